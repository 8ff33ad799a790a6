//! Section 7.8, J2 pins 4 and 5: every row of the table of motion modes. A profile move at the defaults is
//! 10,000 steps in 2.5 s; a move of 400 steps is a triangle of 2·√(400/10,000) = 0.4 s.

use drivetwin_firmware::device::Level;
use drivetwin_protocol::time::{Duration, Span};

use crate::rig::{BUSY, Rig, at, bit};

/// Polarity bits that make pins 4 and 5 active high.
const HIGH_4: u16 = 1 << 1;
const HIGH_5: u16 = 1;

/// A ready MD3 in the motion mode `code`.
fn mode(code: u16) -> Rig {
    let mut rig = Rig::ready();
    rig.write(at::PINS, code << 4);
    rig
}

/// A ready MD3 in the motion mode `code`, with moves of 400 steps.
fn short(code: u16) -> Rig {
    let mut rig = Rig::ready();
    rig.write_long(at::MOVE_STEPS, 400);
    rig.write(at::PINS, code << 4);
    rig
}

/// Asserts that a home cycle has just begun at 400 steps. The flag ends the cycle at its next sample.
fn assert_homes_from_400(rig: &mut Rig) {
    assert_eq!(rig.motion_control(), bit::HOME);
    rig.after(1.secs());
    rig.assert_on_its_way(400 + 3_750, 5_000.0);
    rig.low("J2.2");
    rig.after(4.micros());
    assert_eq!(rig.motion_control(), 0);
}

#[test]
fn section_7_8_mode_0000_step_dir() {
    let mut rig = mode(0b0000);
    rig.low("J2.4");
    assert_eq!(rig.position(), 1);
    rig.after(1.millis());
    rig.open("J2.4"); // only falling edges make steps
    assert_eq!(rig.position(), 1);
    rig.pulses("J2.4", 99, 10_000.0);
    assert_eq!(rig.position(), 100);
    // MD3-20: pin 5 open is forward, low is backward.
    rig.low("J2.5");
    rig.pulses("J2.4", 150, 10_000.0);
    assert_eq!(rig.position(), -50);
    rig.high("J2.5");
    rig.pulses("J2.4", 1, 10_000.0);
    assert_eq!(rig.position(), -49);
}

/// "The direction is determined by the state of Pin 5 when the falling edge occurs."
#[test]
fn section_7_8_mode_0000_direction_at_the_edge() {
    let mut rig = mode(0b0000);
    rig.low("J2.5");
    rig.low("J2.4");
    rig.high("J2.5");
    rig.high("J2.4");
    rig.low("J2.5");
    assert_eq!(rig.position(), -1);
}

#[test]
fn section_7_8_mode_0000_rising_edges() {
    let mut rig = mode(0b0000);
    rig.low("J2.4");
    assert_eq!(rig.position(), 1);
    rig.write(at::PINS, HIGH_4);
    assert_eq!(rig.position(), 1);
    rig.after(1.millis());
    rig.open("J2.4");
    assert_eq!(rig.position(), 2);
    rig.after(1.millis());
    rig.low("J2.4");
    assert_eq!(rig.position(), 2);
}

/// MD3-19: a change of polarity that makes the pin active is an edge.
#[test]
fn section_7_8_mode_0000_step_by_polarity() {
    let mut rig = mode(0b0000);
    rig.write(at::PINS, HIGH_4);
    assert_eq!(rig.position(), 1);
    rig.write(at::PINS, 0);
    assert_eq!(rig.position(), 1);
}

#[test]
fn section_7_8_mode_0000_inverted_direction() {
    let mut rig = mode(0b0000);
    rig.write(at::PINS, HIGH_5); // pin 5 is open, which is now active: backward
    rig.low("J2.4");
    assert_eq!(rig.position(), -1);
}

/// "Maximum step frequency is 250 kHz". MD3-25: faster edges are lost, here every second one.
#[test]
fn section_7_8_mode_0000_at_most_250_khz() {
    let mut rig = mode(0b0000);
    rig.pulses("J2.4", 25_000, 250_000.0);
    assert_eq!(rig.position(), 25_000);
    rig.after(1.millis());
    rig.pulses("J2.4", 10_000, 500_000.0);
    assert_eq!(rig.position(), 30_000);
}

/// Step pulses do not set BUSY.
#[test]
fn section_7_8_mode_0000_is_never_busy() {
    let mut rig = mode(0b0000);
    for _ in 0..100 {
        rig.low("J2.4");
        assert!(!rig.busy() && rig.motion_control() == 0);
        rig.after(50.micros());
        rig.open("J2.4");
        rig.after(50.micros());
    }
    rig.assert_stands(100);
}

