//! Events that are due, in the order of their times.

use core::mem;

use drivetwin_firmware::device::Instant;
use drivetwin_firmware::shell::BoardEvent;
use heapless::Vec;

/// Greatest number of events that a call and an edge cause before the drive takes them.
const MOST: usize = 8;

/// Events that are due, in the order of their times.
#[derive(Debug)]
pub(crate) struct Events(Vec<(Instant, BoardEvent), MOST>);

impl Events {
    pub(crate) const fn new() -> Self {
        Self(Vec::new())
    }

    /// Adds an event behind those that are not later.
    pub(crate) fn push(&mut self, at: Instant, event: Option<BoardEvent>) {
        let Some(event) = event else { return };
        let place = self.0.iter().position(|(other, _)| *other > at).unwrap_or(self.0.len());
        let _ = self.0.insert(place, (at, event));
    }

    /// Returns `true` if there is no room for another event, because the drive has not taken those before.
    pub(crate) fn is_full(&self) -> bool {
        self.0.is_full()
    }

    /// Time of the first event.
    pub(crate) fn due(&self) -> Instant {
        self.0.first().map_or(Instant::NEVER, |(at, _)| *at)
    }

    /// Takes the first event.
    pub(crate) fn take(&mut self) -> Option<(Instant, BoardEvent)> {
        let first = self.0.first().copied();
        let mut stays = false;
        self.0.retain(|_| mem::replace(&mut stays, true));
        first
    }
}
