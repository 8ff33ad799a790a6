//! State of a turning shaft, as a motor reports it to the control loop of its drive.

use drivetwin_protocol::time::TICKS_PER_SECOND;
use fixed::types::I40F24;

use super::interval::{MOST, MotionInterval};
use crate::device::Duration;

/// Angle, speed and acceleration of a motor's shaft at an instant. The acceleration lasts until the next
/// report. While the shaft turns, the next report follows after 65,536 ticks (4 ms) at most.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Rotation {
    /// Angle in 2⁻³² turns, forward; wraps.
    pub angle: i64,
    /// Speed in 2⁻⁵⁶ turns per tick, at most 2⁴⁴ in either direction.
    pub speed: i64,
    /// Acceleration in 2⁻⁶⁴ turns per tick², at most 2³⁶ in either direction.
    pub acceleration: i64,
}

impl Rotation {
    /// The state after `span`, which is 4 ms at most. A shaft that slows down stops and does not reverse.
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

    /// Returns true if the difference from `other` does not matter: the angles differ by 2⁻²⁴ turns at most,
    /// the speeds by 0.001 rpm.
    pub(super) fn is_like(self, other: Self) -> bool {
        const ANGLE: u64 = 1 << 8;
        const SPEED: u64 = 1 << 16;
        self.angle.wrapping_sub(other.angle).unsigned_abs() <= ANGLE
            && self.speed.abs_diff(other.speed) <= SPEED
    }

    /// The speed in rpm.
    pub(super) fn rpm(self) -> I40F24 {
        // With f ticks per second, a speed of 2⁻⁵⁶ turns per tick is 60·f·2⁻⁵⁶ rpm. This is 60·f·2⁻³² in the
        // unit of the result, 2⁻²⁴ rpm.
        const RATE: i64 = (60 * TICKS_PER_SECOND).cast_signed();
        I40F24::from_bits(((self.speed >> 11) * RATE) >> 21)
    }

    /// Limits a report, which may come from a trace, to the allowed range.
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
