//! PR: texts and values.

use drivetwin_protocol::registers::Register;
use heapless::Vec;

use super::Reader;
use crate::mdrive::error::Error;
use crate::mdrive::mcode::console::CR_LF;
use crate::mdrive::mcode::mnemonic::{self, Keyword, Mnemonic};
use crate::mdrive::mcode::names::{Meaning, name};
use crate::mdrive::mcode::operand::{List, Operand, Parameter};
use crate::mdrive::registers::{FIRMWARE, HARDWARE, Model, PART_NUMBER, ROWS, Reg, SERIAL_NUMBER};
use crate::mdrive::variables::RATIO_ONE;

/// Destination of text, piece by piece.
pub(in crate::mdrive) trait Text {
    /// Takes some characters.
    fn write(&mut self, text: &[u8]);
}

/// Item of PR.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Item<'a> {
    Text(&'a [u8]),
    Variable(Reg),
    List(List),
    Keyword(Keyword),
    User(i32),
}

impl Reader<'_> {
    /// Prints the items of PR, and ends the line unless the items end with a semicolon (MC 5-57). Printing ER
    /// clears it.
    ///
    /// # Errors
    /// Error 24, 30, 35, 37: nothing is printed then.
    pub(in crate::mdrive) fn print(&mut self, items: &[u8], to: &mut dyn Text) -> Result<(), Error> {
        let items = items.trim_ascii_end();
        let (items, end) = match items.strip_suffix(b";") {
            Some(items) => (items, &b""[..]),
            None => (items, CR_LF),
        };
        self.print_values(items, to)?;
        to.write(end);
        Ok(())
    }

    /// Prints texts and values. Commas or blanks separate them in `items`; nothing is printed between them.
    ///
    /// # Errors
    /// Those of [`Self::print`].
    pub(in crate::mdrive) fn print_values(&mut self, items: &[u8], to: &mut dyn Text) -> Result<(), Error> {
        let mut rest = items;
        while self.item(&mut rest)?.is_some() {}
        rest = items;
        while let Some(item) = self.item(&mut rest)? {
            match item {
                Item::Text(text) => to.write(text),
                Item::User(value) => write_number(value, to),
                Item::List(list) => self.print_list(list, to),
                Item::Keyword(keyword) => self.print_keyword(keyword, to),
                Item::Variable(reg) => {
                    self.print_variable(reg, to);
                    self.has_read(reg);
                }
            }
        }
        Ok(())
    }

    /// Number of items of PR, up to the first invalid one. Each line of AL and UV counts as an item
    /// (MDRIVE-14).
    pub(super) fn count_items(&self, mut items: &[u8]) -> u32 {
        let mut count = 0;
        while let Ok(Some(item)) = self.item(&mut items) {
            count += match item {
                Item::Keyword(Keyword::AL) => mnemonic::variables(self.bank.variants()).count() as u32,
                Item::Keyword(Keyword::UV) => self.mcode.names.iter().count() as u32,
                _ => 1,
            };
        }
        count
    }

    /// Takes the next item of `rest`.
    fn item<'a>(&self, rest: &mut &'a [u8]) -> Result<Option<Item<'a>>, Error> {
        let is_apart = |character: &u8| *character == b',' || character.is_ascii_whitespace();
        let start = rest.iter().position(|character| !is_apart(character));
        let Some(text) = start.and_then(|start| rest.get(start..)) else { return Ok(None) };
        if let Some(quoted) = text.strip_prefix(b"\"") {
            let end = quoted.iter().position(|character| *character == b'"').ok_or(Error::IllegalData)?;
            let (text, behind) = quoted.split_at_checked(end).ok_or(Error::IllegalData)?;
            *rest = behind.strip_prefix(b"\"").unwrap_or_default();
            return Ok(Some(Item::Text(text)));
        }
        let end = text.iter().position(|character| !character.is_ascii_alphanumeric());
        let (word, behind) = text.split_at_checked(end.unwrap_or(text.len())).ok_or(Error::IllegalData)?;
        *rest = behind;
        match mnemonic::find(word, self.bank.variants()) {
            _ if !word.first().is_some_and(u8::is_ascii_alphabetic) => Err(Error::IllegalData),
            Some(Mnemonic::Variable(reg)) => Ok(Some(Item::Variable(reg))),
            Some(Mnemonic::List(list)) => Ok(Some(Item::List(list))),
            Some(Mnemonic::Keyword(keyword)) => Ok(Some(Item::Keyword(keyword))),
            Some(Mnemonic::Instruction(_)) => Err(Error::NotPrintable),
            Some(Mnemonic::NotAvailable) => Err(Error::NotAvailable),
            None => match name(word).and_then(|name| self.mcode.names.find(name)) {
                Some(Meaning::Global(value) | Meaning::Local(value)) => Ok(Some(Item::User(value))),
                Some(Meaning::Label(_)) => Err(Error::NotPrintable),
                None => Err(Error::UnknownLabel),
            },
        }
    }

    fn print_variable(&self, reg: Reg, to: &mut dyn Text) {
        let value = self.read_mcode(reg);
        match reg {
            Reg::CR => {
                write_number(value / RATIO_ONE, to);
                let digits = [value / 100, value / 10, value].map(|rest| b'0' + (rest % 10) as u8);
                to.write(b".");
                to.write(&digits);
            }
            Reg::DN => to.write(&[b'"', (value & 0x7F) as u8, b'"']),
            _ => write_number(value, to),
        }
    }

    fn print_list(&self, list: List, to: &mut dyn Text) {
        match list {
            List::Trip(trip) => write_values(&self.mcode.trips.parameters(trip), to),
            List::Io(reg) => {
                let values = self.bank.set_up_of(reg).map(|value| number(value.into()));
                write_values(values.get(..list.len()).unwrap_or(&values), to);
            }
            List::With(reg) => {
                // MU's second value "is not saved" (MC 4.8).
                let with = if reg == Reg::CA { self.bank.stored(Reg::CalibrationMethod) } else { 0 };
                write_values(&[number(self.bank.stored(reg)), number(with)], to);
            }
        }
    }

    fn print_keyword(&self, keyword: Keyword, to: &mut dyn Text) {
        match keyword {
            Keyword::AL => self.print_all(to),
            Keyword::UV => self.print_user_variables(to),
            Keyword::MD => to.write(self.mcode.vm.last_motion().map_or(b"", name_of)),
            Keyword::PN => to.write(&self.bank.text(PART_NUMBER)),
            Keyword::SN => to.write(&self.bank.text(SERIAL_NUMBER)),
            Keyword::VR => {
                to.write(&self.bank.text(FIRMWARE));
                if self.bank.model() == Model::Hybrid {
                    to.write(b", ");
                    to.write(&self.bank.text(HARDWARE));
                }
            }
        }
    }

    /// AL: all variables and flags, one line each, including MD and VR (MC 5-1). This does not clear ER.
    fn print_all(&self, to: &mut dyn Text) {
        for (word, mnemonic) in mnemonic::variables(self.bank.variants()) {
            to.write(word.trim_ascii_end());
            to.write(b" = ");
            match mnemonic {
                Mnemonic::Variable(reg) => self.print_variable(reg, to),
                Mnemonic::List(list) => self.print_list(list, to),
                Mnemonic::Keyword(keyword) => self.print_keyword(keyword, to),
                _ => {}
            }
            to.write(CR_LF);
        }
    }

    /// UV: `G` marks global, `L` local variables; labels are printed with their addresses (MC 5-77).
    fn print_user_variables(&self, to: &mut dyn Text) {
        for (name, meaning) in self.mcode.names.iter() {
            let (kind, value): (&[u8], i32) = match meaning {
                Meaning::Label(address) => (b"", address.into()),
                Meaning::Global(value) => (b"G ", value),
                Meaning::Local(value) => (b"L ", value),
            };
            for text in [name.trim_ascii_end(), b" = ", kind] {
                to.write(text);
            }
            write_number(value, to);
            to.write(CR_LF);
        }
    }
}