/// MD3-25: no steps while the drive is disabled, inhibited or in a fault.
#[test]
fn section_7_8_mode_0000_no_steps_without_current() {
    let mut rig = mode(0b0000);
    rig.command(bit::DISABLE);
    rig.pulses("J2.4", 10, 1_000.0);
    assert_eq!(rig.position(), 0);
    rig.command(0);
    rig.low("J2.3"); // INHIBIT
    rig.pulses("J2.4", 10, 1_000.0);
    assert_eq!(rig.position(), 0);
    rig.open("J2.3");
    rig.fault("over_current", true);
    rig.pulses("J2.4", 10, 1_000.0);
    assert_eq!(rig.position(), 0);
}

/// MD3-24 and MD3-25: changes of pins 4 and 5 are ignored during a home cycle, and so are step pulses.
#[test]
fn section_7_8_pins_are_ignored_during_a_home_cycle() {
    let mut rig = mode(0b0000);
    rig.command(bit::HOME);
    rig.after(500.millis());
    rig.low("J2.5");
    rig.pulses("J2.4", 100, 1_000.0);
    rig.after(400.millis());
    rig.assert_on_its_way(3_750, 5_000.0);
    for code in [0b0001, 0b0010, 0b0011, 0b0100, 0b0101, 0b0110, 0b0111] {
        let mut rig = mode(code);
        rig.command(bit::HOME);
        rig.after(500.millis());
        rig.low("J2.4");
        rig.low("J2.5");
        rig.after(200.millis());
        rig.open("J2.4");
        rig.open("J2.5");
        rig.after(300.millis());
        rig.assert_on_its_way(3_750, 5_000.0);
        rig.low("J2.2");
        rig.after(1.secs());
        // MD3-24: the drive does not execute them after the home cycle either.
        assert_eq!((rig.moving(), rig.motion_control()), (false, 0), "mode {code:04b}");
    }
}

#[test]
fn section_7_8_mode_0001_move_profile_dir() {
    let mut rig = mode(0b0001);
    rig.low("J2.4");
    assert_eq!(rig.motion_control(), bit::MOVE); // MD3-3
    rig.after(1.secs());
    rig.assert_on_its_way(3_750, 5_000.0);
    // Pin 5 is read only at the edge of pin 4 (7.8); further edges are ignored (MD3-24).
    rig.low("J2.5");
    rig.open("J2.4");
    rig.low("J2.4");
    rig.until_idle();
    rig.assert_stands(10_000);
    rig.after(5.secs());
    rig.assert_stands(10_000); // MD3-24
    rig.open("J2.4");
    rig.after(1.secs());
    rig.assert_stands(10_000);
    rig.low("J2.4");
    rig.after(1.secs());
    rig.assert_on_its_way(6_250, -5_000.0);
    assert_eq!(rig.until_idle(), 1_500.millis());
    rig.assert_stands(0);
}

/// MD3-20: with pin 5 high the direction is the sign of MoveSteps.
#[test]
fn section_7_8_mode_0001_negative_steps() {
    let mut rig = short(0b0001);
    rig.write_long(at::MOVE_STEPS, -400);
    rig.low("J2.4");
    rig.until_idle();
    rig.assert_stands(-400);
    rig.open("J2.4");
    rig.low("J2.5");
    rig.low("J2.4");
    rig.until_idle();
    rig.assert_stands(0);
    assert_eq!(rig.read_long(at::MOVE_STEPS), -400); // only endless modes write MoveSteps
}

#[test]
fn section_7_8_mode_0001_rising_edge() {
    let mut rig = short(0b0001);
    rig.low("J2.4");
    rig.until_idle();
    rig.write(at::PINS, 0b0001 << 4 | HIGH_4);
    rig.after(1.secs());
    rig.assert_stands(400);
    rig.open("J2.4");
    rig.until_idle();
    rig.assert_stands(800);
    // MD3-19: a change of polarity alone starts a move, too.
    rig.write(at::PINS, 0b0001 << 4);
    rig.write(at::PINS, 0b0001 << 4 | HIGH_4);
    assert_eq!(rig.until_idle(), 400.millis());
    rig.assert_stands(1_200);
}

