//! Steps that slipped, from the code that finds them to the drive.
//!
//! They are counted and not queued: no queue that is full can lose them.

use core::sync::atomic::{AtomicI32, Ordering};

use drivetwin_firmware::device::Axis;
use drivetwin_firmware::shell::BoardEvent;

/// Steps that slipped since the start: a plan was taken late, and that many steps too many were made. Wraps.
pub static SLIPPED: AtomicI32 = AtomicI32::new(0);

/// The part of them that was reported to the drive.
static TOLD: AtomicI32 = AtomicI32::new(0);

/// The only axis of a board.
const AXIS: Axis = Axis(0);

/// Adds slipped steps. For the loop, as [`untold`] is.
pub(crate) fn add(steps: i32) {
    SLIPPED.store(SLIPPED.load(Ordering::Relaxed).wrapping_add(steps), Ordering::Relaxed);
}

/// Steps that slipped since the last time. A board reports them to its drive after all other events that it has
/// caught.
pub fn untold() -> Option<BoardEvent> {
    let all = SLIPPED.load(Ordering::Relaxed);
    let untold = all.wrapping_sub(TOLD.load(Ordering::Relaxed));
    TOLD.store(all, Ordering::Relaxed);
    (untold != 0).then_some(BoardEvent::StepsCorrection(AXIS, untold))
}
