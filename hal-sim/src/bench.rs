//! A bench of drives on virtual time.
//!
//! Nothing on a bench is faster than a tick of 62.5 ns: whatever a drive does reaches others a tick
//! later at the earliest, so there is no loop without delay. What happens at one instant has one
//! order: power, faults, pins, lines, deadlines; then the names of the seats; then what was caused
//! first. So a bench does the same whatever order its drives were added in, and its
//! [trace](Bench::trace) replays exactly.
//!
//! Time goes from event to event: a tournament holds the next deadline of each seat, a heap what is
//! under way, and only the drive that is due is woken.

use std::collections::BTreeMap;
use std::fmt;

use fixed::types::I48F16;
use standin_firmware::device::{
    Axis, Device, Duration, Fault, Instant, Level, Line, Pin, Port, Refused, Spec,
};
use standin_protocol::line::Parity;
use standin_protocol::modbus::rtu::Timing;

use crate::bus::{LineMode, Offer, Outside, Sender, Turn, Wire};
use crate::schedule::{Class, Event, Heap, Tournament, What};
use crate::seat::{Seated, Sent, Tape, Train};
use crate::trace::{self, Fed, Power, Trace, TraceKeep};

/// A device on the bench.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct Seat(pub(crate) u32);

/// A serial line and the ports on it.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct Bus(u32);

/// Somebody outside, who talks and listens on a line.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct Client(u32);

/// What holds for a whole bench.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Settings {
    /// Seed of every random choice.
    pub seed: u64,
    /// How long characters take.
    pub line: LineMode,
    /// How long half a message may wait for its rest, in time of the bench.
    pub patience: Duration,
    /// How much of what happens is kept.
    pub trace: TraceKeep,
}

impl Default for Settings {
    fn default() -> Self {
        Self { seed: 1, line: LineMode::Timed, patience: Duration::millis(20), trace: TraceKeep::default() }
    }
}

/// Told each range of bytes as it is stored: where it begins, and the bytes.
pub type Keep = Box<dyn FnMut(u16, &[u8])>;

/// How a device is seated.
#[derive(Default)]
pub struct Setup {
    /// No start-up delay.
    pub boot_fast: bool,
    /// What is in its memory; cut or filled up with `0xFF` to its size. `None`: a new one.
    pub memory: Option<Vec<u8>>,
    /// Who keeps its memory.
    pub keep: Option<Keep>,
    /// Rows and their values: saved ones are in the memory before the first power-on, others are
    /// set after every power-on.
    pub presets: Vec<(usize, i64)>,
}

/// Why a device cannot be seated; the bench is as before.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum SeatError {
    /// A name is one word that does not begin with `#`, `<` or `>`.
    Name(String),
    /// There is a seat of that name.
    Taken(String),
    /// A preset is refused.
    Preset {
        /// Of which row.
        row: usize,
        /// Why.
        why: Refused,
    },
}

impl fmt::Display for SeatError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Name(name) => write!(f, "\"{name}\" is no name for a drive: use one word"),
            Self::Taken(name) => write!(f, "there are two drives called {name}"),
            Self::Preset { row, why } => write!(f, "the preset of row {row} is refused: {why:?}"),
        }
    }
}

impl std::error::Error for SeatError {}

/// What is done to a pin from outside.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Drive {
    /// Pulled to ground.
    Low,
    /// Driven high.
    High,
    /// Let go.
    Open,
    /// A voltage, in mV.
    Millivolts(i32),
}

/// A train of pulses runs on that pin already.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Busy;

impl fmt::Display for Busy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a train of pulses runs on that pin already")
    }
}

impl std::error::Error for Busy {}

/// What is done to a device's power.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum PowerAction {
    /// Taken away.
    Off,
    /// Given.
    On,
    /// Taken away, and given again a tick later.
    Cycle,
    /// Fails in the middle of the next save, and stays away.
    Cut,
}

/// What an axis does at an instant.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Motion {
    /// Steps or counts since the first power-on.
    pub position: i32,
    /// Steps or counts per second, signed.
    pub speed: I48F16,
    /// Whether it is on its way.
    pub moving: bool,
    /// Peak current in mA.
    pub current_ma: u32,
    /// Duty of a motor without steps, in 1/65536, signed.
    pub duty: i32,
}

