//! Slipped steps (steps beyond the planned ones), reported from the loop to the drive.
//!
//! They are counted and not queued, so that a full queue cannot lose them.

use core::sync::atomic::{AtomicI32, Ordering};

use drivetwin_firmware::device::Axis;
use drivetwin_firmware::shell::BoardEvent;

/// Number of slipped steps since the start; the counter wraps. Steps slip when a plan is taken late: then more
/// steps than planned are made.
pub static SLIPPED: AtomicI32 = AtomicI32::new(0);

/// The part of [`SLIPPED`] that was reported to the drive.
static TOLD: AtomicI32 = AtomicI32::new(0);

/// The only axis of a board.
const AXIS: Axis = Axis(0);

/// Adds slipped steps. Only the loop may call this and [`untold`].
pub(crate) fn add(steps: i32) {
    SLIPPED.store(SLIPPED.load(Ordering::Relaxed).wrapping_add(steps), Ordering::Relaxed);
}

/// Event with the steps that slipped since the last call, if any. A board reports it to its drive after all
/// other queued events.
pub fn untold() -> Option<BoardEvent> {
    let all = SLIPPED.load(Ordering::Relaxed);
    let untold = all.wrapping_sub(TOLD.load(Ordering::Relaxed));
    TOLD.store(all, Ordering::Relaxed);
    (untold != 0).then_some(BoardEvent::StepsCorrection(AXIS, untold))
}
