//! From lines of a program to text that assembles to the same lines.
//!
//! A line that text cannot express exactly, for instance with bits in unused fields or an unknown system
//! register, becomes a number (RS434-34).

use std::fmt::Write as _;

use drivetwin_firmware::rs434::Reg;
use drivetwin_firmware::rs434::program::instruction::{
    Instruction, MNEMONICS, Opcode, OperandForm, Operation,
};
use drivetwin_protocol::registers::{Register as _, Space};

use super::{RELATIVE, SPACES, SYSTEM, WAYS, WORD, ZERO};

/// Minimum number of consecutive lines that contain 0 and are written as one line of text.
const MANY: usize = 4;

/// `program` as text, with the number of each line after it. PC_REG shows the same numbers.
#[must_use]
pub fn disassemble(program: &[u32]) -> String {
    let mut text = String::new();
    for Line { at, label, words } in lines(program) {
        if let Some(label) = label {
            line(&mut text, format_args!("{label}:"));
        }
        if !words.is_empty() {
            line(&mut text, format_args!("        {words:<48}; {at}"));
        }
    }
    text
}

/// A line of a listing.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Line {
    /// Number of the line of the program.
    pub at: usize,
    /// Label in front of it.
    pub label: Option<String>,
    /// The command in words; empty at a label behind the last line.
    pub words: String,
}

/// The lines of a program in words.
#[must_use]
pub fn lines(program: &[u32]) -> Vec<Line> {
    let listing = Listing::new(program);
    let label = |at: usize| listing.labelled[at].then(|| label(at));
    let (mut lines, mut at) = (Vec::new(), 0);
    while at < program.len() {
        let zeros = listing.zeros(at);
        let (words, count) = match listing.command(at) {
            _ if zeros >= MANY => (format!("{ZERO} {zeros}"), zeros),
            Some(found) => (listing.words(at, found), found.command.lines().into()),
            None => (format!("{WORD} 0x{:08X}", program[at]), 1),
        };
        lines.push(Line { at, label: label(at), words });
        at += count;
    }
    lines.extend(label(at).map(|label| Line { at, label: Some(label), words: String::new() }));
    lines
}

/// Appends a text line.
fn line(text: &mut String, content: std::fmt::Arguments<'_>) {
    // Writing to a string cannot fail.
    let _ = writeln!(text, "{content}");
}

fn label(at: usize) -> String {
    format!("line_{at}")
}

/// A command that text can express exactly.
#[derive(Clone, Copy)]
struct Found {
    instruction: Instruction,
    command: Opcode,
    /// Second line of the command; 0 if it has none.
    constant: u32,
}

struct Listing<'a> {
    program: &'a [u32],
    /// True for each line at which a command begins, and for the end of the program.
    begins: Vec<bool>,
    /// True for each line that is a target.
    labelled: Vec<bool>,
}

impl<'a> Listing<'a> {
    fn new(program: &'a [u32]) -> Self {
        let none = vec![false; program.len() + 1];
        let mut listing = Self { program, begins: none.clone(), labelled: none };
        let mut targets = Vec::new();
        let mut at = 0;
        while at < program.len() {
            listing.begins[at] = true;
            let found = listing.command(at);
            targets.extend(found.and_then(|found| target(at, found)));
            at += found.map_or(1, |found| usize::from(found.command.lines()));
        }
        listing.begins[at] = true;
        for to in targets {
            if listing.begins.get(to) == Some(&true) {
                listing.labelled[to] = true;
            }
        }
        listing
    }

    /// Number of lines from `at` on that contain 0, up to the next label.
    fn zeros(&self, at: usize) -> usize {
        let rest = self.program[at..].iter().zip(&self.labelled[at..]).enumerate();
        rest.take_while(|(n, (line, labelled))| **line == 0 && (*n == 0 || !**labelled)).count()
    }

    /// The command at a line, if text can express it exactly.
    fn command(&self, at: usize) -> Option<Found> {
        let instruction = Instruction(self.program[at]);
        let command = instruction.command()?;
        let constant = if command.lines() == 2 { *self.program.get(at + 1)? } else { 0 };
        let used = command.used();
        let (register, data) = (usize::from(instruction.register()), instruction.data());
        let exact = instruction.0 & !used == 0
            && (used & Instruction::REGISTER == 0 || register < SYSTEM.len())
            && (used & Instruction::SPACE == 0 || usize::from(instruction.space()) < SPACES.len())
            && (command.wide || constant >> 16 == 0)
            && match command.form {
                OperandForm::Target if instruction.type_jmp() => data.cast_signed().unsigned_abs() <= 1_024,
                OperandForm::Target | OperandForm::Subroutine => data <= 1_024,
                OperandForm::RegisterRegister => usize::from(data) < SYSTEM.len(),
                OperandForm::Modbus | OperandForm::ModbusConstant | OperandForm::ModbusShift => {
                    matches!(SPACES[usize::from(instruction.space())].1, Space::Coil | Space::Holding)
                }
                _ => true,
            };
        exact.then_some(Found { instruction, command, constant })
    }

