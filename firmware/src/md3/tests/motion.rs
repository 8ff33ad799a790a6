//! Moves, jogs and stops that the bus commands (7.15 to 7.19).

use super::*;

#[test]
fn a_move_of_10_000_steps_takes_two_and_a_half_seconds() {
    let mut dut = ready();
    let begun = dut.hear(&rtu::write(1, 0x11, 1)) + JUDGEMENT;
    dut.run_until(begun);
    assert_eq!(dut.level("J3.7"), Level::Low);
    dut.run_until(begun + 500.millis());
    assert_eq!(dut.position(), 1_250);
    assert_eq!(dut.read(0x11), 1);
    dut.run_until(begun + 2_500.millis() - Duration::TICK);
    assert_eq!((dut.position(), dut.level("J3.7")), (9_999, Level::Low));
    dut.run_until(begun + 2_500.millis());
    assert_eq!((dut.position(), dut.level("J3.7")), (10_000, Level::Float));
    assert_eq!(dut.read(0x11), 0);
}

#[test]
fn a_negative_move_goes_back() {
    let mut dut = ready();
    dut.write(0x12, 0xFFFF);
    dut.write(0x13, 0xFF9C); // -100
    dut.write(0x11, 1);
    dut.run_until(dut.now + 1.secs());
    assert_eq!(dut.position(), -100);
}

#[test]
fn a_profile_ignores_speeds_and_other_moves() {
    let mut dut = ready();
    let begun = dut.hear(&rtu::write(1, 0x11, 1)) + JUDGEMENT;
    dut.run_until(begun + 1.secs());
    dut.write(0x15, 100);
    for command in [1, 2, 0] {
        dut.write(0x11, command);
        assert_eq!(dut.read(0x11), 1);
    }
    dut.run_until(begun + 2_500.millis() - Duration::TICK);
    assert_eq!((dut.position(), dut.level("J3.7")), (9_999, Level::Low));
    dut.run_until(begun + 2_500.millis());
    assert_eq!((dut.position(), dut.level("J3.7")), (10_000, Level::Float));
}

#[test]
fn a_new_acceleration_stops_a_profile_at_once() {
    let mut dut = ready();
    let begun = dut.hear(&rtu::write(1, 0x11, 1)) + JUDGEMENT;
    dut.run_until(begun + 1.secs());
    let written = dut.hear(&rtu::write(1, 0x19, 20_000)) + JUDGEMENT;
    dut.run_until(written - Duration::TICK);
    let position = dut.position();
    dut.run_until(10.secs());
    assert!(dut.position() - position <= 1);
    assert_eq!(dut.read(0x11), 0);
}

#[test]
fn a_jog_follows_the_speed_and_stops_with_a_ramp() {
    let mut dut = ready();
    dut.write(0x11, 2);
    dut.run_until(1.secs());
    assert_eq!(dut.read(0x11), 2);
    assert_eq!(dut.speed(), 5_000);
    dut.write(0x15, 2_000);
    dut.run_until(2.secs());
    assert_eq!(dut.speed(), 2_000);
    dut.write(0x11, 0x10);
    assert_eq!(dut.read(0x11), 0x10);
    dut.run_until(3.secs());
    assert_eq!((dut.read(0x11), dut.level("J3.7")), (0, Level::Float));
    assert_eq!(dut.speed(), 0);
}

#[test]
fn without_acceleration_a_jog_goes_on_and_stops_at_once() {
    let mut dut = ready();
    dut.write(0x11, 2);
    dut.run_until(1.secs());
    dut.write(0x19, 0);
    dut.write(0x15, 2_000);
    assert_eq!(dut.speed(), 5_000);
    dut.write(0x19, 10_000);
    dut.write(0x11, 2); // now the jog takes the new speed
    dut.run_until(2.secs());
    assert_eq!(dut.speed(), 2_000);
    dut.write(0x19, 0);
    dut.write(0x11, 0x10);
    assert_eq!(dut.read(0x11), 0);
    assert_eq!(dut.speed(), 0);
}

#[test]
fn a_jog_turns_round_by_way_of_standstill() {
    let mut dut = ready();
    dut.write(0x11, 2);
    dut.run_until(1.secs());
    dut.write(0x14, 0xFFFF); // after this write the drive sees -60,536, which acts as -40,000
    dut.write(0x15, 0xEC78); // -5000
    dut.run_until(10.secs());
    assert_eq!(dut.speed(), -5_000);
}

#[test]
fn stop_stops_at_once_with_current() {
    let mut dut = ready();
    dut.write(0x11, 2);
    dut.run_until(1.secs());
    dut.write(0x11, 8);
    let position = dut.position();
    dut.run_until(2.secs());
    assert_eq!((dut.position(), dut.read(0x11)), (position, 0));
    assert_eq!(dut.current(), 1_000);
}

#[test]
fn disable_is_a_level() {
    let mut dut = ready();
    dut.write(0x11, 0x21); // Move is ignored beside Disable
    assert_eq!((dut.read(0x11), dut.current()), (0x20, 0));
    dut.write(0x11, 0x01); // enables and moves
    assert_eq!((dut.read(0x11), dut.current()), (0x01, 1_000));
    dut.write(0x11, 0x00); // changes nothing
    assert_eq!(dut.read(0x11), 0x01);
    dut.write(0x11, 0x20);
    let position = dut.position();
    dut.run_until(10.secs());
    assert_eq!(dut.position(), position);
}

#[test]
fn without_speed_or_acceleration_a_command_completes_at_once() {
    for address in [0x15, 0x19] {
        let mut dut = ready();
        dut.write(address, 0);
        for command in [1, 2, 4, 0x10] {
            dut.write(0x11, command);
            assert_eq!(dut.read(0x11), 0);
        }
        assert_eq!(dut.position(), 0);
    }
}

#[test]
fn only_a_new_speed_begins_a_new_ramp() {
    let mut dut = ready();
    dut.preset(Reg::Speed, 40_000);
    dut.preset(Reg::MotionControl, JOG);
    dut.run_until(1.secs());
    // A jog uses a new acceleration for its next ramp; none of these writes starts a ramp.
    dut.preset(Reg::AccelDecel, 1_000_000);
    dut.preset(Reg::AlternateSpeed, 100);
    dut.preset(Reg::MotorCurrentAndMicrostepping, 0x0314);
    dut.preset(Reg::Speed, 40_000);
    dut.run_until(2.secs());
    assert_eq!(dut.speed(), 20_000);
    dut.preset(Reg::Speed, 30_000);
    dut.run_until(2_010.millis());
    assert_eq!(dut.speed(), 30_000);
}
