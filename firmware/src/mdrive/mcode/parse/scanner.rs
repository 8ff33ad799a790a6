//! Scanner for parts of lines: words, numbers, operands, places.

use core::iter::repeat;

use crate::mdrive::error::Error;
use crate::mdrive::mcode::mnemonic::{self, Mnemonic};
use crate::mdrive::mcode::names::{Name, name};
use crate::mdrive::mcode::operand::{Operand, Place};
use crate::mdrive::registers::Reg;

/// Kind of a number.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Kind {
    Whole,
    /// With a fraction, as for CR.
    Ratio,
}

impl Kind {
    pub(super) fn of(reg: Reg) -> Self {
        if reg == Reg::CR { Self::Ratio } else { Self::Whole }
    }
}

/// The rest of a line that is not parsed yet.
pub(super) struct Scanner<'a> {
    pub(super) rest: &'a [u8],
    pub(super) variants: u8,
}

impl<'a> Scanner<'a> {
    /// Next character that is not a blank.
    pub(super) fn peek(&mut self) -> Option<u8> {
        self.rest = self.rest.trim_ascii_start();
        self.rest.first().copied()
    }

    pub(super) fn skip(&mut self, count: usize) {
        self.rest = self.rest.get(count..).unwrap_or_default();
    }

    /// Takes `character` if it is the next one.
    pub(super) fn take(&mut self, character: u8) -> bool {
        let here = self.peek() == Some(character);
        self.skip(usize::from(here));
        here
    }

