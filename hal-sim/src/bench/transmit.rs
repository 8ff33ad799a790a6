//! Speech: what is said on a line, and who hears it when.

use drivetwin_firmware::device::{Duration, Instant, Line, Port};
use drivetwin_protocol::modbus::ascii;

use super::events::EventKind;
use super::lines::judgement;
use super::{Bench, Bus, DriveId};
use crate::line::{LineState, Request, RxBurst, Sender};
use crate::record::capture::{Frame, Medium, Source};
use crate::record::trace::InputRecord;
use crate::scheduler::Phase;
use crate::slot::Sent;

/// Origin of characters on a line.
#[derive(Clone, Copy)]
pub(super) enum Origin {
    /// A client, or nobody.
    Client(Sender),
    /// A drive, on its line, beginning then.
    Drive(Line, Instant),
}

impl Origin {
    /// The settings in which it reaches a port that is on `line`.
    pub(super) fn spoken(self, line: Line) -> Line {
        match self {
            Self::Client(sender) => Line { baud: sender.baud.unwrap_or(line.baud), ..line },
            Self::Drive(own, _) => own,
        }
    }

    /// Returns whether a port on `line` can read it.
    fn fits(self, line: Line) -> bool {
        match self {
            Self::Client(sender) => sender.fits(line),
            Self::Drive(own, _) => own == line,
        }
    }

    /// On its way to a device.
    fn carries(self, fed: InputRecord) -> EventKind {
        match self {
            Self::Client(_) => EventKind::InputRecord(fed),
            Self::Drive(_, began) => EventKind::Overheard { fed, began },
        }
    }
}

/// Characters that follow each other.
#[derive(Clone, Copy)]
pub(super) struct TxBurst<'a> {
    pub(super) bytes: &'a [u8],
    /// Places of those in which a drive finds that they are wrong.
    pub(super) unreadable: &'a [usize],
    pub(super) voice: Origin,
    /// Their number where they may collide.
    pub(super) number: Option<u32>,
}

/// Times of a transmission.
struct TxTiming {
    /// The end of its last character.
    last: Instant,
    /// Time at which it is known that no more follows.
    judged: Instant,
}

/// Speech.
impl Bench {
    /// Puts a message, or noise, on a line from `start` on.
    pub(super) fn put(&mut self, bus: u32, start: Instant, request: &Request) {
        let &Request { client, order, count, ref text, ref refused, noise, .. } = request;
        let baud = self.buses[bus as usize].disturbance.faults().baud.filter(|_| !noise);
        let voice = Origin::Client(Sender { baud: baud.or(request.sender.baud), ..request.sender });
        let bytes = refused.as_ref().map_or(&text.bytes, |(_, instead)| instead);
        let line = voice.spoken(self.line(Bus(bus)));
        let number = self.on_air(bus, start, line, bytes.len());
        let words = TxBurst { bytes, unreadable: &text.unreadable, voice, number };
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
        let free = wire.turn == LineState::Free;
        // What follows a character is looked for when it has ended.
        let mut until = if framed { judged } else { last };
        if let Some(air) = &mut wire.air {
            air.spoke.push(client);
            // What it speaks into may last longer.
            if !free && wire.until < Instant::NEVER {
                until = until.max(wire.until);
            }
        }
        (wire.served, wire.said) = (client, order);
        self.set_turn(bus, LineState::Asked);
        self.turn_until(bus, until);
    }

    /// Times at which so many characters, sent to a port from `start` on, are received.
    fn times(&self, seat: DriveId, port: Port, start: Instant, count: usize, voice: Origin) -> TxTiming {
        let Some(serial) = self.at(seat).serial(port) else { return TxTiming { last: start, judged: start } };
        if self.fast() {
            let at = self.at(seat).free(start, Phase::Line);
            return TxTiming { last: at, judged: at };
        }
        let line = serial.line_at(start);
        let character = voice.spoken(line).character();
        let last = self.first_ends(start, character) + character * count.saturating_sub(1) as u64;
        TxTiming { last, judged: last + judgement(line) }
    }

    /// End of a character that begins at `start`, or as soon as it still can: a line may have been free for a part of a
    /// character by now.
    fn first_ends(&self, start: Instant, character: Duration) -> Instant {
        (start + character).max(self.now + Duration::TICK)
    }

