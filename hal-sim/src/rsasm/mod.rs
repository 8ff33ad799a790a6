//! User programs of the RS 434544 and 434546 as text: assembler and disassembler.
//!
//! The language is described in `docs/reference/rs434-programs.md`. Commands, what they work with and how many lines they
//! take come from the drive's own table, names of registers from its map.
//!
//! | module | what it holds |
//! |---|---|
//! | `cursor` | words, numbers and signs of a line of text, and where they are |
//! | `assemble` | text to lines of a program |
//! | `disassemble` | the way back |
//! | `image` | a program in the memory of a drive |

mod assemble;
mod cursor;
mod disassemble;
mod image;
#[cfg(test)]
mod tests;

use std::fmt;

use drivetwin_firmware::device::Spec;
use drivetwin_firmware::rs434::LINES;
use drivetwin_protocol::registers::Space;

pub use self::assemble::assemble;
pub use self::disassemble::disassemble;
pub use self::image::Image;

/// The system registers, by uAdrSysReg.
const SYSTEM: [&str; 10] = ["ax", "bx", "cx", "dx", "ex", "fx", "gx", "hx", "ix", "jx"];

/// The address spaces, by uTypeModbusReg.
const SPACES: [(&str, Space); 4] = [
    ("discrete", Space::Discrete),
    ("coil", Space::Coil),
    ("input", Space::Input),
    ("holding", Space::Holding),
];

/// The name of a number of lines that hold 0.
const ZERO: &str = ".zero";
/// The name of a line by its number.
const WORD: &str = ".word";
/// Word that makes a jump count from its own line.
const RELATIVE: &str = "rel";
/// The ways of a shift, by bTypeJmp.
const WAYS: [&str; 2] = ["left", "right"];

/// Returns whether a kind of drive runs such programs: it has the register through which they come.
#[must_use]
pub fn runs_on(spec: &Spec) -> bool {
    spec.find("CMD_W").is_some()
}

/// First error in the text of a program, with its position.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Error {
    /// Line of the error, from 1.
    pub line: usize,
    /// Column of the error, in characters from 1.
    pub column: usize,
    /// The error in one sentence.
    pub what: String,
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}: {}", self.line, self.column, self.what)
    }
}

impl std::error::Error for Error {}

/// Assembles a text that may turn out not to be one.
///
/// # Errors
/// What is wrong first, and where.
pub fn assemble_bytes(source: &[u8]) -> Result<Vec<u32>, Error> {
    let text = std::str::from_utf8(source).map_err(|error| {
        let before = String::from_utf8_lossy(&source[..error.valid_up_to()]);
        let (line, start) = (before.matches('\n').count() + 1, before.rfind('\n').map_or(0, |at| at + 1));
        Error { line, column: before[start..].chars().count() + 1, what: "this is not UTF-8 text".into() }
    })?;
    assemble(text)
}

/// A program as it is kept in a file: its lines, each with its low byte first.
#[must_use]
pub fn to_bytes(program: &[u32]) -> Vec<u8> {
    program.iter().flat_map(|line| line.to_le_bytes()).collect()
}

/// The program in the bytes of a file.
///
/// # Errors
/// One sentence: the bytes are not a program.
pub fn from_bytes(bytes: &[u8]) -> Result<Vec<u32>, String> {
    let (lines, rest) = bytes.as_chunks();
    match bytes.len() {
        0 => Err(format!("it is empty; a program has 1 to {LINES} lines of 4 bytes")),
        n if n > 4 * LINES => {
            Err(format!("a program has at most {LINES} lines of 4 bytes, and this is more"))
        }
        n if !rest.is_empty() => Err(format!("a program has lines of 4 bytes, and {n} are no whole lines")),
        _ => Ok(lines.iter().copied().map(u32::from_le_bytes).collect()),
    }
}
