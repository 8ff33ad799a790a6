//! Faults, cutback, inhibit and what the motor gets (7.2, 7.3, 7.8, 7.15).

use super::*;

#[test]
fn a_thermal_fault_stays_until_it_has_cooled() {
    let mut bed = Bed::ready();
    let hot = |on| Input::Fault { fault: Fault(0), on };
    bed.write(0x11, 2);
    bed.input(bed.now, hot(true));
    assert_eq!((bed.read(0x11), bed.level("J3.7")), (0x8000, Level::Low));
    assert_eq!(bed.world.current.last().unwrap().1, 0);
    let position = bed.position();
    bed.write(0x11, 0x8001);
    assert_eq!(bed.read(0x11), 0x8000);
    bed.input(bed.now, hot(false));
    assert_eq!(bed.read(0x11), 0x8000, "it stays until it is cleared");
    bed.write(0x11, 1);
    assert_eq!((bed.read(0x11), bed.position()), (0x8000, position), "answered, and nothing moves");
    bed.write(0x11, 0x8000);
    assert_eq!((bed.read(0x11), bed.level("J3.7")), (0, Level::Float));
    assert_eq!(bed.world.current.last().unwrap().1, 1_000);
}

#[test]
fn other_faults_are_cleared_by_a_write_that_may_move_at_once() {
    let mut bed = Bed::ready();
    bed.input(bed.now, Input::Fault { fault: Fault(1), on: true });
    assert_eq!(bed.read(0x11), 0x8000);
    bed.write(0x11, 0x8001);
    assert_eq!(bed.read(0x11), 1);
}

#[test]
fn the_manuals_currents() {
    use super::super::registers::Version::{HighCurrent, LowCurrent};
    use super::super::registers::current_ma;
    // 7.2, in mA; what is beyond a column acts as its last row.
    let high = [
        0, 100, 200, 300, 400, 500, 600, 700, 800, 900, 1_000, 1_100, 1_200, 1_300, 1_400, 1_500, 1_600,
        1_700, 1_800, 1_900, 2_000, 2_500, 3_000, 3_500, 4_000, 4_500, 5_000, 5_500, 6_000, 6_500, 7_000,
        7_000, 7_000,
    ];
    for (code, ma) in (0..).zip(high).chain([(0xFF, 7_000)]) {
        assert_eq!(current_ma(HighCurrent, 0x0300 | code), ma, "code {code:#04x}");
    }
    let low = [
        0, 50, 100, 150, 200, 250, 300, 350, 400, 450, 500, 550, 600, 650, 700, 750, 800, 850, 900, 950,
        1_000, 1_050, 1_100, 1_150, 1_200, 1_250, 1_300, 1_350, 1_400, 1_450, 1_500, 1_550, 1_600, 1_650,
        1_700, 1_750, 1_800, 1_800, 1_800,
    ];
    for (code, ma) in (0..).zip(low).chain([(0xFF, 1_800)]) {
        assert_eq!(current_ma(LowCurrent, 0x0300 | code), ma, "code {code:#04x}");
    }
}

#[test]
fn full_step_gets_71_percent_and_a_dc_motor_all() {
    let mut bed = Bed::ready();
    bed.set(Reg::MotorCurrentAndMicrostepping, 0x0014);
    assert_eq!(bed.current(), 1_420);
    bed.set(Reg::MotorCurrentAndMicrostepping, 0x2014);
    assert_eq!(bed.current(), 2_000);
}

