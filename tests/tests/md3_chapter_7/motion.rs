//! Sections 7.15 to 7.19: moves, jogs and stops. At the defaults (5,000 steps/s, 10,000 steps/s²) a
//! ramp takes 5,000/10,000 = 0.5 s and 5,000²/(2·10,000) = 1,250 steps.

use drivetwin_protocol::time::Span;

use crate::rig::{Rig, at, bit};

/// 10,000 steps: 1,250 up, 7,500 at 5,000/s in 1.5 s, 1,250 down. The move takes 2.5 s.
#[test]
fn section_7_15_move() {
    let mut rig = Rig::ready();
    rig.command(bit::MOVE);
    assert_eq!(rig.motion_control(), bit::MOVE);
    rig.after(250.millis());
    rig.assert_on_its_way(312, 2_500.0); // 10,000·0.25²/2 = 312.5
    rig.after(250.millis());
    rig.assert_on_its_way(1_250, 5_000.0);
    rig.after(500.millis());
    rig.assert_on_its_way(3_750, 5_000.0);
    rig.after(1_250.millis()); // 2.25 s: a quarter of a second to go
    rig.assert_on_its_way(9_687, 2_500.0); // 10,000 − 312.5
    assert_eq!(rig.motion_control(), bit::MOVE);
    assert_eq!(rig.until_idle(), 250.millis());
    rig.assert_stands(10_000);
    assert_eq!(rig.motion_control(), 0);
}

/// A move with too few steps for the speed: "it will ramp up to the max speed possible and then ramp down".
/// 400 steps: 200 up in √(2·200/10,000) = 0.2 s to 2,000/s, 200 down.
#[test]
fn section_7_16_a_short_move_is_a_triangle() {
    let mut rig = Rig::ready();
    rig.write_long(at::MOVE_STEPS, 400);
    rig.command(bit::MOVE);
    rig.after(200.millis());
    rig.assert_on_its_way(200, 2_000.0);
    assert_eq!(rig.until_idle(), 200.millis());
    rig.assert_stands(400);
}

#[test]
fn section_7_16_negative_steps_go_the_other_way() {
    let mut rig = Rig::ready();
    rig.write_long(at::MOVE_STEPS, -10_000);
    rig.command(bit::MOVE);
    rig.after(1.secs());
    rig.assert_on_its_way(-3_750, -5_000.0);
    assert_eq!(rig.until_idle(), 1_500.millis());
    rig.assert_stands(-10_000);
}

#[test]
fn section_7_16_no_steps_no_motion() {
    let mut rig = Rig::ready();
    rig.write_long(at::MOVE_STEPS, 0);
    rig.command(bit::MOVE);
    assert_eq!(rig.motion_control(), 0);
    rig.assert_stands(0);
}

/// "Two commands in any order" (6.2); 65,536 steps = 0x0001_0000.
#[test]
fn section_7_16_halves_in_any_order() {
    let mut rig = Rig::ready();
    rig.write(at::MOVE_STEPS + 1, 0);
    rig.write(at::MOVE_STEPS, 1);
    assert_eq!(rig.read_long(at::MOVE_STEPS), 65_536);
    rig.command(bit::MOVE);
    rig.until_idle();
    rig.assert_stands(65_536);
}

/// MD3-7: if the speed or the acceleration is 0, a command ends at once without motion.
#[test]
fn section_7_15_without_speed_or_acceleration_nothing_moves() {
    for register in [at::SPEED, at::ACCEL_DECEL] {
        for command in [bit::MOVE, bit::JOG, bit::HOME] {
            let mut rig = Rig::ready();
            rig.write_long(register, 0);
            rig.command(command);
            assert_eq!(rig.motion_control(), 0, "{command:#06x} with 0 in {register:#04x}");
            rig.after(1.secs());
            rig.assert_stands(0);
        }
    }
}

