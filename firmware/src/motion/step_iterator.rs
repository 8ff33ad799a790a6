//! The instants of a plan's steps, in order.
//!
//! Planning runs in the main loop, iteration in an interrupt. [`StepIterator::new`] computes with wide
//! arithmetic how many steps each segment of the plan makes, and when its first step is due.
//! [`StepIterator::next`] then neither divides nor looks beyond a segment, because the number of remaining
//! steps is known. It keeps the exact phase and speed from step to step, in the units of
//! [the plan](super::plan). So each step is exact, and errors do not accumulate.
//!
//! In a ramp the next interval is extrapolated from the last two. The exact phase at the guessed tick shows
//! if the guess is right: the step belongs to the tick from which it is less than half a tick's distance
//! away. If the guess is wrong, the correction is the remaining phase divided by the mean speed of a step in
//! that interval. Between the speeds *h* and *h'* the correction leaves (h' − h)/(h' + h) of the error. This
//! is at most 0.17 if there is another step between this step and standstill. There may be no such step for
//! the first two steps of a ramp and for the last one; those are computed by [`StepIterator::new`].
//!
//! # Example
//!
//! A ramp from standstill with 10,000 steps/s². A step is 512·10¹² units of phase. At 16,000,000 ticks/s step
//! 100 is due at √(2·100/10,000) s = 2,262,741.7 ticks.
//!
//! 1. Steps 97, 98 and 99 were made at the ticks 2,228,542, 2,240,000 and 2,251,400. With the exact times of
//!    these steps within their ticks, the last two intervals are 11,457.89 and 11,399.56 ticks. The next
//!    interval should be shorter by the same difference: 11,399.56 − 58.33 = 11,341.23. Step 99 was due 0.44
//!    ticks before its tick, so the guess is 11,341.23 − 0.44, rounded: 11,341 ticks.
//! 2. At that tick the speed is 10,000·(2,251,400 + 11,341) = 22.627·10⁹, and 31.669·10⁹ units of phase are
//!    left. This is more than the speed, which is the phase that passes in half a tick. So the guess is too
//!    early.
//! 3. The correction is 31.669·10⁹ · 11,341/(512·10¹²) = 0.70 ticks, rounded to 1. So the interval is 11,342
//!    ticks: at tick 2,262,742 the phase is 13.586·10⁹ beyond the step, less than half a tick's distance.
//!    Step 100 belongs to this tick.
//! 4. Step 100 was due 13.586·10⁹ · 11,342/(512·10¹²) = 0.30 ticks earlier. This fraction is stored for the
//!    next guess.
//!
//! The divisions by 512·10¹² are computed as products with a constant.
//!
//! ```
//! use drivetwin_firmware::device::{Instant, Plan};
//! use drivetwin_firmware::motion::StepIterator;
//! use fixed::types::I24F8;
//!
//! let start = Instant::from_ticks(0);
//! let ramp = Plan::at_rest(start, 0).ramp_to(start, I24F8::from_num(5_000), 10_000);
//! let ticks: Vec<u64> = StepIterator::new(&ramp, start).map(|step| step.at.ticks()).skip(96).take(4).collect();
//! assert_eq!(ticks, [2_228_542, 2_240_000, 2_251_400, 2_262_742]);
//! ```
//!
//! Small cores compute 32 bits of a product at once; a product of 64 bits costs them 40 instructions. So the
//! code that runs at every step of a fast ramp multiplies few bits at a time. Longer intervals leave time for
//! wider products.

use drivetwin_protocol::time::{Duration, Instant};
use heapless::Deque;

use super::Plan;
use super::plan::{STEP, Segment};
use super::search::first_true;

/// A step of an axis.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Step {
    /// The tick nearest to its instant in the plan.
    pub at: Instant,
    /// True if the position grows.
    pub forward: bool,
}

/// Yields the steps of a plan in order. The next step is computed only when it is requested.
///
/// The limits are those of the plan: at least two ticks between steps, intervals up to 2³² ticks (1/256
/// step/s), any length.
#[derive(Clone, Debug)]
pub struct StepIterator {
    run: StepRun,
    others: StepRuns,
}

