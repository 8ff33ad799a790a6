//! Arbitration: which client a line serves, and for how long.

use drivetwin_firmware::device::{Duration, Instant};

use super::events::EventKind;
use super::lines::{end_detection_time, inter_frame_gap};
use super::{Bench, Bus, Outlet};
use crate::line::faults::Text;
use crate::line::{LineState, PendingFrame, Request, SerialLine};
use crate::record::effects::FrameEffects;
use crate::record::journal::{NoMessage, Outcome};
use crate::scheduler::Phase;

/// Maximum duration of a drive's queued output; while it is longer, clients have to wait (HOST-14).
const AHEAD: Duration = Duration::secs(1);

/// Arbitration of lines.
impl Bench {
    /// Gives a free line to the client whose bytes arrived first. On a line with timed characters, the client
    /// that is being served also sends its next character.
    pub(super) fn serve(&mut self, bus: u32) {
        let framed = self.framed(bus);
        loop {
            let first = self.first_waiting(bus);
            let serial_line = &mut self.buses[bus as usize];
            let goes_on =
                framed.is_none() && first == Some(serial_line.served) && serial_line.free <= self.now;
            if serial_line.turn != LineState::Free && !goes_on {
                if serial_line.turn == LineState::Kept && first.is_some() {
                    self.set_turn(bus, LineState::Asked);
                }
                return self.transmit_into_collisions(bus);
            }
            let Some(id) = first else {
                if serial_line.turn == LineState::Free {
                    serial_line.until = Instant::NEVER;
                }
                return;
            };
            if framed.is_none() && self.defer_client(bus, id) {
                return;
            }
            let Some(state) = self.clients.get_mut(&id) else { return };
            match state.next_frame(self.now, framed, self.settings.frame_timeout) {
                PendingFrame::Complete(length, came) => {
                    self.transmit(bus, id, length, came);
                    if framed.is_none() {
                        return;
                    }
                }
                PendingFrame::Partial(_) if state.left => {
                    // The line was reserved for the client until the client left.
                    let serial_line = &mut self.buses[bus as usize];
                    serial_line.free = serial_line.free.max(self.now);
                    let bytes = state.first(state.backlog());
                    self.forget(id);
                    let outcome = Outcome::NoMessage(NoMessage::Disconnected);
                    let line = Outlet::Line(Bus(bus));
                    self.enter_undelivered(line, self.now, &bytes, outcome, FrameEffects::NONE);
                }
                PendingFrame::Partial(until) | PendingFrame::Ambiguous(_, until) => {
                    self.turn_until(bus, until);
                    return self.transmit_into_collisions(bus);
                }
            }
        }
    }

    /// The client of a line whose waiting bytes arrived first.
    fn first_waiting(&self, bus: u32) -> Option<u32> {
        let clients = &self.buses[bus as usize].clients;
        let waiting = clients.iter().filter_map(|&id| Some((self.clients.get(&id)?.order()?, id)));
        waiting.min().map(|(_, id)| id)
    }

    /// Sends frames that are complete if no more bytes follow, without waiting for the timeout. Returns true
    /// if there was one.
    pub(super) fn flush_ambiguous(&mut self) -> bool {
        let mut ended = false;
        for bus in 0..self.buses.len() as u32 {
            if self.buses[bus as usize].partial_until().is_none() {
                continue;
            }
            let framed = self.framed(bus);
            let Some(id) = self.first_waiting(bus) else { continue };
            let Some(state) = self.clients.get_mut(&id) else { continue };
            if let PendingFrame::Ambiguous(length, _) =
                state.next_frame(self.now, framed, self.settings.frame_timeout)
            {
                self.transmit(bus, id, length, self.now);
                ended = true;
            }
        }
        ended
    }

    /// Time at which the first partial frame that blocks another client times out.
    pub(super) fn blocking_partial_timeout(&self) -> Option<Instant> {
        let waits = |id: &&u32| self.clients.get(id).is_some_and(|client| client.backlog() > 0);
        let several = |serial_line: &&SerialLine| serial_line.clients.iter().filter(waits).nth(1).is_some();
        self.buses.iter().filter(several).filter_map(SerialLine::partial_until).min()
    }

    /// Defers a client while the queued output of a drive takes longer than [`AHEAD`]. Answers are longer
    /// than commands, so the queue would grow without limit if a client did not wait for its answers. Returns
    /// true if the client is deferred; its turn continues meanwhile.
    fn defer_client(&mut self, bus: u32, client: u32) -> bool {
        let serial_line = &mut self.buses[bus as usize];
        let ahead = AHEAD + serial_line.disturbance.longest_delay();
        if serial_line.sends_until <= self.now + ahead {
            return false;
        }
        let until = serial_line.sends_until - ahead;
        serial_line.served = client;
        self.set_turn(bus, LineState::Asked);
        self.turn_until(bus, until);
        true
    }

