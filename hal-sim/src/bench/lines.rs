//! Lines: clients, whose turn it is, and what is heard when.

use standin_firmware::device::{Duration, Instant, Line, Port};
use standin_protocol::line::Parity;
use standin_protocol::modbus::ascii;
use standin_protocol::modbus::rtu::Timing;

use super::{Bench, Bus, Client, Seat};
use crate::bus::{LineMode, Mark, Offer, Outside, Request, Sender, Told, Turn, Wire};
use crate::capture::{Frame, Source};
use crate::faults::Text;
use crate::schedule::{Class, What};
use crate::seat::Sent;
use crate::trace::{self, Fed};

/// How far a drive's output may lie ahead before a client has to wait.
const AHEAD: Duration = Duration::secs(1);

/// The silence that ends a message on a line of Modbus: in ASCII none, because a line feed does.
pub(super) fn silence_after(line: Line) -> Duration {
    if ascii::is_on(line) { Duration::ZERO } else { Timing::of(line).t3_5 }
}

/// How long after its last character a drive on a line knows that a message is over.
fn judgement(line: Line) -> Duration {
    if ascii::is_on(line) { Duration::ZERO } else { silence_after(line) + line.character() }
}

/// Who says something.
#[derive(Clone, Copy)]
pub(super) enum Voice {
    /// A client, or nobody.
    Client(Sender),
    /// A drive, on its line, beginning then.
    Drive(Line, Instant),
}

impl Voice {
    /// The settings in which it reaches a port that is on `line`.
    pub(super) fn spoken(self, line: Line) -> Line {
        match self {
            Self::Client(sender) => Line { baud: sender.baud.unwrap_or(line.baud), ..line },
            Self::Drive(own, _) => own,
        }
    }

    /// Whether a port on `line` can read it.
    fn fits(self, line: Line) -> bool {
        match self {
            Self::Client(sender) => sender.fits(line),
            Self::Drive(own, _) => own == line,
        }
    }

    /// On its way to a device.
    fn carries(self, fed: Fed) -> What {
        match self {
            Self::Client(_) => What::Fed(fed),
            Self::Drive(_, began) => What::Overheard { fed, began },
        }
    }
}

/// Characters that follow each other.
#[derive(Clone, Copy)]
pub(super) struct Words<'a> {
    pub(super) bytes: &'a [u8],
    /// Places of those in which a drive finds that they are wrong.
    pub(super) unreadable: &'a [usize],
    pub(super) voice: Voice,
    /// Their number where they may collide.
    pub(super) number: Option<u32>,
}

/// When something said is heard.
struct Said {
    /// The end of its last character.
    last: Instant,
    /// When it is known that no more follows.
    judged: Instant,
}

/// Lines.
impl Bench {
    /// Puts several serial ports on one line. Clients connect after it.
    ///
    /// # Panics
    /// If the name is no name, or taken.
    pub fn share(&mut self, name: &str, ports: &[(Seat, Port)]) -> Bus {
        assert!(trace::is_name(name), "\"{name}\" is no name for a line: use one word without dots");
        assert!(!self.is_taken(name), "there are two things called {name}");
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
        self.buses.push(Wire::shared(self.settings.seed, name, shared));
        Bus(bus as u32)
    }

    /// The line of a serial port; `None` for any other port.
    #[must_use]
    pub fn bus(&self, seat: Seat, port: Port) -> Option<Bus> {
        self.at(seat).bus(port).map(Bus)
    }

    /// The name of a line: as given to [`share`](Self::share); of a line that a drive has for itself that of its
    /// port, or where drives are several those of both, `reader.usb`.
    #[must_use]
    pub fn bus_name(&self, bus: Bus) -> &str {
        let wire = &self.buses[bus.0 as usize];
        wire.port.filter(|_| self.seats.len() == 1).unwrap_or(&wire.name)
    }

    /// The ports on a line, by the names of their seats.
    #[must_use]
    pub fn ports(&self, bus: Bus) -> &[(Seat, Port)] {
        &self.buses[bus.0 as usize].ports
    }

