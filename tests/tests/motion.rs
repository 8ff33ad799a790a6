//! Steps compared with the exact instants of constant acceleration, the step iterator compared with the plan,
//! and our algorithm compared with others.
#![allow(missing_docs, reason = "a test")]

use drivetwin_firmware::device::{Duration, Instant, Plan};
use drivetwin_firmware::motion::{Limits, Step, StepIterator};
use drivetwin_protocol::time::TICKS_PER_SECOND;
use drivetwin_tests::exact::{Jog, Move, STEP, TICK, h};
use drivetwin_tests::ramps;
use fixed::types::{I24F8, U24F8};

fn at(ticks: u64) -> Instant {
    Instant::from_ticks(ticks)
}

/// Pseudo-random numbers that are the same in every run.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    fn below(&mut self, bound: u64) -> u64 {
        self.next() % bound
    }

    fn below_one_of(&mut self, bounds: [u64; 4]) -> u32 {
        let bound = bounds[self.below(4) as usize];
        self.below(bound) as u32
    }

    /// A number whose number of bits is random.
    fn any_size(&mut self, bits: u64) -> u32 {
        let bits = 1 + self.below(bits);
        1 + self.below(1 << bits) as u32
    }
}

/// An instant in the unit of the exact model.
fn exactly(instant: Instant) -> i128 {
    i128::from(instant.ticks()) * TICK
}

/// Largest allowed error of step `n`. A step is made at the nearest tick. That allows half a tick, and a
/// little for rounding in the exact model and for the acceleration during half a tick. In the ramp down
/// another half tick is allowed, because the end of the move is at the nearest tick, too.
fn tolerance(exact: &Move, n: u32) -> i128 {
    let ramp_down = n > exact.seams()[1];
    TICK / 2 + TICK / 256 + if ramp_down { TICK / 2 } else { 0 }
}

#[test]
fn twenty_thousand_moves_make_each_step_as_near_as_promised() {
    let mut random = Random(88_172_645_463_325_252);
    let mut worst = 0;
    for _ in 0..20_000 {
        let steps = 1 + random.below_one_of([10, 300, 5_000, 10_000]);
        let speed = 256 * (1 + random.below_one_of([100, 5_000, 40_000, 300_000])) - random.below(256) as u32;
        let up = random.any_size(24);
        let down = if random.below(2) == 0 { up } else { random.any_size(24) };
        let start = if random.below(2) == 0 { 0 } else { random.below(u64::from(speed) + 100) as u32 };
        let rates = Limits {
            start_speed: U24F8::from_bits(start),
            max_speed: U24F8::from_bits(speed),
            acceleration: up,
            deceleration: down,
        };
        let back = random.below(2) == 0;
        let begin = random.below(1 << 40);
        let signed = if back { -steps.cast_signed() } else { steps.cast_signed() };
        let plan = Plan::profile(at(begin), 5, signed, rates);
        let exact = Move::of(steps, rates);
        let error = (exactly(plan.end()) - exact.end() - exactly(at(begin))).abs();
        assert!(error <= TICK / 2 + 64, "{rates:?} {steps}: it ends {error} off");

        let every = 1 + steps / 32;
        let mut made = 0;
        for step in StepIterator::new(&plan, at(begin)) {
            made += 1;
            assert_eq!(step.forward, !back);
            if made <= 8 || made + 8 > steps || made % every == 0 {
                let error = (exactly(step.at) - exact.step(made) - exactly(at(begin))).abs();
                worst = worst.max(error);
                let most = tolerance(&exact, made);
                assert!(error <= most, "step {made} of {steps} is {error} off: {rates:?}");
            }
        }
        assert_eq!(made, steps, "{rates:?}");
    }
    assert!(
        worst > TICK / 2,
        "the worst step of twenty thousand moves is {worst} off: nothing was looked at"
    );
    println!("worst {:.4} ticks", worst as f64 / TICK as f64);
}

