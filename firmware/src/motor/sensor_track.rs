//! Levels of the sensors around a shaft: two sensors a quarter of a period apart, or three sensors a third
//! apart.

use fixed::types::I48F16;

use super::{MotionInterval, Parameters, Report, Reports, Sensor};
use crate::device::{Duration, Instant};
use drivetwin_protocol::time::TICKS_PER_SECOND;

const HALLS: [Sensor; super::HALLS] = [Sensor::Hall(0), Sensor::Hall(1), Sensor::Hall(2)];
const ENCODER: [Sensor; 3] = [Sensor::EncoderA, Sensor::EncoderB, Sensor::Index];

/// Sensors on a shaft. A count lasts from an edge of any sensor to the next edge of any sensor. A period has
/// four or six counts.
///
/// With two sensors both are high in count 0, and in forward direction A changes first. With three sensors
/// the levels of A, B, C are 101 in count 0, and then in forward direction 100, 110, 010, 011, 001.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct SensorTrack {
    /// Counts per turn; 0 if there are no sensors.
    counts: u32,
    /// The sensors, and the index of an encoder.
    sensors: &'static [Sensor],
    /// True with three sensors, false with two.
    three: bool,
    /// The count that the sensors show.
    at: i64,
}

impl SensorTrack {
    /// Channels A and B of an encoder with `cycles` cycles per turn, at count 0.
    pub(super) fn encoder(cycles: u16) -> Self {
        Self { counts: 4 * u32::from(cycles), sensors: &ENCODER, three: false, at: 0 }
    }

    /// The Hall sensors of a motor, at count 0.
    pub(super) fn halls(parameters: &Parameters) -> Self {
        let sensors = parameters.sensors();
        Self {
            counts: 2 * u32::from(sensors) * u32::from(parameters.pulses()),
            sensors: HALLS.get(..sensors.into()).unwrap_or(&HALLS),
            three: parameters.is_brushless(),
            at: 0,
        }
    }

    /// These sensors, at the count that `other` shows.
    pub(super) fn at_count_of(self, other: Self) -> Self {
        Self { at: other.at, ..self }
    }

    /// These sensors, at the count of `angle`.
    pub(super) fn moved_to(self, angle: i64) -> Self {
        Self { at: self.count(angle), ..self }
    }

    /// The angle in the middle of the count that the sensors show.
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

    /// Speed in counts per second, for a speed in 2⁻⁵⁶ turns per tick.
    pub(super) fn counts_per_second(self, speed: i64) -> I48F16 {
        /// 2⁻⁵⁶ turns per tick are f·2⁻⁴⁰ times 2⁻¹⁶ turns per second.
        const RATE: i64 = TICKS_PER_SECOND.cast_signed() >> 10;
        I48F16::from_bits((((speed >> 14) * RATE) >> 16).saturating_mul(self.counts.into()))
    }

    /// The first tick from `from` on at which the shaft is at another count than the sensors show.
    pub(super) fn next_edge(self, interval: &MotionInterval, from: Instant) -> Instant {
        let is_here = |at: Instant| self.count(interval.angle_at(at)) == self.at;
        if self.counts == 0 || is_here(interval.end()) {
            return Instant::NEVER;
        }
        let (mut first, mut last) = (0, interval.end().since(from).ticks());
        while first < last {
            let middle = first + (last - first) / 2;
            if is_here(from + Duration::from_ticks(middle)) { first = middle + 1 } else { last = middle }
        }
        from + Duration::from_ticks(first)
    }

    /// Moves the sensors to the next count in the direction of `angle`, unless they show the count of
    /// `angle`.
    pub(super) fn step_towards(&mut self, angle: i64) {
        self.at = self.at.wrapping_add(self.count(angle).wrapping_sub(self.at).signum());
    }

    /// Reports the levels that differ from those of `before`, or all levels if `before` is `None`. The index is high in
    /// the third count of every turn, when A and B are low.
    pub(super) fn report(self, at: Instant, before: Option<Self>, out: &mut dyn Reports) {
        if self.counts == 0 {
            return;
        }
        let before = before.map(Self::levels);
        for (&sensor, (place, high)) in self.sensors.iter().zip(self.levels().into_iter().enumerate()) {
            if before.and_then(|before| before.get(place).copied()) != Some(high) {
                out.report(at, Report::Level(sensor, high));
            }
        }
    }

    fn levels(self) -> [bool; 3] {
        if self.three {
            let count = self.at.rem_euclid(6);
            return [matches!(count, 0..=2), matches!(count, 2..=4), matches!(count, 0 | 4 | 5)];
        }
        let index = self.at.checked_rem_euclid(self.counts.into()) == Some(2);
        [matches!(self.at & 3, 0 | 3), matches!(self.at & 3, 0 | 1), index]
    }
}