#[test]
fn section_7_15_a_move_while_moving_is_ignored() {
    let mut rig = Rig::ready();
    rig.command(bit::MOVE);
    rig.after(1.secs());
    // MD3-4: Move, Jog and Home are ignored during a move.
    for command in [bit::MOVE, bit::JOG, bit::HOME] {
        rig.command(command);
        assert_eq!(rig.motion_control(), bit::MOVE);
    }
    assert_eq!(rig.until_idle(), 1_500.millis());
    rig.assert_stands(10_000);
}

/// MD3-3: a write of 0 while the motor moves changes nothing.
#[test]
fn section_7_15_writing_0_stops_nothing() {
    let mut rig = Rig::ready();
    rig.command(bit::MOVE);
    rig.after(1.secs());
    rig.command(0);
    assert_eq!(rig.until_idle(), 1_500.millis());
    rig.assert_stands(10_000);
}

#[test]
fn section_7_15_jog() {
    let mut rig = Rig::ready();
    rig.command(bit::JOG);
    rig.after(500.millis());
    rig.assert_on_its_way(1_250, 5_000.0);
    rig.after(1_000.secs());
    rig.assert_on_its_way(5_001_250, 5_000.0);
    assert_eq!(rig.motion_control(), bit::JOG);
}

#[test]
fn section_7_15_jog_with_a_negative_speed() {
    let mut rig = Rig::ready();
    rig.write_long(at::SPEED, -2_000);
    rig.command(bit::JOG);
    rig.after(1.secs()); // up in 0.2 s and 200 steps, 0.8 s at 2,000/s
    rig.assert_on_its_way(-1_800, -2_000.0);
}

/// MD3-4: Move and Home are ignored during a jog.
#[test]
fn section_7_15_a_jog_goes_on_whatever_else_is_commanded() {
    for command in [bit::MOVE, bit::HOME] {
        let mut rig = Rig::ready();
        rig.command(bit::JOG);
        rig.after(1.secs());
        rig.command(command);
        rig.after(10.secs());
        rig.assert_on_its_way(53_750, 5_000.0);
        assert_eq!(rig.motion_control(), bit::JOG);
    }
}

#[test]
fn section_7_15_stop_is_immediate_and_keeps_the_current() {
    let mut rig = Rig::ready();
    rig.command(bit::MOVE);
    rig.after(1.secs());
    rig.command(bit::STOP);
    let stopped_at = rig.position();
    assert!((stopped_at - 3_750).abs() <= 1);
    rig.assert_stands(stopped_at);
    assert_eq!((rig.motion_control(), rig.current()), (0, 1_000));
    rig.after(5.secs());
    rig.assert_stands(stopped_at);
}

/// A stop from 5,000/s takes 0.5 s and 1,250 steps.
#[test]
fn section_7_15_decel_stop_ramps_down_and_keeps_the_current() {
    let mut rig = Rig::ready();
    rig.command(bit::JOG);
    rig.after(1.secs());
    rig.command(bit::DECEL_STOP);
    assert_eq!(rig.motion_control(), bit::DECEL_STOP); // the bit is set until the stop is completed
    rig.after(250.millis());
    rig.assert_on_its_way(3_750 + 1_250 - 312, 2_500.0);
    assert_eq!(rig.until_idle(), 250.millis());
    rig.assert_stands(5_000);
    assert_eq!((rig.motion_control(), rig.current()), (0, 1_000));
}

/// Decel-stop ends a profile move early. At 0.25 s the speed is 2,500/s and the position 312.5 steps;
/// stopping takes the same time and number of steps again.
#[test]
fn section_7_15_decel_stop_ends_a_move() {
    let mut rig = Rig::ready();
    rig.command(bit::MOVE);
    rig.after(250.millis());
    rig.command(bit::DECEL_STOP);
    assert_eq!(rig.until_idle(), 250.millis());
    rig.assert_stands(625);
}

#[test]
fn section_7_15_stops_from_a_stop_do_nothing() {
    let mut rig = Rig::ready();
    for stop in [bit::STOP, bit::DECEL_STOP] {
        rig.command(stop);
        assert_eq!(rig.motion_control(), 0);
        rig.assert_stands(0);
    }
}

