//! RC, HC, HT, DE and MS.

use super::*;

#[test]
fn the_run_current_comes_with_a_motion_and_goes_ht_after_it() {
    let mut bench = Bench::new(SLOW);
    // Currents are in percent of 3 A.
    assert_eq!(bench.out.currents, [(Instant::ZERO, AXIS, 150)]);
    bench.run(10.millis());
    bench.does(to(100));
    bench.run_out();
    let end = bench.now;
    bench.run(10.secs());
    let begin = Instant::from(10.millis());
    assert_eq!(bench.out.currents[1..], [(begin, AXIS, 750), (end + 500.millis(), AXIS, 150)]);
}

#[test]
fn a_motion_within_ht_keeps_the_current() {
    let mut bench = Bench::new(SLOW);
    bench.does(to(1));
    bench.run_out();
    bench.run(499.millis());
    bench.does(to(2));
    bench.run_out();
    bench.run(499.millis());
    assert_eq!(bench.out.currents.len(), 2);
    bench.run(2.millis());
    assert_eq!(bench.out.currents.len(), 3);
}

#[test]
fn with_ht_0_the_current_is_never_reduced() {
    // HT 0 (MC 5-32).
    let mut bench = Bench::new(Settings { hold_delay_ms: 0, ..SLOW });
    bench.does(to(1));
    bench.run(100.secs());
    assert_eq!(bench.out.currents.last(), Some(&(Instant::ZERO, AXIS, 750)));
    // If HT has already passed when it is set, it takes effect at once.
    bench.set(Settings { hold_delay_ms: 2, ..SLOW });
    assert_eq!(bench.out.currents.last(), Some(&(bench.now, AXIS, 150)));
}

#[test]
fn percents_act_at_once_where_they_count() {
    let mut bench = Bench::new(SLOW);
    bench.set(Settings { hold_percent: 100, run_percent: 1, ..SLOW });
    assert_eq!(bench.out.currents.last(), Some(&(Instant::ZERO, AXIS, 3_000)));
    bench.does(Order::Slew(1));
    assert_eq!(bench.out.currents.last(), Some(&(Instant::ZERO, AXIS, 30)));
    bench.set(Settings { hold_percent: 100, run_percent: 67, ..SLOW });
    assert_eq!(bench.out.currents.last(), Some(&(Instant::ZERO, AXIS, 2_010)));
}

#[test]
fn what_holds_without_current_follows_all_the_same() {
    // As in MC 8.7, where HC is 0.
    for order in [to(50_000), Order::Slew(50_000)] {
        let mut bench = Bench::new(Settings { hold_percent: 0, ..FACTORY });
        bench.does(order);
        bench.run(2.secs());
        assert!(bench.c1() >= 50_000);
        assert!((bench.c2() - bench.c1() / 25).abs() <= 1, "{order:?}: {}", bench.c2());
    }
}

#[test]
fn without_its_bridge_the_indexer_runs_and_the_shaft_does_not() {
    // DE 0 (MC 5-19).
    let mut bench = Bench::new(Settings { enabled: false, ..SLOW });
    assert_eq!(bench.out.currents, [(Instant::ZERO, AXIS, 0)]);
    bench.does(to(1_000));
    bench.run_out();
    assert_eq!((bench.c1(), bench.c2()), (1_000, 0));
    bench.set(SLOW);
    bench.does(by(1_000));
    bench.run_out();
    bench.run(2.millis());
    // The shaft comes into step at the nearest position, at most two full steps away: 2·256/25 counts.
    assert_eq!(bench.c1(), 2_000);
    assert!((bench.c2() - 40).abs() <= 21, "{}", bench.c2());
}

#[test]
fn ms_is_the_size_of_a_step() {
    // A revolution is 200 full steps and 2,048 counts (MC 5-48).
    for (microsteps, turn) in [(1, 200), (108, 21_600), (127, 25_400), (180, 36_000), (250, 50_000)] {
        let mut bench = Bench::new(Settings { microsteps, start: 100, speed: 10_000, ..FACTORY });
        bench.does(by(2 * turn));
        bench.run_out();
        bench.run(MS);
        assert_eq!(bench.c2(), 2 * 2_048, "{microsteps}");
        bench.set(Settings { start: 100, speed: 10_000, ..FACTORY });
        assert_eq!(bench.c2(), 2 * 2_048, "{microsteps}");
        bench.does(by(-51_200));
        bench.run_out();
        bench.run(MS);
        assert_eq!(bench.c2(), 2_048, "{microsteps}");
    }
}

#[test]
fn a_restart_forgets_all_but_where_the_shaft_is() {
    let mut bench = Bench::new(SLOW);
    bench.does(to(5_000));
    bench.run(1.secs());
    bench.contact(Contact::PlusLimit, true);
    bench.feed(|motion, at, out| motion.power_on(at, SLOW, out));
    assert_eq!((bench.c1(), bench.c2(), bench.v(), bench.is_moving()), (0, 0, 0, false));
    bench.does(to(51_200));
    bench.run_out();
    assert_eq!((bench.c1(), bench.c2()), (51_200, 2_048));
}
