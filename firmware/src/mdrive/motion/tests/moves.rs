//! MA, MR, SL, PS, RS, Esc.

use super::*;

#[test]
fn a_move_of_75_turns_takes_what_the_manual_reckons() {
    // MC 7.3.5: 0.767 s of ramp, the cruise, 0.767 s, together 5.767 s. By its formula the ramp has 294,911
    // steps, but it subtracts 294,528 from the distance. So its cruise is 1 ms too long.
    let mut bench = Bench::new(FACTORY);
    bench.does(to(3_840_000));
    assert!(bench.is_moving() && bench.is_positioning() && bench.v() == 0);
    // "The time required to calculate the move is 2.5 mSec" (MC 5-45).
    bench.run(Duration::micros(2_500) - Duration::TICK);
    assert_eq!((bench.c1(), bench.v(), bench.is_changing()), (0, 0, false));
    bench.run(Duration::TICK);
    assert_eq!((bench.c1(), bench.v(), bench.is_changing()), (0, 1_000, true));
    let begin = bench.now;
    bench.run(767.millis() + Duration::TICK);
    assert_eq!((bench.c1(), bench.v(), bench.is_changing()), (294_911, 768_000, false));
    bench.run_out();
    let seconds = (bench.now.since(begin).ticks() as f64) / 16e6;
    let cruise = (3_840_000.0 - 2.0 * 294_911.5) / 768_000.0;
    assert!((seconds - (2.0 * 0.767 + cruise)).abs() < 1e-6, "{seconds}");
    assert!((seconds - 5.767).abs() <= 0.001_001, "{seconds}");
    assert_eq!((bench.c1(), bench.c2(), bench.v()), (3_840_000, 3_840_000 / 25, 0));
    assert!(!bench.is_moving() && !bench.is_positioning());
}

#[test]
fn moves_are_relative_to_here_or_to_zero() {
    // Examples of MC 3-7 and 3-8.
    let mut bench = Bench::new(FACTORY);
    for (order, position) in
        [(to(20_000), 20_000), (to(3_000), 3_000), (by(20_000), 23_000), (by(-30_000), -7_000)]
    {
        bench.does(order);
        bench.run_out();
        assert_eq!(bench.c1(), position);
    }
    bench.feed(|motion, at, _| motion.shaft_mut().set_steps(at, 100));
    assert_eq!((bench.c1(), bench.c2()), (100, -7_000 / 25));
    bench.does(to(0));
    bench.run_out();
    assert_eq!((bench.c1(), bench.c2()), (0, -7_100 / 25));
}

#[test]
fn a_position_that_is_set_while_a_move_is_calculated_does_not_change_its_way() {
    let mut bench = Bench::new(FACTORY);
    bench.does(by(1_000));
    bench.run(MS);
    bench.feed(|motion, at, _| motion.shaft_mut().set_steps(at, 50));
    bench.run_out();
    assert_eq!(bench.c1(), 1_050);
}

#[test]
fn a_move_keeps_the_speed_that_it_began_with() {
    let mut bench = Bench::new(SLOW);
    bench.does(to(10_000));
    bench.run(500.millis());
    bench.set(Settings { speed: 20_000, up: 1, down: 1, ..SLOW });
    bench.run(500.millis());
    assert_eq!(bench.v(), 5_000);
    bench.run_out();
    // 2.5 ms to calculate the move, 400 ms for the ramp up, (10,000 − 2,400)/5,000 s at full speed, 400 ms
    // for the ramp down.
    assert_eq!((bench.c1(), bench.now), (10_000, Instant::from(Duration::micros(2_322_500))));
}

#[test]
fn a_second_move_waits_for_the_end_of_the_first_and_for_mt() {
    let mut bench = Bench::new(Settings { settle_ms: 50, ..SLOW });
    bench.does(to(5_000));
    bench.run(100.millis());
    bench.does(by(77));
    // The second command replaces the one that waits.
    bench.does(by(-1_000));
    bench.run_to(Instant::from(Duration::micros(1_322_500)));
    assert_eq!((bench.c1(), bench.v(), bench.is_moving(), bench.is_positioning()), (5_000, 0, true, true));
    bench.run(50.millis() - Duration::TICK);
    assert_eq!((bench.c1(), bench.v()), (5_000, 0));
    bench.run(Duration::TICK);
    assert_eq!(bench.v(), -1_000);
    bench.run_out();
    assert_eq!(bench.c1(), 4_000);
}