/// What a port has seen since its device was seated.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Statistics {
    /// Requests carried out.
    pub requests: u64,
    /// Requests refused with an exception.
    pub refused: u64,
    /// Frames whose check sum did not hold.
    pub crc: u64,
    /// Frames with a silence inside.
    pub gap: u64,
    /// Frames of a wrong length.
    pub length: u64,
    /// Frames with a character that nobody could read.
    pub spoiled: u64,
    /// Frames for somebody else.
    pub foreign: u64,
    /// Frames that came while the device was starting.
    pub starting: u64,
}

impl Statistics {
    /// Frames ignored, for whatever reason.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.crc + self.gap + self.length + self.spoiled + self.foreign + self.starting
    }
}

/// Drives, lines and time.
pub struct Bench {
    settings: Settings,
    now: Instant,
    seats: Vec<Seated>,
    /// Seats by name, and the place of each among them.
    order: Vec<u32>,
    ranks: Vec<u32>,
    deadlines: Tournament,
    /// Whether `order`, `ranks` and `deadlines` know all seats.
    indexed: bool,
    under_way: Heap,
    buses: Vec<Wire>,
    /// Lines on which somebody is being served.
    busy: usize,
    clients: BTreeMap<u32, Outside>,
    /// Clients there have been.
    connected: u32,
    /// Bytes that have arrived from clients, in the order of arrival.
    arrivals: u64,
    /// What the device called last has sent.
    sent: Vec<Sent>,
    trace: Trace,
}

impl Default for Bench {
    fn default() -> Self {
        Self::new()
    }
}

/// Drives on their seats.
impl Bench {
    /// An empty bench at the beginning of time.
    #[must_use]
    pub fn new() -> Self {
        Self::with(Settings::default())
    }

    /// An empty bench with other settings.
    #[must_use]
    pub fn with(settings: Settings) -> Self {
        Self {
            settings,
            now: Instant::ZERO,
            seats: Vec::new(),
            order: Vec::new(),
            ranks: Vec::new(),
            deadlines: Tournament::new(&[]),
            indexed: true,
            under_way: Heap::default(),
            buses: Vec::new(),
            busy: 0,
            clients: BTreeMap::new(),
            connected: 0,
            arrivals: 0,
            sent: Vec::new(),
            trace: Trace::new(settings.seed, settings.trace),
        }
    }

    /// Seats a device and powers it on now.
    ///
    /// # Panics
    /// If the name is no name, or taken.
    pub fn add<D: Device + Default + 'static>(&mut self, name: &str) -> Seat {
        match self.seat(name, Box::new(D::default()), Setup::default()) {
            Ok(seat) => seat,
            Err(error) => panic!("{error}"),
        }
    }

    /// Seats a device and powers it on now. Each of its serial ports gets a line of its own.
    ///
    /// # Errors
    /// Its name or a preset is refused.
    pub fn seat(&mut self, name: &str, device: Box<dyn Device>, setup: Setup) -> Result<Seat, SeatError> {
        if !trace::is_name(name) {
            return Err(SeatError::Name(name.to_owned()));
        }
        if self.seat_named(name).is_some() {
            return Err(SeatError::Taken(name.to_owned()));
        }
        let place = u32::try_from(self.seats.len()).expect("a bench has room for four billion drives");
        let Setup { boot_fast, memory, keep, presets } = setup;
        let spec = device.spec();
        let saved = |row: usize| spec.registers.rows.get(row).is_some_and(|row| row.saved != 0);
        let (now, mark) = (self.now, self.trace.mark());
        let mut seated = Seated::new(place, name, device, self.settings.seed, boot_fast, memory, keep);
        let mut tape = tape(&mut self.trace, &mut self.sent, self.settings);
        let mut result = Ok(());
        for &(row, value) in presets.iter().filter(|(row, _)| saved(*row)) {
            result = result.and_then(|()| {
                seated.preset(now, row, value, &mut tape).map_err(|why| SeatError::Preset { row, why })
            });
        }
        // What it finds in its memory is where its trace begins.
        tape.trace.rewind(mark);
        let memory = seated.body.memory.clone();
        if result.is_ok() {
            seated.presets = presets.into_iter().filter(|(row, _)| !saved(*row)).collect();
            seated.power_on(now, &mut tape);
            result = seated.preset_again(now, &mut tape).map_err(|(row, why)| SeatError::Preset { row, why });
        }
        if let Err(error) = result {
            tape.trace.rewind(mark);
            self.sent.clear();
            return Err(error);
        }
        self.trace.drives.push(trace::Drive { name: name.to_owned(), spec, boot_fast, from: now, memory });
        for (port, serial) in (0..).map(Port).zip(spec.ports) {
            if serial.line.is_some() {
                self.buses.push(Wire::new(serial.name, vec![(Seat(place), port)]));
                seated.set_bus(port, self.buses.len() - 1);
            }
        }
        self.seats.push(seated);
        self.indexed = false;
        self.after(place);
        Ok(Seat(place))
    }

    /// All seats, in the order in which they were added.
    pub fn seats(&self) -> impl ExactSizeIterator<Item = Seat> + use<> {
        (0..self.trace.drives.len() as u32).map(Seat)
    }

    /// What a device is.
    #[must_use]
    pub fn spec(&self, seat: Seat) -> &'static Spec {
        self.at(seat).spec
    }

    /// The name of a seat.
    #[must_use]
    pub fn name(&self, seat: Seat) -> &str {
        &self.at(seat).name
    }

    /// The seat of that name.
    #[must_use]
    pub fn seat_named(&self, name: &str) -> Option<Seat> {
        self.seats.iter().zip(self.seats()).find(|(seated, _)| seated.name == name).map(|(_, seat)| seat)
    }

    /// What has happened.
    #[must_use]
    pub fn trace(&self) -> &Trace {
        &self.trace
    }

    fn at(&self, seat: Seat) -> &Seated {
        &self.seats[seat.0 as usize]
    }

    fn at_mut(&mut self, seat: Seat) -> &mut Seated {
        &mut self.seats[seat.0 as usize]
    }
}

