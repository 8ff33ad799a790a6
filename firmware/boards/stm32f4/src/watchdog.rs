//! The independent watchdog (15).

use crate::registers::Register;

const WATCHDOG: usize = 0x4000_3000;
const KEY: Register = Register::at(WATCHDOG, 0x00);
const PRESCALER: Register = Register::at(WATCHDOG, 0x04);
const RELOAD: Register = Register::at(WATCHDOG, 0x08);

/// Starts the watchdog.
pub(crate) fn start() {
    const START: u32 = 0xCCCC;
    const UNLOCK: u32 = 0x5555;
    const BY_32: u32 = 3;
    // The watchdog's oscillator has 17 to 47 kHz (datasheet, 6.3.9), so the timeout is at least one second
    // and typically one and a half. The slowest erase of a sector takes half a second.
    const COUNT: u32 = 1_500;
    KEY.write(START);
    KEY.write(UNLOCK);
    PRESCALER.write(BY_32);
    RELOAD.write(COUNT);
    feed();
}

/// Feeds the watchdog.
pub(crate) fn feed() {
    const FEED: u32 = 0xAAAA;
    KEY.write(FEED);
}
