//! Serial lines: whose turn it is, and when each character is where.

use standin_firmware::device::Line;
use standin_protocol::line::Parity;

/// How long characters take.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum LineMode {
    /// Their time at the line's rate.
    #[default]
    Timed,
    /// None, for load tests: a frame and its end come at one instant, replies leave at once.
    Fast,
}

/// What is known of the settings of a sender's port; what is `None` fits every line.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Sender {
    /// Bits per second.
    pub baud: Option<u32>,
    /// Stop bits.
    pub stop: Option<u8>,
    /// Whether it asks for odd parity; a pty does not tell more of it.
    pub odd: Option<bool>,
}

impl Sender {
    /// Whether a drive on `line` can read it.
    #[must_use]
    pub fn fits(self, line: Line) -> bool {
        self.baud.is_none_or(|baud| baud == line.baud)
            && self.stop.is_none_or(|stop| stop == line.stop)
            && self.odd.is_none_or(|odd| odd == (line.parity == Parity::Odd))
    }
}
