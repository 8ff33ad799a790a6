//! A level that counts once it has lasted.

use crate::device::{Duration, Instant};

/// The level in effect, and how long the other one is there.
#[derive(Clone, Copy, Debug)]
pub(super) struct Debounce {
    pub(super) level: bool,
    /// Time at which the other level will have lasted long enough; [`Instant::NEVER`] if it is not there.
    pub(super) due: Instant,
}

impl Debounce {
    pub(super) const fn new(level: bool) -> Self {
        Self { level, due: Instant::NEVER }
    }

    /// Sets the level, which counts once that has lasted for `min_time`. Returns whether another one counts now.
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

    /// Returns whether another level counts now because it has lasted.
    pub(super) fn timeout(&mut self, at: Instant) -> bool {
        let changes = self.due <= at;
        if changes {
            *self = Self::new(!self.level);
        }
        changes
    }
}
