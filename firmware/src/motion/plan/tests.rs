#![expect(clippy::float_arithmetic, reason = "mathematics that is not the code's")]

use super::*;
use crate::motion::StepIterator;
use drivetwin_protocol::time::Span;
use proptest::prelude::*;
use std::vec::Vec;

const FACTORY: Limits = Limits::even(U24F8::const_from_int(5_000), 10_000);

fn at(ticks: u64) -> Instant {
    Instant::from_ticks(ticks)
}

#[test]
fn the_factory_move_of_an_md3_takes_two_and_a_half_seconds() {
    let plan = Plan::profile(at(0), 0, 10_000, FACTORY);
    assert_eq!(plan.end(), Instant::from(2_500.millis()));
    assert_eq!(plan.position_at(Instant::from(500.millis())), 1_250);
    assert_eq!(plan.position_at(Instant::from(2_000.millis())), 8_750);
    assert_eq!(plan.position_at(at(2_500 * 16_000 - 1)), 9_999);
    assert_eq!(plan.position_at(Instant::from(2_500.millis())), 10_000);
    assert_eq!(plan.position_at(Instant::NEVER), 10_000);
    assert_eq!(plan.speed_at(Instant::from(250.millis())), I48F16::from_num(2_500));
    assert_eq!(plan.speed_at(Instant::from(1_000.millis())), I48F16::from_num(5_000));
    assert_eq!(plan.speed_at(Instant::from(3_000.millis())), 0);
}

#[test]
fn a_short_move_is_a_triangle() {
    let plan = Plan::profile(at(0), 7, -101, FACTORY);
    assert_eq!(plan.segments().len(), 2);
    assert_eq!(plan.position_at(plan.end()), 7 - 101);
    // 2·sqrt(101 / 10,000) s
    assert_eq!(plan.end().ticks(), 3_215_960);
}

#[test]
fn nothing_to_do_is_done_at_once() {
    for plan in [
        Plan::profile(at(5), 3, 0, FACTORY),
        Plan::profile(at(5), 3, 9, Limits { max_speed: U24F8::ZERO, ..FACTORY }),
        Plan::profile(at(5), 3, 9, Limits { acceleration: 0, ..FACTORY }),
    ] {
        assert_eq!((plan.end(), plan.position_at(at(9))), (at(5), 3));
    }
}

#[test]
fn a_plan_that_is_over_has_no_rest() {
    let plan = Plan::profile(at(0), 0, 100, FACTORY);
    for rest in [plan.continued_from(plan.end(), 7), plan.continued_from(Instant::NEVER, 7)] {
        assert_eq!((rest.position_at(Instant::NEVER), rest.end()), (7, rest.start()));
    }
}

#[test]
fn a_speed_beyond_the_limit_acts_as_the_limit() {
    let limit = Limits { max_speed: U24F8::from_num(MAX_SPEED), ..FACTORY };
    let beyond = Limits { max_speed: U24F8::MAX, ..FACTORY };
    let plan = Plan::profile(at(0), 0, i32::MAX, beyond);
    assert_eq!(plan, Plan::profile(at(0), 0, i32::MAX, limit));
    let jog = plan.ramp_to(at(0), I24F8::MAX, u32::MAX);
    assert_eq!(jog, plan.ramp_to(at(0), I24F8::from_num(MAX_SPEED), MAX_ACCELERATION));
}

#[test]
fn a_jog_goes_on_until_it_is_told_to_stop() {
    let jog = Plan::at_rest(at(0), 0).ramp_to(at(0), I24F8::from_num(5_000), 10_000);
    assert_eq!(jog.end(), Instant::NEVER);
    assert_eq!(jog.position_at(Instant::from(1_500.millis())), 1_250 + 5_000);
    let stop = jog.ramp_to(Instant::from(1_500.millis()), I24F8::ZERO, 10_000);
    assert_eq!(stop.end(), Instant::from(2_000.millis()));
    assert_eq!(stop.position_at(Instant::NEVER), 1_250 + 5_000 + 1_250);
}

