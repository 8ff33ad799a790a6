//! Output to the motor: limits, open loop, torque.

use super::*;

#[test]
fn a_current_stays_below_max_load() {
    for (settings, motor) in motors() {
        for limit_ma in [1_500, 20_000] {
            let mut bench = Bench::new(Settings { limit_ma, ..settings }, motor);
            for order in [
                Order::Velocity(3_000),
                Order::Velocity(-3_000),
                Order::Brake,
                Order::Open(1_023),
                Order::Open(-1_023),
                Order::Position { count: 0, rpm: 3_000 },
                Order::Torque(1_023),
                Order::Torque(-1_023),
            ] {
                bench.order(order);
                bench.run_ms(500);
            }
            assert!(bench.most_ma <= limit_ma && bench.most_ma > limit_ma * 9 / 10, "{}", bench.most_ma);
        }
    }
}

#[test]
fn an_open_loop_is_mirrored_and_goes_with_the_output() {
    for (settings, motor) in motors() {
        let steady = |output| rpm_after(settings, motor, Order::Open(output), 3_000);
        let (one, two) = (steady(300), steady(600));
        assert!((1.6..2.6).contains(&(two / one)), "{one} and {two}");
        assert!((steady(-300) + one).abs() < 0.01 * one);
        // The whole supply without the loss by friction: 24 V are 3,820 rpm, and 0.06 Nm are 1 A and 0.3 V.
        let lost = f64::from(motor.friction_unm) / 60_000.0 * 0.3 / 24.0;
        assert!((steady(1_023) / (3_820.0 * (1.0 - lost)) - 1.0).abs() < 0.01);
    }
}

#[test]
fn a_torque_is_its_part_of_max_load() {
    for (torque, ma) in [(1_023, 20_000), (-1_023, -20_000), (100, 20_000 * 100 / 1_023), (0, 0)] {
        let mut bench = Bench::new(Settings::FACTORY, MOTOR);
        bench.hold(true);
        bench.order(Order::Torque(torque));
        bench.run_ms(100);
        assert_eq!(bench.servo.current(), ma);
        // The current loses this part of 24 V in 0.3 Ω.
        let output = f64::from(ma) * 0.3 / 24_000.0 * 1_023.0;
        assert!(
            (f64::from(bench.servo.output(bench.now)) - output).abs() <= 1.0,
            "{} {output}",
            bench.servo.output(bench.now)
        );
        bench.hold(false);
        bench.run_ms(20);
        // The motor has 0.06 Nm/A, 0.01 Nm of friction, and 5·10⁻⁴ kg·m².
        let way = f64::from(ma) * 0.06e-3 - 0.01 * f64::from(ma.signum());
        let rpm = way / 5e-4 * 0.02 / core::f64::consts::TAU * 60.0;
        assert!((bench.real_rpm() - rpm).abs() <= 0.02 * rpm.abs(), "{} {rpm}", bench.real_rpm());
    }
}

#[test]
fn the_output_is_what_the_limit_of_the_current_lets_it() {
    // At 2 A the winding of 0.3 Ω takes 0.6 V. 0.12 - 0.01 Nm give 110 rad/s in 0.5 s on 5·10⁻⁴ kg·m²: 6.6 V.
    for order in [Order::Open(1_023), Order::Velocity(3_000), Order::Torque(1_023)] {
        let mut bench = Bench::new(Settings { limit_ma: 2_000, ..Settings::FACTORY }, MOTOR);
        bench.hold(true);
        bench.order(order);
        bench.run_ms(100);
        let held = bench.servo.output(bench.now);
        assert!((held - 26).abs() <= 2, "{held} of 25.6, {order:?}");
        bench.hold(false);
        bench.run_ms(500);
        let turns = bench.servo.output(bench.now);
        // Speed control keeps a part of the limit in reserve.
        assert!((285..=310).contains(&turns), "{turns} of 307, {order:?}");
    }
}

#[test]
fn wild_registers_and_orders_do_no_harm() {
    let wild = Settings {
        max_rpm: u16::MAX,
        limit_ma: u32::MAX,
        pv_gain: u16::MAX,
        p_gain: u16::MAX,
        i_gain: u16::MAX,
        slow_start: u16::MAX,
        slow_down: u16::MAX,
        stop_status: u16::MAX,
        poles: u16::MAX,
        enc_ppr: u16::MAX,
    };
    let none = Settings {
        max_rpm: 0,
        limit_ma: 0,
        pv_gain: 0,
        p_gain: 0,
        i_gain: 0,
        slow_start: 0,
        slow_down: 0,
        stop_status: 1,
        poles: 0,
        enc_ppr: 0,
    };
    for settings in
        [wild, none, Settings { enc_ppr: 0, slow_start: 0, ..wild }, Settings { poles: 1, ..wild }]
    {
        let mut bench = Bench::new(Settings::FACTORY, Parameters { encoder_cycles: 100, ..MOTOR });
        bench.set(|now| *now = settings);
        for order in [
            Order::Velocity(i32::MAX),
            Order::Velocity(i32::MIN),
            Order::Open(i16::MIN),
            Order::Torque(i16::MIN),
            Order::Position { count: i32::MIN, rpm: i32::MAX },
            Order::Position { count: i32::MAX, rpm: i32::MIN },
        ] {
            bench.order(order);
            bench.run_ms(200);
            bench.servo.report(bench.now, &Input::MotorCurrent { axis: AXIS, ma: i32::MIN });
            bench.run_ms(10);
            bench.servo.report(bench.now, &Input::MotorCurrent { axis: AXIS, ma: i32::MAX });
            bench.run_ms(10);
        }
        // The servo still obeys orders afterwards.
        bench.order(Order::Free);
        bench.run_ms(10);
        assert_eq!((bench.shaft().ma, bench.servo.output(bench.now)), (0, 0));
        bench.set(|now| *now = Settings { stop_status: 2, ..Settings::FACTORY });
        bench.order(Order::Brake);
        bench.run_ms(5_000);
        bench.order(Order::Velocity(300));
        bench.run_ms(3_000);
        assert!((bench.real_rpm() - 300.0).abs() <= 3.0, "{} {settings:?}", bench.real_rpm());
    }
}
