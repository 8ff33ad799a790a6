//! Assignment of the board's pins. It is defined only here and in README.md.

use crate::pins::{Wire, gp};

/// Output to the transceiver of the bus.
pub(crate) const TX: u32 = gp(0);
/// Input from the transceiver.
pub(crate) const RX: u32 = gp(1);
/// The transceiver sends while this is high.
pub(crate) const DE: u32 = gp(2);
/// STEP: each rising edge is a step.
pub(crate) const STEP: u32 = gp(3);
/// DIR: high is forward.
pub(crate) const DIR: u32 = gp(4);
/// Connected to ground while the board starts, this pin skips the start-up delay.
pub(crate) const FAST: u32 = gp(22);
/// The Pico's own light, lit while high. It shows a light of the drive; of a drive without one, that the board runs.
pub(crate) const LIGHT: u32 = gp(25);

/// Wires of an MD3, by the names of its manual.
pub const MD3: [Wire; 13] = apart(
    BUS | STEP | DIR,
    [
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
        // The green light, shown by the Pico's own light, too.
        ("D6", gp(15) | LIGHT),
        ("over_temperature", gp(16)),
        ("over_current", gp(17)),
    ],
);

/// Wires of a QSB of any variant. Those of pins that a variant does not have are unused. DIO1 and DIO2 are at
/// the pins of STEP and DIR.
pub const QSB: [Wire; 8] = apart(
    BUS,
    [
        ("DIO1", STEP),
        ("DIO2", DIR),
        ("A", gp(5)),
        ("B", gp(6)),
        ("I", gp(7)),
        ("DTR", gp(8)),
        ("DIO0", gp(9)),
        ("DIO3", gp(10)),
    ],
);

/// Wires of an RS 434544 or 434546, with the causes of all its faults.
pub const RS434: [Wire; 17] = apart(
    BUS | STEP | DIR,
    [
        ("IN1", gp(5)),
        ("IN2", gp(6)),
        ("HARD_STOP", gp(7)),
        ("CLR_FLASH", gp(8)),
        ("HA", gp(9)),
        ("HB", gp(10)),
        ("RED", gp(14)),
        // Shown by the Pico's own light, too.
        ("GREEN", gp(15) | LIGHT),
        ("supply_voltage", gp(11)),
        ("short_circuit", gp(12)),
        ("brake_overheat", gp(13)),
        ("power_overheat", gp(16)),
        ("hall", gp(17)),
        ("mcu_overheat", gp(18)),
        ("switches", gp(19)),
        ("current_limit", gp(20)),
        ("stall", gp(21)),
    ],
);

/// Wires of an MD400 of MDROBOT, with the causes of as many faults as there are free pins.
pub const MDROBOT: [Wire; 20] = apart(
    BUS | STEP | DIR,
    [
        ("INT_SPEED", gp(5)),
        ("ALARM_RESET", gp(6)),
        ("DIR", gp(7)),
        ("RUN_BRAKE", gp(8)),
        ("START_STOP", gp(9)),
        ("ENC_A", gp(10)),
        ("ENC_B", gp(11)),
        ("SPEED_IN", gp(12)),
        ("PULSE_IN", gp(13)),
        ("ALARM", gp(14)),
        ("CLUTCH", gp(15)),
        // Shown by the Pico's own light, too.
        ("FAN", gp(16) | LIGHT),
        ("HU", gp(17)),
        ("HV", gp(18)),
        ("HW", gp(19)),
        ("over_voltage", gp(20)),
        ("over_temperature", gp(21)),
        ("hall_fail", gp(26)),
        ("inverse_velocity", gp(27)),
        ("stall", gp(28)),
    ],
);

/// Pins that are in use with every drive.
const BUS: u32 = TX | RX | DE | FAST;

/// Returns `wires` after checking that each uses pins of its own and none that is `taken`. Otherwise the
/// constant does not compile.
const fn apart<const N: usize>(mut taken: u32, wires: [Wire; N]) -> [Wire; N] {
    let mut n = 0;
    while n < N {
        let (_, pins) = wires[n];
        assert!(pins & taken == 0, "two wires at one pin");
        taken |= pins;
        n += 1;
    }
    wires
}
