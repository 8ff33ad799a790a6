//! Which pins of the board are what of a drive.

use crate::pins::{Wire, gp};

/// An MD3, by the names of its manual.
pub const MD3: [Wire; 13] = [
    ("J2.2", gp(5)),
    ("J2.3", gp(6)),
    ("J2.4", gp(7)),
    ("J2.5", gp(8)),
    ("J2.9", gp(9)),
    ("J2.10", gp(10)),
    ("J2.12", gp(11)),
    ("J3.7", gp(12)),
    ("J3.8", gp(13)),
    ("D5", gp(14)),
    // The green light, and the Pico's own.
    ("D6", gp(15) | gp(25)),
    ("over_temperature", gp(16)),
    ("over_current", gp(17)),
];
