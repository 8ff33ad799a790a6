//! Validation of a value before a write has any effect.

use drivetwin_protocol::registers::{Register, Space};

use super::Reader;
use crate::mdrive::error::Error;
use crate::mdrive::hybrid::is_in_torque_mode;
use crate::mdrive::reasons::Why;
use crate::mdrive::registers::{Model, Reg};
use crate::mdrive::variables::{
    CLOSED_MICROSTEPS, NO_DELAY_MS, RATIO_ONE, entry, is_number, output_bit, step,
};

impl Reader<'_> {
    /// Checks that a variable may be set to `value`. `as_is` gives the values of other variables: the present
    /// ones, or those that the same request sets.
    ///
    /// # Errors
    /// Error 21, 22, 23 or 25, or an error of the drive's state.
    pub(in crate::mdrive) fn validate(
        &self,
        reg: Reg,
        value: i32,
        as_is: &dyn Fn(Reg) -> i32,
    ) -> Result<(), Error> {
        // I6 has no register on a Hybrid, but is one of its variables.
        if !entry(reg).access.writes() {
            return Err(Error::ReadOnly);
        }
        if !self.is_present(reg) {
            return Err(Error::Unknown);
        }
        self.bank.validate_together(reg, value, as_is)?;
        match reg {
            _ if self.calibrates(reg, value) && self.is_in_motion() => Err(Error::CalibrationInMotion),
            Reg::EE if value == 1 && !self.bank.is_closed() => self.bank.validate_closing(),
            Reg::LK if value == 0 && self.bank.stored(Reg::LK) == 1 => Err(Error::Locked),
            Reg::O1 | Reg::O2 | Reg::O3 | Reg::O4 => self.validate_outputs(output_bit(reg)),
            // Higher bits are those of outputs that this drive does not have (MC 5-54).
            Reg::OL | Reg::OT => self.validate_outputs(value & 0xF),
            Reg::IC | Reg::DC => {
                let counted = self.counted_by_address(value)?;
                // A value that the same request writes to a later register does not apply yet.
                let stored =
                    if counted.row() < reg.row() { as_is(counted) } else { self.bank.stored(counted) };
                let value = self.counted(counted, step(reg), stored)?;
                self.validate(counted, value, as_is)
            }
            Reg::TE => self.mcode.trips.validate(value, self.bank),
            // "Once the default character has been changed it can not be reset" (MC 5-20).
            Reg::DN if value != self.bank.stored(Reg::DN) && !is_name(value.into()) => {
                Err(Error::IllegalValue)
            }
            Reg::IF if value == 1 && self.mcode.vm.awaits_input() => Err(Error::InputPending),
            Reg::S if self.is_in_motion() => Err(Error::SaveInMotion),
            Reg::CF if self.is_in_motion() => Err(Error::ClearLockedInMotion),
            Reg::AS if self.hybrid.is_calibrating() => Err(Error::JogInClockMode),
            Reg::MA | Reg::MR | Reg::SL | Reg::HM => self.hybrid.takes_orders(),
            _ => Ok(()),
        }
    }

    /// Returns true if a write makes a Hybrid calibrate (FB 5.1, CA).
    pub(in crate::mdrive) fn calibrates(&self, reg: Reg, value: i32) -> bool {
        let calibrates = match reg {
            Reg::AS => self.bank.stored(reg) == 0 && value != 0,
            // "Bridge is re-enabled after being disabled" (MC 5-9), also if heat or a locked rotor has
            // disabled it (MDRIVE-31).
            Reg::DE => !self.hybrid.has_bridge(self.bank) && value != 0,
            Reg::MS => value != self.bank.stored(reg),
            // EE = 1 changes MS to 256.
            Reg::EE => value != 0 && self.bank.stored(Reg::MS) != CLOSED_MICROSTEPS,
            Reg::SC => true,
            _ => false,
        };
        calibrates && self.bank.model() == Model::Hybrid
    }

    /// Checks that outputs, one bit each, can be set active.
    ///
    /// # Errors
    /// Error 9 if a point is not a general purpose output, or if there is no such output at all.
    fn validate_outputs(&self, bits: i32) -> Result<(), Error> {
        let outputs = i32::from(self.io.outputs());
        if bits & !outputs == 0 && outputs != 0 { Ok(()) } else { Err(Error::NoOutput) }
    }

    /// Finds the variable at the address that IC or DC receives on the bus.
    pub(in crate::mdrive) fn counted_by_address(&self, address: i32) -> Result<Reg, Error> {
        let entries = self.bank.model().entries();
        let mut list = entries.list.iter();
        let row = list.position(|row| row.space == Space::Holding && i32::from(row.address) == address);
        row.and_then(Reg::from_row).filter(|&reg| self.is_present(reg)).ok_or(Error::NotCountable)
    }

    /// Computes the value of a variable after counting. `stored` is the value before, for variables that are
    /// not computed when read.
    pub(in crate::mdrive) fn counted(&self, reg: Reg, by: i32, stored: i32) -> Result<i32, Error> {
        if !is_countable(reg) {
            return Err(Error::NotCountable);
        }
        let value = if entry(reg).live { self.read(reg) } else { stored };
        Ok(value.wrapping_add(if reg == Reg::CR { by * RATIO_ONE } else { by }))
    }

    /// Returns the reason if a value that has been stored has no effect now. `changes` is true if it differs
    /// from the value before.
    pub(in crate::mdrive) fn has_effect(&self, reg: Reg, changes: bool) -> Result<(), Why> {
        let is = |value| self.bank.stored(reg) == value;
        match reg {
            Reg::A | Reg::D | Reg::VI | Reg::VM if changes => {
                self.motion.activity().needs_rates(reg == Reg::VM)
            }
            Reg::HT if is(0) => Err(Why::NeverHolds),
            Reg::RC | Reg::HC if self.hybrid.has_torque() => Err(Why::TorqueCurrent),
            Reg::HC if self.motion.never_holds() => Err(Why::NoHolding),
            Reg::DE if is(1) => self.hybrid.needs_bridge(self.bank),
            Reg::AS if is_in_torque_mode(self.bank) => {
                self.hybrid.needs_bridge(self.bank)?;
                if self.motion.is_moving() { Err(Why::TorqueAtRest) } else { Ok(()) }
            }
            Reg::TD if changes && self.hybrid.has_torque() => Err(Why::TorqueBegan),
            _ => Ok(()),
        }
    }
}