    /// All lines with a drive on them, by the names of their first drives and ports.
    #[must_use]
    pub fn buses(&self) -> Vec<Bus> {
        let lines = (0..self.buses.len() as u32).map(Bus);
        let mut lines: Vec<Bus> = lines.filter(|&bus| !self.ports(bus).is_empty()).collect();
        lines.sort_by_key(|&bus| self.ports(bus).first().map(|&(seat, port)| (self.name(seat), port)));
        lines
    }

    /// The line of that name. A line that a drive has for itself may also be called by the name of its port
    /// alone, if no other line can.
    #[must_use]
    pub fn find_bus(&self, name: &str) -> Option<Bus> {
        let lines = self.buses();
        let wire = |bus: &Bus| &self.buses[bus.0 as usize];
        let called = lines.iter().find(|bus| wire(bus).name == name);
        let mut alike = lines.iter().filter(|bus| wire(bus).port == Some(name));
        called.or_else(|| alike.next().filter(|_| alike.next().is_none())).copied()
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
        let Some(outside) = self.clients.leave(client.0) else { return };
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
        let bus = outside.bus;
        outside.sender = sender;
        if self.framed(bus).is_some() {
            self.queue(client, bytes, Mark::default());
        } else {
            self.queue_disturbed(client, bytes);
        }
        self.serve(bus);
    }

    /// Bytes of a client wait for the line.
    pub(super) fn queue(&mut self, client: Client, bytes: &[u8], mark: Mark) {
        if let Some(outside) = self.clients.get_mut(&client.0) {
            self.arrivals += 1;
            outside.arrive(self.now, self.arrivals, bytes, mark);
        }
    }

    /// Bytes of a client that are not on the line yet. A host that reads only while this is small
    /// holds back who sends faster than the line.
    #[must_use]
    pub fn backlog(&self, client: Client) -> usize {
        self.clients.get(&client.0).map_or(0, Outside::backlog)
    }

    /// Appends the characters that have reached a client by now; returns how many.
    pub fn receive(&mut self, client: Client, into: &mut Vec<u8>) -> usize {
        self.clients.receive(client.0, self.now, into)
    }

    /// The clients that can read something now.
    pub fn audible(&self) -> impl Iterator<Item = Client> {
        self.clients.audible(self.now).map(Client)
    }

    /// A client's port gives characters their time itself, as a real serial port does: what a drive says
    /// reaches it whole, as the first character begins.
    pub fn let_pace_itself(&mut self, client: Client) {
        if let Some(outside) = self.clients.get_mut(&client.0) {
            outside.paces_itself = true;
        }
    }