/// Disable switches the current off and clears the other bits. The bit stays set until 0 is written to it
/// (MD3-3).
#[test]
fn section_7_15_disable() {
    let mut rig = Rig::ready();
    rig.command(bit::MOVE);
    rig.after(1.secs());
    rig.command(bit::DISABLE);
    let stopped_at = rig.position();
    rig.assert_stands(stopped_at);
    assert_eq!((rig.motion_control(), rig.current()), (bit::DISABLE, 0));
    // MD3-3: if bit 5 is written as 1, the other bits are ignored.
    rig.command(bit::DISABLE | bit::MOVE);
    assert_eq!(rig.motion_control(), bit::DISABLE);
    rig.after(1.secs());
    rig.assert_stands(stopped_at);
    rig.command(0);
    assert_eq!((rig.motion_control(), rig.current()), (0, 1_000));
    rig.after(1.secs());
    rig.assert_stands(stopped_at);
}

/// MD3-3: a command with bit 5 = 0 enables the drive and is executed.
#[test]
fn section_7_15_a_move_enables() {
    let mut rig = Rig::ready();
    rig.command(bit::DISABLE);
    rig.command(bit::MOVE);
    assert_eq!((rig.motion_control(), rig.current()), (bit::MOVE, 1_000));
    assert_eq!(rig.until_idle(), 2_500.millis());
    rig.assert_stands(10_000);
}

/// MD3-3: if several bits are set, the first of Stop, Decel-stop, Home, Jog, Move is executed.
#[test]
fn section_7_15_several_bits_at_once() {
    let mut rig = Rig::ready();
    rig.command(bit::JOG | bit::MOVE);
    assert_eq!(rig.motion_control(), bit::JOG);
    rig.after(1.secs());
    rig.command(bit::DECEL_STOP | bit::HOME | bit::JOG | bit::MOVE);
    assert_eq!(rig.motion_control(), bit::DECEL_STOP);
    rig.until_idle();
    rig.command(bit::HOME | bit::JOG | bit::MOVE);
    assert_eq!(rig.motion_control(), bit::HOME);
    rig.command(bit::STOP | bit::DECEL_STOP | bit::HOME);
    assert_eq!(rig.motion_control(), 0);
    rig.after(1.secs());
    rig.assert_stands(5_000);
}

/// MD3-2: unused bits of other registers read back as written; unused bits of this register read 0.
#[test]
fn section_7_15_unused_bits_read_0() {
    let mut rig = Rig::ready();
    rig.command(0x7fc0); // bits 14:6
    assert_eq!(rig.motion_control(), 0);
    rig.assert_stands(0);
}

/// MD3-14: an over-temperature fault cannot be cleared before the drive has cooled, and stays until it is
/// cleared after that.
#[test]
fn section_7_15_a_thermal_fault() {
    let mut rig = Rig::ready();
    rig.command(bit::MOVE);
    rig.after(1.secs());
    rig.fault("over_temperature", true);
    assert_eq!((rig.speed(), rig.current()), (0.0, 0));
    assert!(rig.busy());
    assert_eq!(rig.motion_control(), bit::FAULT);
    rig.command(bit::FAULT);
    assert_eq!(rig.motion_control(), bit::FAULT);
    rig.fault("over_temperature", false);
    assert_eq!(rig.motion_control(), bit::FAULT);
    rig.command(bit::FAULT);
    assert_eq!((rig.motion_control(), rig.current()), (0, 1_000));
    assert!(!rig.busy());
}

#[test]
fn section_7_15_another_fault_is_cleared_by_its_bit() {
    let mut rig = Rig::ready();
    rig.fault("over_current", true);
    rig.fault("over_current", false);
    rig.after(1.secs());
    assert_eq!((rig.motion_control(), rig.current()), (bit::FAULT, 0)); // MD3-14: it stays until cleared
    // MD3-3: bit 15 clears the fault first, then the other bits of the same write are executed.
    rig.command(bit::FAULT | bit::MOVE);
    assert_eq!((rig.motion_control(), rig.current()), (bit::MOVE, 1_000));
    assert_eq!(rig.until_idle(), 2_500.millis());
    rig.assert_stands(10_000);
}