/// Returns true if DN may be this character: a to z, A to Z, 0 to 9 (MC 5-20).
fn is_name(character: i64) -> bool {
    u8::try_from(character).is_ok_and(|character| character.is_ascii_alphanumeric())
}

/// Returns true for a value that the range of its variable has, but that no write can set.
pub(in crate::mdrive) fn refuses(row: usize, value: i64) -> bool {
    let is_factory_value = |reg| entry(reg).reset == value;
    match Reg::from_row(row) {
        Some(Reg::HT) => value == i64::from(NO_DELAY_MS),
        Some(Reg::DN) => !is_name(value) && !is_factory_value(Reg::DN),
        Some(Reg::IC | Reg::DC) => {
            let mut list = Reg::ENTRIES.list.iter();
            let row = list.position(|row| row.space == Space::Holding && i64::from(row.address) == value);
            !row.and_then(Reg::from_row).is_some_and(is_countable)
        }
        _ => false,
    }
}

/// Returns true if IC and DC can count this variable. They cannot count commands and the baud rate (MC 9.2).
fn is_countable(reg: Reg) -> bool {
    let does = matches!(
        reg,
        Reg::CF
            | Reg::DC
            | Reg::ER
            | Reg::HM
            | Reg::IC
            | Reg::MA
            | Reg::MR
            | Reg::OL
            | Reg::OT
            | Reg::S
            | Reg::SC
            | Reg::SL
    );
    entry(reg).access.writes() && is_number(reg) && !does && reg != Reg::BD
}
