//! Fields of registers, with the values of the command list.

use drivetwin_protocol::registers::Field;

/// MODE.
pub(super) const MODE: &[Field] = &[
    Field::bit(4, "resolution of a PWM encoder, read only").values(&[(0, "10 bits"), (1, "12 bits")]),
    Field::bits(1, 0, "type").values(&[(0, "quadrature or step/direction"), (1, "PWM"), (2, "analogue")]),
];

/// DIG I/O.
pub(super) const DIO: &[Field] =
    &[Field::bit(3, "DIO3"), Field::bit(2, "DIO2"), Field::bit(1, "DIO1"), Field::bit(0, "DIO0")];

const EDGE: &[(u16, &str)] = &[(0, "rising"), (1, "falling")];
const DIRECTION: &[(u16, &str)] = &[(0, "input"), (1, "output")];

/// DIG I/O CONFIG.
pub(super) const DIO_CONFIG: &[Field] = &[
    Field::bit(12, "a trigger makes a pulse on DIO0"),
    Field::bit(11, "DIO3 is").values(DIRECTION),
    Field::bit(10, "DIO2 is").values(DIRECTION),
    Field::bit(9, "DIO1 is").values(DIRECTION),
    Field::bit(8, "DIO0 is").values(DIRECTION),
    Field::bit(7, "DIO3 captures"),
    Field::bit(6, "DIO2 captures"),
    Field::bit(5, "DIO1 captures"),
    Field::bit(4, "DIO0 captures"),
    Field::bit(3, "edge of DIO3").values(EDGE),
    Field::bit(2, "edge of DIO2").values(EDGE),
    Field::bit(1, "edge of DIO1").values(EDGE),
    Field::bit(0, "edge of DIO0").values(EDGE),
];

/// MDR0.
pub(super) const MDR0: &[Field] = &[
    Field::bit(7, "division of the filter's clock").values(&[(0, "by 1"), (1, "by 2")]),
    Field::bit(6, "index").values(&[(0, "asynchronous"), (1, "synchronous")]),
    Field::bits(5, 4, "effect of the index").values(&[
        (0, "none"),
        (1, "loads CNTR"),
        (2, "clears CNTR"),
        (3, "loads OTR"),
    ]),
    Field::bits(3, 2, "range").values(&[
        (0, "free-running"),
        (1, "single-cycle"),
        (2, "range-limit"),
        (3, "modulo-n"),
    ]),
    Field::bits(1, 0, "count mode").values(&[(0, "non-quadrature"), (1, "x1"), (2, "x2"), (3, "x4")]),
];

/// MDR1.
pub(super) const MDR1: &[Field] = &[
    Field::bit(8, "counts down"),
    Field::bit(7, "trigger on overflow"),
    Field::bit(6, "trigger on underflow"),
    Field::bit(5, "trigger on match"),
    Field::bit(4, "trigger and capture on index"),
    Field::bit(3, "index inverted"),
    Field::bit(2, "counting disabled"),
];

/// STR.
pub(super) const STR: &[Field] = &[
    Field::bit(7, "CY: carry latch"),
    Field::bit(6, "BW: borrow latch"),
    Field::bit(5, "CMP: compare latch"),
    Field::bit(4, "IDX: index latch"),
    Field::bit(3, "CEN: counting enabled"),
    Field::bit(2, "PLS: power loss latch"),
    Field::bit(1, "U/D: direction").values(&[(0, "down"), (1, "up")]),
    Field::bit(0, "S: sign"),
];

/// CLEAR REG.
pub(super) const CLEAR: &[Field] = &[Field::whole(&[(0, "MDR0"), (1, "MDR1"), (2, "CNTR"), (3, "STR")])];

/// LOAD REG.
pub(super) const LOAD: &[Field] = &[Field::whole(&[(0, "DTR to CNTR"), (1, "CNTR to OTR")])];

/// MD STATUS.
pub(super) const MD_STATUS: &[Field] = &[
    Field::bit(4, "motor drive active"),
    Field::bit(3, "jogging"),
    Field::bit(2, "paused"),
    Field::bit(1, "moving"),
    Field::bit(0, "ready"),
];

/// EOR.
pub(super) const EOR: &[Field] = &[
    Field::bit(3, "spaces between fields"),
    Field::bit(2, "time stamp"),
    Field::bit(1, "CR"),
    Field::bit(0, "LF"),
];

/// Streams that command 3 saves.
pub(super) const STREAMS: &[Field] = &[
    Field::bit(4, "MD STATUS"),
    Field::bit(3, "READ ENCODER"),
    Field::bit(2, "STR"),
    Field::bit(1, "CAPTURE"),
    Field::bit(0, "DIG I/O"),
];
