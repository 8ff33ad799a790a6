//! Motion of a shaft with constant acceleration.

use super::{Kinematics, Rotation};
use crate::device::{Duration, Instant};

/// The greatest speed: 234,375 rpm. No motor is meant to reach it. It limits the speed of a shaft that a load
/// turns without power, or against a winding of so much resistance that it does not brake.
pub(super) const MOST: i64 = 1 << 44;

/// Motion of a shaft from an instant on. The direction never reverses inside an interval: a decreasing speed
/// ends at 0.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct MotionInterval {
    since: Instant,
    /// Angle in 2⁻³² turns; wraps.
    pub(super) angle: i64,
    /// Speed in 2⁻⁵⁶ turns per tick.
    pub(super) speed: i64,
    /// Acceleration in 2⁻⁶⁴ turns per tick².
    acceleration: i64,
    /// Duration; infinite only at standstill.
    length: Duration,
}

impl MotionInterval {
    /// The longest interval with motion. With this limit and those of [`Constants`](super::Constants) no
    /// number here exceeds 63 bits.
    pub(super) const LONGEST: Duration = Duration::from_ticks(1 << 16);
    /// The greatest acceleration.
    pub(super) const MAX_ACCELERATION: i64 = 1 << 36;

    /// A shaft at rest.
    pub(super) fn at_rest(since: Instant, angle: i64) -> Self {
        Self { since, angle, speed: 0, acceleration: 0, length: Duration::FOREVER }
    }

    /// The interval that starts in this state with the acceleration `acceleration`. It lasts `length`, or
    /// until standstill or the greatest speed.
    pub(super) fn with(self, acceleration: i64, length: Duration) -> Self {
        let fastest = MOST * acceleration.signum();
        let acceleration = if self.speed == fastest {
            0
        } else {
            acceleration.clamp(-Self::MAX_ACCELERATION, Self::MAX_ACCELERATION)
        };
        let lasting = Self { acceleration, ..self };
        let changes = match acceleration {
            0 => Duration::FOREVER,
            _ if lasting.slows() => Duration::from_ticks(lasting.ticks_to(0)),
            _ => Duration::from_ticks(lasting.ticks_to(fastest)),
        };
        Self { length: length.min(Self::LONGEST).min(changes), ..lasting }
    }

    /// Returns true if the acceleration is against the speed.
    fn slows(&self) -> bool {
        self.speed.signum() * self.acceleration.signum() < 0
    }

    /// Ticks until the shaft has the speed `speed`.
    fn ticks_to(&self, speed: i64) -> u64 {
        ((speed - self.speed).unsigned_abs() << 8).div_ceil(self.acceleration.unsigned_abs().max(1))
    }

    /// Time of standstill if the acceleration continues, also after the end of the interval; never if the
    /// shaft does not slow down.
    pub(super) fn stop_time(&self) -> Instant {
        if self.slows() { self.since + Duration::from_ticks(self.ticks_to(0)) } else { Instant::NEVER }
    }

    pub(super) fn since(&self) -> Instant {
        self.since
    }

    pub(super) fn end(&self) -> Instant {
        self.since + self.length
    }

    /// State at `at`, which is within the interval. The result can be the start of the next interval
    /// ([`with`](Self::with)).
    pub(super) fn at(&self, at: Instant) -> Self {
        let Rotation { angle, speed, .. } = self.rotation().after(at.since(self.since).min(self.length));
        Self { since: at, angle, speed, ..*self }
    }

    /// Rotation at the beginning of the interval.
    pub(super) fn rotation(&self) -> Rotation {
        Rotation { angle: self.angle, speed: self.speed, acceleration: self.acceleration }
    }

    /// Speed at the end of the interval.
    pub(super) fn last_speed(&self) -> i64 {
        self.at(self.end()).speed
    }

    /// State at `at`, which may be after the end of the interval. The acceleration continues until standstill
    /// or the greatest speed.
    pub(super) fn extrapolated_to(&self, at: Instant) -> Self {
        let last = if self.slows() { 0 } else { MOST * self.acceleration.signum() };
        let passed = at.since(self.since).ticks();
        let changing = if self.acceleration == 0 { passed } else { passed.min(self.ticks_to(last)) };
        let (steady, changing) = (i128::from(passed - changing), i128::from(changing));
        let gain = (i128::from(self.acceleration) * changing) >> 8;
        let way = ((2 * i128::from(self.speed) + gain) * changing + 2 * i128::from(last) * steady) >> 25;
        let speed = self.speed + gain as i64;
        let speed = match self.acceleration.signum() {
            1 => speed.min(last),
            -1 => speed.max(last),
            _ => speed,
        };
        Self { since: at, angle: self.angle.wrapping_add(way as i64), speed, ..*self }
    }

    /// The motion in the form for computations.
    pub(super) fn kinematics(&self) -> Kinematics {
        Kinematics {
            since: self.since,
            angle: self.angle,
            half_speed: self.speed << 8,
            half_acceleration: self.acceleration,
            turn: 1 << 65,
        }
    }

    /// The angle at `at`, which is not after the end of the interval.
    pub(super) fn angle_at(&self, at: Instant) -> i64 {
        self.at(at).angle
    }
}
