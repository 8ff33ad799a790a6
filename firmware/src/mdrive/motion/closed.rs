//! Closed loop, EE = 1: the plan is compared with the encoder (MC 7.3.7, 5-18, 5-56, 5-68 to 5-70, 9.6).

use super::Motion;
use super::orders::{Activity, Move};
use super::scale::Scale;
use crate::device::{Context, Duration, Instant, Plan};
use crate::mdrive::error::Error;
use crate::motion::Limits;

/// "After failing 3 attempts Error 92 will be generated" (MC 9.6).
const ATTEMPTS: u8 = 3;

/// Interval of checks while the load turns the shaft.
const CHECK_PERIOD: Duration = Duration::millis(1);

/// Result of the position check at the end of a move.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Verdict {
    InPosition,
    /// Off the target, and a correction has begun.
    Corrected,
    /// Off the target without a correction.
    Off,
}

/// State of the comparison of plan and encoder.
#[derive(Clone, Debug)]
pub(super) struct Closed {
    /// Base of the comparison: plan and encoder at the beginning of a motion or later, and the following
    /// error there. The following error is steps times [`Scale::counts`] minus counts times [`Scale::steps`].
    steps: i32,
    counts: i32,
    following_error: i64,
    /// Time of the next check. The encoder is SF counts behind then, if it stops counting until that time.
    pub(super) due: Instant,
    /// True if a stall was detected in this motion.
    stalled: bool,
    /// ST: true if a stall has occurred since it was cleared.
    pub(super) has_stalled: bool,
    /// Encoder count that position maintenance (PM) keeps, if any.
    encoder_target: Option<i32>,
}

impl Closed {
    pub(super) const NEW: Self = Self {
        steps: 0,
        counts: 0,
        following_error: 0,
        due: Instant::NEVER,
        stalled: false,
        has_stalled: false,
        encoder_target: None,
    };

    /// Following error: how far the encoder is behind the plan.
    fn following_error(&self, scale: Scale, steps: i32, counts: i32) -> i64 {
        let (steps, counts) = (steps.wrapping_sub(self.steps), counts.wrapping_sub(self.counts));
        self.following_error + i64::from(steps) * scale.counts - i64::from(counts) * scale.steps
    }

    /// Moves the base to these positions. The following error stays the same.
    pub(super) fn rebase(&mut self, scale: Scale, steps: i32, counts: i32) {
        self.following_error = self.following_error(scale, steps, counts);
        (self.steps, self.counts) = (steps, counts);
    }
}

impl Motion {
    /// Starts the comparison of plan and encoder at the beginning of a motion.
    pub(super) fn watch_from(&mut self, at: Instant) {
        self.closed.steps = self.motor.position(at);
        self.closed.counts = self.encoder.count(at, &self.motor);
        (self.closed.following_error, self.closed.stalled) = (0, false);
    }

    fn following_error(&self, at: Instant) -> i64 {
        let count = self.encoder.count(at, &self.motor);
        self.closed.following_error(self.settings.scale(), self.motor.position(at), count)
    }

    /// Following error at which a stall is detected.
    fn stalls_at(&self) -> i64 {
        i64::from(self.settings.stall_factor.max(1)) * self.settings.scale().steps
    }

    /// Returns true if a stall would be detected now.
    fn watches(&self) -> bool {
        self.settings.closed && !self.is_idle() && !self.closed.stalled
    }

    /// Returns true if PM is in effect, which requires that the bridge is on.
    fn maintains(&self) -> bool {
        self.settings.closed && self.settings.maintains && self.settings.enabled
    }

    /// Time at which the load turns the shaft out of the deadband DB, while PM keeps the position.
    fn leaves_deadband(&self, at: Instant) -> Instant {
        let Some(encoder_target) =
            self.closed.encoder_target.filter(|_| self.maintains() && self.activity == Activity::Rest)
        else {
            return Instant::NEVER;
        };
        let off = i32::from(self.settings.deadband) + 1;
        let reaches = |count| self.encoder.reaches(at, &self.motor, count);
        reaches(encoder_target.wrapping_add(off)).min(reaches(encoder_target.wrapping_sub(off)))
    }

