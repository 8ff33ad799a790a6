//! Assignment of the board's pins. It is defined only here and in README.md.

use crate::gpio::{A, B, C, Gpio};

/// A wire: the name of a drive's pin or fault, and the pin of the board.
pub type Wire = (&'static str, Gpio);

/// Output to the transceiver of the bus.
pub(crate) const TX: Gpio = B.pin(6);
/// Input from the transceiver.
pub(crate) const RX: Gpio = B.pin(7);
/// The transceiver sends while this is high.
pub(crate) const DE: Gpio = B.pin(8);
/// STEP: each rising edge is a step.
pub(crate) const STEP: Gpio = B.pin(14);
/// DIR: high is forward.
pub(crate) const DIR: Gpio = B.pin(15);
/// Connected to ground while the board starts, this pin skips the start-up delay. The board's button connects
/// it, too.
pub(crate) const FAST: Gpio = A.pin(0);
/// Data lines of the USB cable.
pub(crate) const DM: Gpio = A.pin(11);
pub(crate) const DP: Gpio = A.pin(12);
/// The board's own light.
const LIGHT: Gpio = C.pin(13).lit_low();

/// Wires of an MD3, by the names of its manual.
pub const MD3: [Wire; 13] = apart(
    &[TX, RX, DE, FAST, STEP, DIR],
    [
        input("J2.2", A.pin(1)),
        input("J2.3", A.pin(2)),
        input("J2.4", A.pin(3)),
        input("J2.5", A.pin(4)),
        input("J2.9", A.pin(5)),
        input("J2.10", A.pin(6)),
        input("J2.12", A.pin(7)),
        input("over_temperature", B.pin(12)),
        input("over_current", B.pin(13)),
        output("J3.7", B.pin(0)),
        output("J3.8", B.pin(5)),
        output("D5", B.pin(1)),
        output("D6", LIGHT),
    ],
);

/// Wires of a QSB of any variant. Those of pins that a variant does not have are unused. DIO1 and DIO2 are at
/// the pins of STEP and DIR.
pub const QSB: [Wire; 8] = apart(
    &[TX, RX, DE, FAST],
    [
        input("DIO1", STEP),
        input("DIO2", DIR),
        input("A", A.pin(1)),
        input("B", A.pin(2)),
        input("I", A.pin(3)),
        input("DTR", A.pin(4)),
        input("DIO0", A.pin(5)),
        input("DIO3", A.pin(6)),
    ],
);

/// Wires of an RS 434544 or 434546, with the causes of all its faults.
pub const RS434: [Wire; 17] = apart(
    &[TX, RX, DE, FAST, STEP, DIR],
    [
        input("IN1", A.pin(1)),
        input("IN2", A.pin(2)),
        input("HARD_STOP", A.pin(3)),
        input("CLR_FLASH", A.pin(4)),
        input("supply_voltage", B.pin(12)),
        input("short_circuit", B.pin(13)),
        input("brake_overheat", B.pin(0)),
        input("power_overheat", B.pin(5)),
        input("hall", A.pin(7)),
        input("mcu_overheat", A.pin(8)),
        input("switches", B.pin(9)),
        input("current_limit", B.pin(10)),
        input("stall", A.pin(15)),
        output("HA", A.pin(5)),
        output("HB", A.pin(6)),
        output("RED", B.pin(1)),
        output("GREEN", LIGHT),
    ],
);

/// Wires of an MD400 of MDROBOT, with the causes of as many faults as there are free pins.
pub const MDROBOT: [Wire; 19] = apart(
    &[TX, RX, DE, FAST, STEP, DIR],
    [
        input("INT_SPEED", A.pin(1)),
        input("ALARM_RESET", A.pin(2)),
        input("DIR", A.pin(3)),
        input("RUN_BRAKE", A.pin(4)),
        input("START_STOP", A.pin(5)),
        input("ENC_A", A.pin(6)),
        input("ENC_B", A.pin(7)),
        input("SPEED_IN", A.pin(8)),
        input("PULSE_IN", A.pin(15)),
        input("over_voltage", B.pin(12)),
        input("over_temperature", B.pin(13)),
        input("hall_fail", B.pin(9)),
        input("stall", B.pin(10)),
        output("ALARM", B.pin(0)),
        output("CLUTCH", B.pin(1)),
        output("FAN", LIGHT),
        output("HU", B.pin(3)),
        output("HV", B.pin(4)),
        output("HW", B.pin(5)),
    ],
);

/// A wire, and true if the drive reads it.
type Row = (Wire, bool);

/// A wire that the drive reads. The drive may also drive it at times.
const fn input(name: &'static str, gpio: Gpio) -> Row {
    ((name, gpio), true)
}

/// A wire that the drive only drives, and never reads.
const fn output(name: &'static str, gpio: Gpio) -> Row {
    ((name, gpio), false)
}

/// Checks the wires of `rows`, and returns them. Each wire must use a pin of its own that is not in `taken`.
/// Each input must also use an EXTI line of its own; the number of the line is the number of the pin in its
/// port. A constant with other wires does not compile.
const fn apart<const N: usize>(taken: &[Gpio], rows: [Row; N]) -> [Wire; N] {
    let mut wires = [("", TX); N];
    let (mut pins, mut lines) = (0, 0_u32);
    let mut n = 0;
    while n < taken.len() {
        pins |= taken[n].place();
        n += 1;
    }
    n = 0;
    while n < N {
        let ((name, gpio), is_input) = rows[n];
        assert!(pins & gpio.place() == 0, "two wires at one pin");
        pins |= gpio.place();
        if is_input {
            assert!(lines & 1 << gpio.n() == 0, "two inputs at one line");
            lines |= 1 << gpio.n();
        }
        wires[n] = (name, gpio);
        n += 1;
    }
    wires
}
