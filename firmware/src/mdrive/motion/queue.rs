//! Tasks that wait: for the end of the present motion, or for RS (MC 5-57, 5-61; MDRIVE-18).

use super::{Move, Order};
use crate::device::Instant;
use crate::mdrive::reasons::Why;

/// A task that begins later.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Task {
    /// MA or MR, and the time at which its calculation is complete.
    Order(Order, Instant),
    /// A move that PS has interrupted.
    Move(Move),
    Slew(i32),
    Home(Order),
    /// The jog that the contacts request when the task begins.
    Jog,
}

/// The waiting task, and the pause by PS.
#[derive(Clone, Debug)]
pub(super) struct Queue {
    /// Task that begins when the present motion has ended.
    waiting: Option<Task>,
    /// True from PS to RS: no task begins.
    paused: bool,
    /// The task that PS has interrupted.
    interrupted: Option<Task>,
}

impl Queue {
    pub(super) const EMPTY: Self = Self { waiting: None, paused: false, interrupted: None };

    /// Makes a task the waiting one, in place of another; `None` only removes the other.
    pub(super) fn set(&mut self, task: Option<Task>) {
        self.waiting = task;
    }

    /// Makes the task of a command the waiting one. Returns the reason why the task does not begin now: `why`,
    /// unless there is a more special reason.
    pub(super) fn wait(&mut self, task: Task, why: Why) -> Result<(), Why> {
        Err(match self.waiting.replace(task) {
            Some(_) => Why::TakesPlace,
            None if self.paused => Why::Paused,
            None => why,
        })
    }

    /// Takes the waiting task, unless PS holds it.
    pub(super) fn next(&mut self) -> Option<Task> {
        self.waiting.take_if(|_| !self.paused)
    }

    pub(super) fn is_waiting(&self) -> bool {
        self.waiting.is_some()
    }

    /// Returns true if MA or MR waits for the end of a motion.
    pub(super) fn holds_move(&self) -> bool {
        matches!(self.waiting, Some(Task::Order(..))) && !self.paused
    }

    /// PS: pauses, and stores the task that it interrupts, if any.
    pub(super) fn pause(&mut self, interrupted: Option<Task>) {
        self.paused = true;
        self.interrupted = interrupted.or(self.interrupted);
    }

    /// RS: ends the pause. Returns false if there is none.
    pub(super) fn resume(&mut self) -> bool {
        core::mem::take(&mut self.paused)
    }

    /// Takes the task that PS has interrupted.
    pub(super) fn take_interrupted(&mut self) -> Option<Task> {
        self.interrupted.take()
    }

    #[cfg(test)]
    pub(super) fn is_paused(&self) -> bool {
        self.paused
    }
}
