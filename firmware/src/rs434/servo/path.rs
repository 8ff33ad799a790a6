//! The speed reference from tick to tick: by ramps, and towards a target.

use fixed::types::I40F24;

use crate::motor::{ramped, scaled};

/// A distance in counts beyond which no motor is so fast that it must already brake.
pub(super) const FAR: i64 = 65_536;

/// Factor by which a move may brake harder than DEC. The remaining distance makes the move brake with DEC.
/// But if the speed falls a tick behind, a ramp that is limited to DEC as well would never catch up, and the
/// move would run past its end.
const DECEL_MARGIN: i64 = 2;
/// Part of the deceleration at the current limit that a move uses, in quarters. With the whole deceleration
/// there would be no reserve to correct an error, and each move that brakes at the current limit would
/// overshoot.
const BRAKE_QUARTERS: i64 = 3;

/// Speed in counts per tick, and ramps in counts per tick².
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Limits {
    pub(super) speed: I40F24,
    pub(super) up: I40F24,
    pub(super) down: I40F24,
}

impl Limits {
    /// The same motion of the shaft after the counts per turn have changed from `from` to `to`.
    pub(super) fn rescaled(self, to: i64, from: i64) -> Self {
        let [speed, up, down] = [self.speed, self.up, self.down].map(|rate| scaled(rate, to, from));
        Self { speed, up, down }
    }

    /// The speed at the next tick: from `setpoint` towards `target`. A reversing speed is 0 for one tick.
    pub(super) fn ramped(self, setpoint: I40F24, target: I40F24) -> I40F24 {
        ramped(setpoint, target, Some(self.up), Some(self.down))
    }

    /// The target speed for the remaining `distance`, and the ramps to reach it. The present speed is
    /// `speed`; the current can reduce it by `max_deceleration` per tick.
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

    /// Returns true if the motion would overshoot, that is, if `distance` is too short to stop from `speed`.
    /// The motion decelerates by DEC, but by at most `max_deceleration` per tick, as the current allows.
    /// Returns false if the motion goes in the other direction, because it reverses first.
    pub(super) fn is_too_fast(self, distance: I40F24, speed: I40F24, max_deceleration: I40F24) -> bool {
        let goes_there = (speed > 0) == (distance > 0);
        goes_there && speed * speed > self.down.min(max_deceleration) * distance.abs() * 2
    }
}

/// The speed at the next tick from which the remaining distance is just enough to stop. With v/2 in the
/// present tick the distance is v/2 + v²/2·down.
fn braking_speed(distance: I40F24, down: I40F24) -> I40F24 {
    let distance = distance.clamp(I40F24::ZERO, I40F24::const_from_int(FAR)).to_bits().cast_unsigned();
    let down = down.to_bits().cast_unsigned();
    let root = (2 * down * distance + down * down / 4).isqrt();
    I40F24::from_bits(root.saturating_sub(down / 2).cast_signed())
}
