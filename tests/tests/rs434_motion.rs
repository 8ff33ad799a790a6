//! Moves of an RS 434544 with its motor, commanded by its registers. With any values a move ends on its
//! count.
#![allow(missing_docs, reason = "a test")]

use drivetwin_firmware::device::{Axis, Device, Duration, Instant};
use drivetwin_firmware::rs434::Rs434;
use drivetwin_firmware::testing::{Fixture, Treatment};
use proptest::prelude::*;

proptest! {
    #![proptest_config(ProptestConfig { cases: 32, max_shrink_iters: 100, ..ProptestConfig::default() })]

    #[test]
    fn a_move_by_offset_ends_on_its_count(
        speed in 30..15_001_i64, acc in 10..1_001_i64, dec in 10..1_001_i64, rated in 1_000..15_001_i64,
        pulses in 1..13_i64, current in 1_000..20_001_i64, part in 0.0..1.0_f64, back in any::<bool>(),
    ) {
        let a_second = speed as f64 / 60.0 * 4.0 * pulses as f64;
        let size = a_second.max(1.0).powf(part).round() as i64;
        let counts = if back { -size } else { size };

        let mut dut = Fixture::new(Rs434::rs434544()).ruled(|_| Treatment::Ignore).ready();
        dut.wait(Duration::millis(1));
        for (name, value) in [
            ("RATED_SPEED", rated), ("PULSES_PER_REVOLUTION", pulses), ("REF_CURRENT", current), ("SPEED", speed),
            ("ACC", acc), ("DEC", dec), ("MODE_ROTATION", 2), ("OFFSET", counts), ("START_bit", 1),
        ] {
            dut.set_named(name, value);
        }
        prop_assert_eq!(dut.get_named("STATUS"), if back { 2 } else { 1 });
        let shaft = dut.drive.shaft(dut.now, Axis(0)).unwrap().position;
        while dut.get_named("STATUS") != 0 {
            dut.wait(Duration::millis(10));
            prop_assert!(dut.now < Instant::from(Duration::secs(60)), "still on its way");
        }
        // Waits a second more, to see any motion after the end.
        dut.wait(Duration::secs(1));
        prop_assert_eq!(dut.get_named("CURRENT_POSITION"), counts);
        prop_assert_eq!(dut.get_named("OFFSET"), 0);
        prop_assert_eq!(i64::from(dut.drive.shaft(dut.now, Axis(0)).unwrap().position - shaft), counts);
        // Only the warning of the current limit may be set.
        prop_assert_eq!(dut.get_named("ERROR") & !0x800, 0);
    }
}
