//! The watchdog (11.4), which resets a board that hangs.

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

/// Starts the watchdog. Only a reset stops it.
pub(crate) fn start() {
    const INTERRUPT: u32 = 1 << 0;
    const RESET: u32 = 1 << 1;
    const STALL: u32 = 1 << 8;
    // The first timeout, after half a second, only interrupts; the second one, after a second, resets the
    // board.
    LOAD.write(HZ / 2);
    // The watchdog stops while a debugger halts the processor.
    TEST.write(STALL);
    CONTROL.write(INTERRUPT | RESET);
}

/// Feeds the watchdog. Called in each pass of the loop.
pub(crate) fn feed() {
    CLEAR.write(1);
}
