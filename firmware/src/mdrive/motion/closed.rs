//! Closed loop, EE = 1: the plan is compared with the encoder (MC 7.3.7, 5-18, 5-56, 5-68 to 5-70, 9.6).
//!
//! [`Closed`] finds stalls and positions that are off. Motion stops or corrects the motor.

use super::Settings;
use super::shaft::Shaft;
use super::{Activity, Move};
use crate::device::{Duration, Instant};

/// "After failing 3 attempts Error 92 will be generated" (MC 9.6).
const ATTEMPTS: u8 = 3;

/// Interval of checks while the load turns the shaft.
const CHECK_PERIOD: Duration = Duration::millis(1);

/// Result of the position check at the end of a move.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Verdict {
    InPosition,
    /// Off the target by these counts.
    Off(i32),
    /// Off the target after the last attempt to correct it.
    Failed,
}

/// Result of the position check at rest (PM).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Drift {
    None,
    /// The distance counts as a stall.
    Stall,
    /// Off the position that is kept, by these counts.
    From {
        target: i32,
        off: i32,
    },
}

/// State of the comparison of plan and encoder.
#[derive(Clone, Debug)]
pub(super) struct Closed {
    /// Base of the comparison: plan and encoder at the beginning of a motion or later, and the following
    /// error there, as [`Scale::lag`](super::scale::Scale::lag).
    steps: i32,
    counts: i32,
    following_error: i64,
    /// Time of the next check. The encoder is SF counts behind then, if it stops counting until that time.
    due: Instant,
    /// True if a stall was detected in this motion.
    stalled: bool,
    /// ST: true if a stall has occurred since it was cleared.
    has_stalled: bool,
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

    /// Time of the next check.
    pub(super) fn deadline(&self) -> Instant {
        self.due
    }

    /// ST.
    pub(super) fn has_stalled(&self) -> bool {
        self.has_stalled
    }

    /// Writes ST.
    pub(super) fn set_stalled(&mut self, stalled: bool) {
        self.has_stalled = stalled;
    }

    /// Starts the comparison of plan and encoder at the beginning of a motion.
    pub(super) fn begin(&mut self, at: Instant, shaft: &Shaft) {
        (self.steps, self.counts) = (shaft.position(at), shaft.count(at));
        (self.following_error, self.stalled) = (0, false);
    }

    /// Moves the base of the comparison to the present positions, so that compared positions stay within 32 bits
    /// of each other. The following error stays the same.
    pub(super) fn rebase(&mut self, at: Instant, shaft: &Shaft, settings: &Settings) {
        self.following_error = self.following_error(at, shaft, settings);
        (self.steps, self.counts) = (shaft.position(at), shaft.count(at));
    }

    /// Following error: how far the encoder is behind the plan.
    fn following_error(&self, at: Instant, shaft: &Shaft, settings: &Settings) -> i64 {
        let steps = shaft.position(at).wrapping_sub(self.steps);
        let counts = shaft.count(at).wrapping_sub(self.counts);
        self.following_error + settings.scale().lag(steps, counts)
    }

    /// Returns true if a stall would be detected now.
    fn watches(&self, settings: &Settings, activity: &Activity) -> bool {
        settings.closed && !activity.is_idle() && !self.stalled
    }

    /// Computes the time of the next check, at which the encoder will be too far behind if it stops counting.
    /// The built-in encoder needs no check while the shaft follows the plan.
    pub(super) fn watch(&mut self, at: Instant, shaft: &Shaft, settings: &Settings, activity: &Activity) {
        self.due = self.leaves_deadband(at, shaft, settings, activity);
        let follows = shaft.follows() && !shaft.is_too_fast();
        if !self.watches(settings, activity) || !shaft.has_remote_encoder() && follows {
            return;
        }
        let (following_error, most) = (self.following_error(at, shaft, settings), stall_lag(settings));
        if following_error.abs() >= most {
            self.due = at;
            return;
        }
        if shaft.slides() {
            self.due = at + CHECK_PERIOD;
        }
        let (here, scale) = (shaft.position(at), settings.scale());
        let forth = scale.steps_of_lag(most - following_error);
        let back = scale.steps_of_lag(most + following_error).map(|steps| -steps);
        for steps in [forth, back] {
            if let Some(steps) = steps.and_then(|steps| i32::try_from(steps).ok()) {
                self.due = self.due.min(shaft.plan().time_of(at, here.wrapping_add(steps)));
            }
        }
    }

