//! Moves of an RS 434544 with its motor, by its registers: whatever they say, it ends on its count.
#![allow(missing_docs, reason = "a test")]

use drivetwin_firmware::device::{Axis, Boot, Device, Duration, Instant, Output, Sink, advance};
use drivetwin_firmware::rs434::rs434544;
use proptest::prelude::*;

/// New memory, and nobody else.
struct Nowhere(Vec<u8>);

impl Sink for Nowhere {
    fn put(&mut self, _at: Instant, _output: Output<'_>) {}

    fn memory(&self) -> &[u8] {
        &self.0
    }
}

fn row(device: &impl Device, name: &str) -> usize {
    device.spec().find(name).unwrap().row
}

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

        let mut drive = rs434544();
        let mut out = Nowhere(vec![0xFF; usize::from(drive.spec().memory)]);
        let mut now = Instant::ZERO;
        drive.power_on(now, Boot { fast: true, ..Boot::default() }, &mut out);
        now += Duration::millis(1);
        advance(&mut drive, now, std::iter::empty(), &mut out);
        for (name, value) in [
            ("RATED_SPEED", rated), ("PULSES_PER_REVOLUTION", pulses), ("REF_CURRENT", current), ("SPEED", speed),
            ("ACC", acc), ("DEC", dec), ("MODE_ROTATION", 2), ("OFFSET", counts), ("START_bit", 1),
        ] {
            let row = row(&drive, name);
            drive.poke(now, row, value, &mut out).unwrap();
        }
        let read = |drive: &_, now, name| Device::peek(drive, now, row(drive, name));
        prop_assert_eq!(read(&drive, now, "STATUS"), if back { 2 } else { 1 });
        let shaft = drive.shaft(now, Axis(0)).unwrap().position;
        while read(&drive, now, "STATUS") != 0 {
            now += Duration::millis(10);
            advance(&mut drive, now, std::iter::empty(), &mut out);
            prop_assert!(now < Instant::from(Duration::secs(60)), "still on its way");
        }
        // What friction lets it run on would show.
        now += Duration::secs(1);
        advance(&mut drive, now, std::iter::empty(), &mut out);
        prop_assert_eq!(read(&drive, now, "CURRENT_POSITION"), counts);
        prop_assert_eq!(read(&drive, now, "OFFSET"), 0);
        prop_assert_eq!(i64::from(drive.shaft(now, Axis(0)).unwrap().position - shaft), counts);
        // Only the limit of the current may have held it back.
        prop_assert_eq!(read(&drive, now, "ERROR") & !0x800, 0);
    }
}
