//! From text to lines of a program.
//!
//! There are two passes. The first one finds the program line of each command, and with it the meaning of
//! each label. The second one reads the operands of the commands.

use std::collections::BTreeMap;
use std::iter;
use std::ops::RangeInclusive;

use drivetwin_firmware::rs434::program::instruction::{
    self, COMMANDS, Instruction, MNEMONICS, Opcode, OperandForm, Operation,
};
use drivetwin_firmware::rs434::{LINES, Reg};
use drivetwin_protocol::registers::{Register as _, Space};

use super::cursor::{Cursor, Position, Token};
use super::{Error, RELATIVE, SPACES, SYSTEM, WAYS, WORD, ZERO};
use crate::suggest;

/// Targets of a jump (6.9). A program has no line 1024, but the manual includes it.
const TARGETS: RangeInclusive<i64> = 0..=1_024;
/// Distances of a relative jump (6.9).
const DISTANCES: RangeInclusive<i64> = -1_024..=1_024;
const BYTES: RangeInclusive<i64> = 0..=0xFF;
const WORDS: RangeInclusive<i64> = 0..=0xFFFF;
/// Constants of 16 bits, signed or unsigned.
const CONSTANTS: RangeInclusive<i64> = -0x8000..=0xFFFF;
/// Constants of 32 bits, signed or unsigned.
const PAIRS: RangeInclusive<i64> = -0x8000_0000..=0xFFFF_FFFF;

/// Assembles `source` and returns the lines of the program.
///
/// # Errors
/// The first error, with its position.
pub fn assemble(source: &str) -> Result<Vec<u32>, Error> {
    let mut names = Names::default();
    let mut parts = Vec::new();
    let mut length = 0;
    let source = source.strip_prefix('\u{FEFF}').unwrap_or(source);
    for (index, text) in source.lines().enumerate() {
        let mut cursor = Cursor::new(index + 1, text);
        let Some((position, content)) = names.part(&mut cursor, length)? else { continue };
        parts.push(Part { at: length, content, operands: cursor });
        length += content.lines();
        if length > LINES {
            return Err(position.error(format!("the program is longer than {LINES} lines from here on")));
        }
    }
    if parts.is_empty() {
        return Err(Error { line: 1, column: 1, what: "there is no command in this program".into() });
    }
    let mut program = Vec::with_capacity(length);
    for Part { at, content, operands } in parts {
        let mut reader = Reader { names: &names, cursor: operands, at };
        reader.put(content, &mut program)?;
        reader.cursor.end()?;
    }
    Ok(program)
}

/// A command or a directive.
struct Part<'a> {
    /// Number of the program line at which the part begins.
    at: usize,
    content: Content,
    /// Cursor at the operands of the part in the text.
    operands: Cursor<'a>,
}

#[derive(Clone, Copy)]
enum Content {
    /// A command, with its code.
    Opcode(u8, Opcode),
    /// A line given as a number.
    Word,
    /// A number of lines that contain 0.
    Zero(usize),
}

impl Content {
    /// Number of lines in the program.
    fn lines(self) -> usize {
        match self {
            Self::Opcode(_, command) => command.lines().into(),
            Self::Word => 1,
            Self::Zero(lines) => lines,
        }
    }
}

/// Meaning of a name in the text.
#[derive(Clone, Copy)]
enum Meaning {
    Constant(i64),
    /// A label, with its line in the program.
    Label(usize),
}

#[derive(Default)]
struct Names<'a>(BTreeMap<&'a str, Meaning>);

impl<'a> Names<'a> {
    /// Reads a text line up to the operands of its command; `None` if it has no command. `at` is the next
    /// line of the program.
    fn part(&mut self, cursor: &mut Cursor<'a>, at: usize) -> Result<Option<(Position, Content)>, Error> {
        loop {
            let (position, word) = match cursor.next()? {
                (_, Token::End) => return Ok(None),
                (position, Token::Word(word)) => (position, word),
                (position, _) => {
                    return Err(position.error("expected a command, a label or the name of a constant"));
                }
            };
            if cursor.skips(':')? {
                self.define(position, word, Meaning::Label(at))?;
            } else if cursor.skips('=')? {
                let value = self.number(cursor, PAIRS)?;
                cursor.end()?;
                self.define(position, word, Meaning::Constant(value))?;
                return Ok(None);
            } else {
                return Ok(Some((position, self.content(position, word, cursor)?)));
            }
        }
    }

    fn content(&self, position: Position, word: &str, cursor: &mut Cursor<'a>) -> Result<Content, Error> {
        match (word, instruction::code(word)) {
            (WORD, _) => Ok(Content::Word),
            (ZERO, _) => Ok(Content::Zero(self.number(cursor, 1..=LINES as i64)? as usize)),
            (_, Some(code)) => Ok(Content::Opcode(code, COMMANDS[usize::from(code)])),
            (_, None) => {
                let known = MNEMONICS.into_iter().chain([WORD, ZERO]);
                Err(position.error(suggest::unknown("command", word, known)))
            }
        }
    }