    /// Time at which the load turns the shaft out of the deadband DB, while PM keeps the position.
    fn leaves_deadband(
        &self,
        at: Instant,
        shaft: &Shaft,
        settings: &Settings,
        activity: &Activity,
    ) -> Instant {
        let keeps = settings.keeps_position() && activity.is_rest();
        let Some(target) = self.encoder_target.filter(|_| keeps) else { return Instant::NEVER };
        let off = i32::from(settings.deadband) + 1;
        let reaches = |count| shaft.reaches_count(at, count);
        reaches(target.wrapping_add(off)).min(reaches(target.wrapping_sub(off)))
    }

    /// Handles an encoder count that may have changed. Returns true if the motor has just stalled.
    pub(super) fn stalls(
        &mut self,
        at: Instant,
        shaft: &Shaft,
        settings: &Settings,
        activity: &Activity,
    ) -> bool {
        // With SM = 1 the field continues to turn after a stall. Once the shaft is in step again, it can stall
        // again.
        let continues = self.stalled && settings.goes_on_stalled && !activity.is_idle();
        if continues && !shaft.has_remote_encoder() && shaft.is_in_step(at) {
            self.begin(at, shaft);
        }
        let stalls = self.watches(settings, activity)
            && self.following_error(at, shaft, settings).abs() >= stall_lag(settings);
        if stalls {
            (self.stalled, self.has_stalled) = (true, true);
        }
        stalls
    }

    /// Checks the position at the end of a move. With EE = 1 the target of the move is kept from then on.
    pub(super) fn check(
        &mut self,
        at: Instant,
        movement: &Move,
        shaft: &Shaft,
        settings: &Settings,
    ) -> Verdict {
        let Some(target) = movement.encoder_target.filter(|_| settings.closed) else {
            return Verdict::InPosition;
        };
        self.encoder_target = Some(target);
        match off(at, target, shaft, settings) {
            Some(_) if movement.tries >= ATTEMPTS => {
                self.encoder_target = None;
                Verdict::Failed
            }
            Some(off) => Verdict::Off(off),
            None => Verdict::InPosition,
        }
    }

    /// Makes the present position the one that PM keeps.
    pub(super) fn keep(&mut self, at: Instant, shaft: &Shaft, settings: &Settings) {
        self.encoder_target = settings.closed.then(|| shaft.count(at));
    }

    /// Makes PM keep no position, because it cannot be reached.
    pub(super) fn give_up(&mut self) {
        self.encoder_target = None;
    }

    /// PM: checks if a shaft at rest was forced out of the range DB. If the distance counts as a stall, SM must
    /// be 1 to correct it (MC 5-56). While the bridge is off nothing happens.
    pub(super) fn drift(
        &mut self,
        at: Instant,
        shaft: &Shaft,
        settings: &Settings,
        activity: &Activity,
    ) -> Drift {
        if !activity.is_rest() || !settings.keeps_position() {
            return Drift::None;
        }
        let Some(target) = self.encoder_target else { return Drift::None };
        match off(at, target, shaft, settings) {
            None => Drift::None,
            Some(off)
                if settings.goes_on_stalled
                    || off.unsigned_abs() < settings.stall_counts().unsigned_abs() =>
            {
                Drift::From { target, off }
            }
            Some(_) => {
                (self.stalled, self.has_stalled) = (true, true);
                self.encoder_target = None;
                Drift::Stall
            }
        }
    }
}

/// Following error at which a stall is detected.
fn stall_lag(settings: &Settings) -> i64 {
    settings.scale().lag(0, -settings.stall_counts())
}

/// Counts from the encoder's position to its target; `None` if that is within DB.
fn off(at: Instant, target: i32, shaft: &Shaft, settings: &Settings) -> Option<i32> {
    let off = target.wrapping_sub(shaft.count(at));
    (off.unsigned_abs() > u32::from(settings.deadband)).then_some(off)
}
