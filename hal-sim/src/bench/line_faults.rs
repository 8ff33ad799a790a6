//! Faults of lines, and collisions of characters.

use drivetwin_firmware::device::{Duration, Instant, Line, Port, Spec};
use drivetwin_protocol::modbus::ascii;

use super::lines::inter_frame_gap;
use super::tcp_faults::is_whole_line;
use super::transmit::{HeardBy, Origin, TxBurst};
use super::{Bench, Bus, Client, DriveId, Outlet};
use crate::line::collisions::{CollisionTracker, Transmitter};
use crate::line::fault_rules::Content;
use crate::line::faults::{FrameFaults, LineFaults, Text, exception, opened, readdressed};
use crate::line::{CharFlags, PendingFrame, Refusal, Request, Sender};
use crate::record::capture::Source;
use crate::record::effects::{FrameEffect, FrameEffects};
use crate::record::journal::Outcome;
use crate::record::trace::InputRecord;
use crate::slot::Sent;

/// Maximum delay of replies by inserted repetitions and noise: a stream of replies without pauses leaves no
/// room for more (BENCH-14).
const ROOM: Duration = Duration::millis(500);

/// Faults of lines.
impl Bench {
    /// Sets the faults of a line from its next frame on. The random choices for a frame depend on the seed
    /// and the number of the frame, not on earlier faults. A value that [`check_for`](LineFaults::check_for)
    /// refuses is replaced by the nearest valid value, or has no effect.
    pub fn set_line_faults(&mut self, bus: Bus, faults: LineFaults) {
        let serial_line = &mut self.buses[bus.0 as usize];
        serial_line.disturbance.set(faults);
        serial_line.asked = None;
    }

    /// Present faults of a line; [`LineFaults::NONE`] by default.
    #[must_use]
    pub fn line_faults(&self, bus: Bus) -> LineFaults {
        *self.buses[bus.0 as usize].disturbance.faults()
    }

    /// Sets whether overlapping characters on a line corrupt each other. By default they cannot overlap,
    /// because a client waits until the line is free. This has no effect if characters take no time, or on
    /// full-duplex lines.
    pub fn set_collisions(&mut self, bus: Bus, collisions: bool) {
        let may = collisions && !self.fast() && self.framed(bus.0).is_some();
        let serial_line = &mut self.buses[bus.0 as usize];
        if may != serial_line.collisions.is_some() {
            serial_line.collisions =
                may.then(|| Box::new(CollisionTracker::new(self.settings.seed, &serial_line.name)));
        }
    }

    /// Queues bytes of a client for a line with timed characters, changed by the faults of the line.
    pub(super) fn queue_disturbed(&mut self, client: Client, bytes: &[u8]) {
        let Some(state) = self.clients.get(&client.0) else { return };
        let bus = state.bus;
        let line = self.line(Bus(bus));
        let content = self.request_content(bus, None);
        let Some(fate) = self.buses[bus as usize].disturbance.request(bytes.len(), content.as_ref(), false)
        else {
            return self.queue(client, bytes, CharFlags::default());
        };
        let (text, effects) = (fate.apply(line, bytes), fate.effects());
        if fate.lost || !is_whole_line(bytes, &text.bytes) {
            self.enter_lost(Outlet::Line(Bus(bus)), self.now, bytes, effects);
        }
        let flags = CharFlags { effects, ..CharFlags::default() };
        self.queue_text(client, &text, flags);
        if fate.twice {
            self.queue_text(client, &text, flags);
        }
        if let Some(noise) = fate.noise(line) {
            let effects = FrameEffects::NONE.with(FrameEffect::WithNoise, true);
            self.queue_text(client, &noise, CharFlags { noise: true, effects, ..flags });
        }
    }

    fn queue_text(&mut self, client: Client, text: &Text, flags: CharFlags) {
        for (index, byte) in text.bytes.iter().enumerate() {
            let unreadable = text.unreadable.contains(&index);
            self.queue(client, &[*byte], CharFlags { unreadable, ..flags });
        }
    }