/// Time.
impl Bench {
    /// How far time has come.
    #[must_use]
    pub fn now(&self) -> Instant {
        self.now
    }

    /// The next instant at which something happens, or a client can read a character;
    /// [`Instant::NEVER`] if nothing is under way.
    #[must_use]
    pub fn next(&self) -> Instant {
        let characters = self.clients.values().map(Outside::due);
        characters.fold(self.next_event(), Instant::min)
    }

    fn next_event(&self) -> Instant {
        let under_way = self.under_way.first().map_or(Instant::NEVER, |key| key.at);
        let deadline = if self.indexed {
            self.deadlines.first().0
        } else {
            self.seats.iter().map(Seated::deadline).min().unwrap_or(Instant::NEVER)
        };
        under_way.min(deadline)
    }

    /// Brings everything to `at`, which is included. Time does not go back, and without end only
    /// until nothing more is to happen.
    pub fn run_until(&mut self, at: impl Into<Instant>) {
        let at = at.into();
        self.index();
        loop {
            let (due, rank) = self.deadlines.first();
            match self.under_way.first() {
                Some(key) if (key.at, key.class) < (due, Class::Deadline) => {
                    if key.at > at {
                        break;
                    }
                    self.now = self.now.max(key.at);
                    if let Some(event) = self.under_way.pop() {
                        self.happen(event);
                    }
                }
                _ if due > at || due == Instant::NEVER => break,
                _ => {
                    self.now = self.now.max(due);
                    self.wake(rank, due);
                }
            }
        }
        if at < Instant::NEVER {
            self.now = self.now.max(at);
        }
        self.trace.end = self.now;
    }

    /// Runs until every complete request is answered to its end, or judged, and what was done to
    /// pins and power has arrived.
    pub fn settle(&mut self) {
        self.run_until(self.now);
        // A power cycle takes longest: power goes within a tick and comes a tick later.
        let hands = self.now + Duration::TICK * 2;
        loop {
            let next = self.next_event();
            if next == Instant::NEVER || (next > hands && self.busy == 0) {
                return;
            }
            self.run_until(next);
        }
    }

    /// Wakes the seat of that rank at its deadline.
    fn wake(&mut self, rank: u32, due: Instant) {
        let place = self.order[rank as usize];
        let seated = &mut self.seats[place as usize];
        let next = seated.wake(due, &mut tape(&mut self.trace, &mut self.sent, self.settings));
        self.deadlines.set(rank, next);
        if !self.sent.is_empty() || !seated.body.powered {
            self.after(place);
        }
    }

