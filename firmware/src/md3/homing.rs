//! The fields of HomingConfiguration (7.5).

use fixed::types::{I24F8, U24F8};

use super::Words;
use super::registers::Reg;

const ON_STARTUP: u16 = 1 << 0;
const BACKWARD: u16 = 1 << 4;

/// A value of `HomingConfiguration`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Homing(u16);

/// The end of the search in a home cycle.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Target {
    /// The flag on J2 pin 2.
    Flag,
    /// The index on J2 pin 9.
    Index,
}

impl Homing {
    /// The value of a register of 0.
    pub(super) const ZERO: Self = Self(0);

    /// The value of the register.
    pub(super) fn of(bank: &Words) -> Self {
        Self(bank.word(Reg::HomingConfiguration))
    }

    /// Returns true if a home cycle runs after the start-up.
    pub(super) fn is_on_startup(self) -> bool {
        self.0 & ON_STARTUP != 0
    }

    /// The target of the search; `None` for the modes that the manual does not print.
    pub(super) fn target(self) -> Option<Target> {
        match self.mode() {
            0 | 1 => Some(Target::Flag),
            2 | 3 => Some(Target::Index),
            _ => None,
        }
    }

    /// Returns true if the motor stops at the target with a ramp, false if it stops at once.
    pub(super) fn has_ramp(self) -> bool {
        matches!(self.mode(), 1 | 3)
    }

    /// The signed speed of the search.
    pub(super) fn search_speed(self, speed: U24F8) -> I24F8 {
        let divided = I24F8::from_bits(speed.to_bits().cast_signed() >> (self.0 >> 5 & 7));
        if self.0 & BACKWARD != 0 { -divided } else { divided }
    }

    fn mode(self) -> u16 {
        self.0 >> 1 & 7
    }
}
