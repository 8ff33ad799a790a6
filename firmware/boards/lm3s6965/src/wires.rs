//! Which pins of the board are what of a drive.

use crate::gpio::{A, B, C, D, F, G, Gpio};
use crate::steps;

/// What of a drive, by its name, is wired to which pin of the board.
pub type Wire = (&'static str, Gpio);

/// An MD3, by the names of its manual.
pub const MD3: [Wire; 13] = [
    ("J2.2", D.pin(4)),
    ("J2.3", D.pin(5)),
    ("J2.4", D.pin(6)),
    ("J2.5", D.pin(7)),
    ("J2.9", C.pin(4)),
    ("J2.10", C.pin(5)),
    ("J2.12", C.pin(6)),
    ("J3.7", B.pin(1)),
    ("J3.8", B.pin(2)),
    ("D5", B.pin(0)),
    ("D6", F.pin(0)),
    ("over_temperature", A.pin(7)),
    ("over_current", G.pin(0)),
];

/// A QSB of any variant: what one does not have stays unused. DIO1 and DIO2 are the pins of STEP and DIR.
pub const QSB: [Wire; 8] = [
    ("A", D.pin(4)),
    ("B", D.pin(5)),
    ("I", D.pin(6)),
    ("DTR", D.pin(7)),
    ("DIO0", C.pin(4)),
    ("DIO1", steps::STEP),
    ("DIO2", steps::DIR),
    ("DIO3", C.pin(5)),
];