#[test]
fn moves_of_any_length_make_each_step_as_near_as_promised() {
    let mut random = Random(7);
    for _ in 0..2_000 {
        let steps = random.any_size(31).min(i32::MAX as u32);
        let speed = 256 + random.any_size(30);
        // Accelerations for which way·a·b/(a + b) fits into the model's 128 bits.
        let [up, down] = [random.any_size(16), random.any_size(16)];
        let rates = Limits {
            start_speed: U24F8::ZERO,
            max_speed: U24F8::from_bits(speed),
            acceleration: up,
            deceleration: down,
        };
        let plan = Plan::profile(at(0), 0, steps.cast_signed(), rates);
        let exact = Move::of(steps, rates);
        let [first, second] = exact.seams();
        for n in [1, first, second, steps].into_iter().chain((0..4).map(|_| random.next() as u32 % steps)) {
            let n = n.clamp(1, steps).saturating_sub(4);
            // An instant halfway between step n and step n + 1.
            let after = if n == 0 { 0 } else { (exact.step(n) + exact.step(n + 1)) / 2 / TICK };
            let after = at(after as u64);
            assert_eq!(plan.position_at(after), n.cast_signed(), "{rates:?}");
            let mut made = n;
            for step in StepIterator::new(&plan, after).take(8) {
                made += 1;
                let error = (exactly(step.at) - exact.step(made)).abs();
                let most = tolerance(&exact, made);
                assert!(error <= most, "step {made} of {steps} is {error} off: {rates:?}");
            }
            assert_eq!(made, steps.min(n + 8));
        }
    }
}

/// Integer test that `ticks` is the tick nearest to √(n·STEP/a). Halfway between two ticks the earlier one is
/// taken. Halfway is where phase + speed reaches the step: a·t² + a·t = n·STEP.
fn is_nearest_root(ticks: u64, n: u32, a: u32) -> bool {
    let (t, a, way) = (u128::from(ticks), u128::from(a), u128::from(n) * STEP);
    a * t * (t - 1) <= way && way < a * t * (t + 1)
}

#[test]
fn a_ramp_from_standstill_and_its_mirror_are_at_the_nearest_tick() {
    let mut random = Random(11);
    for round in 0..400 {
        let a = if round < 16 { 1 << (2 * round) } else { random.any_size(31).min(i32::MAX as u32) };
        // A triangle: the move reaches no cruise, whatever the acceleration.
        let plan = Plan::profile(at(0), 0, 4_000, Limits::even(U24F8::MAX, a));
        let [up, stop] = plan.segments() else { panic!("no triangle: {plan:?}") };
        assert_eq!((up.acceleration.unsigned_abs(), stop.acceleration.unsigned_abs()), (a, a));
        let steps: Vec<u64> = StepIterator::new(&plan, at(0)).map(|step| step.at.ticks()).collect();
        assert_eq!(steps.len(), 4_000);
        for (n, &ticks) in (1..=1_999).zip(&steps) {
            assert!(is_nearest_root(ticks, n, a), "step {n} at {ticks}, {a} steps/s²");
        }
        let end = plan.end().ticks();
        assert_eq!(steps[3_999], end);
        for (left, &ticks) in (1..=1_999).zip(steps.iter().rev().skip(1)) {
            // Seen from the end, halfway between two ticks the later one is taken.
            assert!(is_nearest_root(end - ticks, left, a), "{left} before the end, {a} steps/s²");
        }
    }
}

/// A command to a jog, and the number of ticks until the next command.
struct Order {
    ticks: u64,
    speed: I24F8,
    acceleration: u32,
}

fn orders(random: &mut Random) -> Vec<Order> {
    let most = 1 << random.below(12);
    let acceleration = random.any_size(20) + 10;
    (0..2 + random.below(7))
        .map(|_| {
            let speed = random.below(most * 10_240) as i32;
            let speed = [speed, speed, -speed, 0][random.below(4) as usize];
            let longest = [100_000, 1_000_000, 10_000_000][random.below(3) as usize];
            let acceleration = if random.below(3) == 0 { random.any_size(20) + 10 } else { acceleration };
            Order { ticks: random.below(longest), speed: I24F8::from_bits(speed), acceleration }
        })
        .collect()
}

