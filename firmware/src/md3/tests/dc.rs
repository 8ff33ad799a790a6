//! DC motor PWM mode (7.2, 7.17).

use super::*;

/// A drive with a DC motor, PWM of 16 kHz and 5,000 counts (code 5).
fn dc_motor() -> Fixture<Md3> {
    let mut dut = ready();
    dut.preset(Reg::MotorCurrentAndMicrostepping, 0x250a);
    dut
}

#[test]
fn half_the_counts_are_half_the_duty() {
    let mut dut = dc_motor();
    dut.preset(Reg::Speed, 2_500);
    dut.preset(Reg::MotionControl, JOG);
    // The ramp has 10,000 counts/s: 1,250 counts, a quarter of the range, after 0.125 s.
    dut.run_until(125.millis());
    assert_eq!(dut.duty(), 16_384);
    dut.run_until(1.secs());
    assert_eq!(dut.out.duties.last().unwrap(), &(Instant::from(250.millis()), AXIS, 32_768));
    // A period is 1,000 ticks; the duty changes only at the start of a period.
    assert!(dut.out.duties.iter().all(|(at, ..)| at.ticks() % 1_000 == 0));
    assert_eq!(dut.out.duties.len(), 4_000, "16 kHz for a quarter of a second");
    assert_eq!((dut.control(), dut.busy(), dut.position()), (JOG, true, 0));
    dut.preset(Reg::MotionControl, DECEL_STOP);
    dut.run_until(1_250.millis() - Duration::TICK);
    assert_eq!((dut.control(), dut.busy()), (DECEL_STOP, true));
    dut.run_until(1_250.millis());
    assert_eq!((dut.control(), dut.busy(), dut.duty()), (0, false, 0));
}

#[test]
fn the_ranges_jump() {
    // Ranges from 7.2, the column of the DC motor.
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
        let mut dut = ready();
        dut.preset(Reg::MotorCurrentAndMicrostepping, 0x200a | code << 8);
        dut.preset(Reg::AccelDecel, 10_000_000);
        dut.preset(Reg::Speed, -range / 2);
        dut.preset(Reg::MotionControl, JOG);
        dut.wait(1.secs());
        assert_eq!(dut.duty(), -32_768, "code {code}");
        dut.preset(Reg::Speed, 40_000);
        dut.wait(1.secs());
        assert_eq!(dut.duty(), 65_536, "code {code}");
    }
}

#[test]
fn moves_and_home_cycles_complete_at_once() {
    let mut dut = dc_motor();
    for command in [MOVE, HOME] {
        dut.preset(Reg::MotionControl, command);
        assert_eq!(dut.control(), 0);
    }
    for mode in [0b0000, 0b0001, 0b0010, 0b0101, 0b1000, 0b1001] {
        dut.preset(Reg::PinFunctionAndPolarity, mode << 4);
        dut.pin(4, false);
        dut.pin(4, true);
        assert_eq!((dut.control(), dut.position()), (0, 0), "mode {mode:04b}");
    }
}

#[test]
fn the_jog_modes_of_the_pins_work() {
    let mut dut = dc_motor();
    dut.preset(Reg::PinFunctionAndPolarity, 0b0111 << 4);
    dut.pin(5, false);
    dut.run_until(1.secs());
    assert_eq!(dut.duty(), -65_536);
    dut.pin(4, false);
    dut.pin(5, true);
    dut.run_until(1_500.millis());
    assert_eq!(dut.duty(), 0);
    dut.run_until(2.secs());
    assert_eq!(dut.duty(), 65_536);
    dut.pin(4, true);
    dut.run_until(3.secs());
    assert_eq!((dut.control(), dut.duty()), (0, 0));
}

#[test]
fn another_motor_mode_stops_and_zeroes() {
    let mut dut = dc_motor();
    dut.preset(Reg::MotionControl, JOG);
    dut.run_until(1.secs());
    dut.preset(Reg::MotorCurrentAndMicrostepping, 0x030a);
    assert_eq!((dut.control(), dut.busy(), dut.duty()), (0, false, 0));
    dut.preset(Reg::MotionControl, MOVE);
    dut.wait(3.secs());
    assert_eq!(dut.position(), 10_000);
    dut.preset(Reg::MotorCurrentAndMicrostepping, 0x250a);
    dut.preset(Reg::MotionControl, JOG);
    dut.wait(1.secs());
    assert_eq!(dut.position(), 10_000);
}

#[test]
fn inhibit_takes_the_duty_while_the_ramp_goes_on() {
    let mut dut = dc_motor();
    dut.preset(Reg::MotionControl, JOG);
    dut.run_until(100.millis());
    dut.pin(3, false);
    assert_eq!((dut.duty(), dut.current()), (0, 0));
    dut.run_until(250.millis());
    assert_eq!(dut.duty(), 0);
    dut.pin(3, true);
    dut.run_until(251.millis());
    // The ramp has continued to 2,510 of 5,000 counts.
    assert_eq!(dut.duty(), 32_899);
}

#[test]
fn counts_are_of_the_range_that_holds() {
    let mut dut = ready();
    dut.preset(Reg::MotorCurrentAndMicrostepping, 0x200a); // 500 Hz, 40,000 counts
    dut.preset(Reg::MotionControl, JOG);
    dut.run_until(1.secs());
    assert_eq!(dut.duty(), 8_192);
    dut.preset(Reg::MotorCurrentAndMicrostepping, 0x230a); // 5 kHz, 16,000 counts
    dut.run_until(2.secs());
    assert_eq!(dut.duty(), 20_480);
    // The ramp starts at 5,000 counts, which is more than the range of 2,000 counts: full duty at first.
    dut.preset(Reg::MotionControl, DECEL_STOP);
    dut.preset(Reg::MotorCurrentAndMicrostepping, 0x280a); // 40 kHz
    dut.run_until(2_001.millis());
    assert_eq!(dut.duty(), 65_536);
    dut.run_until(2_400.millis());
    assert_eq!(dut.duty(), 32_768);
    dut.run_until(2_500.millis());
    assert_eq!((dut.control(), dut.duty()), (0, 0));
    // A new current code does not change the jog.
    dut.preset(Reg::MotionControl, JOG);
    dut.run_until(4.secs());
    let duty = dut.out.duties.last().copied();
    dut.preset(Reg::MotorCurrentAndMicrostepping, 0x2814);
    dut.run_until(5.secs());
    assert_eq!((dut.control(), dut.out.duties.last().copied()), (JOG, duty));
}