    /// Applies faults to a request on a Modbus line. Repetitions and noise are sent after the answer.
    pub(super) fn disturbed_request(&mut self, bus: u32, start: Instant, request: Request) -> Request {
        let line = self.line(Bus(bus));
        let content = self.request_content(bus, Some((line, &request.text.bytes)));
        let refusal = self.refusal(bus, start, &request);
        let serial_line = &mut self.buses[bus as usize];
        let count = request.text.bytes.len();
        let fate = serial_line.disturbance.request(count, content.as_ref(), refusal.is_some());
        serial_line.asked = content.map(Box::new);
        let Some(fate) = fate else { return request };
        let (text, effects) = (fate.apply(line, &request.text.bytes), fate.effects());
        // Drives see a Modbus ASCII message only between its colon and its line feed.
        let is_seen = !ascii::is_on(line) || text.has_ends_of_ascii();
        if fate.lost || !is_seen {
            self.enter_lost(Outlet::Line(Bus(bus)), start, &request.text.bytes, effects);
        }
        let serial_line = &mut self.buses[bus as usize];
        if fate.hides_end() {
            serial_line.last_request = None;
        }
        let refusal = refusal.filter(|_| fate.refused);
        // Noise before the request makes the transmission longer.
        let count = request.count.max(text.bytes.len());
        let request = Request { count, text, refusal, effects, ..request };
        if fate.twice && !fate.lost {
            serial_line.behind.push_back(Request { early: None, ..request.clone() });
        }
        serial_line.behind.extend(fate.noise(line).map(|text| Request {
            count: text.bytes.len(),
            text,
            noise: true,
            effects: FrameEffects::NONE.with(FrameEffect::IsNoise, true),
            ..Request::default()
        }));
        request
    }

    /// The Modbus exception that the fault `exception` sends for a request that begins at `start`. `None` if no drive
    /// would answer the request, so that there is nothing to refuse: the drive to which the request is addressed must
    /// be on the line and receive it.
    fn refusal(&self, bus: u32, start: Instant, request: &Request) -> Option<Refusal> {
        let &LineFaults { exception: rule, exception_code: code, baud, .. } =
            self.buses[bus as usize].disturbance.faults();
        if !rule.is_active() || !request.text.unreadable.is_empty() {
            return None;
        }
        let sender = Sender { baud: baud.or(request.sender.baud), ..request.sender };
        self.ports(Bus(bus)).iter().find_map(|&(drive, port)| {
            let line = self.at(drive).line_at(port, start).filter(|line| sender.fits(*line))?;
            let (unit, answer) = exception(line, self.spec(drive).rules, &request.text.bytes, code)?;
            let receives =
                self.address(drive).is_none_or(|own| own == unit) && self.is_receiving(drive, port, start);
            receives.then_some(Refusal { drive, port, code, answer })
        })
    }

    /// Returns true if a drive receives characters that begin at `start`.
    fn is_receiving(&self, drive: DriveId, port: Port, start: Instant) -> bool {
        let slot = self.at(drive);
        let Some(serial) = slot.serial(port).filter(|_| slot.state.powered) else { return false };
        let first = self.first_ends(start, self.takes(serial.line_at(start), 1));
        serial.sends_until <= start && slot.receives_from() <= first
    }

    /// Answers a request that ended at `end` in place of its drive, with the Modbus exception that the fault
    /// `exception` sends. `number` identifies the request if characters may collide.
    pub(super) fn answer_refused(
        &mut self,
        refusal: Refusal,
        request: &[u8],
        end: Instant,
        number: Option<u32>,
    ) {
        let Refusal { drive, port, code, ref answer } = refusal;
        let Some(Bus(bus)) = self.bus(drive, port) else { return };
        let collisions = self.buses[bus as usize].collisions.as_ref().zip(number);
        // The collision has an entry of its own.
        if collisions.is_some_and(|(all, number)| all.overlapped(number).next().is_some()) {
            return;
        }
        let outcome = if self.powered(drive) { Outcome::RefusedByFault(code) } else { Outcome::NoPower };
        let answers = outcome == Outcome::RefusedByFault(code);
        let effects = self.buses[bus as usize].on_request;
        self.enter_refused(
            (drive, port),
            end,
            (request, if answers { answer } else { &[] }),
            outcome,
            effects,
        );
        let (now, fast) = (self.now, self.fast());
        if let Some(serial) = self.at_mut(drive).state.serial(port).filter(|_| answers) {
            let (start, line) = serial.send(now, answer.len(), fast);
            let until = serial.sends_until;
            if let Some(entry) = self.at_mut(drive).state.journal.last_answered(port) {
                entry.answer_until = until;
            }
            let sent = Sent { drive: drive.0, port, start, line, count: answer.len() };
            self.transmit_from_drive(&sent, answer, HeardBy::Clients);
        }
    }