/// Steps of all orders: for each order those of its own iterator, and at the end those up to a tick later.
fn walked(orders: &[Order]) -> Vec<Step> {
    let mut plan = Plan::at_rest(at(0), 0);
    let (mut now, mut steps) = (0, Vec::new());
    for (n, order) in orders.iter().enumerate() {
        plan = plan.ramp_to(at(now), order.speed, order.acceleration);
        let from = at(now);
        now += order.ticks;
        let last = if n + 1 == orders.len() { at(now + 1) } else { at(now) };
        steps.extend(StepIterator::new(&plan, from).take_while(|step| step.at <= last));
    }
    steps
}

#[test]
fn three_thousand_jogs_make_each_step_at_the_nearest_tick() {
    let mut random = Random(88_172_645_463_325_252);
    let (mut worst, mut total, mut turns) = (0.0_f64, 0, 0);
    for round in 0..3_000 {
        let orders = orders(&mut random);
        let mut steps = walked(&orders);
        let (mut jog, mut exact, mut now) = (Jog::default(), Vec::new(), 0);
        for order in &orders {
            jog.order(order.speed, order.acceleration);
            now += order.ticks;
            jog.walk(now, &mut exact);
        }
        // The last step may be one that is due within a tick after the end.
        if steps.len() == exact.len() + 1 && steps.pop_if(|step| step.at >= at(now)).is_none() {
            panic!("jog {round} makes a step too many");
        }
        assert_eq!(steps.len(), exact.len(), "jog {round}");
        for (n, (step, (due, forward))) in steps.iter().zip(&exact).enumerate() {
            assert_eq!(step.forward, *forward, "step {n} of jog {round}");
            let error = (step.at.ticks() as f64 - due).abs();
            worst = worst.max(error);
            assert!(error <= 0.501, "step {n} of jog {round} is {error} ticks off");
        }
        total += steps.len();
        turns += steps.windows(2).filter(|pair| pair[0].forward != pair[1].forward).count();
    }
    println!("{total} steps, {turns} turns, worst {worst:.4} ticks");
    assert!(total > 1_000_000 && turns > 500, "{total} steps, {turns} turns: too little was looked at");
}

/// A random profile move of up to `most` steps.
fn profile(random: &mut Random, most: u64) -> Plan {
    let steps = random.below(2 * most) as i32 - most as i32;
    let [start, speed] = [random.any_size(24), random.any_size(27)].map(U24F8::from_bits);
    let [up, down] = [random.any_size(31), random.any_size(31)];
    let start = if random.below(2) == 0 { U24F8::ZERO } else { start };
    Plan::profile(
        at(random.below(1 << 33)),
        -3,
        steps,
        Limits { start_speed: start, max_speed: speed, acceleration: up, deceleration: down },
    )
}

/// A random instant of a plan: within its first hour, or close to the border of two segments.
fn somewhere(random: &mut Random, plan: &Plan) -> Instant {
    let seams = random.below(4) as usize;
    let seam = plan
        .segments()
        .iter()
        .take(seams)
        .fold(plan.start(), |at, segment| at + Duration::from_ticks(segment.ticks.min(1 << 40)));
    let length = plan.end().since(plan.start()).ticks().min(3_600 * TICKS_PER_SECOND);
    let anywhere = Duration::from_ticks(random.below(length + 2));
    if random.below(2) == 0 {
        plan.start() + anywhere
    } else {
        seam - Duration::from_ticks(3) + Duration::from_ticks(random.below(6))
    }
}

