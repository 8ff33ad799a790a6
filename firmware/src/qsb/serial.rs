//! Output on the serial line: texts are sent one after the other (QSB-4).

use super::USB;
use super::registers::{FACTORY_LINE, line};
use crate::device::{Context, Duration, Instant, Line, Output};

/// The sending part of the port.
#[derive(Clone, Copy, Debug)]
pub(super) struct Serial {
    /// The code of the baud rate that was set last.
    rate: Option<u8>,
    /// Time of a character; zero if characters take no time on this line.
    character: Duration,
    fast: bool,
    /// Time at which the last character put so far has been sent.
    sent: Instant,
}

impl Serial {
    /// A free line. If `fast` is true, characters take no time.
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

    /// Sends a text at once, or after all earlier texts.
    pub(super) fn send(&mut self, at: Instant, bytes: &[u8], out: &mut dyn Context) {
        let from = self.sent.max(at);
        out.put(from, Output::Bytes { port: USB, bytes });
        self.sent = from + self.character * bytes.len() as u64;
    }

    /// Treats the line as free. Texts put earlier are still sent.
    pub(super) fn clear(&mut self) {
        self.sent = Instant::ZERO;
    }

    /// Changes the baud rate after all earlier texts, if it differs from the present one.
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