    /// Transmits the first `length` bytes of a client without gaps, from their arrival or, if later, from the
    /// time at which the line is free.
    pub(super) fn transmit(&mut self, bus: u32, client: u32, length: usize, came: Instant) {
        self.note_silence(bus, client);
        let length = self.unbroken(bus, client, length);
        let ends_bad_frame = self.ends_bad_frame(bus, client, length);
        let in_one_write = self.in_one_write(bus, client, length);
        let early = self.early_request(bus, client, length);
        let early = in_one_write.or(early).filter(|_| !ends_bad_frame);
        let Some(state) = self.clients.get_mut(&client) else { return };
        let (flags, order) = (state.flags(), state.order().unwrap_or_default());
        let (bytes, sender) = (state.take(length), state.sender);
        if state.left && state.backlog() == 0 {
            self.forget(client);
        }
        if self.framed(bus).is_some() && !flags.noise {
            self.buses[bus as usize].requests.request(&bytes);
        }
        if let Some(early) = early
            && self.drops_early(bus, early, came, &bytes)
        {
            return;
        }
        let unreadable = if flags.unreadable { vec![0] } else { Vec::new() };
        let text = Text { bytes, unreadable };
        let (noise, effects) = (flags.noise, flags.effects);
        let request = Request {
            client,
            order,
            sender,
            count: length,
            text,
            noise,
            effects,
            early,
            ..Request::default()
        };
        let serial_line = &self.buses[bus as usize];
        let start = came.max(match &serial_line.collisions {
            // The client transmits while others do.
            Some(collisions) if serial_line.turn != LineState::Free => collisions.free.max(self.now),
            _ => serial_line.free,
        });
        let request = match self.framed(bus) {
            Some(_) => self.disturbed_request(bus, start, request),
            None => request,
        };
        self.transmit_request(bus, start, &request);
    }

    /// Changes the state of a line.
    pub(super) fn set_turn(&mut self, bus: u32, turn: LineState) {
        let serial_line = &mut self.buses[bus as usize];
        let before = std::mem::replace(&mut serial_line.turn, turn);
        self.busy += usize::from(turn.is_busy());
        self.busy -= usize::from(before.is_busy());
    }

    /// Schedules the end of the present turn, or of the wait for the rest of a partial frame.
    pub(super) fn turn_until(&mut self, bus: u32, at: Instant) {
        self.buses[bus as usize].until = at;
        if let Some(&(drive, _)) = self.ports(Bus(bus)).first() {
            self.schedule(at, Phase::Turn, drive.0, EventKind::TurnEnd { bus });
        }
    }

    /// Ends a turn if its time is over. The line is then free and serves the next client.
    pub(super) fn turn_ends(&mut self, bus: u32, at: Instant) {
        let serial_line = &mut self.buses[bus as usize];
        if serial_line.until != at {
            return;
        }
        serial_line.until = Instant::NEVER;
        if serial_line.turn == LineState::Free {
            self.serve(bus);
        } else if self.framed(bus).is_some() {
            self.turn_ends_of_frames(bus, at);
        } else {
            self.turn_ends_of_characters(bus, at);
        }
    }

    /// Ends a turn on a line with frames. The turn lasts until all drives have detected the inter-frame gap
    /// and answered, and repetitions and noise are sent (HOST-4).
    fn turn_ends_of_frames(&mut self, bus: u32, at: Instant) {
        self.enter_frame(bus);
        // The turn is extended for answers only once, because drives may answer each other's answers forever.
        if self.buses[bus as usize].turn == LineState::Asked && self.answers(bus, at) {
            return;
        }
        let from = if self.fast() {
            at
        } else {
            let gap = self.longest(bus, inter_frame_gap);
            let serial_line = &self.buses[bus as usize];
            // A character that begins at this time plus the gap ends one tick after the drives have detected
            // the gap.
            (serial_line.free + Duration::TICK).max(serial_line.sends_until) + gap
        };
        match self.buses[bus as usize].behind.pop_front() {
            Some(request) => self.transmit_request(bus, self.received_by_all(bus, from), &request),
            None => self.free(bus, from),
        }
    }

    /// Ends a turn on a line with timed characters: the client sends its next character, a deferred client
    /// tries again, or all is sent. If all is sent, the client keeps the line for an inter-frame gap, because
    /// programs write a command in pieces, and pieces from two clients must not mix. If a drive begins to
    /// answer at once, the turn ends earlier (HOST-13).
    fn turn_ends_of_characters(&mut self, bus: u32, at: Instant) {
        let serial_line = &mut self.buses[bus as usize];
        let transmitted = serial_line.turn == LineState::Asked && serial_line.free == at;
        let answered = serial_line.turn == LineState::Answering;
        serial_line.free = at;
        self.serve(bus);
        if self.buses[bus as usize].until != Instant::NEVER {
            return;
        }
        if transmitted && !self.fast() {
            let quiet = self.longest(bus, end_detection_time);
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
        // The turn is extended for answers only once, because a stream never ends, and a client may send
        // during it.
        if answered || !self.answers(bus, at) {
            self.enter_unreadable(bus);
            self.free(bus, at);
        }
    }

    /// If a drive still sends, extends the turn until the end of its transmission and returns true.
    fn answers(&mut self, bus: u32, at: Instant) -> bool {
        let serial_line = &mut self.buses[bus as usize];
        let until = serial_line.sends_until;
        let answers = until > at;
        if answers {
            self.set_turn(bus, LineState::Answering);
            self.turn_until(bus, until);
        }
        answers
    }

    /// Time at which all drives have received the characters sent by `at`. If characters take no time, other
    /// drives receive an answer one tick later.
    fn received_by_all(&self, bus: u32, at: Instant) -> Instant {
        let waits = self.fast() && self.ports(Bus(bus)).len() > 1;
        if waits { at + Duration::TICK } else { at }
    }

    /// Ends a turn: the line is free from `from` on, and serves the next client.
    fn free(&mut self, bus: u32, from: Instant) {
        let from = self.received_by_all(bus, from);
        let serial_line = &mut self.buses[bus as usize];
        serial_line.free = from;
        if let Some(collisions) = &mut serial_line.collisions {
            collisions.transmitted.clear();
            collisions.free = from;
        }
        self.set_turn(bus, LineState::Free);
        self.serve(bus);
    }
}