/// Runs of a plan: one for each of its three segments, and at most one for a step at standstill after a
/// segment.
type StepRuns = Deque<StepRun, 4>;

/// Successive steps of a segment in one direction.
#[derive(Clone, Copy, Debug)]
struct StepRun {
    /// Tick of the first step.
    first: u64,
    /// Tick from which the next interval is counted: the tick of the last step. Before the first interval it
    /// may be earlier than `first`, because a step cannot be made before its segment starts.
    base: u64,
    /// Steps that remain in this lap.
    more: u32,
    /// Laps that follow this one, of [`LAP_STEPS`] steps each. Laps exist because a small core counts 32 bits
    /// in fewer instructions.
    laps: u32,
    /// True if the position grows.
    forward: bool,
    intervals: Intervals,
}

const LAP_STEPS: u32 = u32::MAX;

/// Intervals between the steps of a run.
#[derive(Clone, Copy, Debug)]
enum Intervals {
    Ramp(Ramp),
    Cruise(Cruise),
}

impl StepIterator {
    /// An iterator over the steps of `plan`, from the first step later than `after` on. An `after` before the
    /// plan's start acts as the start.
    #[must_use]
    pub fn new(plan: &Plan, after: Instant) -> Self {
        let mut iterator = Self::done();
        iterator.restart(plan, after);
        iterator
    }

    /// An iterator without steps.
    #[must_use]
    pub const fn done() -> Self {
        Self { run: StepRun::single(0, true), others: StepRuns::new() }
    }

    /// Drops the remaining steps and continues with those of `plan`, as [`new`](Self::new) does. It works in
    /// place, because an iterator takes a few hundred bytes and boards have small stacks.
    pub fn restart(&mut self, plan: &Plan, after: Instant) {
        self.run = StepRun::single(0, true);
        self.others.clear();
        let after = after.max(plan.start()).ticks();
        let mut end = plan.start().ticks();
        // Position of the axis at the end of the last segment.
        let mut position = 0;
        let mut segments = plan.segments().iter().filter(|segment| segment.ticks > 0).peekable();
        while let Some(segment) = segments.next() {
            let begin = end;
            end = begin.saturating_add(segment.ticks);
            if end <= after {
                continue;
            }
            let cursor = SegmentCursor::of(segment, begin, after, position);
            let stop_position = match segments.peek() {
                Some(next) if next.reverse == segment.reverse => None,
                Some(next) => Some(next.base),
                None => Some(plan.position_at(Instant::NEVER)),
            };
            position = cursor.append_runs(stop_position, &mut self.others);
        }
    }

    /// Delays all remaining steps by `late`.
    pub fn delay(&mut self, late: Duration) {
        for run in core::iter::once(&mut self.run).chain(&mut self.others) {
            run.first = run.first.saturating_add(late.ticks());
            run.base = run.base.wrapping_add(late.ticks());
        }
    }

    /// Continues with the next run and its first step.
    #[cold]
    fn next_run(&mut self) -> Option<Step> {
        self.run = self.others.pop_front()?;
        Some(Step { at: Instant::from_ticks(self.run.first), forward: self.run.forward })
    }
}

impl Iterator for StepIterator {
    type Item = Step;

    // Always inlined, because an interrupt calls this for every step, and a call costs it ten instructions.
    #[inline(always)]
    fn next(&mut self) -> Option<Step> {
        let run = &mut self.run;
        if run.more == 0 && !run.begin_lap() {
            return self.next_run();
        }
        run.more -= 1;
        let interval = match &mut run.intervals {
            Intervals::Ramp(ramp) => ramp.next(),
            Intervals::Cruise(cruise) => cruise.next(),
        };
        run.base = run.base.wrapping_add(u64::from(interval));
        Some(Step { at: Instant::from_ticks(run.base), forward: run.forward })
    }
}

/// A segment, and the tick after which its steps are taken.
struct SegmentCursor<'a> {
    segment: &'a Segment,
    begin: u64,
    /// Ticks of the segment up to the tick after which its steps are taken.
    since: u64,
    /// Steps made up to the same tick, beyond the segment's `base`.
    made: i64,
}

