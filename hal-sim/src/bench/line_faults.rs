//! Lines that are disturbed, and characters on them that collide.

use drivetwin_firmware::device::{Duration, Instant, Line, Port};

use super::lines::silence_after;
use super::transmit::{Origin, TxBurst};
use super::{Bench, Bus, Client, DriveId};
use crate::line::collisions::Air;
use crate::line::faults::{Fate, LineFaults, Refusal, Text, readdressed};
use crate::line::{CharFlags, PendingFrame, Request, Sender};
use crate::record::capture::Source;
use crate::record::trace::InputRecord;
use crate::slot::Sent;

/// Longest delay of replies by what comes between them: a stream without a pause leaves no room for more (BENCH-14).
const ROOM: Duration = Duration::millis(500);

/// Faults of lines.
impl Bench {
    /// Disturbs a line from its next frame on, where each frame has the same chances whatever was asked for
    /// before. Values that [`check_for`](LineFaults::check_for) refuses act as the nearest ones that it takes,
    /// or not at all.
    pub fn set_line_faults(&mut self, bus: Bus, faults: LineFaults) {
        self.buses[bus.0 as usize].disturbance.set(faults);
    }

    /// Faults of a line.
    #[must_use]
    pub fn line_faults(&self, bus: Bus) -> LineFaults {
        *self.buses[bus.0 as usize].disturbance.faults()
    }

    /// Sets whether characters that overlap on a line corrupt each other, instead of waiting for their turn; at first
    /// they wait. Without effect where characters take no time, and on lines on which both directions run at once.
    pub fn set_collisions(&mut self, bus: Bus, collisions: bool) {
        let may = collisions && !self.fast() && self.framed(bus.0).is_some();
        let wire = &mut self.buses[bus.0 as usize];
        if may != wire.air.is_some() {
            wire.air = may.then(|| Air::new(self.settings.seed, &wire.name));
        }
    }

    /// Bytes of a client arrive for a line on which each character has its time, as faults leave them.
    pub(super) fn queue_disturbed(&mut self, client: Client, bytes: &[u8]) {
        let Some(outside) = self.clients.get(&client.0) else { return };
        let bus = outside.bus;
        let Some(fate) = self.buses[bus as usize].disturbance.request() else {
            return self.queue(client, bytes, CharFlags::default());
        };
        let line = self.line(Bus(bus));
        let text = fate.spoil(line, bytes);
        self.queue_text(client, &text, false);
        if fate.twice {
            self.queue_text(client, &text, false);
        }
        if let Some(noise) = fate.noise(line) {
            self.queue_text(client, &noise, true);
        }
    }

    fn queue_text(&mut self, client: Client, text: &Text, noise: bool) {
        for (place, byte) in text.bytes.iter().enumerate() {
            let unreadable = text.unreadable.contains(&place);
            self.queue(client, &[*byte], CharFlags { noise, unreadable });
        }
    }

    /// A request on a line of Modbus as faults leave it; what is to follow it waits until it is answered.
    pub(super) fn disturbed_request(&mut self, bus: u32, request: Request) -> Request {
        let line = self.line(Bus(bus));
        let wire = &mut self.buses[bus as usize];
        let Some(fate) = wire.disturbance.request() else { return request };
        let code = wire.disturbance.faults().exception_code;
        let refused = if fate.refused { Refusal::of(line, &request.text.bytes, code) } else { None };
        let refused = refused.map(|(refusal, instead)| (refusal, fate.spoil(line, &instead).bytes));
        let text = fate.spoil(line, &request.text.bytes);
        let request = Request { text, refused, ..request };
        if fate.twice && !fate.lost {
            wire.behind.push_back(request.clone());
        }
        wire.behind.extend(fate.noise(line).map(|text| Request {
            count: text.bytes.len(),
            text,
            noise: true,
            ..Request::default()
        }));
        request
    }