#[test]
fn section_7_8_mode_0010_move_profile_forward_backward() {
    let mut rig = short(0b0010);
    rig.low("J2.5"); // has no effect
    rig.low("J2.4");
    assert_eq!(rig.motion_control(), bit::MOVE);
    assert_eq!(rig.until_idle(), 400.millis());
    rig.assert_stands(400);
    rig.open("J2.4");
    assert_eq!(rig.motion_control(), bit::MOVE);
    rig.after(100.millis());
    assert!(rig.speed() < 0.0);
    assert_eq!(rig.until_idle(), 300.millis());
    rig.assert_stands(0);
    assert_eq!(rig.read_long(at::MOVE_STEPS), 400);
    // MD3-24: an edge during the move is not executed later.
    rig.low("J2.4");
    rig.after(100.millis());
    rig.open("J2.4");
    rig.until_idle();
    rig.after(1.secs());
    rig.assert_stands(400);
}

#[test]
fn section_7_8_mode_0010_inverted() {
    let mut rig = short(0b1111);
    rig.low("J2.4");
    rig.write(at::PINS, 0b1111 << 4 | HIGH_4);
    rig.write(at::PINS, 0b0010 << 4 | HIGH_4);
    rig.assert_stands(0);
    rig.open("J2.4"); // pin 4 becomes active: forward
    rig.until_idle();
    rig.assert_stands(400);
    rig.low("J2.4");
    rig.until_idle();
    rig.assert_stands(0);
}

/// MD3-19: a change of polarity counts as an edge, in both directions.
#[test]
fn section_7_8_mode_0010_by_polarity() {
    let mut rig = short(0b0010);
    rig.write(at::PINS, 0b0010 << 4 | HIGH_4);
    assert_eq!(rig.until_idle(), 400.millis());
    rig.assert_stands(400);
    rig.write(at::PINS, 0b0010 << 4);
    assert_eq!(rig.until_idle(), 400.millis());
    rig.assert_stands(0);
}

#[test]
fn section_7_8_mode_0011_move_profile_forward_home() {
    let mut rig = short(0b0011);
    rig.low("J2.5"); // has no effect
    rig.low("J2.4");
    assert_eq!(rig.motion_control(), bit::MOVE);
    rig.until_idle();
    rig.assert_stands(400);
    rig.open("J2.4");
    assert_homes_from_400(&mut rig);
}

#[test]
fn section_7_8_mode_0100_move_profile_forward_and_backward() {
    let mut rig = short(0b0100);
    rig.low("J2.4");
    rig.after(100.millis());
    rig.low("J2.5"); // ignored while moving
    rig.open("J2.5");
    rig.until_idle();
    rig.open("J2.4");
    rig.after(1.secs());
    rig.assert_stands(400);
    for n in [0, -400] {
        rig.low("J2.5");
        assert_eq!(rig.motion_control(), bit::MOVE);
        assert_eq!(rig.until_idle(), 400.millis());
        rig.assert_stands(n);
        rig.open("J2.5");
        rig.after(1.secs());
        rig.assert_stands(n);
    }
}

#[test]
fn section_7_8_mode_0101_move_profile_forward_and_home() {
    let mut rig = short(0b0101);
    rig.low("J2.4");
    assert_eq!(rig.until_idle(), 400.millis());
    rig.assert_stands(400);
    rig.low("J2.5");
    assert_homes_from_400(&mut rig);
}

#[test]
fn section_7_8_mode_0110_jog_dir() {
    let mut rig = mode(0b0110);
    rig.low("J2.4");
    assert_eq!(rig.motion_control(), bit::JOG); // MD3-3
    rig.after(1.secs());
    rig.assert_on_its_way(3_750, 5_000.0);
    rig.low("J2.5"); // 0.5 s down, 0.5 s up, 1,250 steps each
    rig.after(500.millis());
    assert!(rig.speed().abs() < 1.0 && (rig.position() - 5_000).abs() <= 1);
    rig.after(500.millis());
    rig.assert_on_its_way(3_750, -5_000.0);
    rig.open("J2.4");
    // The bit shows the running motion until the motor is at rest.
    assert_eq!(rig.motion_control(), bit::JOG);
    assert_eq!(rig.until_idle(), 500.millis());
    assert!((rig.position() - 2_500).abs() <= 1);
    assert_eq!(rig.motion_control(), 0);
}

/// The speed with its sign comes from its register (7.17). MD3-20: pin 5 low reverses the direction.
#[test]
fn section_7_8_mode_0110_negative_speed() {
    let mut rig = mode(0b0110);
    rig.write_long(at::SPEED, -2_000);
    rig.low("J2.4");
    rig.after(1.secs()); // 0.2 s and 200 steps, 0.8 s at 2,000/s
    rig.assert_on_its_way(-1_800, -2_000.0);
    rig.low("J2.5");
    rig.after(400.millis());
    rig.assert_on_its_way(-1_800, 2_000.0);
    // A speed that is written while jogging takes effect at once (7.17).
    rig.write(at::SPEED + 1, (-3_000_i16).cast_unsigned());
    rig.after(100.millis());
    assert!((rig.speed() - 3_000.0).abs() < 1.0, "{}", rig.speed());
}

