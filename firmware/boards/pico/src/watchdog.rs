//! The watchdog (4.7; RP2350: 12.9).

use crate::chip::{PSM_WDSEL, RESET_PARTS, WATCHDOG, WATCHDOG_COUNTS};
use crate::registers::Register;

const CTRL: Register = WATCHDOG;
const LOAD: Register = WATCHDOG.plus(0x04);
#[cfg(feature = "defmt")]
const REASON: Register = WATCHDOG.plus(0x08);

const TRIGGER: u32 = 1 << 31;
const ENABLE: u32 = 1 << 30;
/// Stops the watchdog while a debugger halts a core.
const PAUSE: u32 = 0b111 << 24;

/// Timeout in µs: a second. The slowest erase of a sector takes 0.4 s (flash chip, 9.6).
const MICROS: u32 = 1_000_000;

/// Starts the watchdog.
pub(crate) fn start() {
    CTRL.clear(ENABLE);
    select();
    feed();
    CTRL.write(PAUSE | ENABLE);
}

/// Feeds the watchdog.
pub(crate) fn feed() {
    LOAD.write(WATCHDOG_COUNTS * MICROS);
}

/// Resets the board.
pub(crate) fn reset() -> ! {
    select();
    CTRL.set(TRIGGER);
    loop {
        cortex_m::asm::nop();
    }
}

/// Reason of the watchdog's last reset of the board: 0 for none, 1 if it was not fed, 2 after [`reset`].
#[cfg(feature = "defmt")]
pub(crate) fn reason() -> u32 {
    REASON.read() & 0b11
}

/// Selects the parts that a reset resets.
fn select() {
    PSM_WDSEL.write(RESET_PARTS);
}