    /// After a device has been called: its deadline, what it has sent, what an end of power cuts.
    fn after(&mut self, place: u32) {
        let seated = &self.seats[place as usize];
        if self.indexed {
            self.deadlines.set(self.ranks[place as usize], seated.deadline());
        }
        let off = !seated.body.powered;
        let mut sent = std::mem::take(&mut self.sent);
        for sent in sent.drain(..) {
            self.carry(&sent);
        }
        self.sent = sent;
        if off {
            self.hush(place);
        }
    }

    /// Puts the seats in order, if there are new ones.
    fn index(&mut self) {
        if self.indexed {
            return;
        }
        self.order = (0..self.seats.len() as u32).collect();
        let seats = &self.seats;
        self.order.sort_by(|&a, &b| seats[a as usize].name.cmp(&seats[b as usize].name));
        self.ranks = vec![0; seats.len()];
        for (rank, &place) in (0..).zip(&self.order) {
            self.ranks[place as usize] = rank;
        }
        let deadlines: Vec<Instant> =
            self.order.iter().map(|&place| seats[place as usize].deadline()).collect();
        self.deadlines = Tournament::new(&deadlines);
        let ranks = &self.ranks;
        self.under_way.rank(|place| ranks[place as usize]);
        self.indexed = true;
    }

    /// Sends something on its way.
    fn schedule(&mut self, at: Instant, class: Class, place: u32, what: What) {
        // As long as there are seats without a rank all get theirs before the next event.
        let rank = self.ranks.get(place as usize).copied().unwrap_or(0);
        self.under_way.push(at, class, rank, place, what);
    }

    /// Sends something on its way to a device, to arrive at `at`.
    fn send_to(&mut self, at: Instant, place: u32, fed: Fed) {
        self.schedule(at, Class::of(&fed), place, What::Fed(fed));
    }

    /// Something under way arrives.
    fn happen(&mut self, event: Event) {
        match event.what {
            What::Fed(fed) => self.deliver(event.seat, &fed),
            What::Pulse { pin, train } => self.edge(event.seat, pin, train),
            What::Turn { bus } => self.turn_ends(bus, event.key.at),
        }
    }

    /// Feeds a device now, unless it cannot hear.
    fn deliver(&mut self, place: u32, fed: &Fed) {
        let now = self.now;
        let seated = &mut self.seats[place as usize];
        if !seated.hears(now, fed) {
            return;
        }
        let comes = matches!(fed, Fed::Power(Power::On)) && !seated.body.powered;
        let mut tape = tape(&mut self.trace, &mut self.sent, self.settings);
        // Only a preset can be refused, and it does not come this way.
        let _ = seated.feed(now, fed, &mut tape);
        if comes {
            for fed in seated.surroundings() {
                let _ = seated.feed(now, &fed, &mut tape);
            }
            // They were accepted at the first power-on.
            let _ = seated.preset_again(now, &mut tape);
        }
        self.after(place);
    }

    /// Feeds a device as a trace says, at an instant that is not over. Several characters for a port
    /// where each has its time follow back to back.
    pub(crate) fn feed(&mut self, seat: Seat, at: Instant, fed: &Fed) {
        if matches!(fed, Fed::Poke { .. }) {
            self.run_until(at);
        } else if at > Instant::ZERO {
            self.run_until(at - Duration::TICK);
        }
        self.now = self.now.max(at);
        self.index();
        if let Fed::Bytes { port, ref bytes } = *fed
            && let Some(serial) = self.at_mut(seat).body.serial(port)
            && !serial.silence
        {
            let character = serial.line_at(at).character();
            for (n, &byte) in (0..).zip(bytes) {
                self.send_to(at + character * n, seat.0, Fed::Bytes { port, bytes: vec![byte] });
            }
            return;
        }
        let mut tape = tape(&mut self.trace, &mut self.sent, self.settings);
        // A preset that is refused does nothing, and is not recorded.
        let _ = self.seats[seat.0 as usize].feed(at, fed, &mut tape);
        self.after(seat.0);
    }
}

/// What the outputs of a device go to.
fn tape<'a>(trace: &'a mut Trace, sent: &'a mut Vec<Sent>, settings: Settings) -> Tape<'a> {
    Tape { trace, sent, fast: settings.line == LineMode::Fast }
}

