//! Debouncing and delays: a level takes effect once it has lasted long enough. A level that ends in the very instant in
//! which it would take effect is dropped, unless the drive handles that instant's [`timeout`](Debounce::timeout) first.

use crate::device::{Duration, Instant};

/// The level in effect, and the time at which the other level takes effect. Each change of the input is a
/// [`sample`](Self::sample), or, if all inputs of an instant must be known first, a [`note`](Self::note). At the
/// [deadline](Self::due) follows a [`timeout`](Self::timeout).
#[derive(Clone, Copy, Debug)]
pub struct Debounce {
    level: bool,
    due: Instant,
}

impl Debounce {
    /// An input with this level, which is in effect.
    #[must_use]
    pub const fn new(level: bool) -> Self {
        Self { level, due: Instant::NEVER }
    }

    /// The level in effect.
    #[must_use]
    pub fn level(&self) -> bool {
        self.level
    }

    /// Time at which the other level will have lasted long enough; [`Instant::NEVER`] if the input does not have it.
    #[must_use]
    pub fn due(&self) -> Instant {
        self.due
    }

    /// Sets the level of the input, which takes effect at the [`timeout`](Self::timeout) once it has lasted for `lasting`.
    pub fn note(&mut self, at: Instant, level: bool, lasting: Duration) {
        self.due = if level == self.level { Instant::NEVER } else { self.due.min(at + lasting) };
    }

    /// Sets the level of the input, which takes effect once it has lasted for `lasting`. Returns true if another level takes
    /// effect now.
    pub fn sample(&mut self, at: Instant, level: bool, lasting: Duration) -> bool {
        self.note(at, level, lasting);
        self.timeout(at)
    }

    /// Sets a condition that takes effect once it has lasted for `lasting`, and ends at once (on-delay). Returns true if it is
    /// in effect.
    pub fn has_lasted(&mut self, at: Instant, condition: bool, lasting: Duration) -> bool {
        self.sample(at, condition, if condition { lasting } else { Duration::ZERO });
        self.level
    }

    /// Returns true if another level takes effect now, because it has lasted long enough.
    pub fn timeout(&mut self, at: Instant) -> bool {
        let changes = self.due <= at;
        if changes {
            *self = Self::new(!self.level);
        }
        changes
    }

    /// Drops a level that is not in effect yet.
    pub fn cancel(&mut self) {
        self.due = Instant::NEVER;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LASTING: Duration = Duration::millis(10);

    fn at(millis: u64) -> Instant {
        Instant::ZERO + Duration::millis(millis)
    }

    #[test]
    fn a_level_takes_effect_when_it_has_lasted_and_not_before() {
        let mut input = Debounce::new(false);
        assert!(!input.sample(at(1), true, LASTING));
        assert_eq!((input.level(), input.due()), (false, at(11)));
        assert!(!input.timeout(at(11) - Duration::TICK));
        assert!(input.timeout(at(11)));
        assert_eq!((input.level(), input.due()), (true, Instant::NEVER));
        assert!(!input.timeout(at(12)), "only once");
    }

    #[test]
    fn a_level_that_does_not_last_is_dropped() {
        let mut input = Debounce::new(false);
        input.sample(at(1), true, LASTING);
        assert!(!input.sample(at(5), false, LASTING));
        assert_eq!(input.due(), Instant::NEVER);
        input.sample(at(6), true, LASTING);
        assert_eq!(input.due(), at(16), "it lasts since 6 ms");
        input.sample(at(9), true, LASTING);
        assert_eq!(input.due(), at(16), "the same level is no change");
        input.cancel();
        assert_eq!((input.level(), input.due()), (false, Instant::NEVER));
    }

    #[test]
    fn without_a_time_a_sample_takes_effect_at_once_and_a_note_at_the_timeout() {
        let mut input = Debounce::new(false);
        assert!(input.sample(at(1), true, Duration::ZERO) && input.level());
        input.note(at(2), false, Duration::ZERO);
        assert_eq!((input.level(), input.due()), (true, at(2)));
        assert!(input.timeout(at(2)) && !input.level());
    }

    #[test]
    fn a_condition_begins_late_and_ends_at_once() {
        let mut condition = Debounce::new(false);
        assert!(!condition.has_lasted(at(1), true, LASTING));
        assert!(!condition.has_lasted(at(10), true, LASTING));
        assert!(condition.has_lasted(at(11), true, LASTING));
        assert!(condition.has_lasted(at(30), true, LASTING));
        assert!(!condition.has_lasted(at(31), false, LASTING));
        assert!(!condition.has_lasted(at(32), true, LASTING), "it lasts since 32 ms");
        assert!(!condition.has_lasted(at(33), false, LASTING));
        assert_eq!(condition.due(), Instant::NEVER);
    }
}