#[test]
fn cutback_comes_when_nothing_was_asked_for_as_long() {
    let mut bed = Bed::ready();
    bed.set(Reg::CurrentCutbackSettings, 0x0505); // half a second, 0.5 A
    bed.run_until(500.millis() - Duration::TICK);
    assert_eq!((bed.current(), bed.level("D5")), (1_000, Level::Low));
    bed.run_until(500.millis());
    assert_eq!((bed.current(), bed.level("D5")), (500, Level::High));
    // A change of an input gives the current back.
    bed.run_until(1.secs());
    bed.pin(5, false);
    assert_eq!((bed.current(), bed.level("D5")), (1_000, Level::Low));
    // A motion has it until its end, and the time begins anew there.
    bed.run_until(2.secs());
    assert_eq!(bed.current(), 500);
    bed.set(Reg::MotionControl, MOVE);
    assert_eq!(bed.current(), 1_000);
    bed.run_until(Instant::from(5.secs()) - Duration::TICK);
    assert_eq!(bed.current(), 1_000);
    bed.run_until(5.secs());
    assert_eq!(bed.current(), 500);
    // Other writes do not count, a write of 0x11 does.
    bed.set(Reg::UserRegister, 1);
    assert_eq!(bed.current(), 500);
    bed.set(Reg::MotionControl, 0);
    assert_eq!(bed.current(), 1_000);
    bed.run_until(10.secs());
    bed.set(Reg::CurrentCutbackSettings, 0x0005);
    assert_eq!((bed.current(), bed.level("D5")), (1_000, Level::Low), "no timeout, no cutback");
    bed.set(Reg::CurrentCutbackSettings, 0x0a07);
    assert_eq!(bed.current(), 700, "the time that has passed counts");
}

#[test]
fn lowcurrent_lowers_it_whatever_the_timeout() {
    let mut bed = Bed::ready();
    bed.set(Reg::HomingConfiguration, 2 << 1);
    bed.set(Reg::CurrentCutbackSettings, 0x0005);
    bed.pin(2, false);
    assert_eq!((bed.current(), bed.level("D5")), (500, Level::High));
    bed.set(Reg::MotionControl, JOG);
    assert_eq!(bed.current(), 500);
    bed.pin(2, true);
    assert_eq!((bed.current(), bed.level("D5")), (1_000, Level::Low));
}

#[test]
fn a_current_of_0_moves_nothing() {
    let mut bed = Bed::ready();
    bed.set(Reg::HomingConfiguration, 2 << 1);
    bed.set(Reg::MotionControl, MOVE);
    bed.run_until(1.secs());
    bed.pin(2, false); // LOWCURRENT, at level 0
    bed.run_until(1_500.millis());
    assert_eq!((bed.current(), bed.position(), bed.control()), (0, 3_750, MOVE));
    bed.pin(2, true);
    bed.run_until(3.secs());
    assert_eq!(bed.position(), 7_500);
}

#[test]
fn a_step_pulse_that_ends_the_cutback_is_made() {
    let mut bed = Bed::ready();
    bed.set(Reg::CurrentCutbackSettings, 0x0100); // 0.1 s, no current
    bed.run_until(1.secs());
    assert_eq!(bed.current(), 0);
    bed.pin(4, false);
    assert_eq!((bed.current(), bed.position()), (1_000, 1));
}

#[test]
fn inhibit_lets_the_profile_run_on_without_the_motor() {
    let mut bed = Bed::ready();
    bed.set(Reg::MotionControl, MOVE);
    bed.run_until(1.secs());
    assert_eq!(bed.position(), 3_750);
    bed.pin(3, false);
    assert_eq!((bed.current(), bed.control()), (0, MOVE));
    bed.run_until(1_500.millis());
    assert_eq!((bed.position(), bed.control(), bed.busy()), (3_750, MOVE, true));
    bed.pin(3, true);
    assert_eq!((bed.current(), bed.position()), (1_000, 3_750));
    bed.run_until(2_500.millis() - Duration::TICK);
    assert_eq!(bed.control(), MOVE);
    bed.run_until(2_500.millis());
    // What would have been made in half a second is lost.
    assert_eq!((bed.control(), bed.position()), (0, 7_500));
    // Begun and ended without current: no step.
    bed.pin(3, false);
    bed.set(Reg::MotionControl, MOVE);
    bed.run_until(10.secs());
    assert_eq!((bed.control(), bed.position()), (0, 7_500));
    bed.pin(4, false);
    bed.pin(3, true);
    assert_eq!(bed.position(), 7_500);
    bed.set(Reg::MotionControl, MOVE);
    bed.run_until(20.secs());
    assert_eq!(bed.position(), 17_500);
}

