//! Faults, cutback, INHIBIT and the motor's current (7.2, 7.3, 7.8, 7.15).

use super::*;

#[test]
fn a_thermal_fault_stays_until_it_has_cooled() {
    let mut dut = ready();
    let hot = |on| Input::Fault { fault: Fault(0), on };
    dut.write(0x11, 2);
    dut.input(dut.now, hot(true));
    assert_eq!((dut.read(0x11), dut.level("J3.7")), (0x8000, Level::Low));
    assert_eq!(dut.current(), 0);
    let position = dut.position();
    dut.write(0x11, 0x8001);
    assert_eq!(dut.read(0x11), 0x8000);
    dut.input(dut.now, hot(false));
    assert_eq!(dut.read(0x11), 0x8000, "it stays until it is cleared");
    dut.write(0x11, 1);
    assert_eq!((dut.read(0x11), dut.position()), (0x8000, position), "answered, and nothing moves");
    dut.write(0x11, 0x8000);
    assert_eq!((dut.read(0x11), dut.level("J3.7")), (0, Level::Float));
    assert_eq!(dut.current(), 1_000);
}

#[test]
fn other_faults_are_cleared_by_a_write_that_may_move_at_once() {
    let mut dut = ready();
    dut.input(dut.now, Input::Fault { fault: Fault(1), on: true });
    assert_eq!(dut.read(0x11), 0x8000);
    dut.write(0x11, 0x8001);
    assert_eq!(dut.read(0x11), 1);
}

#[test]
fn the_manuals_currents() {
    let check = |drive, currents: &[u32], last| {
        let mut dut = of(drive, vec![0xFF; MEMORY]).ready();
        for (code, ma) in (0..).zip(currents.iter().copied()).chain([(0xFF, last)]) {
            dut.preset(Reg::MotorCurrentAndMicrostepping, 0x0300 | code);
            assert_eq!(dut.current(), ma, "code {code:#04x}");
        }
    };
    // Currents from 7.2, in mA. Codes beyond a column act as its last row.
    let high = [
        0, 100, 200, 300, 400, 500, 600, 700, 800, 900, 1_000, 1_100, 1_200, 1_300, 1_400, 1_500, 1_600,
        1_700, 1_800, 1_900, 2_000, 2_500, 3_000, 3_500, 4_000, 4_500, 5_000, 5_500, 6_000, 6_500, 7_000,
        7_000, 7_000,
    ];
    check(Md3::new(), &high, 7_000);
    let low = [
        0, 50, 100, 150, 200, 250, 300, 350, 400, 450, 500, 550, 600, 650, 700, 750, 800, 850, 900, 950,
        1_000, 1_050, 1_100, 1_150, 1_200, 1_250, 1_300, 1_350, 1_400, 1_450, 1_500, 1_550, 1_600, 1_650,
        1_700, 1_750, 1_800, 1_800, 1_800,
    ];
    check(Md3::low(), &low, 1_800);
}

#[test]
fn full_step_gets_71_percent_and_a_dc_motor_all() {
    let mut dut = ready();
    dut.preset(Reg::MotorCurrentAndMicrostepping, 0x0014);
    assert_eq!(dut.current(), 1_420);
    dut.preset(Reg::MotorCurrentAndMicrostepping, 0x2014);
    assert_eq!(dut.current(), 2_000);
}

