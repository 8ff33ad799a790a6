//! Velocity: steps, ramps, gains, and the state at reference zero.

use super::*;

#[test]
fn a_step_of_the_velocity_comes_in_time_and_stays() {
    for (settings, motor) in motors() {
        for (from, to) in [(0, 1_000), (0, 40), (1_000, 40), (40, 2_500), (2_500, 100), (1_000, -1_000)] {
            let mut bench = Bench::new(settings, motor);
            if from != 0 {
                bench.order(Order::Velocity(from));
                bench.run_ms(2_000);
            }
            bench.order(Order::Velocity(to));
            let begin = bench.real_rpm();
            let part = |bench: &Bench| (bench.real_rpm() - begin) / (f64::from(to) - begin);
            let what = format!("{from} to {to} of {motor:?}");
            for ms in 1..4_000 {
                bench.run_ms(1);
                let part = part(&bench);
                assert!(part <= 1.2, "{part} of {what} after {ms} ms");
                assert!(ms > 1 || part < 0.6, "{part} of {what} at once");
                assert!(ms < 580 || part >= 0.9, "{part} of {what} after {ms} ms");
                if ms >= 2_000 {
                    let off = (bench.rpm() - to).abs();
                    let most = if to == 40 { 4 } else { (to.abs() / 100).max(2) };
                    assert!(off <= most, "{} of {what} after {ms} ms", bench.rpm());
                }
            }
            assert!(bench.most_ma <= 20_000 && bench.alarms == 0, "{what}: {:?}", bench.alarms);
        }
    }
}

#[test]
fn it_follows_a_ramp() {
    // A ramp takes 15 s·raw/1,023 for 3,000 rpm.
    for (settings, motor) in motors() {
        for (from, to, start, down) in [
            (0, 600, 68, 0),
            (0, 600, 1_023, 0),
            (600, 0, 0, 68),
            (0, 1_000, 205, 0),
            (1_000, 0, 0, 205),
            (0, 2_500, 68, 0),
            (2_500, 0, 0, 136),
            (2_000, 500, 0, 136),
            (0, 1_000, 1_023, 0),
            (1_000, -1_000, 341, 205),
        ] {
            let mut bench = Bench::new(settings, motor);
            bench.order(Order::Velocity(from));
            bench.run_ms(2_000);
            bench.set(|settings| (settings.slow_start, settings.slow_down) = (start, down));
            bench.order(Order::Velocity(to));
            let slope = |raw: u16| 3_000.0 / (15.0 * f64::from(raw) / 1_023.0);
            let ideal = |t: f64| {
                let (from, to) = (f64::from(from), f64::from(to));
                if from * to < 0.0 {
                    let stands = from / slope(down);
                    if t < stands { from - slope(down) * t } else { (slope(start) * (stands - t)).max(to) }
                } else if to > from {
                    (from + slope(start) * t).min(to)
                } else {
                    (from - slope(down) * t).max(to)
                }
            };
            let (mut done, mut ms) = (0, 0);
            while done < 500 {
                bench.run_ms(1);
                ms += 1;
                let should = ideal(f64::from(ms) / 1e3);
                let off = (bench.real_rpm() - should).abs();
                let step = f64::from(to - from).abs();
                // With the greatest inertia and friction, the speed lags 20 ms behind at 3,000 rpm/s,
                // whatever the step.
                assert!(
                    off <= (0.08 * step).max(66.0),
                    "{} for {should} from {from} to {to}, {ms} ms, {motor:?}",
                    bench.real_rpm()
                );
                // `RPM_DATA` is the mean over the last edges: over at least 2 ms, or over one count. 500 rpm
                // make 100 counts per second.
                let shown = (f64::from(bench.rpm()) - bench.real_rpm()).abs();
                let a_ms =
                    [start, down].into_iter().filter(|&raw| raw > 0).map(slope).fold(0.0, f64::max) / 1e3;
                assert!(
                    bench.real_rpm().abs() < 500.0 || shown <= 10.0 + a_ms * 25.0,
                    "{} shown at {} rpm from {from} to {to}, {ms} ms, {motor:?}",
                    bench.rpm(),
                    bench.real_rpm()
                );
                done += i32::from((should - f64::from(to)).abs() < 0.5);
            }
            let most = (f64::from(to).abs() / 100.0).max(2.0);
            assert!(f64::from(bench.rpm() - to).abs() <= most, "{} after {from} to {to}", bench.rpm());
        }
    }
}

