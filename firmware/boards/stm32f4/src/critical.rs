//! Critical sections: they mask interrupts, except those of the driver of USB.

use cortex_m::interrupt;
use cortex_m::peripheral::SCB;
use cortex_m::peripheral::scb::VectActive;
use cortex_m::register::primask;
use critical_section::RawRestoreState;

use crate::usb;

/// States to restore: the end of the section unmasks interrupts, or leaves them as they are.
const UNMASK: RawRestoreState = 1;
const LEAVE: RawRestoreState = 0;

/// The critical section of the board.
struct Section;

critical_section::set_impl!(Section);

// SAFETY: the processor has one core, and no interrupt runs while interrupts are masked. A critical section of the driver of
// USB in the loop masks nothing: what it protects is used only by the loop.
unsafe impl critical_section::Impl for Section {
    unsafe fn acquire() -> RawRestoreState {
        if usb::is_in_driver() && SCB::vect_active() == VectActive::ThreadMode {
            return LEAVE;
        }
        let was_active = primask::read().is_active();
        interrupt::disable();
        if was_active { UNMASK } else { LEAVE }
    }

    unsafe fn release(state: RawRestoreState) {
        if state == UNMASK {
            // SAFETY: interrupts were enabled before the section.
            unsafe { interrupt::enable() };
        }
    }
}