#[test]
fn a_walk_begun_anywhere_makes_the_same_steps() {
    let mut random = Random(5);
    for _ in 0..2_000 {
        let plan = profile(&mut random, 300);
        let all: Vec<Step> = StepIterator::new(&plan, plan.start()).collect();
        assert_eq!(all.len(), plan.position_at(Instant::NEVER).abs_diff(-3) as usize, "{plan:?}");
        for _ in 0..8 {
            let after = somewhere(&mut random, &plan);
            let rest: Vec<Step> = all.iter().copied().filter(|step| step.at > after).collect();
            assert_eq!(StepIterator::new(&plan, after).collect::<Vec<_>>(), rest, "{plan:?} after {after:?}");
        }
    }
}

#[test]
fn repeating_an_order_to_a_jog_makes_the_same_steps() {
    let (mut random, mut total) = (Random(6), 0);
    for _ in 0..2_000 {
        let orders = orders(&mut random);
        let mut pieces = Vec::new();
        for order in &orders {
            let cut = random.below(order.ticks + 1);
            let (speed, acceleration) = (order.speed, order.acceleration);
            pieces.push(Order { ticks: cut, speed, acceleration });
            pieces.push(Order { ticks: order.ticks - cut, speed, acceleration });
        }
        let steps = walked(&orders);
        assert_eq!(walked(&pieces), steps);
        total += steps.len();
    }
    assert!(total > 500_000, "{total} steps: too little was looked at");
}

/// Asserts that the position of a plan changes exactly at the iterator's steps. Compares `most` steps, or all
/// if there are fewer.
fn agrees(plan: &Plan, after: Instant, most: usize) {
    let mut position = plan.position_at(after);
    let (mut last, mut made) = (after, 0);
    for step in StepIterator::new(plan, after).take(most) {
        made += 1;
        let before = step.at - Duration::TICK;
        assert!(step.at > last, "{plan:?} {step:?} {last:?}");
        for instant in [last, last + Duration::TICK, before] {
            if instant < step.at {
                assert_eq!(plan.position_at(instant), position, "{plan:?} at {instant:?} before {step:?}");
            }
        }
        position = position.wrapping_add(if step.forward { 1 } else { -1 });
        assert_eq!(plan.position_at(step.at), position, "{plan:?} at {step:?}");
        last = step.at;
    }
    if made < most {
        assert_eq!(position, plan.position_at(Instant::NEVER), "{plan:?} from {after:?}: steps are missing");
    }
}

#[test]
fn positions_agree_with_the_walker_around_every_step() {
    let mut random = Random(9);
    for _ in 0..2_000 {
        let plan = profile(&mut random, 200);
        agrees(&plan, plan.start(), usize::MAX);
        let mut now = 0;
        let mut plan = Plan::at_rest(at(0), 0);
        for order in orders(&mut random) {
            plan = plan.ramp_to(at(now), order.speed, order.acceleration);
            let after = somewhere(&mut random, &plan);
            agrees(&plan, at(now), 100);
            agrees(&plan, after, 100);
            now += order.ticks;
        }
    }
}

#[test]
fn positions_agree_with_the_walker_at_every_tick() {
    let fast = Limits { acceleration: 2_147_483_647, ..Limits::even(U24F8::MAX, 1_500_000_000) };
    let started =
        Limits { start_speed: U24F8::from_num(700_000), max_speed: U24F8::from_num(900_000), ..fast };
    let one_speed = Limits { start_speed: U24F8::MAX, max_speed: U24F8::from_num(5_000_000), ..fast };
    for rates in [fast, started, one_speed] {
        for steps in [-1, 1, 2, 3, 40, -400] {
            let plan = Plan::profile(at(9), 0, steps, rates);
            let mut position = 0;
            let mut walker = StepIterator::new(&plan, at(9)).peekable();
            for tick in 9..plan.end().ticks() + 100 {
                while let Some(step) = walker.next_if(|step| step.at <= at(tick)) {
                    position += if step.forward { 1 } else { -1 };
                }
                assert_eq!(plan.position_at(at(tick)), position, "{plan:?} at {tick}");
            }
            assert_eq!(position, steps);
        }
    }
}

