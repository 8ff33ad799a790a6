//! A bench of drives on virtual time.
//!
//! Nothing on a bench is faster than a tick of 62.5 ns: whatever a drive does reaches others a tick
//! later at the earliest, so there is no loop without delay. What happens at one instant has one
//! order: power, faults, pins, lines, deadlines; then the names of the seats; then what was caused
//! first. So a bench does the same whatever order its drives were added in, and its
//! [trace](Bench::trace) replays exactly.
//!
//! Time goes from event to event: a tournament holds the next deadline of each seat, a heap what is
//! under way, and only the drive that is due is woken. Step pulses and the edges of waves are made
//! where a [wire](Bench::wire) listens, one ahead; where none does, a move is one event.

mod arbitration;
mod clients;
mod events;
mod line_faults;
mod lines;
mod motors;
mod pin_wires;
mod shaft_sensors;
mod stimulus;
mod tcp_clients;
#[cfg(test)]
mod tests;
mod transmit;

use std::collections::HashMap;
use std::fmt;

use drivetwin_firmware::device::{Device, Duration, Instant, Port, PresetError, Spec};

pub use crate::ids::{Bus, Client, DriveId};
use crate::line::{Clients, LineMode, SerialLine};
use crate::record::capture::Capture;
use crate::record::trace::{self, InputRecord, Power, Retention, Trace};
use crate::scheduler::{Event, Phase, Queue, Tournament};
use crate::slot::{CallContext, Outputs, Slot};
pub use crate::slot::{MOST_CONNECTIONS, Motion, PersistFn, PinStimulus, Statistics};
use events::EventKind;
use motors::MotorSlot;
pub use motors::{Motor, MotorModel, ShaftState};
use pin_wires::PinWire;
pub use pin_wires::StepOutput;
pub use shaft_sensors::{CYCLES_PER_REV, Closed, FURTHEST_REV};
use tcp_clients::Connections;
pub use tcp_clients::{Ended, Outlet, TurnedAway};

/// Settings of a whole bench.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Settings {
    /// Seed of every random choice.
    pub seed: u64,
    /// Time that characters take.
    pub line: LineMode,
    /// Longest wait for the rest of half a message, in time of the bench.
    pub patience: Duration,
    /// Retention of the trace.
    pub trace: Retention,
    /// Retention of the frames on the lines.
    pub capture: Retention,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            seed: 1,
            line: LineMode::Timed,
            patience: Duration::millis(20),
            trace: Retention::default(),
            capture: Retention::Off,
        }
    }
}

/// Options of a device that is added.
#[derive(Default)]
pub struct Setup {
    /// No start-up delay.
    pub boot_fast: bool,
    /// Content of its memory; cut or filled up with `0xFF` to its size. `None`: a new memory.
    pub memory: Option<Vec<u8>>,
    /// Called for each store to its memory.
    pub keep: Option<PersistFn>,
    /// Rows and their values: saved ones are in the memory before the first power-on, others are
    /// set after every power-on.
    pub presets: Vec<(usize, i64)>,
    /// The brush motor that it turns is one of the bench, and not its own: whatever its registers say of a motor
    /// from then on is for the drive itself.
    pub apart: bool,
}

/// Reason why a device cannot be added; the bench is as before.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum AddError {
    /// A name is one word without dots that begins with no digit and none of `#`, `<`, `>` and `"`, and is not
    /// `end`.
    Name(String),
    /// There is a seat, a shared line or a motor of that name.
    Taken(String),
    /// A preset is refused.
    Preset {
        /// Row of the register map.
        row: usize,
        /// Reason.
        why: PresetError,
    },
}

impl fmt::Display for AddError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Name(name) => write!(f, "\"{name}\" is no name for a drive: use one word without dots"),
            Self::Taken(name) => write!(f, "there are two things called {name}"),
            Self::Preset { row, why } => write!(f, "the preset of row {row} is refused: {why:?}"),
        }
    }
}

impl std::error::Error for AddError {}

/// A train of pulses, or an encoder, runs on that pin already.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Busy;

impl fmt::Display for Busy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a train of pulses, or an encoder, runs on that pin already")
    }
}

impl std::error::Error for Busy {}

