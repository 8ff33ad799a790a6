//! Reading and writing of variables, by the bus and by MCode.
//!
//! The drive stores a value of each (`stored`). All values of a write are validated first (`judge`), then
//! applied (`apply`, `lists`). EE changes units (`units`).

mod apply;
mod judge;
mod lists;
mod stored;
mod units;

use drivetwin_protocol::registers::{Entry, Register, Row, Shape};

pub(super) use self::judge::{illegal, refuses};
pub(super) use self::stored::Registers;
use super::drive::{Drive, Model};
use super::error::Error;
use super::hybrid::frequency;
use super::mcode::names::Meaning;
use super::mcode::statement::{Name, Operand};
use super::registers::{Reg, is_frequency};
use crate::device::Instant;

/// Stored value of CR for a ratio of 1.
pub(super) const RATIO_ONE: i32 = 1_000;
/// Value of AS for torque mode.
const TORQUE: i64 = 3;

impl Drive {
    /// Present value of a variable, as its register reads. This has none of the side effects of reading. A
    /// user variable that is not declared is 0.
    pub(super) fn read(&self, at: Instant, reg: Reg) -> i32 {
        match reg {
            Reg::C1 => self.motion.shaft().steps(at),
            Reg::C2 => self.motion.shaft().counts(at),
            Reg::P => self.motion.shaft().displayed_position(at),
            Reg::EF => self.errors.is_set().into(),
            Reg::ER => self.errors.number().into(),
            Reg::I1 | Reg::O1 => self.io.is_active(1).into(),
            Reg::I2 | Reg::O2 => self.io.is_active(2).into(),
            Reg::I3 | Reg::O3 => self.io.is_active(3).into(),
            Reg::I4 | Reg::O4 => self.io.is_active(4).into(),
            Reg::I5 => self.io.analogue(at).into(),
            Reg::I6 => self.motion.shaft().is_on_index(at).into(),
            Reg::IL => self.io.levels().into(),
            Reg::IN => self.io.raw_levels().into(),
            Reg::IF => self.mcode.vm.awaits_input().into(),
            Reg::MP => self.motion.is_positioning().into(),
            Reg::MV => self.motion.is_moving().into(),
            Reg::PC => self.mcode.trips.captured(),
            Reg::ST => self.motion.has_stalled().into(),
            Reg::TE => self.mcode.trips.enabled().into(),
            // In torque mode V is 0 (FB 5, V).
            Reg::V if self.bank.model() == Model::Hybrid && self.bank.get(Reg::AS) == TORQUE => 0,
            Reg::V => self.motion.velocity(at),
            Reg::VC => self.motion.is_changing(at).into(),
            // The register has one byte (FB 5.1).
            Reg::AF => (self.hybrid.status(at, &self.bank, &self.motion) & 0xFF).into(),
            Reg::LL => self.hybrid.lag(at, &self.bank, &self.motion),
            Reg::LR => self.hybrid.is_locked().into(),
            Reg::IT => self.hybrid.temperature(at),
            Reg::BY => self.mcode.vm.is_running().into(),
            // These variables are commands, which store no value.
            Reg::DC | Reg::IC | Reg::OL | Reg::OT | Reg::S | Reg::CF | Reg::SC => 0,
            _ => match user_name(reg) {
                Some(name) => self.user_variable(name).unwrap_or(0),
                None => self.bank.stored(reg),
            },
        }
    }

    /// Present value of a variable as MCode reads it: SS and TS in Hz, AF with all its bits.
    pub(super) fn read_mcode(&self, at: Instant, reg: Reg) -> i32 {
        match reg {
            Reg::AF => self.hybrid.status(at, &self.bank, &self.motion).into(),
            _ if is_frequency(reg) => frequency(self.read(at, reg)),
            _ => self.read(at, reg),
        }
    }

    /// Applies the side effect of reading a variable: reading ER clears it.
    pub(super) fn has_read(&mut self, reg: Reg) {
        if reg == Reg::ER {
            self.errors.clear();
        }
    }

    /// Value of an operand of MCode, without its fraction. Reading a variable has its side effects.
    ///
    /// # Errors
    /// Error 30: there is no such user variable.
    pub(super) fn operand(&mut self, at: Instant, operand: Operand) -> Result<i32, Error> {
        match operand {
            Operand::Number(number) => Ok(number),
            Operand::Ratio(thousandths) => Ok(thousandths / RATIO_ONE),
            Operand::Variable(Reg::CR) => Ok(self.bank.stored(Reg::CR) / RATIO_ONE),
            Operand::Variable(reg) => {
                let value = self.read_mcode(at, reg);
                self.has_read(reg);
                Ok(value)
            }
            Operand::User(name) => self.user_variable(name).ok_or(Error::UnknownLabel),
        }
    }

    /// Value of an operand in thousandths, the unit in which CR is stored.
    ///
    /// # Errors
    /// As [`Self::operand`].
    pub(super) fn thousandths(&mut self, at: Instant, operand: Operand) -> Result<i64, Error> {
        match operand {
            Operand::Ratio(thousandths) => Ok(thousandths.into()),
            Operand::Variable(Reg::CR) => Ok(self.bank.stored(Reg::CR).into()),
            whole => self.operand(at, whole).map(|value| i64::from(value) * i64::from(RATIO_ONE)),
        }
    }

    /// Returns true if a row is present: the model has it, and a user variable is declared.
    pub(super) fn is_present(&self, reg: Reg) -> bool {
        self.bank.has(reg) && user_name(reg).is_none_or(|name| self.user_variable(name).is_some())
    }

    /// Returns true if there is a user variable of that name.
    pub(super) fn has_user_variable(&self, name: Name) -> bool {
        self.user_variable(name).is_some()
    }

    fn user_variable(&self, name: Name) -> Option<i32> {
        match self.mcode.names.find(name)? {
            Meaning::Global(value) | Meaning::Local(value) => Some(value),
            Meaning::Label(_) => None,
        }
    }
}

/// Entry of a variable in the register map.
pub(super) fn entry(reg: Reg) -> &'static Entry {
    static NONE: Entry = Row::setting(0, "no row").entry;
    Reg::ENTRIES.list.get(reg.row()).unwrap_or(&NONE)
}

/// Splits the number of a row into the values of a set-up. Unused values at the end are 0.
pub(super) fn words(reg: Reg, value: i64) -> [u16; 3] {
    let word = |n: u16| (value >> (16 * n) & 0xFFFF) as u16;
    match entry(reg).shape.words() {
        3 => [word(2), word(1), word(0)],
        _ => [word(1), word(0), 0],
    }
}

/// Returns true if a variable has one value, not several.
pub(super) fn is_number(reg: Reg) -> bool {
    !matches!(entry(reg).shape, Shape::Words(_))
}

/// Amount that IC or DC adds.
fn step(reg: Reg) -> i32 {
    if reg == Reg::DC { -1 } else { 1 }
}

/// Bit of an output, O1 to O4, in OL.
fn output_bit(reg: Reg) -> i32 {
    match reg {
        Reg::O1 => 1,
        Reg::O2 => 2,
        Reg::O3 => 4,
        _ => 8,
    }
}

/// Name of the user variable behind one of the registers V1 to V8 (FB 5.2).
fn user_name(reg: Reg) -> Option<Name> {
    let digit = match reg {
        Reg::V1 => b'1',
        Reg::V2 => b'2',
        Reg::V3 => b'3',
        Reg::V4 => b'4',
        Reg::V5 => b'5',
        Reg::V6 => b'6',
        Reg::V7 => b'7',
        Reg::V8 => b'8',
        _ => return None,
    };
    Some([b'V', digit])
}