/// Lines.
impl Bench {
    /// Puts several serial ports on one line. Clients connect after it.
    pub fn share(&mut self, name: &str, ports: &[(Seat, Port)]) -> Bus {
        let bus = self.buses.len();
        let mut shared: Vec<(Seat, Port)> = Vec::new();
        for &(seat, port) in ports {
            if let Some(Bus(old)) = self.bus(seat, port) {
                self.buses[old as usize].ports.retain(|&other| other != (seat, port));
                self.at_mut(seat).set_bus(port, bus);
                shared.push((seat, port));
            }
        }
        shared.sort_by(|a, b| (self.name(a.0), a.1).cmp(&(self.name(b.0), b.1)));
        self.buses.push(Wire::new(name, shared));
        Bus(bus as u32)
    }

    /// The line of a serial port; `None` for any other port.
    #[must_use]
    pub fn bus(&self, seat: Seat, port: Port) -> Option<Bus> {
        self.at(seat).bus(port).map(Bus)
    }

    /// The name of a line: as given to [`share`](Self::share), or that of its port.
    #[must_use]
    pub fn bus_name(&self, bus: Bus) -> &str {
        &self.buses[bus.0 as usize].name
    }

    /// The ports on a line, by the names of their seats.
    #[must_use]
    pub fn ports(&self, bus: Bus) -> &[(Seat, Port)] {
        &self.buses[bus.0 as usize].ports
    }

    /// The settings of a line now: those of its first drive, by name.
    #[must_use]
    pub fn line(&self, bus: Bus) -> Line {
        let first = self.ports(bus).first().and_then(|&(seat, port)| self.at(seat).line_at(port, self.now));
        first.unwrap_or(Line::new(9_600, 8, Parity::None, 1))
    }

    /// How long half a message may wait for its rest from now on, in time of the bench.
    pub fn set_patience(&mut self, patience: Duration) {
        self.settings.patience = patience;
    }

    /// Somebody joins a line.
    pub fn connect(&mut self, bus: Bus) -> Client {
        self.connected += 1;
        self.clients.insert(self.connected, Outside::new(bus.0));
        self.buses[bus.0 as usize].clients.push(self.connected);
        Client(self.connected)
    }

    /// A client leaves, and takes its half message along. What was complete is still sent.
    pub fn disconnect(&mut self, client: Client) {
        let Some(outside) = self.clients.get_mut(&client.0) else { return };
        outside.left = true;
        let bus = outside.bus;
        if outside.backlog() == 0 {
            self.forget(client.0);
        }
        self.serve(bus);
    }

    /// A client's bytes arrive now.
    pub fn send(&mut self, client: Client, bytes: &[u8]) {
        self.send_from(client, bytes, Sender::default());
    }

    /// A client's bytes arrive now, from a port with these settings. A drive whose line they do not
    /// fit hears characters that nobody can read.
    pub fn send_from(&mut self, client: Client, bytes: &[u8], sender: Sender) {
        let Some(outside) = self.clients.get_mut(&client.0).filter(|outside| !outside.left) else { return };
        if bytes.is_empty() {
            return;
        }
        self.arrivals += 1;
        outside.arrive(self.now, self.arrivals, bytes, sender);
        let bus = outside.bus;
        self.serve(bus);
    }

    /// Bytes of a client that are not on the line yet. A host that reads only while this is small
    /// holds back who sends faster than the line.
    #[must_use]
    pub fn backlog(&self, client: Client) -> usize {
        self.clients.get(&client.0).map_or(0, Outside::backlog)
    }

    /// Appends the characters that have reached a client by now; returns how many.
    pub fn receive(&mut self, client: Client, into: &mut Vec<u8>) -> usize {
        self.clients.get_mut(&client.0).map_or(0, |outside| outside.receive(self.now, into))
    }

    /// Somebody opens or leaves the port at the other end of a line (DTR, a pty).
    pub fn attach(&mut self, bus: Bus, here: bool) {
        for n in 0..self.ports(bus).len() {
            let (seat, port) = self.ports(bus)[n];
            let at = self.at(seat).free(self.now, Class::Line);
            self.send_to(at, seat.0, Fed::Attached { port, here });
        }
    }

    /// Sends a frame to the first port of a device, [settles](Self::settle), and returns what came.
    pub fn ask(&mut self, seat: Seat, frame: &[u8]) -> Vec<u8> {
        let mut reply = Vec::new();
        if let Some(bus) = self.bus(seat, Port(0)) {
            let client = self.connect(bus);
            self.send(client, frame);
            self.settle();
            self.receive(client, &mut reply);
            self.disconnect(client);
        }
        reply
    }