/// MD3-21: a single write of 0x09 can start a jog, because jog modes act on levels.
#[test]
fn section_7_8_mode_0110_starts_by_its_write() {
    let mut rig = mode(0b1111);
    rig.write(at::PINS, 0b0110 << 4 | HIGH_4);
    assert_eq!(rig.motion_control(), bit::JOG);
    rig.after(1.secs());
    rig.assert_on_its_way(3_750, 5_000.0);
    rig.low("J2.4");
    assert_eq!(rig.until_idle(), 500.millis());
    rig.assert_stands(5_000);
}

/// If the pin is active while the speed is 0, the jog starts when a speed is written.
#[test]
fn section_7_8_mode_0110_waits_for_a_speed() {
    let mut rig = mode(0b0110);
    rig.write(at::SPEED + 1, 0);
    rig.low("J2.4");
    rig.after(1.secs());
    rig.assert_stands(0);
    rig.write(at::SPEED + 1, 5_000);
    rig.after(1.secs());
    rig.assert_on_its_way(3_750, 5_000.0);
}

#[test]
fn section_7_8_mode_0110_pressed_again_while_it_ramps_down() {
    let mut rig = mode(0b0110);
    rig.low("J2.4");
    rig.after(1.secs());
    rig.open("J2.4");
    rig.after(250.millis()); // at 2,500/s, after another 937.5 steps
    rig.low("J2.4");
    rig.after(250.millis());
    rig.assert_on_its_way(3_750 + 1_875, 5_000.0);
    assert_eq!(rig.motion_control(), bit::JOG);
}

/// A jog that was started over the bus continues while the pins do not change. After a change the pins
/// control the jog.
#[test]
fn section_7_8_mode_0110_and_a_jog_by_the_bus() {
    let mut rig = mode(0b0110);
    rig.command(bit::JOG);
    rig.after(10.secs());
    rig.assert_on_its_way(48_750, 5_000.0);
    rig.low("J2.4");
    rig.after(1.secs());
    rig.assert_on_its_way(53_750, 5_000.0);
    rig.open("J2.4");
    assert_eq!(rig.until_idle(), 500.millis());
}

/// MD3-24 applies to a jog by pins only: a jog that was started over the bus continues in any mode.
#[test]
fn section_7_8_a_change_of_the_motion_mode_and_a_jog_by_the_bus() {
    let mut rig = mode(0b0110);
    rig.command(bit::JOG);
    rig.after(1.secs());
    rig.write(at::PINS, 0b1111 << 4);
    rig.write(at::PINS, 0b0111 << 4);
    rig.after(1.secs());
    rig.assert_on_its_way(8_750, 5_000.0);
}

/// SPEEDSEL also selects the speed of jogs by pins.
#[test]
fn section_7_8_mode_0110_speedsel() {
    let mut rig = Rig::ready();
    rig.write(at::HOMING, 2 << 1);
    rig.write(at::PINS, 0b0110 << 4 | 1 << 10);
    rig.low("J2.4");
    rig.after(1.secs());
    rig.low("J2.2");
    rig.after(250.millis());
    rig.assert_on_its_way(3_750 + 937, 2_500.0);
    rig.open("J2.4");
    assert_eq!(rig.until_idle(), 250.millis());
}

/// SPEEDSEL also selects the speed of a move that a pin starts: 10,000 steps at 2,500/s take 4.25 s.
#[test]
fn section_7_8_mode_0001_speedsel() {
    let mut rig = Rig::ready();
    rig.write(at::HOMING, 2 << 1);
    rig.write(at::PINS, 0b0001 << 4 | 1 << 10);
    rig.low("J2.2");
    rig.low("J2.4");
    assert_eq!(rig.until_idle(), 4_250.millis());
    rig.assert_stands(10_000);
}

#[test]
fn section_7_8_mode_0111_jog_forward_and_backward() {
    let mut rig = mode(0b0111);
    rig.low("J2.4");
    rig.after(1.secs());
    rig.assert_on_its_way(3_750, 5_000.0);
    rig.open("J2.4");
    assert_eq!(rig.motion_control(), bit::JOG);
    assert_eq!(rig.until_idle(), 500.millis());
    rig.assert_stands(5_000);
    rig.low("J2.5");
    assert_eq!(rig.motion_control(), bit::JOG);
    rig.after(1.secs());
    rig.assert_on_its_way(1_250, -5_000.0);
    rig.open("J2.5");
    assert_eq!(rig.until_idle(), 500.millis());
    rig.assert_stands(0);
}

