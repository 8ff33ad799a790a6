//! The noise filter of a quadrature counter.

use super::Channel;
use crate::device::{Duration, Instant};

/// Delays a new level until it has lasted long enough, for each input separately. A shorter level is dropped, and one that
/// ends in the very instant in which it would take effect, unless the owner handles that instant's timeout first.
#[derive(Clone, Debug)]
pub(crate) struct Filter {
    /// For A, B and index: the time at which the pending new level will have lasted long enough;
    /// [`Instant::NEVER`] if there is no new level.
    due: [Instant; 3],
}

impl Filter {
    /// A filter without pending levels.
    pub(crate) const fn new() -> Self {
        Self { due: [Instant::NEVER; 3] }
    }

    /// Handles a level of an input. `other` is true if the level differs from the level in effect, `lasting`
    /// is the time for which it must last. Returns true if the level takes effect at once.
    #[inline]
    pub(crate) fn passes(&mut self, at: Instant, channel: Channel, other: bool, lasting: Duration) -> bool {
        let due = self.due_mut(channel);
        if !other {
            *due = Instant::NEVER;
            return false;
        }
        if *due != Instant::NEVER {
            return false;
        }
        if lasting != Duration::ZERO {
            *due = at + lasting;
        }
        lasting == Duration::ZERO
    }

    /// Time at which the first pending level will have lasted long enough; [`Instant::NEVER`] if there is
    /// none.
    #[inline]
    pub(crate) fn deadline(&self) -> Instant {
        let [a, b, index] = self.due;
        a.min(b).min(index)
    }

    /// Removes the pending level that is due first, and returns its input; `None` if no level is due by `at`.
    /// If several levels are due at once, the order is A, B, index, or index first if `index_first` is true.
    #[inline]
    pub(crate) fn take(&mut self, at: Instant, index_first: bool) -> Option<Channel> {
        let first = self.deadline();
        if first > at || first == Instant::NEVER {
            return None;
        }
        if index_first && *self.due_mut(Channel::Index) == first {
            *self.due_mut(Channel::Index) = Instant::NEVER;
            return Some(Channel::Index);
        }
        let channels = [Channel::A, Channel::B, Channel::Index];
        let (due, channel) = self.due.iter_mut().zip(channels).find(|(due, _)| **due == first)?;
        *due = Instant::NEVER;
        Some(channel)
    }

    /// Drops the pending changes of A and B.
    pub(crate) fn forget_a_and_b(&mut self) {
        let [a, b, _] = &mut self.due;
        (*a, *b) = (Instant::NEVER, Instant::NEVER);
    }

    fn due_mut(&mut self, channel: Channel) -> &mut Instant {
        let [a, b, index] = &mut self.due;
        match channel {
            Channel::A => a,
            Channel::B => b,
            Channel::Index => index,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LASTING: Duration = Duration::micros(10);

    fn at(micros: u64) -> Instant {
        Instant::ZERO + Duration::micros(micros)
    }

    /// A filter with these pending levels, each since a time in µs.
    fn holding(levels: &[(Channel, u64)]) -> Filter {
        let mut filter = Filter::new();
        for &(channel, micros) in levels {
            assert!(!filter.passes(at(micros), channel, true, LASTING));
        }
        filter
    }

    #[test]
    fn levels_come_in_the_order_in_which_they_have_lasted() {
        for index_first in [false, true] {
            let mut filter = holding(&[(Channel::A, 1), (Channel::B, 2), (Channel::Index, 3)]);
            assert_eq!(filter.take(at(10), index_first), None);
            assert_eq!(filter.deadline(), at(11));
            let order = [11, 12, 13].map(|micros| filter.take(at(micros), index_first));
            assert_eq!(order, [Some(Channel::A), Some(Channel::B), Some(Channel::Index)]);
            assert_eq!((filter.deadline(), filter.take(Instant::NEVER, index_first)), (Instant::NEVER, None));
        }
    }

    #[test]
    fn levels_of_one_instant_come_a_before_b_and_the_index_first_or_last() {
        let all = [(Channel::Index, 0), (Channel::B, 0), (Channel::A, 0)];
        let mut filter = holding(&all);
        assert_eq!(filter.take(at(10), false), Some(Channel::A));
        assert_eq!(filter.take(at(10), true), Some(Channel::Index));
        assert_eq!(filter.take(at(10), true), Some(Channel::B));
        assert_eq!(filter.take(at(10), true), None);
    }

    #[test]
    fn a_level_that_does_not_last_is_forgotten() {
        let mut filter = holding(&[(Channel::A, 0), (Channel::B, 1), (Channel::Index, 2)]);
        assert!(!filter.passes(at(5), Channel::B, true, LASTING), "it is held back since 1 µs");
        assert!(!filter.passes(at(9), Channel::A, false, LASTING));
        assert_eq!(filter.deadline(), at(11));
        filter.forget_a_and_b();
        assert_eq!(filter.deadline(), at(12));
        assert!(filter.passes(at(9), Channel::A, true, Duration::ZERO), "without a filter it passes");
        assert_eq!(filter.take(at(12), false), Some(Channel::Index));
    }
}
