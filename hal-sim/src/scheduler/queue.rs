//! A queue of events, in the total order of a bench.

use std::cmp::{Ordering, Reverse};
use std::collections::BinaryHeap;

use drivetwin_firmware::device::Instant;

use super::Phase;

/// The total order of events on a bench. Drives are ordered by the rank of their names, so that the order in which
/// they were added makes no difference.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(crate) struct EventKey {
    pub(crate) at: Instant,
    pub(crate) phase: Phase,
    pub(crate) rank: u32,
    pub(crate) sequence: u64,
}

/// A scheduled event.
#[derive(Debug)]
pub(crate) struct Event<T> {
    pub(crate) key: EventKey,
    /// Index of the drive or motor.
    pub(crate) target: u32,
    pub(crate) kind: T,
}

impl<T> PartialEq for Event<T> {
    fn eq(&self, other: &Self) -> bool {
        self.key == other.key
    }
}

impl<T> Eq for Event<T> {}

impl<T> PartialOrd for Event<T> {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl<T> Ord for Event<T> {
    fn cmp(&self, other: &Self) -> Ordering {
        self.key.cmp(&other.key)
    }
}

/// All scheduled events, the earliest on top.
#[derive(Debug)]
pub(crate) struct Queue<T> {
    events: BinaryHeap<Reverse<Event<T>>>,
    sequence: u64,
}

impl<T> Default for Queue<T> {
    fn default() -> Self {
        Self { events: BinaryHeap::new(), sequence: 0 }
    }
}

impl<T> Queue<T> {
    /// Schedules an event.
    // Inlined so that an event is written once and not copied.
    #[inline(always)]
    pub(crate) fn push(&mut self, at: Instant, phase: Phase, rank: u32, target: u32, kind: T) {
        self.sequence += 1;
        let key = EventKey { at, phase, rank, sequence: self.sequence };
        self.events.push(Reverse(Event { key, target, kind }));
    }

    /// Puts back an event that was taken, with another rank and target.
    pub(crate) fn put_back(&mut self, event: Event<T>) {
        self.events.push(Reverse(event));
    }

    /// The key of the earliest event, if there is one.
    pub(crate) fn first(&self) -> Option<&EventKey> {
        self.events.peek().map(|Reverse(event)| &event.key)
    }

    pub(crate) fn pop(&mut self) -> Option<Event<T>> {
        self.events.pop().map(|Reverse(event)| event)
    }

    /// Updates the rank of every event.
    pub(crate) fn rank(&mut self, rank: impl Fn(u32) -> u32) {
        let mut events = std::mem::take(&mut self.events).into_vec();
        for Reverse(event) in &mut events {
            event.key.rank = rank(event.target);
        }
        self.events = events.into();
    }
}