    /// Carries what a drive sends as faults leave it.
    pub(super) fn carry_disturbed(&mut self, bus: u32, sent: &Sent, bytes: &[u8], fate: &Fate) {
        let LineFaults { delay, mute, baud, .. } = self.line_faults(Bus(bus));
        let line = sent.line;
        let modbus = self.framed(bus).is_some();
        let rewritten = if modbus { self.rewritten(bus, line, bytes, fate) } else { None };
        let sound = rewritten.as_deref().unwrap_or(bytes);
        let text = if mute { Text::default() } else { fate.spoil(line, sound) };
        let elsewhere = baud.filter(|&baud| baud != line.baud).map(|baud| Line { baud, ..line });
        let garbage = elsewhere.map(|clients| (clients, fate.garbage(line, clients.baud, text.bytes.len())));
        let clients =
            garbage.as_ref().map_or((line, text.bytes.as_slice()), |(line, garbage)| (*line, garbage));

        let takes = self.takes(line, bytes.len());
        let silence = if self.fast() { Duration::ZERO } else { silence_after(line) };
        let due = sent.start + delay;
        let start = due.max(self.buses[bus as usize].held_up);
        let room = start <= due + ROOM;
        self.reach(bus, start, sent, (&text.bytes, &text.unreadable), clients);
        let mut end = start + takes;
        if fate.twice && room && !text.bytes.is_empty() {
            self.reach(bus, end + silence, sent, (&text.bytes, &text.unreadable), clients);
            end += silence + takes;
        }
        if let Some(noise) = fate.noise(line).filter(|_| room) {
            let deaf = (!modbus).then_some((DriveId(sent.seat), sent.port));
            self.noise(bus, end + silence, line, &noise, deaf);
            end += silence + self.takes(line, noise.bytes.len());
        }
        let wire = &mut self.buses[bus as usize];
        wire.sends_until = wire.sends_until.max(end);
        if end > sent.start + takes {
            wire.held_up = end;
        }
    }

    /// A reply that is another one: the refusal of a request that was not carried out, or from another address.
    fn rewritten(&self, bus: u32, line: Line, reply: &[u8], fate: &Fate) -> Option<Vec<u8>> {
        let refusal = self.buses[bus as usize].refusal;
        let refused = refusal.and_then(|refusal| refusal.answer(line, reply));
        if !fate.elsewhere {
            return refused;
        }
        let address = |&(seat, _): &(DriveId, Port)| Some(self.peek(seat, self.spec(seat).address?));
        let taken: Vec<i64> = self.ports(Bus(bus)).iter().filter_map(address).collect();
        readdressed(line, refused.as_deref().unwrap_or(reply), &taken).or(refused)
    }

    /// Noise on a line from `start` on, heard by all but one drive.
    fn noise(&mut self, bus: u32, start: Instant, line: Line, noise: &Text, deaf: Option<(DriveId, Port)>) {
        let number = self.on_air(bus, start, line, noise.bytes.len());
        self.reach_clients(bus, start, line, &noise.bytes, number, None);
        let voice = Origin::Client(Sender::default());
        let words = TxBurst { bytes: &noise.bytes, unreadable: &noise.unreadable, voice, number };
        self.reach_drives(bus, start, line, words, deaf);
        self.record(bus, start, line, Source::Noise, &noise.bytes, number);
    }
}

/// Characters that collide.
impl Bench {
    /// Characters are on a line from `start` on, and are recorded next: their number where they may collide. What
    /// clients have yet to hear of others is spoiled by them.
    pub(super) fn on_air(&mut self, bus: u32, start: Instant, line: Line, count: usize) -> Option<u32> {
        let wire = &mut self.buses[bus as usize];
        let air = wire.air.as_mut().filter(|_| count > 0)?;
        let character = line.character();
        let number = air.carry(self.now, start, character, count, self.capture.seen());
        for frame in air.met(number) {
            self.capture.collide(frame);
        }
        let until = start + character * count as u64;
        for id in &wire.clients {
            if let Some(outside) = self.clients.get_mut(id) {
                outside.garble(start, until, character, |end, byte| air.garbage(line, end, byte));
            }
        }
        Some(number)
    }

    /// A character that may have collided, as a device receives it.
    pub(super) fn exposed(&self, place: u32, fed: InputRecord, number: u32) -> InputRecord {
        let (InputRecord::Bytes { port, .. } | InputRecord::RxError { port }) = fed else { return fed };
        let bus = self.bus(DriveId(place), port);
        let air = bus.and_then(|Bus(bus)| self.buses[bus as usize].air.as_ref());
        if air.is_some_and(|air| air.spoils(number, self.now)) { InputRecord::RxError { port } } else { fed }
    }

    /// Sends the messages of waiting clients at once on a line where characters may collide: none waits until it is
    /// free.
    pub(super) fn speak_into(&mut self, bus: u32) {
        let wire = &self.buses[bus as usize];
        let (Some(air), framed) = (&wire.air, self.framed(bus)) else { return };
        let silent = wire.clients.iter().filter(|id| !air.spoke.contains(id));
        let mut waiting: Vec<(u64, u32)> =
            silent.filter_map(|&id| Some((self.clients.get(&id)?.order()?, id))).collect();
        waiting.sort_unstable();
        for (_, id) in waiting {
            let Some(outside) = self.clients.get_mut(&id) else { continue };
            if let PendingFrame::Message(length, came) =
                outside.offer(self.now, framed, self.settings.patience)
            {
                self.transmit(bus, id, length, came);
            }
        }
    }
}
