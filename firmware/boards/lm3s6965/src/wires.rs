//! Assignment of the board's pins to the pins of drives.

use crate::gpio::{A, B, C, D, E, F, G, Gpio};
use crate::steps;

/// A wire: the name of a drive's pin or fault, and the pin of the board.
pub type Wire = (&'static str, Gpio);

/// Wires of an MD3, by the names of its manual.
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

/// Wires of a QSB of any variant. Those of pins that a variant does not have are unused. DIO1 and DIO2 are at
/// the pins of STEP and DIR.
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

/// Wires of an RS 434544 or 434546, with the causes of all its faults.
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

/// Wires of an MD400 of MDROBOT, with the causes of all its faults.
pub const MDROBOT: [Wire; 24] = [
    ("INT_SPEED", D.pin(0)),
    ("ALARM_RESET", D.pin(1)),
    ("DIR", D.pin(4)),
    ("RUN_BRAKE", D.pin(5)),
    ("START_STOP", D.pin(6)),
    ("ENC_A", D.pin(7)),
    ("ENC_B", C.pin(4)),
    ("SPEED_IN", C.pin(5)),
    ("PULSE_IN", C.pin(6)),
    ("ALARM", B.pin(0)),
    ("CLUTCH", B.pin(1)),
    ("FAN", F.pin(0)),
    ("HU", E.pin(0)),
    ("HV", E.pin(1)),
    ("HW", E.pin(2)),
    ("over_voltage", A.pin(2)),
    ("over_temperature", A.pin(3)),
    ("overload", A.pin(4)),
    ("hall_fail", A.pin(5)),
    ("encoder_fail", A.pin(6)),
    ("inverse_velocity", A.pin(7)),
    ("stall", G.pin(0)),
    ("ctrl_fail", G.pin(1)),
    ("regen_over_temperature", C.pin(7)),
];

/// Wires of an MDrive of either kind, with the causes of all its faults. Those of pins that a kind does not
/// have are unused.
pub const MDRIVE: [Wire; 16] = [
    ("IO1", D.pin(4)),
    ("IO2", D.pin(5)),
    ("IO3", D.pin(6)),
    ("IO4", D.pin(7)),
    ("IO7", C.pin(4)),
    ("IO8", C.pin(5)),
    ("CAPTURE", C.pin(6)),
    ("A", E.pin(0)),
    ("B", E.pin(1)),
    ("I", E.pin(2)),
    ("stall", A.pin(2)),
    ("locked_rotor", A.pin(3)),
    ("lead_limit", A.pin(4)),
    ("lag_limit", A.pin(5)),
    ("over_temperature", A.pin(6)),
    ("calibration", A.pin(7)),
];