    /// Says something to a port from `start` on.
    fn say(&mut self, seat: DriveId, port: Port, start: Instant, words: TxBurst<'_>) {
        let TxBurst { bytes, unreadable, voice, number } = words;
        let Some(serial) = self.at(seat).serial(port).filter(|_| !bytes.is_empty()) else { return };
        let line = serial.line_at(start);
        let (framed, fit, ascii) = (serial.silence, voice.fits(line), ascii::is_on(line));
        // Characters that nobody can read come one by one, as do those that have their time, and those that may
        // collide. In ASCII what comes together ends at latest with a line feed.
        let whole = framed && fit && unreadable.is_empty() && number.is_none();
        let pieces = bytes.split_inclusive(|&byte| !whole || (ascii && byte == b'\n'));
        let message = |place: usize, piece: &[u8]| {
            let readable = fit && !unreadable.contains(&place);
            let fed = if readable {
                InputRecord::Bytes { port, bytes: piece.to_vec() }
            } else {
                InputRecord::RxError { port }
            };
            match number {
                Some(number) => EventKind::Exposed { fed, number },
                None => voice.carries(fed),
            }
        };
        if self.fast() {
            let at = self.at(seat).free(start, Phase::Line);
            let over = || voice.carries(InputRecord::Idle { port });
            for (place, piece) in pieces.enumerate() {
                self.schedule(at, Phase::Line, seat.0, message(place, piece));
                if whole {
                    self.schedule(at, Phase::Line, seat.0, over());
                }
            }
            if framed && !whole {
                self.schedule(at, Phase::Line, seat.0, over());
            }
            return;
        }
        let character = voice.spoken(line).character();
        let mut end = self.first_ends(start, character);
        for (place, piece) in pieces.enumerate() {
            self.schedule(end, Phase::Line, seat.0, message(place, piece));
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
        let mut messages = outbox.messages.as_slice();
        for said in &outbox.said {
            let (message, rest) = messages.split_at(said.count.unwrap_or(0));
            self.carry_said(said, message);
            messages = rest;
        }
        for (seat, moved) in &outbox.moved {
            self.carry_moved(*seat, moved);
        }
        outbox.clear();
        self.outbox = outbox;
    }

    /// Carries what a drive sends to all who listen; nobody hears himself.
    fn carry(&mut self, sent: &Sent, bytes: &[u8]) {
        let Some(Bus(bus)) = self.bus(DriveId(sent.seat), sent.port) else { return };
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

    /// Time that so many characters take.
    pub(super) fn takes(&self, line: Line, count: usize) -> Duration {
        if self.fast() { Duration::ZERO } else { line.character() * count as u64 }
    }

    /// Sends characters of a drive to all others on the line, from `start` on; `outside` is what clients make of it.
    pub(super) fn reach(
        &mut self,
        bus: u32,
        start: Instant,
        sent: &Sent,
        (bytes, unreadable): (&[u8], &[usize]),
        outside: (Line, &[u8]),
    ) {
        let number = self.on_air(bus, start, sent.line, bytes.len());
        self.reach_clients(bus, start, outside.0, outside.1, number, Some(DriveId(sent.seat)));
        let voice = Origin::Drive(sent.line, sent.start);
        let words = TxBurst { bytes, unreadable, voice, number };
        self.reach_drives(bus, start, sent.line, words, Some((DriveId(sent.seat), sent.port)));
        self.record(bus, start, sent.line, Source::Drive(DriveId(sent.seat)), bytes, number);
    }

    /// Characters reach all clients, from `start` on; `from` is the drive that says them, if one does. What it answers
    /// to somebody who has left does not reach those who have come since that was asked: one of them may have taken
    /// over the port.
    pub(super) fn reach_clients(
        &mut self,
        bus: u32,
        start: Instant,
        line: Line,
        bytes: &[u8],
        number: Option<u32>,
        from: Option<DriveId>,
    ) {
        let told = RxBurst { start, character: self.takes(line, 1), bytes, from };
        let wire = &self.buses[bus as usize];
        let air = wire.air.as_ref().zip(number);
        let asker_left = self.clients.get(&wire.served).is_none_or(|asker| asker.left);
        let is_framed = self.framed(bus).is_some();
        let has_left = from.is_some() && is_framed && asker_left;
        for &id in &wire.clients {
            if has_left && self.clients.came_after(id, wire.said) {
                continue;
            }
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
        words: TxBurst<'_>,
        sender: Option<(DriveId, Port)>,
    ) {
        let start = match (self.fast(), self.buses[bus as usize].turn) {
            (false, _) => start,
            // What nobody asked for takes its time: two drives with one address may answer each
            // other's answers for ever, and must not do so every tick.
            (true, LineState::Free) => start + line.character() * words.bytes.len() as u64,
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
            on: Medium::Line(Bus(bus)),
            from,
            line: Some(line),
            bytes: bytes.to_vec(),
            collided: air.is_some_and(|(air, number)| air.met(number).next().is_some()),
        });
    }

    /// Power is gone: what a device was still sending was never sent.
    pub(super) fn hush(&mut self, place: u32) {
        let now = self.now;
        for port in (0..self.spec(DriveId(place)).ports.len() as u8).map(Port) {
            let Some(serial) = self.at_mut(DriveId(place)).body.serial(port) else { continue };
            if serial.sends_until <= now {
                continue;
            }
            serial.sends_until = now;
            let Some(Bus(bus)) = self.bus(DriveId(place), port) else { continue };
            let serials = self.ports(Bus(bus)).iter().filter_map(|&(seat, port)| self.at(seat).serial(port));
            let sends_until = serials.map(|serial| serial.sends_until).max().unwrap_or(now);
            let wire = &mut self.buses[bus as usize];
            // What was held up still comes, and what is no drive's.
            let delay = wire.disturbance.faults().delay;
            let until = now + delay;
            wire.sends_until = (sends_until + delay).max(wire.held_up);
            self.capture.cut(Bus(bus), DriveId(place), until);
            for &id in &wire.clients {
                self.clients.hush(id, DriveId(place), until);
            }
        }
    }
}
