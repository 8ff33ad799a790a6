//! Transmission: characters on a line, and the times at which each receiver gets them.

use std::sync::Arc;

use drivetwin_firmware::device::{Duration, Framing, Instant, Line, Port};
use drivetwin_protocol::modbus::ascii;

use super::events::{EventKind, Heard};
use super::lines::end_detection_time;
use super::tcp_faults::ends_line;
use super::{Bench, Bus, DriveId};
use crate::decode::Message;
use crate::line::collisions::Transmitter;
use crate::line::{LineState, Request, RxBurst, Sender};
use crate::record::capture::{Frame, Medium, Source};
use crate::record::effects::FrameEffects;
use crate::record::trace::InputRecord;
use crate::scheduler::Phase;
use crate::slot::{Sent, TcpSend};

/// Origin of characters on a line.
#[derive(Clone, Copy)]
pub(super) enum Origin {
    /// A client, or noise.
    Client(Sender),
    /// A drive: its serial settings, and the start of its transmission.
    Drive(Line, Instant),
}

impl Origin {
    /// Serial settings of the characters at a port with the settings `line`.
    pub(super) fn settings_on(self, line: Line) -> Line {
        match self {
            Self::Client(sender) => sender.or(line),
            Self::Drive(own, _) => own,
        }
    }

    /// Returns true if a port with the settings `line` can read the characters.
    fn fits(self, line: Line) -> bool {
        match self {
            Self::Client(sender) => sender.fits(line),
            Self::Drive(own, _) => own == line,
        }
    }

    /// Time at which a drive began to send the characters.
    fn began(self) -> Option<Instant> {
        match self {
            Self::Client(_) => None,
            Self::Drive(_, began) => Some(began),
        }
    }

    /// Event that delivers an input to a drive.
    fn carries(self, input: InputRecord) -> EventKind {
        match self {
            Self::Client(_) => EventKind::Input(input),
            Self::Drive(_, began) => EventKind::Overheard { input, began },
        }
    }
}

/// Receivers of a drive's characters.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum HeardBy {
    /// All clients, and the other drives on the line.
    All,
    /// All clients. No drive has sent the characters: they are the answer or the repetition of a fault.
    Clients,
}

/// Characters that are sent back to back.
#[derive(Clone, Copy)]
pub(super) struct TxBurst<'a> {
    pub(super) bytes: &'a [u8],
    /// Indices of characters with a parity or framing error.
    pub(super) unreadable: &'a [usize],
    pub(super) origin: Origin,
    /// Number of the transmission, if characters may collide.
    pub(super) number: Option<u32>,
}

/// Times of a transmission.
struct TxTiming {
    /// End of the last character.
    last: Instant,
    /// Time at which receivers detect that the transmission is over.
    detected: Instant,
    /// True if the receiver can read the characters.
    fits: bool,
}