    /// Content of a request on a line, if a fault needs it: the drives that it is for and, on a Modbus line, the
    /// decoded frame. A frame with an invalid checksum is for no drive.
    fn request_content(&self, bus: u32, frame: Option<(Line, &[u8])>) -> Option<Content> {
        if !self.buses[bus as usize].disturbance.needs_content() {
            return None;
        }
        let drives = self.ports(Bus(bus)).iter().map(|&(drive, _)| (drive, self.spec(drive)));
        let Some((line, bytes)) = frame else { return Some(Content::of_request(drives.collect(), &[])) };
        let Some((unit, pdu)) = opened(line, bytes) else { return Some(Content::default()) };
        let is_for = |&(drive, spec): &(DriveId, &Spec)| {
            let address = spec.address.map(|row| self.peek(drive, row));
            unit == 0 || address.is_none_or(|address| address == i64::from(unit))
        };
        Some(Content::of_request(drives.filter(is_for).collect(), &pdu))
    }

    /// Content of a reply on a line, if a fault needs it.
    pub(super) fn reply_content(&self, bus: u32, sent: &Sent, bytes: &[u8]) -> Option<Content> {
        let serial_line = &self.buses[bus as usize];
        if !serial_line.disturbance.needs_content() {
            return None;
        }
        let drive = (DriveId(sent.drive), self.spec(DriveId(sent.drive)));
        Some(match &serial_line.asked {
            Some(asked) => asked.of_reply(drive),
            None => {
                let frame = self.framed(bus).and_then(|_| opened(sent.line, bytes));
                Content::of_lone_reply(drive, &frame.map_or(Vec::new(), |(_, pdu)| pdu))
            }
        })
    }

    /// Transmits the output of a drive, changed by the faults of the line.
    pub(super) fn transmit_with_faults(
        &mut self,
        bus: u32,
        (sent, heard_by): (&Sent, HeardBy),
        bytes: &[u8],
        fate: &FrameFaults,
    ) {
        let LineFaults { baud, .. } = self.line_faults(Bus(bus));
        let line = sent.line;
        let modbus = self.framed(bus).is_some();
        let rewritten = if modbus { self.rewritten(bus, line, bytes, fate) } else { None };
        let sound = rewritten.as_deref().unwrap_or(bytes);
        let text = if fate.muted { Text::default() } else { fate.apply(line, sound) };
        let other_baud = baud.filter(|&baud| baud != line.baud).map(|baud| Line { baud, ..line });
        let garbage = other_baud.map(|clients| (clients, fate.garbage(line, clients.baud, text.bytes.len())));
        let clients =
            garbage.as_ref().map_or((line, text.bytes.as_slice()), |(line, garbage)| (*line, garbage));

        let takes = self.takes(line, bytes.len().max(text.bytes.len()));
        let gap = if self.fast() { Duration::ZERO } else { inter_frame_gap(line) };
        let due = sent.start + fate.delay;
        let start = due.max(self.buses[bus as usize].held_up);
        let has_room = start <= due + ROOM;
        let characters = (text.bytes.as_slice(), text.unreadable.as_slice());
        self.deliver_from_drive(bus, start, (sent, heard_by), characters, clients);
        let mut end = start + takes;
        if fate.twice && has_room && !text.bytes.is_empty() {
            let repeated = (sent, HeardBy::Clients);
            self.deliver_from_drive(bus, end + gap, repeated, characters, clients);
            end += gap + takes;
        }
        if let Some(noise) = fate.noise(line).filter(|_| has_room) {
            let except = (!modbus).then_some((DriveId(sent.drive), sent.port));
            self.noise(bus, end + gap, line, &noise, except);
            end += gap + self.takes(line, noise.bytes.len());
        }
        let serial_line = &mut self.buses[bus as usize];
        serial_line.sends_until = serial_line.sends_until.max(end);
        serial_line.late_by = start.since(sent.start);
        if fate.hides_end() {
            serial_line.last_request = None;
        }
        if end > sent.start + takes {
            serial_line.held_up = end;
        }
    }