    /// Text of a command.
    fn words(&self, at: usize, found: Found) -> String {
        let Found { instruction, command, constant } = found;
        let data = instruction.data();
        let system = |number: usize| SYSTEM[number];
        let register = || system(instruction.register().into());
        let modbus = || modbus(instruction);
        let way = || WAYS[usize::from(instruction.type_jmp())];
        let operands = match command.form {
            OperandForm::NoOperand => String::new(),
            OperandForm::Target if instruction.type_jmp() => {
                let distance = data.cast_signed();
                format!(
                    "{RELATIVE} {}",
                    self.target_label(at, found).unwrap_or_else(|| format!("{distance:+}"))
                )
            }
            OperandForm::Target | OperandForm::Subroutine => {
                self.target_label(at, found).unwrap_or_else(|| data.to_string())
            }
            OperandForm::Time => data.to_string(),
            OperandForm::Loop => {
                let [lines, times] = data.to_be_bytes();
                format!("{}, {times}", self.target_label(at, found).unwrap_or_else(|| lines.to_string()))
            }
            OperandForm::Register => register().into(),
            OperandForm::Modbus => modbus(),
            OperandForm::RegisterConstant => {
                let value = if command.wide { constant } else { data.into() };
                format!("{}, {}", register(), number(command, value))
            }
            OperandForm::RegisterModbus => format!("{}, {}", register(), modbus()),
            OperandForm::ModbusConstant => format!("{}, {}", modbus(), number(command, constant)),
            OperandForm::ModbusRegister => format!("{}, {}", modbus(), register()),
            OperandForm::RegisterRegister => {
                let other = system(data.into());
                // In the text, the register that changes always comes first.
                let (first, second) = if command.operation == Operation::Move {
                    (other, register())
                } else {
                    (register(), other)
                };
                format!("{first}, {second}")
            }
            OperandForm::RegisterShift => format!("{}, {}, {data}", register(), way()),
            OperandForm::ModbusShift => format!("{}, {}, {constant}", modbus(), way()),
        };
        let mnemonic = MNEMONICS[usize::from(instruction.code())];
        if operands.is_empty() { mnemonic.into() } else { format!("{mnemonic} {operands}") }
    }

    /// The label of a command's target; `None` if the target has no label and must be a number.
    fn target_label(&self, at: usize, found: Found) -> Option<String> {
        target(at, found).filter(|to| self.labelled.get(*to) == Some(&true)).map(label)
    }
}

/// Target of a jump or call, or the line after the loop that the command begins.
fn target(at: usize, Found { instruction, command, .. }: Found) -> Option<usize> {
    let data = instruction.data();
    match command.form {
        OperandForm::Target if instruction.type_jmp() => at.checked_add_signed(data.cast_signed().into()),
        OperandForm::Target | OperandForm::Subroutine => Some(data.into()),
        OperandForm::Loop => Some(at + 1 + usize::from(data >> 8)),
        _ => None,
    }
}

/// Text of a register: its name if it has one, otherwise its space and address.
fn modbus(instruction: Instruction) -> String {
    let (name, space) = SPACES[usize::from(instruction.space())];
    let table = Reg::TABLE;
    let found =
        table.at(space, instruction.data()).and_then(|(row, word)| Some((table.rows.get(row)?.name, word)));
    match found {
        Some((register, 0)) => register.into(),
        Some((register, _)) => format!("{register}High"),
        None => format!("{name} 0x{:04X}", instruction.data()),
    }
}

/// Text of a constant: hexadecimal for logic commands, signed for other commands with 32 bits.
fn number(command: Opcode, value: u32) -> String {
    match command.operation {
        Operation::And | Operation::Or | Operation::Xor if command.wide => format!("0x{value:08X}"),
        Operation::And | Operation::Or | Operation::Xor => format!("0x{value:04X}"),
        _ if command.wide => value.cast_signed().to_string(),
        _ => value.to_string(),
    }
}