/// MD3-14: "all serial port commands will appear to work normally, except that the motor will
/// not move".
#[test]
fn section_7_15_in_a_fault_every_command_is_answered() {
    let mut rig = Rig::ready();
    rig.fault("over_temperature", true);
    for command in [bit::MOVE, bit::JOG, bit::HOME, bit::STOP, bit::DECEL_STOP, 0] {
        rig.command(command);
        assert_eq!(rig.motion_control(), bit::FAULT);
        rig.after(1.secs());
        assert_eq!((rig.position(), rig.current()), (0, 0));
    }
    rig.write(at::USER, 7);
    assert_eq!(rig.read(at::USER), 7);
}

#[test]
fn section_7_17_a_jog_ramps_to_a_new_speed() {
    let mut rig = Rig::ready();
    rig.command(bit::JOG);
    rig.after(1.secs());
    rig.write(at::SPEED + 1, 8_000); // 3,000/s more: 0.3 s, 1,950 steps at 6,500/s on average
    rig.after(300.millis());
    rig.assert_on_its_way(3_750 + 1_950, 8_000.0);
    rig.write(at::SPEED + 1, 1_000); // 7,000/s less: 0.7 s at 4,500/s
    rig.after(700.millis());
    rig.assert_on_its_way(5_700 + 3_150, 1_000.0);
}

/// A jog reverses through standstill: 0.2 s and 200 steps down, 0.2 s and 200 steps up.
#[test]
fn section_7_17_a_jog_reverses() {
    let mut rig = Rig::ready();
    rig.write_long(at::SPEED, 2_000);
    rig.command(bit::JOG);
    rig.after(1_200.millis()); // 200 + 2,000
    // −2,000 = 0xFFFF_F830. Between the two writes the register is 63,536, which has no visible effect.
    rig.write(at::SPEED + 1, (-2_000_i16).cast_unsigned());
    rig.write(at::SPEED, 0xFFFF);
    rig.after(200.millis());
    let there = rig.position();
    assert!((there - 2_400).abs() <= 1 && rig.speed().abs() < 1.0, "{there}");
    assert!(rig.busy());
    rig.after(200.millis());
    rig.assert_on_its_way(2_200, -2_000.0);
    assert_eq!(rig.motion_control(), bit::JOG);
}

/// In a jog a write of the high half alone changes the speed: 0x0001_1388 = 70,536 acts as 40,000.
#[test]
fn section_7_17_the_high_half_first_is_a_value_in_between() {
    let mut rig = Rig::ready();
    rig.command(bit::JOG);
    rig.after(500.millis());
    rig.write(at::SPEED, 1);
    rig.after(100.millis());
    rig.assert_on_its_way(1_250 + 550, 6_000.0);
    rig.after(10.secs());
    assert_eq!(rig.speed(), 40_000.0);
}

#[test]
fn section_7_17_speeds_are_at_most_40_000() {
    let mut rig = Rig::ready();
    rig.write_long(at::ACCEL_DECEL, 100_000);
    for (speed, acts_as) in [(40_000, 40_000.0), (40_001, 40_000.0), (-1_000_000, -40_000.0)] {
        rig.write_long(at::SPEED, speed);
        assert_eq!(rig.read_long(at::SPEED), speed); // the limit applies when it is used
        rig.command(bit::JOG);
        rig.after(2.secs());
        assert_eq!(rig.speed(), acts_as);
        rig.command(bit::STOP);
    }
}

/// The sign of MoveSteps gives the direction of a move, whatever the sign of Speed.
#[test]
fn section_7_17_a_move_uses_the_absolute_speed() {
    let mut rig = Rig::ready();
    rig.write_long(at::SPEED, -5_000);
    rig.command(bit::MOVE);
    rig.after(1.secs());
    rig.assert_on_its_way(3_750, 5_000.0);
    assert_eq!(rig.until_idle(), 1_500.millis());
    rig.assert_stands(10_000);
}

