//! Step pulses on a board: the work of the step timer's interrupt, and the hand-over of a plan to the
//! interrupt.
//!
//! The interrupt owns a [`StepGenerator`]. At each instant that the generator has requested, it makes a
//! pulse, or changes DIR before a pulse, and returns the next instant. The next step is always computed one
//! step ahead, so the computing time does not move an edge.
//!
//! The main loop owns a [`PlanLoader`]. Planning takes time, and meanwhile the interrupt makes steps of the
//! old plan. So a new plan starts late: steps of the old plan were made that the new plan does not contain,
//! or the first steps of the new plan are missing. The loader counts this difference, for
//! [`Input::StepsCorrection`](crate::device::Input::StepsCorrection). A plan that begins at standstill loses
//! no step: the whole plan is delayed, and the drive's clock waits for the delay ([`shell`](crate::shell)).

use core::mem;

use drivetwin_protocol::time::{Duration, Instant};

use super::{Plan, Step, StepIterator};

/// High time of STEP. If half the interval to the next step is shorter, that applies. A board's pulse may be
/// longer by the time needed to find the next step.
pub const HIGH: Duration = Duration::micros(2);
/// Set-up time of DIR before the first step of a reversal. If half the interval is shorter, that applies.
pub const SETUP: Duration = Duration::micros(5);
/// Time from a change of DIR to a step without a plan. It is as long as the pause between two such steps, so
/// DIR may change at every step even if there is a step every [`CYCLE`].
pub const DIR_SETUP: Duration = Duration::micros(2);
/// The least time between two steps without a plan: a pulse and a pause of the same length.
pub const CYCLE: Duration = Duration::micros(4);

/// Time from loading a delayed plan to its first step.
const LEAD: Duration = Duration::micros(10);

/// The outputs of an axis.
pub trait StepDir {
    /// Sets STEP high.
    fn rise(&mut self);

    /// Sets STEP low, once it has been high for [`HIGH`].
    fn fall(&mut self);

    /// Sets DIR: high is forward.
    fn set_direction(&mut self, forward: bool);

    /// Number of pulses made so far, of both directions; it wraps. 0 if the pulses are not counted.
    fn pulses(&self) -> u32 {
        0
    }
}

/// The outputs of an axis, with a count of the pulses.
#[derive(Debug)]
pub struct Counted<P> {
    pins: P,
    pulses: u32,
}

impl<P> Counted<P> {
    /// A count of the pulses of `pins`, from 0.
    pub const fn new(pins: P) -> Self {
        Self { pins, pulses: 0 }
    }
}

impl<P: StepDir> StepDir for Counted<P> {
    #[inline]
    fn rise(&mut self) {
        self.pins.rise();
        self.pulses = self.pulses.wrapping_add(1);
    }

    #[inline]
    fn fall(&mut self) {
        self.pins.fall();
    }

    fn set_direction(&mut self, forward: bool) {
        self.pins.set_direction(forward);
    }

    fn pulses(&self) -> u32 {
        self.pulses
    }
}

/// Makes the pulses of an axis.
#[derive(Debug)]
pub struct StepGenerator<P> {
    pins: P,
    steps: StepIterator,
    /// The next step of the plan; at [`Instant::NEVER`] if there is none.
    next: Step,
    /// The level of DIR.
    forward: bool,
    /// Time of the next call of [`StepGenerator::fire`].
    due: Instant,
    /// Planned time of the last step. A step without a plan is made `CYCLE` after this time. `step` may replace this
    /// time by a later one to delay the next step without a plan, as if another step had been made at the later time.
    last: Instant,
    /// Steps made along plans, signed; wraps.
    planned_steps: i32,
    /// Steps without a plan that are still to be made, signed.
    unplanned_steps: i32,
}

impl<P: StepDir> StepGenerator<P> {
    /// An axis at standstill, with STEP and DIR low.
    pub const fn new(pins: P) -> Self {
        Self {
            pins,
            steps: StepIterator::done(),
            next: NO_STEP,
            forward: false,
            due: Instant::NEVER,
            last: Instant::ZERO,
            planned_steps: 0,
            unplanned_steps: 0,
        }
    }

    /// Notes that another function uses the pins from now on. The axis stands still, and STEP and DIR are
    /// low.
    pub fn release(&mut self) {
        self.forward = false;
    }