const SLEW: Limits = Limits {
    start_speed: U24F8::const_from_int(1_000),
    max_speed: U24F8::ZERO,
    acceleration: 10_000,
    deceleration: 5_000,
};

#[test]
fn a_slew_begins_and_ends_at_its_start_speed() {
    let slew = Plan::at_rest(at(0), 0).slew(at(0), I24F8::from_num(5_000), SLEW);
    assert_eq!(slew.speed_at(at(0)), 1_000);
    // 400 ms at 3,000 steps/s on average, then 100 ms at 5,000.
    assert_eq!(slew.position_at(Instant::from(400.millis())), 1_200);
    assert_eq!(slew.position_at(Instant::from(500.millis())), 1_700);
    let stop = slew.slew(Instant::from(500.millis()), I24F8::ZERO, SLEW);
    // 800 ms at 3,000 steps/s on average.
    assert_eq!(stop.end(), Instant::from(1_300.millis()));
    assert_eq!(stop.speed_at(stop.end() - Duration::TICK).round(), 1_000);
    assert_eq!((stop.speed_at(stop.end()), stop.position_at(stop.end())), (I48F16::ZERO, 4_100));
}

#[test]
fn a_slew_below_the_start_speed_has_no_ramp() {
    let slow = Plan::at_rest(at(0), 7).slew(at(0), I24F8::from_num(-500), SLEW);
    assert_eq!(slow.speed_at(at(0)), -500);
    assert_eq!(slow.position_at(Instant::from(2.secs())), 7 - 1_000);
    let stop = slow.slew(Instant::from(2.secs()), I24F8::ZERO, SLEW);
    assert_eq!((stop.end(), stop.position_at(Instant::NEVER)), (Instant::from(2.secs()), 7 - 1_000));
}

#[test]
fn a_slew_turns_round_at_its_start_speed() {
    let slew = Plan::at_rest(at(0), 0).slew(at(0), I24F8::from_num(5_000), SLEW);
    let back = slew.slew(Instant::from(500.millis()), I24F8::from_num(-3_000), SLEW);
    let turn = Instant::from(1_300.millis());
    assert_eq!((back.position_at(turn), back.speed_at(turn)), (4_100, I48F16::from_num(-1_000)));
    // 200 ms at 2,000 steps/s on average, then at 3,000 steps/s.
    assert_eq!(back.position_at(Instant::from(1_500.millis())), 3_700);
    assert_eq!(back.position_at(Instant::from(2_500.millis())), 700);
    let slower = back.slew(Instant::from(2_500.millis()), I24F8::from_num(-2_000), SLEW);
    // 200 ms at 2,500 steps/s on average.
    assert_eq!(slower.position_at(Instant::from(2_700.millis())), 200);
    assert_eq!(slower.speed_at(Instant::from(2_700.millis())), -2_000);
}

#[test]
fn without_a_start_speed_a_slew_stops_as_a_ramp() {
    let jog = Plan::at_rest(at(0), 0).ramp_to(at(0), I24F8::from_num(4_321), 7_000);
    let rates = Limits { start_speed: U24F8::ZERO, acceleration: 1, deceleration: 9_999, ..SLEW };
    for ticks in (3_000_000..30_000_000).step_by(777_777) {
        assert_eq!(jog.slew(at(ticks), I24F8::ZERO, rates), jog.ramp_to(at(ticks), I24F8::ZERO, 9_999));
    }
}

#[test]
fn the_last_step_of_a_stop_is_one_that_falls_on_its_end() {
    let at_once = Limits { start_speed: U24F8::MAX, ..SLEW };
    let cruise = Plan::at_rest(at(0), 0).slew(at(0), I24F8::from_num(4_000), at_once);
    // (4000² − 1000²)/(2·7500) = 1000 steps in 400 ms.
    let stop = cruise.slew(Instant::from(250.millis()), I24F8::ZERO, Limits { deceleration: 7_500, ..SLEW });
    assert_eq!(stop.end(), Instant::from(650.millis()));
    assert_eq!(stop.position_at(stop.end() - Duration::TICK), 1_999);
    assert_eq!(stop.position_at(stop.end()), 2_000);
}