/// Transmission on lines.
impl Bench {
    /// Transmits a request or noise on a line from `start` on.
    pub(super) fn transmit_request(&mut self, bus: u32, start: Instant, request: &Request) {
        let &Request { client, order, count, ref text, ref refusal, noise, .. } = request;
        let baud = self.buses[bus as usize].disturbance.faults().baud.filter(|_| !noise);
        let origin = Origin::Client(Sender { baud: baud.or(request.sender.baud), ..request.sender });
        let line = origin.settings_on(self.line(Bus(bus)));
        let by = if noise { Transmitter::Noise } else { Transmitter::Client };
        let number = self.occupy_line(bus, by, start, line, text.bytes.len());
        if let (false, Some(number)) = (noise, number)
            && let Some(collisions) = &mut self.buses[bus as usize].collisions
        {
            collisions.add_request(number, &text.bytes, request.effects);
        }
        let burst = TxBurst { bytes: &text.bytes, unreadable: &text.unreadable, origin, number };
        let (mut last, mut detected) = (start, start);
        let mut in_characters = number.is_some() || !text.unreadable.is_empty() || text.bytes.len() < 2;
        let at_once = refusal.is_none() && self.schedule_for_all(bus, start, burst, None);
        // All receivers of characters that arrive at once have the same settings.
        let receivers = if at_once { 1 } else { self.ports(Bus(bus)).len() };
        for n in 0..receivers {
            let (drive, port) = self.ports(Bus(bus))[n];
            let timing = self.times(drive, port, start, count, origin);
            match refusal {
                None if at_once => {}
                None => self.schedule_characters(drive, port, start, burst),
                Some(refusal) if (refusal.drive, refusal.port) == (drive, port) => {
                    let (refusal, request) = (refusal.clone(), text.bytes.clone());
                    let refused = EventKind::Refused { refusal, request, end: timing.last, number };
                    self.schedule(timing.detected, Phase::Line, drive.0, refused);
                }
                Some(_) => {}
            }
            (last, detected) = (last.max(timing.last), detected.max(timing.detected));
            in_characters |= !timing.fits;
        }
        let framed = self.framed(bus).is_some();
        if !framed {
            self.note_character(bus, &text.bytes, request.effects);
        }
        if noise && framed {
            self.deliver_to_clients(bus, start, line, &text.bytes, number, None);
        }
        let source = if noise { Source::Noise } else { Source::Client };
        self.record(bus, start, line, source, &text.bytes, number);
        let serial_line = &mut self.buses[bus as usize];
        serial_line.free = serial_line.free.max(last);
        let free = serial_line.turn == LineState::Free;
        // On a line with timed characters, the next character is sent after the end of this one.
        let mut until = if framed { detected } else { last };
        if let Some(collisions) = &mut serial_line.collisions {
            collisions.transmitted.push(client);
            // An overlapping transmission may last longer than this one.
            if !free && serial_line.until < Instant::NEVER {
                until = until.max(serial_line.until);
            }
        }
        (serial_line.served, serial_line.served_order) = (client, order);
        if framed {
            (serial_line.on_request, serial_line.on_early) = (request.effects, request.early);
            serial_line.in_characters |= in_characters;
        }
        self.set_turn(bus, LineState::Asked);
        self.turn_until(bus, until);
    }

    /// Notes the effects of faults on a character, for the journal's entry of the line of text that contains it. The
    /// characters on the serial line are timed.
    fn note_character(&mut self, bus: u32, character: &[u8], effects: FrameEffects) {
        let serial_line = &mut self.buses[bus as usize];
        let ends = ends_line(character);
        let begins = std::mem::replace(&mut serial_line.has_ended, ends) && !ends;
        let before = if begins { FrameEffects::NONE } else { serial_line.on_request };
        let effects = before.and(effects);
        serial_line.on_request = effects;
        for n in 0..self.ports(Bus(bus)).len() {
            let (drive, port) = self.ports(Bus(bus))[n];
            if let Some(port) = self.at_mut(drive).state.ports.get_mut(usize::from(port.0)) {
                port.on_request = effects;
            }
        }
    }

    /// Times at which `count` characters, sent to a port from `start` on, are received.
    fn times(&self, drive: DriveId, port: Port, start: Instant, count: usize, origin: Origin) -> TxTiming {
        let Some(serial) = self.at(drive).serial(port) else {
            return TxTiming { last: start, detected: start, fits: true };
        };
        let line = serial.line_at(start);
        let fits = origin.fits(line);
        if self.fast() {
            let at = self.at(drive).free(start, Phase::Line);
            return TxTiming { last: at, detected: at, fits };
        }
        let character = origin.settings_on(line).character();
        let last = self.first_ends(start, character) + character * count.saturating_sub(1) as u64;
        TxTiming { last, detected: last + end_detection_time(line), fits }
    }

    /// End of a character that begins at `start`, or one tick after now if that end is past: the line may
    /// have been free for a part of a character already.
    pub(super) fn first_ends(&self, start: Instant, character: Duration) -> Instant {
        (start + character).max(self.now + Duration::TICK)
    }

