//! The drive as its languages read it: values of variables, expressions and printed text, and whether a value may
//! be written. [`Reader`] changes nothing; but reading ER clears it, and the drive takes that over from the reader.
//!
//! | file | content |
//! |---|---|
//! | `judge` | validation of a value before a write has any effect |
//! | `evaluate` | expressions |
//! | `lists` | values of a variable with several values |
//! | `print` | PR: texts and values |
//! | `time` | execution times of typed lines |

mod evaluate;
mod judge;
mod lists;
mod print;
mod time;

pub(super) use self::judge::refuses;
pub(super) use self::print::Text;
use super::drive::Drive;
use super::error::{Error, Errors};
use super::hybrid::{Hybrid, is_in_torque_mode};
use super::io::Io;
use super::mcode::Mcode;
use super::mcode::parse::parse;
use super::mcode::statement::Statement;
use super::motion::Motion;
use super::registers::{Model, Reg, is_frequency};
use super::variables::{Registers, frequency, user_name};
use crate::device::Instant;

/// The drive at an instant.
pub(super) struct Reader<'a> {
    at: Instant,
    bank: &'a Registers,
    errors: Errors,
    io: &'a Io,
    motion: &'a Motion,
    hybrid: &'a Hybrid,
    mcode: &'a Mcode,
}

impl Drive {
    /// The drive as its languages read it.
    // Not inlined: a reader has seven fields, and there are many of them.
    #[inline(never)]
    pub(super) fn reader(&self, at: Instant) -> Reader<'_> {
        let Self { bank, io, motion, hybrid, mcode, .. } = self;
        Reader { at, bank, errors: self.mcode.errors, io, motion, hybrid, mcode }
    }

    /// Reads values, with the side effect of reading: ER is cleared.
    pub(super) fn read<T>(&mut self, at: Instant, read: impl FnOnce(&mut Reader<'_>) -> T) -> T {
        let mut reader = self.reader(at);
        let value = read(&mut reader);
        self.mcode.errors = reader.errors;
        value
    }
}

impl Reader<'_> {
    /// Present value of a variable, as its register reads. This has none of the side effects of reading. A
    /// user variable that is not declared is 0.
    pub(super) fn read(&self, reg: Reg) -> i32 {
        match reg {
            Reg::C1 => self.motion.shaft().steps(self.at),
            Reg::C2 => self.motion.shaft().counts(self.at),
            Reg::P => self.motion.shaft().displayed_position(self.at),
            Reg::EF => self.errors.is_set().into(),
            Reg::ER => self.errors.number().into(),
            Reg::I1 | Reg::O1 => self.io.is_active(1).into(),
            Reg::I2 | Reg::O2 => self.io.is_active(2).into(),
            Reg::I3 | Reg::O3 => self.io.is_active(3).into(),
            Reg::I4 | Reg::O4 => self.io.is_active(4).into(),
            Reg::I5 => self.io.analogue(self.at).into(),
            Reg::I6 => self.motion.shaft().is_on_index(self.at).into(),
            Reg::IL => self.io.levels().into(),
            Reg::IN => self.io.raw_levels().into(),
            Reg::IF => self.mcode.vm.awaits_input().into(),
            Reg::MP => self.motion.is_positioning().into(),
            Reg::MV => self.motion.is_moving().into(),
            Reg::PC => self.mcode.trips.captured(),
            Reg::ST => self.motion.has_stalled().into(),
            Reg::TE => self.mcode.trips.enabled().into(),
            // In torque mode V is 0 (FB 5, V).
            Reg::V if self.bank.model() == Model::Hybrid && is_in_torque_mode(self.bank) => 0,
            Reg::V => self.motion.velocity(self.at),
            Reg::VC => self.motion.is_changing(self.at).into(),
            // The register has one byte (FB 5.1).
            Reg::AF => (self.hybrid.status(self.at, self.bank, self.motion) & 0xFF).into(),
            Reg::LL => self.hybrid.lag(self.at, self.bank, self.motion),
            Reg::LR => self.hybrid.is_locked().into(),
            Reg::IT => self.hybrid.temperature(self.at),
            Reg::BY => self.mcode.vm.is_running().into(),
            // These variables are commands, which store no value.
            Reg::DC | Reg::IC | Reg::OL | Reg::OT | Reg::S | Reg::CF | Reg::SC => 0,
            _ => match user_name(reg) {
                Some(name) => self.mcode.names.value(name).unwrap_or(0),
                None => self.bank.stored(reg),
            },
        }
    }

    /// Present value of a variable as MCode reads it: SS and TS in Hz, AF with all its bits.
    pub(super) fn read_mcode(&self, reg: Reg) -> i32 {
        match reg {
            Reg::AF => self.hybrid.status(self.at, self.bank, self.motion).into(),
            _ if is_frequency(reg) => frequency(self.read(reg)),
            _ => self.read(reg),
        }
    }

    /// Present value of a variable, as its register reads. Reading ER clears it.
    pub(super) fn take(&mut self, reg: Reg) -> i32 {
        let value = self.read(reg);
        self.has_read(reg);
        value
    }

    /// Applies the side effect of reading a variable: reading ER clears it.
    fn has_read(&mut self, reg: Reg) {
        if reg == Reg::ER {
            self.errors.clear();
        }
    }

    /// Returns true if a row is present: the model has it, and a user variable is declared.
    pub(super) fn is_present(&self, reg: Reg) -> bool {
        self.bank.has(reg) && user_name(reg).is_none_or(|name| self.mcode.names.value(name).is_some())
    }

    /// Returns true if anything moves. S, SC, CF, MS and similar commands are refused then.
    pub(super) fn is_in_motion(&self) -> bool {
        self.motion.is_moving() || self.hybrid.turns()
    }

    /// Parses a line of MCode for this drive.
    ///
    /// # Errors
    /// The errors of [`parse`].
    pub(super) fn parse<'l>(&self, line: &'l [u8]) -> Result<Statement<'l>, Error> {
        parse(line, self.bank.variants(), &self.mcode.names)
    }
}
