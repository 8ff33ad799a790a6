//! Where the motor is and where it goes, and how fast it goes there (p. 15).

use super::{Order, Servo, Settings};

/// By how much an ampere brakes for sure, in rpm a second: 0.06 Nm on 10⁻³ kg·m², twice what the drive's own motor
/// has, of which a quarter is left to the loop. A motor of more inertia overshoots.
const BRAKING_RPM_PER_S_A: u64 = 430;
/// The loop of the speed is behind its reference by this part of a second.
const LAG_PER_S: u64 = 40;

/// The speed for so many counts that are left, in rpm: PV_GAIN for each count, at most `most`, and no more than MAX_LOAD
/// can brake on that way.
pub(super) fn pace(left: i64, most: i32, settings: &Settings) -> i64 {
    let braking = u64::from(settings.limit_ma) * BRAKING_RPM_PER_S_A / 1_000;
    // v² = 2·a·(s − v·t), with 60 rpm for a turn in a second.
    let lag = braking / LAG_PER_S;
    let square = (2 * 60 * braking).saturating_mul(left.unsigned_abs());
    let square = square.checked_div(settings.counts().into()).unwrap_or(0);
    let fair = square.saturating_add(lag * lag).isqrt().saturating_sub(lag);
    let most = i64::from(most.clamp(0, u16::MAX.into())).min(fair.cast_signed());
    left.saturating_mul(settings.pv_gain.into()).min(most).max(-most)
}

impl Servo {
    /// Counts to the target.
    pub(super) fn way(&self) -> i64 {
        self.way_to(self.target)
    }

    /// Counts from where the motor is to a position.
    pub(in crate::mdrobot) fn way_to(&self, position: i32) -> i64 {
        self.zero + i64::from(position) - self.halls.count()
    }

    /// Counts of the Hall sensors, CCW less CW; further than positions go it stays at the last one.
    pub(in crate::mdrobot) fn position(&self) -> i32 {
        of_position(self.halls.count() - self.zero)
    }

    /// The position is 0 here; a position that is held moves along.
    pub(in crate::mdrobot) fn clear_position(&mut self) {
        self.target = of_position(self.way());
        self.zero = self.halls.count();
        if let Order::Position { count, .. } = &mut self.order {
            *count = self.target;
        }
    }

    /// Where position control goes, or went last, in counts; it moves along when the position is cleared.
    pub(in crate::mdrobot) fn target(&self) -> i32 {
        self.target
    }

    /// The error of position control, in counts; `None` unless it controls the position.
    pub(in crate::mdrobot) fn error(&self) -> Option<i64> {
        matches!(self.order, Order::Position { .. }).then(|| self.way())
    }
}

/// Counts as a position, or as far as positions go.
fn of_position(counts: i64) -> i32 {
    counts.clamp(i32::MIN.into(), i32::MAX.into()) as i32
}