impl<'a> SegmentCursor<'a> {
    /// The part of `segment` later than `after`. The segment begins at the tick `begin`. If that is after
    /// `after`, the part starts from `position`, the position at the end of the previous segment.
    fn of(segment: &'a Segment, begin: u64, after: u64, position: i32) -> Self {
        let since = after.saturating_sub(begin);
        let made = if after < begin {
            // `position` and `base` differ by a step at most.
            let steps = position.wrapping_sub(segment.base);
            i64::from(if segment.reverse { steps.wrapping_neg() } else { steps })
        } else {
            segment.steps_made(since).cast_signed()
        };
        Self { segment, begin, since, made }
    }

    /// Appends the runs of this segment. If the axis stops after the segment, at `stop_position`, the runs
    /// include the step that is made when the axis reaches standstill. Returns the position after the
    /// segment.
    fn append_runs(&self, stop_position: Option<i32>, runs: &mut StepRuns) -> i32 {
        let Self { segment, begin, made, .. } = *self;
        let mut push = |run| {
            let pushed = runs.push_back(run);
            debug_assert!(pushed.is_ok(), "a plan has no more legs");
        };
        if segment.ticks == u64::MAX {
            push(self.run(u64::MAX));
            return segment.base;
        }
        let end = begin.saturating_add(segment.ticks);
        let last = segment.ticks - 1;
        let all = segment.steps_made(last);
        let position = segment.step(all);
        let mut steps = (all.cast_signed() - made).cast_unsigned();
        // A separate run: the step at standstill, or the last step of a ramp down.
        let closing = match stop_position {
            Some(stop_position) if stop_position != position => Some(end),
            _ if segment.acceleration < 0 && steps > 0 => {
                steps -= 1;
                let there = Motion::of(segment, last, all.cast_signed());
                let back = first_true(|d| there.after(-d.cast_signed()).is_early());
                Some(end.saturating_sub(back))
            }
            _ => None,
        };
        if let Some(others) = steps.checked_sub(1) {
            push(self.run(others));
        }
        if let Some(tick) = closing {
            push(StepRun::single(tick, !segment.reverse));
        }
        stop_position.unwrap_or(position)
    }

    /// A run of the next step and `others` steps after it.
    fn run(&self, others: u64) -> StepRun {
        let Self { segment, begin, since, made } = *self;
        let start = begin.saturating_add(since);
        let motion = Motion::of(segment, since, made + 1);
        let (ticks, intervals) = if segment.acceleration == 0 {
            let (ticks, cruise) = Cruise::of(motion);
            (ticks, Intervals::Cruise(cruise))
        } else {
            let ticks = motion.ticks();
            (ticks, Intervals::Ramp(Ramp::from(motion.after(ticks).next_step())))
        };
        let base = start.wrapping_add_signed(ticks);
        let (laps, more) = ((others / u64::from(LAP_STEPS)) as u32, (others % u64::from(LAP_STEPS)) as u32);
        StepRun { first: base.max(start), base, more, laps, forward: !segment.reverse, intervals }
    }
}

impl StepRun {
    /// Starts the next lap. Returns false if there is none.
    #[cold]
    fn begin_lap(&mut self) -> bool {
        let Some(laps) = self.laps.checked_sub(1) else { return false };
        self.laps = laps;
        self.more = LAP_STEPS;
        true
    }

    /// A run of a single step.
    const fn single(tick: u64, forward: bool) -> Self {
        Self {
            first: tick,
            base: tick,
            more: 0,
            laps: 0,
            forward,
            intervals: Intervals::Cruise(Cruise::STANDING),
        }
    }
}

/// Motion of a segment at a tick, relative to a step.
#[derive(Clone, Copy, Debug)]
struct Motion {
    /// Acceleration, in steps/s².
    acceleration: i32,
    /// Speed, in the unit of [`Segment::start_speed`].
    speed: i64,
    /// Phase that remains until the step.
    phase_left: i64,
}