/// MD3-22: with both pins low a running jog keeps its direction; from rest the direction is that of pin 4.
#[test]
fn section_7_8_mode_0111_both_pins() {
    let mut rig = mode(0b0111);
    rig.low("J2.5");
    rig.after(1.secs());
    rig.low("J2.4");
    rig.after(1.secs());
    rig.assert_on_its_way(-8_750, -5_000.0);
    rig.open("J2.5"); // now only pin 4 is low: reverses through standstill
    rig.after(1.secs());
    rig.assert_on_its_way(-8_750, 5_000.0);
    rig.low("J2.5");
    rig.after(1.secs());
    rig.assert_on_its_way(-3_750, 5_000.0);

    let mut rig = mode(0b1111);
    rig.low("J2.5");
    rig.low("J2.4");
    rig.write(at::PINS, 0b0111 << 4);
    rig.after(1.secs());
    rig.assert_on_its_way(3_750, 5_000.0);
}

/// The drive reads the jog levels when it becomes ready.
#[test]
fn section_7_8_jog_levels_when_the_drive_becomes_ready() {
    for code in [0b0110, 0b0111] {
        let mut rig = mode(code);
        rig.save();
        rig.low("J2.4");
        rig.power_cycle();
        rig.after(2_499.millis());
        assert!(!rig.moving());
        rig.after(1_001.millis());
        assert_eq!(rig.motion_control(), bit::JOG);
        assert!((rig.position() - 3_750).abs() <= 5, "{}", rig.position());
    }
}

/// MD3-21: the drive reads the jog levels again at the end of a home cycle or a profile move.
#[test]
fn section_7_8_jog_levels_when_a_motion_ends() {
    for code in [0b0110, 0b0111] {
        let mut rig = mode(code);
        rig.command(bit::HOME);
        rig.after(500.millis());
        rig.low("J2.4");
        rig.after(500.millis());
        assert_eq!(rig.motion_control(), bit::HOME);
        rig.low("J2.2");
        rig.after(4.micros());
        assert_eq!(rig.motion_control(), bit::JOG);
        rig.after(1.secs());
        rig.assert_on_its_way(7_500, 5_000.0);
    }
    let mut rig = short(0b0110);
    rig.command(bit::MOVE);
    rig.after(100.millis());
    rig.low("J2.4");
    assert_eq!(rig.motion_control(), bit::MOVE);
    rig.after(300.millis());
    assert_eq!(rig.motion_control(), bit::JOG);
}

/// Stop and Decel-stop end a jog by pins even if the pin stays low. The next active edge of the pin starts a
/// new jog.
#[test]
fn section_7_8_stops_end_a_jog_by_pins() {
    for code in [0b0110, 0b0111] {
        for stop in [bit::STOP, bit::DECEL_STOP] {
            let mut rig = mode(code);
            rig.low("J2.4");
            rig.after(1.secs());
            rig.command(stop);
            rig.until_idle();
            let stopped_at = rig.position();
            rig.after(5.secs());
            rig.assert_stands(stopped_at);
            rig.write(at::SPEED + 1, 4_000);
            rig.after(1.secs());
            rig.assert_stands(stopped_at);
            rig.open("J2.4");
            rig.after(1.secs());
            rig.assert_stands(stopped_at);
            rig.low("J2.4");
            assert_eq!(rig.motion_control(), bit::JOG);
        }
    }
}

/// A fault or INHIBIT_MODBUS_MOTION also ends a jog by pins. When the fault is cleared, the drive reads the
/// levels again.
#[test]
fn section_7_8_a_fault_ends_a_jog_by_pins_until_it_is_cleared() {
    let mut rig = mode(0b0110);
    rig.low("J2.4");
    rig.after(1.secs());
    rig.fault("over_current", true);
    rig.fault("over_current", false);
    assert_eq!((rig.speed(), rig.current()), (0.0, 0));
    rig.after(1.secs());
    assert_eq!(rig.motion_control(), bit::FAULT);
    rig.command(bit::FAULT);
    assert_eq!(rig.motion_control(), bit::JOG);

    rig.command(bit::STOP);
    rig.open("J2.4");
    rig.write(at::PINS, 0b0110 << 4 | 2 << 8);
    rig.low("J2.4");
    rig.after(1.secs());
    rig.low("J2.3");
    assert_eq!((rig.speed(), rig.motion_control()), (0.0, 0));
    rig.after(1.secs());
    rig.open("J2.3");
    rig.after(1.secs());
    assert_eq!((rig.speed(), rig.motion_control()), (0.0, 0));
}