    fn fast(&self) -> bool {
        self.settings.line == LineMode::Fast
    }

    /// Whether silence ends the messages on a line.
    fn silence(&self, bus: u32) -> bool {
        let first = self.ports(Bus(bus)).first();
        first.is_some_and(|&(seat, port)| self.at(seat).serial(port).is_some_and(|serial| serial.silence))
    }

    /// The longest character, and the longest silence between frames, that a drive on a line knows.
    fn timing(&self, bus: u32) -> (Duration, Duration) {
        let lines =
            self.ports(Bus(bus)).iter().filter_map(|&(seat, port)| self.at(seat).line_at(port, self.now));
        lines.map(Timing::of).fold((Duration::ZERO, Duration::ZERO), |(character, silence), timing| {
            (character.max(timing.character), silence.max(timing.t3_5))
        })
    }

    /// Gives a free line to whose bytes came first.
    fn serve(&mut self, bus: u32) {
        while self.buses[bus as usize].turn == Turn::Free {
            let clients = self.buses[bus as usize].clients.iter();
            let waiting = clients.filter_map(|&id| Some((self.clients.get(&id)?.order()?, id)));
            let Some((_, id)) = waiting.min() else {
                self.buses[bus as usize].until = Instant::NEVER;
                return;
            };
            let silence = self.silence(bus);
            let Some(outside) = self.clients.get_mut(&id) else { return };
            match outside.offer(self.now, silence, self.settings.patience) {
                Offer::Message(length) => {
                    let (bytes, sender) = (outside.take(length), outside.sender);
                    if outside.left && outside.backlog() == 0 {
                        self.forget(id);
                    }
                    self.transmit(bus, &bytes, sender);
                }
                Offer::Half(_) if outside.left => self.forget(id),
                Offer::Half(until) => {
                    self.turn_until(bus, until);
                    return;
                }
            }
        }
    }

    /// A client is gone for good.
    fn forget(&mut self, id: u32) {
        if let Some(outside) = self.clients.remove(&id) {
            self.buses[outside.bus as usize].clients.retain(|&other| other != id);
        }
    }

    /// Puts a message on a free line, as if sent without gaps from now, or from when the line is
    /// free.
    fn transmit(&mut self, bus: u32, bytes: &[u8], sender: Sender) {
        let start = self.now.max(self.buses[bus as usize].free);
        let mut judged = start;
        for n in 0..self.ports(Bus(bus)).len() {
            let (seat, port) = self.ports(Bus(bus))[n];
            let Some(line) = self.at(seat).line_at(port, start) else { continue };
            let spoken = Line { baud: sender.baud.unwrap_or(line.baud), ..line };
            judged = judged.max(self.say(seat, port, start, bytes, spoken, sender.fits(line)));
        }
        let wire = &mut self.buses[bus as usize];
        wire.turn = Turn::Asked;
        self.busy += 1;
        self.turn_until(bus, judged);
    }

    /// Says something to a port from `start` on, in the settings `spoken`, which its own `fit`.
    /// Returns when it has judged it.
    fn say(
        &mut self,
        seat: Seat,
        port: Port,
        start: Instant,
        bytes: &[u8],
        spoken: Line,
        fit: bool,
    ) -> Instant {
        let Some(silence) = self.at(seat).serial(port).map(|serial| serial.silence) else { return start };
        let whole = silence && fit;
        let message = |bytes: &[u8]| {
            if fit { Fed::Bytes { port, bytes: bytes.to_vec() } } else { Fed::Spoiled { port } }
        };
        if self.fast() {
            let at = self.at(seat).free(start, Class::Line);
            if whole {
                self.send_to(at, seat.0, message(bytes));
            } else {
                for byte in bytes.chunks(1) {
                    self.send_to(at, seat.0, message(byte));
                }
            }
            if silence {
                self.send_to(at, seat.0, Fed::Idle { port });
            }
            return at;
        }
        let character = spoken.character();
        let first = start + character;
        if whole {
            self.send_to(first, seat.0, message(bytes));
        } else {
            for (n, byte) in (0..).zip(bytes.chunks(1)) {
                self.send_to(first + character * n, seat.0, message(byte));
            }
        }
        let last = start + character * bytes.len() as u64;
        let own = self.at(seat).line_at(port, start).map_or(Timing::of(spoken), Timing::of);
        last + own.t3_5 + own.character
    }

