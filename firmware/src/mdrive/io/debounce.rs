//! Debouncing: a level takes effect once it has lasted long enough.

use crate::device::{Duration, Instant};

/// The level in effect, and the time at which the other level takes effect.
#[derive(Clone, Copy, Debug)]
pub(super) struct Debounce {
    pub(super) level: bool,
    /// Time at which the other level will have lasted long enough; [`Instant::NEVER`] if the input does not
    /// have it.
    pub(super) due: Instant,
}

impl Debounce {
    pub(super) const fn new(level: bool) -> Self {
        Self { level, due: Instant::NEVER }
    }

    /// Sets the level of the input, which takes effect once it has lasted for `min_time`. Returns true if
    /// another level takes effect now.
    pub(super) fn sample(&mut self, at: Instant, level: bool, min_time: Duration) -> bool {
        if level == self.level {
            self.due = Instant::NEVER;
            return false;
        }
        if min_time == Duration::ZERO {
            *self = Self::new(level);
            return true;
        }
        self.due = self.due.min(at + min_time);
        false
    }

    /// Returns true if another level takes effect now, because it has lasted long enough.
    pub(super) fn timeout(&mut self, at: Instant) -> bool {
        let changes = self.due <= at;
        if changes {
            *self = Self::new(!self.level);
        }
        changes
    }
}