#[test]
fn a_position_is_reached_once_around_or_never() {
    let slew = Plan::at_rest(at(0), 0).slew(
        at(0),
        I24F8::from_num(8_000_000),
        Limits { start_speed: U24F8::MAX, ..SLEW },
    );
    // One step every two ticks.
    assert_eq!(slew.time_of(at(0), 100), at(200));
    assert_eq!(slew.time_of(at(200), 100), at(200 + (2 << 32)));
    assert_eq!(slew.time_of(at(200), 99), at(200 + (2 << 32) - 2));
    assert_eq!(slew.time_of(at(0), -1), at((2 << 32) - 2));
    let stop = slew.halt(at(200));
    assert_eq!((stop.time_of(at(200), 100), stop.time_of(at(0), 101)), (Instant::NEVER, Instant::NEVER));
    let profile = Plan::profile(at(5), 0, 10, FACTORY);
    assert_eq!(profile.time_of(at(0), 10), profile.end());
    assert_eq!(profile.time_of(profile.end(), 10), Instant::NEVER);
    assert_eq!(profile.time_of(at(0), 11), Instant::NEVER);
}

#[test]
fn a_reversal_goes_by_way_of_standstill() {
    let jog = Plan::at_rest(at(0), 0).ramp_to(at(0), I24F8::from_num(5_000), 10_000);
    let back = jog.ramp_to(Instant::from(1_000.millis()), I24F8::from_num(-5_000), 10_000);
    // 1250 + 2500 steps forward, 1250 steps more to stop, then back: 1250 steps in the ramp, 5000 steps per
    // second.
    assert_eq!(back.position_at(Instant::from(1_500.millis())), 5_000);
    assert_eq!(back.speed_at(Instant::from(1_500.millis())), 0);
    assert_eq!(back.position_at(Instant::from(2_000.millis())), 3_750);
    assert_eq!(back.position_at(Instant::from(3_000.millis())), -1_250);
    assert_eq!(back.speed_at(Instant::from(3_000.millis())), -5_000);
}

/// The tick nearest to sqrt(n·S/a), computed without the plan's arithmetic.
fn nearest_root(n: u128, a: u128) -> u64 {
    let square = 2 * 16_000_000_u128.pow(2) * n;
    let (mut low, mut high) = (0_u128, 1_u128 << 50);
    while low < high {
        let middle = (low + high) / 2;
        // middle + 1/2 >= root  <=>  (2·middle + 1)² · a >= 4 · square
        if (2 * middle + 1).pow(2) * a >= 4 * square { high = middle } else { low = middle + 1 }
    }
    low as u64
}

#[test]
fn a_plan_cannot_have_just_any_segments() {
    let possible = Segment { ticks: 16_000_000, acceleration: 10_000, ..Segment::default() };
    assert!(Plan::of_segments(at(7), &[possible]).is_some());
    for wrong in [
        Segment { ticks: u64::MAX, ..possible },
        Segment { start_speed: i64::MAX, ..possible },
        Segment { start_speed: i64::MIN, ..possible },
        Segment { phase_offset: STEP, ..possible },
        Segment { phase_offset: -1, ..possible },
    ] {
        assert_eq!(Plan::of_segments(at(7), &[wrong]), None, "{wrong:?}");
    }
    assert_eq!(Plan::of_segments(at(7), &[]), None);
    assert_eq!(Plan::of_segments(at(7), &[possible; 4]), None);
}

