//! Readings of the sensors and of the current, also with other motors.

use super::*;

#[test]
fn halls_count_as_the_motor_shows_them() {
    // The load turns the shaft more than a turn: each count of the shaft is a count of the drive.
    for load_unm in [-50_000, 50_000] {
        let mut bench = Bench::new(Settings::FACTORY, Parameters { load_unm, ..MOTOR });
        let start = bench.shaft().position;
        while bench.servo.position().abs() < 24 {
            bench.run(Duration::micros(100));
            // An edge arrives one tick after it was made.
            let made = bench.shaft().position - start;
            assert!((bench.servo.position() - made).abs() <= 1, "{made}");
        }
        assert_eq!(bench.servo.position().signum(), -load_unm.signum());
    }
}

#[test]
fn counts_are_three_for_each_pole_and_turn() {
    for (settings, motor) in motors() {
        let mut bench = Bench::new(settings, motor);
        bench.order(Order::Velocity(-1_200));
        bench.run_ms(2_000);
        let (before, shaft) = (bench.servo.position(), bench.shaft().position);
        bench.run_ms(3_000);
        let made = bench.servo.position() - before;
        let ideal = -1_200.0 / 60.0 * 3.0 * f64::from(settings.poles) * 3.0;
        assert!((f64::from(made) - ideal).abs() <= 0.02 * ideal.abs() + 2.0, "{made} {ideal}");
        assert!((bench.shaft().position - shaft - made).abs() <= 1);
    }
}

#[test]
fn what_a_rpm_is_the_sensors_say() {
    // Poles by `HALL_TYPE` and real ones, `ENC_PPR` and real pulses, and the factor by which the motor is
    // faster.
    for (poles, real_poles, enc_ppr, real_ppr, times) in [
        (8, 4, 0, 0, 2.0),
        (4, 12, 0, 0, 1.0 / 3.0),
        (4, 4, 1_000, 1_000, 1.0),
        (4, 4, 1_000, 500, 2.0),
        (4, 4, 100, 500, 0.2),
        (10, 4, 20, 20, 1.0),
    ] {
        for rpm in [100, 1_000, -600] {
            let settings = Settings { poles, enc_ppr, ..Settings::FACTORY };
            let motor = Parameters { hall_pulses: real_poles / 2, encoder_cycles: real_ppr, ..MOTOR };
            let mut bench = Bench::new(settings, motor);
            bench.order(Order::Velocity(rpm));
            bench.run_ms(3_000);
            let ideal = f64::from(rpm) * times;
            let what = format!("{rpm}, {poles}/{real_poles} poles, {enc_ppr}/{real_ppr}");
            assert!(
                (bench.real_rpm() / ideal - 1.0).abs() < 0.01,
                "{} for {ideal}: {what}",
                bench.real_rpm()
            );
            assert!((bench.rpm() - rpm).abs() <= (rpm.abs() / 100).max(2), "{}: {what}", bench.rpm());
            assert_eq!(bench.alarms, 0, "{what}");
        }
    }
}

#[test]
fn other_motors_are_turned_well() {
    for resistance_mohm in [50, 150, 500, 1_500] {
        for no_load_rpm in [2_000, 4_000, 8_000] {
            for ms in [1.5, 10.0, 50.0] {
                // The time constant is J·R/K².
                let k = 24.0 / (f64::from(no_load_rpm) * core::f64::consts::TAU / 60.0);
                let inertia = ms * 1e-3 * k * k / (f64::from(resistance_mohm) * 1e-3);
                let motor = Parameters {
                    resistance_mohm,
                    inertia_gcm2: (inertia * 1e7) as u32,
                    no_load_rpm,
                    ..MOTOR
                };
                let mut bench = Bench::new(Settings::FACTORY, motor);
                for rpm in [300, -1_000, 100] {
                    bench.order(Order::Velocity(rpm));
                    bench.run_ms(3_000);
                    for _ in 0..500 {
                        bench.run_ms(1);
                        let off = (bench.real_rpm() - f64::from(rpm)).abs();
                        assert!(
                            off <= 0.01 * f64::from(rpm).abs() + 2.0,
                            "{} for {rpm}, {motor:?}",
                            bench.real_rpm()
                        );
                    }
                }
                bench.order(Order::Position { count: bench.servo.position() + 200, rpm: 600 });
                bench.run_ms(4_000);
                assert!(bench.servo.error().unwrap().abs() <= 1, "{:?} left, {motor:?}", bench.servo.error());
            }
        }
    }
}

#[test]
fn the_winding_is_known_after_any_rest() {
    for resistance_mohm in [100, 200, 900, 2_000] {
        for (rest, limit_ma) in [
            (Order::Free, 20_000),
            (Order::Brake, 20_000),
            (Order::Brake, 1_000),
            (Order::Velocity(0), 20_000),
        ] {
            for friction_unm in [10_000, 40_000] {
                let motor = Parameters { resistance_mohm, friction_unm, ..MOTOR };
                let mut bench = Bench::new(Settings { limit_ma, stop_status: 2, ..Settings::FACTORY }, motor);
                bench.order(rest);
                bench.run_ms(100);
                bench.order(Order::Velocity(300));
                bench.run_ms(3_000);
                for _ in 0..500 {
                    bench.run_ms(1);
                    let (shown, real) = (bench.rpm(), bench.real_rpm());
                    let what = format!("{shown} {real} rpm after {rest:?}, {motor:?}");
                    assert!((real - 300.0).abs() <= 3.0 && (shown - 300).abs() <= 3, "{what}");
                }
            }
        }
    }
}

#[test]
fn what_stands_stands_for_good() {
    for (settings, motor) in motors() {
        for load in [0, 200_000, -200_000] {
            for order in [Order::Velocity(0), Order::Position { count: 50, rpm: 500 }] {
                let mut bench = Bench::new(Settings { stop_status: 1, ..settings }, motor);
                bench.order(Order::Velocity(700));
                bench.run_ms(1_000);
                bench.load(load);
                bench.order(order);
                bench.run_ms(10_000);
                let before = (bench.servo.position(), bench.servo.duty, bench.servo.pi.clone());
                let what = format!("{load} µNm, {order:?}, {motor:?}");
                // At standstill with an unchanged integral and no error, every further ms is the same.
                bench.run_ms(3_000);
                let after = (bench.servo.position(), bench.servo.duty, bench.servo.pi.clone());
                assert_eq!((bench.real_rpm(), bench.rpm(), bench.alarms), (0.0, 0, 0), "{what}");
                assert_eq!(format!("{before:?}"), format!("{after:?}"), "{what}");
                let needed = (f64::from(load).abs() + f64::from(motor.friction_unm)) / 60.0;
                let ma = f64::from(bench.servo.current().abs());
                assert!(ma <= needed + 200.0, "{ma} of {needed} mA, {what}");
            }
        }
    }
}
