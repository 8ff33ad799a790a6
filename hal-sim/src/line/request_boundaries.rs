//! Request boundaries: where a request ends in the bytes of a client, and when it is complete.
//!
//! Gaps between bytes carry no information on a pty or TCP connection, so the checksum and the length of the function
//! decide ([`modbus::scan`]), and after them a timeout.

use drivetwin_firmware::device::{Duration, Instant, Line};
use drivetwin_protocol::modbus::{self, Expect, Scan};

use super::ClientState;

/// Bytes of a client without a gap of the frame timeout.
struct ClientBytes<'a> {
    bytes: &'a [u8],
    /// Time at which the last of them came.
    last: Instant,
    /// True if more came after such a gap.
    over: bool,
}

/// Bytes of a client that are ready for the line.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum PendingFrame {
    /// A frame of so many bytes, complete at that instant.
    Complete(usize, Instant),
    /// A partial frame, whose rest is waited for until then.
    Partial(Instant),
    /// A frame of so many bytes, if no more follow until then.
    Ambiguous(usize, Instant),
}

impl ClientState {
    /// Returns what is ready for a line at `now`. On a Modbus line (`framed`) that is a frame, which ends where its
    /// checksum is valid or in ASCII behind its line feed; a burst that cannot become a frame is sent unchanged. On
    /// other lines it is a character.
    pub(crate) fn next_frame(
        &mut self,
        now: Instant,
        framed: Option<Line>,
        frame_timeout: Duration,
    ) -> PendingFrame {
        let Some(line) = framed else {
            return PendingFrame::Complete(1, self.arrivals.front().map_or(now, |arrival| arrival.at));
        };
        // Behind a port that paces itself is a real line, on which other drives may answer.
        let expect = if self.paces_itself { Expect::Both } else { Expect::Requests };
        let left = self.left;
        let ClientBytes { bytes, last, over } = self.first_burst(frame_timeout);
        let ended = || modbus::ended(line, bytes, expect);
        let until = last + frame_timeout;
        match modbus::scan(line, bytes, expect) {
            Scan::Complete(length) => PendingFrame::Complete(length, last),
            Scan::Ambiguous if left => PendingFrame::Complete(ended(), last),
            Scan::Invalid(_) | Scan::Incomplete if left && !over => PendingFrame::Partial(Instant::NEVER),
            Scan::Invalid(length) => PendingFrame::Complete(length, last),
            _ if over || until <= now => PendingFrame::Complete(ended(), until.min(now)),
            Scan::Ambiguous => PendingFrame::Ambiguous(ended(), until),
            Scan::Incomplete => PendingFrame::Partial(until),
        }
    }

    /// The first bytes, up to a gap of `frame_timeout`.
    fn first_burst(&mut self, frame_timeout: Duration) -> ClientBytes<'_> {
        let bytes = &*self.bytes.make_contiguous();
        let mut count = 0;
        let mut last = self.arrivals.front().map_or(Instant::ZERO, |arrival| arrival.at);
        for arrival in &self.arrivals {
            if arrival.at.since(last) >= frame_timeout {
                return ClientBytes { bytes: &bytes[..count], last, over: true };
            }
            count += arrival.count;
            last = arrival.at;
        }
        ClientBytes { bytes, last, over: false }
    }
}
