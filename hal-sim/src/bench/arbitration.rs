//! Arbitration: which client a line belongs to, and until when.

use drivetwin_firmware::device::{Duration, Instant};

use super::events::EventKind;
use super::lines::{judgement, silence_after};
use super::{Bench, Bus};
use crate::line::faults::Text;
use crate::line::{LineState, PendingFrame, Request, SerialLine};
use crate::scheduler::Phase;

/// Longest time by which a drive's output may lie ahead before a client has to wait (HOST-14).
const AHEAD: Duration = Duration::secs(1);

/// Turns.
impl Bench {
    /// Gives a free line to whose bytes came first. Where each character has its time a client also goes on
    /// while it has the line, with one character behind the other.
    pub(super) fn serve(&mut self, bus: u32) {
        let framed = self.framed(bus);
        loop {
            let first = self.first_waiting(bus);
            let wire = &mut self.buses[bus as usize];
            let goes_on = framed.is_none() && first == Some(wire.served) && wire.free <= self.now;
            if wire.turn != LineState::Free && !goes_on {
                if wire.turn == LineState::Kept && first.is_some() {
                    self.set_turn(bus, LineState::Asked);
                }
                return self.speak_into(bus);
            }
            let Some(id) = first else {
                if wire.turn == LineState::Free {
                    wire.until = Instant::NEVER;
                }
                return;
            };
            if framed.is_none() && self.holds_back(bus, id) {
                return;
            }
            let Some(outside) = self.clients.get_mut(&id) else { return };
            match outside.offer(self.now, framed, self.settings.patience) {
                PendingFrame::Message(length, came) => {
                    self.transmit(bus, id, length, came);
                    if framed.is_none() {
                        return;
                    }
                }
                PendingFrame::Half(_) if outside.left => {
                    // The line was its own until it left.
                    let wire = &mut self.buses[bus as usize];
                    wire.free = wire.free.max(self.now);
                    self.forget(id);
                }
                PendingFrame::Half(until) | PendingFrame::Unsure(_, until) => {
                    self.turn_until(bus, until);
                    return self.speak_into(bus);
                }
            }
        }
    }

    /// The client of a line whose bytes came first.
    fn first_waiting(&self, bus: u32) -> Option<u32> {
        let clients = &self.buses[bus as usize].clients;
        let waiting = clients.iter().filter_map(|&id| Some((self.clients.get(&id)?.order()?, id)));
        waiting.min().map(|(_, id)| id)
    }

    /// Sends what only waits for silence to show that it is all. Whether there is such.
    pub(super) fn end_bursts(&mut self) -> bool {
        let mut ended = false;
        for bus in 0..self.buses.len() as u32 {
            if self.buses[bus as usize].half_until().is_none() {
                continue;
            }
            let framed = self.framed(bus);
            let Some(id) = self.first_waiting(bus) else { continue };
            let Some(outside) = self.clients.get_mut(&id) else { continue };
            if let PendingFrame::Unsure(length, _) = outside.offer(self.now, framed, self.settings.patience) {
                self.transmit(bus, id, length, self.now);
                ended = true;
            }
        }
        ended
    }

    /// The end of the patience with half a message behind which another client waits.
    pub(super) fn half_in_the_way(&self) -> Option<Instant> {
        let waits = |id: &&u32| self.clients.get(id).is_some_and(|client| client.backlog() > 0);
        let several = |wire: &&SerialLine| wire.clients.iter().filter(waits).nth(1).is_some();
        self.buses.iter().filter(several).filter_map(SerialLine::half_until).min()
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
        wire.served = client;
        self.set_turn(bus, LineState::Asked);
        self.turn_until(bus, until);
        true
    }

    /// Puts the first `length` bytes of a client on a line, as if sent without gaps from when they came, or from
    /// when the line is free.
    pub(super) fn transmit(&mut self, bus: u32, client: u32, length: usize, came: Instant) {
        let Some(outside) = self.clients.get_mut(&client) else { return };
        let (mark, order) = (outside.mark(), outside.order().unwrap_or_default());
        let (bytes, sender) = (outside.take(length), outside.sender);
        if outside.left && outside.backlog() == 0 {
            self.forget(client);
        }
        let unreadable = if mark.unreadable { vec![0] } else { Vec::new() };
        let text = Text { bytes, unreadable };
        let request =
            Request { client, order, sender, count: length, text, refused: None, noise: mark.noise };
        let wire = &self.buses[bus as usize];
        let start = came.max(match &wire.air {
            // It speaks into what others say.
            Some(air) if wire.turn != LineState::Free => air.free.max(self.now),
            _ => wire.free,
        });
        let request = if self.framed(bus).is_some() { self.disturbed_request(bus, request) } else { request };
        self.put(bus, start, &request);
    }

