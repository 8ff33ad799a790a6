//! Steps of the motor and counts of the encoder. With EE = 1 the user's units are counts (MC 7.3.7).

use fixed::types::{I24F8, I48F16, U24F8};

use crate::motion::MAX_ACCELERATION;

/// Ratio of steps to counts.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) struct Scale {
    steps: i64,
    counts: i64,
}

impl Scale {
    /// Scale with EE = 0: the unit is a step.
    pub(super) const STEPS: Self = Self { steps: 1, counts: 1 };

    /// Scale with EE = 1, for a motor of so many full steps and an encoder of so many lines, each of which is four
    /// counts.
    pub(in crate::mdrive) fn of_encoder(full_steps: u16, microsteps: u16, lines: u16) -> Self {
        Self { steps: i64::from(full_steps) * i64::from(microsteps), counts: 4 * i64::from(lines.max(1)) }
    }

    /// Lag of the encoder behind the steps: steps times the counts of a revolution, minus counts times its steps.
    pub(super) fn lag(self, steps: i32, counts: i32) -> i64 {
        i64::from(steps) * self.counts - i64::from(counts) * self.steps
    }

    /// Steps at which [`Self::lag`] reaches `lag`, if the encoder does not move; `None` if they have more than 64
    /// bits.
    pub(super) fn steps_of_lag(self, lag: i64) -> Option<i64> {
        lag.checked_add(self.counts - 1)?.checked_div(self.counts)
    }

    /// Converts from steps to counts: A or D to counts/s², VI or VM to counts/s.
    pub(in crate::mdrive) fn in_counts(self, value: i64) -> i64 {
        (value * self.counts).checked_div(self.steps).unwrap_or(0)
    }

    /// Converts from counts to steps: A or D to steps/s², VI or VM to steps/s.
    pub(in crate::mdrive) fn in_steps(self, value: i64) -> i64 {
        (value * self.steps).checked_div(self.counts).unwrap_or(0)
    }

    /// First step at which an encoder shows `counts`, if step 0 is at count 0.
    pub(super) fn first_step(self, counts: i64) -> i64 {
        let down = (-counts * self.steps).checked_div_euclid(self.counts);
        down.unwrap_or(0).wrapping_neg()
    }

    /// Converts a speed in the user's unit to steps/s.
    pub(super) fn speed(self, speed: u32) -> U24F8 {
        let bits = (i64::from(speed) << 8) * self.steps;
        let bits = bits.checked_div(self.counts).unwrap_or(0);
        U24F8::from_bits(u32::try_from(bits).unwrap_or(u32::MAX))
    }

    /// Converts a speed with a sign in the user's unit to steps/s.
    pub(super) fn signed_speed(self, speed: i32) -> I24F8 {
        let size = I24F8::saturating_from_num(self.speed(speed.unsigned_abs()));
        if speed < 0 { -size } else { size }
    }

    /// Converts an acceleration in the user's unit to steps/s².
    pub(super) fn acceleration(self, acceleration: u32) -> u32 {
        let scaled = (i64::from(acceleration) * self.steps).checked_div(self.counts).unwrap_or(0);
        u32::try_from(scaled).unwrap_or(u32::MAX).clamp(1, MAX_ACCELERATION)
    }

    /// Converts a speed of the motor to the user's unit, rounded.
    pub(super) fn speed_in_counts(self, speed: I48F16) -> i32 {
        let scaled = i128::from(speed.to_bits().unsigned_abs()) * i128::from(self.counts);
        let unit = i128::from(self.steps) << 16;
        let size = (scaled + unit / 2).checked_div(unit).unwrap_or(0);
        let size = i32::try_from(size).unwrap_or(i32::MAX);
        if speed < 0 { -size } else { size }
    }
}
