//! Section 7.8, J2 pins 2 and 3: LOWCURRENT, SPEEDSEL; INHIBIT, HOME, INHIBIT_MODBUS_MOTION.

use drivetwin_protocol::time::Span;

use crate::rig::{RED, Rig, at, bit};

/// PinFunctionAndPolarity with pins 4 and 5 without function.
const NO_PIN_4_5: u16 = 0xf << 4;

/// A drive with this function of pin 2, which needs homing by index. The cutback level is 0.5 A.
fn pin_2(function: u16) -> Rig {
    let mut rig = Rig::ready();
    rig.write(at::HOMING, 2 << 1);
    rig.write(at::CURRENT_CUTBACK, 5);
    rig.write(at::PINS, NO_PIN_4_5 | function << 10);
    rig
}

fn pin_3(function: u16) -> Rig {
    let mut rig = Rig::ready();
    rig.write(at::PINS, NO_PIN_4_5 | function << 8);
    rig
}

/// LOWCURRENT reduces the current to the cutback level even with timeout 0, and switches the red light on.
#[test]
fn section_7_8_pin_2_lowcurrent() {
    let mut rig = pin_2(0);
    assert_eq!((rig.current(), rig.lit(RED)), (1_000, false));
    rig.low("J2.2");
    assert_eq!((rig.current(), rig.lit(RED)), (500, true));
    rig.after(10.secs());
    assert_eq!((rig.current(), rig.lit(RED)), (500, true));
    rig.open("J2.2");
    assert_eq!((rig.current(), rig.lit(RED)), (1_000, false));
}

/// Homing mode 3 is by index, too, so LOWCURRENT works.
#[test]
fn section_7_8_pin_2_lowcurrent_in_homing_mode_3() {
    let mut rig = pin_2(0);
    rig.write(at::HOMING, 3 << 1);
    rig.low("J2.2");
    assert_eq!(rig.current(), 500);
}

/// LOWCURRENT takes priority over cutback, even while the motor moves.
#[test]
fn section_7_8_pin_2_lowcurrent_wins_over_cutback() {
    let mut rig = pin_2(0);
    rig.write(at::CURRENT_CUTBACK, 10 << 8 | 5);
    rig.low("J2.2");
    rig.command(0);
    assert_eq!((rig.current(), rig.lit(RED)), (500, true));
    rig.command(bit::MOVE);
    rig.after(1.secs());
    rig.assert_on_its_way(3_750, 5_000.0);
    assert_eq!((rig.current(), rig.lit(RED)), (500, true));
}

/// Inverting a released pin makes it active at once, without an edge at the pin.
#[test]
fn section_7_8_pin_2_polarity() {
    let mut rig = pin_2(0);
    rig.write(at::PINS, NO_PIN_4_5 | 1 << 3);
    assert_eq!((rig.current(), rig.lit(RED)), (500, true));
    rig.low("J2.2");
    assert_eq!((rig.current(), rig.lit(RED)), (1_000, false));
    rig.write(at::PINS, NO_PIN_4_5);
    assert_eq!(rig.current(), 500);
}

/// MD3-18: in homing modes 0 and 1 pin 2 is only the home flag, whatever its function code.
#[test]
fn section_7_8_pin_2_is_only_the_flag_when_homing_by_switch() {
    for mode in [0, 1] {
        let mut rig = pin_2(0);
        rig.write(at::HOMING, mode << 1);
        rig.low("J2.2");
        assert_eq!((rig.current(), rig.lit(RED)), (1_000, false));
        rig.write(at::PINS, NO_PIN_4_5 | 1 << 10);
        rig.command(bit::JOG);
        rig.after(1.secs());
        rig.assert_on_its_way(3_750, 5_000.0);
    }
}

/// A change of HomingConfiguration changes the pin's function at once.
#[test]
fn section_7_8_pin_2_follows_the_homing_mode() {
    let mut rig = pin_2(0);
    rig.low("J2.2");
    assert_eq!(rig.current(), 500);
    rig.write(at::HOMING, 0);
    assert_eq!(rig.current(), 1_000);
    rig.write(at::HOMING, 2 << 1);
    assert_eq!(rig.current(), 500);
}

