//! Parser of lines. `=`, a blank or nothing separates a name from its value. Upper and lower case are the
//! same. Blanks may be anywhere between words (MDRIVE-9).

mod expression;
mod scanner;

use heapless::Vec;

pub(in crate::mdrive) use self::expression::Expression;
use self::scanner::{Kind, Scanner};
use super::super::error::Error;
use super::super::registers::Reg;
use super::super::variables::Registers;
use super::mnemonic::{Instruction, Mnemonic, SERIAL};
use super::names::{Name, Names, name, unknown};
use super::operand::{List, Operand, Parameter, Place};
use super::statement::Statement;

/// Parses a line for a drive of these variants and with these user names.
///
/// # Errors
/// Error 10, 20, 24 to 26, 29, 30, 33, 34, 37, 38 or 81 if the line is not a valid statement; 21 if it
/// contains a number that no variable can hold.
pub(in crate::mdrive) fn parse<'a>(
    line: &'a [u8],
    variants: u8,
    names: &Names,
) -> Result<Statement<'a>, Error> {
    let mut scanner = Scanner { rest: without_comment(line), variants };
    match scanner.peek() {
        None => Ok(Statement::Empty),
        Some(_) if begins_number(scanner.rest) => {
            // IV and CR accept a fraction.
            let kind = if scanner.rest.contains(&b'.') { Kind::Ratio } else { Kind::Whole };
            let value = scanner.expression(kind)?;
            scanner.end().map(|()| Statement::Number(value))
        }
        Some(letter) if letter.is_ascii_alphabetic() => scanner.statement(names),
        Some(_) => Err(Error::Unknown),
    }
}

/// Returns true if a line begins with a number, so that it has no command.
pub(in crate::mdrive) fn begins_number(line: &[u8]) -> bool {
    matches!(line.trim_ascii_start().first(), Some(b'0'..=b'9' | b'+' | b'-' | b'.'))
}

/// The part of a line before its comment (MC 3.3.1), without blanks at both ends.
pub(in crate::mdrive) fn without_comment(line: &[u8]) -> &[u8] {
    let mut quoted = false;
    let end = line.iter().position(|character| {
        quoted ^= *character == b'"';
        *character == b'\'' && !quoted
    });
    line.get(..end.unwrap_or(line.len())).unwrap_or(line).trim_ascii()
}

impl Registers {
    /// Variants whose MCode words (commands and variables) this drive knows, one bit each. The bit `SERIAL` is also set
    /// if the drive has a serial port.
    pub(in crate::mdrive) fn variants(&self) -> u8 {
        self.model().variant() | if self.is_serial() { SERIAL } else { 0 }
    }
}

/// The instruction S. A word of S and a number is the name of an I/O instead.
const SAVE: Mnemonic = Mnemonic::Instruction(Instruction::S);

/// First word of a statement.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Head {
    Known(Mnemonic),
    User(Name),
}

impl<'a> Scanner<'a> {
    /// Takes the first word of a statement. Digits after a name are its value, unless the whole word is
    /// another name. Letters after an instruction begin its operand.
    fn head(&mut self, names: &Names) -> Result<Head, Error> {
        let word = self.word();
        let known = |scanner: &Self, count: usize| word.get(..count).and_then(|word| scanner.find(word));
        let set = self.rest.get(word.len()..).is_some_and(|rest| rest.trim_ascii_start().starts_with(b"="));
        let user = word.get(..2).and_then(name).filter(|user| {
            // A variable that does not exist yet may exist when a program executes this line.
            names.find(*user).is_some() || word.len() == 2 && set
        });
        let digits = |count: usize| word.get(count..).is_some_and(|rest| rest.iter().all(u8::is_ascii_digit));

        let (count, head) = if let Some(mnemonic) = known(self, word.len()) {
            (word.len(), Head::Known(mnemonic))
        } else if word.len() > 2 && set && unknown(word) == Error::IllegalIo {
            return Err(Error::IllegalIo);
        } else if let Some(mnemonic @ Mnemonic::Instruction(_)) = known(self, 2) {
            (2, Head::Known(mnemonic))
        } else if let (Some(mnemonic), true) = (known(self, 2), digits(2)) {
            (2, Head::Known(mnemonic))
        } else if let (Some(user), true) = (user, digits(2)) {
            (2, Head::User(user))
        } else if let (Some(mnemonic), true) = (known(self, 1).filter(|it| *it != SAVE), digits(1)) {
            (1, Head::Known(mnemonic))
        } else {
            (word.len(), Head::User(name(word).ok_or_else(|| unknown(word))?))
        };
        self.skip(count);
        Ok(head)
    }