/// After a fault is cleared, the drive reads the levels again, even after a Stop.
#[test]
fn section_7_8_clearing_a_fault_looks_at_levels_again() {
    for code in [0b0110, 0b0111, 0b1000, 0b1001] {
        let mut rig = mode(code);
        rig.low("J2.4");
        rig.command(bit::STOP);
        rig.fault("over_current", true);
        rig.fault("over_current", false);
        rig.command(bit::FAULT);
        rig.after(1.secs());
        rig.assert_on_its_way(3_750, 5_000.0);
    }
}

/// While Disable is 1, pins start nothing. When the drive is enabled, it acts on levels only.
#[test]
fn section_7_8_pins_start_nothing_while_disabled() {
    for code in [0b0001, 0b0010, 0b0011, 0b0100, 0b0101] {
        let mut rig = mode(code);
        rig.command(bit::DISABLE);
        rig.low("J2.4");
        rig.low("J2.5");
        rig.after(1.secs());
        assert_eq!((rig.moving(), rig.motion_control()), (false, bit::DISABLE), "mode {code:04b}");
        rig.command(0);
        rig.after(1.secs());
        rig.assert_stands(0);
    }
    for code in [0b0110, 0b0111, 0b1000, 0b1001] {
        let mut rig = mode(0b1111);
        rig.command(bit::DISABLE);
        rig.low("J2.4");
        rig.write(at::PINS, code << 4);
        rig.after(1.secs());
        assert_eq!((rig.moving(), rig.current()), (false, 0), "mode {code:04b}");
        rig.command(0);
        rig.after(1.secs());
        rig.assert_on_its_way(3_750, 5_000.0);
    }
    let mut rig = Rig::ready();
    rig.write(at::PINS, 0b1111 << 4 | 1 << 8);
    rig.command(bit::DISABLE);
    rig.low("J2.3");
    assert_eq!(rig.motion_control(), bit::DISABLE);
}

/// MD3-24: a change of the motion mode ends a jog by pins with a ramp, but a move and a home cycle continue.
#[test]
fn section_7_8_a_change_of_the_motion_mode() {
    let mut rig = mode(0b0110);
    rig.low("J2.4");
    rig.after(1.secs());
    rig.write(at::PINS, 0b1111 << 4);
    assert_eq!(rig.until_idle(), 500.millis());
    rig.assert_stands(5_000);

    let mut rig = mode(0b0001);
    rig.low("J2.4");
    rig.after(1.secs());
    rig.write(at::PINS, 0b0010 << 4);
    assert_eq!(rig.until_idle(), 1_500.millis());
    rig.assert_stands(10_000);

    let mut rig = mode(0b0101);
    rig.low("J2.5");
    rig.after(1.secs());
    rig.write(at::PINS, 0);
    rig.after(1.secs());
    rig.assert_on_its_way(8_750, 5_000.0);
    assert_eq!(rig.motion_control(), bit::HOME);
}

/// MD3-21: the motion starts when the mode is written. MD3-23: there is no pause between the parts, and the
/// drive itself writes MoveSteps. It moves forward until 0.4 s, back until 0.8 s, and so on.
#[test]
fn section_7_8_mode_1000_forward_and_backward() {
    let mut rig = short(0b1000);
    assert_eq!(rig.motion_control(), bit::MOVE);
    rig.after(200.millis());
    rig.assert_on_its_way(200, 2_000.0);
    assert_eq!(rig.read_long(at::MOVE_STEPS), 400);
    rig.after(400.millis()); // 0.6 s
    rig.assert_on_its_way(200, -2_000.0);
    assert_eq!(rig.read_long(at::MOVE_STEPS), -400);
    assert_eq!(rig.motion_control(), bit::MOVE);
    rig.after(400.millis()); // 1.0 s
    rig.assert_on_its_way(200, 2_000.0);
    assert_eq!(rig.read_long(at::MOVE_STEPS), 400);
    // The 1,000th move forward: no tick is lost between the parts.
    rig.after(799_200.millis());
    rig.assert_on_its_way(200, 2_000.0);
}

#[test]
fn section_7_8_mode_1000_is_busy_all_the_time() {
    let mut rig = short(0b1000);
    let end = rig.now() + 4.secs();
    while rig.bench.next() < end {
        let next = rig.bench.next();
        rig.bench.run_until(next);
        assert_eq!(rig.level(BUSY), Level::Low);
    }
    assert!(rig.now() > end - 1.secs());
}