    /// Carries what a drive sends to all who listen; nobody hears himself.
    fn carry(&mut self, sent: &Sent) {
        let Some(Bus(bus)) = self.bus(Seat(sent.seat), sent.port) else { return };
        let fast = self.fast();
        let character = if fast { Duration::ZERO } else { sent.line.character() };
        let wire = &mut self.buses[bus as usize];
        wire.sends_until = wire.sends_until.max(sent.start + character * sent.bytes.len() as u64);
        for id in &wire.clients {
            if let Some(outside) = self.clients.get_mut(id).filter(|outside| !outside.left) {
                for (n, &byte) in (1..).zip(&sent.bytes) {
                    outside.hear(sent.start + character * n, byte);
                }
            }
        }
        let start = if fast { sent.start + Duration::TICK } else { sent.start };
        for n in 0..self.ports(Bus(bus)).len() {
            let (seat, port) = self.ports(Bus(bus))[n];
            if (seat.0, port) != (sent.seat, sent.port) {
                let fit = self.at(seat).line_at(port, start) == Some(sent.line);
                self.say(seat, port, start, &sent.bytes, sent.line, fit);
            }
        }
    }

    /// Power is gone: what a device was still sending was never sent.
    fn hush(&mut self, place: u32) {
        let now = self.now;
        for port in (0..self.spec(Seat(place)).ports.len() as u8).map(Port) {
            let Some(serial) = self.at_mut(Seat(place)).body.serial(port) else { continue };
            if serial.sends_until <= now {
                continue;
            }
            serial.sends_until = now;
            let Some(Bus(bus)) = self.bus(Seat(place), port) else { continue };
            for id in &self.buses[bus as usize].clients {
                if let Some(outside) = self.clients.get_mut(id) {
                    outside.hush(now);
                }
            }
        }
    }

    /// The present turn, or the patience with half a message, ends at `at`.
    fn turn_until(&mut self, bus: u32, at: Instant) {
        self.buses[bus as usize].until = at;
        if let Some(&(seat, _)) = self.ports(Bus(bus)).first() {
            self.schedule(at, Class::Turn, seat.0, What::Turn { bus });
        }
    }

    /// A turn may be over: then the line is free, and goes to whoever waits.
    fn turn_ends(&mut self, bus: u32, at: Instant) {
        let (silence, fast, (character, t3_5)) = (self.silence(bus), self.fast(), self.timing(bus));
        let wire = &mut self.buses[bus as usize];
        if wire.until != at {
            return;
        }
        wire.until = Instant::NEVER;
        let answers = match wire.turn {
            Turn::Free => return self.serve(bus),
            Turn::Asked => true,
            // Streams never end, and both directions of their lines run at once.
            Turn::Answering => silence,
        };
        if answers && wire.sends_until > at {
            wire.turn = Turn::Answering;
            let until = wire.sends_until;
            return self.turn_until(bus, until);
        }
        wire.turn = Turn::Free;
        wire.free = if fast && wire.ports.len() > 1 {
            // The other drives hear the answer then.
            at + Duration::TICK
        } else if fast || !silence {
            at
        } else {
            // A tick after the drives have judged the silence the next character may end.
            (at + Duration::TICK - character).max(wire.sends_until + t3_5)
        };
        self.busy -= 1;
        self.serve(bus);
    }
}

/// Pins, faults, power and registers.
impl Bench {
    /// Drives a pin from outside, and ends a train of pulses there. It arrives a tick later.
    pub fn set_pin(&mut self, seat: Seat, pin: Pin, drive: Drive) {
        let at = self.now + Duration::TICK;
        let Some(state) = self.at_mut(seat).pin_mut(pin) else { return };
        state.train = None;
        let before = state.signal(state.outside);
        state.outside = drive;
        let signal = state.signal(drive);
        if signal != before {
            self.send_to(at, seat.0, signal.fed(pin));
        }
    }