/// The ticks of the steps after `after`.
fn steps(plan: &Plan, after: u64) -> impl Iterator<Item = u64> {
    StepIterator::new(plan, at(after)).map(|step| step.at.ticks())
}

#[test]
fn a_ramp_of_eleven_hours_is_as_exact_as_a_short_one() {
    // A ramp of 40,000 s has 6.4·10¹¹ ticks and 800 million steps.
    let plan = Plan::at_rest(at(0), 0).ramp_to(at(0), I24F8::from_num(40_000), 1);
    assert_eq!(plan.segments()[1].ticks, 40_000 * TICKS_PER_SECOND);
    let mut random = Random(3);
    for _ in 0..300 {
        let after = random.below(40_000 * TICKS_PER_SECOND);
        let made = plan.position_at(at(after)).cast_unsigned();
        let ticks: Vec<u64> = steps(&plan, after).take(100).collect();
        assert_eq!(ticks.len(), 100);
        for (n, ticks) in (made + 1..=800_000_000).zip(ticks) {
            assert!(is_nearest_root(ticks, n, 1), "step {n} at {ticks}");
        }
    }
}

#[test]
fn a_day_of_cruise_is_as_exact_as_a_second() {
    // At 40,000.25 steps/s a step is due every 399.9975 ticks, so the rounding keeps changing.
    let bits = 40_000 * 256 + 64;
    let plan = Plan::at_rest(at(0), 0).ramp_to(at(0), I24F8::from_bits(bits), 400_000);
    let h = h(bits.cast_unsigned());
    // The way is 2h·t − h²/a, so step n is due at (n·STEP + h²/a)/2h. Returns numerator and denominator.
    let due = |n: u128| (n * STEP * 400_000 + h * h, 2 * h * 400_000);
    let mut random = Random(4);
    for hour in 0..50 {
        let after = (1 + hour * 3_600) * TICKS_PER_SECOND + random.below(1 << 34);
        let made = plan.position_at(at(after));
        // Positions wrap at 32 bits, after 29 hours.
        let ticks: Vec<u64> = steps(&plan, after).take(1_000).collect();
        assert_eq!(ticks.len(), 1_000);
        let first = (u128::from(ticks[0]) * 2 * h * 400_000 - h * h) / (STEP * 400_000);
        let first = (first..).find(|n| *n as u32 == made.cast_unsigned().wrapping_add(1)).expect("endless");
        for (n, ticks) in (first..).zip(ticks) {
            let (number, by) = due(n);
            assert!((2 * u128::from(ticks)).abs_diff(2 * number / by) <= 1, "step {n} at {ticks}");
        }
    }
}

#[test]
fn the_slowest_cruise_steps_every_256_seconds() {
    let plan = Plan::at_rest(at(0), 0).ramp_to(at(0), -I24F8::DELTA, 1);
    // The ramp takes 1/256 s, which delays each step by 1/512 s.
    let late = TICKS_PER_SECOND / 512;
    let due: Vec<u64> = (1..=50).map(|n| n * 256 * TICKS_PER_SECOND + late).collect();
    assert_eq!(steps(&plan, 0).take(50).collect::<Vec<_>>(), due);
    assert!(StepIterator::new(&plan, at(0)).take(50).all(|step| !step.forward));
    assert_eq!(plan.position_at(at(due[49])), -50);
}

#[test]
fn a_speed_reached_within_a_tick_makes_up_for_a_step_that_is_due() {
    // At 1/256 step/s, 200 ticks before the first step, the speed changes to 67 steps/s within half a tick.
    let due = 256 * TICKS_PER_SECOND + TICKS_PER_SECOND / 512;
    let slow = Plan::at_rest(at(0), 0).ramp_to(at(0), I24F8::DELTA, 1);
    let plan = slow.ramp_to(at(due - 200), I24F8::from_num(67), i32::MAX.cast_unsigned());
    let ticks: Vec<u64> = steps(&plan, due - 200).take(1_000).collect();
    assert_eq!((ticks.len(), ticks[0]), (1_000, due - 199));
    for (n, ticks) in (0..).zip(&ticks) {
        // Steps are 1/67 s apart, counted from the instant of the change, at which the first step became due.
        let exact = n as f64 * TICKS_PER_SECOND as f64 / 67.0;
        assert!(((ticks - (due - 200)) as f64 - exact).abs() <= 1.5, "step {n} at {ticks}");
    }
    agrees(&plan, at(due - 200), 1_000);
}