#[test]
fn section_7_8_pin_2_speedsel() {
    let mut rig = pin_2(1);
    rig.command(bit::JOG);
    rig.after(1.secs());
    rig.assert_on_its_way(3_750, 5_000.0);
    rig.low("J2.2"); // ramps to 2,500/s in 0.25 s and 937.5 steps
    assert_eq!(rig.current(), 1_000);
    rig.after(250.millis());
    rig.assert_on_its_way(3_750 + 937, 2_500.0);
}

#[test]
fn section_7_8_pin_2_speedsel_inverted() {
    let mut rig = pin_2(1);
    rig.write(at::PINS, NO_PIN_4_5 | 1 << 10 | 1 << 3); // open: active, the alternate speed
    rig.command(bit::JOG);
    rig.after(1.secs());
    assert_eq!(rig.speed(), 2_500.0);
    rig.low("J2.2");
    rig.after(1.secs());
    assert_eq!(rig.speed(), 5_000.0);
}

/// MD3-18: codes 2 and 3 have no function.
#[test]
fn section_7_8_pin_2_invalid_functions() {
    for function in [2, 3] {
        let mut rig = pin_2(function);
        rig.low("J2.2");
        assert_eq!((rig.current(), rig.lit(RED)), (1_000, false));
        rig.command(bit::JOG);
        rig.after(1.secs());
        rig.assert_on_its_way(3_750, 5_000.0);
    }
}

/// MD3-28: the profile continues without current, and its steps are lost. At 1 s the motor is at 3,750. The
/// profile of 10,000 steps reaches 6,250 at 1.5 s, so the motor makes only the remaining 3,750 steps.
#[test]
fn section_7_8_pin_3_inhibit() {
    let mut rig = pin_3(0);
    rig.command(bit::MOVE);
    rig.after(1.secs());
    rig.low("J2.3");
    let stopped_at = rig.position();
    assert!((stopped_at - 3_750).abs() <= 1);
    rig.after(500.millis());
    assert_eq!((rig.current(), rig.position()), (0, stopped_at));
    assert_eq!(rig.motion_control(), bit::MOVE);
    rig.open("J2.3");
    assert_eq!(rig.current(), 1_000);
    rig.until_idle();
    assert!((rig.position() - 7_500).abs() <= 1, "{}", rig.position());
    assert_eq!(rig.motion_control(), 0);
}

/// MD3-28: bit 0 stays 1 for the whole duration of the profile, 2.5 s.
#[test]
fn section_7_8_pin_3_inhibit_over_the_end_of_a_move() {
    let mut rig = pin_3(0);
    rig.command(bit::MOVE);
    rig.after(1.secs());
    rig.low("J2.3");
    let stopped_at = rig.position();
    rig.after(1_499.millis());
    assert_eq!(rig.motion_control(), bit::MOVE);
    rig.after(2.millis());
    assert_eq!(rig.motion_control(), 0);
    rig.open("J2.3");
    rig.after(1.secs());
    assert_eq!(rig.current(), 1_000);
    rig.assert_stands(stopped_at);
}

/// A move that is commanded while the drive is inhibited takes its usual time, but the motor does not move.
#[test]
fn section_7_8_pin_3_a_move_while_inhibited() {
    let mut rig = pin_3(0);
    rig.low("J2.3");
    assert_eq!(rig.current(), 0);
    rig.command(bit::MOVE);
    rig.after(2_499.millis());
    assert_eq!((rig.motion_control(), rig.position()), (bit::MOVE, 0));
    rig.after(2.millis());
    assert_eq!((rig.motion_control(), rig.position()), (0, 0));
    rig.open("J2.3");
    assert_eq!(rig.current(), 1_000);
}

/// A jog continues while the drive is inhibited, too. After 1 s the motor is at 3,750; it loses the steps of
/// the second without current.
#[test]
fn section_7_8_pin_3_inhibit_in_a_jog() {
    let mut rig = pin_3(0);
    rig.command(bit::JOG);
    rig.after(1.secs());
    rig.low("J2.3");
    rig.after(1.secs());
    assert_eq!((rig.motion_control(), rig.current()), (bit::JOG, 0));
    assert!((rig.position() - 3_750).abs() <= 1);
    rig.open("J2.3");
    rig.after(1.secs());
    rig.assert_on_its_way(8_750, 5_000.0);
    // After a stop while the drive is inhibited, the motor keeps its position.
    rig.low("J2.3");
    rig.command(bit::DECEL_STOP);
    rig.after(1.secs());
    rig.open("J2.3");
    rig.after(1.secs());
    assert_eq!((rig.motion_control(), rig.current()), (0, 1_000));
    assert!((rig.position() - 8_750).abs() <= 1);
}