    fn define(&mut self, position: Position, name: &'a str, meaning: Meaning) -> Result<(), Error> {
        if !name.starts_with(|first: char| first.is_alphabetic() || first == '_') || name.contains('.') {
            return Err(position
                .error(format!("'{name}' cannot be a name: take a letter, then letters, digits and _")));
        }
        if let Some(what) = reserved(name) {
            return Err(position.error(format!("'{name}' is {what} and cannot be another name")));
        }
        match self.0.insert(name, meaning) {
            None => Ok(()),
            Some(_) => Err(position.error(format!("'{name}' is already defined; choose another name"))),
        }
    }

    /// Reads a number, or the name of a constant that the text has defined before.
    fn number(&self, cursor: &mut Cursor<'a>, takes: RangeInclusive<i64>) -> Result<i64, Error> {
        let (position, token) = cursor.next()?;
        let value = match token {
            Token::Number(value) => value,
            Token::Word(name) => match self.0.get(name) {
                Some(Meaning::Constant(value)) => *value,
                Some(Meaning::Label(_)) => {
                    return Err(
                        position.error(format!("'{name}' is a label; expected a number or a constant"))
                    );
                }
                None => return Err(position.error(self.unknown("constant", name))),
            },
            Token::Sign(_) | Token::End => {
                return Err(position.error("a number or the name of a constant is missing"));
            }
        };
        within(position, value, takes)
    }

    /// Message that there is no constant or label with that name.
    fn unknown(&self, what: &str, name: &str) -> String {
        let same = |meaning: &Meaning| matches!(meaning, Meaning::Label(_)) == (what == "label");
        suggest::unknown(
            what,
            name,
            self.0.iter().filter(|(_, meaning)| same(meaning)).map(|(name, _)| *name),
        )
    }
}

/// Meaning of a name that the language reserves.
fn reserved(name: &str) -> Option<&'static str> {
    if instruction::code(name).is_some() {
        Some("a command")
    } else if SYSTEM.contains(&name) {
        Some("a system register")
    } else if Reg::TABLE.find(name).is_some() {
        Some("a register of the drive")
    } else if name == RELATIVE || WAYS.contains(&name) || SPACES.iter().any(|(space, _)| *space == name) {
        Some("a word of the language")
    } else {
        None
    }
}

fn within(position: Position, value: i64, takes: RangeInclusive<i64>) -> Result<i64, Error> {
    if takes.contains(&value) {
        return Ok(value);
    }
    Err(position.error(format!("expected a number from {} to {}, not {value}", takes.start(), takes.end())))
}

/// Reader of the operands of a command.
struct Reader<'a, 'n> {
    names: &'n Names<'a>,
    cursor: Cursor<'a>,
    /// First line of the command in the program.
    at: usize,
}

impl Reader<'_, '_> {
    fn put(&mut self, content: Content, program: &mut Vec<u32>) -> Result<(), Error> {
        match content {
            Content::Opcode(code, command) => {
                let (fields, constant) = self.operands(command)?;
                program.push(u32::from(code) | fields);
                program.extend(constant);
            }
            Content::Word => program.push(self.number(PAIRS)? as u32),
            Content::Zero(lines) => program.extend(iter::repeat_n(0, lines)),
        }
        Ok(())
    }

    /// Reads the operands of a command. Returns the fields of its first line except uCmd, and its second line
    /// if it has one.
    fn operands(&mut self, command: Opcode) -> Result<(u32, Option<u32>), Error> {
        let mut constant = None;
        let fields = match command.form {
            OperandForm::NoOperand => 0,
            OperandForm::Target => self.target()?,
            OperandForm::Time => data(self.number(WORDS)?),
            OperandForm::Subroutine => data(self.line()?),
            OperandForm::Loop => {
                let lines = self.body()?;
                self.cursor.comma()?;
                data(lines << 8 | self.number(BYTES)?)
            }
            OperandForm::Register => self.system()? << 8,
            OperandForm::Modbus => self.written()?,
            OperandForm::RegisterConstant => {
                let register = self.system()? << 8;
                self.cursor.comma()?;
                if command.wide {
                    constant = Some(self.number(PAIRS)? as u32);
                    register
                } else {
                    register | data(self.number(CONSTANTS)?)
                }
            }
            OperandForm::RegisterModbus => {
                let register = self.system()? << 8;
                self.cursor.comma()?;
                register | self.modbus()?
            }
            OperandForm::ModbusConstant => {
                let modbus = self.written()?;
                self.cursor.comma()?;
                constant = Some(self.constant(command.wide)?);
                modbus
            }
            OperandForm::ModbusRegister => {
                let modbus = self.modbus()?;
                self.cursor.comma()?;
                modbus | self.system()? << 8
            }
            OperandForm::RegisterRegister => {
                let first = self.system()?;
                self.cursor.comma()?;
                let second = self.system()?;
                // In the text, the register that changes always comes first.
                let (register, data) =
                    if command.operation == Operation::Move { (second, first) } else { (first, second) };
                register << 8 | data << 16
            }
            OperandForm::RegisterShift => {
                let register = self.system()? << 8;
                let way = self.way()?;
                register | way | data(self.number(WORDS)?)
            }
            OperandForm::ModbusShift => {
                let modbus = self.written()?;
                let way = self.way()?;
                constant = Some(self.number(if command.wide { 0..=0xFFFF_FFFF } else { WORDS })? as u32);
                modbus | way
            }
        };
        Ok((fields, constant))
    }