/// The same motor with another supply, from the start on or from a change while it turns.
#[test]
fn the_supply_may_be_another_one() {
    let fed = |supply: u16| {
        let of_24_v = |whole: u32| whole * u32::from(supply) / 240;
        Parameters { supply_mv: of_24_v(24_000), no_load_rpm: of_24_v(3_820), load_unm: 60_000, ..MOTOR }
    };
    for (first, then) in [(120, 120), (480, 480), (240, 120), (240, 600), (480, 240)] {
        let mut bench = turning(Settings::FACTORY, fed(first), 1_000);
        bench.motor.set_parameters(bench.now, fed(then), &mut Wires(&mut bench.wires));
        bench.run_ms(2_000);
        for _ in 0..1_000 {
            bench.run_ms(1);
            assert!((bench.rpm() - 1_000).abs() <= 10, "{} rpm at {then}, after {first}", bench.rpm());
            assert!((bench.real_rpm() - 1_000.0).abs() <= 30.0, "{} rpm at {then}", bench.real_rpm());
        }
        assert_eq!(bench.alarms, 0);
    }
}

#[test]
fn gains_act_on_the_motor() {
    for (settings, motor) in motors() {
        let steady = |p_gain, i_gain| {
            rpm_after(Settings { p_gain, i_gain, ..settings }, motor, Order::Velocity(1_000), 3_000)
        };
        assert_eq!(steady(0, 0), 0.0);
        assert!(steady(1, 0) < 900.0);
        let errors = [1_000, 3_000, 6_000, 20_000].map(|p_gain| 1_000.0 - steady(p_gain, 0));
        assert!(errors.is_sorted_by(|more, less| more > less) && errors[3] > 0.0, "{errors:?}");
        for (p_gain, i_gain) in [(6_000, 1_000), (0, 2_000), (20_000, 6_000)] {
            assert!(
                (steady(p_gain, i_gain) - 1_000.0).abs() < 10.0,
                "{p_gain} {i_gain} {}",
                steady(p_gain, i_gain)
            );
        }
    }
}

#[test]
fn no_gain_and_no_limit_make_it_stick_on_the_way() {
    for i_gain in [500, 6_000, 20_000] {
        for p_gain in [1_000, 6_000, 20_000] {
            for limit_ma in [500, 2_000, 20_000] {
                for (from, to) in [(0, 3_000), (3_000, 0), (1_000, -1_000)] {
                    let settings = Settings { i_gain, p_gain, limit_ma, stop_status: 1, ..Settings::FACTORY };
                    let mut bench = turning(Settings::FACTORY, MOTOR, from);
                    bench.set(|now| *now = settings);
                    bench.order(Order::Velocity(to));
                    let what = format!("{from} to {to}, I {i_gain}, P {p_gain}, {limit_ma} mA");
                    // 0.5 A are 0.02 Nm more than friction: 382 rpm/s on 5·10⁻⁴ kg·m².
                    bench.run_ms(11_000);
                    let (mut off, mut accelerates) = (0.0_f64, 0.0_f64);
                    for _ in 0..10 {
                        let before = bench.real_rpm();
                        bench.run_ms(100);
                        off = off.max((bench.real_rpm() - f64::from(to)).abs());
                        accelerates = accelerates.max((bench.real_rpm() - before).abs());
                    }
                    // A wrong speed still oscillates, as with an integral gain and a small proportional gain.
                    // It does not stay wrong.
                    let settles = off <= (f64::from(to).abs() / 100.0).max(2.0);
                    assert!(settles || accelerates > off / 10.0, "off by {off}: {what}");
                    assert!(settles || p_gain < 6_000, "off by {off}: {what}");
                    // A current at its limit for 4 s is a real overload, so that alarm is allowed.
                    assert_eq!(bench.alarms & !(Alarm::OverLoad as u16), 0, "{what}");
                }
            }
        }
    }
}