impl Motion {
    /// The motion of `segment`, `d` ticks after its start, relative to the step that is the `n`th beyond its
    /// `base`.
    fn of(segment: &Segment, d: u64, n: i64) -> Self {
        // The difference fits in 64 bits. So the low 64 bits of both terms are enough.
        let phase_left = n.wrapping_mul(STEP).wrapping_sub(segment.phase(d) as i64);
        Self { acceleration: segment.acceleration, speed: segment.speed(d), phase_left }
    }

    /// The motion `d` ticks later.
    #[inline]
    fn after(self, d: i64) -> Self {
        let speed = self.speed + i64::from(self.acceleration) * d;
        Self { speed, phase_left: self.phase_left - (self.speed + speed) * d, ..self }
    }

    /// As [`Self::after`], for a `d` up to [`Self::short_limit`], with products of 32 bits.
    #[inline]
    fn after_short(self, d: u32) -> Self {
        let speed = self.speed + i64::from(self.acceleration * d.cast_signed());
        let sum = (self.speed + speed).cast_unsigned();
        let low = (sum as u32 & 0xFFFF) * d;
        let middle = (sum as u32 >> 16) * d;
        let high = ((sum >> 32) as u32).wrapping_mul(d);
        // A negative sum wraps, and its product wraps the same way.
        let phase = ((u64::from(high) << 32) + u64::from(low)).wrapping_add(u64::from(middle) << 16);
        Self { speed, phase_left: self.phase_left - phase.cast_signed(), ..self }
    }

    /// The longest `d` that has at most 16 bits (4 ms) and changes the speed by at most 31 bits (134
    /// steps/s).
    fn short_limit(self) -> u32 {
        let change = i32::MAX.cast_unsigned();
        change.checked_div(self.acceleration.unsigned_abs()).unwrap_or(change).min(0xFFFF)
    }

    /// Ticks until the step, or until standstill.
    #[inline(never)]
    fn ticks(self) -> i64 {
        first_true(|d| !self.after(d.cast_signed()).is_early()).cast_signed()
    }

    /// Returns true if this tick is before the tick of the step; false after standstill.
    fn is_early(self) -> bool {
        self.speed >= 0 && self.phase_left >= self.speed.max(1)
    }

    /// Returns true if this is the tick of the step: less than half a tick's distance remains to the step, or
    /// at most half a tick's distance has passed since the step.
    #[inline]
    fn is_nearest(self) -> bool {
        // With p = phase_left, -speed <= p is the same as -1 - p < speed, and p ^ -1 is -1 - p. So one
        // comparison covers both signs.
        (self.phase_left ^ (self.phase_left >> 63)) < self.speed
    }

    /// The same motion, relative to the next step.
    #[inline]
    fn next_step(self) -> Self {
        Self { phase_left: self.phase_left + STEP, ..self }
    }
}

/// Steps of a ramp.
#[derive(Clone, Copy, Debug)]
struct Ramp {
    /// Motion at the tick of the last step, relative to the next step.
    motion: Motion,
    /// The longest interval for which [`Motion::after_short`] may be used.
    short_limit: u32,
    /// The last interval, in 1/64 tick.
    interval: i32,
    /// Exact time of the last step minus its tick, in 1/64 tick.
    part: i32,
    /// A copy of [`STEP`]: a Cortex-M3 loads it from here in one instruction, and as a constant in four.
    step: i64,
    /// Guess of the next interval, in ticks.
    guess: i32,
}

/// Greatest number of attempts to find a step. The third step of the slowest ramps takes 12. Later steps of a
/// ramp hardly ever take more than one.
const MAX_TRIES: u32 = 16;

impl Ramp {
    /// A ramp from the tick of a step on.
    fn from(motion: Motion) -> Self {
        let second = motion.ticks() as i32;
        // The interval before the second step is set to twice the second interval. The search for the third
        // step then starts from half the second interval, and the third interval is never far below that.
        Self {
            motion,
            step: STEP,
            short_limit: motion.short_limit(),
            // The product saturates only if there is no next step.
            interval: second.saturating_mul(128),
            part: 0,
            guess: second,
        }
    }

