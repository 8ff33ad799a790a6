//! The watchdog (12.9).

use crate::registers::Register;

const WATCHDOG: usize = 0x400D_8000;
const CTRL: Register = Register::at(WATCHDOG, 0x00);
const LOAD: Register = Register::at(WATCHDOG, 0x04);
#[cfg(feature = "defmt")]
const REASON: Register = Register::at(WATCHDOG, 0x08);
/// Parts of the chip that a reset by the watchdog resets (7.4).
const PSM_WDSEL: Register = Register::at(0x4001_8000, 0x8);

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
    LOAD.write(MICROS);
}

/// Resets the board.
pub(crate) fn reset() -> ! {
    select();
    CTRL.set(TRIGGER);
    loop {
        cortex_m::asm::nop();
    }
}

/// Reason of the watchdog's last reset of the board (12.9): 0 for none, 1 if it was not fed, 2 after [`reset`].
#[cfg(feature = "defmt")]
pub(crate) fn reason() -> u32 {
    REASON.read() & 0b11
}

/// Selects the parts that a reset resets: all except the oscillators.
fn select() {
    PSM_WDSEL.write(0x1FF_FFF3);
}
