//! Request boundaries: where a request ends in the bytes of a client, and when it is complete.
//!
//! The gaps between bytes on a pty or TCP connection say nothing, so the check sum and the length of the function
//! decide ([`modbus::front`]), and after them patience.

use drivetwin_firmware::device::{Duration, Instant, Line};
use drivetwin_protocol::modbus::{self, Burst, Voices};

use super::Outside;

/// Bytes of a client that came without a silence beyond patience.
struct Spoken<'a> {
    bytes: &'a [u8],
    /// Time at which the last of them came.
    last: Instant,
    /// True if more came after such a silence.
    over: bool,
}

/// Bytes of a client that are ready for the line.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Offer {
    /// So many bytes are to be sent, as from then on.
    Message(usize, Instant),
    /// Half a message, whose rest is waited for until then.
    Half(Instant),
    /// So many bytes, if no more follow until then.
    Unsure(usize, Instant),
}

impl Outside {
    /// Returns what is ready for a line at `now`. On a line of Modbus, `framed`, that is a message, cut where its
    /// checksum holds or in ASCII behind its line feed; a burst that cannot become one is sent as it is. Elsewhere it
    /// is a character.
    pub(crate) fn offer(&mut self, now: Instant, framed: Option<Line>, patience: Duration) -> Offer {
        let Some(line) = framed else {
            return Offer::Message(1, self.arrivals.front().map_or(now, |arrival| arrival.at));
        };
        // Behind a port that paces itself is a real line, on which other drives may answer.
        let voices = if self.paces_itself { Voices::All } else { Voices::Master };
        let left = self.left;
        let Spoken { bytes, last, over } = self.first_burst(patience);
        let ended = || modbus::ended(line, bytes, voices);
        let until = last + patience;
        match modbus::front(line, bytes, voices) {
            Burst::Frame(length) => Offer::Message(length, last),
            Burst::Unsure if left => Offer::Message(ended(), last),
            Burst::Broken(_) | Burst::Partial if left && !over => Offer::Half(Instant::NEVER),
            Burst::Broken(length) => Offer::Message(length, last),
            _ if over || until <= now => Offer::Message(ended(), until.min(now)),
            Burst::Unsure => Offer::Unsure(ended(), until),
            Burst::Partial => Offer::Half(until),
        }
    }

    /// The first bytes, up to a silence beyond `patience`.
    fn first_burst(&mut self, patience: Duration) -> Spoken<'_> {
        let bytes = &*self.bytes.make_contiguous();
        let mut count = 0;
        let mut last = self.arrivals.front().map_or(Instant::ZERO, |arrival| arrival.at);
        for arrival in &self.arrivals {
            if arrival.at.since(last) >= patience {
                return Spoken { bytes: &bytes[..count], last, over: true };
            }
            count += arrival.count;
            last = arrival.at;
        }
        Spoken { bytes, last, over: false }
    }
}