#[test]
fn cutback_comes_when_nothing_was_asked_for_as_long() {
    let mut dut = ready();
    dut.preset(Reg::CurrentCutbackSettings, 0x0505); // half a second, 0.5 A
    dut.run_until(500.millis() - Duration::TICK);
    assert_eq!((dut.current(), dut.level("D5")), (1_000, Level::Low));
    dut.run_until(500.millis());
    assert_eq!((dut.current(), dut.level("D5")), (500, Level::High));
    // A change of an input restores the current.
    dut.run_until(1.secs());
    dut.pin(5, false);
    assert_eq!((dut.current(), dut.level("D5")), (1_000, Level::Low));
    // A motion has the full current until its end, and the timeout restarts at the end.
    dut.run_until(2.secs());
    assert_eq!(dut.current(), 500);
    dut.preset(Reg::MotionControl, MOVE);
    assert_eq!(dut.current(), 1_000);
    dut.run_until(Instant::from(5.secs()) - Duration::TICK);
    assert_eq!(dut.current(), 1_000);
    dut.run_until(5.secs());
    assert_eq!(dut.current(), 500);
    // A write to another register does not end the cutback; a write to 0x11 does.
    dut.preset(Reg::UserRegister, 1);
    assert_eq!(dut.current(), 500);
    dut.preset(Reg::MotionControl, 0);
    assert_eq!(dut.current(), 1_000);
    dut.run_until(10.secs());
    dut.preset(Reg::CurrentCutbackSettings, 0x0005);
    assert_eq!((dut.current(), dut.level("D5")), (1_000, Level::Low), "no timeout, no cutback");
    dut.preset(Reg::CurrentCutbackSettings, 0x0a07);
    assert_eq!(dut.current(), 700, "the time that has passed counts");
}

#[test]
fn lowcurrent_lowers_it_whatever_the_timeout() {
    let mut dut = ready();
    dut.preset(Reg::HomingConfiguration, 2 << 1);
    dut.preset(Reg::CurrentCutbackSettings, 0x0005);
    dut.pin(2, false);
    assert_eq!((dut.current(), dut.level("D5")), (500, Level::High));
    dut.preset(Reg::MotionControl, JOG);
    assert_eq!(dut.current(), 500);
    dut.pin(2, true);
    assert_eq!((dut.current(), dut.level("D5")), (1_000, Level::Low));
}

#[test]
fn a_current_of_0_moves_nothing() {
    let mut dut = ready();
    dut.preset(Reg::HomingConfiguration, 2 << 1);
    dut.preset(Reg::MotionControl, MOVE);
    dut.run_until(1.secs());
    dut.pin(2, false); // LOWCURRENT, with a cutback current of 0
    dut.run_until(1_500.millis());
    assert_eq!((dut.current(), dut.position(), dut.control()), (0, 3_750, MOVE));
    dut.pin(2, true);
    dut.run_until(3.secs());
    assert_eq!(dut.position(), 7_500);
}

#[test]
fn a_step_pulse_that_ends_the_cutback_is_made() {
    let mut dut = ready();
    dut.preset(Reg::CurrentCutbackSettings, 0x0100); // 0.1 s, no current
    dut.run_until(1.secs());
    assert_eq!(dut.current(), 0);
    dut.pin(4, false);
    assert_eq!((dut.current(), dut.position()), (1_000, 1));
}

#[test]
fn inhibit_lets_the_profile_run_on_without_the_motor() {
    let mut dut = ready();
    dut.preset(Reg::MotionControl, MOVE);
    dut.run_until(1.secs());
    assert_eq!(dut.position(), 3_750);
    dut.pin(3, false);
    assert_eq!((dut.current(), dut.control()), (0, MOVE));
    dut.run_until(1_500.millis());
    assert_eq!((dut.position(), dut.control(), dut.busy()), (3_750, MOVE, true));
    dut.pin(3, true);
    assert_eq!((dut.current(), dut.position()), (1_000, 3_750));
    dut.run_until(2_500.millis() - Duration::TICK);
    assert_eq!(dut.control(), MOVE);
    dut.run_until(2_500.millis());
    // The steps of the half second without current are lost.
    assert_eq!((dut.control(), dut.position()), (0, 7_500));
    // A move that begins and ends without current makes no step.
    dut.pin(3, false);
    dut.preset(Reg::MotionControl, MOVE);
    dut.run_until(10.secs());
    assert_eq!((dut.control(), dut.position()), (0, 7_500));
    dut.pin(4, false);
    dut.pin(3, true);
    assert_eq!(dut.position(), 7_500);
    dut.preset(Reg::MotionControl, MOVE);
    dut.run_until(20.secs());
    assert_eq!(dut.position(), 17_500);
}

