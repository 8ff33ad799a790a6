//! Conditions of a motor that are faults, and conditions that are not.

use super::*;

/// The first alarm within `most` ms: its time in ms and its bits.
fn alarm(bench: &mut Bench, most: u64) -> Option<(u64, u16)> {
    (0..most).find_map(|ms| {
        bench.run_ms(1);
        (bench.alarms != 0).then_some((ms, bench.alarms))
    })
}

#[track_caller]
fn assert_alarm(bench: &mut Bench, from: u64, to: u64, status: u16) {
    let alarm = alarm(bench, 2 * to);
    assert!(alarm.is_some_and(|(ms, bits)| (from..=to).contains(&ms) && bits == status), "{alarm:?}");
}

#[test]
fn a_shaft_that_is_held_is_a_stall() {
    for rpm in [60, 300, -1_000, 3_000] {
        let mut bench = turning(Settings::FACTORY, MOTOR, rpm);
        bench.hold(true);
        assert_alarm(&mut bench, 990, 3_500, Alarm::Stall as u16);
        // The output for 20 A in the winding, which is 6 of 24 V.
        assert!((bench.servo.output(bench.now).abs() - 256).abs() <= 10, "{}", bench.servo.output(bench.now));
    }
    let mut bench = Bench::new(Settings::FACTORY, MOTOR);
    bench.hold(true);
    bench.order(Order::Position { count: 10, rpm: 1_000 });
    assert_alarm(&mut bench, 990, 3_500, Alarm::Stall as u16);
}

#[test]
fn a_current_at_max_load_is_an_overload() {
    let mut bench = Bench::new(Settings::FACTORY, MOTOR);
    bench.hold(true);
    bench.order(Order::Torque(1_023));
    assert_alarm(&mut bench, 3_900, 4_100, Alarm::OverLoad as u16);
    // 2 A are 0.12 Nm, of which 0.01 Nm is friction.
    let settings = Settings { limit_ma: 2_000, ..Settings::FACTORY };
    let mut bench = turning(settings, MOTOR, 1_500);
    bench.load(95_000);
    assert_eq!(alarm(&mut bench, 10_000), None);
    bench.order(Order::Velocity(2_500));
    bench.load(109_000);
    let alarm = alarm(&mut bench, 10_000);
    assert!(alarm.is_some_and(|(_, bits)| bits & Alarm::OverLoad as u16 != 0), "{alarm:?}");
}

#[test]
fn a_speed_that_does_not_come_is_a_failure_of_control() {
    // 0.5 A are 0.03 Nm, of which 0.01 Nm is friction: too little to accelerate a large inertia in time.
    let settings = Settings { limit_ma: 500, ..Settings::FACTORY };
    let mut bench = Bench::new(settings, Parameters { inertia_gcm2: 100_000, ..MOTOR });
    bench.order(Order::Velocity(2_000));
    assert_alarm(&mut bench, 2_900, 3_100, Alarm::CtrlFail as u16);
}

#[test]
fn a_reference_of_zero_is_no_failure_of_control() {
    // 0.5 A against a load of 1 A: the load turns the shaft faster and faster.
    let settings = Settings { limit_ma: 500, stop_status: 1, ..Settings::FACTORY };
    let mut bench = Bench::new(settings, Parameters { inertia_gcm2: 100_000, ..MOTOR });
    bench.order(Order::Velocity(0));
    bench.load(-60_000);
    bench.run_ms(3_900);
    assert!(bench.real_rpm() > 10.0 && bench.alarms & Alarm::CtrlFail as u16 == 0, "{}", bench.alarms);
}

#[test]
fn swapped_wires_turn_it_against_its_reference() {
    for rpm in [300, -1_000] {
        let mut bench = Bench::new(Settings::FACTORY, MOTOR);
        bench.servo.swap(bench.now, true, &mut Wires(&mut bench.wires));
        bench.order(Order::Velocity(rpm));
        assert_alarm(&mut bench, 500, 700, Alarm::InvVel as u16);
        // The loop accelerates the shaft more and more in the wrong direction.
        let sign = rpm.signum();
        assert!(bench.real_rpm() * f64::from(sign) < -300.0 && bench.rpm() * sign < -300);
        bench.order(Order::Free);
        bench.run_ms(1);
        assert_eq!((bench.servo.current(), bench.servo.output(bench.now)), (0, 0));
    }
    // The wires are swapped while the motor turns.
    let mut bench = turning(Settings::FACTORY, MOTOR, 1_000);
    bench.servo.swap(bench.now, true, &mut Wires(&mut bench.wires));
    assert_alarm(&mut bench, 500, 900, Alarm::InvVel as u16);
}