    /// Parses a line that begins with a letter.
    fn statement(mut self, names: &Names) -> Result<Statement<'a>, Error> {
        match self.head(names)? {
            Head::Known(Mnemonic::NotAvailable) => Err(Error::NotAvailable),
            Head::Known(Mnemonic::Instruction(name)) => self.instruction(name),
            Head::Known(Mnemonic::Variable(reg)) => {
                if reg == Reg::DN {
                    return self.device_name().map(Statement::Name);
                }
                self.value(Kind::of(reg)).map(|value| Statement::Set(reg, value))
            }
            Head::Known(Mnemonic::List(list)) => {
                self.list(list).map(|values| Statement::SetList(list, values))
            }
            Head::Known(Mnemonic::Keyword(_)) => {
                Err(if self.peek().is_none() { Error::IsVariable } else { Error::ReadOnly })
            }
            Head::User(name) => match self.value(Kind::Whole) {
                // This error applies whatever else is wrong.
                Err(_) if names.find(name).is_none() => Err(unknown(&name)),
                value => value.map(|value| Statement::SetUser(name, value)),
            },
        }
    }

    /// Parses the rest of a line that begins with an instruction.
    fn instruction(mut self, name: Instruction) -> Result<Statement<'a>, Error> {
        let text = self.rest;
        let nothing = text.trim_ascii().is_empty();
        let equals = self.take(b'=');
        if name.stands_alone() && !nothing {
            return Err(if equals { Error::IsInstruction } else { Error::IllegalData });
        }
        let place = |scanner: &mut Self| if nothing { Ok(None) } else { scanner.place().map(Some) };
        let statement = match name {
            Instruction::E => Statement::End,
            Instruction::RT => Statement::Return,
            Instruction::PS => Statement::Pause,
            Instruction::RS => Statement::Resume,
            Instruction::S => Statement::Save,
            Instruction::FD => Statement::Defaults,
            Instruction::IP => Statement::Initialize,
            Instruction::CF => Statement::ClearLocked,
            Instruction::PR => return Ok(Statement::Print(text)),
            Instruction::MA => return self.movement(false),
            Instruction::MR => return self.movement(true),
            Instruction::SL => Statement::Slew(self.expression(Kind::Whole)?),
            Instruction::HM | Instruction::HI if nothing => return Err(Error::HomeType),
            Instruction::HM => Statement::Set(Reg::HM, self.expression(Kind::Whole)?),
            Instruction::HI => Statement::HomeToIndex(self.expression(Kind::Whole)?),
            Instruction::H if nothing => Statement::Hold(None),
            Instruction::H => Statement::Hold(Some(self.expression(Kind::Whole)?)),
            Instruction::BR => Statement::Branch(self.place()?, self.optional(Self::condition)?),
            Instruction::CL => Statement::Call(self.place()?, self.optional(Self::condition)?),
            Instruction::EX => {
                Statement::Execute(self.place()?, self.optional(|scanner| scanner.expression(Kind::Whole))?)
            }
            Instruction::BP => Statement::BreakPoint(
                self.place()?,
                self.optional(|scanner| scanner.expression(Kind::Whole))?,
            ),
            Instruction::OE => Statement::OnError(self.place()?),
            Instruction::PG => Statement::Program(place(&mut self)?),
            Instruction::L => Statement::ListProgram(place(&mut self)?),
            Instruction::CP => Statement::Clear(place(&mut self)?),
            Instruction::LB => Statement::Label(self.new_name(true)?),
            Instruction::VA => {
                let name = self.new_name(false)?;
                let value = if self.peek().is_none() { None } else { Some(self.value(Kind::Whole)?) };
                Statement::Declare(name, value)
            }
            Instruction::IV => Statement::Input(self.input()?),
            Instruction::IC => Statement::Increment(self.counted()?),
            Instruction::DC => Statement::Decrement(self.counted()?),
            Instruction::SC if nothing => Statement::Calibrate(None),
            Instruction::SC => Statement::Calibrate(Some(self.expression(Kind::Whole)?)),
        };
        self.end().map(|()| statement)
    }

    /// Parses the rest of a line that begins with MA or MR.
    fn movement(mut self, relative: bool) -> Result<Statement<'a>, Error> {
        let way = self.expression(Kind::Whole)?;
        let notify_on_end = self.optional(Self::switch)?.unwrap_or(false);
        let continuous = self.optional(Self::switch)?.unwrap_or(false);
        self.end()?;
        Ok(Statement::Move { relative, way, notify_on_end, continuous })
    }

    /// Parses 0, 1 or nothing.
    fn switch(&mut self) -> Result<bool, Error> {
        match self.peek() {
            None | Some(b',') => Ok(false),
            Some(_) => match self.number()? {
                0 => Ok(false),
                1 => Ok(true),
                _ => Err(Error::IllegalValue),
            },
        }
    }

    /// Parses the rest of the line as the value of a variable. Without a value it is an error (34).
    fn value(&mut self, kind: Kind) -> Result<Expression<'a>, Error> {
        if self.peek().is_none() {
            return Err(Error::IsVariable);
        }
        self.take(b'=');
        let value = self.expression(kind)?;
        self.end().map(|()| value)
    }

    /// Parses the value of DN: a character in quotation marks, or the decimal code of one (MC 5-20).
    fn device_name(&mut self) -> Result<i32, Error> {
        if self.peek().is_none() {
            return Err(Error::IsVariable);
        }
        self.take(b'=');
        match self.rest.trim_ascii() {
            [b'"', name, b'"'] => Ok(i32::from(*name)),
            [b'"', digits @ .., b'"'] => Self { rest: digits, ..*self }.number(),
            _ => Err(Error::IllegalData),
        }
    }

    /// Parses the values of a list. A name in the position of a trip's subroutine is a label.
    fn list(&mut self, list: List) -> Result<Vec<Parameter, 3>, Error> {
        if self.peek().is_none() {
            return Err(Error::IsVariable);
        }
        self.take(b'=');
        let mut values = Vec::new();
        for place in 0..list.len() {
            let value = match self.peek() {
                None | Some(b',') => Parameter::Absent,
                Some(_) if list.label() == Some(place) => match self.place()? {
                    Place::Address(address) => Parameter::Value(Operand::Number(address)),
                    Place::Label(name) => Parameter::Label(name),
                },
                Some(_) => Parameter::Value(self.operand(Kind::Whole)?),
            };
            // `values` has room for the longest list.
            let _ = values.push(value);
            if !self.take(b',') {
                self.end()?;
                let says_something = values.iter().any(|value| *value != Parameter::Absent);
                return if says_something { Ok(values) } else { Err(Error::IllegalData) };
            }
        }
        Err(Error::IllegalData)
    }
}
