//! What interrupts have for the loop.

use drivetwin_board::Queue;
use drivetwin_firmware::device::Instant;
use drivetwin_firmware::shell::{Caught, Inputs};

use crate::{clock, inputs};

/// Things that may be caught before the drive is told of the first one. A request has 8 characters.
pub(crate) const ROOM: usize = 80;

/// What was caught.
pub(crate) static QUEUE: Queue<(Instant, Caught), ROOM> = Queue::new();

/// What the board hears.
pub(crate) struct Ears;

impl Inputs for Ears {
    fn now(&self) -> Instant {
        clock::now()
    }

    fn caught(&mut self, until: Instant) -> Option<(Instant, Caught)> {
        let first = QUEUE.pop_if(|(at, _)| *at <= until);
        if first.is_none() && QUEUE.is_empty() {
            inputs::tell_missed();
        }
        first.or_else(|| drivetwin_board::untold().map(|slipped| (until, slipped)))
    }
}
