//! What lines are made of: words, numbers, operands, places.

use super::{find, name};
use crate::mdrive::error::Error;
use crate::mdrive::mcode::mnemonic::Mnemonic;
use crate::mdrive::mcode::statement::{Condition, Expression, Name, Operand, Operator, Place, Relation};
use crate::mdrive::registers::Reg;

/// What the number 1 is to the drive.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Scale {
    One,
    /// Of CR, which is kept in thousandths.
    Thousand,
}

impl Scale {
    pub(super) fn of(reg: Reg) -> Self {
        if reg == Reg::CR { Self::Thousand } else { Self::One }
    }
}

/// What is left of a line.
pub(super) struct Scanner<'a> {
    pub(super) rest: &'a [u8],
    pub(super) variants: u8,
}

impl<'a> Scanner<'a> {
    /// The next character that is no blank.
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

    /// The letters and digits that come next.
    pub(super) fn word(&mut self) -> &'a [u8] {
        self.peek();
        let rest = self.rest;
        let end = rest.iter().position(|character| !character.is_ascii_alphanumeric());
        rest.get(..end.unwrap_or(rest.len())).unwrap_or(rest)
    }

    pub(super) fn find(&self, word: &[u8]) -> Option<Mnemonic> {
        find(word, self.variants)
    }

    /// Nothing more may come.
    pub(super) fn end(&mut self) -> Result<(), Error> {
        match self.peek() {
            None => Ok(()),
            Some(next) if next.is_ascii_alphanumeric() => Err(Error::MissingSeparator),
            Some(_) => Err(Error::IllegalData),
        }
    }

    /// What follows a comma, if there is one; else nothing more may come.
    pub(super) fn optional<T>(
        &mut self,
        item: impl FnOnce(&mut Self) -> Result<T, Error>,
    ) -> Result<Option<T>, Error> {
        if self.take(b',') { item(self).map(Some) } else { self.end().map(|()| None) }
    }

    /// An operand, or two with an operator between them (MC 4.9). A minus before a variable is that
    /// operator.
    pub(super) fn expression(&mut self, scale: Scale) -> Result<Expression, Error> {
        if let [b'-', rest @ ..] = self.rest.trim_ascii_start()
            && rest.trim_ascii_start().first().is_some_and(u8::is_ascii_alphabetic)
        {
            self.take(b'-');
            let less = Some((Operator::Minus, self.operand(scale)?));
            return Ok(Expression { not: false, first: Operand::Number(0), then: less });
        }
        let not = self.take(b'!');
        let first = self.operand(scale)?;
        let operator = match self.peek() {
            Some(b'+') => Operator::Plus,
            Some(b'-') => Operator::Minus,
            Some(b'*') => Operator::Times,
            Some(b'/') => Operator::Over,
            Some(b'&') => Operator::And,
            Some(b'|') => Operator::Or,
            Some(b'^') => Operator::Xor,
            _ => return Ok(Expression { not, first, then: None }),
        };
        self.skip(1);
        let second = self.operand(scale)?;
        Ok(Expression { not, first, then: Some((operator, second)) })
    }

    /// Of BR and CL.
    pub(super) fn condition(&mut self) -> Result<Condition, Error> {
        let left = self.operand(Scale::One)?;
        if self.peek().is_none() {
            return Ok(Condition { left, right: None });
        }
        let (relation, count) = match self.rest {
            [b'<', b'>', ..] => (Relation::Unequal, 2),
            [b'<', b'=', ..] => (Relation::AtMost, 2),
            [b'>', b'=', ..] => (Relation::AtLeast, 2),
            [b'=', ..] => (Relation::Equal, 1),
            [b'<', ..] => (Relation::Less, 1),
            [b'>', ..] => (Relation::Greater, 1),
            _ => return Err(Error::IllegalData),
        };
        self.skip(count);
        let scale = if let Operand::Variable(reg) = left { Scale::of(reg) } else { Scale::One };
        Ok(Condition { left, right: Some((relation, self.operand(scale)?)) })
    }

    pub(super) fn operand(&mut self, scale: Scale) -> Result<Operand, Error> {
        match self.peek() {
            Some(b'0'..=b'9' | b'+' | b'-') => self.number(scale).map(Operand::Number),
            Some(letter) if letter.is_ascii_alphabetic() => {
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

    /// What IV, IC and DC are about.
    pub(super) fn variable(&mut self) -> Result<Operand, Error> {
        let word = self.word();
        match self.find(word) {
            Some(Mnemonic::List(_) | Mnemonic::Keyword(_) | Mnemonic::Instruction(_)) => {
                Err(Error::NotCountable)
            }
            _ => match self.operand(Scale::One)? {
                Operand::Number(_) => Err(Error::IllegalData),
                variable => Ok(variable),
            },
        }
    }

    /// An address or a label.
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
            _ => self.number(Scale::One).map(Place::Address),
        }
    }

    /// The name of a new label or variable; SU is for a label (MC 5-71).
    pub(super) fn new_name(&mut self, label: bool) -> Result<Name, Error> {
        let word = self.word();
        self.skip(word.len());
        let name = name(word).ok_or(Error::IllegalData)?;
        let free = self.find(word).is_none() && (label || name != *b"SU");
        if free { Ok(name) } else { Err(Error::BuiltIn) }
    }

    /// A number with or without a sign; three decimals at most of what is kept in thousandths.
    pub(super) fn number(&mut self, scale: Scale) -> Result<i32, Error> {
        let minus = self.take(b'-');
        if !minus {
            self.take(b'+');
        }
        let mut value = self.digits().ok_or(Error::IllegalData)?;
        if scale == Scale::Thousand {
            let decimals = self.decimals()?;
            value = value.saturating_mul(1_000).saturating_add(decimals);
        }
        i32::try_from(if minus { -value } else { value }).map_err(|_| Error::IllegalValue)
    }

    /// A run of digits, which no letter follows; more than 32 bits are too many, whatever they are.
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

    /// Behind a point, in thousandths; 0 without one.
    fn decimals(&mut self) -> Result<i64, Error> {
        if !self.take(b'.') {
            return Ok(0);
        }
        let word = self.word();
        let value = self.digits().ok_or(Error::IllegalData)?;
        match word.len() {
            1 => Ok(value * 100),
            2 => Ok(value * 10),
            3 => Ok(value),
            _ => Err(Error::IllegalData),
        }
    }
}
