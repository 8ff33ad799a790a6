//! Request boundaries: where a request ends in the bytes of a client, and when it is complete.
//!
//! The gaps between bytes on a pty or TCP connection say nothing, so the check sum and the length of the function
//! decide ([`modbus::scan`]), and after them patience.

use drivetwin_firmware::device::{Duration, Instant, Line};
use drivetwin_protocol::modbus::{self, Expect, Scan};

use super::ClientState;

/// Bytes of a client that came without a silence beyond patience.
struct ClientBytes<'a> {
    bytes: &'a [u8],
    /// Time at which the last of them came.
    last: Instant,
    /// True if more came after such a silence.
    over: bool,
}

/// Bytes of a client that are ready for the line.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum PendingFrame {
    /// So many bytes are to be sent, as from then on.
    Message(usize, Instant),
    /// Half a message, whose rest is waited for until then.
    Half(Instant),
    /// So many bytes, if no more follow until then.
    Unsure(usize, Instant),
}

impl ClientState {
    /// Returns what is ready for a line at `now`. On a line of Modbus, `framed`, that is a message, cut where its
    /// checksum holds or in ASCII behind its line feed; a burst that cannot become one is sent as it is. Elsewhere it
    /// is a character.
    pub(crate) fn offer(&mut self, now: Instant, framed: Option<Line>, patience: Duration) -> PendingFrame {
        let Some(line) = framed else {
            return PendingFrame::Message(1, self.arrivals.front().map_or(now, |arrival| arrival.at));
        };
        // Behind a port that paces itself is a real line, on which other drives may answer.
        let expect = if self.paces_itself { Expect::Both } else { Expect::Requests };
        let left = self.left;
        let ClientBytes { bytes, last, over } = self.first_burst(patience);
        let ended = || modbus::ended(line, bytes, expect);
        let until = last + patience;
        match modbus::scan(line, bytes, expect) {
            Scan::Complete(length) => PendingFrame::Message(length, last),
            Scan::Ambiguous if left => PendingFrame::Message(ended(), last),
            Scan::Invalid(_) | Scan::Incomplete if left && !over => PendingFrame::Half(Instant::NEVER),
            Scan::Invalid(length) => PendingFrame::Message(length, last),
            _ if over || until <= now => PendingFrame::Message(ended(), until.min(now)),
            Scan::Ambiguous => PendingFrame::Unsure(ended(), until),
            Scan::Incomplete => PendingFrame::Half(until),
        }
    }

    /// The first bytes, up to a silence beyond `patience`.
    fn first_burst(&mut self, patience: Duration) -> ClientBytes<'_> {
        let bytes = &*self.bytes.make_contiguous();
        let mut count = 0;
        let mut last = self.arrivals.front().map_or(Instant::ZERO, |arrival| arrival.at);
        for arrival in &self.arrivals {
            if arrival.at.since(last) >= patience {
                return ClientBytes { bytes: &bytes[..count], last, over: true };
            }
            count += arrival.count;
            last = arrival.at;
        }
        ClientBytes { bytes, last, over: false }
    }
}
