//! Home cycles (7.5 to 7.8).

use super::*;

/// A drive that homes at 1,000 steps/s, with ramps of a millisecond and half a step.
fn bed(configuration: i64) -> Bed {
    let mut bed = Bed::ready();
    bed.set(Reg::Speed, 1_000);
    bed.set(Reg::AccelDecel, 1_000_000);
    bed.set(Reg::HomingConfiguration, configuration);
    bed
}

#[test]
fn mode_0_stops_at_the_sample_that_sees_the_flag() {
    let mut bed = bed(0);
    bed.set(Reg::MotionControl, HOME);
    bed.run_until(1.secs());
    assert_eq!((bed.control(), bed.speed().to_num::<i32>(), bed.busy()), (HOME, 1_000, true));
    let position = bed.position();
    // Samples are at multiples of 4 µs (64 ticks): this pulse fits between two of them.
    bed.now += Duration::TICK;
    bed.pin(2, false);
    bed.now += Duration::from_ticks(62);
    bed.pin(2, true);
    bed.wait(1.micros());
    assert_eq!(bed.control(), HOME);
    // This one is there at the next sample.
    bed.now = Instant::from(1_001.millis()) + Duration::TICK;
    bed.pin(2, false);
    bed.run_until(Instant::from(1_001.millis()) + 4.micros() - Duration::TICK);
    assert_eq!(bed.control(), HOME);
    bed.run_until(Instant::from(1_001.millis()) + 4.micros());
    assert_eq!((bed.control(), bed.speed().to_num::<i32>(), bed.busy()), (0, 0, false));
    assert_eq!(bed.position(), position + 1);
}

#[test]
fn mode_1_stops_with_a_ramp() {
    let mut bed = bed(1 << 1);
    bed.set(Reg::AccelDecel, 10_000);
    bed.set(Reg::MotionControl, HOME);
    bed.run_until(1.secs());
    // The sample is at this very instant.
    bed.pin(2, false);
    let position = bed.position();
    bed.wait(100.millis() - Duration::TICK);
    assert_eq!(bed.control(), HOME);
    bed.wait(Duration::TICK);
    // 1,000² / (2 · 10,000) = 50 steps in 0.1 s.
    assert_eq!((bed.control(), bed.position()), (0, position + 50));
}

#[test]
fn offsets_go_at_the_undivided_speed_and_the_search_slower_and_backward() {
    // Divisor 4, backward, mode 0.
    let mut bed = bed(2 << 5 | 1 << 4);
    bed.set(Reg::PreHomeOffset, 500);
    bed.set(Reg::HomeOffset, 200);
    bed.set(Reg::MotionControl, HOME);
    // 500 steps at 1,000/s and two ramps of 1 ms, each half lost.
    bed.run_until(501.millis() - Duration::TICK);
    assert_eq!((bed.position(), bed.control()), (499, HOME));
    bed.run_until(501.millis());
    assert_eq!(bed.position(), 500);
    bed.run_until(1_501.millis());
    assert_eq!(bed.speed().to_num::<i32>(), -250);
    bed.pin(2, false);
    bed.wait(8.micros());
    let found = bed.position();
    assert!((249..=250).contains(&(500 - found)), "{found}");
    bed.wait(100.millis());
    assert_eq!(bed.speed().to_num::<i32>(), 1_000);
    bed.wait(1.secs());
    assert_eq!((bed.position(), bed.control()), (found + 200, 0));
}

#[test]
fn a_fraction_of_a_step_per_second_is_kept() {
    let mut bed = bed(7 << 5);
    bed.set(Reg::Speed, 1);
    bed.set(Reg::MotionControl, HOME);
    bed.run_until(300.secs());
    assert_eq!(bed.speed(), I48F16::from_num(1.0 / 128.0));
    assert_eq!(bed.position(), 2, "a step each 128 s");
}

