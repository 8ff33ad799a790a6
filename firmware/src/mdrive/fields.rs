//! Fields of variables, with the values of the fieldbus manual (FB) and the MCode reference (MC).

use drivetwin_protocol::registers::Field;

/// CE (MC 5-10).
pub(super) const CTRL_C: &[Field] = &[Field::whole(&[
    (0, "none"),
    (1, "restart"),
    (2, "restart, in party mode only if addressed to this drive"),
])];

/// HM (MC 5-29).
pub(super) const HOMING: &[Field] = &[Field::whole(&[
    (1, "slew minus, creep plus"),
    (2, "slew minus, creep minus"),
    (3, "slew plus, creep minus"),
    (4, "slew plus, creep plus"),
])];

/// IL and IN (FB 5).
pub(super) const INPUTS: &[Field] =
    &[Field::bit(3, "input 4"), Field::bit(2, "input 3"), Field::bit(1, "input 2"), Field::bit(0, "input 1")];

/// OL (FB 5).
pub(super) const OUTPUTS: &[Field] = &[
    Field::bit(3, "output 4"),
    Field::bit(2, "output 3"),
    Field::bit(1, "output 2"),
    Field::bit(0, "output 1"),
];

/// LM (MC 5-41).
pub(super) const LIMIT: &[Field] = &[Field::whole(&[
    (1, "normal, with a ramp"),
    (2, "stops homing, too, with a ramp"),
    (3, "stops the program, too, with a ramp"),
    (4, "normal, without a ramp"),
    (5, "stops homing, too, without a ramp"),
    (6, "stops the program, too, without a ramp"),
])];

/// EM (MC 5-22).
pub(super) const ECHO: &[Field] = &[Field::whole(&[
    (0, "all characters and prompts"),
    (1, "only CR LF"),
    (2, "none"),
    (3, "the whole line after its end"),
])];

/// ES (MC 5-23).
pub(super) const ESCAPE: &[Field] = &[Field::whole(&[
    (0, "Ctrl-E"),
    (1, "Esc"),
    (2, "Ctrl-E, in party mode only if addressed to this drive"),
    (3, "Esc, in party mode only if addressed to this drive"),
])];

/// CK (MC 5-12).
pub(super) const CHECKSUM: &[Field] =
    &[Field::whole(&[(0, "off"), (1, "on"), (2, "on, without ACK while a program runs")])];
