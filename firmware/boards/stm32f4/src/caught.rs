//! What interrupts have for the loop.

use core::sync::atomic::{AtomicBool, Ordering};

use drivetwin_board::Queue;
use drivetwin_firmware::device::Instant;
use drivetwin_firmware::shell::{Caught, Inputs};

use crate::{inputs, timer};

/// Things that may wait, of 16 bytes each: a request of the longest kind, or all that a line of 9,600 baud brings in
/// the half second that erasing a sector may take.
const ROOM: usize = 512;

/// What was caught.
pub(crate) static QUEUE: Queue<(Instant, Caught), ROOM> = Queue::new();

/// Whether the bus takes more to send than it did.
static BUS_HAS_ROOM: AtomicBool = AtomicBool::new(false);

/// Tells the loop to look at the bus again.
pub(crate) fn bus_has_room() {
    BUS_HAS_ROOM.store(true, Ordering::Relaxed);
}

/// The loop is about to look at the bus.
pub(crate) fn look_at_bus() {
    BUS_HAS_ROOM.store(false, Ordering::Relaxed);
}

/// Whether there is anything for the loop.
pub(crate) fn is_there() -> bool {
    !QUEUE.is_empty() || BUS_HAS_ROOM.load(Ordering::Relaxed)
}

/// What the board hears.
pub(crate) struct Ears;

impl Inputs for Ears {
    fn now(&self) -> Instant {
        timer::past()
    }

    fn caught(&mut self, until: Instant) -> Option<(Instant, Caught)> {
        let first = QUEUE.pop_if(|(at, _)| *at <= until);
        if first.is_none() && QUEUE.is_empty() {
            inputs::tell_missed();
        }
        first.or_else(|| drivetwin_board::untold().map(|slipped| (until, slipped)))
    }
}
