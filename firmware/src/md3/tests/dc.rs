//! DC motor PWM mode (7.2, 7.17).

use super::*;

/// 16 kHz, 5,000 counts (code 5).
fn bed() -> Bed {
    let mut bed = Bed::ready();
    bed.set(Reg::MotorCurrentAndMicrostepping, 0x250a);
    bed
}

#[test]
fn half_the_counts_are_half_the_duty() {
    let mut bed = bed();
    bed.set(Reg::Speed, 2_500);
    bed.set(Reg::MotionControl, JOG);
    // 10,000 counts/s: after 0.125 s 1,250 counts, a quarter.
    bed.run_until(125.millis());
    assert_eq!(bed.world.duty.last().unwrap().1, 16_384);
    bed.run_until(1.secs());
    assert_eq!(bed.world.duty.last().unwrap(), &(Instant::from(250.millis()), 32_768));
    // A period is 1,000 ticks, and a duty holds for a whole one.
    assert!(bed.world.duty.iter().all(|(at, _)| at.ticks() % 1_000 == 0));
    assert_eq!(bed.world.duty.len(), 4_000, "16 kHz for a quarter of a second");
    assert_eq!((bed.control(), bed.busy(), bed.position()), (JOG, true, 0));
    bed.set(Reg::MotionControl, DECEL_STOP);
    bed.run_until(1_250.millis() - Duration::TICK);
    assert_eq!((bed.control(), bed.busy()), (DECEL_STOP, true));
    bed.run_until(1_250.millis());
    assert_eq!((bed.control(), bed.busy(), bed.world.duty.last().unwrap().1), (0, false, 0));
}

#[test]
fn the_ranges_jump() {
    // 7.2, the column of the DC motor.
    for (code, range) in [
        (0, 40_000),
        (1, 20_000),
        (2, 40_000),
        (3, 16_000),
        (4, 8_000),
        (5, 5_000),
        (6, 4_000),
        (7, 3_200),
        (8, 2_000),
        (9, 2_000),
        (31, 2_000),
    ] {
        let mut bed = Bed::ready();
        bed.set(Reg::MotorCurrentAndMicrostepping, 0x200a | code << 8);
        bed.set(Reg::AccelDecel, 10_000_000);
        bed.set(Reg::Speed, -range / 2);
        bed.set(Reg::MotionControl, JOG);
        bed.wait(1.secs());
        assert_eq!(bed.world.duty.last().unwrap().1, -32_768, "code {code}");
        bed.set(Reg::Speed, 40_000);
        bed.wait(1.secs());
        assert_eq!(bed.world.duty.last().unwrap().1, 65_536, "code {code}");
    }
}

#[test]
fn moves_and_home_cycles_complete_at_once() {
    let mut bed = bed();
    for command in [MOVE, HOME] {
        bed.set(Reg::MotionControl, command);
        assert_eq!(bed.control(), 0);
    }
    for mode in [0b0000, 0b0001, 0b0010, 0b0101, 0b1000, 0b1001] {
        bed.set(Reg::PinFunctionAndPolarity, mode << 4);
        bed.pin(4, false);
        bed.pin(4, true);
        assert_eq!((bed.control(), bed.position()), (0, 0), "mode {mode:04b}");
    }
}

#[test]
fn the_jog_modes_of_the_pins_work() {
    let mut bed = bed();
    bed.set(Reg::PinFunctionAndPolarity, 0b0111 << 4);
    bed.pin(5, false);
    bed.run_until(1.secs());
    assert_eq!(bed.world.duty.last().unwrap().1, -65_536);
    bed.pin(4, false);
    bed.pin(5, true);
    bed.run_until(1_500.millis());
    assert_eq!(bed.world.duty.last().unwrap().1, 0);
    bed.run_until(2.secs());
    assert_eq!(bed.world.duty.last().unwrap().1, 65_536);
    bed.pin(4, true);
    bed.run_until(3.secs());
    assert_eq!((bed.control(), bed.world.duty.last().unwrap().1), (0, 0));
}

#[test]
fn another_motor_mode_stops_and_zeroes() {
    let mut bed = bed();
    bed.set(Reg::MotionControl, JOG);
    bed.run_until(1.secs());
    bed.set(Reg::MotorCurrentAndMicrostepping, 0x030a);
    assert_eq!((bed.control(), bed.busy(), bed.world.duty.last().unwrap().1), (0, false, 0));
    bed.set(Reg::MotionControl, MOVE);
    bed.wait(3.secs());
    assert_eq!(bed.position(), 10_000);
    bed.set(Reg::MotorCurrentAndMicrostepping, 0x250a);
    bed.set(Reg::MotionControl, JOG);
    bed.wait(1.secs());
    assert_eq!(bed.position(), 10_000);
}

#[test]
fn inhibit_takes_the_duty_while_the_ramp_goes_on() {
    let mut bed = bed();
    bed.set(Reg::MotionControl, JOG);
    bed.run_until(100.millis());
    bed.pin(3, false);
    assert_eq!((bed.world.duty.last().unwrap().1, bed.current()), (0, 0));
    bed.run_until(250.millis());
    assert_eq!(bed.world.duty.last().unwrap().1, 0);
    bed.pin(3, true);
    bed.run_until(251.millis());
    // 2,510 of 5,000 counts.
    assert_eq!(bed.world.duty.last().unwrap().1, 32_899);
}

#[test]
fn counts_are_of_the_range_that_holds() {
    let mut bed = Bed::ready();
    bed.set(Reg::MotorCurrentAndMicrostepping, 0x200a); // 500 Hz, 40,000 counts
    bed.set(Reg::MotionControl, JOG);
    bed.run_until(1.secs());
    assert_eq!(bed.world.duty.last().unwrap().1, 8_192);
    bed.set(Reg::MotorCurrentAndMicrostepping, 0x230a); // 5 kHz, 16,000 counts
    bed.run_until(2.secs());
    assert_eq!(bed.world.duty.last().unwrap().1, 20_480);
    // It slows down from 5,000 counts, which more than fill a period of 2,000.
    bed.set(Reg::MotionControl, DECEL_STOP);
    bed.set(Reg::MotorCurrentAndMicrostepping, 0x280a); // 40 kHz
    bed.run_until(2_001.millis());
    assert_eq!(bed.world.duty.last().unwrap().1, 65_536);
    bed.run_until(2_400.millis());
    assert_eq!(bed.world.duty.last().unwrap().1, 32_768);
    bed.run_until(2_500.millis());
    assert_eq!((bed.control(), bed.world.duty.last().unwrap().1), (0, 0));
    // Another current changes nothing.
    bed.set(Reg::MotionControl, JOG);
    bed.run_until(4.secs());
    let duty = bed.world.duty.last().copied();
    bed.set(Reg::MotorCurrentAndMicrostepping, 0x2814);
    bed.run_until(5.secs());
    assert_eq!((bed.control(), bed.world.duty.last().copied()), (JOG, duty));
}