/// MD3-23: leaving the mode stops the motor at once. MoveSteps is negative if the motor was moving back.
#[test]
fn section_7_8_mode_1000_stopped() {
    let mut rig = short(0b1000);
    rig.after(600.millis());
    rig.write(at::PINS, 0);
    let stopped_at = rig.position();
    assert!((stopped_at - 200).abs() <= 1);
    rig.assert_stands(stopped_at);
    assert_eq!((rig.motion_control(), rig.read_long(at::MOVE_STEPS)), (0, -400));
    rig.after(5.secs());
    rig.assert_stands(stopped_at);

    let mut rig = short(0b1000);
    rig.after(1_000.millis());
    rig.write(at::PINS, 0);
    assert_eq!(rig.read_long(at::MOVE_STEPS), 400);
}

/// If MoveSteps is 0, the drive waits.
#[test]
fn section_7_8_mode_1000_without_steps() {
    let mut rig = mode(0b1111);
    rig.write_long(at::MOVE_STEPS, 0);
    rig.write(at::PINS, 0b1000 << 4);
    rig.after(1.secs());
    rig.assert_stands(0);
    // A write of MoveSteps starts the motion.
    rig.write(at::MOVE_STEPS + 1, 400);
    rig.after(200.millis());
    rig.assert_on_its_way(200, 2_000.0);
}

/// Pins 4 and 5 have no function in this mode.
#[test]
fn section_7_8_mode_1000_without_pins() {
    let mut rig = short(0b1000);
    rig.after(100.millis());
    rig.low("J2.4");
    rig.low("J2.5");
    rig.after(100.millis());
    rig.assert_on_its_way(200, 2_000.0);
}

/// Stop ends the motion until 0x09 is written again, or the drive is disabled and enabled.
#[test]
fn section_7_8_mode_1000_stop() {
    let mut rig = short(0b1000);
    rig.after(200.millis());
    rig.command(bit::STOP);
    let stopped_at = rig.position();
    rig.after(5.secs());
    rig.low("J2.4");
    rig.open("J2.4");
    rig.after(1.secs());
    rig.assert_stands(stopped_at);
    rig.write(at::PINS, 0b1000 << 4);
    rig.after(200.millis());
    rig.assert_on_its_way(stopped_at + 200, 2_000.0);
    rig.command(bit::DISABLE);
    rig.command(0);
    assert_eq!(rig.motion_control(), bit::MOVE);
}

/// A fault and INHIBIT_MODBUS_MOTION also end the motion. It starts again when the fault is cleared, but not
/// when pin 3 is released.
#[test]
fn section_7_8_mode_1000_in_a_fault_and_inhibited() {
    let mut rig = short(0b1000);
    rig.after(200.millis());
    rig.fault("over_current", true);
    rig.fault("over_current", false);
    let stopped_at = rig.position();
    assert_eq!((rig.motion_control(), rig.speed()), (bit::FAULT, 0.0));
    rig.after(5.secs());
    assert_eq!(rig.position(), stopped_at);
    rig.command(bit::FAULT);
    assert_eq!(rig.motion_control(), bit::MOVE);

    let mut rig = short(0b1111);
    rig.write(at::PINS, 0b1000 << 4 | 2 << 8);
    rig.after(200.millis());
    rig.low("J2.3");
    let stopped_at = rig.position();
    rig.after(1.secs());
    rig.open("J2.3");
    rig.after(1.secs());
    rig.assert_stands(stopped_at);
    assert_eq!(rig.motion_control(), 0);
}

/// INHIBIT: the parts of the motion continue, but the motor does not move (MD3-28).
#[test]
fn section_7_8_mode_1000_goes_on_while_inhibited() {
    let mut rig = short(0b1000);
    rig.after(200.millis());
    rig.low("J2.3");
    let stopped_at = rig.position();
    rig.after(400.millis());
    assert_eq!((rig.motion_control(), rig.current(), rig.position()), (bit::MOVE, 0, stopped_at));
    assert_eq!(rig.read_long(at::MOVE_STEPS), -400);
}

/// MD3-21: a saved endless mode starts its motion after the start-up delay.
#[test]
fn section_7_8_endless_modes_start_after_power_up() {
    for code in [0b1000, 0b1001] {
        let mut rig = short(code);
        rig.save();
        rig.power_cycle();
        rig.after(2_499.millis());
        assert!(!rig.moving());
        rig.after(201.millis());
        assert_eq!(rig.motion_control(), bit::MOVE);
        assert!((rig.position() - 200).abs() <= 5, "{}", rig.position());
    }
}