#[test]
fn a_reversal_or_a_stop_is_no_alarm_however_long_it_takes() {
    for (settings, motor) in motors() {
        // 0.5 A are 0.03 Nm: on 10⁻³ kg·m² 3,000 rpm take 12 s with 0.005 Nm of friction. More friction would
        // hold the shaft.
        for (limit_ma, slow, seconds) in [(20_000, 0, 6), (20_000, 1_023, 20), (3_000, 100, 6), (500, 0, 40)]
        {
            if motor.friction_unm > 30_000 && limit_ma == 500 {
                continue;
            }
            for target in [-1_500, 0] {
                let settings =
                    Settings { limit_ma, slow_start: slow, slow_down: slow, stop_status: 1, ..settings };
                let mut bench =
                    turning(Settings { poles: settings.poles, ..Settings::FACTORY }, motor, 1_500);
                bench.set(|now| *now = settings);
                bench.order(Order::Velocity(target));
                bench.run_ms(1_000 * seconds);
                // A current at its limit for 4 s is a real overload, so that alarm is allowed.
                let alarms = bench.alarms & !(Alarm::OverLoad as u16);
                assert_eq!(alarms, 0, "{target}, {limit_ma} mA, {motor:?}");
                assert!((bench.real_rpm() - f64::from(target)).abs() < 20.0, "{}", bench.real_rpm());
            }
        }
    }
}

#[test]
fn a_broken_hall_sensor_is_noticed() {
    let mut bench = turning(Settings::FACTORY, MOTOR, 300);
    bench.servo.cut(bench.now, true, false);
    // All three sensors are high once in a period, 1/600 min.
    assert_alarm(&mut bench, 0, 101, Alarm::HallFail as u16);
    // The sensors are reported as broken in every ms while the code lasts. Within a period of 10 ms, HU is
    // high for half, and all three for a sixth.
    while !bench.servo.halls_are_broken() {
        bench.run_ms(1);
    }
    bench.hold(true);
    for _ in 0..100 {
        bench.alarms = 0;
        bench.run_ms(1);
        assert!(bench.servo.halls_are_broken());
    }
    bench.hold(false);
    bench.servo.cut(bench.now, false, false);
    bench.run_ms(10);
    bench.alarms = 0;
    assert_eq!(alarm(&mut bench, 2_000), None);
}

/// A bench with an encoder of `cycles` cycles, and the correct `ENC_PPR`.
fn encoder_edges(cycles: u16, stop_status: u16) -> Bench {
    let settings = Settings { enc_ppr: cycles, stop_status, ..Settings::FACTORY };
    Bench::new(settings, Parameters { encoder_cycles: cycles, ..MOTOR })
}

#[test]
fn a_good_encoder_is_no_alarm() {
    for cycles in [1, 2, 16, 500, 2_500] {
        for order in [
            Order::Position { count: 100, rpm: 600 },
            Order::Velocity(10),
            Order::Velocity(-40),
            Order::Velocity(1_000),
        ] {
            let mut bench = encoder_edges(cycles, 1);
            bench.order(order);
            assert_eq!(alarm(&mut bench, 6_000), None, "{order:?}, {cycles} cycles");
            // The shaft is held at 0, and a load pushes it.
            bench.order(Order::Velocity(0));
            assert_eq!(alarm(&mut bench, 3_000), None, "0 after {order:?}, {cycles} cycles");
            bench.load(-100_000);
            assert_eq!(alarm(&mut bench, 3_000), None, "a load after {order:?}, {cycles} cycles");
        }
    }
}

#[test]
fn a_silent_encoder_is_noticed() {
    let settings = Settings { enc_ppr: 500, ..Settings::FACTORY };
    let mut bench = Bench::new(settings, MOTOR);
    bench.order(Order::Velocity(500));
    assert_alarm(&mut bench, 600, 900, Alarm::HallFail as u16 | Alarm::EncoderFail as u16);
    assert_eq!(bench.rpm(), 0);

    let mut bench = turning(settings, Parameters { encoder_cycles: 500, ..MOTOR }, 500);
    bench.servo.cut(bench.now, false, true);
    assert_alarm(&mut bench, 590, 700, Alarm::HallFail as u16 | Alarm::EncoderFail as u16);
}

#[test]
fn nothing_is_wrong_with_a_motor_that_is_left_alone() {
    let mut bench =
        Bench::new(Settings { enc_ppr: 500, ..Settings::FACTORY }, Parameters { load_unm: -50_000, ..MOTOR });
    for order in [Order::Free, Order::Brake] {
        bench.order(order);
        assert_eq!(alarm(&mut bench, 6_000), None);
    }
    assert_eq!(bench.looks, 0);
}
