//! What two sensors a quarter of a period apart see of a shaft.

use fixed::types::I48F16;

use super::Stretch;
use crate::device::{Duration, Instant, Level, Output, Pin, Sink};
use standin_protocol::time::TICKS_PER_SECOND;

/// Two sensors on a shaft. A count is a quarter of their period; both are high in count 0, and going forward
/// A changes first.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Wheel {
    /// In a turn; 0 if there are no sensors.
    counts: u32,
    /// The count that they show.
    at: i64,
}

impl Wheel {
    /// Sensors of so many pulses a turn, at count 0.
    pub(super) fn new(pulses: u16) -> Self {
        Self { counts: 4 * u32::from(pulses), at: 0 }
    }

    /// Others, at the same count.
    pub(super) fn with_pulses(self, pulses: u16) -> Self {
        Self { at: self.at, ..Self::new(pulses) }
    }

    /// These, showing what is at `angle`.
    pub(super) fn moved_to(self, angle: i64) -> Self {
        Self { at: self.count(angle), ..self }
    }

    /// The angle in the middle of the count that they show.
    pub(super) fn middle(self) -> i64 {
        let turns = self.at.checked_div_euclid(self.counts.into()).unwrap_or(0);
        let part = self.at.checked_rem_euclid(self.counts.into()).unwrap_or(0);
        let part = ((2 * part + 1) << 31).checked_div(self.counts.into()).unwrap_or(0);
        (turns << 32).wrapping_add(part)
    }

    /// The count at `angle`.
    pub(super) fn count(self, angle: i64) -> i64 {
        let counts = i64::from(self.counts);
        let part = angle & 0xFFFF_FFFF;
        (angle >> 32).wrapping_mul(counts).wrapping_add((part * counts) >> 32)
    }

    /// A speed in 2⁻⁵⁶ turns a tick in counts per second.
    pub(super) fn counts_per_second(self, speed: i64) -> I48F16 {
        /// 2⁻⁵⁶ turns a tick are f·2⁻⁴⁰ of 2⁻¹⁶ turns a second.
        const RATE: i64 = TICKS_PER_SECOND.cast_signed() >> 10;
        I48F16::from_bits((((speed >> 14) * RATE) >> 16).saturating_mul(self.counts.into()))
    }

    /// The first tick from `from` on at which the shaft is at another count than they show.
    pub(super) fn next_edge(self, stretch: &Stretch, from: Instant) -> Instant {
        let is_here = |at: Instant| self.count(stretch.angle_at(at)) == self.at;
        if self.counts == 0 || is_here(stretch.end()) {
            return Instant::NEVER;
        }
        let (mut first, mut last) = (0, stretch.end().since(from).ticks());
        while first < last {
            let middle = first + (last - first) / 2;
            if is_here(from + Duration::from_ticks(middle)) { first = middle + 1 } else { last = middle }
        }
        from + Duration::from_ticks(first)
    }

    /// Goes on to the next count towards `angle`, if it is not there.
    pub(super) fn follow(&mut self, angle: i64) {
        self.at = self.at.wrapping_add(self.count(angle).wrapping_sub(self.at).signum());
    }

    /// Puts what sensor A, sensor B and an index show, where there are pins for them and it is not what they
    /// showed `before`. The index is high in the first count of every turn.
    pub(super) fn show(self, at: Instant, before: Option<Self>, pins: &[Pin], out: &mut dyn Sink) {
        let before = before.map(Self::shown);
        let shown = self.shown().into_iter().enumerate();
        for ((place, high), &pin) in shown.zip(pins).filter(|_| self.counts > 0) {
            if before.and_then(|before| before.get(place).copied()) != Some(high) {
                out.put(at, Output::Level { pin, level: if high { Level::High } else { Level::Low } });
            }
        }
    }

    fn shown(self) -> [bool; 3] {
        let index = self.at.checked_rem_euclid(self.counts.into()) == Some(0);
        [matches!(self.at & 3, 0 | 3), matches!(self.at & 3, 0 | 1), index]
    }
}