/// The drive is inhibited twice in a move: when the profile is at 3,750 and at 6,250, each time for 0.25 s
/// and 1,250 steps.
#[test]
fn section_7_8_pin_3_inhibit_twice() {
    let mut rig = pin_3(0);
    rig.command(bit::MOVE);
    rig.after(1.secs());
    for _ in 0..2 {
        rig.low("J2.3");
        rig.after(250.millis());
        rig.open("J2.3");
        rig.after(250.millis());
    }
    rig.until_idle();
    assert!((rig.position() - 7_500).abs() <= 2, "{}", rig.position());
}

/// MD3-19: a single write of 0x09 can inhibit the drive.
#[test]
fn section_7_8_pin_3_inhibit_by_polarity() {
    let mut rig = pin_3(0);
    rig.write(at::PINS, NO_PIN_4_5 | 1 << 2);
    assert_eq!(rig.current(), 0);
    rig.low("J2.3");
    assert_eq!(rig.current(), 1_000);
    rig.write(at::PINS, NO_PIN_4_5);
    assert_eq!(rig.current(), 0);
}

/// MD3-19: INHIBIT acts on the level of the pin, so it works from power-up.
#[test]
fn section_7_8_pin_3_inhibit_at_power_up() {
    let mut rig = pin_3(0);
    rig.low("J2.3");
    rig.power_cycle();
    rig.after(3.secs());
    assert_eq!(rig.current(), 0);
    rig.open("J2.3");
    assert_eq!(rig.current(), 1_000);
}

#[test]
fn section_7_8_pin_3_home() {
    let mut rig = pin_3(1);
    rig.low("J2.3");
    assert_eq!(rig.motion_control(), bit::HOME);
    rig.after(1.secs());
    rig.assert_on_its_way(3_750, 5_000.0);
    rig.open("J2.3");
    rig.after(1.secs());
    rig.assert_on_its_way(8_750, 5_000.0);
    rig.low("J2.2");
    rig.after(4.micros());
    assert_eq!((rig.motion_control(), rig.current()), (0, 1_000));
}

/// An edge at HOME during another kind of motion is ignored, and not executed later.
#[test]
fn section_7_8_pin_3_home_while_moving() {
    let mut rig = pin_3(1);
    rig.command(bit::MOVE);
    rig.after(1.secs());
    rig.low("J2.3");
    assert_eq!(rig.motion_control(), bit::MOVE);
    rig.until_idle();
    rig.after(1.secs());
    rig.assert_stands(10_000);
}

#[test]
fn section_7_8_pin_3_home_inverted() {
    let mut rig = pin_3(1);
    rig.low("J2.3");
    rig.command(bit::STOP);
    rig.write(at::PINS, NO_PIN_4_5 | 1 << 8 | 1 << 2);
    assert_eq!(rig.motion_control(), 0);
    rig.open("J2.3"); // a rising edge
    assert_eq!(rig.motion_control(), bit::HOME);
}

/// MD3-19: a change of polarity that makes the pin active counts as an edge.
#[test]
fn section_7_8_pin_3_home_by_polarity() {
    let mut rig = pin_3(1);
    rig.write(at::PINS, NO_PIN_4_5 | 1 << 8 | 1 << 2);
    assert_eq!(rig.motion_control(), bit::HOME);
}

/// MD3-29: while pin 3 inhibits motion, the drive answers motion commands but does not execute them. The motor current
/// stays on, and the command Disable works.
#[test]
fn section_7_8_pin_3_inhibit_modbus_motion() {
    let mut rig = pin_3(2);
    rig.command(bit::MOVE);
    rig.after(1.secs());
    rig.low("J2.3");
    let stopped_at = rig.position();
    assert!((stopped_at - 3_750).abs() <= 1);
    rig.assert_stands(stopped_at);
    assert_eq!((rig.motion_control(), rig.current()), (0, 1_000));
    for command in [bit::MOVE, bit::JOG, bit::HOME, bit::DECEL_STOP, bit::STOP] {
        rig.command(command);
        assert_eq!(rig.motion_control(), 0);
        rig.after(1.secs());
        rig.assert_stands(stopped_at);
    }
    rig.command(bit::DISABLE);
    assert_eq!((rig.motion_control(), rig.current()), (bit::DISABLE, 0));
    rig.command(bit::MOVE);
    assert_eq!((rig.motion_control(), rig.current()), (0, 1_000));
    rig.open("J2.3");
    rig.after(1.secs());
    rig.assert_stands(stopped_at);
    rig.command(bit::MOVE);
    assert_eq!(rig.until_idle(), 2_500.millis());
    rig.assert_stands(stopped_at + 10_000);
}

