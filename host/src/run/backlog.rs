//! Limit of the events of a board that wait to be recorded, so that a file that is written slowly does not fill the memory.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use drivetwin_sim::record::trace::Event;

/// Maximum number of events that wait to be recorded.
const MOST_EVENTS: usize = 1 << 20;

/// Number of events that wait to be recorded, on the side that has received them.
#[derive(Default)]
pub(super) struct Backlog {
    waiting: Arc<AtomicUsize>,
    dropped: u64,
}

/// Events that wait. They no longer wait when this value is dropped.
pub(super) struct Waiting<T> {
    pub(super) events: Vec<(T, Event)>,
    count: usize,
    waiting: Arc<AtomicUsize>,
}

impl Backlog {
    /// Lets events wait; `None` if too many wait already. The next events are then preceded by [`Event::Missing`].
    pub(super) fn add<T: Copy>(&mut self, mut events: Vec<(T, Event)>) -> Option<Waiting<T>> {
        if self.waiting.load(Ordering::Relaxed) > MOST_EVENTS {
            self.dropped += events.len() as u64;
            return None;
        }
        if self.dropped > 0
            && let Some(&(at, _)) = events.first()
        {
            events.insert(0, (at, Event::Missing { events: Some(std::mem::take(&mut self.dropped)) }));
        }
        let count = events.len();
        self.waiting.fetch_add(count, Ordering::Relaxed);
        Some(Waiting { events, count, waiting: Arc::clone(&self.waiting) })
    }
}

impl<T> Drop for Waiting<T> {
    fn drop(&mut self) {
        self.waiting.fetch_sub(self.count, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_above_the_limit_are_counted_in_the_recording() {
        let events = |count: usize| vec![(5_u64, Event::Missing { events: None }); count];
        let mut backlog = Backlog::default();
        let first = backlog.add(events(MOST_EVENTS + 1)).unwrap();
        assert!(backlog.add(events(7)).is_none());
        drop(first);
        let next = backlog.add(events(1)).unwrap();
        assert_eq!(
            next.events,
            [(5, Event::Missing { events: Some(7) }), (5, Event::Missing { events: None })]
        );
    }
}