#[test]
fn section_7_17_speed_changes_in_a_move_are_ignored() {
    let mut rig = Rig::ready();
    rig.command(bit::MOVE);
    rig.after(1.secs());
    rig.write(at::SPEED + 1, 100);
    rig.write(at::SPEED, 0xFFFF);
    assert_eq!(rig.until_idle(), 1_500.millis());
    rig.assert_stands(10_000);
    // The next move uses the new speed: 100 steps at 100/s take 1.01 s, with 0.01 s and half a step for each
    // ramp.
    rig.write_long(at::SPEED, 100);
    rig.write_long(at::MOVE_STEPS, 100);
    rig.command(bit::MOVE);
    assert_eq!(rig.until_idle(), 1_010.millis());
}

/// MD3-6: a write to either half of the acceleration stops a move, even if the value does not change.
#[test]
fn section_7_17_an_acceleration_written_in_a_move_stops_it() {
    for (half, value) in [(0, 0), (1, 10_000)] {
        let mut rig = Rig::ready();
        rig.command(bit::MOVE);
        rig.after(1.secs());
        rig.write(at::ACCEL_DECEL + half, value);
        let stopped_at = rig.position();
        assert!((stopped_at - 3_750).abs() <= 1);
        rig.assert_stands(stopped_at);
        assert_eq!((rig.motion_control(), rig.current()), (0, 1_000));
    }
}

/// MD3-6: a jog uses a new acceleration from its next ramp on. From 5,000/s down at 2,500/s²: 2 s, 5,000
/// steps.
#[test]
fn section_7_19_an_acceleration_written_in_a_jog_is_for_its_next_ramp() {
    let mut rig = Rig::ready();
    rig.command(bit::JOG);
    rig.after(1.secs());
    rig.write(at::ACCEL_DECEL + 1, 2_500);
    rig.after(1.secs());
    rig.assert_on_its_way(8_750, 5_000.0);
    rig.command(bit::DECEL_STOP);
    assert_eq!(rig.until_idle(), 2.secs());
    rig.assert_stands(13_750);
}

/// 0x0007_A120 = 500,000 steps/s²: to 40,000/s in 0.08 s and 1,600 steps.
#[test]
fn section_7_19_acceleration_has_32_bits() {
    let mut rig = Rig::ready();
    rig.write(at::ACCEL_DECEL, 0x0007);
    rig.write(at::ACCEL_DECEL + 1, 0xa120);
    rig.write_long(at::SPEED, 40_000);
    rig.write_long(at::MOVE_STEPS, 100_000);
    rig.command(bit::MOVE);
    rig.after(80.millis());
    rig.assert_on_its_way(1_600, 40_000.0);
    // 96,800 steps of cruise are 2.42 s.
    assert_eq!(rig.until_idle(), 2_500.millis());
    rig.assert_stands(100_000);
}

/// The ramp down is as long as the ramp up, even if the motor reaches full speed only for a moment: 2,500
/// steps = 1,250 up and 1,250 down.
#[test]
fn section_7_16_ramps_are_as_long_up_as_down() {
    let mut rig = Rig::ready();
    rig.write_long(at::MOVE_STEPS, 2_500);
    rig.command(bit::MOVE);
    rig.after(500.millis());
    rig.assert_on_its_way(1_250, 5_000.0);
    assert_eq!(rig.until_idle(), 500.millis());
    rig.assert_stands(2_500);
}

/// If the speed of a jog becomes 0, the motor is at standstill, but the jog lasts until a stop.
#[test]
fn section_7_17_a_jog_at_speed_0() {
    let mut rig = Rig::ready();
    rig.command(bit::JOG);
    rig.after(1.secs());
    rig.write(at::SPEED + 1, 0);
    rig.after(1.secs());
    assert_eq!((rig.position(), rig.moving(), rig.busy()), (5_000, false, true));
    assert_eq!(rig.motion_control(), bit::JOG);
    rig.write(at::SPEED + 1, 5_000);
    rig.after(500.millis());
    rig.assert_on_its_way(6_250, 5_000.0);
    rig.write(at::SPEED + 1, 0);
    rig.after(1.secs());
    rig.command(bit::STOP);
    assert_eq!(rig.motion_control(), 0);
    rig.assert_stands(7_500);
}

