//! Steps against the mathematics of constant acceleration, computed here in another way than the plan
//! does it: real instants from square roots, in 1/65,536 tick.
//!
//! With *h* = speed · ticks/s and a step of 2·(ticks/s)², way and speed are tied by
//! h² = h₀² + a·way, and a time at constant acceleration is Δh/a ticks.
#![allow(missing_docs, reason = "a test")]

use fixed::types::U24F8;
use standin_firmware::device::{Instant, Plan};
use standin_firmware::motion::{Rates, Step, Walker};
use standin_protocol::time::TICKS_PER_SECOND;

/// A step: the unit of a way.
const STEP: u128 = 2 * (TICKS_PER_SECOND as u128) * (TICKS_PER_SECOND as u128);
/// Units of an exact instant in a tick.
const TICK: i128 = 1 << 16;

fn at(ticks: u64) -> Instant {
    Instant::from_ticks(ticks)
}

/// A speed in 1/256 step/s as h.
fn h(bits: u32) -> u128 {
    u128::from(bits) * u128::from(TICKS_PER_SECOND) / 256
}

/// The same numbers in every run.
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

    /// Of any size: as likely to have few bits as many.
    fn any_size(&mut self, bits: u64) -> u32 {
        let bits = 1 + self.below(bits);
        1 + self.below(1 << bits) as u32
    }
}

/// The exact instants of a profile move.
struct Move {
    steps: u32,
    start: u128,
    speed: u128,
    up: u128,
    down: u128,
    /// Way of the ramp up, and from where on the ramp down.
    ramps: [u128; 2],
    /// Instant of the end.
    end: i128,
}

/// How long, in 1/65,536 tick, from the speed `start` over a `way` with acceleration `a`.
fn ramp(start: u128, a: u128, way: u128) -> i128 {
    ((((start * start + a * way) << 32).isqrt() - (start << 16)) / a) as i128
}

impl Move {
    fn of(steps: u32, rates: Rates) -> Self {
        let speed = h(rates.speed.to_bits());
        let start = h(rates.start.to_bits()).min(speed);
        let (up, down) = (u128::from(rates.up), u128::from(rates.down));
        let way = u128::from(steps) * STEP;
        let gained = speed * speed - start * start;
        let (mut first, mut last) = (gained / up, gained / down);
        let mut cruise = 0;
        if first + last > way {
            // The ramps meet: first·up = last·down.
            first = way * down / (up + down);
            last = way - first;
        } else {
            cruise = (((way - first - last) << 16) / (2 * speed)) as i128;
        }
        let end = ramp(start, up, first) + cruise + ramp(start, down, last);
        Self { steps, start, speed, up, down, ramps: [first, way - last], end }
    }

    /// When step `n` is due, counted from 1.
    fn step(&self, n: u32) -> i128 {
        let way = u128::from(n) * STEP;
        let [first, last] = self.ramps;
        if way <= first {
            ramp(self.start, self.up, way)
        } else if way <= last {
            ramp(self.start, self.up, first) + (((way - first) << 16) / (2 * self.speed)) as i128
        } else {
            self.end - ramp(self.start, self.down, u128::from(self.steps) * STEP - way)
        }
    }
}

/// A tick in the unit of exact instants.
fn exactly(instant: Instant) -> i128 {
    i128::from(instant.ticks()) * TICK
}

/// The first half is that of the end of the move, the second that of the step; what the oracle rounds
/// and what the acceleration adds in half a tick comes on top.
const A_TICK: i128 = TICK + TICK / 256;