/// Change of a device's power.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum PowerAction {
    /// Power goes.
    Off,
    /// Power comes.
    On,
    /// Power goes, and comes again a tick later.
    Cycle,
    /// Power fails in the middle of the next save, and stays away.
    Cut,
}

/// State of [`Bench::settle_until`] between two calls.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Settling {
    /// Time by which changes of pins and power have arrived, and waits for half messages have ended.
    hands: Instant,
}

/// Drives, lines and time.
pub struct Bench {
    settings: Settings,
    now: Instant,
    seats: Vec<Slot>,
    /// Names of seats, shared lines and motors; of a seat which one.
    names: HashMap<String, Option<DriveId>>,
    /// Seats by name, and the place of each among them.
    order: Vec<u32>,
    ranks: Vec<u32>,
    deadlines: Tournament,
    /// True if `order`, `ranks` and `deadlines` are up to date.
    indexed: bool,
    under_way: Queue<EventKind>,
    /// Wires between pins.
    wires: Vec<PinWire>,
    /// Motors, and the rank of each.
    motors: Vec<MotorSlot>,
    motor_ranks: Vec<u32>,
    buses: Vec<SerialLine>,
    /// Lines on which somebody is being served, and what is on its way on TCP connections.
    busy: usize,
    clients: Clients,
    /// Clients of TCP ports.
    connections: Connections,
    /// Clients there have been.
    connected: u32,
    /// Bytes that have arrived from clients, in the order of arrival.
    arrivals: u64,
    /// Outputs of the device that was called last.
    outbox: Outputs,
    trace: Trace,
    capture: Capture,
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
            names: HashMap::new(),
            order: Vec::new(),
            ranks: Vec::new(),
            deadlines: Tournament::new(&[]),
            indexed: true,
            under_way: Queue::default(),
            wires: Vec::new(),
            motors: Vec::new(),
            motor_ranks: Vec::new(),
            buses: Vec::new(),
            busy: 0,
            clients: Clients::default(),
            connections: Connections::default(),
            connected: 0,
            arrivals: 0,
            outbox: Outputs::default(),
            trace: Trace::new(settings.seed, settings.trace),
            capture: Capture::new(settings.capture),
        }
    }

    /// Seats a device and powers it on now.
    ///
    /// # Panics
    /// If the name is no name, or taken.
    pub fn add<D: Device + Default + 'static>(&mut self, name: &str) -> DriveId {
        match self.add_with(name, Box::new(D::default()), Setup::default()) {
            Ok(seat) => seat,
            Err(error) => panic!("{error}"),
        }
    }

    /// Seats a device and powers it on now. Each of its serial ports gets a line of its own.
    ///
    /// # Errors
    /// Its name or a preset is refused.
    pub fn add_with(
        &mut self,
        name: &str,
        device: Box<dyn Device>,
        setup: Setup,
    ) -> Result<DriveId, AddError> {
        if !trace::is_name(name) {
            return Err(AddError::Name(name.to_owned()));
        }
        if self.is_taken(name) {
            return Err(AddError::Taken(name.to_owned()));
        }
        let place = u32::try_from(self.seats.len()).expect("a bench has room for four billion drives");
        let Setup { boot_fast, memory, keep, presets, apart } = setup;
        let spec = device.spec();
        let saved = |row: usize| spec.registers.rows.get(row).is_some_and(|row| row.saved != 0);
        let (now, mark) = (self.now, self.trace.mark());
        let mut seated = Slot::new(place, name, device, self.settings.seed, boot_fast, memory, keep);
        if apart {
            seated.part();
        }
        let apart = seated.halls.is_some();
        let mut tape = tape(&mut self.trace, &mut self.outbox, self.settings);
        let mut result = Ok(());
        for &(row, value) in presets.iter().filter(|(row, _)| saved(*row)) {
            result = result.and_then(|()| {
                seated.preset(now, row, value, &mut tape).map_err(|why| AddError::Preset { row, why })
            });
        }
        // What it finds in its memory is where its trace begins.
        tape.trace.rewind(mark);
        let memory = seated.body.memory.clone();
        if result.is_ok() {
            seated.presets = presets.into_iter().filter(|(row, _)| !saved(*row)).collect();
            seated.power_on(now, &mut tape);
            result = seated.preset_again(now, &mut tape).map_err(|(row, why)| AddError::Preset { row, why });
        }
        if let Err(error) = result {
            tape.trace.rewind(mark);
            self.outbox.clear();
            return Err(error);
        }
        seated.know_parted();
        self.trace.drives.push(trace::TraceDrive {
            name: name.to_owned(),
            spec,
            boot_fast,
            fast_line: self.settings.line == LineMode::Fast,
            apart,
            from: now,
            memory,
        });
        for (port, serial) in (0..).map(Port).zip(spec.ports) {
            if serial.line.is_some() {
                self.buses.push(SerialLine::own(
                    self.settings.seed,
                    name,
                    serial.name,
                    (DriveId(place), port),
                ));
                seated.set_bus(port, self.buses.len() - 1);
            }
        }
        self.seats.push(seated);
        self.names.insert(name.to_owned(), Some(DriveId(place)));
        self.indexed = false;
        self.after(place);
        Ok(DriveId(place))
    }

    /// Presets rows that are not saved, now and after every power-on, in place of those it was seated with. At the
    /// instant of its power-on that is after what stands at its pins, which a preset of [`Setup`] comes before: nobody
    /// knows its wires then.
    ///
    /// # Errors
    /// A preset is refused; those before it are set.
    pub fn preset(&mut self, seat: DriveId, presets: Vec<(usize, i64)>) -> Result<(), AddError> {
        self.run_until(self.now);
        let mut tape = tape(&mut self.trace, &mut self.outbox, self.settings);
        let seated = &mut self.seats[seat.0 as usize];
        seated.presets = presets;
        let result = seated.preset_again(self.now, &mut tape);
        self.after(seat.0);
        result.map_err(|(row, why)| AddError::Preset { row, why })
    }

    /// All seats, in the order in which they were added.
    pub fn drives(&self) -> impl ExactSizeIterator<Item = DriveId> + use<> {
        (0..self.trace.drives.len() as u32).map(DriveId)
    }

    /// Description of a device.
    #[must_use]
    pub fn spec(&self, seat: DriveId) -> &'static Spec {
        self.at(seat).spec
    }

    /// The name of a seat.
    #[must_use]
    pub fn name(&self, seat: DriveId) -> &str {
        &self.at(seat).name
    }

    /// The seat of that name.
    #[must_use]
    pub fn find_drive(&self, name: &str) -> Option<DriveId> {
        self.names.get(name).copied().flatten()
    }

    /// Returns whether a device, a shared line or a motor has that name: they have one list of names. The name of a
    /// line that a drive has for itself has a dot, which no other name has.
    #[must_use]
    pub fn is_taken(&self, name: &str) -> bool {
        self.names.contains_key(name)
    }

    /// Everything that has happened.
    #[must_use]
    pub fn trace(&self) -> &Trace {
        &self.trace
    }

    /// All of the [trace](Self::trace) is written, and may be dropped by [`Retention::Written`].
    pub fn has_written(&mut self) {
        self.trace.has_written();
    }

    /// Frames that were on the lines.
    #[must_use]
    pub fn capture(&self) -> &Capture {
        &self.capture
    }

    fn at(&self, seat: DriveId) -> &Slot {
        &self.seats[seat.0 as usize]
    }

    fn at_mut(&mut self, seat: DriveId) -> &mut Slot {
        &mut self.seats[seat.0 as usize]
    }
}