/// "J2 pins 2/3/4/5 functions work normally."
#[test]
fn section_7_8_pin_3_inhibit_modbus_motion_lets_pins_work() {
    let mut rig = pin_3(2);
    rig.write(at::PINS, 1 << 4 | 2 << 8);
    rig.low("J2.3");
    rig.low("J2.4");
    assert_eq!(rig.motion_control(), bit::MOVE);
    rig.until_idle();
    rig.assert_stands(10_000);
}

/// MD3-19: a change of the polarity alone stops the motion.
#[test]
fn section_7_8_pin_3_inhibit_modbus_motion_by_polarity() {
    let mut rig = pin_3(2);
    rig.command(bit::JOG);
    rig.after(1.secs());
    rig.write(at::PINS, NO_PIN_4_5 | 2 << 8 | 1 << 2);
    assert_eq!((rig.speed(), rig.motion_control(), rig.current()), (0.0, 0, 1_000));
}

/// MD3-18: code 3 has no function.
#[test]
fn section_7_8_pin_3_invalid_function() {
    let mut rig = pin_3(3);
    rig.command(bit::MOVE);
    rig.after(1.secs());
    rig.low("J2.3");
    assert_eq!(rig.current(), 1_000);
    assert_eq!(rig.until_idle(), 1_500.millis() - drivetwin_protocol::time::Duration::TICK);
    rig.assert_stands(10_000);
}

/// Activating INHIBIT, HOME or INHIBIT_MODBUS_MOTION clears a fault that is not a thermal one.
#[test]
fn section_7_8_pin_3_clears_a_fault() {
    for function in [0, 1, 2] {
        let mut rig = pin_3(function);
        rig.fault("over_current", true);
        rig.fault("over_current", false);
        rig.after(1.secs());
        assert_eq!(rig.motion_control(), bit::FAULT);
        rig.low("J2.3");
        // HOME clears the fault and starts a home cycle.
        assert_eq!(rig.motion_control(), if function == 1 { bit::HOME } else { 0 });
        rig.open("J2.3");
        assert_eq!(rig.current(), 1_000);
    }
}

/// MD3-14: the pin clears a thermal fault only after the drive has cooled.
#[test]
fn section_7_8_pin_3_does_not_clear_a_thermal_fault() {
    for function in [0, 1, 2] {
        let mut rig = pin_3(function);
        rig.fault("over_temperature", true);
        rig.low("J2.3");
        assert_eq!(rig.motion_control(), bit::FAULT, "function {function}");
        rig.open("J2.3");
        rig.after(1.secs());
        assert_eq!((rig.motion_control(), rig.position()), (bit::FAULT, 0));
        rig.fault("over_temperature", false);
        assert_eq!(rig.motion_control(), bit::FAULT);
        rig.low("J2.3");
        assert_eq!(rig.motion_control(), if function == 1 { bit::HOME } else { 0 });
    }
}

/// A pin that stays active clears no fault, even if other pins change.
#[test]
fn section_7_8_pin_3_held_clears_no_fault() {
    for function in [0, 2] {
        let mut rig = pin_3(function);
        rig.low("J2.3");
        rig.fault("over_current", true);
        rig.fault("over_current", false);
        rig.low("J2.4");
        rig.open("J2.5");
        rig.write(at::PINS, NO_PIN_4_5 | function << 8 | 1);
        assert_eq!(rig.motion_control(), bit::FAULT, "function {function}");
    }
}

/// Releasing the pin clears no fault; activating it does.
#[test]
fn section_7_8_pin_3_clears_by_its_active_edge() {
    let mut rig = pin_3(2);
    rig.low("J2.3");
    rig.fault("over_current", true);
    rig.fault("over_current", false);
    rig.open("J2.3");
    assert_eq!(rig.motion_control(), bit::FAULT);
    rig.low("J2.3");
    assert_eq!(rig.motion_control(), 0);
}