#[test]
fn a_slew_waits_for_mt_of_the_move_before_it() {
    // MC 5-49: "the time between moves if consecutive motions are executed".
    let mut bench = Bench::new(Settings { settle_ms: 50, ..SLOW });
    bench.does(to(5_000));
    bench.run_to(Instant::from(Duration::micros(1_322_500)));
    assert_eq!((bench.c1(), bench.v(), bench.is_moving()), (5_000, 0, true));
    bench.does(Order::Slew(2_000));
    bench.run(50.millis() - Duration::TICK);
    assert_eq!((bench.c1(), bench.v(), bench.is_positioning()), (5_000, 0, true));
    bench.run(Duration::TICK);
    assert_eq!((bench.v(), bench.is_positioning()), (1_000, false));
    // SL 0 cancels the waiting slew.
    bench.does(Order::Slew(0));
    bench.run_out();
    bench.does(to(0));
    while bench.v() != 0 || bench.c1() != 0 {
        bench.run(1.millis());
    }
    bench.does(Order::Slew(2_000));
    bench.does(Order::Slew(0));
    bench.run_out();
    bench.run(1.secs());
    assert_eq!(bench.c1(), 0);
}

#[test]
fn a_waiting_move_is_calculated_for_its_whole_time() {
    let mut bench = Bench::new(SLOW);
    bench.does(to(1));
    bench.run(2.millis());
    bench.does(to(2));
    // The first move makes its step at 3.5 ms. The second move begins at 4.5 ms at the earliest.
    bench.run_to(Instant::from(Duration::micros(4_500)) - Duration::TICK);
    assert_eq!((bench.c1(), bench.v(), bench.is_moving()), (1, 0, true));
    bench.run(Duration::TICK);
    assert_eq!(bench.v(), 1_000);
}

#[test]
fn mt_belongs_to_the_move_and_then_comes_ht() {
    let mut bench = Bench::new(Settings { settle_ms: 50, ..SLOW });
    bench.does(to(100));
    bench.run_out();
    let end = bench.out.plan().end();
    assert_eq!(bench.now, end + 50.millis());
    assert_eq!(bench.out.currents.last(), Some(&(Instant::ZERO, AXIS, 750)));
    bench.run(500.millis());
    assert_eq!(bench.out.currents.last(), Some(&(end + 550.millis(), AXIS, 150)));
}

#[test]
fn a_slew_is_changed_on_the_fly_also_in_sign() {
    let mut bench = Bench::new(SLOW);
    bench.does(Order::Slew(20_000));
    assert_eq!(
        (bench.v(), bench.is_moving(), bench.is_positioning(), bench.is_changing()),
        (1_000, true, false, true)
    );
    // VM has no effect (MC 5-68): (20,000 − 1,000)/10,000 s at 10,500 steps/s on average.
    bench.run(1_900.millis() + Duration::TICK);
    assert_eq!((bench.v(), bench.c1(), bench.is_changing()), (20_000, 19_950, false));
    bench.does(Order::Slew(-3_000));
    // 1.9 s and 19,950 steps to standstill, then 0.2 s and 400 steps backward.
    bench.run(1_900.millis());
    assert_eq!((bench.v(), bench.c1()), (-1_000, 2 * 19_950));
    bench.run(200.millis());
    assert_eq!((bench.v(), bench.c1()), (-3_000, 2 * 19_950 - 400));
    bench.does(Order::Slew(-500));
    bench.run(250.millis());
    assert_eq!(bench.v(), -500);
    bench.does(Order::Slew(0));
    assert_eq!((bench.v(), bench.is_moving()), (0, true));
    bench.run(Duration::ZERO);
    assert!(!bench.is_moving());
}

#[test]
fn a_slew_takes_over_from_a_move_and_sl_0_ends_it() {
    let mut bench = Bench::new(SLOW);
    bench.does(to(50_000));
    bench.run(1.secs());
    bench.does(Order::Slew(2_000));
    assert_eq!((bench.v(), bench.is_moving(), bench.is_positioning()), (5_000, true, false));
    bench.run(1.secs());
    assert_eq!(bench.v(), 2_000);
    bench.does(Order::Slew(0));
    // "Motion has to come to a stop before issuing another motion command" (MC 5-68).
    bench.run(50.millis());
    assert_eq!(bench.order(to(0)), Err(Error::Homing));
    bench.run(50.millis());
    assert_eq!((bench.v(), bench.is_moving()), (0, false));
    bench.does(to(0));
    bench.run_out();
    assert_eq!(bench.c1(), 0);
}

#[test]
fn a_move_takes_over_from_a_slew_as_soon_as_that_stands() {
    let mut bench = Bench::new(Settings { settle_ms: 50, ..SLOW });
    bench.does(Order::Slew(5_000));
    bench.run(1.secs());
    bench.does(to(0));
    assert!(bench.is_positioning());
    bench.run(400.millis());
    // 3,000 steps at full speed and two ramps; MT is not waited for.
    assert_eq!((bench.c1(), bench.v()), (1_200 + 3_000 + 1_200, -1_000));
    bench.run_out();
    assert_eq!(bench.c1(), 0);
}