#[test]
fn inhibit_is_a_level_at_power_up() {
    let mut bed = Bed::booting();
    bed.pin(3, false);
    bed.run_until(3.secs());
    assert_eq!(bed.current(), 0);
    bed.pin(3, true);
    assert_eq!(bed.current(), 1_000);
}

#[test]
fn pin_3_clears_a_fault_in_each_of_its_functions() {
    for function in [0, 1, 2] {
        let mut bed = Bed::ready();
        bed.set(Reg::PinFunctionAndPolarity, function << 8);
        bed.input(bed.now, Input::Fault { fault: Fault(1), on: true });
        assert_eq!((bed.control(), bed.busy()), (FAULT, true));
        bed.pin(3, false);
        let homes = if function == 1 { HOME } else { 0 };
        assert_eq!(bed.control(), homes, "function {function}");
        let mut hot = Bed::ready();
        hot.set(Reg::PinFunctionAndPolarity, function << 8);
        hot.input(hot.now, Input::Fault { fault: Fault(0), on: true });
        hot.pin(3, false);
        assert_eq!(hot.control(), FAULT, "not while it is too hot");
    }
}

#[test]
fn a_fault_flashes_red_and_stops_the_green_heartbeat() {
    let mut bed = Bed::ready();
    bed.run_until(1.secs());
    bed.world.waves.clear();
    bed.input(bed.now, Input::Fault { fault: Fault(1), on: true });
    assert_eq!(bed.world.waves, [(bed.now, RED, 1_500.millis(), 250.millis())]);
    assert_eq!(bed.level("D6"), Level::Low);
    bed.run_until(2.secs());
    bed.set(Reg::MotionControl, FAULT);
    assert_eq!(bed.world.waves[1..], [(bed.now, GREEN, 1_500.millis(), 250.millis())]);
    assert_eq!(bed.level("D5"), Level::Low);
}

#[test]
fn a_new_polarity_ends_the_cutback_before_its_step() {
    let mut bed = Bed::ready();
    bed.set(Reg::CurrentCutbackSettings, 0x0a00);
    bed.run_until(2.secs());
    assert_eq!(bed.current(), 0);
    bed.set(Reg::PinFunctionAndPolarity, 0b0010);
    assert_eq!((bed.position(), bed.current(), bed.level("D5")), (1, 1_000, Level::Low));
}

#[test]
fn a_fault_that_a_new_function_clears_begins_the_cutback_anew() {
    for function in [0x0104, 0x0204] {
        let mut bed = Bed::ready();
        bed.set(Reg::Speed, 0);
        bed.set(Reg::CurrentCutbackSettings, 0x0a05);
        bed.input(bed.now, Input::Fault { fault: Fault(1), on: true });
        bed.run_until(5.secs());
        bed.set(Reg::PinFunctionAndPolarity, function);
        assert_eq!((bed.control(), bed.current()), (0, 1_000));
        bed.run_until(Instant::from(6.secs()) - Duration::TICK);
        assert_eq!(bed.current(), 1_000);
        bed.run_until(6.secs());
        assert_eq!(bed.current(), 500);
    }
}

#[test]
fn a_cause_at_power_up_shows_whatever_pin_3_holds() {
    for function in [0, 1, 2] {
        let mut bed = Bed::off(vec![0xFF; MEMORY]);
        let row = Reg::PinFunctionAndPolarity.row();
        bed.drive.poke(Instant::ZERO, row, function << 8, &mut bed.world).unwrap();
        bed.power_on(Boot::default());
        bed.pin(3, false);
        bed.input(bed.now, Input::Fault { fault: Fault(1), on: true });
        bed.run_until(3.secs());
        assert_eq!((bed.control(), bed.current()), (FAULT, 0), "function {function}");
    }
}