    /// Schedules characters for all ports of a line except one, as one event. Returns false if they do not
    /// receive them whole at the same instant; then nothing is scheduled.
    fn schedule_for_all(
        &mut self,
        bus: u32,
        start: Instant,
        burst: TxBurst<'_>,
        except: Option<(DriveId, Port)>,
    ) -> bool {
        #[cfg(test)]
        if self.one_by_one {
            return false;
        }
        let TxBurst { bytes, unreadable, origin, number } = burst;
        let ports = &self.buses[bus as usize].ports;
        let [first, others @ ..] = &**ports else { return false };
        if others.is_empty() || bytes.is_empty() || !unreadable.is_empty() || number.is_some() {
            return false;
        }
        let ends = self.fast();
        let state = |&(drive, port): &(DriveId, Port)| {
            let slot = self.at(drive);
            let serial = slot.serial(port).filter(|serial| serial.framed)?;
            Some((serial.line_at(start), if ends { slot.free(start, Phase::Line) } else { start }))
        };
        let Some((line, free)) = state(first) else { return false };
        let is_whole = origin.fits(line) && !ascii::is_on(line);
        if !is_whole || others.iter().any(|other| state(other) != Some((line, free))) {
            return false;
        }
        let at = if ends { free } else { self.first_ends(start, origin.settings_on(line).character()) };
        let mut heard = Heard::new(bytes.into(), Arc::clone(ports), except, origin.began(), ends);
        if let Some(drive) = heard.receiver() {
            self.schedule(at, Phase::Line, drive.0, EventKind::Heard(heard));
        }
        true
    }

    /// Schedules characters for a port from `start` on.
    fn schedule_characters(&mut self, drive: DriveId, port: Port, start: Instant, burst: TxBurst<'_>) {
        let TxBurst { bytes, unreadable, origin, number } = burst;
        let Some(serial) = self.at(drive).serial(port).filter(|_| !bytes.is_empty()) else { return };
        let line = serial.line_at(start);
        let (framed, fit, ascii) = (serial.framed, origin.fits(line), ascii::is_on(line));
        // Corrupt characters, timed characters and characters that may collide are delivered one by one. In
        // ASCII, a delivery ends at a line feed at the latest.
        let whole = framed && fit && unreadable.is_empty() && number.is_none();
        let pieces = bytes.split_inclusive(|&byte| !whole || (ascii && byte == b'\n'));
        let message = |index: usize, piece: &[u8]| {
            let readable = fit && !unreadable.contains(&index);
            let input = if readable {
                InputRecord::Bytes { port, bytes: piece.into() }
            } else {
                InputRecord::RxError { port }
            };
            match number {
                Some(number) => {
                    EventKind::MayCollide { input, number, overheard: matches!(origin, Origin::Drive(..)) }
                }
                None => origin.carries(input),
            }
        };
        if self.fast() {
            let at = self.at(drive).free(start, Phase::Line);
            let over = || origin.carries(InputRecord::Idle { port });
            for (index, piece) in pieces.enumerate() {
                self.schedule(at, Phase::Line, drive.0, message(index, piece));
                if whole {
                    self.schedule(at, Phase::Line, drive.0, over());
                }
            }
            if framed && !whole {
                self.schedule(at, Phase::Line, drive.0, over());
            }
            return;
        }
        let character = origin.settings_on(line).character();
        let mut end = self.first_ends(start, character);
        for (index, piece) in pieces.enumerate() {
            self.schedule(end, Phase::Line, drive.0, message(index, piece));
            end += character * piece.len() as u64;
        }
    }

    /// Routes the outputs of the drive that was called last. What one kind of them needs is taken out and put back, so
    /// that its memory is used again.
    pub(super) fn route_outputs(&mut self) {
        let answers = !self.outputs.sent.is_empty();
        if answers {
            self.route_sent();
        }
        if !self.outputs.tcp_sends.is_empty() {
            self.route_messages();
        }
        if !self.outputs.pin_changes.is_empty() {
            let mut changes = std::mem::take(&mut self.outputs.pin_changes);
            for (drive, change) in changes.drain(..) {
                self.schedule_pin_change(drive, &change);
            }
            self.outputs.pin_changes = changes;
        }
        for n in 0..self.outputs.claimed.len() {
            let (drive, port) = self.outputs.claimed[n];
            self.claim(drive, port, answers);
        }
        self.outputs.claimed.clear();
        if !self.outputs.unclaimed.is_empty() {
            let mut unclaimed = std::mem::take(&mut self.outputs.unclaimed);
            for (drive, entry) in unclaimed.drain(..) {
                self.enter_unclaimed(drive, entry);
            }
            self.outputs.unclaimed = unclaimed;
        }
    }