/// Time.
impl Bench {
    /// Present time.
    #[must_use]
    pub fn now(&self) -> Instant {
        self.now
    }

    /// The next instant at which something happens, or a client can read a character;
    /// [`Instant::NEVER`] if nothing is under way.
    #[must_use]
    pub fn next(&self) -> Instant {
        let heard = if self.connections.audible().next().is_some() { self.now } else { Instant::NEVER };
        self.next_event().min(self.clients.due()).min(heard)
    }

    fn next_event(&self) -> Instant {
        let under_way = self.under_way.first().map_or(Instant::NEVER, |key| key.at);
        let deadline = if self.indexed {
            self.deadlines.first().0
        } else {
            self.seats.iter().map(Slot::deadline).min().unwrap_or(Instant::NEVER)
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
                Some(key) if (key.at, key.class) < (due, Phase::Deadline) => {
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
    /// pins and power has arrived; so a typed line has its effect before the next one is taken (MDRIVE-36).
    pub fn settle(&mut self) {
        let settling = self.begin_to_settle();
        self.settle_until(settling, Instant::NEVER);
    }

    /// Begins to [settle](Self::settle) by way of [`settle_until`](Self::settle_until).
    pub fn begin_to_settle(&mut self) -> Settling {
        self.run_until(self.now);
        // A power cycle takes longest: power goes within a tick and comes a tick later.
        Settling { hands: self.now + Duration::TICK * 2 }
    }

    /// Begins to [settle](Self::settle) with all that has been said, because nobody will say the rest of
    /// half a message any more.
    pub fn begin_to_settle_halves(&mut self) -> Settling {
        let Settling { hands } = self.begin_to_settle();
        let halves = self.buses.iter().filter_map(SerialLine::half_until).max();
        Settling { hands: halves.map_or(hands, |until| hands.max(until)) }
    }

    /// Goes on to [settle](Self::settle), but not beyond `at`; whether that is over. In how many pieces it is done
    /// makes no difference, as long as nothing is done to the bench in between.
    pub fn settle_until(&mut self, settling: Settling, at: Instant) -> bool {
        loop {
            let mut next = self.next_event();
            if next == Instant::NEVER || (next > settling.hands && self.busy == 0) {
                // Nobody says more before this is over.
                if self.end_bursts() {
                    continue;
                }
                let Some(until) = self.half_in_the_way() else { return true };
                next = until;
            }
            self.run_until(next.min(at));
            if next > at {
                return false;
            }
        }
    }

    /// Wakes the seat of that rank at its deadline.
    fn wake(&mut self, rank: u32, due: Instant) {
        let place = self.order[rank as usize];
        let seated = &mut self.seats[place as usize];
        let next = seated.wake(due, &mut tape(&mut self.trace, &mut self.outbox, self.settings));
        let off = !seated.body.powered;
        self.deadlines.set(rank, next);
        self.tell_motors(place);
        self.carry_all();
        if off {
            self.hush(place);
            self.lose_connections(place);
        }
        self.note_taking(place);
    }

    /// After a device has been called otherwise: its deadline, what it has sent, what an end of power
    /// cuts.
    fn after(&mut self, place: u32) {
        let seated = &self.seats[place as usize];
        let off = !seated.body.powered;
        if self.indexed {
            self.deadlines.set(self.ranks[place as usize], seated.deadline());
        }
        self.tell_motors(place);
        self.carry_all();
        if off {
            self.hush(place);
            self.lose_connections(place);
        }
        self.note_taking(place);
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
        self.rank_motors();
        let (ranks, motor_ranks) = (&self.ranks, &self.motor_ranks);
        self.under_way.rank(|place| match motors::at_place(place) {
            Some(motor) => motor_ranks[motor],
            None => ranks[place as usize],
        });
        self.indexed = true;
    }

    /// Sends something on its way.
    #[inline(always)]
    fn schedule(&mut self, at: Instant, class: Phase, place: u32, what: EventKind) {
        // As long as there are seats without a rank all get theirs before the next event.
        let rank = self.ranks.get(place as usize).copied().unwrap_or(0);
        self.under_way.push(at, class, rank, place, what);
    }

    /// Sends something on its way to a device, to arrive at `at`.
    fn send_to(&mut self, at: Instant, place: u32, fed: InputRecord) {
        self.schedule(at, Phase::of(&fed), place, EventKind::InputRecord(fed));
    }

    /// Handles an event.
    fn happen(&mut self, event: Event<EventKind>) {
        match event.what {
            EventKind::InputRecord(fed) => self.deliver(event.seat, &fed),
            EventKind::Overheard { fed, began } => {
                // Where characters take no time, who begins at the same instant sends meanwhile.
                if !(self.fast() && self.seats[event.seat as usize].began(&fed) == Some(began)) {
                    self.deliver(event.seat, &fed);
                }
            }
            EventKind::Exposed { fed, number } => {
                let fed = self.exposed(event.seat, fed, number);
                self.deliver(event.seat, &fed);
            }
            EventKind::TcpSend { client, fed } => self.hear(event.seat, client, &fed),
            EventKind::Hand { pin, drive } => self.hand(event.seat, pin, drive),
            EventKind::Wired { wire, level } => self.wired(wire, level),
            EventKind::Contacts => self.find_contacts(event.seat),
            EventKind::Pulse { pin, number } => self.pulse_edge(event.seat, pin, number),
            EventKind::Encoder { encoder, number } => self.encoder_edge(event.seat, encoder, number),
            EventKind::Wave { pin, number } => self.wave_edge(event.seat, pin, number),
            EventKind::Steps { axis, number } => self.axis_edge(event.seat, axis, number),
            EventKind::Motor { number } => self.motor_is_due(event.seat, number, event.key.class),
            EventKind::MotorReports { motor } => self.felt(motor),
            EventKind::Turn { bus } => self.turn_ends(bus, event.key.at),
        }
    }

    /// Feeds a device now, unless it cannot hear.
    fn deliver(&mut self, place: u32, fed: &InputRecord) {
        let now = self.now;
        if let InputRecord::Fault { fault, on } = *fed {
            self.hold(place, fault, on);
        }
        let seated = &mut self.seats[place as usize];
        if !seated.hears(now, fed) {
            return;
        }
        let comes = matches!(fed, InputRecord::Power(Power::On)) && !seated.body.powered;
        let reports = if comes { self.motors_report(place) } else { Vec::new() };
        let seated = &mut self.seats[place as usize];
        let mut tape = tape(&mut self.trace, &mut self.outbox, self.settings);
        // Only a preset can be refused, and it does not come this way.
        let _ = seated.feed(now, fed, &mut tape);
        if comes {
            for fed in seated.surroundings().into_iter().chain(reports) {
                let _ = seated.feed(now, &fed, &mut tape);
            }
            // They were accepted at the first power-on.
            let _ = seated.preset_again(now, &mut tape);
        }
        self.after(place);
    }

    /// Feeds a device as a trace says, at an instant that is not over. Several characters for a port
    /// where each has its time follow back to back.
    pub(crate) fn feed(&mut self, seat: DriveId, at: Instant, fed: &InputRecord) {
        if matches!(fed, InputRecord::Poke { .. }) && at > Instant::ZERO {
            self.run_until(at);
        } else if at > Instant::ZERO {
            self.run_until(at - Duration::TICK);
        }
        self.now = self.now.max(at);
        self.index();
        // At power-on a preset comes after the deadlines of its own drive; others are still told their contacts.
        if matches!(fed, InputRecord::Poke { .. }) {
            while self.at(seat).deadline() <= at {
                self.wake(self.ranks[seat.0 as usize], self.at(seat).deadline());
            }
        }
        let serial = |port| self.at(seat).serial(port).filter(|serial| !serial.silence);
        if let InputRecord::Bytes { port, ref bytes } = *fed
            && let Some(serial) = serial(port)
        {
            let character = self.takes(serial.line_at(at), 1);
            let single = |&byte| InputRecord::Bytes { port, bytes: vec![byte] };
            // Those of the same instant keep their place among what else happens at it.
            let count = if character == Duration::ZERO { bytes.len() } else { 1 };
            let (now, later) = bytes.split_at(count.min(bytes.len()));
            for (n, byte) in (1..).zip(later) {
                self.send_to(at + character * n, seat.0, single(byte));
            }
            for byte in now {
                self.feed_now(seat, at, &single(byte));
            }
            return;
        }
        self.feed_now(seat, at, fed);
    }

    fn feed_now(&mut self, seat: DriveId, at: Instant, fed: &InputRecord) {
        let mut tape = tape(&mut self.trace, &mut self.outbox, self.settings);
        // A preset that is refused does nothing, and is not recorded.
        let _ = self.seats[seat.0 as usize].feed(at, fed, &mut tape);
        self.after(seat.0);
    }
}

/// The place for the outputs of a device.
fn tape<'a>(trace: &'a mut Trace, outbox: &'a mut Outputs, settings: Settings) -> CallContext<'a> {
    CallContext { trace, outbox, fast: settings.line == LineMode::Fast }
}