    /// Ends all motion at once, at position 0 of a new [`PlanLoader`], with DIR low. STEP is low between two calls.
    pub fn halt(&mut self) {
        self.steps = StepIterator::done();
        (self.next, self.planned_steps, self.unplanned_steps) = (NO_STEP, 0, 0);
        self.forward = false;
        self.pins.set_direction(false);
        self.schedule();
    }

    /// The level of DIR: true is forward.
    #[must_use]
    pub fn is_forward(&self) -> bool {
        self.forward
    }

    /// Number of pulses made so far, if the outputs [count](StepDir::pulses) them.
    #[must_use]
    pub fn pulses(&self) -> u32 {
        self.pins.pulses()
    }

    /// Time of the next interrupt.
    #[must_use]
    pub fn due(&self) -> Instant {
        self.due
    }

    /// Handles an interrupt of the timer: makes a pulse, or changes DIR before one. Returns the time of the
    /// next interrupt.
    #[inline]
    pub fn fire(&mut self) -> Instant {
        let planned = self.plan_is_next();
        let Step { at, forward } = self.upcoming(planned);
        if at == Instant::NEVER {
            return at;
        }
        if forward != self.forward {
            self.forward = forward;
            self.pins.set_direction(forward);
            self.due = at;
            return at;
        }
        self.pins.rise();
        self.last = at;
        if planned {
            self.planned_steps = self.planned_steps.wrapping_add(sign(self.next));
            self.next = self.steps.next().unwrap_or(NO_STEP);
        } else {
            self.unplanned_steps -= self.unplanned_steps.signum();
        }
        self.pins.fall();
        self.schedule()
    }

    /// Makes steps without a plan from `now` on, signed, at most one every [`CYCLE`].
    pub fn step(&mut self, now: Instant, steps: i32) {
        let begins = self.unplanned_steps == 0;
        self.unplanned_steps = self.unplanned_steps.saturating_add(steps);
        if (self.unplanned_steps > 0) != self.forward {
            self.last = self.last.max(now + DIR_SETUP - CYCLE);
        } else if begins {
            self.last = self.last.max(now - CYCLE);
        }
        self.schedule();
    }

    /// Returns true if the next step belongs to the plan, or if there is no next step.
    fn plan_is_next(&self) -> bool {
        self.unplanned_steps == 0 || self.next.at <= self.last + CYCLE
    }

    fn upcoming(&self, planned: bool) -> Step {
        if planned { self.next } else { Step { at: self.last + CYCLE, forward: self.unplanned_steps > 0 } }
    }

    fn schedule(&mut self) -> Instant {
        let Step { at, forward } = self.upcoming(self.plan_is_next());
        self.due = if forward == self.forward || at == Instant::NEVER {
            at
        } else {
            at - SETUP.min(Duration::from_ticks(at.since(self.last).ticks() / 2))
        };
        self.due
    }
}

const NO_STEP: Step = Step { at: Instant::NEVER, forward: true };

const fn sign(step: Step) -> i32 {
    if step.forward { 1 } else { -1 }
}

/// A step timer as the main loop uses it.
pub trait StepTimer {
    /// Pins of the axis.
    type Pins: StepDir;

    /// The present time of the timer.
    fn now(&self) -> Instant;

    /// Calls `act` with the step generator and the present time while the interrupt is blocked, then sets the
    /// timer to the generator's next instant. Returns `None` if the generator is in use already.
    fn with<R>(&mut self, act: impl FnOnce(&mut StepGenerator<Self::Pins>, Instant) -> R) -> Option<R>;
}

/// Loads the plans of an axis into its step generator.
#[derive(Debug)]
pub struct PlanLoader {
    plan: Plan,
    /// Number of steps by which the pulses are ahead of the plan's position.
    offset: i32,
    next: PendingPlan,
}

/// Deviation of an axis from a plan.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct HandOff {
    /// Steps made beyond the planned ones.
    pub step_skew: i32,
    /// Delay of the whole plan.
    pub delay: Duration,
}

/// A plan that is being loaded into the step generator.
#[derive(Debug)]
struct PendingPlan {
    steps: StepIterator,
    next: Step,
    /// Position before the step `next`.
    position: i32,
}

impl Default for PlanLoader {
    fn default() -> Self {
        Self::new()
    }
}

impl PlanLoader {
    /// A loader for an axis at standstill.
    #[must_use]
    pub fn new() -> Self {
        let next = PendingPlan { steps: StepIterator::done(), next: NO_STEP, position: 0 };
        Self { plan: Plan::at_rest(Instant::ZERO, 0), offset: 0, next }
    }

