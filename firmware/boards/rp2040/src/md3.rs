//! How an MD3 is wired to the Pico, whichever its current.

use standin_firmware::md3::Reg;
use standin_firmware::memory;

use crate::{Wire, gp};

/// Bytes of its EEPROM.
pub const MEMORY: usize = memory::bytes(Reg::SAVED_WORDS) as usize;

/// Which pins are what of the drive, by the manual's names.
pub const WIRES: [Wire; 13] = [
    (gp(5), "J2.2"),
    (gp(6), "J2.3"),
    (gp(7), "J2.4"),
    (gp(8), "J2.5"),
    (gp(9), "J2.9"),
    (gp(10), "J2.10"),
    (gp(11), "J2.12"),
    (gp(12), "J3.7"),
    (gp(13), "J3.8"),
    (gp(14), "D5"),
    // The green light, and the Pico's own.
    (gp(15) | gp(25), "D6"),
    (gp(16), "over_temperature"),
    (gp(17), "over_current"),
];