proptest! {
    #[test]
    fn every_step_of_a_ramp_is_at_the_nearest_tick(a in 16_u32..2_000_000, n in 1_u32..5_000) {
        let plan = Plan::at_rest(at(0), 0).ramp_to(at(0), I24F8::MAX, a);
        let due = nearest_root(u128::from(n), u128::from(a));
        prop_assert_eq!(plan.position_at(at(due)), n.cast_signed());
        prop_assert_eq!(plan.position_at(at(due - 1)), n.cast_signed() - 1);
    }

    #[test]
    fn a_profile_makes_its_steps_and_no_others(
        steps in any::<i32>(), start in 0_u32..2_000_000, speed in 1_u32..5_000_000,
        up in 1_u32.., down in 1_u32..,
        samples in proptest::collection::vec(any::<u64>(), 2..40),
    ) {
        let start = U24F8::from_num(start.saturating_sub(1_000_000));
        let rates = Limits { start_speed: start, max_speed: U24F8::from_num(speed), acceleration: up, deceleration: down };
        let plan = Plan::profile(at(0), 0, steps, rates);
        let mirror = Plan::profile(at(0), 0, steps, Limits { acceleration: down, deceleration: up, ..rates });
        let end = plan.end().ticks();
        prop_assert_eq!(Plan::of_segments(plan.start(), plan.segments()), Some(plan));
        let turned = plan.ramp_to(at(samples[0] % (end + 1)), I24F8::from_num(-4_000), up);
        prop_assert_eq!(Plan::of_segments(turned.start(), turned.segments()), Some(turned));
        prop_assert_eq!(plan.position_at(plan.end()), steps);
        let mut instants: Vec<u64> = samples.iter().map(|n| n % (end + 1)).collect();
        // Transitions between segments, where rounding could show.
        let mut seam = 0;
        for segment in plan.segments() {
            seam += segment.ticks;
            instants.extend([seam.saturating_sub(1), seam, seam + 1]);
        }
        instants.sort_unstable();
        let positions: Vec<i64> =
            instants.iter().map(|&t| i64::from(plan.position_at(at(t))) * i64::from(steps.signum())).collect();
        prop_assert!(positions.is_sorted(), "{:?} at {:?}", positions, instants);
        // In the mirrored plan as many steps are left before the end as the plan has made after the start, to
        // half a tick each.
        prop_assert_eq!(mirror.end(), plan.end());
        for t in instants {
            let passed = i64::from(plan.position_at(at(t)).unsigned_abs());
            let left = i64::from(steps.unsigned_abs())
                - i64::from(mirror.position_at(at(end.saturating_sub(t))).unsigned_abs());
            let tolerance = 1 + i64::from(speed) / 8_000_000;
            prop_assert!((passed - left).abs() <= tolerance, "{} {}", passed, left);
        }
    }

    #[test]
    fn a_new_plan_goes_on_where_the_old_one_is(
        turns in proptest::collection::vec((0_u64..40_000_000, -40_000_i32..40_000), 1..8),
        acceleration in 1_u32..,
    ) {
        let mut plan = Plan::at_rest(at(0), 0);
        let mut now = 0;
        for (wait, speed) in turns {
            now += wait;
            let next = plan.ramp_to(at(now), I24F8::from_num(speed), acceleration);
            prop_assert_eq!(next.position_at(at(now)), plan.position_at(at(now)));
            prop_assert_eq!(next.speed_at(at(now)), plan.speed_at(at(now)));
            // At 40,000 steps/s there are never two steps in two ticks.
            let mut seam = now;
            for segment in next.segments() {
                seam = seam.saturating_add(segment.ticks);
                let jump = next.position_at(at(seam)) - next.position_at(at(seam - 1));
                prop_assert!(jump.abs() <= 1);
            }
            plan = next;
        }
    }

    #[test]
    fn a_slew_goes_on_where_it_is_and_never_creeps(
        turns in proptest::collection::vec((0_u64..40_000_000, -40_000_i32..40_000), 1..8),
        start in 1_u32..30_000, up in 1_u32.., down in 1_u32..,
    ) {
        let rates = Limits { start_speed: U24F8::from_num(start), acceleration: up, deceleration: down, ..SLEW };
        let mut plan = Plan::at_rest(at(0), 0);
        let mut now = 0;
        for (wait, speed) in turns {
            now += wait;
            let next = plan.slew(at(now), I24F8::from_num(speed), rates);
            prop_assert_eq!(next.position_at(at(now)), plan.position_at(at(now)));
            let first_true = I48F16::from_num(speed.unsigned_abs().min(start));
            let mut seam = now;
            for segment in next.segments().iter().filter(|segment| segment.ticks > 0) {
                // Within a ramp no speed is below the start speed, unless it was below it before.
                let slowest = next.speed_at(at(seam)).abs().min(next.speed_at(at(seam + segment.ticks.min(1 << 40) - 1)).abs());
                prop_assert!(slowest + I48F16::DELTA >= first_true.min(plan.speed_at(at(now)).abs()) || speed == 0);
                seam = seam.saturating_add(segment.ticks);
                let jump = next.position_at(at(seam)) - next.position_at(at(seam - 1));
                prop_assert!(jump.abs() <= 1);
            }
            plan = next;
        }
    }

    /// Compares a stop on a step with a distance computed by hand: v·t until the ramp, (v² − v0²)/2a in the
    /// ramp, and the end on a whole step.
    #[test]
    fn a_stop_on_a_step_ends_on_one_and_no_later_than_it_must(
        speed in 1_u32..2_000_000, share in 0_u32..1_000, up in 91_u32..2_000_000_000, down in 91_u32..2_000_000_000,
        when in 0_u64..40_000_000, again in 0_u64..1_000, back: bool, finishes: bool,
    ) {
        let start = (u64::from(speed) * u64::from(share) / 1_000).max(1) as u32;
        let rates = Limits { start_speed: U24F8::from_num(start), acceleration: up, deceleration: down, ..SLEW };
        let to = I24F8::from_num(speed);
        let slew = Plan::at_rest(at(0), -5).slew(at(0), if back { -to } else { to }, rates);
        let now = at(when);
        let stop = if finishes { slew.finish_step(now) } else { slew.stop_on_step(now, rates) };
        prop_assert_eq!(stop.start(), now);
        let mut seam = when;
        let mut position = slew.position_at(now);
        prop_assert_eq!(stop.position_at(now), position);
        for segment in stop.segments().iter().filter(|segment| segment.ticks > 0) {
            seam += segment.ticks;
            for ticks in [seam.saturating_sub(1), seam].into_iter().filter(|ticks| *ticks >= when) {
                let next = stop.position_at(at(ticks));
                prop_assert!(if back { next <= position } else { next >= position }, "no step is taken back");
                position = next;
            }
        }

        let (segment, d) = slew.segment_at(now);
        let speed = segment.speed(d) as f64 / 16e6;
        let beyond = ((segment.phase(d) % i128::from(STEP)) as f64 / STEP as f64).min(1.0);
        let ramp = (speed * speed - f64::from(start).powi(2)).max(0.0) / (2.0 * f64::from(down));
        let first_true = if finishes { 0.0 } else { ramp.max(0.5) };
        let from = i64::from(segment.base) + (segment.phase(d) / i128::from(STEP)) as i64 * if back { -1 } else { 1 };
        let end = i64::from(stop.position_at(stop.end()));
        let way = (end - from).abs() as f64 - beyond;
        let rounding = 1e-6 * (1.0 + ramp);
        prop_assert!((first_true - rounding..=first_true + 1.0 + rounding).contains(&way), "{} steps, not {}", way, first_true);

        // The motion continues at the slew's speed until the ramp, and is never faster.
        let seconds = stop.end().since(now).ticks() as f64 / 16e6;
        let takes = if finishes { way / speed } else {
            (way - ramp) / speed + (speed - f64::from(start)).max(0.0) / f64::from(down)
        };
        prop_assert!((seconds - takes).abs() < 1e-7 + 1e-6 * takes, "{} s, not {}", seconds, takes);
        // A shaft that follows the plan stays at its end, because the phase there is a whole step.
        let (last, d) = (stop.segments().last().unwrap(), stop.segments().last().unwrap().ticks);
        prop_assert_eq!((last.phase(d)) % i128::from(STEP), 0);
        // In its ramp the motion can be stopped again, with the same end.
        let [cruise, ramp] = stop.segments() else { panic!("{stop:?}") };
        let later = cruise.ticks + again;
        if !finishes && again < ramp.ticks / 2 && first_true > 8.0 {
            let twice = stop.stop_on_step(at(when + later), rates);
            prop_assert_eq!(twice.position_at(Instant::NEVER), stop.position_at(Instant::NEVER));
        }
    }

    #[test]
    fn a_position_is_reached_with_the_walkers_step(
        steps in -3_000..3_000_i32, speed in 1_u32..1_000_000_000, start in 0_u32..1_000_000,
        up in 0_u32..31, down in 0_u32..31, passed in any::<u64>(),
        slew in proptest::option::of(any::<i32>()),
    ) {
        let (start, speed) = (U24F8::from_bits(start), U24F8::from_bits(speed));
        let rates = Limits { start_speed: start, max_speed: speed, acceleration: 1 << up, deceleration: 1 << down };
        let mut plan = Plan::profile(at(100), 3, steps, rates);
        let length = (plan.end().ticks() - 100).min(1 << 41);
        if let Some(speed) = slew {
            plan = plan.slew(at(100 + passed % (length + 1)), I24F8::from_bits(speed >> (passed % 20)), rates);
        }
        let after = plan.start() + Duration::from_ticks((passed / 3) % (length + 1));
        let mut position = plan.position_at(after);
        let mut seen = std::collections::BTreeSet::new();
        for step in StepIterator::new(&plan, after).take(500) {
            position += if step.forward { 1 } else { -1 };
            if seen.insert(position) {
                prop_assert_eq!(plan.time_of(after, position), step.at, "{}", position);
            }
        }
    }

    #[test]
    fn the_rest_of_a_plan_is_the_plan_elsewhere(
        steps in -1_000..1_000_i32, bits in proptest::array::uniform4(0_u32..31), fine in any::<u32>(),
        order in proptest::option::of((any::<u64>(), any::<i32>())),
        seam in 0..4_usize, beside in -2..3_i64, inside in any::<u64>(), position in any::<i32>(),
    ) {
        let [start, speed, up, down] = bits.map(|bits| (1 << bits) | (fine & ((1 << bits) - 1)));
        let rates = Limits { start_speed: U24F8::from_bits(start), max_speed: U24F8::from_bits(speed), acceleration: up, deceleration: down };
        let mut plan = Plan::profile(at(100), 3, steps, rates);
        if let Some((when, speed)) = order {
            let when = at(100 + when % (plan.end().ticks() - 99));
            plan = plan.ramp_to(when, I24F8::from_bits(speed), up);
        }
        // Half of the cases are close to a transition between segments.
        let seam = plan.segments().iter().take(seam).map(|segment| segment.ticks.min(1 << 40)).sum::<u64>();
        let length = (plan.end().ticks() - plan.start().ticks()).min(1 << 41);
        let passed = if inside % 2 == 0 { seam } else { (inside / 2) % (length + 2) };
        let now = at(plan.start().ticks() + passed.saturating_add_signed(beside));

        let rest = plan.continued_from(now, position);
        let lost = position.wrapping_sub(plan.position_at(now));
        prop_assert_eq!(rest.start(), now);
        prop_assert_eq!(rest.end(), plan.end().max(now));
        let seams = plan.segments().iter().scan(plan.start(), |at, segment| {
            *at += Duration::from_ticks(segment.ticks);
            Some(*at)
        });
        let steps = StepIterator::new(&plan, now).take(50).map(|step| step.at);
        let near = |instant: Instant| [instant - Duration::TICK, instant, instant + Duration::TICK];
        for t in seams.chain(steps).chain([now]).flat_map(near).filter(|t| *t >= now) {
            prop_assert_eq!(rest.position_at(t), plan.position_at(t).wrapping_add(lost), "at {:?}", t);
            prop_assert_eq!(rest.speed_at(t), plan.speed_at(t), "at {:?}", t);
        }
        prop_assert!(StepIterator::new(&rest, now).take(50).eq(StepIterator::new(&plan, now).take(50)));
    }
}