    /// Makes the axis follow `plan` from now on. The plan has already started when it is loaded.
    pub fn load(&mut self, timer: &mut impl StepTimer, plan: &Plan) -> HandOff {
        let start = plan.start();
        let offset = self.planned_steps(start).wrapping_sub(plan.position_at(start));
        let stands = |stepper: &mut StepGenerator<_>, _| stepper.next.at == Instant::NEVER;
        let stood = self.plan.end() <= start && timer.with(stands) == Some(true);
        let pending = &mut self.next;
        pending.restart(plan, if stood { start } else { timer.now() });
        if !stood {
            // Skips most of the steps that are already past, without blocking the interrupt.
            pending.skip(timer.now());
        }
        let hand_off = timer.with(|stepper, now| {
            let mut delay = Duration::ZERO;
            if stood {
                delay = pending.delay(now);
            } else {
                while stepper.due <= now {
                    stepper.fire();
                }
                pending.skip(now);
            }
            mem::swap(&mut stepper.steps, &mut pending.steps);
            stepper.next = pending.next;
            stepper.schedule();
            HandOff {
                step_skew: stepper.planned_steps.wrapping_sub(pending.position).wrapping_sub(offset),
                delay,
            }
        });
        let Some(hand_off) = hand_off else { return HandOff::default() };
        (self.plan, self.offset) = (plan.delayed(hand_off.delay), offset.wrapping_add(hand_off.step_skew));
        hand_off
    }

    /// Delays the plan by `delay`, for which the drive's time stood still while the pulses continued. The number
    /// of steps by which the pulses are ahead is reported with the next plan.
    pub fn wait(&mut self, delay: Duration) {
        self.plan = self.plan.delayed(delay);
    }

    /// Position of the pulses at `at` if every step was made as planned.
    fn planned_steps(&self, at: Instant) -> i32 {
        self.plan.position_at(at).wrapping_add(self.offset)
    }
}

impl PendingPlan {
    /// Starts with the first step of `plan` after `after`.
    fn restart(&mut self, plan: &Plan, after: Instant) {
        self.steps.restart(plan, after);
        self.next = self.steps.next().unwrap_or(NO_STEP);
        self.position = plan.position_at(after);
    }

    /// Skips the steps up to `now`.
    fn skip(&mut self, now: Instant) {
        while self.next.at <= now {
            self.position = self.position.wrapping_add(sign(self.next));
            self.next = self.steps.next().unwrap_or(NO_STEP);
        }
    }

