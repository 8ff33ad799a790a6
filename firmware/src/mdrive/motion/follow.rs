//! Following the clock inputs with the motor (MC 5-13, 5-14).
//!
//! At a ratio of 1.000 the motor makes each step when it is requested. At any other ratio the requested speed
//! is sampled every millisecond and approached with A and D. When the clock has stopped, the remaining
//! distance is made as a move.

use fixed::types::I24F8;

use super::shaft::Shaft;
use crate::device::{Duration, Instant};
use drivetwin_protocol::time::TICKS_PER_SECOND;

/// Interval at which the speed is computed.
pub(super) const CHECK_PERIOD: Duration = Duration::millis(1);
/// A clock without an edge for this time counts as stopped.
const QUIET: Duration = Duration::millis(10);

/// Reaction to the clock, once per interval.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Pursuit {
    /// The plan is as it should be.
    Continues,
    /// Ramp to the speed of the clock.
    Slew(I24F8),
    /// Move by the remaining distance.
    Move(i32),
    /// The clock has stopped, and all steps are made.
    Ends,
}

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

    /// Begins at a position.
    pub(super) fn begin(at: Instant, position: i32) -> Self {
        Self { target: position, before: at, ..Self::NEW }
    }

    /// Speed of the clock, in steps/s.
    pub(super) fn speed(&self) -> I24F8 {
        self.speed
    }

    /// Adds requested steps.
    pub(super) fn take(&mut self, at: Instant, steps: i32) {
        self.target = self.target.wrapping_add(steps);
        self.steps = self.steps.saturating_add(steps);
        self.last = at;
    }

    /// Computes the speed of the clock. Returns the reaction of a motor that follows with ramps, or at once.
    pub(super) fn pursue(&mut self, at: Instant, shaft: &Shaft, ramps: bool) -> Pursuit {
        let before = self.speed;
        self.update_speed(at);
        let stands = shaft.plan().end() <= at;
        let left = self.target.wrapping_sub(shaft.position(at));
        if ramps && (self.speed != before || stands && self.speed != 0) {
            Pursuit::Slew(self.speed)
        } else if !stands || at.since(self.last) < QUIET {
            Pursuit::Continues
        } else if left != 0 {
            Pursuit::Move(left)
        } else {
            Pursuit::Ends
        }
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