    /// Routes the characters on serial lines.
    fn route_sent(&mut self) {
        let (mut sent, mut bytes) =
            (std::mem::take(&mut self.outputs.sent), std::mem::take(&mut self.outputs.bytes));
        let mut rest = bytes.as_slice();
        for sent in &sent {
            let (message, others) = rest.split_at(sent.count);
            self.transmit_from_drive(sent, message, HeardBy::All);
            rest = others;
        }
        sent.clear();
        bytes.clear();
        (self.outputs.sent, self.outputs.bytes) = (sent, bytes);
    }

    /// Routes the messages on TCP connections.
    fn route_messages(&mut self) {
        let (mut sends, mut bytes) =
            (std::mem::take(&mut self.outputs.tcp_sends), std::mem::take(&mut self.outputs.messages));
        let mut rest = bytes.as_slice();
        for sends in sends.chunk_by(TcpSend::is_continued_by) {
            let Some(send) = sends.first() else { continue };
            let count = sends.iter().filter_map(|send| send.count).sum();
            let (message, others) = rest.split_at(count);
            self.receive_from_drive(send, message);
            rest = others;
        }
        sends.clear();
        bytes.clear();
        (self.outputs.tcp_sends, self.outputs.messages) = (sends, bytes);
    }

    /// Transmits the characters of a drive on its line.
    pub(super) fn transmit_from_drive(&mut self, sent: &Sent, bytes: &[u8], heard_by: HeardBy) {
        let Some(Bus(bus)) = self.bus(DriveId(sent.drive), sent.port) else { return };
        let content = self.reply_content(bus, sent, bytes);
        let serial_line = &mut self.buses[bus as usize];
        let start = sent.start.max(serial_line.held_up);
        match serial_line.disturbance.reply(bytes.len(), content.as_ref()) {
            None => {
                let end = start + self.takes(sent.line, bytes.len());
                let serial_line = &mut self.buses[bus as usize];
                serial_line.sends_until = serial_line.sends_until.max(end);
                serial_line.requests.answer();
                serial_line.late_by = start.since(sent.start);
                let all = (sent.line, bytes);
                self.deliver_from_drive(bus, start, (sent, heard_by), (bytes, &[]), all);
            }
            Some(fate) => {
                self.note_reply(DriveId(sent.drive), sent.port, bytes, fate.effects());
                self.transmit_with_faults(bus, (sent, heard_by), bytes, &fate);
            }
        }
    }

    /// Time that `count` characters take.
    pub(super) fn takes(&self, line: Line, count: usize) -> Duration {
        if self.fast() { Duration::ZERO } else { line.character() * count as u64 }
    }

    /// Delivers characters of a drive on its line: to the clients from `start` on, and to the other drives, if they
    /// hear them, when the drive sends them. A fault delays a reply between the line and the clients, so that drives
    /// with one address answer at the same time and do not hear each other. `to_clients` contains the settings and
    /// characters for clients.
    pub(super) fn deliver_from_drive(
        &mut self,
        bus: u32,
        start: Instant,
        (sent, heard_by): (&Sent, HeardBy),
        (bytes, unreadable): (&[u8], &[usize]),
        to_clients: (Line, &[u8]),
    ) {
        let requests = &mut self.buses[bus as usize].requests;
        // Faults may have changed the answer.
        if !requests.is_answered() && requests.address() == to_clients.1.get(..1) && unreadable.is_empty() {
            let ascii = ascii::is_on(sent.line);
            let answer = Message { framing: Framing::Silence, ascii, bytes: to_clients.1 };
            if answer.is_whole() {
                requests.answer();
            }
        }
        let by = Transmitter::Drive(DriveId(sent.drive), sent.port);
        let number = self.occupy_line(bus, by, start, sent.line, bytes.len());
        self.deliver_to_clients(bus, start, to_clients.0, to_clients.1, number, Some(DriveId(sent.drive)));
        let origin = Origin::Drive(sent.line, sent.start);
        if heard_by == HeardBy::All {
            // The number is that of the characters from `start` on.
            let number = number.filter(|_| start == sent.start);
            let burst = TxBurst { bytes, unreadable, origin, number };
            let sender = Some((DriveId(sent.drive), sent.port));
            self.deliver_to_drives(bus, sent.start, sent.line, burst, sender);
        }
        self.record(bus, start, sent.line, Source::Drive(DriveId(sent.drive)), bytes, number);
    }

