//! Position control: the speed towards a target (p. 15; MDROBOT-19).

use fixed::types::I40F24;

use super::sensing::Sensing;
use super::{FULL_DUTY, NEAR, Settings};
use crate::device::Instant;

/// Beyond this distance in counts, no motor is fast enough to have to brake.
const FAR: i64 = 1 << 24;
/// A move uses the deceleration that `MAX_LOAD` allows, divided by this. The rest is for the speed loop.
const BRAKE_DIVISOR: i64 = 2;
/// With the factory gains the speed loop lags behind its reference by at least 1/40 s.
const LAG_PER_S: i64 = 40;
/// The lag is also at least the motor's time constant divided by this. Without this term a heavy motor
/// would oscillate around its target.
const LAG_PART: i64 = 2;

/// The speed reference in rpm at the `distance` from the target in counts: `PV_GAIN` for each remaining count, at most `most`, and at most the speed
/// from which `MAX_LOAD` can brake within the distance.
pub(super) fn speed_to_target(
    distance: i64,
    most: i32,
    at: Instant,
    sensing: &Sensing,
    settings: &Settings,
) -> I40F24 {
    const TICKS_PER_S: i64 = 1_000;
    let (turn, motor) = (sensing.turn(), sensing.motor());
    let left = sensing.distance(distance, FAR, at);
    if left.abs() <= NEAR {
        return I40F24::ZERO;
    }
    let sign = left.to_bits().signum();
    let brakes = motor.max_deceleration(settings.limit_ma, FULL_DUTY, sign) / BRAKE_DIVISOR * TICKS_PER_S;
    // The braking speed v stops the shaft within the distance s with the deceleration a, after the lag t:
    // v² = 2·a·(s − v·t). Speeds are in rpm: 60 rpm are one turn per second.
    let brakes = sensing.of_halls(brakes).max(I40F24::ONE).to_num::<i64>();
    let lag_ms = (motor.slowness / LAG_PART).to_num::<i64>().max(TICKS_PER_S / LAG_PER_S);
    let lag = brakes.saturating_mul(lag_ms) / TICKS_PER_S;
    let square =
        (left.abs().to_bits() >> 8).saturating_mul((2 * 60 * brakes).checked_div(turn).unwrap_or(0)) >> 16;
    let root = square.saturating_add(lag.saturating_mul(lag)).unsigned_abs().isqrt();
    let braking_speed = root.cast_signed().saturating_sub(lag);
    let most = I40F24::from_num(i64::from(most.clamp(0, u16::MAX.into())).min(braking_speed.max(1)));
    left.saturating_mul(settings.pv_gain.into()).min(most).max(-most)
}

/// Counts as a position, limited to the range of positions.
pub(super) fn of_counts(counts: i64) -> i32 {
    counts.clamp(i32::MIN.into(), i32::MAX.into()) as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    /// POSI_DATA has 32 bits with sign (2.4). A motor that goes on turning stays at the end of the range, and comes back
    /// from it on the count.
    #[test]
    fn a_position_stays_in_its_range() {
        let counts = [2_147_483_647, 2_147_483_648, 189_345_600_000, -2_147_483_648, -2_147_483_649];
        let positions = [2_147_483_647, 2_147_483_647, 2_147_483_647, -2_147_483_648, -2_147_483_648];
        assert_eq!(counts.map(of_counts), positions);
    }
}
