//! State of a turning shaft, as a motor reports it to the control loop of its drive.

use drivetwin_protocol::time::TICKS_PER_SECOND;
use fixed::types::I40F24;

use super::interval::{MOST, MotionInterval};
use crate::device::Duration;

/// Angle, speed and acceleration of a motor's shaft at an instant. The acceleration lasts until the next report: while
/// the shaft turns that comes 65,536 ticks (4 ms) later at most.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Rotation {
    /// In 2⁻³² turns, forward; wraps.
    pub angle: i64,
    /// In 2⁻⁵⁶ turns a tick, at most 2⁴⁴ either way.
    pub speed: i64,
    /// In 2⁻⁶⁴ turns a tick², at most 2³⁶ either way.
    pub acceleration: i64,
}

impl Rotation {
    /// The state a span later, at most 4 ms. A shaft that slows down ends at rest and does not turn round.
    pub(super) fn after(self, span: Duration) -> Self {
        let moves = self.speed != 0 || self.acceleration != 0;
        let ticks = if moves { span.min(MotionInterval::LONGEST).ticks().cast_signed() } else { 0 };
        let gain = (self.acceleration * ticks) >> 8;
        let speed = self.speed + gain;
        let turned_round = self.speed.signum() * speed.signum() < 0;
        Self {
            angle: self.angle.wrapping_add(((2 * self.speed + gain) * ticks) >> 25),
            speed: if turned_round { 0 } else { speed.clamp(-MOST, MOST) },
            ..self
        }
    }

    /// Returns whether the difference to another rotation does not matter: the angle is the same to 2⁻²⁴ turns, the
    /// speed to 0.001 rpm.
    pub(super) fn is_like(self, other: Self) -> bool {
        const ANGLE: u64 = 1 << 8;
        const SPEED: u64 = 1 << 16;
        self.angle.wrapping_sub(other.angle).unsigned_abs() <= ANGLE
            && self.speed.abs_diff(other.speed) <= SPEED
    }

    /// The speed in rpm.
    pub(super) fn rpm(self) -> I40F24 {
        // 2⁻⁵⁶ turns a tick are 60·f·2⁻³² of 2⁻²⁴ rpm.
        const RATE: i64 = (60 * TICKS_PER_SECOND).cast_signed();
        I40F24::from_bits(((self.speed >> 11) * RATE) >> 21)
    }

    /// A report that is out of its range, from a trace, as one that is in it.
    #[must_use]
    pub fn limited(self) -> Self {
        Self {
            speed: self.speed.clamp(-MOST, MOST),
            acceleration: self
                .acceleration
                .clamp(-MotionInterval::MAX_ACCELERATION, MotionInterval::MAX_ACCELERATION),
            ..self
        }
    }
}
