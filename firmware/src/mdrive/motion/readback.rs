//! Readback of the motion in variables: counters, velocity, flags.

use super::Motion;
use super::orders::{Activity, Task};
use crate::device::{Instant, Plan};

impl Motion {
    /// Present plan: C1, but for its preset.
    pub(in crate::mdrive) fn plan(&self) -> &Plan {
        self.motor.plan()
    }

    /// Steps made, of the motor (C1).
    pub(in crate::mdrive) fn steps(&self, at: Instant) -> i32 {
        match self.activity {
            Activity::CircuitDriven { steps, .. } => steps,
            _ => self.motor.position(at).wrapping_add(self.c1),
        }
    }

    /// Presets C1.
    pub(in crate::mdrive) fn set_steps(&mut self, at: Instant, steps: i32) {
        let more = steps.wrapping_sub(self.steps(at));
        self.lag_origin = self.lag_origin.wrapping_add(more);
        match &mut self.activity {
            Activity::CircuitDriven { steps: held, .. } => *held = steps,
            _ => self.c1 = self.c1.wrapping_add(more),
        }
        self.changed = true;
    }

    /// Counts of the encoder (C2).
    pub(in crate::mdrive) fn counts(&self, at: Instant) -> i32 {
        self.encoder.count(at, &self.motor).wrapping_add(self.c2)
    }

    /// Presets C2.
    pub(in crate::mdrive) fn set_counts(&mut self, at: Instant, counts: i32) {
        self.c2 = counts.wrapping_sub(self.encoder.count(at, &self.motor));
        self.changed = true;
    }

    /// P: C1, or C2 with EE = 1.
    pub(super) fn displayed_position(&self, at: Instant) -> i32 {
        if self.settings.closed { self.counts(at) } else { self.steps(at) }
    }

    /// V, in steps/s, or counts/s with EE = 1, rounded.
    pub(in crate::mdrive) fn velocity(&self, at: Instant) -> i32 {
        let speed = match self.activity {
            Activity::Follows if self.settings.follows_at_once() => self.follow.speed().into(),
            Activity::CircuitDriven { .. } => return 0,
            _ => self.motor.plan().speed_at(at),
        };
        self.settings.scale().speed_in_counts(speed)
    }

    /// Returns whether a motion that C1 counts runs, or is about to (MV).
    pub(in crate::mdrive) fn is_moving(&self) -> bool {
        match self.activity {
            Activity::Rest => false,
            Activity::CircuitDriven { .. } => self.waiting.is_some(),
            _ => true,
        }
    }

    /// Returns whether it moves to a position, or will (MP).
    pub(in crate::mdrive) fn is_positioning(&self) -> bool {
        match self.activity {
            Activity::Planning(way) | Activity::Moves(way) | Activity::Settles(Some(way)) => way.ordered,
            _ => matches!(self.waiting, Some(Task::Order(..))) && !self.paused,
        }
    }

    /// Returns whether its speed changes (VC).
    pub(in crate::mdrive) fn is_changing(&self, at: Instant) -> bool {
        self.is_moving() && self.motor.plan().segment_at(at).0.acceleration != 0
    }

    /// Returns whether the encoder is on its index (I6).
    pub(in crate::mdrive) fn is_on_index(&self, at: Instant) -> bool {
        self.encoder.is_on_index(at, &self.motor)
    }

    /// Returns whether it stalled, since ST was cleared (ST).
    pub(in crate::mdrive) fn has_stalled(&self) -> bool {
        self.closed.has_stalled
    }

    /// Writes ST.
    pub(in crate::mdrive) fn set_stalled(&mut self, stalled: bool) {
        self.closed.has_stalled = stalled;
    }

    /// Time at which P comes to be `position` next, after `at`; [`Instant::NEVER`] if it does not. With EE = 1 that
    /// holds only while the shaft keeps its motion.
    pub(in crate::mdrive) fn reaches(&self, at: Instant, position: i32) -> Instant {
        if self.settings.closed {
            self.encoder.reaches(at, &self.motor, position.wrapping_sub(self.c2))
        } else {
            self.reaches_steps(at, position)
        }
    }

    /// Time at which C1 comes to be `steps` next, after `at`, if motion goes on as planned; [`Instant::NEVER`] if it
    /// does not.
    pub(in crate::mdrive) fn reaches_steps(&self, at: Instant, steps: i32) -> Instant {
        if self.is_circuit_driven() {
            return Instant::NEVER;
        }
        self.motor.plan().time_of(at, steps.wrapping_sub(self.c1))
    }

    /// Returns whether its plan or C1 or C2 has changed since the last call: then predictions of
    /// [`Self::reaches_steps`] are void.
    pub(in crate::mdrive) fn has_changed(&mut self) -> bool {
        core::mem::take(&mut self.changed)
    }
}