    /// Delays the whole plan if its first step is due before [`LEAD`] after `now`. Returns the delay.
    fn delay(&mut self, now: Instant) -> Duration {
        let delay = (now + LEAD).since(self.next.at);
        if delay > Duration::ZERO {
            self.steps.delay(delay);
            self.next.at += delay;
        }
        delay
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::{Limits, MAX_ACCELERATION};
    use fixed::types::{I24F8, U24F8};
    use proptest::prelude::*;
    use std::vec::Vec;

    /// A change of the pins: a rise of STEP with the present level of DIR, or the new level of DIR.
    #[derive(Clone, Copy, PartialEq, Eq, Debug)]
    enum Seen {
        Rise(bool),
        Turn(bool),
    }

    #[derive(Default)]
    struct Pins {
        seen: Vec<Seen>,
        high: bool,
        forward: bool,
    }

    impl StepDir for Pins {
        fn rise(&mut self) {
            assert!(!self.high);
            self.high = true;
            self.seen.push(Seen::Rise(self.forward));
        }

        fn fall(&mut self) {
            assert!(self.high);
            self.high = false;
        }

        fn set_direction(&mut self, forward: bool) {
            assert!(!self.high);
            self.forward = forward;
            self.seen.push(Seen::Turn(forward));
        }
    }

    /// A timer with a clock that the test sets. Each reading of the clock advances it by `pace`.
    struct Timer {
        now: core::cell::Cell<u64>,
        pace: u64,
        stepper: StepGenerator<Pins>,
        /// Time of each step and each change of DIR.
        at: Vec<(u64, Seen)>,
    }

    impl Timer {
        fn new(pace: u64) -> Self {
            Self { now: 0.into(), pace, stepper: StepGenerator::new(Pins::default()), at: Vec::new() }
        }

        /// Runs the interrupt for everything that is due by `until`.
        fn run(&mut self, until: u64) {
            while self.stepper.due().ticks() <= until && self.stepper.due() != Instant::NEVER {
                let due = self.stepper.due().ticks();
                self.stepper.fire();
                let seen = self.stepper.pins.seen.drain(..);
                self.at.extend(seen.map(|seen| (due, seen)));
            }
            self.now.set(until.max(self.now.get()));
        }

        fn position(&self) -> i32 {
            self.at.iter().fold(0, |n, (_, seen)| match seen {
                Seen::Rise(forward) => n + if *forward { 1 } else { -1 },
                Seen::Turn(_) => n,
            })
        }
    }

    impl StepTimer for Timer {
        type Pins = Pins;

        fn now(&self) -> Instant {
            self.now.set(self.now.get() + self.pace);
            Instant::from_ticks(self.now.get())
        }

        fn with<R>(&mut self, act: impl FnOnce(&mut StepGenerator<Pins>, Instant) -> R) -> Option<R> {
            let now = self.now();
            self.run(now.ticks());
            let result = act(&mut self.stepper, now);
            let at = self.now.get();
            self.at.extend(self.stepper.pins.seen.drain(..).map(|seen| (at, seen)));
            Some(result)
        }
    }

    fn at(ticks: u64) -> Instant {
        Instant::from_ticks(ticks)
    }

    #[test]
    fn dir_turns_5_us_before_the_step() {
        let mut timer = Timer::new(0);
        let plan = Plan::profile(at(0), 0, 2, Limits::even(U24F8::from_num(1_000), 1_000_000));
        assert_eq!(PlanLoader::new().load(&mut timer, &plan), HandOff::default());
        timer.run(u64::MAX - 1);
        let steps: Vec<u64> = StepIterator::new(&plan, at(0)).map(|step| step.at.ticks()).collect();
        let expected =
            [(steps[0] - 80, Seen::Turn(true)), (steps[0], Seen::Rise(true)), (steps[1], Seen::Rise(true))];
        assert_eq!(timer.at, expected);
    }

    #[test]
    fn steps_without_a_plan_are_4_us_apart() {
        let mut timer = Timer::new(0);
        timer.now.set(1_000);
        timer.stepper.step(at(1_000), -3);
        timer.run(u64::MAX - 1);
        let rises: Vec<u64> = timer.at.iter().map(|(at, _)| *at).collect();
        assert_eq!(rises, [1_000, 1_064, 1_128]);
        assert_eq!(timer.position(), -3);
    }

    #[test]
    fn dir_settles_before_a_step_without_a_plan_however_often_it_turns() {
        let mut timer = Timer::new(0);
        let mut expected = Vec::new();
        // A step every 4 µs, each in the opposite direction of the one before.
        for n in 1..=1_000 {
            let (now, forward) = (64 * n, n % 2 == 1);
            timer.run(now - 1);
            timer.now.set(now);
            timer.stepper.step(at(now), if forward { 1 } else { -1 });
            expected.extend([(now, Seen::Turn(forward)), (now + 32, Seen::Rise(forward))]);
        }
        timer.run(u64::MAX - 1);
        assert_eq!(timer.at, expected);
    }

    #[test]
    fn a_plan_from_standstill_loses_nothing_by_being_late() {
        // The first step is due 0.1 ms after the plan's start; the board gets the plan 1 ms after the start.
        let mut timer = Timer::new(0);
        timer.now.set(16_000);
        let rates =
            Limits { start_speed: U24F8::from_num(10_000), ..Limits::even(U24F8::from_num(20_000), 100_000) };
        let plan = Plan::profile(at(0), 0, 500, rates);
        let hand_off = PlanLoader::new().load(&mut timer, &plan);
        timer.run(u64::MAX - 1);
        let rises = timer.at.iter().filter(|(_, seen)| matches!(seen, Seen::Rise(_))).map(|(at, _)| *at);
        let rises: Vec<u64> = rises.collect();
        let planned: Vec<u64> = StepIterator::new(&plan, at(0)).map(|step| step.at.ticks()).collect();
        assert_eq!((rises.len(), rises[0]), (500, 16_000 + LEAD.ticks()));
        let intervals = |ticks: &[u64]| ticks.windows(2).map(|pair| pair[1] - pair[0]).collect::<Vec<_>>();
        assert_eq!(intervals(&rises), intervals(&planned));
        let delay = Duration::from_ticks(rises[0] - planned[0]);
        assert_eq!(hand_off, HandOff { step_skew: 0, delay });
    }

    #[test]
    fn moves_in_a_row_lose_nothing_if_time_waits_for_them() {
        let mut timer = Timer::new(0);
        let mut loader = PlanLoader::new();
        let rates =
            Limits { start_speed: U24F8::from_num(10_000), ..Limits::even(U24F8::from_num(20_000), 100_000) };
        let (mut start, mut position) = (Instant::ZERO, 0);
        for steps in [500, -500, 2, -2, 1] {
            let plan = Plan::profile(start, position, steps, rates);
            // The board gets each plan 1 ms late.
            timer.run(start.ticks() + 16_000);
            let HandOff { step_skew, delay } = loader.load(&mut timer, &plan);
            assert_eq!(step_skew, 0);
            assert!(delay > Duration::ZERO);
            start = plan.end() + delay;
            position += steps;
        }
        timer.run(u64::MAX - 1);
        assert_eq!(timer.position(), 1);
    }

    #[test]
    fn after_a_halt_a_plan_from_position_0_begins_without_a_skew() {
        let mut timer = Timer::new(0);
        let plan = Plan::at_rest(at(0), 0).ramp_to(at(0), I24F8::from_num(10_000), MAX_ACCELERATION);
        PlanLoader::new().load(&mut timer, &plan);
        timer.run(1_600_000);
        timer.stepper.halt();
        let plan = Plan::at_rest(at(1_600_000), 0);
        assert_eq!(
            PlanLoader::new().load(&mut timer, &plan),
            HandOff { step_skew: 0, delay: Duration::ZERO }
        );
        let plan = Plan::profile(at(1_700_000), 0, 3, Limits::even(U24F8::from_num(100), 1_000));
        assert_eq!(PlanLoader::new().load(&mut timer, &plan).step_skew, 0);
    }

    #[test]
    fn pulses_do_not_wait_for_the_drive() {
        let mut timer = Timer::new(0);
        let mut loader = PlanLoader::new();
        // 0.1 s at 10,000 steps/s.
        let plan = Plan::at_rest(at(0), 0).ramp_to(at(0), I24F8::from_num(10_000), MAX_ACCELERATION);
        let HandOff { delay, .. } = loader.load(&mut timer, &plan);
        let plan = plan.delayed(delay);
        timer.run(1_600_000);
        // The drive's time waits for 1 ms, so the drive assumes the position of 1 ms ago.
        loader.wait(Duration::millis(1));
        let plan = plan.delayed(Duration::millis(1)).halt(at(1_600_000));
        assert_eq!(loader.load(&mut timer, &plan), HandOff { step_skew: 10, delay: Duration::ZERO });
    }

    proptest! {
        /// Plans that are loaded without delay cause no deviation.
        #[test]
        fn nothing_slips_in_no_time(
            turns in proptest::collection::vec((0_u64..4_000_000, -20_000_i32..20_000), 1..12),
            acceleration in 1_000_u32..1_000_000,
        ) {
            let mut timer = Timer::new(0);
            let mut loader = PlanLoader::new();
            let mut plan = Plan::at_rest(at(0), 0);
            let mut start = 0;
            for (wait, speed) in turns {
                start += wait;
                plan = plan.ramp_to(at(start), I24F8::from_num(speed), acceleration);
                timer.run(start);
                let HandOff { step_skew, delay } = loader.load(&mut timer, &plan);
                prop_assert_eq!(step_skew, 0);
                plan = plan.delayed(delay);
            }
            timer.run(start + 4_000_000);
            prop_assert_eq!(timer.position(), plan.position_at(at(start + 4_000_000)));
        }

        /// However late plans are loaded, the pulses end at the plan's position plus the reported deviations.
        #[test]
        fn what_slips_is_told(
            turns in proptest::collection::vec((0_u64..4_000_000, -20_000_i32..20_000, 0_u64..40_000), 1..12),
            pace in 0_u64..400, acceleration in 1_000_u32..1_000_000,
        ) {
            let mut timer = Timer::new(pace);
            let mut loader = PlanLoader::new();
            let mut plan = Plan::at_rest(at(0), 0);
            let (mut start, mut step_skew) = (0, 0);
            // The last order is a stop.
            for (wait, speed, delay) in turns.into_iter().chain([(0, 0, 0)]) {
                start = (start + wait).max(timer.now.get());
                plan = plan.ramp_to(at(start), I24F8::from_num(speed), acceleration);
                timer.run(start + delay);
                let hand_off = loader.load(&mut timer, &plan);
                step_skew += hand_off.step_skew;
                plan = plan.delayed(hand_off.delay);
            }
            timer.run(u64::MAX - 1);
            prop_assert_eq!(timer.position(), plan.position_at(Instant::NEVER) + step_skew);
        }
    }
}