/// MD3-4: Jog while jogging ramps to the speed in the registers with the acceleration in the registers. From
/// 5,000/s to 8,000/s in 1 s at 3,000/s².
#[test]
fn section_7_15_jog_while_jogging() {
    let mut rig = Rig::ready();
    rig.command(bit::JOG);
    rig.after(1.secs());
    rig.write(at::ACCEL_DECEL + 1, 3_000);
    rig.write(at::SPEED + 1, 8_000);
    rig.command(bit::JOG);
    rig.after(1.secs());
    rig.assert_on_its_way(3_750 + 6_500, 8_000.0);
    assert_eq!(rig.motion_control(), bit::JOG);
}

/// If the acceleration becomes 0, a running jog keeps its speed, and Decel-stop stops at once.
#[test]
fn section_7_19_a_jog_that_loses_its_acceleration() {
    let mut rig = Rig::ready();
    rig.command(bit::JOG);
    rig.after(1.secs());
    rig.write(at::ACCEL_DECEL + 1, 0);
    rig.write(at::SPEED + 1, 8_000);
    rig.after(1.secs());
    rig.assert_on_its_way(8_750, 5_000.0);
    rig.command(bit::DECEL_STOP);
    let stopped_at = rig.position();
    assert!((stopped_at - 8_750).abs() <= 1);
    rig.assert_stands(stopped_at);
}

/// A move with the largest acceleration works: 10,000 steps at 5,000/s take 2 s and less than 10 µs more.
#[test]
fn section_7_19_the_largest_acceleration() {
    let mut rig = Rig::ready();
    rig.write_long(at::ACCEL_DECEL, -1);
    rig.command(bit::MOVE);
    let took = rig.until_idle();
    assert!(took >= 2.secs() && took < 2.secs() + 10.micros(), "{took:?}");
    rig.assert_stands(10_000);
}

/// A fault that has a cause at power-on is shown at the end of the start-up delay.
#[test]
fn section_7_15_a_fault_at_power_up() {
    let mut rig = Rig::ready();
    rig.fault("over_temperature", true);
    rig.power_cycle();
    rig.after(3.secs());
    assert_eq!((rig.motion_control(), rig.current()), (bit::FAULT, 0));
    assert!(rig.busy());
}

/// SPEEDSEL (homing by index, pin 2 function 1): low selects the alternate speed.
fn with_speedsel() -> Rig {
    let mut rig = Rig::ready();
    rig.write(at::HOMING, 2 << 1);
    rig.write(at::PINS, 1 << 10 | 0xf << 4);
    rig
}

/// From 5,000/s to the default alternate speed 2,500/s: 0.25 s, 937.5 steps.
#[test]
fn section_7_18_a_jog_ramps_to_the_selected_speed() {
    let mut rig = with_speedsel();
    rig.command(bit::JOG);
    rig.after(1.secs());
    rig.low("J2.2");
    rig.after(250.millis());
    rig.assert_on_its_way(3_750 + 937, 2_500.0);
    rig.open("J2.2");
    rig.after(250.millis());
    rig.assert_on_its_way(3_750 + 1_875, 5_000.0);
}

/// Section 7.18 prints 0x14/0x15 but means 0x16/0x17. The alternate speed is unsigned and gets the sign of
/// Speed.
#[test]
fn section_7_18_the_alternate_speed_takes_the_sign_of_speed() {
    let mut rig = with_speedsel();
    rig.low("J2.2");
    rig.write_long(at::SPEED, -1);
    rig.command(bit::JOG);
    rig.after(1.secs()); // 0.25 s and 312.5 steps up, 0.75 s at 2,500/s
    rig.assert_on_its_way(-312 - 1_875, -2_500.0);
    // A write while jogging takes effect at once (7.17).
    rig.write(at::ALTERNATE_SPEED + 1, 3_500);
    rig.after(100.millis());
    assert_eq!(rig.speed(), -3_500.0);
}

