//! Path of the speed reference from tick to tick: by ramps, and towards a target.

use fixed::types::I40F24;

use crate::motor::scaled;

/// At a larger distance no motor is so fast that it would have to brake, in counts.
pub(super) const FAR: i64 = 65_536;

/// By how much more than DEC a move may brake: the way that is left brakes it with DEC, but what came a tick
/// too late would run ahead of a ramp of the same steepness to the end, and past it.
const DECEL_MARGIN: i64 = 2;
/// Part of the current's braking that a move takes, in quarters: with all of it nothing would be left to correct an
/// error, and each move that brakes at the current limit would overshoot.
const BRAKE_QUARTERS: i64 = 3;

/// Speed and ramps, in counts, ticks and ticks².
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Limits {
    pub(super) speed: I40F24,
    pub(super) up: I40F24,
    pub(super) down: I40F24,
}

impl Limits {
    /// The same motion of the shaft, where a turn has `to` counts and not `from` any more.
    pub(super) fn rescaled(self, to: i64, from: i64) -> Self {
        let [speed, up, down] = [self.speed, self.up, self.down].map(|rate| scaled(rate, to, from));
        Self { speed, up, down }
    }

    /// The speed at the next tick: on from `setpoint` towards `target`.
    pub(super) fn ramped(self, setpoint: I40F24, target: I40F24) -> I40F24 {
        let (from, to, sign) = if setpoint < 0 { (-setpoint, -target, -1) } else { (setpoint, target, 1) };
        let next = if to >= from {
            to.min(from + self.up)
        } else {
            // Through 0 not before the next tick.
            if from > 0 { to.max(from - self.down).max(I40F24::ZERO) } else { to.max(-self.up) }
        };
        next * i64::from(sign)
    }

    /// The speed to go for with a `distance` to go, and the ramps to it, at a `speed` of which a current can take
    /// `max_deceleration` in a tick.
    pub(super) fn towards_target(
        self,
        distance: I40F24,
        speed: I40F24,
        max_deceleration: I40F24,
    ) -> (I40F24, Self) {
        let back = distance < 0;
        let (distance, speed) = if back { (-distance, -speed) } else { (distance, speed) };
        let down = self.down.min(max_deceleration - max_deceleration * (4 - BRAKE_QUARTERS) / 4);
        let most = braking_speed(distance - speed / 2, down).min(self.speed);
        (if back { -most } else { most }, Self { down: self.down * DECEL_MARGIN, ..self })
    }

    /// Returns whether it would overshoot: at `speed` there is less `distance` left than DEC, and a current that can take
    /// `max_deceleration` in a tick, need to stop. A motion the other way reverses first.
    pub(super) fn is_too_fast(self, distance: I40F24, speed: I40F24, max_deceleration: I40F24) -> bool {
        let goes_there = (speed > 0) == (distance > 0);
        goes_there && speed * speed > self.down.min(max_deceleration) * distance.abs() * 2
    }
}

/// The speed at the next tick from which the `distance` left then just suffices to stop: with v/2 until then
/// v/2 + v²/2·down is the way.
fn braking_speed(distance: I40F24, down: I40F24) -> I40F24 {
    let distance = distance.clamp(I40F24::ZERO, I40F24::const_from_int(FAR)).to_bits().cast_unsigned();
    let down = down.to_bits().cast_unsigned();
    let root = (2 * down * distance + down * down / 4).isqrt();
    I40F24::from_bits(root.saturating_sub(down / 2).cast_signed())
}
