//! A queue of events, in the total order of a bench.

use std::cmp::{Ordering, Reverse};
use std::collections::BinaryHeap;

use drivetwin_firmware::device::Instant;

use super::Phase;

/// The total order of everything that happens on a bench. Seats count by the rank of their names, so
/// that the order in which they were added never matters.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(crate) struct EventKey {
    pub(crate) at: Instant,
    pub(crate) class: Phase,
    pub(crate) rank: u32,
    pub(crate) sequence: u64,
}

/// An event that is under way.
#[derive(Debug)]
pub(crate) struct Event<T> {
    pub(crate) key: EventKey,
    /// To which seat.
    pub(crate) seat: u32,
    pub(crate) what: T,
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

/// Everything under way, the first on top.
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
    /// Sends something on its way.
    // Where it is inlined an event is written once, and not copied about on its way to its place.
    #[inline(always)]
    pub(crate) fn push(&mut self, at: Instant, class: Phase, rank: u32, seat: u32, what: T) {
        self.sequence += 1;
        let key = EventKey { at, class, rank, sequence: self.sequence };
        self.events.push(Reverse(Event { key, seat, what }));
    }

    /// The key of the first.
    pub(crate) fn first(&self) -> Option<&EventKey> {
        self.events.peek().map(|Reverse(event)| &event.key)
    }

    pub(crate) fn pop(&mut self) -> Option<Event<T>> {
        self.events.pop().map(|Reverse(event)| event)
    }

    /// Gives every event the rank that its seat has now.
    pub(crate) fn rank(&mut self, rank: impl Fn(u32) -> u32) {
        let mut events = std::mem::take(&mut self.events).into_vec();
        for Reverse(event) in &mut events {
            event.key.rank = rank(event.seat);
        }
        self.events = events.into();
    }
}
