//! The watchdog (11.4): a board that hangs starts again.

use drivetwin_firmware::device::Duration;

use crate::clock::HZ;
use crate::registers::Register;

const WATCHDOG: usize = 0x4000_0000;
const LOAD: Register = Register::at(WATCHDOG, 0x000);
const CONTROL: Register = Register::at(WATCHDOG, 0x008);
const CLEAR: Register = Register::at(WATCHDOG, 0x00C);
const TEST: Register = Register::at(WATCHDOG, 0x418);

/// Longest sleep of the loop.
pub(crate) const NAP: Duration = Duration::millis(250);

/// Starts it; nothing but a reset ends it.
pub(crate) fn start() {
    const INTERRUPT: u32 = 1 << 0;
    const RESET: u32 = 1 << 1;
    const STALL: u32 = 1 << 8;
    // It forgives once, and resets the board after twice that time: a second.
    LOAD.write(HZ / 2);
    // It stands still while a debugger holds the processor.
    TEST.write(STALL);
    CONTROL.write(INTERRUPT | RESET);
}

/// The loop turns.
pub(crate) fn feed() {
    CLEAR.write(1);
}