    /// Ticks to the next step.
    #[inline]
    fn next(&mut self) -> u32 {
        let d = self.guess.cast_unsigned();
        if d <= self.short_limit {
            let there = self.motion.after_short(d);
            if there.is_nearest() {
                return self.step(d, there);
            }
        }
        self.search()
    }

    /// Advances by `d` ticks to the next step, with the motion `there` at its tick. Returns `d`.
    #[inline]
    fn step(&mut self, d: u32, there: Motion) -> u32 {
        let part = ticks_64(there.phase_left, d);
        let interval = (d << 6).cast_signed() + part - self.part;
        // The order of operations matters, because the sum of two of the longest intervals exceeds 32 bits.
        self.guess = (interval + (interval - self.interval) + part + 32) >> 6;
        self.interval = interval;
        self.part = part;
        self.motion = Motion { phase_left: there.phase_left + self.step, ..there };
        d
    }

    /// As [`Self::next`], but also for a wrong guess and for an interval beyond the short limit.
    #[cold]
    #[inline(never)]
    fn search(&mut self) -> u32 {
        let Self { motion, short_limit, .. } = *self;
        let after = |d| if d <= short_limit { motion.after_short(d) } else { motion.after(i64::from(d)) };
        // Close to standstill the intervals shrink fastest, but hardly ever to less than a half.
        let mut d = self.guess.max(self.interval >> 7).cast_unsigned();
        let mut there = after(d);
        let (mut early, mut late) = (0, u32::MAX);
        for _ in 0..MAX_TRIES {
            if there.is_nearest() {
                break;
            }
            if there.is_early() {
                early = d;
            } else {
                late = d;
            }
            d = d.wrapping_add_signed(ticks(there.phase_left, d)).max(early + 1).min(late - 1);
            there = after(d);
        }
        debug_assert!(there.is_nearest(), "a step that is there is found");
        self.step(d, there)
    }
}

/// Time that `phase` takes at the mean speed of an interval of `d` ticks, a step in `d` ticks. The time is in
/// 1/64 tick, and must be within a tick.
#[inline]
fn ticks_64(phase: i64, d: u32) -> i32 {
    /// 2³³ · 64 / STEP, in units of 2⁻²³.
    const RATE: i32 = ((1 << 62) / STEP as u64) as i32;
    let high = ((phase >> 18) as i32 * d.cast_signed()) >> 15;
    (high * RATE) >> 23
}

/// As [`ticks_64`], for any phase and in whole ticks.
fn ticks(phase: i64, d: u32) -> i32 {
    /// 2⁴¹ / STEP, in units of 2⁻²⁰.
    const RATE: i64 = (1 << 61) / STEP;
    let high = ((phase >> 16) * i64::from(d)) >> 25;
    ((high * RATE + (1 << 19)) >> 20) as i32
}

/// Steps at a constant speed.
#[derive(Clone, Copy, Debug)]
struct Cruise {
    /// Whole ticks of an interval.
    whole: u32,
    /// Phase of a step that remains after the whole ticks.
    remainder: i64,
    /// Phase that passes in a tick.
    phase_per_tick: i64,
    /// Phase left to the next step, counted from half a tick after the tick of the last step. It is in
    /// `-phase_per_tick..0`.
    phase_left: i64,
}

impl Cruise {
    const STANDING: Self = Self { whole: 0, remainder: 0, phase_per_tick: 0, phase_left: 0 };

    /// The ticks from `motion` to its step, and the steps after that step. The step may be due already, if
    /// the speed changes within one tick.
    fn of(motion: Motion) -> (i64, Self) {
        let tick = (2 * motion.speed).max(1);
        let late = motion.phase_left - motion.speed;
        let cruise = Self {
            whole: (STEP / tick) as u32,
            remainder: STEP % tick,
            phase_per_tick: tick,
            phase_left: late.rem_euclid(tick) - tick,
        };
        (late.div_euclid(tick) + 1, cruise)
    }

