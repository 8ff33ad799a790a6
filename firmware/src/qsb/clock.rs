//! The clock of 512 Hz. It starts at each reset.

use crate::device::{Duration, Instant};

/// Period of the clock: 1/512 s, exactly.
pub(super) const TICK: Duration = Duration::from_ticks(31_250);
/// Unit of the timestamp in an analogue packet.
const HALF_MILLISECOND: Duration = Duration::micros(500);

/// Time since the reset, and TIME STAMP.
#[derive(Clone, Copy, Debug)]
pub(super) struct Clock {
    reset: Instant,
    /// Value of `ticks` at which TIME STAMP is 0.
    zero: u32,
}

impl Clock {
    pub(super) fn new(at: Instant) -> Self {
        Self { reset: at, zero: 0 }
    }

    /// Number of whole ticks since the reset.
    pub(super) fn ticks(self, at: Instant) -> u64 {
        at.since(self.reset) / TICK
    }

    /// Time at which `ticks` ticks have passed since the reset.
    pub(super) fn instant(self, ticks: u64) -> Instant {
        self.reset + TICK * ticks
    }

    /// Present value of TIME STAMP.
    pub(super) fn timestamp(self, at: Instant) -> u32 {
        (self.ticks(at) as u32).wrapping_sub(self.zero)
    }

    /// Sets TIME STAMP; the time of the next tick does not change (QSB-10).
    pub(super) fn set_timestamp(&mut self, at: Instant, number: u32) {
        self.zero = (self.ticks(at) as u32).wrapping_sub(number);
    }

    /// The timestamp of an analogue packet.
    pub(super) fn half_milliseconds(self, at: Instant) -> u16 {
        (at.since(self.reset) / HALF_MILLISECOND) as u16
    }
}
