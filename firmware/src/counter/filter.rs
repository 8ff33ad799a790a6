//! The noise filter of a quadrature counter.

use super::Channel;
use crate::device::{Duration, Instant};

/// Holds a new level back until it has lasted, each input for itself, and forgets it if it does not.
#[derive(Clone, Debug)]
pub(crate) struct Filter {
    /// When the other level of A, B and index will have lasted; [`Instant::NEVER`] if it is not there.
    due: [Instant; 3],
}

impl Filter {
    /// Holds nothing back.
    pub(crate) const fn new() -> Self {
        Self { due: [Instant::NEVER; 3] }
    }

    /// An input takes a level. `other`: it is not the level in effect. `lasting`: how long it must last.
    /// Returns whether it takes effect at once.
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

    /// When the first level held back will have lasted; [`Instant::NEVER`] if none is.
    #[inline]
    pub(crate) fn deadline(&self) -> Instant {
        let [a, b, index] = self.due;
        a.min(b).min(index)
    }

    /// Takes out the level that is due first, of several A before B before index, or `index_first`, if that is not
    /// after `at`.
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

    /// Lets go of what it holds back of A and B.
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
