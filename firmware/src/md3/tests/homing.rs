//! Home cycles (7.5 to 7.8).

use super::*;

/// A drive that homes at 1,000 steps/s; a ramp takes 1 ms and covers half a step.
fn dut(configuration: i64) -> Fixture<Md3> {
    let mut dut = ready();
    dut.preset(Reg::Speed, 1_000);
    dut.preset(Reg::AccelDecel, 1_000_000);
    dut.preset(Reg::HomingConfiguration, configuration);
    dut
}

#[test]
fn mode_0_stops_at_the_sample_that_sees_the_flag() {
    let mut dut = dut(0);
    dut.preset(Reg::MotionControl, HOME);
    dut.run_until(1.secs());
    assert_eq!((dut.control(), dut.speed().to_num::<i32>(), dut.busy()), (HOME, 1_000, true));
    let position = dut.position();
    // The drive samples at multiples of 4 µs (64 ticks). This pulse lies between two samples.
    dut.now += Duration::TICK;
    dut.pin(2, false);
    dut.now += Duration::from_ticks(62);
    dut.pin(2, true);
    dut.wait(1.micros());
    assert_eq!(dut.control(), HOME);
    // This pulse lasts until the next sample.
    dut.now = Instant::from(1_001.millis()) + Duration::TICK;
    dut.pin(2, false);
    dut.run_until(Instant::from(1_001.millis()) + 4.micros() - Duration::TICK);
    assert_eq!(dut.control(), HOME);
    dut.run_until(Instant::from(1_001.millis()) + 4.micros());
    assert_eq!((dut.control(), dut.speed().to_num::<i32>(), dut.busy()), (0, 0, false));
    assert_eq!(dut.position(), position + 1);
}

#[test]
fn mode_1_stops_with_a_ramp() {
    let mut dut = dut(1 << 1);
    dut.preset(Reg::AccelDecel, 10_000);
    dut.preset(Reg::MotionControl, HOME);
    dut.run_until(1.secs());
    // The drive samples at exactly this instant.
    dut.pin(2, false);
    let position = dut.position();
    dut.wait(100.millis() - Duration::TICK);
    assert_eq!(dut.control(), HOME);
    dut.wait(Duration::TICK);
    // 1,000² / (2 · 10,000) = 50 steps in 0.1 s.
    assert_eq!((dut.control(), dut.position()), (0, position + 50));
}

#[test]
fn offsets_go_at_the_undivided_speed_and_the_search_slower_and_backward() {
    // The drive searches with divisor 4, backward, in mode 0.
    let mut dut = dut(2 << 5 | 1 << 4);
    dut.preset(Reg::PreHomeOffset, 500);
    dut.preset(Reg::HomeOffset, 200);
    dut.preset(Reg::MotionControl, HOME);
    // 500 steps at 1,000 steps/s take 0.5 s, and each of the two ramps of 1 ms adds 0.5 ms.
    dut.run_until(501.millis() - Duration::TICK);
    assert_eq!((dut.position(), dut.control()), (499, HOME));
    dut.run_until(501.millis());
    assert_eq!(dut.position(), 500);
    dut.run_until(1_501.millis());
    assert_eq!(dut.speed().to_num::<i32>(), -250);
    dut.pin(2, false);
    dut.wait(8.micros());
    let found = dut.position();
    assert!((249..=250).contains(&(500 - found)), "{found}");
    dut.wait(100.millis());
    assert_eq!(dut.speed().to_num::<i32>(), 1_000);
    dut.wait(1.secs());
    assert_eq!((dut.position(), dut.control()), (found + 200, 0));
}

#[test]
fn a_fraction_of_a_step_per_second_is_kept() {
    let mut dut = dut(7 << 5);
    dut.preset(Reg::Speed, 1);
    dut.preset(Reg::MotionControl, HOME);
    dut.run_until(300.secs());
    assert_eq!(dut.speed(), I48F16::from_num(1.0 / 128.0));
    assert_eq!(dut.position(), 2, "a step each 128 s");
}