#[test]
fn inhibit_is_a_level_at_power_up() {
    let mut dut = booting();
    dut.pin(3, false);
    dut.run_until(3.secs());
    assert_eq!(dut.current(), 0);
    dut.pin(3, true);
    assert_eq!(dut.current(), 1_000);
}

#[test]
fn pin_3_clears_a_fault_in_each_of_its_functions() {
    for function in [0, 1, 2] {
        let mut dut = ready();
        dut.preset(Reg::PinFunctionAndPolarity, function << 8);
        dut.input(dut.now, Input::Fault { fault: Fault(1), on: true });
        assert_eq!((dut.control(), dut.busy()), (FAULT, true));
        dut.pin(3, false);
        let homes = if function == 1 { HOME } else { 0 };
        assert_eq!(dut.control(), homes, "function {function}");
        let mut hot = ready();
        hot.set(Reg::PinFunctionAndPolarity, function << 8);
        hot.input(hot.now, Input::Fault { fault: Fault(0), on: true });
        hot.pin(3, false);
        assert_eq!(hot.control(), FAULT, "not while it is too hot");
    }
}

#[test]
fn a_fault_flashes_red_and_stops_the_green_heartbeat() {
    let mut dut = ready();
    dut.run_until(1.secs());
    dut.out.waves.clear();
    dut.input(dut.now, Input::Fault { fault: Fault(1), on: true });
    assert_eq!(dut.out.waves, [(dut.now, RED, 1_500.millis(), 250.millis())]);
    assert_eq!(dut.level("D6"), Level::Low);
    dut.run_until(2.secs());
    dut.preset(Reg::MotionControl, FAULT);
    assert_eq!(dut.out.waves[1..], [(dut.now, GREEN, 1_500.millis(), 250.millis())]);
    assert_eq!(dut.level("D5"), Level::Low);
}

#[test]
fn a_new_polarity_ends_the_cutback_before_its_step() {
    let mut dut = ready();
    dut.preset(Reg::CurrentCutbackSettings, 0x0a00);
    dut.run_until(2.secs());
    assert_eq!(dut.current(), 0);
    dut.preset(Reg::PinFunctionAndPolarity, 0b0010);
    assert_eq!((dut.position(), dut.current(), dut.level("D5")), (1, 1_000, Level::Low));
}

#[test]
fn a_fault_that_a_new_function_clears_begins_the_cutback_anew() {
    for function in [0x0104, 0x0204] {
        let mut dut = ready();
        dut.preset(Reg::Speed, 0);
        dut.preset(Reg::CurrentCutbackSettings, 0x0a05);
        dut.input(dut.now, Input::Fault { fault: Fault(1), on: true });
        dut.run_until(5.secs());
        dut.preset(Reg::PinFunctionAndPolarity, function);
        assert_eq!((dut.control(), dut.current()), (0, 1_000));
        dut.run_until(Instant::from(6.secs()) - Duration::TICK);
        assert_eq!(dut.current(), 1_000);
        dut.run_until(6.secs());
        assert_eq!(dut.current(), 500);
    }
}

#[test]
fn a_cause_at_power_up_shows_whatever_pin_3_holds() {
    for function in [0, 1, 2] {
        let mut dut = off(vec![0xFF; MEMORY]);
        let row = Reg::PinFunctionAndPolarity.row();
        dut.drive.poke(Instant::ZERO, row, function << 8, &mut dut.out).unwrap();
        dut.power_on(Boot::default());
        dut.pin(3, false);
        dut.input(dut.now, Input::Fault { fault: Fault(1), on: true });
        dut.run_until(3.secs());
        assert_eq!((dut.control(), dut.current()), (FAULT, 0), "function {function}");
    }
}