#[test]
fn stop_status_says_what_zero_is() {
    for (stop_status, slow_down) in [(0, 0), (0, 68), (1, 0), (1, 68), (2, 0), (2, 68), (3, 0), (3, 68)] {
        let mut bench = turning(Settings { stop_status, slow_down, ..Settings::FACTORY }, MOTOR, 1_500);
        bench.order(Order::Velocity(0));
        // A `SLOW_DOWN` of 68 is 1 s for 3,000 rpm.
        bench.run_ms(100);
        let free = bench.shaft().ma == 0 && bench.shaft().duty == 0;
        let at_once = slow_down == 0 || stop_status == 3;
        assert_eq!(free, at_once && matches!(stop_status, 0 | 3), "{stop_status} {slow_down}");
        if !at_once {
            assert!((bench.real_rpm() - 1_200.0).abs() < 100.0);
        }
        bench.run_ms(600);
        assert_eq!(bench.real_rpm() < 50.0, !matches!((stop_status, slow_down), (0, 0) | (3, _)));
        bench.run_ms(15_000);
        assert_eq!((bench.rpm(), bench.real_rpm()), (0, 0.0), "{stop_status} {slow_down}");
        // A shaft that is held reacts against a load.
        bench.load(-200_000);
        bench.run_ms(2_000);
        let rpm = bench.real_rpm();
        match stop_status {
            1 => assert!(rpm.abs() < 1.0, "{rpm}"),
            // 0.19 Nm are 3.17 A and 0.95 V.
            2 => assert!((rpm - 0.95 / 24.0 * 3_820.0).abs() < 2.0, "{rpm}"),
            _ => assert!(rpm > 3_000.0, "{rpm}"),
        }
    }
}

#[test]
fn an_order_goes_on_from_the_present_speed() {
    let settings = Settings { slow_start: 341, slow_down: 341, ..Settings::FACTORY };
    for before in
        [Order::Free, Order::Open(400), Order::Torque(0), Order::Position { count: 100_000, rpm: 1_000 }]
    {
        let mut bench = Bench::new(Settings::FACTORY, MOTOR);
        bench.order(Order::Velocity(1_000));
        bench.run_ms(2_000);
        bench.order(before);
        bench.run_ms(100);
        bench.set(|now| *now = settings);
        let speed = bench.real_rpm();
        bench.order(Order::Velocity(2_000));
        // The ramp is 600 rpm per second.
        for ms in 1..200 {
            bench.run_ms(1);
            let ideal = speed + 0.6 * f64::from(ms);
            assert!(
                (bench.real_rpm() - ideal).abs() < 60.0,
                "{} for {ideal} after {before:?}",
                bench.real_rpm()
            );
        }
    }
}

#[test]
fn it_coasts_longer_than_it_brakes_and_without_a_current() {
    for (settings, motor) in motors() {
        let stands = |order| {
            let mut bench = Bench::new(settings, motor);
            bench.order(Order::Velocity(1_000));
            bench.run_ms(1_000);
            bench.order(order);
            bench.run_ms(1);
            (0..60_000).find(|_| {
                bench.run_ms(1);
                assert!(order == Order::Brake || bench.servo.current() == 0);
                assert_eq!(bench.servo.output(bench.now), 0);
                bench.real_rpm() == 0.0
            })
        };
        let (coasts, brakes) = (stands(Order::Free).unwrap(), stands(Order::Brake).unwrap());
        assert!(coasts >= 2 * brakes, "{coasts} and {brakes} ms, {motor:?}");
    }
}