    /// Ticks to the next step.
    #[inline]
    fn next(&mut self) -> u32 {
        self.phase_left += self.remainder;
        if self.phase_left < 0 {
            return self.whole;
        }
        self.phase_left -= self.phase_per_tick;
        self.whole + 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::{Limits, MAX_ACCELERATION, MAX_SPEED};
    use drivetwin_protocol::time::Span;
    use fixed::types::{I24F8, U24F8};
    use proptest::prelude::*;

    fn at(ticks: u64) -> Instant {
        Instant::from_ticks(ticks)
    }

    /// Checks that a plan's steps after `after` are at the ticks at which its position changes, for `most`
    /// steps or for all.
    fn check(plan: &Plan, after: Instant, most: usize) {
        let (mut position, mut made) = (plan.position_at(after), 0);
        for step in StepIterator::new(plan, after).take(most) {
            assert_eq!(plan.position_at(at(step.at.ticks() - 1)), position, "{step:?} of {plan:?}");
            position = position.wrapping_add(if step.forward { 1 } else { -1 });
            assert_eq!(plan.position_at(step.at), position, "{step:?} of {plan:?}");
            made += 1;
        }
        if made < most {
            assert_eq!(plan.position_at(Instant::NEVER), position, "{plan:?}: steps are missing");
        }
    }

    #[test]
    fn a_leg_of_several_laps_goes_on() {
        let plan = Plan::at_rest(at(0), 0).ramp_to(at(0), I24F8::from_num(8_000_000), MAX_ACCELERATION);
        let later = at(1 << 36);
        let mut all = StepIterator::new(&plan, later);
        let mut lap = all.clone();
        assert_eq!((all.run.more, all.others.len()), (0, 1), "the cruise is left");
        all.next();
        lap.next();
        assert!(all.run.laps > 0);
        lap.run.more = 2;
        for _ in 0..10 {
            assert_eq!(lap.next(), all.next());
        }
    }

    #[test]
    fn a_step_is_at_the_first_tick_from_which_it_is_less_than_half_a_tick_away() {
        // In half a tick the phase grows by the speed.
        let is_nearest = |phase_left| Motion { acceleration: 0, speed: 5, phase_left }.is_nearest();
        assert!((-5..=4).all(is_nearest), "less than half a tick to go, or half a tick past it");
        assert!(!is_nearest(5), "half a tick to go: the next one");
        assert!(!is_nearest(-6), "more than half a tick past it: the one before");
        assert!(
            Motion { acceleration: 0, speed: 5, phase_left: 5 }.is_early()
                && !Motion { acceleration: 0, speed: 5, phase_left: 4 }.is_early()
        );
    }

    #[test]
    fn an_interval_is_short_if_it_has_16_bits_and_the_change_of_speed_31() {
        let short_limit = |acceleration| Motion { acceleration, speed: 0, phase_left: 0 }.short_limit();
        assert_eq!([0, 1, -1, 32_768].map(short_limit), [65_535; 4]);
        // 32,769 * 65,534 is 2^31 - 2.
        assert_eq!([32_769, -32_769].map(short_limit), [65_534; 2]);
        assert_eq!([1_000_000, -1_000_000].map(short_limit), [2_147; 2]);
        assert_eq!([i32::MAX, -i32::MAX].map(short_limit), [1; 2]);
    }

    #[test]
    fn a_phase_is_told_in_ticks_at_the_mean_speed_of_an_interval() {
        // An interval of a thousand ticks.
        let tick = STEP / 1_000;
        let tenths = [-16, -14, -6, -4, 0, 4, 6, 14, 16];
        assert_eq!(tenths.map(|n| ticks(tick * n / 10, 1_000)), [-2, -1, -1, 0, 0, 0, 1, 1, 2]);
        // The results are in 1/64 tick, rounded down.
        assert_eq!([-1, 1, 21, 61].map(|n| ticks_64(tick * n / 128, 1_000)), [-1, 0, 10, 30]);
    }

    /// The time t of a step after standstill at `a` steps/s², in 1/`ticks_64` tick, rounded to the nearest.
    /// The step is at the distance a·t²/2.
    fn due(step: u64, a: u32, ticks_64: u64) -> u64 {
        let square = u128::from(ticks_64 * ticks_64 * step) * u128::from(STEP.cast_unsigned());
        // The root of four times the square is twice the time, rounded down. Half of it, rounded up, is the
        // time, rounded to the nearest.
        let twice = (4 * square / u128::from(a)).isqrt();
        twice.div_ceil(2) as u64
    }

    #[test]
    fn the_last_steps_of_a_ramp_are_those_of_its_mirror() {
        for a in 1..=3_000 {
            let plan = Plan::profile(at(0), 0, 8, Limits::even(U24F8::from_num(MAX_SPEED), a));
            // The ramp up over 4 steps and the ramp down together take as long as 16 steps from standstill.
            let end = due(16, a, 1);
            let down = [3, 2, 1, 0].map(|n| at(end - due(n, a, 1)));
            assert!(StepIterator::new(&plan, at(0)).skip(4).map(|step| step.at).eq(down), "{a} steps/s²");
        }
    }

    #[test]
    fn a_step_is_found_though_the_guess_is_off() {
        for a in 1..=3_000 {
            let plan = Plan::profile(at(0), 0, 8, Limits::even(U24F8::from_num(MAX_SPEED), a));
            let mut iterator = StepIterator::new(&plan, at(0));
            // Intervals from the third step before the end to the second, and from the second to the first.
            // They equal those of the ramp up.
            for (skipped, last, next) in [(4, 3, 2), (0, 2, 1)] {
                iterator.nth(skipped);
                let Intervals::Ramp(ramp) = iterator.run.intervals else { panic!("a ramp") };
                let interval = (due(last, a, 1) - due(next, a, 1)) as u32;
                for off in [-1_000, -2, -1, 0, 1, 2, 1_000] {
                    let guess = interval.cast_signed() + off;
                    assert_eq!(Ramp { guess, ..ramp }.search(), interval, "{a} steps/s², {off} ticks off");
                }
            }
        }
    }

    #[test]
    fn a_ramp_that_has_begun_knows_its_interval_and_guesses_the_next() {
        for (a, first, last) in [(10_000, 200, 1_250), (500_000, 40, 1_600)] {
            let plan = Plan::at_rest(at(0), 0).ramp_to(at(0), I24F8::from_num(MAX_SPEED), a);
            let mut iterator = StepIterator::new(&plan, at(0));
            let mut misses = 0;
            for step in 1..last {
                let at = iterator.next().unwrap().at.ticks();
                assert_eq!(at, due(step, a, 1), "step {step}");
                if step < first {
                    continue;
                }
                let Intervals::Ramp(ramp) = &iterator.run.intervals else { panic!("a ramp") };
                // Both values are rounded, down or up.
                let part = due(step, a, 64).cast_signed() - 64 * at.cast_signed();
                assert!((i64::from(ramp.part) - part).abs() <= 1, "step {step}: {} for {part}", ramp.part);
                let interval = due(step, a, 64) - due(step - 1, a, 64);
                assert!(interval.abs_diff(u64::from(ramp.interval.cast_unsigned())) <= 2, "step {step}");
                misses += u64::from(i64::from(ramp.guess) != (due(step + 1, a, 1) - at).cast_signed());
            }
            // A guess adds several numbers rounded to 1/64 tick, so a few are off by a tick.
            assert!(misses * 10 < last - first, "{misses} guesses miss at {a} steps/s²");
        }
    }

    #[test]
    fn the_factory_move_of_an_md3_is_walked_step_by_step() {
        // 1250 steps in 0.5 s up at 10,000 steps/s², 1.5 s at 5,000 steps/s, and the ramp up mirrored at the
        // end.
        let rates = Limits::even(U24F8::from_num(5_000), 10_000);
        for (steps, forward) in [(10_000, true), (-10_000, false)] {
            let plan = Plan::profile(at(0), 0, steps, rates);
            let up = (1..=1_250).map(|n| due(n, 10_000, 1));
            let cruise = (1..=7_500).map(|n| 8_000_000 + n * 3_200);
            let down = (0..1_250).rev().map(|n| 40_000_000 - due(n, 10_000, 1));
            let steps = up.chain(cruise).chain(down).map(|ticks| Step { at: at(ticks), forward });
            assert!(StepIterator::new(&plan, at(0)).eq(steps));
        }
    }

    #[test]
    fn a_step_at_which_an_axis_turns_round_is_made_there() {
        let ms = |ms: u64| at(ms * 16_000);
        let rates = Limits {
            start_speed: U24F8::from_num(MAX_SPEED),
            deceleration: 7_500,
            ..Limits::even(U24F8::from_num(4_000), 10_000)
        };
        let cruise = Plan::at_rest(at(0), 0).slew(at(0), I24F8::from_num(4_000), rates);
        // At 250 ms the axis has made 1,000 steps. 400 ms from 4,000 steps/s down to 1,000 steps/s take
        // another 1,000 steps.
        let rates = Limits { start_speed: U24F8::from_num(1_000), ..rates };
        let back = cruise.slew(ms(250), I24F8::from_num(-500), rates);
        let turn =
            [(650, true), (652, false), (654, false)].map(|(at, forward)| Step { at: ms(at), forward });
        assert!(StepIterator::new(&back, ms(250)).skip(999).take(3).eq(turn));
    }

    #[test]
    fn the_longest_interval_of_a_ramp_is_walked() {
        // One step takes 256 s. One tick before the first step the axis starts to speed up at 1 step/s²: the
        // next step follows √2 s later.
        let creep = Plan::at_rest(at(0), 0).ramp_to(at(0), I24F8::DELTA, MAX_ACCELERATION);
        let first = StepIterator::new(&creep, at(0)).next().unwrap().at;
        let turn = first - Duration::TICK;
        let jog = creep.ramp_to(turn, I24F8::from_num(9), 1);
        check(&jog, turn, 20);
        let second = StepIterator::new(&jog, first).next().unwrap().at;
        assert!((1_400_u64.millis()..1_415_u64.millis()).contains(&second.since(first)));
    }

    proptest! {
        #[test]
        fn a_short_interval_is_as_exact_as_any(
            a in any::<i32>(), bits in 0_u32..32, speed in 0..1_i64 << 44, phase_left in -STEP..2 * STEP, d in any::<u32>(),
        ) {
            let motion = Motion { acceleration: a >> bits, speed, phase_left };
            let short_limit = motion.short_limit();
            for d in [0, d % (short_limit + 1), short_limit] {
                let (there, same) = (motion.after_short(d), motion.after(i64::from(d)));
                prop_assert_eq!((there.speed, there.phase_left), (same.speed, same.phase_left));
            }
        }

        #[test]
        fn a_walker_makes_the_steps_of_a_profile(
            steps in -3_000..3_000_i32, speed in 1_u32..1_000_000_000, start in 0_u32..1_000_000,
            up in 0_u32..31, down in 0_u32..31, fine in any::<u32>(),
        ) {
            let rates = Limits {
                start_speed: U24F8::from_bits(start),
                max_speed: U24F8::from_bits(speed),
                acceleration: (1 << up) | (fine & ((1 << up) - 1)),
                deceleration: (1 << down) | (fine.rotate_left(7) & ((1 << down) - 1)),
            };
            let plan = Plan::profile(at(5), 7, steps, rates);
            check(&plan, at(5), usize::MAX);
            prop_assert_eq!(StepIterator::new(&plan, at(5)).count(), steps.unsigned_abs() as usize);
        }

        #[test]
        fn a_walker_makes_the_steps_of_a_jog(
            turns in proptest::collection::vec((0_u64..40_000_000, any::<i32>(), 0_u32..22), 1..8),
            acceleration in 0_u32..31,
        ) {
            let mut plan = Plan::at_rest(at(0), 0);
            let mut now = 0;
            for (wait, speed, shift) in turns {
                now += wait;
                plan = plan.ramp_to(at(now), I24F8::from_bits(speed >> shift), 1 << acceleration);
                check(&plan, at(now), 300);
                check(&plan, at(now + wait), 300);
            }
        }
    }
}