    /// Delivers characters to all clients, from `start` on. `from` is the drive that sends them, if any. If a
    /// client has left, clients that connected after its request do not receive the answer, because one of
    /// them may use the same port.
    pub(super) fn deliver_to_clients(
        &mut self,
        bus: u32,
        start: Instant,
        line: Line,
        bytes: &[u8],
        number: Option<u32>,
        from: Option<DriveId>,
    ) {
        let serial_line = &self.buses[bus as usize];
        if serial_line.clients.is_empty() {
            return;
        }
        let rx_burst = RxBurst { start, line, character: self.takes(line, 1), bytes, from };
        let collisions = serial_line.collisions.as_ref().zip(number);
        let asker_left = self.clients.get(&serial_line.served).is_none_or(|asker| asker.left);
        let is_framed = self.framed(bus).is_some();
        let has_left = from.is_some() && is_framed && asker_left;
        for &id in &serial_line.clients {
            if has_left && self.clients.came_after(id, serial_line.served_order) {
                continue;
            }
            if id != serial_line.served
                && self.clients.get(&id).is_some_and(|state| state.hears_own_answers_only)
            {
                continue;
            }
            self.clients.push(id, rx_burst, |end, byte| {
                let (collisions, _) =
                    collisions.filter(|(collisions, number)| collisions.collides(*number, end))?;
                Some(collisions.garbage(line, end, byte))
            });
        }
    }

    /// Delivers characters to all drives except the sender, from `start` on.
    pub(super) fn deliver_to_drives(
        &mut self,
        bus: u32,
        start: Instant,
        line: Line,
        burst: TxBurst<'_>,
        sender: Option<(DriveId, Port)>,
    ) {
        if matches!(*self.ports(Bus(bus)), [only] if Some(only) == sender) {
            return;
        }
        let start = match (self.fast(), self.buses[bus as usize].turn) {
            (false, _) => start,
            // Unsolicited output takes time here: two drives with the same address may answer each other's
            // answers forever, and must not do so every tick.
            (true, LineState::Free) => start + line.character() * burst.bytes.len() as u64,
            (true, _) => start + Duration::TICK,
        };
        if self.schedule_for_all(bus, start, burst, sender) {
            return;
        }
        for n in 0..self.ports(Bus(bus)).len() {
            let (drive, port) = self.ports(Bus(bus))[n];
            if Some((drive, port)) != sender {
                self.schedule_characters(drive, port, start, burst);
            }
        }
    }

    /// Records the characters of a transmission; `number` identifies it if characters may collide.
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
        let fast = self.fast();
        let collisions = self.buses[bus as usize].collisions.as_ref().zip(number);
        self.capture.record(|| Frame {
            at,
            lasts: if fast { Duration::ZERO } else { line.character() * bytes.len() as u64 },
            on: Medium::Line(Bus(bus)),
            from,
            line: Some(line),
            bytes: bytes.to_vec(),
            collided: collisions
                .is_some_and(|(collisions, number)| collisions.overlapped(number).next().is_some()),
            received: Vec::new(),
        });
    }

    /// Cancels the characters that a drive has not sent yet when its power goes off.
    pub(super) fn cancel_output(&mut self, index: u32) {
        let now = self.now;
        for port in (0..self.spec(DriveId(index)).ports.len() as u8).map(Port) {
            let Some(serial) = self.at_mut(DriveId(index)).state.serial(port) else { continue };
            if serial.sends_until <= now {
                continue;
            }
            let character = serial.line_at(now).character();
            serial.sends_until = now;
            self.note_unsent(DriveId(index), port, character);
            let Some(Bus(bus)) = self.bus(DriveId(index), port) else { continue };
            let serials =
                self.ports(Bus(bus)).iter().filter_map(|&(drive, port)| self.at(drive).serial(port));
            let sends_until = serials.map(|serial| serial.sends_until).max().unwrap_or(now);
            let serial_line = &mut self.buses[bus as usize];
            // Delayed replies and noise are still delivered.
            let delay = serial_line.late_by;
            let until = now + delay;
            serial_line.sends_until = (sends_until + delay).max(serial_line.held_up);
            self.capture.cut(Bus(bus), DriveId(index), until);
            for &id in &serial_line.clients {
                self.clients.cancel_from(id, DriveId(index), until);
            }
        }
    }
}
