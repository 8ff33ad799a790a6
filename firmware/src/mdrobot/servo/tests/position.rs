//! Positions: moves, holding, and the ends of the range.

use super::*;

#[test]
fn a_move_arrives_in_time_and_stays() {
    for (settings, motor) in motors() {
        for (count, rpm) in
            [(1, 1_000), (-2, 1_000), (7, 1_000), (400, 600), (-1_200, 1_500), (3_000, 2_500), (120, 40)]
        {
            let mut bench = Bench::new(settings, motor);
            bench.order(Order::Position { count, rpm });
            let ideal = f64::from(count).abs() / (f64::from(rpm) / 60.0 * 3.0 * f64::from(settings.poles));
            let what = format!("{count} at {rpm} rpm of {motor:?}");
            let mut arrived = None;
            for ms in 1..(ideal * 2e3) as u64 + 1_500 {
                bench.run_ms(1);
                assert!(bench.real_rpm().abs() <= f64::from(rpm) * 1.15, "{} rpm, {what}", bench.real_rpm());
                let error = bench.servo.error().unwrap();
                let past = -error * i64::from(count.signum());
                assert!(past <= i64::from(count.abs() / 20).max(1), "{error} too far, {what}");
                if error.abs() <= 1 && arrived.is_none() {
                    arrived = Some(ms as f64 / 1e3);
                }
                assert!(arrived.is_none() || error.abs() <= 1, "{error} after {ms} ms, {what}");
            }
            let arrived = arrived.unwrap();
            // `PV_GAIN` makes the end slower: 20 rpm for each count are 60/(20·3·poles) s for slowing down by
            // a factor of e.
            let slowing = 60.0 / (20.0 * 3.0 * f64::from(settings.poles));
            if ideal > 6.0 * slowing {
                // The way is from the middle of a count to the count before the target.
                let least = ideal * (1.0 - 1.5 / f64::from(count).abs());
                assert!((least..2.0 * ideal).contains(&arrived), "{arrived} s for {ideal}, {what}");
            }
            assert_eq!(i64::from(bench.servo.position() - count), -bench.servo.error().unwrap());
            assert!(bench.alarms == 0 && bench.real_rpm().abs() < 0.1, "{what}: {:?}", bench.alarms);
        }
    }
}

#[test]
fn the_furthest_position_is_on_its_own_side() {
    for (start, count) in [(100, i32::MIN), (-100, i32::MAX)] {
        let mut bench = Bench::new(Settings::FACTORY, MOTOR);
        bench.order(Order::Position { count: start, rpm: 1_000 });
        bench.run_ms(3_000);
        bench.order(Order::Position { count, rpm: 1_000 });
        bench.run_ms(1_000);
        assert!((bench.rpm() - 1_000 * count.signum()).abs() <= 10, "{} rpm to {count}", bench.rpm());
    }
}

/// The counts continue beyond the range of positions.
#[test]
fn the_furthest_position_is_reached_and_held() {
    for (last, way) in [(i32::MAX, 1), (i32::MIN, -1)] {
        let mut bench = Bench::new(Settings::FACTORY, MOTOR);
        bench.servo.zero -= i64::from(last) - 50 * way;
        for order in [Order::Position { count: last, rpm: 1_000 }, Order::Velocity(300 * way as i32)] {
            bench.order(order);
            bench.run_ms(2_000);
            assert_eq!(bench.servo.position(), last);
        }
        // The shaft turned 10 turns further, and comes back.
        bench.order(Order::Position { count: last, rpm: 1_000 });
        assert!((-130..=-110).contains(&(bench.servo.error().unwrap() * way)), "{:?}", bench.servo.error());
        bench.run_ms(3_000);
        assert!(bench.servo.error().unwrap().abs() <= 1 && bench.rpm() == 0, "{:?}", bench.servo.error());
    }
}

#[test]
fn what_is_held_does_not_hunt() {
    for (settings, motor) in motors() {
        let settings = Settings { stop_status: 1, ..settings };
        // Loads of up to half of the torque of 20 A.
        for load in [0, 30_000, -600_000] {
            for order in [Order::Velocity(0), Order::Position { count: 50, rpm: 500 }] {
                let mut bench = Bench::new(settings, motor);
                bench.order(Order::Velocity(500));
                bench.run_ms(1_000);
                bench.order(order);
                bench.run_ms(3_000);
                bench.load(load);
                bench.run_ms(2_000);
                let place = bench.servo.position();
                for _ in 0..10_000 {
                    bench.run_ms(1);
                    let moved = (bench.servo.position() - place).abs();
                    assert!(moved <= 1, "{moved} counts by {load} µNm, {order:?}, {motor:?}");
                    assert_eq!(bench.rpm(), 0, "by {load} µNm, {order:?}, {motor:?}");
                }
                assert!(
                    bench.servo.error().is_none_or(|error| error.abs() <= 1),
                    "{:?}",
                    bench.servo.error()
                );
            }
        }
    }
}

#[test]
fn a_smaller_pv_gain_is_later_and_a_lower_max_load_slower() {
    for (settings, motor) in motors() {
        let arrival = |settings| {
            let mut bench = Bench::new(settings, motor);
            bench.order(Order::Position { count: 300, rpm: 1_000 });
            (1..20_000).find(|_| {
                bench.run_ms(1);
                bench.servo.error().unwrap().abs() <= 1
            })
        };
        let arrivals = [40, 20, 10, 5].map(|pv_gain| arrival(Settings { pv_gain, ..settings }).unwrap());
        assert!(arrivals.is_sorted_by(|soon, late| soon < late), "{arrivals:?}");
        // Speeds 60 ms after the order: a higher limit accelerates faster.
        let speeds = [4_000, 8_000, 16_000]
            .map(|limit_ma| rpm_after(Settings { limit_ma, ..settings }, motor, Order::Velocity(2_500), 60));
        assert!(speeds.is_sorted_by(|slow, fast| slow < fast), "{speeds:?}");
    }
}

#[test]
fn clearing_the_position_moves_the_target_along() {
    let mut bench = Bench::new(Settings::FACTORY, MOTOR);
    bench.order(Order::Position { count: 100, rpm: 500 });
    bench.run_ms(500);
    let (way, speed) = (100 - bench.servo.position(), bench.real_rpm());
    assert!(way > 10);
    bench.servo.clear_position();
    assert_eq!(
        (bench.servo.position(), bench.servo.target(), bench.servo.error()),
        (0, way, Some(way.into()))
    );
    bench.run_ms(1);
    assert!((bench.real_rpm() - speed).abs() < 5.0);
    bench.run_ms(3_000);
    assert!(bench.servo.error().unwrap().abs() <= 1);
    assert_eq!(bench.servo.target(), way);
}