#[test]
fn a_flag_that_is_there_ends_the_search_at_once() {
    let mut bed = bed(0);
    bed.pin(2, false);
    bed.set(Reg::MotionControl, HOME);
    assert_eq!((bed.control(), bed.position()), (0, 0));
    bed.set(Reg::HomeOffset, -10);
    bed.set(Reg::MotionControl, HOME);
    assert_eq!(bed.control(), HOME);
    bed.wait(1.secs());
    assert_eq!((bed.control(), bed.position()), (0, -10));
}

#[test]
fn modes_2_and_3_search_for_a_high_index() {
    for (mode, steps) in [(2, 0), (3, 50)] {
        let mut bed = bed(mode << 1);
        bed.set(Reg::AccelDecel, 10_000);
        bed.set(Reg::MotionControl, HOME);
        bed.run_until(1.secs());
        bed.set(Reg::CurrentCutbackSettings, 0x0005);
        bed.pin(2, false); // LOWCURRENT in this mode, no flag
        bed.now += Duration::TICK;
        let position = bed.position();
        bed.pin(9, true);
        bed.wait(1.secs());
        assert_eq!((bed.control(), bed.position()), (0, position + steps));
    }
}

#[test]
fn the_polarity_of_the_flag_can_be_inverted() {
    let mut bed = bed(0);
    bed.pin(2, false);
    bed.set(Reg::PinFunctionAndPolarity, 1 << 3);
    bed.set(Reg::MotionControl, HOME);
    assert_eq!(bed.control(), HOME);
    bed.run_until(1.secs());
    bed.pin(2, true);
    assert_eq!(bed.control(), 0);
}

#[test]
fn modes_nobody_prints_complete_at_once() {
    for mode in 4..8 {
        let mut bed = bed(mode << 1);
        bed.set(Reg::MotionControl, HOME);
        assert_eq!((bed.control(), bed.get(Reg::HomingConfiguration)), (0, mode << 1));
    }
}

#[test]
fn a_home_cycle_ignores_other_commands_and_ends_with_a_stop() {
    let mut bed = bed(0);
    bed.set(Reg::MotionControl, HOME);
    for command in [MOVE, JOG, HOME, 0] {
        bed.set(Reg::MotionControl, command);
        assert_eq!(bed.control(), HOME);
    }
    bed.wait(1.secs());
    bed.set(Reg::MotionControl, DECEL_STOP);
    assert_eq!(bed.control(), DECEL_STOP);
    bed.wait(1.millis());
    assert_eq!(bed.control(), 0);
}

#[test]
fn pins_4_and_5_are_ignored_and_jog_levels_looked_at_when_it_ends() {
    let mut bed = bed(0);
    bed.set(Reg::PinFunctionAndPolarity, 0b0110 << 4);
    bed.set(Reg::MotionControl, HOME);
    bed.run_until(100.millis());
    bed.pin(4, false);
    assert_eq!(bed.control(), HOME);
    bed.run_until(200.millis());
    bed.pin(2, false);
    assert_eq!(bed.control(), JOG);
}

#[test]
fn home_on_startup_unless_disabled_or_a_dc_motor() {
    let saved = |presets: &[(Reg, i64)]| {
        let mut bed = Bed::off(vec![0xFF; MEMORY]);
        for (reg, value) in presets {
            bed.drive.poke(Instant::ZERO, reg.row(), *value, &mut bed.world).unwrap();
        }
        bed.power_on(Boot::default());
        bed.run_until(Instant::from(2_500.millis()) - Duration::TICK);
        assert_eq!(bed.control() & !DISABLE, 0);
        bed.run_until(3.secs());
        bed
    };
    assert_eq!(saved(&[(Reg::HomingConfiguration, 1)]).control(), HOME);
    let disabled = saved(&[(Reg::HomingConfiguration, 1), (Reg::MotionControl, DISABLE)]);
    assert_eq!((disabled.control(), disabled.position()), (DISABLE, 0));
    let dc = saved(&[(Reg::HomingConfiguration, 1), (Reg::MotorCurrentAndMicrostepping, 0x200a)]);
    assert_eq!((dc.control(), dc.position()), (0, 0));
}