#[test]
fn twenty_thousand_moves_make_each_step_within_a_tick() {
    let mut random = Random(88_172_645_463_325_252);
    let mut worst = 0;
    for _ in 0..20_000 {
        let steps = 1 + random.below_one_of([10, 300, 5_000, 10_000]);
        let speed = 256 * (1 + random.below_one_of([100, 5_000, 40_000, 300_000])) - random.below(256) as u32;
        let up = random.any_size(24);
        let down = if random.below(2) == 0 { up } else { random.any_size(24) };
        let start = if random.below(2) == 0 { 0 } else { random.below(u64::from(speed) + 100) as u32 };
        let rates = Rates { start: U24F8::from_bits(start), speed: U24F8::from_bits(speed), up, down };
        let back = random.below(2) == 0;
        let begin = random.below(1 << 40);
        let signed = if back { -steps.cast_signed() } else { steps.cast_signed() };
        let plan = Plan::profile(at(begin), 5, signed, rates);
        let exact = Move::of(steps, rates);
        let error = (exactly(plan.end()) - exact.end - exactly(at(begin))).abs();
        assert!(error <= TICK / 2 + 64, "{rates:?} {steps}: it ends {error} off");

        let every = 1 + steps / 32;
        let mut made = 0;
        for step in Walker::new(&plan, at(begin)) {
            made += 1;
            assert_eq!(step.forward, !back);
            if made <= 8 || made + 8 > steps || made % every == 0 {
                let error = (exactly(step.at) - exact.step(made) - exactly(at(begin))).abs();
                worst = worst.max(error);
                assert!(error <= A_TICK, "step {made} of {steps} is {error} off: {rates:?}");
            }
        }
        assert_eq!(made, steps, "{rates:?}");
    }
    assert!(worst > TICK / 2, "the worst step of twenty thousand moves is {worst} off: nothing was looked at");
    println!("worst {:.4} ticks", worst as f64 / TICK as f64);
}

#[test]
fn moves_of_any_length_make_each_step_within_a_tick() {
    let mut random = Random(7);
    for _ in 0..2_000 {
        let steps = random.any_size(31).min(i32::MAX as u32);
        let speed = 256 + random.any_size(30);
        // The oracle's 128 bits hold a way·a·b/(a + b) of so much.
        let [up, down] = [random.any_size(16), random.any_size(16)];
        let rates = Rates { start: U24F8::ZERO, speed: U24F8::from_bits(speed), up, down };
        let plan = Plan::profile(at(0), 0, steps.cast_signed(), rates);
        let exact = Move::of(steps, rates);
        let near = [1, exact.ramps[0] / STEP, exact.ramps[1] / STEP, u128::from(steps)];
        for n in near.map(|n| n as u32).into_iter().chain((0..4).map(|_| random.next() as u32 % steps)) {
            let n = n.clamp(1, steps).saturating_sub(4);
            // Half a step before step n + 1.
            let after = if n == 0 { 0 } else { (exact.step(n) + exact.step(n + 1)) / 2 / TICK };
            let after = at(after as u64);
            assert_eq!(plan.position_at(after), n.cast_signed(), "{rates:?}");
            let mut made = n;
            for step in Walker::new(&plan, after).take(8) {
                made += 1;
                let error = (exactly(step.at) - exact.step(made)).abs();
                assert!(error <= A_TICK, "step {made} of {steps} is {error} off: {rates:?}");
            }
            assert_eq!(made, steps.min(n + 8));
        }
    }
}

/// In whole numbers: √(n·STEP/a) is nearer to `ticks` than to its neighbours. Halfway between two the
/// earlier is taken, and halfway is where phase + speed reaches the step: a·t² + a·t = n·STEP.
fn is_nearest_root(ticks: u64, n: u32, a: u32) -> bool {
    let (t, a, way) = (u128::from(ticks), u128::from(a), u128::from(n) * STEP);
    a * t * (t - 1) <= way && way < a * t * (t + 1)
}

#[test]
fn a_ramp_from_standstill_and_its_mirror_are_at_the_nearest_tick() {
    let mut random = Random(11);
    for round in 0..400 {
        let a = if round < 16 { 1 << (2 * round) } else { random.any_size(31).min(i32::MAX as u32) };
        // A triangle: no cruise at any acceleration.
        let plan = Plan::profile(at(0), 0, 4_000, Rates::even(U24F8::MAX, a));
        let [up, stop] = plan.segments() else { panic!("no triangle: {plan:?}") };
        assert_eq!((up.a.unsigned_abs(), stop.a.unsigned_abs()), (a, a));
        let steps: Vec<u64> = Walker::new(&plan, at(0)).map(|step| step.at.ticks()).collect();
        assert_eq!(steps.len(), 4_000);
        for (n, &ticks) in (1..=1_999).zip(&steps) {
            assert!(is_nearest_root(ticks, n, a), "step {n} at {ticks}, {a} steps/s²");
        }
        let end = plan.end().ticks();
        assert_eq!(steps[3_999], end);
        for (left, &ticks) in (1..=1_999).zip(steps.iter().rev().skip(1)) {
            // Seen from the end the later of two.
            assert!(is_nearest_root(end - ticks, left, a), "{left} before the end, {a} steps/s²");
        }
    }
}
