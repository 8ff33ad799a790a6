//! Which pins of the board are what: the only place that says so, beside README.md.

use crate::gpio::{A, B, C, Gpio};

/// What of a drive, by its name, is wired to which pin of the board.
pub type Wire = (&'static str, Gpio);

/// To the transceiver of the bus.
pub(crate) const TX: Gpio = B.pin(6);
/// From the transceiver.
pub(crate) const RX: Gpio = B.pin(7);
/// The transceiver sends while this is high.
pub(crate) const DE: Gpio = B.pin(8);
/// A step where it rises.
pub(crate) const STEP: Gpio = B.pin(14);
/// High forward.
pub(crate) const DIR: Gpio = B.pin(15);
/// To ground while the board starts: no start-up delay. The board's button does that, too.
pub(crate) const FAST: Gpio = A.pin(0);
/// The board's own light.
const LIGHT: Gpio = C.pin(13).lit_low();

/// An MD3, by the names of its manual.
pub const MD3: [Wire; 13] = apart(
    &[TX, RX, DE, FAST, STEP, DIR],
    9,
    [
        ("J2.2", A.pin(1)),
        ("J2.3", A.pin(2)),
        ("J2.4", A.pin(3)),
        ("J2.5", A.pin(4)),
        ("J2.9", A.pin(5)),
        ("J2.10", A.pin(6)),
        ("J2.12", A.pin(7)),
        ("over_temperature", B.pin(12)),
        ("over_current", B.pin(13)),
        ("J3.7", B.pin(0)),
        ("J3.8", B.pin(5)),
        ("D5", B.pin(1)),
        ("D6", LIGHT),
    ],
);

/// A QSB of any variant: what one does not have stays unused. DIO1 and DIO2 are the pins of STEP and DIR.
pub const QSB: [Wire; 8] = apart(
    &[TX, RX, DE, FAST],
    8,
    [
        ("DIO1", STEP),
        ("DIO2", DIR),
        ("A", A.pin(1)),
        ("B", A.pin(2)),
        ("I", A.pin(3)),
        ("DTR", A.pin(4)),
        ("DIO0", A.pin(5)),
        ("DIO3", A.pin(6)),
    ],
);

/// An RS 434544 or 434546, with the causes of all its faults.
pub const RS434: [Wire; 17] = apart(
    &[TX, RX, DE, FAST, STEP, DIR],
    13,
    [
        ("IN1", A.pin(1)),
        ("IN2", A.pin(2)),
        ("HARD_STOP", A.pin(3)),
        ("CLR_FLASH", A.pin(4)),
        ("supply_voltage", B.pin(12)),
        ("short_circuit", B.pin(13)),
        ("brake_overheat", B.pin(0)),
        ("power_overheat", B.pin(5)),
        ("hall", A.pin(7)),
        ("mcu_overheat", A.pin(8)),
        ("switches", B.pin(9)),
        ("current_limit", B.pin(10)),
        ("stall", A.pin(15)),
        ("HA", A.pin(5)),
        ("HB", A.pin(6)),
        ("RED", B.pin(1)),
        ("GREEN", LIGHT),
    ],
);

/// These wires, each at a pin of its own, beside those that are `taken`; the first of them, so many `inputs`, with
/// lines of their own at EXTI, which are numbered as the pins of a port are. Two at one pin, or two inputs at one
/// line, do not compile.
const fn apart<const N: usize>(taken: &[Gpio], inputs: usize, wires: [Wire; N]) -> [Wire; N] {
    let (mut pins, mut lines) = (0, 0_u32);
    let mut n = 0;
    while n < taken.len() {
        pins |= taken[n].place();
        n += 1;
    }
    n = 0;
    while n < N {
        let (_, gpio) = wires[n];
        assert!(pins & gpio.place() == 0, "two wires at one pin");
        pins |= gpio.place();
        if n < inputs {
            assert!(lines & 1 << gpio.n() == 0, "two inputs at one line");
            lines |= 1 << gpio.n();
        }
        n += 1;
    }
    wires
}