#[test]
fn the_longest_move_ends_with_its_last_step() {
    let slow = Limits::even(U24F8::DELTA, 1);
    let plan = Plan::profile(at(0), 0, i32::MIN, slow);
    // 2³¹ steps of 256 s each, and 1/256 s more for the two ramps.
    let end = ((1 << 31) * 256 * 256 + 1) * (TICKS_PER_SECOND / 256);
    assert_eq!(plan.end(), at(end));
    assert_eq!(plan.position_at(plan.end()), i32::MIN);
    let last: Vec<u64> = steps(&plan, end - 600 * TICKS_PER_SECOND).collect();
    let second = end - 256 * TICKS_PER_SECOND - TICKS_PER_SECOND / 512;
    assert_eq!(last, [second - 256 * TICKS_PER_SECOND, second, end]);
}

#[test]
fn a_start_speed_above_the_speed_acts_as_the_speed() {
    let rates = Limits { start_speed: U24F8::from_num(7_000), ..Limits::even(U24F8::from_num(4_000), 10) };
    let plan = Plan::profile(at(0), 0, 25, rates);
    assert_eq!(steps(&plan, 0).collect::<Vec<_>>(), (1..=25).map(|n| n * 4_000).collect::<Vec<_>>());
    assert_eq!(plan.speed_at(at(1)), 4_000);
    assert_eq!(plan.speed_at(plan.end()), 0);
}

#[test]
fn a_start_speed_is_also_the_speed_of_the_last_step() {
    // From 1,000 to 3,000 steps/s in 0.2 s and 400 steps, down in 0.1 s and 200 steps, with 600 steps in
    // between.
    let rates = Limits {
        start_speed: U24F8::from_num(1_000),
        max_speed: U24F8::from_num(3_000),
        acceleration: 10_000,
        deceleration: 20_000,
    };
    let plan = Plan::profile(at(0), 0, 1_200, rates);
    assert_eq!(plan.end().ticks(), 5 * TICKS_PER_SECOND / 10);
    let ticks: Vec<u64> = steps(&plan, 0).collect();
    assert_eq!(ticks.len(), 1_200);
    assert_eq!((ticks[399], ticks[999], ticks[1_199]), (3_200_000, 6_400_000, 8_000_000));
    assert_eq!(plan.speed_at(at(3_200_000)), 3_000);
    assert_eq!(plan.speed_at(at(8_000_000 - 800_000)), 2_000);
}