    /// Changes the turn on a line.
    pub(super) fn set_turn(&mut self, bus: u32, turn: LineState) {
        let wire = &mut self.buses[bus as usize];
        let before = std::mem::replace(&mut wire.turn, turn);
        self.busy += usize::from(turn.is_busy());
        self.busy -= usize::from(before.is_busy());
    }

    /// The present turn, or the patience with half a message, ends at `at`.
    pub(super) fn turn_until(&mut self, bus: u32, at: Instant) {
        self.buses[bus as usize].until = at;
        if let Some(&(seat, _)) = self.ports(Bus(bus)).first() {
            self.schedule(at, Phase::Turn, seat.0, EventKind::Turn { bus });
        }
    }

    /// A turn may be over: then the line is free, and goes to whoever waits.
    pub(super) fn turn_ends(&mut self, bus: u32, at: Instant) {
        let wire = &mut self.buses[bus as usize];
        if wire.until != at {
            return;
        }
        wire.until = Instant::NEVER;
        if wire.turn == LineState::Free {
            self.serve(bus);
        } else if self.framed(bus).is_some() {
            self.turn_ends_of_frames(bus, at);
        } else {
            self.turn_ends_of_characters(bus, at);
        }
    }

    /// Ends a turn on a line where silence ends a message: it lasts until all drives have judged that, and answered,
    /// and what follows it is over (HOST-4).
    fn turn_ends_of_frames(&mut self, bus: u32, at: Instant) {
        // Once: drives may answer each other's answers for ever.
        if self.buses[bus as usize].turn == LineState::Asked && self.answers(bus, at) {
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

    /// Ends a turn on a line where each character has its time: the client goes on; or, held back, tries again; or it
    /// has said all. Then it keeps the line for as long as silence would take to end a message: programs write a
    /// command in pieces, and those of two clients must not mix (HOST-13). An answer that begins at once ends the exchange
    /// before that.
    fn turn_ends_of_characters(&mut self, bus: u32, at: Instant) {
        let wire = &mut self.buses[bus as usize];
        let spoke = wire.turn == LineState::Asked && wire.free == at;
        let answered = wire.turn == LineState::Answering;
        wire.free = at;
        self.serve(bus);
        if self.buses[bus as usize].until != Instant::NEVER {
            return;
        }
        if spoke && !self.fast() {
            let quiet = self.lines(bus).map(judgement).max().unwrap_or(Duration::ZERO);
            self.buses[bus as usize].kept_until = at + quiet;
            if !self.answers(bus, at) {
                self.turn_until(bus, at + quiet);
            }
            return;
        }
        let kept_until = self.buses[bus as usize].kept_until;
        if answered && at < kept_until {
            let turn = if self.first_waiting(bus).is_some() { LineState::Asked } else { LineState::Kept };
            self.set_turn(bus, turn);
            return self.turn_until(bus, kept_until);
        }
        // Once: streams never end, and both directions run at once.
        if answered || !self.answers(bus, at) {
            self.free(bus, at);
        }
    }

    /// Returns whether a drive still sends: then the turn lasts until that has left.
    fn answers(&mut self, bus: u32, at: Instant) -> bool {
        let wire = &mut self.buses[bus as usize];
        let until = wire.sends_until;
        let answers = until > at;
        if answers {
            self.set_turn(bus, LineState::Answering);
            self.turn_until(bus, until);
        }
        answers
    }

    /// Time at which all drives have received what was sent until then: where characters take no time the others
    /// receive an answer a tick later.
    fn heard_by_all(&self, bus: u32, at: Instant) -> Instant {
        let waits = self.fast() && self.ports(Bus(bus)).len() > 1;
        if waits { at + Duration::TICK } else { at }
    }

    /// A turn is over: the line is free from then on, and goes to whoever waits.
    fn free(&mut self, bus: u32, from: Instant) {
        let from = self.heard_by_all(bus, from);
        let wire = &mut self.buses[bus as usize];
        (wire.free, wire.refusal) = (from, None);
        if let Some(air) = &mut wire.air {
            air.spoke.clear();
            air.free = from;
        }
        self.set_turn(bus, LineState::Free);
        self.serve(bus);
    }
}
