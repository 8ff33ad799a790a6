//! Request boundaries: where a request ends in the bytes of a client, and at which time it is complete.
//!
//! On a pty or TCP connection, gaps between bytes carry no information. The end of a request is determined by
//! its checksum and by the length that its function code implies ([`modbus::scan`]), otherwise by a timeout.

use drivetwin_firmware::device::{Duration, Instant, Line};
use drivetwin_protocol::modbus::{self, Expect, Scan};

use super::ClientState;

/// Bytes of a client up to the first gap that is as long as the frame timeout.
struct ClientBytes<'a> {
    bytes: &'a [u8],
    /// Arrival time of the last of these bytes.
    last: Instant,
    /// True if more bytes have arrived after the gap.
    over: bool,
}

/// Frame that the waiting bytes of a client form.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum PendingFrame {
    /// A frame of that many bytes, complete since that instant.
    Complete(usize, Instant),
    /// A partial frame. The line waits for the rest until that instant.
    Partial(Instant),
    /// A frame of that many bytes, if no more bytes follow by that instant.
    Ambiguous(usize, Instant),
}

impl ClientState {
    /// Returns the next frame of the client for a line at `now`. On a Modbus line (`framed`), a frame ends
    /// where its checksum is valid, or in ASCII after its line feed. A burst that cannot become a frame is
    /// sent unchanged. On other lines a frame is a single character.
    pub(crate) fn next_frame(
        &mut self,
        now: Instant,
        framed: Option<Line>,
        frame_timeout: Duration,
    ) -> PendingFrame {
        let Some(line) = framed else {
            return PendingFrame::Complete(1, self.arrivals.front().map_or(now, |arrival| arrival.at));
        };
        // A port that times characters itself is a real serial line, on which other drives may answer.
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

    /// The first bytes, up to a gap of at least `frame_timeout`.
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
