//! Motion of an axis at any time, from the commands of its drive.

use drivetwin_firmware::device::{Duration, Instant, Plan, Shaft};
use fixed::types::I48F16;

/// Motion of an axis at an instant, returned by [`Bench::motion`](crate::bench::Bench::motion).
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Motion {
    /// Position in steps or counts since the first power-on.
    pub position: i32,
    /// Speed in steps or counts per second, signed.
    pub speed: I48F16,
    /// True while the axis moves.
    pub moving: bool,
    /// Peak phase current in mA; for a motor model the current that it draws.
    pub current_ma: u32,
    /// Duty of a motor without steps, signed, in 1/65536 of full on.
    pub duty: i32,
}

impl From<Shaft> for Motion {
    fn from(shaft: Shaft) -> Self {
        Self {
            position: shaft.position,
            speed: shaft.speed,
            moving: shaft.speed != 0,
            current_ma: shaft.ma.unsigned_abs(),
            duty: shaft.duty,
        }
    }
}

/// Distance of two samples of a motion.
pub const SAMPLE: Duration = Duration::millis(1);

/// Commands of a drive to an axis.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Commanded {
    pub(crate) plan: Plan,
    /// Steps made without a plan since the last plan.
    pub(crate) steps: i32,
    pub(crate) current_ma: u32,
    pub(crate) duty: i32,
}

impl Commanded {
    /// Standstill at position 0 without current.
    pub(crate) fn at_rest(at: Instant) -> Self {
        Self { plan: Plan::at_rest(at, 0), steps: 0, current_ma: 0, duty: 0 }
    }

    /// Follows `plan`.
    pub(crate) fn follow(&mut self, plan: &Plan) {
        (self.plan, self.steps) = (*plan, 0);
    }

    /// Makes steps without a plan; negative steps go backward.
    pub(crate) fn step(&mut self, steps: i32) {
        self.steps = self.steps.wrapping_add(steps);
    }

    /// Stops at `at`, without current.
    pub(crate) fn power_off(&mut self, at: Instant) {
        (self.plan, self.current_ma, self.duty) = (self.plan.halt(at), 0, 0);
    }

    /// The motion at `at`.
    pub(crate) fn motion(&self, at: Instant) -> Motion {
        Motion {
            position: self.plan.position_at(at).wrapping_add(self.steps),
            speed: self.plan.speed_at(at),
            moving: self.plan.end() > at || self.duty != 0,
            current_ma: self.current_ma,
            duty: self.duty,
        }
    }

    /// Time of the next sample after `at`: the next whole multiple of `every`, or the next begin or end of
    /// a segment of the plan. [`Instant::NEVER`] if the axis stands from `at` on.
    pub(crate) fn next_sample(&self, at: Instant, every: Duration) -> Instant {
        let start = self.plan.start();
        if at < start {
            return start;
        }
        let mut end = start;
        for segment in self.plan.segments() {
            end += Duration::from_ticks(segment.ticks);
            if at < end {
                let raster = (at.ticks() / every.ticks().max(1) + 1).saturating_mul(every.ticks());
                return end.min(Instant::from_ticks(raster));
            }
        }
        Instant::NEVER
    }
}

/// Chooses the states of a motor that are recorded. Between two states there is at least [`SAMPLE`], at a steady
/// speed ten times that, except when the shaft starts, stops, or stands. A shaft that turns is looked at again after 4 ms at most
/// ([`Rotation`](drivetwin_firmware::device::Rotation)), so the last state is never missed.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Sampler {
    last: Option<(Instant, Shaft)>,
}

impl Sampler {
    /// Returns true if the state at `at` is to be recorded.
    pub(crate) fn takes(&mut self, at: Instant, shaft: Shaft) -> bool {
        let is_due = self.last.is_none_or(|(since, last)| {
            let is_steady = (shaft.speed - last.speed).abs() < last.speed.abs() / 64;
            let pause = SAMPLE * if is_steady { 10 } else { 1 };
            last != shaft && (last.speed == 0 || shaft.speed == 0 || at >= since + pause)
        });
        if is_due {
            self.last = Some((at, shaft));
        }
        is_due
    }
}

#[cfg(test)]
mod tests {
    use drivetwin_firmware::motion::Limits;
    use drivetwin_protocol::time::Span;
    use fixed::types::U24F8;

    use super::*;

    #[test]
    fn samples_are_on_the_millisecond_and_at_the_ends_of_segments() {
        let mut axis = Commanded::at_rest(Instant::ZERO);
        assert_eq!(axis.next_sample(Instant::ZERO, SAMPLE), Instant::NEVER);
        // Ramps of 2.5 ms and 25/2 steps, and a cruise of 1 ms.
        let start = Instant::from_ticks(8_000);
        axis.follow(&Plan::profile(start, 0, 35, Limits::even(U24F8::from_num(10_000), 4_000_000)));
        let (mut at, mut samples) = (Instant::ZERO, Vec::new());
        while at < Instant::NEVER {
            at = axis.next_sample(at, SAMPLE);
            samples.push(at.ticks());
        }
        let half_millis = [1, 2, 4, 6, 8, 10, 12, 13];
        let expected: Vec<u64> = half_millis.iter().map(|half| half * 500.micros().ticks()).collect();
        assert_eq!(samples[..samples.len() - 1], expected[..]);
    }
}
