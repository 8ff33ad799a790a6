//! Moves, jogs and stops by the bus (7.15 to 7.19).

use super::*;

#[test]
fn a_move_of_10_000_steps_takes_two_and_a_half_seconds() {
    let mut bed = Bed::ready();
    let begun = bed.hear(&rtu::write(1, 0x11, 1)) + JUDGEMENT;
    bed.run_until(begun);
    assert_eq!(bed.level("J3.7"), Level::Low);
    bed.run_until(begun + 500.millis());
    assert_eq!(bed.position(), 1_250);
    assert_eq!(bed.read(0x11), 1);
    bed.run_until(begun + 2_500.millis() - Duration::TICK);
    assert_eq!((bed.position(), bed.level("J3.7")), (9_999, Level::Low));
    bed.run_until(begun + 2_500.millis());
    assert_eq!((bed.position(), bed.level("J3.7")), (10_000, Level::Float));
    assert_eq!(bed.read(0x11), 0);
}

#[test]
fn a_negative_move_goes_back() {
    let mut bed = Bed::ready();
    bed.write(0x12, 0xFFFF);
    bed.write(0x13, 0xFF9C); // -100
    bed.write(0x11, 1);
    bed.run_until(bed.now + 1.secs());
    assert_eq!(bed.position(), -100);
}

#[test]
fn a_profile_ignores_speeds_and_other_moves() {
    let mut bed = Bed::ready();
    let begun = bed.hear(&rtu::write(1, 0x11, 1)) + JUDGEMENT;
    bed.run_until(begun + 1.secs());
    bed.write(0x15, 100);
    for command in [1, 2, 0] {
        bed.write(0x11, command);
        assert_eq!(bed.read(0x11), 1);
    }
    bed.run_until(begun + 2_500.millis() - Duration::TICK);
    assert_eq!((bed.position(), bed.level("J3.7")), (9_999, Level::Low));
    bed.run_until(begun + 2_500.millis());
    assert_eq!((bed.position(), bed.level("J3.7")), (10_000, Level::Float));
}

#[test]
fn a_new_acceleration_stops_a_profile_at_once() {
    let mut bed = Bed::ready();
    let begun = bed.hear(&rtu::write(1, 0x11, 1)) + JUDGEMENT;
    bed.run_until(begun + 1.secs());
    let written = bed.hear(&rtu::write(1, 0x19, 20_000)) + JUDGEMENT;
    bed.run_until(written - Duration::TICK);
    let position = bed.position();
    bed.run_until(10.secs());
    assert!(bed.position() - position <= 1);
    assert_eq!(bed.read(0x11), 0);
}

#[test]
fn a_jog_follows_the_speed_and_stops_with_a_ramp() {
    let mut bed = Bed::ready();
    bed.write(0x11, 2);
    bed.run_until(1.secs());
    assert_eq!(bed.read(0x11), 2);
    assert_eq!(bed.world.plan.unwrap().speed_at(bed.now), 5_000);
    bed.write(0x15, 2_000);
    bed.run_until(2.secs());
    assert_eq!(bed.world.plan.unwrap().speed_at(bed.now), 2_000);
    bed.write(0x11, 0x10);
    assert_eq!(bed.read(0x11), 0x10);
    bed.run_until(3.secs());
    assert_eq!((bed.read(0x11), bed.level("J3.7")), (0, Level::Float));
    assert_eq!(bed.world.plan.unwrap().speed_at(bed.now), 0);
}

#[test]
fn without_acceleration_a_jog_goes_on_and_stops_at_once() {
    let mut bed = Bed::ready();
    bed.write(0x11, 2);
    bed.run_until(1.secs());
    bed.write(0x19, 0);
    bed.write(0x15, 2_000);
    assert_eq!(bed.world.plan.unwrap().speed_at(bed.now), 5_000);
    bed.write(0x19, 10_000);
    bed.write(0x11, 2); // now it takes the speed
    bed.run_until(2.secs());
    assert_eq!(bed.world.plan.unwrap().speed_at(bed.now), 2_000);
    bed.write(0x19, 0);
    bed.write(0x11, 0x10);
    assert_eq!(bed.read(0x11), 0);
    assert_eq!(bed.world.plan.unwrap().speed_at(bed.now), 0);
}

#[test]
fn a_jog_turns_round_by_way_of_standstill() {
    let mut bed = Bed::ready();
    bed.write(0x11, 2);
    bed.run_until(1.secs());
    bed.write(0x14, 0xFFFF); // between the two writes the drive sees -60,536, which acts as -40,000
    bed.write(0x15, 0xEC78); // -5000
    bed.run_until(10.secs());
    assert_eq!(bed.world.plan.unwrap().speed_at(bed.now), -5_000);
}

#[test]
fn stop_stops_at_once_with_current() {
    let mut bed = Bed::ready();
    bed.write(0x11, 2);
    bed.run_until(1.secs());
    bed.write(0x11, 8);
    let position = bed.position();
    bed.run_until(2.secs());
    assert_eq!((bed.position(), bed.read(0x11)), (position, 0));
    assert_eq!(bed.world.current.last().unwrap().1, 1_000);
}

#[test]
fn disable_is_a_level() {
    let mut bed = Bed::ready();
    bed.write(0x11, 0x21); // Move is ignored beside Disable
    assert_eq!((bed.read(0x11), bed.world.current.last().unwrap().1), (0x20, 0));
    bed.write(0x11, 0x01); // enables and moves
    assert_eq!((bed.read(0x11), bed.world.current.last().unwrap().1), (0x01, 1_000));
    bed.write(0x11, 0x00); // changes nothing
    assert_eq!(bed.read(0x11), 0x01);
    bed.write(0x11, 0x20);
    let position = bed.position();
    bed.run_until(10.secs());
    assert_eq!(bed.position(), position);
}

#[test]
fn without_speed_or_acceleration_a_command_completes_at_once() {
    for address in [0x15, 0x19] {
        let mut bed = Bed::ready();
        bed.write(address, 0);
        for command in [1, 2, 4, 0x10] {
            bed.write(0x11, command);
            assert_eq!(bed.read(0x11), 0);
        }
        assert_eq!(bed.position(), 0);
    }
}

#[test]
fn only_a_new_speed_begins_a_new_ramp() {
    let mut bed = Bed::ready();
    bed.set(Reg::Speed, 40_000);
    bed.set(Reg::MotionControl, JOG);
    bed.run_until(1.secs());
    // A jog takes a new acceleration for its next ramp, and these are no reason for one.
    bed.set(Reg::AccelDecel, 1_000_000);
    bed.set(Reg::AlternateSpeed, 100);
    bed.set(Reg::MotorCurrentAndMicrostepping, 0x0314);
    bed.set(Reg::Speed, 40_000);
    bed.run_until(2.secs());
    assert_eq!(bed.speed(), 20_000);
    bed.set(Reg::Speed, 30_000);
    bed.run_until(2_010.millis());
    assert_eq!(bed.speed(), 30_000);
}
