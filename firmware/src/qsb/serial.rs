//! Output on the line: one text behind the other (QSB-4).

use super::USB;
use super::registers::{FACTORY_LINE, line};
use crate::device::{Context, Duration, Instant, Line, Output};

/// The sending half of the port.
#[derive(Clone, Copy, Debug)]
pub(super) struct Serial {
    /// The rate of command A that was set.
    rate: Option<u8>,
    /// The time of a character; none on a line on which characters take none.
    character: Duration,
    fast: bool,
    /// Time at which all that was put has left.
    sent: Instant,
}

impl Serial {
    /// A free line; `fast`: characters take no time on it.
    pub(super) fn new(at: Instant, fast: bool) -> Self {
        Self { rate: None, character: Self::character(FACTORY_LINE, fast), fast, sent: at }
    }

    fn character(line: Line, fast: bool) -> Duration {
        if fast { Duration::ZERO } else { line.character() }
    }

    /// Time at which the line is free.
    pub(super) fn free_at(&self) -> Instant {
        self.sent
    }

    /// Sends a text at once, or behind all that is still leaving.
    pub(super) fn send(&mut self, at: Instant, bytes: &[u8], out: &mut dyn Context) {
        let from = self.sent.max(at);
        out.put(from, Output::Bytes { port: USB, bytes });
        self.sent = from + self.character * bytes.len() as u64;
    }

    /// Forgets the characters that are still leaving; they leave all the same.
    pub(super) fn clear(&mut self) {
        self.sent = Instant::ZERO;
    }

    /// Changes to a rate of command A behind all that is still leaving, unless that is set.
    pub(super) fn set_rate(&mut self, at: Instant, rate: u8, out: &mut dyn Context) {
        if self.rate == Some(rate) {
            return;
        }
        self.rate = Some(rate);
        let line = line(rate);
        self.character = Self::character(line, self.fast);
        out.put(self.sent.max(at), Output::Line { port: USB, line });
    }
}