/// The mnemonic of a variable.
fn name_of(reg: Reg) -> &'static [u8] {
    ROWS.get(reg.row()).map_or(b"", |row| row.name.as_bytes())
}

fn number(value: i32) -> Parameter {
    Parameter::Value(Operand::Number(value))
}

/// Writes values with a comma and a blank between them.
fn write_values(values: &[Parameter], to: &mut dyn Text) {
    for (n, value) in values.iter().enumerate() {
        if n > 0 {
            to.write(b", ");
        }
        match value {
            Parameter::Value(Operand::Number(value)) => write_number(*value, to),
            Parameter::Value(Operand::User(name)) | Parameter::Label(name) => to.write(name.trim_ascii_end()),
            // Only numbers and labels are stored.
            Parameter::Value(Operand::Ratio(_) | Operand::Variable(_)) | Parameter::Absent => {}
        }
    }
}

/// Writes a number in decimal.
fn write_number(value: i32, to: &mut dyn Text) {
    let mut text = Vec::<u8, 11>::new();
    let mut rest = value.unsigned_abs();
    // The text has room for the longest number.
    loop {
        let _ = text.push(b'0' + (rest % 10) as u8);
        rest /= 10;
        if rest == 0 {
            break;
        }
    }
    if value < 0 {
        let _ = text.push(b'-');
    }
    text.reverse();
    to.write(&text);
}