/// The alternate speed is limited to 40,000; 0xFFFF_FFFF is not −1.
#[test]
fn section_7_18_the_alternate_speed_is_at_most_40_000() {
    let mut rig = with_speedsel();
    rig.low("J2.2");
    rig.write_long(at::ALTERNATE_SPEED, -1);
    assert_eq!(rig.words(at::ALTERNATE_SPEED, 2), [0xFFFF, 0xFFFF]);
    rig.command(bit::JOG);
    rig.after(5.secs());
    assert_eq!(rig.speed(), 40_000.0);
}

/// 10,000 steps at 2,500/s: 0.25 s and 312.5 steps up and down, 9,375 at 2,500/s in 3.75 s: 4.25 s.
#[test]
fn section_7_18_a_move_reads_the_pin_when_it_starts() {
    let mut rig = with_speedsel();
    rig.low("J2.2");
    rig.command(bit::MOVE);
    assert_eq!(rig.until_idle(), 4_250.millis());
    rig.assert_stands(10_000);
}

/// Section 7.8 says that pin changes in a move are ignored, 7.18 that they make the move a jog. MD3-30: 7.8
/// applies.
#[test]
fn section_7_18_against_7_8_the_pin_is_ignored_in_a_move() {
    let mut rig = with_speedsel();
    rig.command(bit::MOVE);
    rig.after(1.secs());
    rig.low("J2.2");
    rig.after(100.millis());
    rig.open("J2.2");
    rig.after(100.millis());
    rig.low("J2.2");
    rig.after(50.millis());
    rig.assert_on_its_way(5_000, 5_000.0); // 1.25 s
    rig.until_idle();
    rig.assert_stands(10_000);
}

/// MD3-30, the alternative: with SpeedselJogsProfile a pin change turns the move into a jog at the selected
/// speed, with the sign of Speed.
#[test]
fn section_7_18_against_7_8_or_makes_the_move_a_jog() {
    let mut rig = with_speedsel();
    rig.poke("SpeedselJogsProfile", 1);
    rig.command(bit::MOVE);
    rig.after(1.secs());
    rig.low("J2.2");
    assert_eq!(rig.motion_control(), bit::JOG);
    rig.after(250.millis());
    rig.assert_on_its_way(3_750 + 937, 2_500.0);
    rig.after(100.secs());
    rig.assert_on_its_way(3_750 + 937 + 250_000, 2_500.0);
    rig.command(bit::DECEL_STOP);
    assert_eq!(rig.until_idle(), 250.millis());
}

/// The jog gets the sign of Speed, not of MoveSteps: from +5,000/s through standstill to −2,500/s.
#[test]
fn section_7_18_a_move_that_becomes_a_jog_takes_the_sign_of_speed() {
    let mut rig = with_speedsel();
    rig.poke("SpeedselJogsProfile", 1);
    rig.write_long(at::SPEED, -5_000);
    rig.command(bit::MOVE);
    rig.after(1.secs());
    rig.assert_on_its_way(3_750, 5_000.0);
    rig.low("J2.2"); // 0.5 s and 1,250 steps down, 0.25 s and 312.5 steps up
    rig.after(750.millis());
    rig.assert_on_its_way(5_000 - 312, -2_500.0);
}

/// With SpeedselJogsProfile a starting move still reads the pin. A pin change does not affect a home cycle.
#[test]
fn section_7_18_speedsel_before_a_move() {
    let mut rig = with_speedsel();
    rig.poke("SpeedselJogsProfile", 1);
    rig.low("J2.2");
    rig.command(bit::MOVE);
    assert_eq!(rig.until_idle(), 4_250.millis());
    rig.assert_stands(10_000);
    rig.open("J2.2");
    rig.command(bit::HOME);
    rig.after(1.secs());
    rig.low("J2.2");
    assert_eq!(rig.motion_control(), bit::HOME);
    rig.after(1.secs());
    rig.assert_on_its_way(18_750, 5_000.0);
}
