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

/// An RS 434544 or 434546, with the causes of all its faults.
pub const RS434: [Wire; 17] = [
    ("IN1", D.pin(4)),
    ("IN2", D.pin(5)),
    ("HARD_STOP", D.pin(6)),
    ("CLR_FLASH", D.pin(7)),
    ("HA", C.pin(4)),
    ("HB", C.pin(5)),
    ("RED", B.pin(0)),
    ("GREEN", F.pin(0)),
    ("supply_voltage", A.pin(2)),
    ("short_circuit", A.pin(3)),
    ("brake_overheat", A.pin(4)),
    ("power_overheat", A.pin(5)),
    ("hall", A.pin(6)),
    ("mcu_overheat", A.pin(7)),
    ("switches", G.pin(0)),
    ("current_limit", G.pin(1)),
    ("stall", C.pin(6)),
];
