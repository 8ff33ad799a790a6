//! Following the clock inputs with the motor (MC 5-13, 5-14).
//!
//! At a ratio of 1.000 the motor makes each step when it is requested. At any other ratio the requested speed
//! is sampled every millisecond and approached with A and D. When the clock has stopped, the remaining
//! distance is made as a move.

use fixed::types::I24F8;

use super::orders::Activity;
use super::{Motion, Settings};
use crate::device::{Context, Duration, Instant, Plan};
use drivetwin_protocol::time::TICKS_PER_SECOND;

/// Interval at which the speed is computed.
const CHECK_PERIOD: Duration = Duration::millis(1);
/// A clock without an edge for this time counts as stopped.
const QUIET: Duration = Duration::millis(10);

/// Value of CR at which the motor follows without ramps.
const AT_ONCE: u16 = 1_000;

/// State of following a clock.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Follow {
    /// Position that the plan is to reach.
    target: i32,
    /// Steps since the last computation of the speed, and the time of the last step.
    steps: i32,
    last: Instant,
    /// Time of the last step that the previous computation included.
    before: Instant,
    speed: I24F8,
}

impl Follow {
    pub(super) const NEW: Self =
        Self { target: 0, steps: 0, last: Instant::ZERO, before: Instant::ZERO, speed: I24F8::ZERO };

    /// Speed of the clock, in steps/s.
    pub(super) fn speed(&self) -> I24F8 {
        self.speed
    }

    /// Adds requested steps.
    fn take(&mut self, at: Instant, steps: i32) {
        self.target = self.target.wrapping_add(steps);
        self.steps = self.steps.saturating_add(steps);
        self.last = at;
    }

    /// Computes the speed from the steps since the last computation.
    fn update_speed(&mut self, at: Instant) {
        if self.last > self.before {
            let ticks = self.last.since(self.before).ticks().cast_signed();
            let way = i64::from(self.steps) * (TICKS_PER_SECOND << 8).cast_signed();
            let bits = way.checked_div(ticks).unwrap_or(0);
            let most = i64::from(I24F8::MAX.to_bits());
            self.speed = I24F8::from_bits(bits.clamp(-most, most) as i32);
            (self.steps, self.before) = (0, self.last);
        } else if at.since(self.last) >= QUIET {
            self.speed = I24F8::ZERO;
        }
    }
}

impl Settings {
    /// Returns true if the motor follows the clock without ramps.
    pub(super) fn follows_at_once(&self) -> bool {
        self.ratio == AT_ONCE
    }
}

impl Motion {
    /// Makes steps that the clock inputs request. They are ignored during any other motion.
    pub(in crate::mdrive) fn follow(&mut self, at: Instant, steps: i32, out: &mut dyn Context) {
        let begins = self.activity == Activity::Rest;
        if !self.settings.follows_clock || !begins && self.activity != Activity::Follows {
            return;
        }
        if begins {
            self.watch_from(at);
            self.follow = Follow { target: self.motor.position(at), before: at, ..Follow::NEW };
            self.enter(Activity::Follows, at + CHECK_PERIOD);
        }
        self.follow.take(at, steps);
        if self.settings.follows_at_once() {
            self.motor.step(at, steps, out);
            self.changed = true;
        }
        self.refresh(at, out);
    }

    /// Computes the speed of the clock and adapts the plan, once per interval.
    pub(super) fn follow_on(&mut self, at: Instant, out: &mut dyn Context) {
        self.due = at + CHECK_PERIOD;
        let before = self.follow.speed;
        self.follow.update_speed(at);
        let Follow { speed, target, last, .. } = self.follow;
        let (plan, rates) = (self.motor.plan(), self.settings.rates());
        let (here, stands) = (self.motor.position(at), plan.end() <= at);
        let (left, is_quiet) = (target.wrapping_sub(here), at.since(last) >= QUIET);
        let ramps = !self.settings.follows_at_once();
        if ramps && (speed != before || stands && speed != 0) {
            let plan = plan.slew(at, speed, rates);
            self.start_plan(at, plan, out);
        } else if is_quiet && stands && left != 0 {
            self.start_plan(at, Plan::profile(at, here, left, rates), out);
        } else if is_quiet && stands {
            self.start_settling(at, None, out);
        }
    }

    /// Ends following the clock. CM has changed, or CR between with ramps and without ramps (MDRIVE-33).
    pub(super) fn end_following(&mut self, at: Instant, out: &mut dyn Context) {
        if self.activity == Activity::Follows {
            self.ramp_down(at, false, out);
        }
    }
}