    /// Whether a line is nobody's now. Half a message may wait for its rest there.
    #[must_use]
    pub fn is_free(&self, bus: Bus) -> bool {
        self.buses[bus.0 as usize].turn == Turn::Free
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

    pub(super) fn fast(&self) -> bool {
        self.settings.line == LineMode::Fast
    }

    /// The settings of a line of Modbus, on which messages go whole; `None` where each character has its time.
    pub(super) fn framed(&self, bus: u32) -> Option<Line> {
        let &(seat, port) = self.ports(Bus(bus)).first()?;
        let serial = self.at(seat).serial(port).filter(|serial| serial.silence)?;
        Some(serial.line_at(self.now))
    }

    /// The settings of all drives on a line now.
    fn lines(&self, bus: u32) -> impl Iterator<Item = Line> {
        self.ports(Bus(bus)).iter().filter_map(|&(seat, port)| self.at(seat).line_at(port, self.now))
    }

    /// Gives a free line to whose bytes came first. Where each character has its time a client also goes on
    /// while it has the line, with one character behind the other.
    fn serve(&mut self, bus: u32) {
        let framed = self.framed(bus);
        loop {
            let wire = &mut self.buses[bus as usize];
            let waiting = wire.clients.iter().filter_map(|&id| Some((self.clients.get(&id)?.order()?, id)));
            let first = waiting.min().map(|(_, id)| id);
            let goes_on = framed.is_none() && first == Some(wire.served) && wire.free <= self.now;
            if wire.turn != Turn::Free && !goes_on {
                return self.speak_into(bus);
            }
            let Some(id) = first else {
                if wire.turn == Turn::Free {
                    wire.until = Instant::NEVER;
                }
                return;
            };
            if framed.is_none() && self.holds_back(bus, id) {
                return;
            }
            let Some(outside) = self.clients.get_mut(&id) else { return };
            match outside.offer(self.now, framed, self.settings.patience) {
                Offer::Message(length, came) => {
                    self.transmit(bus, id, length, came);
                    if framed.is_none() {
                        return;
                    }
                }
                Offer::Half(_) if outside.left => {
                    // The line was its own until it left.
                    let wire = &mut self.buses[bus as usize];
                    wire.free = wire.free.max(self.now);
                    self.forget(id);
                }
                Offer::Half(until) => {
                    self.turn_until(bus, until);
                    return self.speak_into(bus);
                }
            }
        }
    }

    /// Holds a client back while a drive has more than that to say. Answers are longer than commands, so a
    /// client that does not wait for them would make an endless queue. Whether it does; the turn waits with it.
    fn holds_back(&mut self, bus: u32, client: u32) -> bool {
        let wire = &mut self.buses[bus as usize];
        let ahead = AHEAD + wire.disturbance.faults().delay;
        if wire.sends_until <= self.now + ahead {
            return false;
        }
        let until = wire.sends_until - ahead;
        self.busy += usize::from(wire.turn == Turn::Free);
        (wire.turn, wire.served) = (Turn::Asked, client);
        self.turn_until(bus, until);
        true
    }

    /// A client is gone for good.
    fn forget(&mut self, id: u32) {
        if let Some(outside) = self.clients.remove(&id) {
            self.buses[outside.bus as usize].clients.retain(|&other| other != id);
        }
    }

    /// Puts the first `length` bytes of a client on a line, as if sent without gaps from when they came, or from
    /// when the line is free.
    pub(super) fn transmit(&mut self, bus: u32, client: u32, length: usize, came: Instant) {
        let Some(outside) = self.clients.get_mut(&client) else { return };
        let (mark, bytes, sender) = (outside.mark(), outside.take(length), outside.sender);
        if outside.left && outside.backlog() == 0 {
            self.forget(client);
        }
        let unreadable = if mark.unreadable { vec![0] } else { Vec::new() };
        let text = Text { bytes, unreadable };
        let request = Request { client, sender, count: length, text, refused: None, noise: mark.noise };
        let wire = &self.buses[bus as usize];
        let start = came.max(match &wire.air {
            // It speaks into what others say.
            Some(air) if wire.turn != Turn::Free => air.free.max(self.now),
            _ => wire.free,
        });
        let request = if self.framed(bus).is_some() { self.disturbed_request(bus, request) } else { request };
        self.put(bus, start, &request);
    }

    /// Puts a message, or noise, on a line from `start` on.
    pub(super) fn put(&mut self, bus: u32, start: Instant, request: &Request) {
        let &Request { client, count, ref text, ref refused, noise, .. } = request;
        let baud = self.buses[bus as usize].disturbance.faults().baud.filter(|_| !noise);
        let voice = Voice::Client(Sender { baud: baud.or(request.sender.baud), ..request.sender });
        let bytes = refused.as_ref().map_or(&text.bytes, |(_, instead)| instead);
        let line = voice.spoken(self.line(Bus(bus)));
        let number = self.on_air(bus, start, line, bytes.len());
        let words = Words { bytes, unreadable: &text.unreadable, voice, number };
        let (mut last, mut judged) = (start, start);
        for n in 0..self.ports(Bus(bus)).len() {
            let (seat, port) = self.ports(Bus(bus))[n];
            let said = self.times(seat, port, start, count, voice);
            self.say(seat, port, start, words);
            (last, judged) = (last.max(said.last), judged.max(said.judged));
        }
        let framed = self.framed(bus).is_some();
        if noise && framed {
            self.reach_clients(bus, start, line, &text.bytes, number, None);
        }
        let source = if noise { Source::Noise } else { Source::Client };
        self.record(bus, start, line, source, &text.bytes, number);
        let wire = &mut self.buses[bus as usize];
        wire.refusal = refused.as_ref().map(|&(refusal, _)| refusal).or(wire.refusal);
        wire.free = wire.free.max(last);
        let free = wire.turn == Turn::Free;
        self.busy += usize::from(free);
        // What follows a character is looked for when it has ended.
        let mut until = if framed { judged } else { last };
        if let Some(air) = &mut wire.air {
            air.spoke.push(client);
            // What it speaks into may last longer.
            if !free && wire.until < Instant::NEVER {
                until = until.max(wire.until);
            }
        }
        (wire.turn, wire.served) = (Turn::Asked, client);
        self.turn_until(bus, until);
    }

    /// When so many characters, said to a port from `start` on, are heard.
    fn times(&self, seat: Seat, port: Port, start: Instant, count: usize, voice: Voice) -> Said {
        let Some(serial) = self.at(seat).serial(port) else { return Said { last: start, judged: start } };
        if self.fast() {
            let at = self.at(seat).free(start, Class::Line);
            return Said { last: at, judged: at };
        }
        let line = serial.line_at(start);
        let character = voice.spoken(line).character();
        let last = self.first_ends(start, character) + character * count.saturating_sub(1) as u64;
        Said { last, judged: last + judgement(line) }
    }

    /// When a character ends that begins at `start`, or as soon as it still can: a line may have been free for a
    /// part of a character by now.
    fn first_ends(&self, start: Instant, character: Duration) -> Instant {
        (start + character).max(self.now + Duration::TICK)
    }

    /// Says something to a port from `start` on.
    fn say(&mut self, seat: Seat, port: Port, start: Instant, words: Words<'_>) {
        let Words { bytes, unreadable, voice, number } = words;
        let Some(serial) = self.at(seat).serial(port).filter(|_| !bytes.is_empty()) else { return };
        let line = serial.line_at(start);
        let (framed, fit, ascii) = (serial.silence, voice.fits(line), ascii::is_on(line));
        // Characters that nobody can read come one by one, as do those that have their time, and those that may
        // collide. In ASCII what comes together ends at latest with a line feed.
        let whole = framed && fit && unreadable.is_empty() && number.is_none();
        let pieces = bytes.split_inclusive(|&byte| !whole || (ascii && byte == b'\n'));
        let message = |place: usize, piece: &[u8]| {
            let readable = fit && !unreadable.contains(&place);
            let fed =
                if readable { Fed::Bytes { port, bytes: piece.to_vec() } } else { Fed::Spoiled { port } };
            match number {
                Some(number) => What::Exposed { fed, number },
                None => voice.carries(fed),
            }
        };
        if self.fast() {
            let at = self.at(seat).free(start, Class::Line);
            let over = || voice.carries(Fed::Idle { port });
            for (place, piece) in pieces.enumerate() {
                self.schedule(at, Class::Line, seat.0, message(place, piece));
                if whole {
                    self.schedule(at, Class::Line, seat.0, over());
                }
            }
            if framed && !whole {
                self.schedule(at, Class::Line, seat.0, over());
            }
            return;
        }
        let character = voice.spoken(line).character();
        let mut end = self.first_ends(start, character);
        for (place, piece) in pieces.enumerate() {
            self.schedule(end, Class::Line, seat.0, message(place, piece));
            end += character * piece.len() as u64;
        }
    }

    /// Carries what the device called last has sent.
    pub(super) fn carry_all(&mut self) {
        if self.outbox.is_empty() {
            return;
        }
        let mut outbox = std::mem::take(&mut self.outbox);
        let mut bytes = outbox.bytes.as_slice();
        for sent in &outbox.sent {
            let (message, rest) = bytes.split_at(sent.count);
            self.carry(sent, message);
            bytes = rest;
        }
        for (seat, moved) in &outbox.moved {
            self.carry_moved(*seat, moved);
        }
        outbox.clear();
        self.outbox = outbox;
    }

    /// Carries what a drive sends to all who listen; nobody hears himself.
    fn carry(&mut self, sent: &Sent, bytes: &[u8]) {
        let Some(Bus(bus)) = self.bus(Seat(sent.seat), sent.port) else { return };
        let wire = &mut self.buses[bus as usize];
        let start = sent.start.max(wire.held_up);
        match wire.disturbance.reply() {
            None if wire.refusal.is_none() => {
                let end = start + self.takes(sent.line, bytes.len());
                let wire = &mut self.buses[bus as usize];
                wire.sends_until = wire.sends_until.max(end);
                self.reach(bus, start, sent, (bytes, &[]), (sent.line, bytes));
            }
            fate => self.carry_disturbed(bus, sent, bytes, &fate.unwrap_or_default()),
        }
    }

    /// How long so many characters take.
    pub(super) fn takes(&self, line: Line, count: usize) -> Duration {
        if self.fast() { Duration::ZERO } else { line.character() * count as u64 }
    }

    /// What a drive has sent reaches all who listen, from `start` on; `outside` is what clients make of it.
    pub(super) fn reach(
        &mut self,
        bus: u32,
        start: Instant,
        sent: &Sent,
        (bytes, unreadable): (&[u8], &[usize]),
        outside: (Line, &[u8]),
    ) {
        let number = self.on_air(bus, start, sent.line, bytes.len());
        self.reach_clients(bus, start, outside.0, outside.1, number, Some(Seat(sent.seat)));
        let voice = Voice::Drive(sent.line, sent.start);
        let words = Words { bytes, unreadable, voice, number };
        self.reach_drives(bus, start, sent.line, words, Some((Seat(sent.seat), sent.port)));
        self.record(bus, start, sent.line, Source::Drive(Seat(sent.seat)), bytes, number);
    }

    /// Characters reach all clients, from `start` on; `from` is the drive that says them, if one does.
    pub(super) fn reach_clients(
        &mut self,
        bus: u32,
        start: Instant,
        line: Line,
        bytes: &[u8],
        number: Option<u32>,
        from: Option<Seat>,
    ) {
        let told = Told { start, character: self.takes(line, 1), bytes, from };
        let wire = &self.buses[bus as usize];
        let air = wire.air.as_ref().zip(number);
        for &id in &wire.clients {
            self.clients.hear(id, told, |end, byte| {
                let (air, _) = air.filter(|(air, number)| air.spoils(*number, end))?;
                Some(air.garbage(line, end, byte))
            });
        }
    }

    /// Characters reach all drives but the one that has sent them, from `start` on.
    pub(super) fn reach_drives(
        &mut self,
        bus: u32,
        start: Instant,
        line: Line,
        words: Words<'_>,
        sender: Option<(Seat, Port)>,
    ) {
        let start = match (self.fast(), self.buses[bus as usize].turn) {
            (false, _) => start,
            // What nobody asked for takes its time: two drives with one address may answer each
            // other's answers for ever, and must not do so every tick.
            (true, Turn::Free) => start + line.character() * words.bytes.len() as u64,
            (true, _) => start + Duration::TICK,
        };
        for n in 0..self.ports(Bus(bus)).len() {
            let (seat, port) = self.ports(Bus(bus))[n];
            if Some((seat, port)) != sender {
                self.say(seat, port, start, words);
            }
        }
    }

    /// Keeps what is on a line, if it is anything; `number` is its own where it may collide.
    pub(super) fn record(
        &mut self,
        bus: u32,
        at: Instant,
        line: Line,
        from: Source,
        bytes: &[u8],
        number: Option<u32>,
    ) {
        if bytes.is_empty() {
            return;
        }
        let lasts = self.takes(line, bytes.len());
        let air = self.buses[bus as usize].air.as_ref().zip(number);
        self.capture.record(|| Frame {
            at,
            lasts,
            bus: Bus(bus),
            from,
            line,
            bytes: bytes.to_vec(),
            collided: air.is_some_and(|(air, number)| air.met(number).next().is_some()),
        });
    }

    /// Power is gone: what a device was still sending was never sent.
    pub(super) fn hush(&mut self, place: u32) {
        let now = self.now;
        for port in (0..self.spec(Seat(place)).ports.len() as u8).map(Port) {
            let Some(serial) = self.at_mut(Seat(place)).body.serial(port) else { continue };
            if serial.sends_until <= now {
                continue;
            }
            serial.sends_until = now;
            let Some(Bus(bus)) = self.bus(Seat(place), port) else { continue };
            let serials = self.ports(Bus(bus)).iter().filter_map(|&(seat, port)| self.at(seat).serial(port));
            let sends_until = serials.map(|serial| serial.sends_until).max().unwrap_or(now);
            let wire = &mut self.buses[bus as usize];
            // What was held up still comes, and what is no drive's.
            let delay = wire.disturbance.faults().delay;
            let until = now + delay;
            wire.sends_until = (sends_until + delay).max(wire.held_up);
            self.capture.cut(Bus(bus), Seat(place), until);
            for &id in &wire.clients {
                self.clients.hush(id, Seat(place), until);
            }
        }
    }

    /// The present turn, or the patience with half a message, ends at `at`.
    pub(super) fn turn_until(&mut self, bus: u32, at: Instant) {
        self.buses[bus as usize].until = at;
        if let Some(&(seat, _)) = self.ports(Bus(bus)).first() {
            self.schedule(at, Class::Turn, seat.0, What::Turn { bus });
        }
    }

    /// A turn may be over: then the line is free, and goes to whoever waits.
    pub(super) fn turn_ends(&mut self, bus: u32, at: Instant) {
        let wire = &mut self.buses[bus as usize];
        if wire.until != at {
            return;
        }
        wire.until = Instant::NEVER;
        if wire.turn == Turn::Free {
            self.serve(bus);
        } else if self.framed(bus).is_some() {
            self.turn_ends_of_frames(bus, at);
        } else {
            self.turn_ends_of_characters(bus, at);
        }
    }

    /// Where silence ends a message: the turn lasts until all drives have judged that, and answered, and what
    /// follows it is over.
    fn turn_ends_of_frames(&mut self, bus: u32, at: Instant) {
        // Once: drives may answer each other's answers for ever.
        if self.buses[bus as usize].turn == Turn::Asked && self.answers(bus, at) {
            return;
        }
        let from = if self.fast() {
            at
        } else {
            let silence = self.lines(bus).map(silence_after).max().unwrap_or(Duration::ZERO);
            let wire = &self.buses[bus as usize];
            // A character that began no sooner ends a tick after the drives have judged the silence.
            (wire.free + Duration::TICK).max(wire.sends_until) + silence
        };
        match self.buses[bus as usize].behind.pop_front() {
            Some(request) => self.put(bus, self.heard_by_all(bus, from), &request),
            None => self.free(bus, from),
        }
    }

    /// Where each character has its time: the client goes on; or, held back, tries again; or it has said all.
    /// Then the turn is its own for as long as silence would take to end a message: programs write a command
    /// in pieces, and those of two clients must not mix.
    fn turn_ends_of_characters(&mut self, bus: u32, at: Instant) {
        let wire = &mut self.buses[bus as usize];
        let spoke = wire.turn == Turn::Asked && wire.free == at;
        let answered = wire.turn == Turn::Answering;
        wire.free = at;
        self.serve(bus);
        if self.buses[bus as usize].until != Instant::NEVER {
            return;
        }
        if spoke && !self.fast() {
            let quiet = self.lines(bus).map(judgement).max().unwrap_or(Duration::ZERO);
            return self.turn_until(bus, at + quiet);
        }
        // Once: streams never end, and both directions run at once.
        if answered || !self.answers(bus, at) {
            self.free(bus, at);
        }
    }

    /// Whether a drive still sends: then the turn lasts until that has left.
    fn answers(&mut self, bus: u32, at: Instant) -> bool {
        let wire = &mut self.buses[bus as usize];
        let until = wire.sends_until;
        let answers = until > at;
        if answers {
            wire.turn = Turn::Answering;
            self.turn_until(bus, until);
        }
        answers
    }

    /// When all drives have heard what was said until then: where characters take no time the others hear an
    /// answer a tick later.
    fn heard_by_all(&self, bus: u32, at: Instant) -> Instant {
        let waits = self.fast() && self.ports(Bus(bus)).len() > 1;
        if waits { at + Duration::TICK } else { at }
    }

    /// A turn is over: the line is free from then on, and goes to whoever waits.
    fn free(&mut self, bus: u32, from: Instant) {
        let from = self.heard_by_all(bus, from);
        let wire = &mut self.buses[bus as usize];
        (wire.turn, wire.free, wire.refusal) = (Turn::Free, from, None);
        if let Some(air) = &mut wire.air {
            air.spoke.clear();
            air.free = from;
        }
        self.busy -= 1;
        self.serve(bus);
    }
}
