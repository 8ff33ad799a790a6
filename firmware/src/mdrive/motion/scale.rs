//! Steps of the motor and counts of the encoder. With EE = 1 the user's units are counts (MC 7.3.7).

use fixed::types::{I24F8, I48F16, U24F8};

use super::Settings;
use crate::motion::{Limits, MAX_ACCELERATION};

/// Ratio of steps to counts.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) struct Scale {
    pub(super) steps: i64,
    pub(super) counts: i64,
}

impl Settings {
    pub(super) fn scale(&self) -> Scale {
        if self.closed { self.closed_scale() } else { Scale { steps: 1, counts: 1 } }
    }

    /// Scale with EE = 1.
    pub(in crate::mdrive) fn closed_scale(&self) -> Scale {
        let steps = i64::from(self.machine.steps_per_rev) * i64::from(self.microsteps);
        Scale { steps, counts: 4 * i64::from(self.lines.max(1)) }
    }

    /// VI, VM, A and D, converted to steps.
    pub(super) fn rates(&self) -> Limits {
        let scale = self.scale();
        Limits {
            start_speed: scale.speed(self.start),
            max_speed: scale.speed(self.speed),
            acceleration: scale.acceleration(self.up),
            deceleration: scale.acceleration(self.down),
        }
    }
}

impl Scale {
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

    fn acceleration(self, acceleration: u32) -> u32 {
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
