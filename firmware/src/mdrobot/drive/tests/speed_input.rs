//! `SPEED_IN`, `PULSE_IN` and the inputs that replace them (p. 10, 13, 14; MDROBOT-24, MDROBOT-25).

use super::*;

impl Dut {
    /// A motor that runs with the connectors as source of commands.
    fn running(input_type: i64) -> Self {
        let mut dut = Self::connected();
        dut.set(Pid::INPUT_TYPE, input_type);
        dut.close(START_STOP);
        dut
    }

    fn rpm(&self) -> i32 {
        match self.order() {
            Order::Velocity(rpm) => rpm,
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn a_voltage_is_linear_up_to_max_rpm() {
    let mut dut = Dut::running(0);
    assert_eq!(dut.rpm(), 0, "nothing is wired");
    // A measurement has 10 bits over 5 V.
    for mv in [0, 4, 5, 1_000, 2_500, 4_999, 5_000, 6_000, -100] {
        dut.volts(mv);
        assert_eq!(dut.rpm(), mv.clamp(0, 5_000) * 1_023 / 5_000 * 3_000 / 1_023, "{mv}");
    }
    dut.volts(2_500);
    dut.set(Pid::MAX_RPM, 1_023);
    assert_eq!(dut.rpm(), 511);
}

#[test]
fn the_limits_are_where_the_voltage_begins_and_ends() {
    let mut dut = Dut::running(0);
    dut.set(Pid::LOW_SPEED_LIMIT, 200);
    dut.set(Pid::HIGH_SPEED_LIMIT, 800);
    // The middle of 200 and 800 is 500, 2.444 V.
    for (digit, rpm) in
        [(0, 0), (199, 0), (200, 0), (201, 5), (500, 1_500), (799, 2_995), (800, 3_000), (1_023, 3_000)]
    {
        // Applies the voltage in the middle of a measured value.
        dut.volts((digit * 10_000 + 5_000) / 2_046);
        assert_eq!(dut.rpm(), rpm, "{digit}");
    }
    dut.set(Pid::LOW_SPEED_LIMIT, 512);
    dut.set(Pid::HIGH_SPEED_LIMIT, 512);
    dut.volts(2_500);
    assert_eq!(dut.rpm(), 0);
    dut.volts(2_510);
    assert_eq!(dut.rpm(), 3_000);
}

#[test]
fn a_joystick_has_a_middle_and_two_ways() {
    let mut dut = Dut::running(1);
    assert_eq!(dut.rpm(), -3_000, "nothing is wired: 0 V");
    for (mv, rpm) in
        [(0, -3_000), (1_000, -1_500), (2_000, 0), (2_500, 0), (3_000, 0), (4_000, 1_500), (5_000, 3_000)]
    {
        dut.volts(mv);
        assert!(dut.rpm().abs_diff(rpm) <= 8, "{mv}: {}, a digit is 7.3 rpm", dut.rpm());
        assert_eq!(dut.rpm() == 0, rpm == 0, "{mv}");
    }
    assert_eq!(dut.rpm(), 3_000);
}

#[test]
fn fast_pulses_at_speed_in_count_by_their_duty() {
    let mut dut = Dut::running(0);
    dut.pulses(SPEED_IN, 1, 25.micros(), 100.micros());
    assert_eq!(dut.rpm(), 0, "no whole period yet");
    dut.edge(SPEED_IN, true);
    assert_eq!(dut.rpm(), 255 * 3_000 / 1_023, "a quarter");
    dut.wait(75.micros());
    dut.edge(SPEED_IN, false);
    dut.wait(25.micros());
    dut.edge(SPEED_IN, true);
    assert_eq!(dut.rpm(), 767 * 3_000 / 1_023, "three quarters");
    // The level stays high, so it counts as 5 V.
    dut.wait(200.micros() - Duration::TICK);
    assert_eq!(dut.rpm(), 767 * 3_000 / 1_023);
    dut.wait(Duration::TICK);
    assert_eq!(dut.rpm(), 3_000);
    dut.edge(SPEED_IN, false);
    dut.wait(200.micros());
    assert_eq!((dut.rpm(), dut.sources_due()), (0, Instant::NEVER));
}

#[test]
fn slow_pulses_at_speed_in_are_levels() {
    let mut dut = Dut::running(0);
    for _ in 0..3 {
        dut.edge(SPEED_IN, true);
        dut.wait(250.micros());
        assert_eq!(dut.rpm(), 3_000);
        dut.edge(SPEED_IN, false);
        dut.wait(250.micros());
        assert_eq!(dut.rpm(), 0);
    }
    dut.volts(2_500);
    dut.wait(1.secs());
    assert_eq!(dut.rpm(), 1_498, "511 of 1,023");
}

#[test]
fn pulses_are_linear_from_5_to_500_thousand_a_second() {
    // Period of the pulses in ticks of 1/16 µs; there are 16,000,000 ticks in a second.
    for (period, rpm) in [(8_000, 0), (3_200, 0), (1_600, 30), (64, 1_484), (32, 3_000), (16, 3_000)] {
        let mut dut = Dut::running(2);
        let period = Duration::from_ticks(period);
        dut.pulses(PULSE_IN, (2.millis() / period) as u32 + 1, Duration::from_ticks(8), period);
        // (16,000,000 / 1,600 - 5,000) / 495,000 of 3,000 is 30.3; the other rows follow the same formula.
        assert_eq!(dut.rpm(), rpm, "{period:?}");
    }
}

#[test]
fn pulses_that_cease_are_zero() {
    let mut dut = Dut::running(2);
    dut.pulses(PULSE_IN, 1_001, 1.micros(), 4.micros());
    assert_eq!(dut.rpm(), 1_484);
    // The last pulse began 4 µs ago.
    dut.wait(3_996.micros() - Duration::TICK);
    assert_eq!(dut.rpm(), 1_484);
    dut.wait(Duration::TICK);
    assert_eq!((dut.rpm(), dut.sources_due()), (0, Instant::NEVER));
    dut.close(DIR);
    dut.pulses(PULSE_IN, 1_001, 1.micros(), 4.micros());
    assert_eq!(dut.rpm(), -1_484, "DIR is their way");
}

#[test]
fn pulses_of_a_radio_control_count_by_their_width() {
    let mut dut = Dut::running(3);
    assert_eq!(dut.rpm(), 0, "nothing is wired");
    for (width, rpm) in [
        (900, -3_000),
        (1_050, -3_000),
        (1_225, -1_500),
        (1_400, 0),
        (1_500, 0),
        (1_600, 0),
        (1_775, 1_500),
        (1_950, 3_000),
        (2_100, 3_000),
    ] {
        dut.pulses(PULSE_IN, 2, width.micros(), 3.millis());
        assert_eq!(dut.rpm(), rpm, "{width}");
    }
    // The last pulse began 3 ms ago.
    dut.wait(1.millis() - Duration::TICK);
    assert_eq!(dut.rpm(), 3_000);
    dut.wait(Duration::TICK);
    assert_eq!(dut.rpm(), 0);
}

#[test]
fn the_volume_takes_the_place_of_speed_in_and_tar_vel_that_of_both() {
    let mut dut = Dut::running(0);
    dut.set(Pid::INT_VOLUME, 341);
    dut.volts(5_000);
    assert_eq!(dut.rpm(), 3_000);
    dut.close(INT_SPEED);
    assert_eq!(dut.rpm(), 1_000);
    dut.set(Pid::INT_VOLUME, 682);
    assert_eq!(dut.rpm(), 2_000);
    dut.set(Pid::TAR_VEL, 777);
    assert_eq!(dut.rpm(), 777);
    dut.close(DIR);
    assert_eq!(dut.rpm(), -777);
    dut.set(Pid::TAR_VEL, 5_000);
    assert_eq!(dut.rpm(), -3_000, "MAX_RPM");
    dut.set(Pid::TAR_VEL, 0);
    dut.unwire(INT_SPEED);
    assert_eq!(dut.rpm(), -3_000);
    dut.open(START_STOP);
    dut.set(Pid::TAR_VEL, 777);
    assert_eq!(dut.rpm(), 0);
}

#[test]
fn the_volume_is_an_analogue_input_whatever_the_type_is() {
    for input_type in [0, 1, 2, 3] {
        let mut dut = Dut::running(input_type);
        dut.close(INT_SPEED);
        assert_eq!(dut.rpm(), 0, "{input_type}: a new controller");
        dut.set(Pid::INT_VOLUME, 341);
        assert_eq!(dut.rpm(), 1_000, "{input_type}");
        dut.close(DIR);
        assert_eq!(dut.rpm(), -1_000, "{input_type}");
        dut.set(Pid::LOW_SPEED_LIMIT, 342);
        assert_eq!(dut.rpm(), 0, "{input_type}");
        dut.open(INT_SPEED);
        assert_eq!(dut.rpm(), if input_type == 1 { -3_000 } else { 0 }, "{input_type}: nothing is wired");
    }
}

#[test]
fn the_speed_input_may_be_a_torque() {
    let mut dut = Dut::running(0);
    dut.set(Pid::TQ_CTRL, 1);
    dut.volts(2_500);
    assert_eq!(dut.order(), Order::Torque(511));
    dut.close(DIR);
    dut.volts(5_000);
    assert_eq!(dut.order(), Order::Torque(-1_023));
    dut.open(START_STOP);
    assert_eq!(dut.order(), Order::Velocity(0));
}

#[test]
fn no_speed_is_none_of_it() {
    let mut dut = Dut::running(0);
    dut.volts(5_000);
    dut.set(Pid::MAX_RPM, 0);
    assert_eq!(dut.rpm(), 0);
    dut.set(Pid::TAR_VEL, 100);
    assert_eq!(dut.rpm(), 0);
}
