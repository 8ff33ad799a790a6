//! User programs of the RS 434544 and 434546 as text: assembler and disassembler.
//!
//! `docs/reference/rs434-programs.md` describes the language. Commands, their operands and their numbers of
//! lines come from the drive's own table, and names of registers from its register map.
//!
//! | module | what it holds |
//! |---|---|
//! | `cursor` | words, numbers and signs of a text line, with their positions |
//! | `assemble` | from text to lines of a program |
//! | `disassemble` | from lines of a program to text |
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
pub use self::disassemble::{Line, disassemble, lines};
pub use self::image::Image;

/// The system registers, in the order of uAdrSysReg.
const SYSTEM: [&str; 10] = ["ax", "bx", "cx", "dx", "ex", "fx", "gx", "hx", "ix", "jx"];

/// The address spaces, in the order of uTypeModbusReg.
const SPACES: [(&str, Space); 4] = [
    ("discrete", Space::Discrete),
    ("coil", Space::Coil),
    ("input", Space::Input),
    ("holding", Space::Holding),
];

/// Directive for a number of lines that contain 0.
const ZERO: &str = ".zero";
/// Directive for a line given as a number.
const WORD: &str = ".word";
/// Word that makes a jump relative to its own line.
const RELATIVE: &str = "rel";
/// The directions of a shift, in the order of bTypeJmp.
const WAYS: [&str; 2] = ["left", "right"];

/// Returns true if a kind of drive runs user programs: it then has the register through which they are
/// loaded.
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

/// Assembles bytes, which may turn out not to be text.
///
/// # Errors
/// The first error, with its position.
pub fn assemble_bytes(source: &[u8]) -> Result<Vec<u32>, Error> {
    let text = std::str::from_utf8(source).map_err(|error| {
        let before = String::from_utf8_lossy(&source[..error.valid_up_to()]);
        let (line, start) = (before.matches('\n').count() + 1, before.rfind('\n').map_or(0, |at| at + 1));
        Error { line, column: before[start..].chars().count() + 1, what: "this is not UTF-8 text".into() }
    })?;
    assemble(text)
}

/// A program as the bytes of a file: its lines, each with the low byte first.
#[must_use]
pub fn to_bytes(program: &[u32]) -> Vec<u8> {
    program.iter().flat_map(|line| line.to_le_bytes()).collect()
}

/// The program in the bytes of a file; see [`to_bytes`].
///
/// # Errors
/// A sentence that says why the bytes are not a program.
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