    /// The reply with a wrong address; `None` if the reply stays unchanged.
    fn rewritten(&self, bus: u32, line: Line, reply: &[u8], fate: &FrameFaults) -> Option<Vec<u8>> {
        if !fate.wrong_address {
            return None;
        }
        let address = |&(drive, _): &(DriveId, Port)| Some(self.peek(drive, self.spec(drive).address?));
        let taken: Vec<i64> = self.ports(Bus(bus)).iter().filter_map(address).collect();
        readdressed(line, reply, &taken)
    }

    /// Transmits noise from `start` on to all clients, and to all drives except one.
    fn noise(&mut self, bus: u32, start: Instant, line: Line, noise: &Text, except: Option<(DriveId, Port)>) {
        let number = self.occupy_line(bus, Transmitter::Noise, start, line, noise.bytes.len());
        // If characters take no time, drives receive them one tick later.
        let end = start + self.takes(line, noise.bytes.len()) + Duration::TICK;
        self.buses[bus as usize].noise_of_reply = (start, end);
        self.deliver_to_clients(bus, start, line, &noise.bytes, number, None);
        let origin = Origin::Client(Sender::default());
        let burst = TxBurst { bytes: &noise.bytes, unreadable: &noise.unreadable, origin, number };
        self.deliver_to_drives(bus, start, line, burst, except);
        self.record(bus, start, line, Source::Noise, &noise.bytes, number);
    }
}

/// Collisions of characters.
impl Bench {
    /// Occupies a line with characters of a sender from `start` on, which the caller records next. Overlapping characters
    /// that clients have not received yet are corrupted. Returns the number of the transmission, or `None` if
    /// characters cannot collide.
    pub(super) fn occupy_line(
        &mut self,
        bus: u32,
        by: Transmitter,
        start: Instant,
        line: Line,
        count: usize,
    ) -> Option<u32> {
        let serial_line = &mut self.buses[bus as usize];
        let collisions = serial_line.collisions.as_mut().filter(|_| count > 0)?;
        let character = line.character();
        let number = collisions.add(self.now, by, start, character, count, self.capture.seen());
        for frame in collisions.overlapped(number) {
            self.capture.collide(frame);
        }
        let until = start + character * count as u64;
        for id in &serial_line.clients {
            if let Some(state) = self.clients.get_mut(id) {
                state.garble(start, until, character, |end, byte| collisions.garbage(line, end, byte));
            }
        }
        for (drive, port) in collisions.collided_replies(number) {
            self.note_collision(drive, port);
        }
        Some(number)
    }

    /// The input that a drive receives for a character that may have collided.
    pub(super) fn exposed(&self, index: u32, input: InputRecord, number: u32) -> InputRecord {
        let (InputRecord::Bytes { port, .. } | InputRecord::RxError { port }) = input else { return input };
        let bus = self.bus(DriveId(index), port);
        let collisions = bus.and_then(|Bus(bus)| self.buses[bus as usize].collisions.as_ref());
        if collisions.is_some_and(|collisions| collisions.collides(number, self.now)) {
            InputRecord::RxError { port }
        } else {
            input
        }
    }

    /// On a line where characters may collide, transmits the frames of waiting clients at once: no client
    /// waits for a free line.
    pub(super) fn transmit_into_collisions(&mut self, bus: u32) {
        let serial_line = &self.buses[bus as usize];
        let (Some(collisions), framed) = (&serial_line.collisions, self.framed(bus)) else { return };
        let silent = serial_line.clients.iter().filter(|id| !collisions.transmitted.contains(id));
        let mut waiting: Vec<(u64, u32)> =
            silent.filter_map(|&id| Some((self.clients.get(&id)?.order()?, id))).collect();
        waiting.sort_unstable();
        for (_, id) in waiting {
            let Some(state) = self.clients.get_mut(&id) else { continue };
            if let PendingFrame::Complete(length, came) =
                state.next_frame(self.now, framed, self.settings.frame_timeout)
            {
                self.transmit(bus, id, length, came);
            }
        }
    }
}