#[test]
fn sl_0_stops_a_move_that_is_calculated() {
    let mut bench = Bench::new(SLOW);
    bench.does(to(50));
    bench.does(Order::Slew(0));
    assert!(!bench.is_moving());
    bench.run(1.secs());
    assert_eq!(bench.c1(), 0);
}

#[test]
fn escape_stops_on_the_spot() {
    let mut bench = Bench::new(SLOW);
    bench.does(Order::Slew(5_000));
    bench.run(1.secs());
    bench.feed(|motion, at, out| motion.halt(at, out));
    assert_eq!((bench.c1(), bench.v(), bench.is_moving()), (4_200, 0, false));
}

#[test]
fn a_soft_stop_brakes_and_drops_what_waits() {
    let mut bench = Bench::new(SLOW);
    bench.does(to(50_000));
    bench.does(to(0));
    bench.run(Duration::micros(1_002_500));
    bench.feed(|motion, at, out| motion.stop(at, out));
    assert!(!bench.is_positioning());
    bench.run(400.millis());
    assert_eq!((bench.c1(), bench.is_moving()), (1_200 + 3_000 + 1_200, false));
    bench.run(1.secs());
    assert_eq!(bench.c1(), 5_400);
}

#[test]
fn a_paused_move_goes_on_to_its_target() {
    let mut bench = Bench::new(SLOW);
    bench.does(by(20_000));
    bench.run(1.secs());
    bench.feed(|motion, at, out| motion.pause(at, out));
    bench.run(1.secs());
    assert!(!bench.is_moving());
    let there = bench.c1();
    bench.does(by(-100));
    bench.run_out();
    assert_eq!(bench.c1(), there - 100);
    bench.feed(|motion, at, out| motion.resume(at, out));
    assert!(bench.is_moving());
    bench.run_out();
    assert_eq!(bench.c1(), 20_000);
}

#[test]
fn a_paused_slew_goes_on_also_before_it_stands() {
    let mut bench = Bench::new(SLOW);
    bench.does(Order::Slew(-3_000));
    bench.run(1.secs());
    for wait in [100.millis(), 1.secs()] {
        bench.feed(|motion, at, out| motion.pause(at, out));
        bench.run(wait);
        bench.feed(|motion, at, out| motion.resume(at, out));
        bench.run(1.secs());
        assert_eq!(bench.v(), -3_000);
    }
}

/// In one case the target is passed during the first ramp.
#[test]
fn a_paused_move_that_goes_on_keeps_the_speed_that_it_began_with() {
    for (distance, closed) in [(-3_000, false), (-10, false), (-1_000, true)] {
        let slow = if closed { Settings { start: 40, ..SLOW } } else { SLOW };
        let mut bench = Bench::new(Settings { closed, ..slow });
        bench.does(Order::By { distance, notify_on_end: false, continuous: true });
        bench.run(10.millis());
        bench.set(Settings { speed: 2_000, closed, ..slow });
        bench.run(2.secs());
        bench.feed(|motion, at, out| motion.pause(at, out));
        bench.run(2.secs());
        assert!(!bench.is_moving());
        bench.feed(|motion, at, out| motion.resume(at, out));
        bench.run(2.secs());
        assert_eq!(bench.v(), -5_000, "{distance}");
    }
}

#[test]
fn what_waits_behind_a_paused_move_waits_for_rs() {
    let mut bench = Bench::new(SLOW);
    bench.does(to(5_000));
    bench.does(to(0));
    bench.run(100.millis());
    bench.feed(|motion, at, out| motion.pause(at, out));
    bench.run(10.secs());
    assert!(!bench.is_moving() && !bench.is_positioning());
    bench.feed(|motion, at, out| motion.resume(at, out));
    let mut most = 0;
    while bench.is_moving() {
        bench.run(MS);
        most = most.max(bench.c1());
    }
    assert_eq!((most, bench.c1()), (5_000, 0));
}

#[test]
fn a_move_may_send_a_name_at_its_end() {
    let mut bench = Bench::new(Settings { settle_ms: 20, ..SLOW });
    bench.does(Order::To { position: 100, notify_on_end: true, continuous: false });
    bench.run_out();
    assert_eq!(bench.events, [(bench.now, Event::Announce)]);
    bench.does(Order::To { position: 50_000, notify_on_end: true, continuous: false });
    bench.run(1.secs());
    bench.does(Order::Slew(0));
    bench.run_out();
    assert_eq!(bench.events.len(), 1, "it was not completed");
}

