//! How fast a motor goes to a position (p. 15).

use super::Settings;

/// By how much an ampere brakes for sure, in rpm a second: 0.06 Nm on 10⁻³ kg·m², of which a quarter is left to the
/// loop. A motor of more inertia overshoots.
const BRAKING_RPM_PER_S_A: u64 = 430;
/// The loop of the speed is behind its reference by this part of a second.
const LAG_PER_S: u64 = 40;

/// The speed for so many counts that are left, in rpm: PV_GAIN for each count, at most `most`, and no more than MAX_LOAD
/// can brake on that way.
pub(super) fn pace(left: i32, most: i32, settings: &Settings) -> i64 {
    let braking = u64::from(settings.limit_ma) * BRAKING_RPM_PER_S_A / 1_000;
    // v² = 2·a·(s − v·t), with 60 rpm for a turn in a second.
    let lag = braking / LAG_PER_S;
    let square = (2 * 60 * braking).saturating_mul(left.unsigned_abs().into());
    let square = square.checked_div(settings.counts().into()).unwrap_or(0);
    let fair = square.saturating_add(lag * lag).isqrt().saturating_sub(lag);
    let most = i64::from(most.clamp(0, u16::MAX.into())).min(fair.cast_signed());
    (i64::from(left) * i64::from(settings.pv_gain)).min(most).max(-most)
}