    fn number(&mut self, takes: RangeInclusive<i64>) -> Result<i64, Error> {
        self.names.number(&mut self.cursor, takes)
    }

    /// Reads a constant that fills a line of the program.
    fn constant(&mut self, wide: bool) -> Result<u32, Error> {
        if wide { Ok(self.number(PAIRS)? as u32) } else { Ok(u32::from(self.number(CONSTANTS)? as u16)) }
    }

    /// Reads a system register, and returns uAdrSysReg.
    fn system(&mut self) -> Result<u32, Error> {
        let (position, token) = self.cursor.next()?;
        let Token::Word(name) = token else {
            return Err(position.error(format!("a system register is missing: one of {}", SYSTEM.join(", "))));
        };
        match SYSTEM.iter().position(|known| *known == name) {
            Some(number) => Ok(number as u32),
            None => Err(position.error(suggest::unknown("system register", name, SYSTEM.into_iter()))),
        }
    }

    /// Reads a register by its name, or by its space and address. Returns uTypeModbusReg and uData.
    fn modbus(&mut self) -> Result<u32, Error> {
        let (position, token) = self.cursor.next()?;
        let Token::Word(name) = token else {
            return Err(position.error(
                "a register is missing: its name, or discrete, coil, input or holding and its address",
            ));
        };
        if let Some(space) = SPACES.iter().position(|(known, _)| *known == name) {
            return Ok((space as u32) << 12 | data(self.number(WORDS)?));
        }
        let table = Reg::TABLE;
        let unknown =
            || position.error(suggest::unknown("register", name, table.rows.iter().map(|row| row.name)));
        let named = table.find(name).ok_or_else(unknown)?;
        let row = table.rows.get(named.row).ok_or_else(unknown)?;
        let space = SPACES.iter().position(|(_, space)| *space == row.space).ok_or_else(unknown)?;
        Ok((space as u32) << 12 | u32::from(row.address + named.word.unwrap_or(0)) << 16)
    }

    /// Like `modbus`, but only for a coil or a holding register: commands that write a constant take no
    /// others.
    fn written(&mut self) -> Result<u32, Error> {
        let mut ahead = self.cursor;
        let (position, _) = ahead.next()?;
        let fields = self.modbus()?;
        match SPACES.get((fields >> 12 & 0xF) as usize) {
            Some((_, Space::Coil | Space::Holding)) => Ok(fields),
            _ => Err(position.error("this is an input, which cannot be written")),
        }
    }

    /// Reads the target of a jump, and returns bTypeJmp and uData.
    fn target(&mut self) -> Result<u32, Error> {
        if !self.cursor.skips_word(RELATIVE)? {
            return Ok(data(self.line()?));
        }
        let distance = match self.label()? {
            Some(line) => line as i64 - self.at as i64,
            None => self.number(DISTANCES)?,
        };
        Ok(Instruction::TYPE_JMP | data(distance))
    }

    /// Reads a line of the program: a label or a number.
    fn line(&mut self) -> Result<i64, Error> {
        match self.label()? {
            Some(line) => Ok(line as i64),
            None => self.number(TARGETS),
        }
    }

    /// Reads the number of lines of a loop: a number, or the label after the loop.
    fn body(&mut self) -> Result<i64, Error> {
        let mut ahead = self.cursor;
        let (position, _) = ahead.next()?;
        let Some(line) = self.label()? else { return self.number(BYTES) };
        let lines = line as i64 - self.at as i64 - 1;
        if BYTES.contains(&lines) {
            return Ok(lines);
        }
        Err(position.error(format!("the last line of a loop is 0 to 255 lines after its first, not {lines}")))
    }

    /// Reads a label if one comes next, and returns its line.
    fn label(&mut self) -> Result<Option<usize>, Error> {
        let mut ahead = self.cursor;
        let (position, Token::Word(name)) = ahead.next()? else { return Ok(None) };
        match self.names.0.get(name) {
            Some(Meaning::Constant(_)) => Ok(None),
            Some(Meaning::Label(line)) => {
                self.cursor = ahead;
                Ok(Some(*line))
            }
            None => Err(position.error(self.names.unknown("label", name))),
        }
    }

    /// Reads the direction of a shift with the commas around it, and returns bTypeJmp.
    fn way(&mut self) -> Result<u32, Error> {
        self.cursor.comma()?;
        let (position, token) = self.cursor.next()?;
        let way = WAYS.iter().position(|way| token == Token::Word(way));
        let way = way.ok_or_else(|| position.error("expected left or right"))?;
        self.cursor.comma()?;
        Ok(if way == 1 { Instruction::TYPE_JMP } else { 0 })
    }
}

/// uData for a number, in two's complement.
fn data(value: i64) -> u32 {
    u32::from(value as u16) << 16
}
