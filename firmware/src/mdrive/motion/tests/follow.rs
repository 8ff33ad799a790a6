//! Clock inputs (MC 5-13, 5-14).

use super::*;

/// Requests a `step` every `every`, `steps` times.
fn clock(bench: &mut Bench, steps: u32, step: i32, every: Duration) {
    for _ in 0..steps {
        bench.run(every);
        bench.feed(|motion, at, out| motion.follow(at, step, out));
    }
}

#[test]
fn at_a_ratio_of_1_every_step_is_made_at_once() {
    let mut bench = Bench::new(Settings { follows_clock: true, ..SLOW });
    clock(&mut bench, 100, -1, 100.micros());
    let expected: Vec<_> = (1..=100).map(|n| (Instant::from(Duration::micros(100 * n)), AXIS, -1)).collect();
    assert_eq!(bench.out.steps, expected);
    assert_eq!((bench.c1(), bench.is_moving(), bench.v()), (-100, true, -10_000));
    assert_eq!(bench.out.currents.last().map(|(.., ma)| *ma), Some(750));
    bench.run(2.millis());
    assert_eq!(bench.c2(), -4);
    bench.run_out();
    assert!(bench.now.since(Instant::from(10.millis())) <= 12.millis());
    bench.does(to(0));
    bench.run_out();
    assert_eq!(bench.c1(), 0);
}

#[test]
fn at_another_ratio_it_ramps_and_makes_all_steps() {
    let mut bench = Bench::new(Settings { follows_clock: true, ratio: 500, ..SLOW });
    // 4,000 steps/s need 0.3 s of ramp.
    clock(&mut bench, 100, 1, 250.micros());
    assert!(bench.v() > 1_000 && bench.v() < 1_500, "{}", bench.v());
    clock(&mut bench, 3_900, 1, 250.micros());
    assert_eq!((bench.v(), bench.out.steps.len()), (4_000, 0));
    bench.run_out();
    assert_eq!((bench.c1(), bench.c2()), (4_000, 160));
}

#[test]
fn it_follows_both_ways() {
    let mut bench = Bench::new(Settings { follows_clock: true, ratio: 1_999, ..SLOW });
    clock(&mut bench, 2_000, 2, 500.micros());
    clock(&mut bench, 3_000, -2, 500.micros());
    assert_eq!(bench.v(), -4_000);
    bench.run_out();
    assert_eq!(bench.c1(), -2_000);
}

#[test]
fn another_ratio_ends_what_it_follows() {
    let mut bench = Bench::new(Settings { follows_clock: true, ratio: 500, ..SLOW });
    clock(&mut bench, 2_000, 1, 250.micros());
    assert_eq!(bench.v(), 4_000);
    bench.set(Settings { follows_clock: true, ..SLOW });
    bench.run(100.millis());
    // The ramp takes 300 ms.
    assert!(bench.v() < 4_000 && bench.is_moving());
    bench.run_out();
    let there = bench.c1();
    clock(&mut bench, 10, 1, MS);
    assert_eq!((bench.c1(), bench.out.steps.len()), (there + 10, 10));
}

#[test]
fn without_cm_the_clock_does_nothing() {
    let mut bench = Bench::new(SLOW);
    clock(&mut bench, 10, 1, MS);
    assert_eq!((bench.c1(), bench.is_moving()), (0, false));
}

#[test]
fn an_order_is_not_disturbed_by_the_clock() {
    let mut bench = Bench::new(Settings { follows_clock: true, ..SLOW });
    bench.does(to(1_000));
    bench.run(5.millis());
    clock(&mut bench, 10, 1, MS);
    bench.run_out();
    assert_eq!(bench.c1(), 1_000);
}

/// Clock mode neither ends nor forbids a slew. The motor follows the clock from standstill only.
#[test]
fn a_slew_goes_on_into_clock_mode() {
    let follows = Settings { follows_clock: true, ..SLOW };
    let mut bench = Bench::new(SLOW);
    bench.does(Order::Slew(2_000));
    bench.run(1.secs());
    bench.set(follows);
    clock(&mut bench, 1_000, 1, MS);
    assert_eq!((bench.v(), bench.out.steps.len()), (2_000, 0));
    bench.does(Order::Slew(0));
    bench.run_out();
    let there = bench.c1();
    clock(&mut bench, 10, -1, MS);
    assert_eq!(bench.c1(), there - 10);
    bench.run_out();
    bench.does(Order::Slew(2_000));
    bench.run(1.secs());
    assert_eq!(bench.v(), 2_000);
}