#[test]
fn a_move_may_go_on_behind_its_position() {
    let mut bench = Bench::new(SLOW);
    bench.does(Order::By { distance: -2_200, notify_on_end: true, continuous: true });
    // 2.5 ms, 1,200 steps of ramp in 400 ms, 1,000 in 200 ms.
    bench.run(Duration::micros(602_500) - Duration::TICK * 2);
    assert_eq!((bench.c1(), bench.is_positioning()), (-2_199, true));
    bench.run(Duration::TICK * 4);
    assert_eq!((bench.c1(), bench.is_moving(), bench.is_positioning()), (-2_200, true, false));
    assert_eq!(bench.events.len(), 1);
    bench.run(1.secs());
    assert_eq!((bench.v(), bench.is_changing()), (-5_000, false));
    bench.does(Order::Slew(0));
    bench.run_out();
}

#[test]
fn five_million_steps_a_second() {
    let settings = Settings { start: 4_000_000, speed: 5_000_000, up: 1_525_878_997, down: 91, ..FACTORY };
    let mut bench = Bench::new(settings);
    bench.does(Order::Slew(5_000_000));
    bench.run(400.secs());
    // The ramp takes 0.66 ms, and (10⁶)²/(2·a) = 327.7 steps less than at full speed. Positions wrap.
    let steps = 5_000_000.0 * 400.0 - 1e12 / (2.0 * 1_525_878_997.0);
    assert_eq!((bench.v(), bench.c1()), (5_000_000, steps as i32));
    bench.run(100.secs());
    assert_eq!(bench.c1(), (steps as i64 + 500_000_000) as i32);
    bench.feed(|motion, at, out| motion.halt(at, out));
    // D is 91 steps/s²: a ramp from this speed would take more than half a day.
    assert!(!bench.is_moving());
}

#[test]
fn when_a_position_is_reached_is_known() {
    let mut bench = Bench::new(SLOW);
    bench.feed(|motion, at, _| motion.shaft_mut().set_steps(at, -500));
    assert!(bench.motion.shaft_mut().has_changed() && !bench.motion.shaft_mut().has_changed());
    assert_eq!(bench.motion.shaft().reaches(bench.now, 1_700), Instant::NEVER);
    bench.does(Order::Slew(5_000));
    assert!(bench.motion.shaft_mut().has_changed());
    // 1,200 steps of ramp in 400 ms, 1,000 in 200 ms.
    let due = bench.motion.shaft().reaches(bench.now, 1_700);
    assert_eq!(due, Instant::from(600.millis()));
    bench.run_to(due - Duration::TICK);
    assert_eq!(bench.c1(), 1_699);
    bench.run(Duration::TICK);
    assert_eq!((bench.c1(), bench.motion.shaft_mut().has_changed()), (1_700, false));
}

#[test]
fn the_manuals_change_of_velocity_ends_where_it_expects() {
    // MC 8.2. A line takes 210 µs. The motion changes two lines after each trip: label and SL 202400, label
    // and SL 0.
    const LINE: Duration = Duration::micros(210);
    let settings = Settings { start: 20_000, speed: 500_000, up: 500_000, down: 800_000_000, ..FACTORY };
    let mut bench = Bench::new(settings);
    bench.does(Order::Slew(101_200));
    bench.run_to(bench.motion.shaft().reaches(bench.now, 51_200));
    bench.run(LINE * 2);
    bench.does(Order::Slew(202_400));
    bench.run_to(bench.motion.shaft().reaches(bench.now, 102_290));
    assert_eq!(bench.v(), 202_400);
    bench.run(LINE * 2);
    bench.does(Order::Slew(0));
    bench.run_out();
    // 85.008 steps in 420 µs, and (202,400² − 20,000²)/(2·D) = 25.35 steps of ramp.
    assert_eq!(bench.c1(), 102_400);
}

#[test]
fn a_waiting_move_takes_over_from_one_that_goes_on() {
    let mut bench = Bench::new(SLOW);
    bench.does(Order::To { position: 2_200, notify_on_end: false, continuous: true });
    bench.run(100.millis());
    bench.does(to(0));
    bench.run_out();
    assert_eq!(bench.c1(), 0);
}

#[test]
fn rs_takes_over_from_what_was_ordered_while_it_paused() {
    let mut bench = Bench::new(SLOW);
    bench.does(to(20_000));
    bench.run(1.secs());
    bench.feed(|motion, at, out| motion.pause(at, out));
    bench.run_out();
    bench.does(Order::Slew(-500));
    bench.run(1.secs());
    bench.feed(|motion, at, out| motion.resume(at, out));
    bench.run_out();
    assert_eq!(bench.c1(), 20_000);
}
