//! Functions of J2 pins 2 to 5 (7.8).

use super::registers::homing::{self, Mode as Homing};
use super::registers::io_port::INPUTS;
use super::registers::pin_function;

/// Function of pin 2.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Pin2 {
    /// The home sensor's flag.
    Flag,
    /// LOWCURRENT: while it is active, the motor gets the cutback current.
    LowCurrent,
    /// SPEEDSEL: while it is active, `AlternateSpeed` applies.
    SpeedSelect,
    /// "Invalid": the pin has no effect.
    None,
}

/// Function of pin 3.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Pin3 {
    /// INHIBIT: while it is active, the motor has no current.
    Inhibit,
    /// HOME: a home cycle starts when it becomes active.
    Home,
    /// `INHIBIT_MODBUS_MOTION`: while it is active, the bus cannot start motion.
    InhibitModbus,
    /// "Invalid": the pin has no effect.
    None,
}

/// Functions of pins 4 and 5, in the order of the codes. If pin 5 is the direction, active means reversed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Mode {
    /// 0000: a step when pin 4 becomes active; pin 5 is the direction.
    StepDirection,
    /// 0001: a profile move when pin 4 becomes active; pin 5 is the direction.
    MoveDirection,
    /// 0010: a profile move when pin 4 becomes active, the reversed move when pin 4 becomes inactive.
    MoveForwardBackward,
    /// 0011: a profile move when pin 4 becomes active, a home cycle when pin 4 becomes inactive.
    MoveThenHome,
    /// 0100: a profile move when pin 4 becomes active, the reversed move when pin 5 becomes active.
    MoveEitherWay,
    /// 0101: a profile move when pin 4 becomes active, a home cycle when pin 5 becomes active.
    MoveOrHome,
    /// 0110: a jog while pin 4 is active; pin 5 is the direction.
    JogDirection,
    /// 0111: a jog while pin 4 is active, a reversed jog while pin 5 is active.
    JogEitherWay,
    /// 1000: profile moves forward and backward, endlessly.
    EndlessMoves,
    /// 1001: a profile move and a home cycle, endlessly.
    EndlessHomes,
    /// 1111 and the codes that the manual does not print: no function.
    None,
}

/// The functions of J2 pins 2 to 5.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Pins {
    /// Bits of the inputs that are active high.
    polarity: u16,
    pub(super) pin_2: Pin2,
    pub(super) pin_3: Pin3,
    pub(super) mode: Mode,
}

impl Pins {
    /// The functions that PinFunctionAndPolarity and HomingConfiguration select, for a stepper or a DC motor.
    pub(super) fn new(function: u16, homing: u16, dc: bool) -> Self {
        let pin_2 = match (homing::mode(homing), function >> pin_function::PIN_2_AT & 3) {
            // While homing searches for the flag, pin 2 is the flag, whatever its function (MD3-18).
            (Some(Homing { by_index: false, .. }), _) => Pin2::Flag,
            (_, 0) => Pin2::LowCurrent,
            (_, 1) => Pin2::SpeedSelect,
            _ => Pin2::None,
        };
        let pin_3 = match function >> pin_function::PIN_3_AT & 3 {
            0 => Pin3::Inhibit,
            1 => Pin3::Home,
            2 => Pin3::InhibitModbus,
            _ => Pin3::None,
        };
        let mode = match function >> pin_function::PINS_4_5_AT & 0xF {
            0b0110 => Mode::JogDirection,
            0b0111 => Mode::JogEitherWay,
            // A DC motor: "0110 or 0111 are the only allowed options."
            _ if dc => Mode::None,
            0b0000 => Mode::StepDirection,
            0b0001 => Mode::MoveDirection,
            0b0010 => Mode::MoveForwardBackward,
            0b0011 => Mode::MoveThenHome,
            0b0100 => Mode::MoveEitherWay,
            0b0101 => Mode::MoveOrHome,
            0b1000 => Mode::EndlessMoves,
            0b1001 => Mode::EndlessHomes,
            _ => Mode::None,
        };
        Self { polarity: function & INPUTS, pin_2, pin_3, mode }
    }

    /// Bits of the inputs that are active at these levels. An input is active low unless its polarity is
    /// inverted.
    pub(super) fn active(&self, levels: u16) -> u16 {
        !(levels ^ self.polarity) & INPUTS
    }
}
