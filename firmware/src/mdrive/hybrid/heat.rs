//! Temperature of the electronics (MC 5-38, 5-81). The manual gives a figure for WT only; the other values
//! are ours.

use crate::device::{Duration, Instant};
use drivetwin_protocol::time::TICKS_PER_SECOND;

/// Temperatures in normal operation and when overheated, in m°C.
const COOL: i64 = 40_000;
const HOT: i64 = 95_000;
/// Rate of change, in m°C/s.
const PER_SECOND: i64 = 10_000;
/// Temperature at which the bridge is switched off, in °C: 10 °C above the factory's warning temperature (MC
/// 9.5, error 71).
pub(super) const SHUTDOWN: i64 = 90;

/// Model of the temperature: a linear rise or fall between two limits.
#[derive(Clone, Copy, Debug)]
pub(super) struct Heat {
    /// True while the cause of heat is present.
    heats: bool,
    /// Temperature when that cause appeared or disappeared, in m°C.
    from: i64,
    since: Instant,
}

impl Heat {
    pub(super) const COOL: Self = Self { heats: false, from: COOL, since: Instant::ZERO };

    /// Switches the cause of heat on or off.
    pub(super) fn set(&mut self, at: Instant, heats: bool) {
        *self = Self { heats, from: self.milli(at), since: at };
    }

    /// IT, in °C.
    pub(super) fn celsius(&self, at: Instant) -> i64 {
        self.milli(at) / 1_000
    }

    /// Time at which the temperature rises to this value in °C, or falls below it; [`Instant::NEVER`] if it
    /// does neither.
    pub(super) fn passes(&self, celsius: i64) -> Instant {
        let way = if self.heats { celsius * 1_000 - self.from } else { self.from - celsius * 1_000 + 1 };
        let left = if self.heats { HOT - self.from } else { self.from - COOL };
        match u64::try_from(way) {
            Ok(way) if way.cast_signed() <= left && way > 0 => {
                let ticks = (way * TICKS_PER_SECOND).div_ceil(PER_SECOND.unsigned_abs());
                self.since + Duration::from_ticks(ticks)
            }
            _ => Instant::NEVER,
        }
    }

    fn milli(&self, at: Instant) -> i64 {
        let ticks = at.since(self.since).ticks().min(3_600 * TICKS_PER_SECOND).cast_signed();
        let way = ticks * PER_SECOND / TICKS_PER_SECOND.cast_signed();
        if self.heats { (self.from + way).min(HOT) } else { (self.from - way).max(COOL) }
    }
}
