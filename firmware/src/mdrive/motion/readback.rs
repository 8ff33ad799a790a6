//! Values of the motion for variables: counters, velocity, flags.

use super::Motion;
use super::orders::{Activity, Task};
use crate::device::{Instant, Plan};

impl Motion {
    /// Present plan. Its position is C1 without C1's preset.
    pub(in crate::mdrive) fn plan(&self) -> &Plan {
        self.motor.plan()
    }

    /// C1: steps that the motor has made.
    pub(in crate::mdrive) fn steps(&self, at: Instant) -> i32 {
        match self.activity {
            Activity::CircuitDriven { steps, .. } => steps,
            _ => self.motor.position(at).wrapping_add(self.c1),
        }
    }

    /// Sets C1.
    pub(in crate::mdrive) fn set_steps(&mut self, at: Instant, steps: i32) {
        let more = steps.wrapping_sub(self.steps(at));
        self.lag_origin = self.lag_origin.wrapping_add(more);
        match &mut self.activity {
            Activity::CircuitDriven { steps: held, .. } => *held = steps,
            _ => self.c1 = self.c1.wrapping_add(more),
        }
        self.changed = true;
    }

    /// C2: counts of the encoder.
    pub(in crate::mdrive) fn counts(&self, at: Instant) -> i32 {
        self.encoder.count(at, &self.motor).wrapping_add(self.c2)
    }

    /// Sets C2.
    pub(in crate::mdrive) fn set_counts(&mut self, at: Instant, counts: i32) {
        self.c2 = counts.wrapping_sub(self.encoder.count(at, &self.motor));
        self.changed = true;
    }

    /// P: C1, or C2 with EE = 1.
    pub(in crate::mdrive) fn displayed_position(&self, at: Instant) -> i32 {
        if self.settings.closed { self.counts(at) } else { self.steps(at) }
    }

    /// Returns true if the user's units are counts (EE).
    pub(in crate::mdrive) fn is_closed(&self) -> bool {
        self.settings.closed
    }

    /// V: velocity in steps/s, or counts/s with EE = 1, rounded.
    pub(in crate::mdrive) fn velocity(&self, at: Instant) -> i32 {
        let speed = match self.activity {
            Activity::Follows if self.settings.follows_at_once() => self.follow.speed().into(),
            Activity::CircuitDriven { .. } => return 0,
            _ => self.motor.plan().speed_at(at),
        };
        self.settings.scale().speed_in_counts(speed)
    }

    /// Returns true if a motion that C1 counts is in progress or about to begin (MV).
    pub(in crate::mdrive) fn is_moving(&self) -> bool {
        match self.activity {
            Activity::Rest => false,
            Activity::CircuitDriven { .. } => self.waiting.is_some(),
            _ => true,
        }
    }

    /// Returns true if a move to a position is in progress or waiting (MP).
    pub(in crate::mdrive) fn is_positioning(&self) -> bool {
        match self.activity {
            Activity::Planning(way) | Activity::Moves(way) | Activity::Settles(Some(way)) => way.ordered,
            _ => matches!(self.waiting, Some(Task::Order(..))) && !self.paused,
        }
    }

    /// Returns true if the speed changes (VC).
    pub(in crate::mdrive) fn is_changing(&self, at: Instant) -> bool {
        self.is_moving() && self.motor.plan().segment_at(at).0.acceleration != 0
    }

    /// Returns true if the encoder is on its index (I6).
    pub(in crate::mdrive) fn is_on_index(&self, at: Instant) -> bool {
        self.encoder.is_on_index(at, &self.motor)
    }

    /// Returns true if the motor has stalled since ST was cleared (ST).
    pub(in crate::mdrive) fn has_stalled(&self) -> bool {
        self.closed.has_stalled
    }

    /// Writes ST.
    pub(in crate::mdrive) fn set_stalled(&mut self, stalled: bool) {
        self.closed.has_stalled = stalled;
    }

    /// Next time after `at` at which P is `position`; [`Instant::NEVER`] if there is none. With EE = 1 the
    /// result is valid only until the shaft changes its motion.
    pub(in crate::mdrive) fn reaches(&self, at: Instant, position: i32) -> Instant {
        if self.settings.closed {
            self.encoder.reaches(at, &self.motor, position.wrapping_sub(self.c2))
        } else {
            self.reaches_steps(at, position)
        }
    }

    /// Next time after `at` at which C1 is `steps`, if the plan does not change; [`Instant::NEVER`] if there
    /// is none.
    pub(in crate::mdrive) fn reaches_steps(&self, at: Instant, steps: i32) -> Instant {
        if self.is_circuit_driven() {
            return Instant::NEVER;
        }
        self.motor.plan().time_of(at, steps.wrapping_sub(self.c1))
    }

    /// Returns true if the plan, C1 or C2 has changed since the last call. Earlier predictions of
    /// [`Self::reaches_steps`] are invalid then.
    pub(in crate::mdrive) fn has_changed(&mut self) -> bool {
        core::mem::take(&mut self.changed)
    }
}