#[test]
fn a_flag_that_is_there_ends_the_search_at_once() {
    let mut dut = dut(0);
    dut.pin(2, false);
    dut.preset(Reg::MotionControl, HOME);
    assert_eq!((dut.control(), dut.position()), (0, 0));
    dut.preset(Reg::HomeOffset, -10);
    dut.preset(Reg::MotionControl, HOME);
    assert_eq!(dut.control(), HOME);
    dut.wait(1.secs());
    assert_eq!((dut.control(), dut.position()), (0, -10));
}

#[test]
fn modes_2_and_3_search_for_a_high_index() {
    for (mode, steps) in [(2, 0), (3, 50)] {
        let mut dut = dut(mode << 1);
        dut.preset(Reg::AccelDecel, 10_000);
        dut.preset(Reg::MotionControl, HOME);
        dut.run_until(1.secs());
        dut.preset(Reg::CurrentCutbackSettings, 0x0005);
        dut.pin(2, false); // pin 2 is LOWCURRENT in this mode and not the flag
        dut.now += Duration::TICK;
        let position = dut.position();
        dut.pin(9, true);
        dut.wait(1.secs());
        assert_eq!((dut.control(), dut.position()), (0, position + steps));
    }
}

#[test]
fn the_polarity_of_the_flag_can_be_inverted() {
    let mut dut = dut(0);
    dut.pin(2, false);
    dut.preset(Reg::PinFunctionAndPolarity, 1 << 3);
    dut.preset(Reg::MotionControl, HOME);
    assert_eq!(dut.control(), HOME);
    dut.run_until(1.secs());
    dut.pin(2, true);
    assert_eq!(dut.control(), 0);
}

#[test]
fn modes_nobody_prints_complete_at_once() {
    for mode in 4..8 {
        let mut dut = dut(mode << 1);
        dut.preset(Reg::MotionControl, HOME);
        assert_eq!((dut.control(), dut.get(Reg::HomingConfiguration)), (0, mode << 1));
    }
}

#[test]
fn a_home_cycle_ignores_other_commands_and_ends_with_a_stop() {
    let mut dut = dut(0);
    dut.preset(Reg::MotionControl, HOME);
    for command in [MOVE, JOG, HOME, 0] {
        dut.preset(Reg::MotionControl, command);
        assert_eq!(dut.control(), HOME);
    }
    dut.wait(1.secs());
    dut.preset(Reg::MotionControl, DECEL_STOP);
    assert_eq!(dut.control(), DECEL_STOP);
    dut.wait(1.millis());
    assert_eq!(dut.control(), 0);
}

#[test]
fn pins_4_and_5_are_ignored_and_jog_levels_looked_at_when_it_ends() {
    let mut dut = dut(0);
    dut.preset(Reg::PinFunctionAndPolarity, 0b0110 << 4);
    dut.preset(Reg::MotionControl, HOME);
    dut.run_until(100.millis());
    dut.pin(4, false);
    assert_eq!(dut.control(), HOME);
    dut.run_until(200.millis());
    dut.pin(2, false);
    assert_eq!(dut.control(), JOG);
}

#[test]
fn home_on_startup_unless_disabled_or_a_dc_motor() {
    let saved = |presets: &[(Reg, i64)]| {
        let mut dut = off(vec![0xFF; MEMORY]);
        for (reg, value) in presets {
            dut.set(*reg, *value);
        }
        dut.power_on(Boot::default());
        dut.run_until(Instant::from(2_500.millis()) - Duration::TICK);
        assert_eq!(dut.control() & !DISABLE, 0);
        dut.run_until(3.secs());
        dut
    };
    assert_eq!(saved(&[(Reg::HomingConfiguration, 1)]).control(), HOME);
    let disabled = saved(&[(Reg::HomingConfiguration, 1), (Reg::MotionControl, DISABLE)]);
    assert_eq!((disabled.control(), disabled.position()), (DISABLE, 0));
    let dc = saved(&[(Reg::HomingConfiguration, 1), (Reg::MotorCurrentAndMicrostepping, 0x200a)]);
    assert_eq!((dc.control(), dc.position()), (0, 0));
}