    /// Letters and digits that come next, without taking them.
    pub(super) fn word(&mut self) -> &'a [u8] {
        self.peek();
        let rest = self.rest;
        let end = rest.iter().position(|character| !character.is_ascii_alphanumeric());
        rest.get(..end.unwrap_or(rest.len())).unwrap_or(rest)
    }

    pub(super) fn find(&self, word: &[u8]) -> Option<Mnemonic> {
        mnemonic::find(word, self.variants)
    }

    /// Checks that the line ends here.
    pub(super) fn end(&mut self) -> Result<(), Error> {
        match self.peek() {
            None => Ok(()),
            Some(next) if next.is_ascii_alphanumeric() => Err(Error::MissingSeparator),
            Some(_) => Err(Error::IllegalData),
        }
    }

    /// Parses the part after a comma, if there is one. Without a comma the line must end.
    pub(super) fn optional<T>(
        &mut self,
        item: impl FnOnce(&mut Self) -> Result<T, Error>,
    ) -> Result<Option<T>, Error> {
        if self.take(b',') { item(self).map(Some) } else { self.end().map(|()| None) }
    }

    pub(super) fn operand(&mut self, kind: Kind) -> Result<Operand, Error> {
        match (kind, self.peek()) {
            (Kind::Whole, Some(b'0'..=b'9' | b'+' | b'-')) => self.number().map(Operand::Number),
            (Kind::Ratio, Some(b'0'..=b'9' | b'+' | b'-' | b'.')) => self.ratio().map(Operand::Ratio),
            (_, Some(letter)) if letter.is_ascii_alphabetic() => {
                let word = self.word();
                self.skip(word.len());
                match self.find(word) {
                    Some(Mnemonic::Variable(reg)) => Ok(Operand::Variable(reg)),
                    Some(Mnemonic::NotAvailable) => Err(Error::NotAvailable),
                    Some(_) => Err(Error::UnknownLabel),
                    None => name(word).map(Operand::User).ok_or(Error::UnknownLabel),
                }
            }
            _ => Err(Error::IllegalData),
        }
    }

    /// Parses the operand of IC or DC.
    pub(super) fn counted(&mut self) -> Result<Operand, Error> {
        match self.next() {
            Some(Mnemonic::List(_) | Mnemonic::Keyword(_) | Mnemonic::Instruction(_)) => {
                Err(Error::NotCountable)
            }
            _ => self.variable(),
        }
    }

    /// Parses the operand of IV.
    pub(super) fn input(&mut self) -> Result<Operand, Error> {
        match self.next() {
            // A list has more than one number.
            Some(Mnemonic::List(_)) => Err(Error::IllegalData),
            Some(Mnemonic::Keyword(_)) => Err(Error::ReadOnly),
            Some(Mnemonic::Instruction(_)) => Err(Error::IsInstruction),
            _ => self.variable(),
        }
    }

    /// Meaning of the next word in the language.
    fn next(&mut self) -> Option<Mnemonic> {
        let word = self.word();
        self.find(word)
    }

    fn variable(&mut self) -> Result<Operand, Error> {
        match self.operand(Kind::Whole)? {
            Operand::Number(_) => Err(Error::IllegalData),
            variable => Ok(variable),
        }
    }

    /// Parses an address or a label.
    pub(super) fn place(&mut self) -> Result<Place, Error> {
        match self.peek() {
            Some(letter) if letter.is_ascii_alphabetic() => {
                let word = self.word();
                self.skip(word.len());
                match self.find(word) {
                    None => name(word).map(Place::Label).ok_or(Error::UnknownLabel),
                    Some(_) => Err(Error::UnknownLabel),
                }
            }
            _ => self.number().map(Place::Address),
        }
    }

    /// Parses the name of a new label or variable. SU can only be a label (MC 5-71).
    pub(super) fn new_name(&mut self, label: bool) -> Result<Name, Error> {
        let word = self.word();
        self.skip(word.len());
        let name = name(word).ok_or(Error::IllegalData)?;
        let free = self.find(word).is_none() && (label || name != *b"SU");
        if free { Ok(name) } else { Err(Error::BuiltIn) }
    }

    /// Parses a whole number with or without a sign.
    pub(super) fn number(&mut self) -> Result<i32, Error> {
        let minus = self.minus();
        signed(minus, self.digits().ok_or(Error::IllegalData)?)
    }

    /// Parses a number that may have a fraction, in thousandths.
    fn ratio(&mut self) -> Result<i32, Error> {
        let minus = self.minus();
        let whole = match self.peek() {
            Some(b'.') => None,
            _ => Some(self.digits().ok_or(Error::IllegalData)?),
        };
        let decimals = if self.take(b'.') { self.decimals()? } else { None };
        if whole.or(decimals).is_none() {
            return Err(Error::IllegalData);
        }
        signed(minus, whole.unwrap_or(0).saturating_mul(1_000) + decimals.unwrap_or(0))
    }

    /// Takes a sign. Returns true if it is a minus.
    fn minus(&mut self) -> bool {
        let minus = self.take(b'-');
        if !minus {
            self.take(b'+');
        }
        minus
    }

    /// Takes a run of digits that no letter follows. The value is limited to 2⁴⁰, more than any 32-bit
    /// number.
    fn digits(&mut self) -> Option<i64> {
        let word = self.word();
        self.skip(word.len());
        if word.is_empty() {
            return None;
        }
        word.iter().try_fold(0_i64, |value, character| {
            let digit = char::from(*character).to_digit(10)?;
            Some((value * 10 + i64::from(digit)).min(1 << 40))
        })
    }

    /// Takes the digits after a decimal point, in thousandths; `None` if there are none.
    ///
    /// # Errors
    /// Error 21: the fraction is finer than thousandths; 24: a character is not a digit.
    fn decimals(&mut self) -> Result<Option<i64>, Error> {
        let word = self.word();
        self.skip(word.len());
        let mut value = 0;
        for (character, weight) in word.iter().zip([100, 10, 1].into_iter().chain(repeat(0))) {
            match char::from(*character).to_digit(10) {
                None => return Err(Error::IllegalData),
                Some(digit) if digit != 0 && weight == 0 => return Err(Error::IllegalValue),
                Some(digit) => value += i64::from(digit) * weight,
            }
        }
        Ok((!word.is_empty()).then_some(value))
    }
}

fn signed(minus: bool, value: i64) -> Result<i32, Error> {
    i32::try_from(if minus { -value } else { value }).map_err(|_| Error::IllegalValue)
}