    /// A train of `count` pulses on an input pin, away from its present level and back, `hz` a
    /// second (limited to 1 µHz to 8 MHz). Edges are made one by one as time comes to them.
    ///
    /// # Errors
    /// One runs there already.
    pub fn pulse(&mut self, seat: Seat, pin: Pin, count: u32, hz: f64) -> Result<(), Busy> {
        const EDGES_PER_SECOND: f64 = 8_000_000.0;
        let start = self.now + Duration::TICK;
        let Some(state) = self.at_mut(seat).pin_mut(pin) else { return Ok(()) };
        if state.train.is_some() {
            return Err(Busy);
        }
        if count == 0 {
            return Ok(());
        }
        state.trains += 1;
        let train = state.trains;
        state.train = Some(Train {
            start,
            // NaN counts as the least.
            ticks_per_edge: EDGES_PER_SECOND / hz.max(1e-6).min(EDGES_PER_SECOND),
            made: 0,
            edges: 2 * u64::from(count),
            rest: state.is_high(),
            before: state.outside,
        });
        self.schedule(start, Class::Pin, seat.0, What::Pulse { pin, train });
        Ok(())
    }

    /// The next edge of a train.
    fn edge(&mut self, place: u32, pin: Pin, number: u32) {
        let Some(state) = self.seats[place as usize].pin_mut(pin) else { return };
        let Some(mut train) = state.train.filter(|_| state.trains == number) else { return };
        state.outside = if train.rest == (train.made % 2 == 1) { Drive::High } else { Drive::Low };
        let signal = state.signal(state.outside);
        train.made += 1;
        if train.made < train.edges {
            state.train = Some(train);
            self.schedule(train.due(), Class::Pin, place, What::Pulse { pin, train: number });
        } else {
            (state.train, state.outside) = (None, train.before);
        }
        self.deliver(place, &signal.fed(pin));
    }

    /// A pin as it is seen from outside now.
    #[must_use]
    pub fn level(&self, seat: Seat, pin: Pin) -> Level {
        self.at(seat).level(self.now, pin)
    }

    /// The cause of a fault comes or goes.
    pub fn fault(&mut self, seat: Seat, fault: Fault, on: bool) {
        let at = self.at(seat).free(self.now, Class::Fault);
        self.send_to(at, seat.0, Fed::Fault { fault, on });
    }

    /// Whether the cause of a fault is there.
    #[must_use]
    pub fn faulty(&self, seat: Seat, fault: Fault) -> bool {
        self.at(seat).body.faults.get(usize::from(fault.0)).copied().unwrap_or(false)
    }

    /// Does something to a device's power, now or a tick later.
    pub fn power(&mut self, seat: Seat, action: PowerAction) {
        let at = self.at(seat).free(self.now, Class::Power);
        let power = match action {
            PowerAction::Off | PowerAction::Cycle => Power::Off,
            PowerAction::On => Power::On,
            PowerAction::Cut => Power::Cut(None),
        };
        self.send_to(at, seat.0, Fed::Power(power));
        if action == PowerAction::Cycle {
            self.send_to(at + Duration::TICK, seat.0, Fed::Power(Power::On));
        }
    }

    /// Whether a device has power.
    #[must_use]
    pub fn powered(&self, seat: Seat) -> bool {
        self.at(seat).body.powered
    }

    /// Presets a register past the bus.
    ///
    /// # Errors
    /// The device refuses it; nothing has changed then. Without power it takes nothing.
    pub fn poke(&mut self, seat: Seat, row: usize, value: i64) -> Result<(), Refused> {
        // After all else that happens now, so that a replay does the same.
        self.run_until(self.now);
        if !self.powered(seat) {
            return Err(Refused::ReadOnly);
        }
        let mut tape = tape(&mut self.trace, &mut self.sent, self.settings);
        let result = self.seats[seat.0 as usize].feed(self.now, &Fed::Poke { row, value }, &mut tape);
        self.after(seat.0);
        self.run_until(self.now);
        result
    }

    /// A register as it reads now, without the bus's side effects.
    #[must_use]
    pub fn peek(&self, seat: Seat, row: usize) -> i64 {
        self.at(seat).peek(self.now, row)
    }

    /// What an axis does now.
    #[must_use]
    pub fn motion(&self, seat: Seat, axis: Axis) -> Motion {
        self.at(seat).motion(self.now, axis)
    }

    /// What a port has seen since its device was seated.
    #[must_use]
    pub fn statistics(&self, seat: Seat, port: Port) -> Statistics {
        self.at(seat).body.ports.get(usize::from(port.0)).map(|port| port.statistics).unwrap_or_default()
    }

    /// The non-volatile memory of a device.
    #[must_use]
    pub fn memory(&self, seat: Seat) -> &[u8] {
        &self.at(seat).body.memory
    }
}