#[test]
fn a_reversal_that_is_pending_takes_orders_in_each_of_its_parts() {
    // 1,000 steps/s forward. At 2 s the direction reverses: standstill at 2.1 s, −1,000 steps/s at 2.2 s.
    let ms = |ms: u64| at(ms * TICKS_PER_SECOND / 1_000);
    let thousand = I24F8::from_num(1_000);
    let jog = Plan::at_rest(at(0), 0).ramp_to(at(0), thousand, 10_000);
    let back = jog.ramp_to(ms(2_000), -thousand, 10_000);
    assert_eq!(back.position_at(ms(2_100)), 2_000);
    // An order at 2.05 s, at 500 steps/s, 37½ steps after the reversal was ordered.
    let on = back.ramp_to(ms(2_050), thousand, 10_000);
    assert_eq!((on.position_at(ms(2_050)), on.position_at(ms(2_100))), (1_987, 2_025));
    let stop = back.ramp_to(ms(2_050), I24F8::ZERO, 5_000);
    assert_eq!((stop.end(), stop.position_at(stop.end())), (ms(2_150), 2_012));
    assert_eq!(back.halt(ms(2_050)).position_at(Instant::NEVER), 1_987);
    // An order at standstill.
    let on = back.ramp_to(ms(2_100), thousand, 10_000);
    assert_eq!((on.position_at(ms(2_100)), on.position_at(ms(2_200))), (2_000, 2_050));
    let stop = back.ramp_to(ms(2_100), I24F8::ZERO, 10_000);
    assert_eq!((stop.end(), stop.position_at(Instant::NEVER)), (ms(2_100), 2_000));
    // An order at 2.15 s, at −500 steps/s and 12½ steps back. A stop takes 12½ steps more.
    let on = back.ramp_to(ms(2_150), thousand, 10_000);
    assert_eq!((on.position_at(ms(2_150)), on.position_at(ms(2_200))), (1_988, 1_975));
    assert_eq!(on.position_at(ms(2_300)), 1_975 + 50);
    let stop = back.ramp_to(ms(2_150), I24F8::ZERO, 10_000);
    assert_eq!((stop.end(), stop.position_at(stop.end())), (ms(2_200), 1_975));
    // The next order arrives in the cruise backward.
    let on = back.ramp_to(ms(2_300), thousand, 10_000);
    assert_eq!((on.position_at(ms(2_300)), on.position_at(ms(2_400))), (1_850, 1_800));
    for plan in [on, stop, back] {
        agrees(&plan, plan.start(), 1_000);
    }
}

#[test]
fn a_step_on_the_vertex_is_made_there() {
    // The factory move of an MD3 has ramps of 1,250 steps. A stop in its cruise also ends exactly on a step.
    let second = TICKS_PER_SECOND;
    let speed = I24F8::from_num(5_000);
    let stop = Plan::at_rest(at(0), 0).ramp_to(at(0), speed, 10_000).ramp_to(at(second), I24F8::ZERO, 10_000);
    assert_eq!(stop.end(), at(3 * second / 2));
    let ticks: Vec<u64> = steps(&stop, second).collect();
    assert_eq!((ticks.len(), ticks.last()), (1_250, Some(&(3 * second / 2))));
    // In a reversal the step at standstill is still made forward.
    let back = Plan::at_rest(at(0), 0).ramp_to(at(0), speed, 10_000).ramp_to(at(second), -speed, 10_000);
    let turn: Vec<Step> = StepIterator::new(&back, at(second)).skip(1_249).take(2).collect();
    assert_eq!((turn[0].at, turn[0].forward, turn[1].forward), (at(3 * second / 2), true, false));
}

#[test]
fn the_table_of_errors_is_the_printed_one() {
    let rows = ramps::rows();
    let ours: Vec<f64> = rows.iter().map(|row| row.ours.worst).collect();
    // The triangle ends after 2·√(101/10,000) s, which is not a whole tick. The other moves end on a tick.
    let limits = [0.501, 0.501, 1.0, 0.501];
    assert!(ours.iter().zip(limits).all(|(worst, limit)| *worst <= limit), "{ours:?}");
    assert_eq!((rows[0].ours.last, rows[1].ours.last), (0.0, 0.0));
    // Both other algorithms lose (1 − 0.676)·√(2/a) in the first interval, and the same in the last.
    for (row, a) in rows.iter().zip([10_000.0, 500_000.0, 10_000.0_f64]) {
        let lost = 2.0 * 0.324 * (2.0 / a).sqrt() * TICKS_PER_SECOND as f64;
        for others in [row.avr446, row.accelstepper] {
            let others = others.expect("they make moves").worst;
            assert!((0.9 * lost..2.6 * lost).contains(&others), "{}: {others} ticks, not {lost}", row.name);
        }
    }
    let document = include_str!("../../docs/explanation/motion.md");
    let table = ramps::table(&rows);
    assert!(document.contains(&table), "docs/explanation/motion.md does not show this:\n{table}");
}
