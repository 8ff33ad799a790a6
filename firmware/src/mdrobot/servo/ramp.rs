//! `SLOW_START` and `SLOW_DOWN` (p. 13; MDROBOT-16): ramps of the speed reference.

use fixed::types::I40F24;

/// Longest time of a ramp between 0 and `MAX_RPM`, in ms.
const LONGEST_MS: i64 = 15_000;
/// Greatest value of `SLOW_START` and `SLOW_DOWN`.
const GREATEST: i64 = 1_023;

/// The change of the speed in a ms, in rpm, for a value of `SLOW_START` or `SLOW_DOWN`; `None` without a
/// ramp.
pub(super) fn rate(slow: u16, max_rpm: u16) -> Option<I40F24> {
    let rate = ((i64::from(max_rpm) * GREATEST) << 24).checked_div(LONGEST_MS * i64::from(slow))?;
    Some(I40F24::from_bits(rate.max(1)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motor::ramped;

    /// The rounded reference after `ms` milliseconds.
    fn paces(from: i32, to: i32, up: u16, down: u16, ms: usize) -> i32 {
        let (up, down) = (rate(up, 3_000), rate(down, 3_000));
        let mut setpoint = I40F24::from_num(from);
        for _ in 0..ms {
            setpoint = ramped(setpoint, I40F24::from_num(to), up, down);
        }
        setpoint.round().to_num()
    }

    #[test]
    fn the_greatest_takes_15_s_for_max_rpm_and_others_their_part_of_it() {
        assert_eq!(paces(0, 3_000, 1_023, 0, 7_500), 1_500);
        assert_eq!(paces(0, 3_000, 1_023, 0, 15_001), 3_000);
        // 341 is a third of 1,023, so the ramp takes 5 s.
        assert_eq!(paces(3_000, 0, 0, 341, 2_500), 1_500);
        assert_eq!(paces(0, -600, 341, 0, 500), -300);
    }

    #[test]
    fn a_reversal_goes_down_by_the_one_and_up_by_the_other() {
        // 600 rpm take 1 s down and 3 s up.
        assert_eq!(paces(600, -600, 1_023, 341, 500), 300);
        assert_eq!(paces(600, -600, 1_023, 341, 1_001 + 1_500), -300);
        assert_eq!(paces(600, -600, 0, 341, 1_003), -600);
        assert_eq!(paces(600, -600, 1_023, 0, 1_500), -300);
    }

    #[test]
    fn zero_is_no_ramp() {
        assert_eq!(paces(0, 3_000, 0, 1_023, 1), 3_000);
        assert_eq!(paces(-600, 600, 0, 0, 1), 600);
    }
}
