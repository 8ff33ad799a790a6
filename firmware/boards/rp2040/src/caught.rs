//! What interrupts have for the loop.

use core::cell::Cell;

use critical_section::Mutex;
use drivetwin_board::Queue;
use drivetwin_firmware::device::Instant;
use drivetwin_firmware::shell::{Caught, Inputs};

use crate::{pins, timer};

/// Things that may wait, of 24 bytes each: a request of the longest kind, or all that a line of 57,600 baud
/// brings in the 45 ms in which a sector is erased.
pub(crate) const ROOM: usize = 256;

/// What was caught.
pub(crate) static QUEUE: Queue<(Instant, Caught), ROOM> = Queue::new();

/// Whether the bus takes more to send than it did.
static BUS_HAS_ROOM: Mutex<Cell<bool>> = Mutex::new(Cell::new(false));

/// Tells the loop to look at the bus again.
pub(crate) fn bus_has_room() {
    critical_section::with(|cs| BUS_HAS_ROOM.borrow(cs).set(true));
}

/// The loop is about to look at the bus.
pub(crate) fn look_at_bus() {
    critical_section::with(|cs| BUS_HAS_ROOM.borrow(cs).set(false));
}

/// Whether there is anything for the loop.
pub(crate) fn is_there() -> bool {
    !QUEUE.is_empty() || critical_section::with(|cs| BUS_HAS_ROOM.borrow(cs).get())
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
            pins::tell_missed();
        }
        first.or_else(|| drivetwin_board::untold().map(|slipped| (until, slipped)))
    }
}
