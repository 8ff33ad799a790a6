//! Requests that are too early (HOST-23).
//!
//! A drive takes a silence of t3.5 for the end of a frame. A request without that silence before it is one
//! frame with the reply before it, and the drive ignores both. A pty and a TCP connection do not carry
//! silences, so the line inserts the missing silence, and a client that works here may fail on a real line.
//! Therefore each such request is counted, and a strict line drops it.

use drivetwin_firmware::device::{Duration, Framing, Instant, Line};
use drivetwin_protocol::modbus::{self, Expect, Scan, ascii};

use super::lines::inter_frame_gap;
use super::{Bench, Bus, Outlet};
use crate::decode::Message;
use crate::line::LastRequest;
use crate::record::early::{EarlyCause, EarlyRequest, EarlyRequests};
use crate::record::effects::FrameEffects;
use crate::record::journal::Outcome;
use crate::record::requests::RequestStatistics;

/// Requests that are too early.
impl Bench {
    /// Sets whether a Modbus line drops requests that are too early, as a real drive does. By default the
    /// line inserts the missing silence. A request of [`ask`](Self::ask) is never too early, because each
    /// call of `ask` has a client of its own.
    ///
    /// ```
    /// use drivetwin_firmware::device::Port;
    /// use drivetwin_firmware::md3::Md3;
    /// use drivetwin_protocol::modbus::rtu;
    /// use drivetwin_protocol::time::Span as _;
    /// use drivetwin_sim::bench::{Bench, Setup};
    ///
    /// let mut bench = Bench::new();
    /// let setup = Setup { boot_fast: true, ..Setup::default() };
    /// let x = bench.add_with("x", Box::new(Md3::default()), setup)?;
    /// let line = bench.bus(x, Port(0)).expect("the MD3 has a line");
    /// bench.set_strict(line, true);
    /// let request = rtu::write(1, 0x15, 9_000);
    /// let client = bench.connect(line);
    /// bench.send(client, &request);
    /// bench.run_until_idle();
    /// // The second request follows the reply at once.
    /// bench.send(client, &request);
    /// bench.run_until_idle();
    /// let mut replies = Vec::new();
    /// bench.receive(client, &mut replies);
    /// assert_eq!((replies, bench.early_requests(line).count), (request.to_vec(), 1));
    /// // The lost request takes 9.2 ms on the line, and the silence after it 4.0 ms.
    /// bench.run_until(bench.now() + 14.millis());
    /// bench.send(client, &request);
    /// bench.run_until_idle();
    /// assert_eq!(bench.early_requests(line).count, 1);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn set_strict(&mut self, bus: Bus, strict: bool) {
        self.buses[bus.0 as usize].strict = strict;
    }

    /// Returns true if a line drops requests that are too early.
    #[must_use]
    pub fn is_strict(&self, bus: Bus) -> bool {
        self.buses[bus.0 as usize].strict
    }

    /// Requests on a line so far that were too early. A request is not judged if its client cannot know when
    /// it may send: after a request of another client, through a port that [times characters
    /// itself](Self::set_self_paced), on a line with the fault `baud`, or after a request or reply whose time on the line
    /// a fault hides: a reply that is late, lost or truncated, noise, and what is sent twice.
    #[must_use]
    pub fn early_requests(&self, bus: Bus) -> EarlyRequests {
        self.buses[bus.0 as usize].early
    }

    /// Statistics of the requests on a Modbus line or Modbus/TCP port so far; all zero elsewhere. On a TCP port no
    /// request is too early.
    #[must_use]
    pub fn request_statistics(&self, outlet: impl Into<Outlet>) -> RequestStatistics {
        match outlet.into() {
            Outlet::Line(bus) => {
                let line = &self.buses[bus.0 as usize];
                line.requests.statistics(line.early.count)
            }
            Outlet::Tcp(drive, port) => {
                let port = self.at(drive).state.ports.get(usize::from(port.0));
                let tcp = port.and_then(|port| port.tcp.as_ref());
                tcp.map(|tcp| tcp.requests.statistics(0)).unwrap_or_default()
            }
        }
    }

    /// Number of requests on all lines so far that were too early.
    #[must_use]
    pub fn early_count(&self) -> u64 {
        self.early_count
    }

    /// Sets whether the silence before requests is judged; by default it is. A bench whose time stands still
    /// between a reply and the next request does not know this silence.
    pub fn judge_silence(&mut self, judge: bool) {
        self.silence_is_free = !judge;
    }

    /// Sets the time by which the bytes of the next [`send`](Self::send) were sent at the latest. By default
    /// it is the present time of the bench, which may be earlier than the clock of a host.
    pub fn set_arrived_by(&mut self, at: Instant) {
        self.arrived_by = at;
    }

    /// Lets the next request on each line begin at any time, after a jump of a host's clock.
    pub fn forget_silence(&mut self) {
        for line in &mut self.buses {
            line.last_request = None;
        }
    }

    /// Number of waiting bytes of a client that drives receive as one frame on a strict line. `length` is that of the
    /// first frame. Characters that follow it without silence belong to it, unless all are whole frames, which are too
    /// early.
    pub(super) fn unbroken(&self, bus: u32, client: u32, length: usize) -> usize {
        let line = &self.buses[bus as usize];
        let is_judged = line.strict && !self.silence_is_free && !self.fast();
        // The frames behind the first one of a write were judged together with it.
        let is_first = line.continues != Some(client);
        let settings = self.framed(bus).filter(|line| is_judged && is_first && !ascii::is_on(*line));
        let client = self.clients.get(&client).filter(|state| !state.paces_itself);
        let Some((settings, state)) = settings.zip(client) else { return length };
        let needs = self.longest(bus, inter_frame_gap);
        let burst = state.sent_without(needs);
        let is_one = burst.len() > length
            && line.disturbance.faults().baud.is_none()
            && !are_whole_frames(settings, &burst);
        if is_one { burst.len() } else { length }
    }

    /// Returns true if the first `length` waiting bytes of a client arrived together with the frame before them, and are
    /// no whole frame: on a real line they are the end of a bad frame and not a request.
    pub(super) fn ends_bad_frame(&self, bus: u32, client: u32, length: usize) -> bool {
        self.buses[bus as usize].continues == Some(client)
            && self.clients.get(&client).zip(self.framed(bus)).is_some_and(|(state, line)| {
                !Message { framing: Framing::Silence, ascii: ascii::is_on(line), bytes: &state.first(length) }
                    .is_whole()
            })
    }

    /// Judges the first `length` waiting bytes of a client, which are a frame. The times are chosen so that
    /// the silence was certainly missing.
    ///
    /// Some clients wait until their bytes are on the wire. On a pty or a TCP connection this wait takes no time, so
    /// such a client is earlier here than on a real line, by the duration of its last request. This may be so unless
    /// the reply to the last request was complete.
    pub(super) fn early_request(&mut self, bus: u32, client: u32, length: usize) -> Option<EarlyRequest> {
        let settings = self.framed(bus).filter(|_| !self.silence_is_free && !self.fast())?;
        let state = self.clients.get(&client)?;
        let (_, began) = state.sent_between(0)?;
        let (written, _) = state.sent_between(length.checked_sub(1)?)?;
        let next = state.sent_between(length);
        let is_judged = !state.paces_itself;
        let takes = self.takes(settings, length);
        let needs = self.longest(bus, inter_frame_gap);
        let line = &mut self.buses[bus as usize];
        let replied = line.sends_until;
        let last_request = line.last_request.replace(LastRequest { client, written, takes });
        if !is_judged || line.disturbance.faults().baud.is_some() {
            return None;
        }
        let cause = last_request.filter(|last| last.client == client).and_then(|last| {
            if replied <= last.written + last.takes {
                (began < last.written + needs).then_some(EarlyCause::AfterRequest(began.since(last.written)))
            } else if replied <= began {
                (began < replied + needs).then_some(EarlyCause::AfterReply(began.since(replied)))
            } else {
                (began + last.takes < replied).then_some(EarlyCause::InUse)
            }
        });
        // On a line that is not strict, the second of two frames with no silence between them is counted when
        // its own turn comes. In Modbus ASCII the first frame is complete without silence after it.
        let is_followed = || {
            let (_, next) = next.filter(|_| line.strict)?;
            (next < written + needs).then_some(EarlyCause::Followed)
        };
        cause.or_else(is_followed).map(|cause| EarlyRequest { cause, needs })
    }

    /// Judges the first `length` waiting bytes of a client, which are a frame, by what arrived with them. This is known
    /// in manual time, too: the second of two frames in one write has no silence before it.
    pub(super) fn in_one_write(&mut self, bus: u32, client: u32, length: usize) -> Option<EarlyRequest> {
        self.framed(bus).filter(|_| !self.fast())?;
        let state = self.clients.get(&client)?;
        let (paces_itself, continues) = (state.paces_itself, state.arrived_at_once(length));
        let needs = self.longest(bus, inter_frame_gap);
        let line = &mut self.buses[bus as usize];
        let before = std::mem::replace(&mut line.continues, continues.then_some(client));
        // In Modbus ASCII a frame is complete without silence after it.
        if paces_itself || needs == Duration::ZERO || line.disturbance.faults().baud.is_some() {
            return None;
        }
        let cause = match before == Some(client) {
            true => EarlyCause::OneWrite,
            false if continues && line.strict && !self.silence_is_free => EarlyCause::Followed,
            false => return None,
        };
        Some(EarlyRequest { cause, needs })
    }

    /// Notes the silence between the last reply on a line and the waiting frame of a client.
    pub(super) fn note_silence(&mut self, bus: u32, client: u32) {
        let knows = self.framed(bus).is_some() && !self.silence_is_free && !self.fast();
        let Some(state) = self.clients.get(&client).filter(|state| knows && !state.paces_itself) else {
            return;
        };
        let Some((_, began)) = state.sent_between(0) else { return };
        let line = &mut self.buses[bus as usize];
        let is_timed = line.last_request.is_some() && line.disturbance.faults().baud.is_none();
        if line.sends_until > Instant::ZERO && is_timed {
            line.requests.silence(began.max(line.sends_until).since(line.sends_until));
        }
    }

    /// Counts a request that is too early. On a strict line, enters it in a journal and returns true.
    pub(super) fn drops_early(&mut self, bus: u32, early: EarlyRequest, came: Instant, bytes: &[u8]) -> bool {
        let line = &mut self.buses[bus as usize];
        // The request that follows is the one without silence before it.
        if early.cause != EarlyCause::Followed {
            line.early = EarlyRequests { count: line.early.count + 1, last: Some(early) };
            self.early_count += 1;
        }
        // In manual time two requests that wait for the bench may look like one write.
        if !line.strict || self.silence_is_free {
            return false;
        }
        self.enter_undelivered(
            Outlet::Line(Bus(bus)),
            came,
            bytes,
            Outcome::TooEarly(early),
            FrameEffects::NONE,
        );
        true
    }
}

/// Returns true if the characters are one whole Modbus RTU request behind the other.
fn are_whole_frames(line: Line, burst: &[u8]) -> bool {
    let mut rest = burst;
    while !rest.is_empty() {
        let length = match modbus::scan(line, rest, Expect::Requests) {
            Scan::Complete(length) => length,
            Scan::Ambiguous => modbus::ended(line, rest, Expect::Requests),
            Scan::Incomplete | Scan::Invalid(_) => return false,
        };
        let (frame, behind) = rest.split_at(length);
        if !(Message { framing: Framing::Silence, ascii: false, bytes: frame }).is_whole() {
            return false;
        }
        rest = behind;
    }
    true
}
