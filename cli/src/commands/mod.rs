//! The commands, one file each.

pub(crate) mod asm;
pub(crate) mod check;
pub(crate) mod describe;
pub(crate) mod disasm;
pub(crate) mod list;
pub(crate) mod reference;
pub(crate) mod replay;
pub(crate) mod run;

use std::io::{self, Write as _};

/// Writes to stdout.
///
/// # Errors
/// One sentence: stdout cannot be written.
pub(crate) fn print(text: &str) -> Result<(), String> {
    match io::stdout().write_all(text.as_bytes()) {
        // A reader that closes stdout early, as in `drivetwin list | head -1`, is not an error.
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
            Err(format!("stdout cannot be written: {error}"))
        }
        _ => Ok(()),
    }
}