/// Profile move and home cycle alternate without a pause: 0.4 s to 400 steps, then the search.
#[test]
fn section_7_8_mode_1001_forward_and_home() {
    let mut rig = short(0b1001);
    rig.write(at::HOMING, 1 << 4); // homes in the negative direction
    assert_eq!(rig.motion_control(), bit::MOVE);
    rig.after(200.millis());
    rig.assert_on_its_way(200, 2_000.0);
    rig.after(700.millis()); // 0.5 s of search
    rig.assert_on_its_way(400 - 1_250, -5_000.0);
    assert_eq!(rig.motion_control(), bit::HOME);
    rig.low("J2.2");
    rig.after(4.micros());
    assert_eq!(rig.motion_control(), bit::MOVE);
    rig.open("J2.2");
    rig.after(200.millis());
    rig.assert_on_its_way(-850 + 200, 2_000.0);
    assert_eq!(rig.read_long(at::MOVE_STEPS), 400);
    rig.after(700.millis());
    assert_eq!(rig.motion_control(), bit::HOME);
    rig.write(at::PINS, 0);
    assert_eq!((rig.speed(), rig.motion_control()), (0.0, 0));
}

/// MD3-18: 1111 and the codes that the manual does not print have no function.
#[test]
fn section_7_8_modes_1010_to_1111_have_no_function() {
    for code in 0b1010..=0b1111 {
        let mut rig = mode(code);
        assert_eq!(rig.read(at::PINS), code << 4);
        for pin in ["J2.4", "J2.5"] {
            rig.low(pin);
            rig.after(100.millis());
            rig.open(pin);
            rig.after(100.millis());
        }
        rig.assert_stands(0);
        assert_eq!(rig.motion_control(), 0);
    }
}

/// "In DC motor PWM mode, 0110 or 0111 are the only allowed options."
#[test]
fn section_7_8_dc_motor_modes() {
    for code in 0b0000..=0b1111 {
        let mut rig = mode(0b1111);
        rig.write(at::CURRENT_AND_MICROSTEPPING, 0x220a); // 2 kHz, ±40,000 counts
        rig.write(at::PINS, code << 4);
        rig.low("J2.4");
        rig.after(1.secs());
        let jogs = code == 0b0110 || code == 0b0111;
        // 5,000 of 40,000 counts.
        assert_eq!(rig.duty(), if jogs { 8_192 } else { 0 }, "mode {code:04b}");
        assert_eq!(rig.motion_control(), if jogs { bit::JOG } else { 0 });
        assert_eq!((rig.busy(), rig.position()), (jogs, 0));
    }
}

/// A fault, Disable and Stop set the duty to 0 at once, for a jog by the bus or by pins.
#[test]
fn section_7_8_dc_motor_stops() {
    for code in [0b0110, 0b0111] {
        let mut rig = mode(code);
        rig.write(at::CURRENT_AND_MICROSTEPPING, 0x220a);
        rig.low("J2.4");
        rig.after(1.secs());
        assert_eq!(rig.duty(), 8_192);
        rig.fault("over_current", true);
        assert_eq!((rig.duty(), rig.current()), (0, 0));
        rig.fault("over_current", false);
        rig.command(bit::FAULT);
        rig.after(1.secs());
        assert_eq!(rig.duty(), 8_192);
        rig.command(bit::DISABLE);
        assert_eq!((rig.duty(), rig.busy()), (0, false));
        rig.command(0);
        rig.after(1.secs());
        assert_eq!(rig.duty(), 8_192);
        rig.command(bit::STOP);
        assert_eq!((rig.duty(), rig.busy()), (0, false));
        rig.after(1.secs());
        assert_eq!(rig.duty(), 0);
    }
}

#[test]
fn section_7_8_dc_motor_directions() {
    let mut rig = mode(0b0110);
    rig.write(at::CURRENT_AND_MICROSTEPPING, 0x220a);
    rig.low("J2.4");
    rig.low("J2.5");
    rig.after(2.secs());
    assert_eq!(rig.duty(), -8_192);
    rig.open("J2.4");
    rig.after(2.secs());
    assert_eq!((rig.duty(), rig.busy()), (0, false));

    let mut rig = mode(0b0111);
    rig.write(at::CURRENT_AND_MICROSTEPPING, 0x220a);
    rig.low("J2.5");
    rig.after(2.secs());
    assert_eq!(rig.duty(), -8_192);
    rig.low("J2.4");
    rig.open("J2.5");
    rig.after(2.secs());
    assert_eq!(rig.duty(), 8_192);
}

/// IOPortData shows the raw levels of input pins, whatever their polarity (MD3-11).
#[test]
fn section_7_8_polarity_does_not_change_what_is_read() {
    let mut rig = mode(0b1111);
    rig.write(at::PINS, 0b1111 << 4 | 0b1111);
    assert_eq!(rig.read(at::IO_PORT), 0x000f);
    rig.low("J2.4");
    rig.after(Duration::TICK);
    assert_eq!(rig.read(at::IO_PORT), 0x000d);
}