    /// Computes the time of the next check, at which the encoder will be too far behind if it stops counting.
    /// The built-in encoder needs no check while the shaft follows the plan.
    pub(super) fn watch(&mut self, at: Instant) {
        self.closed.due = self.leaves_deadband(at);
        let follows = self.motor.follows() && !self.motor.is_too_fast();
        if !self.watches() || !self.encoder.is_remote() && follows {
            return;
        }
        let (following_error, most) = (self.following_error(at), self.stalls_at());
        if following_error.abs() >= most {
            self.closed.due = at;
            return;
        }
        if self.motor.slides() {
            self.closed.due = at + CHECK_PERIOD;
        }
        let (here, counts) = (self.motor.position(at), self.settings.scale().counts);
        let up = |movement: i64| movement.checked_add(counts - 1)?.checked_div(counts);
        for movement in [up(most - following_error), up(most + following_error).map(|movement| -movement)] {
            if let Some(movement) = movement.and_then(|movement| i32::try_from(movement).ok()) {
                let due = self.motor.plan().time_of(at, here.wrapping_add(movement));
                self.closed.due = self.closed.due.min(due);
            }
        }
    }

    /// Handles an encoder count that may have changed.
    pub(super) fn counted(&mut self, at: Instant, out: &mut dyn Context) {
        self.check_stall(at, out);
        self.maintain(at, out);
    }

    /// With SM = 1 the field continues to turn after a stall. Once the shaft is in step again, it can stall
    /// again.
    fn recover(&mut self, at: Instant) {
        let continuous = self.closed.stalled && self.settings.goes_on_stalled && !self.is_idle();
        if continuous && !self.encoder.is_remote() && self.motor.is_in_step(at) {
            self.watch_from(at);
        }
    }

    /// Reports a stall, and stops the motion unless SM is 1.
    pub(super) fn check_stall(&mut self, at: Instant, out: &mut dyn Context) {
        self.recover(at);
        if !self.watches() || self.following_error(at).abs() < self.stalls_at() {
            return;
        }
        self.tell_stall();
        if !self.settings.goes_on_stalled {
            self.clear_waiting();
            self.stop_at_once(at, out);
        }
    }

    fn tell_stall(&mut self) {
        self.closed.stalled = true;
        self.closed.has_stalled = true;
        self.fail(Error::Stall);
    }

    /// Counts from the encoder's position to its target; `None` if that is within DB.
    fn off(&self, at: Instant, encoder_target: i32) -> Option<i32> {
        let off = encoder_target.wrapping_sub(self.encoder.count(at, &self.motor));
        (off.unsigned_abs() > u32::from(self.settings.deadband)).then_some(off)
    }

    /// Checks the position at the end of a move. With EE = 1 the target of the move is kept from then on.
    pub(super) fn check_position(&mut self, at: Instant, movement: Move, out: &mut dyn Context) -> Verdict {
        let Some(encoder_target) = movement.encoder_target.filter(|_| self.settings.closed) else {
            return Verdict::InPosition;
        };
        self.closed.encoder_target = Some(encoder_target);
        match self.off(at, encoder_target) {
            Some(_) if movement.tries >= ATTEMPTS => {
                self.fail(Error::PositionError);
                self.closed.encoder_target = None;
                Verdict::Off
            }
            Some(off) if self.correct(at, movement, off, out) => Verdict::Corrected,
            Some(_) => Verdict::Off,
            None => Verdict::InPosition,
        }
    }

    /// Begins a correction at VI (MC 5-56). Returns true if one has begun.
    fn correct(&mut self, at: Instant, movement: Move, off: i32, out: &mut dyn Context) -> bool {
        let Some(steps) = self.steps_of(self.counts(at), off) else { return false };
        if self.is_barred(off < 0) {
            self.fail_at_limit(off < 0);
            self.closed.encoder_target = None;
            return false;
        }
        let rates = self.settings.rates();
        let from = self.motor.position(at);
        let rates = Limits { max_speed: rates.start_speed, ..rates };
        self.start_plan(at, Plan::profile(at, from, steps, rates), out);
        let movement = Move { target: from.wrapping_add(steps), tries: movement.tries + 1, ..movement };
        self.enter(Activity::Moves(movement), self.motor.plan().end());
        true
    }

    /// Makes the present position the one that PM keeps.
    pub(super) fn keep(&mut self, at: Instant) {
        self.closed.encoder_target = self.settings.closed.then(|| self.encoder.count(at, &self.motor));
    }

    /// PM: brings back a shaft that is at rest and was forced out of the range DB. If the distance counts as
    /// a stall, SM must be 1 (MC 5-56). While the bridge is off nothing happens.
    pub(super) fn maintain(&mut self, at: Instant, out: &mut dyn Context) {
        let (Activity::Rest, true, Some(encoder_target)) =
            (self.activity, self.maintains(), self.closed.encoder_target)
        else {
            return;
        };
        let Some(off) = self.off(at, encoder_target) else { return };
        let stalls_at = u32::from(self.settings.stall_factor.max(1));
        if !self.settings.goes_on_stalled && off.unsigned_abs() >= stalls_at {
            self.tell_stall();
            self.closed.encoder_target = None;
            return;
        }
        self.correct(at, Move::back_to(encoder_target), off, out);
    }
}
