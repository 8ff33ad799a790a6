//! The commands, one file each.

pub(crate) mod asm;
pub(crate) mod check;
pub(crate) mod describe;
pub(crate) mod disasm;
pub(crate) mod list;
pub(crate) mod plot;
pub(crate) mod reference;
pub(crate) mod replay;
pub(crate) mod run;

use std::io::{self, Write as _};

use drivetwin_sim::catalog;
use drivetwin_sim::record::trace::{Trace, whole_lines};

/// Writes to stdout.
///
/// # Errors
/// One sentence that says what is wrong: stdout cannot be written.
pub(crate) fn print(text: &str) -> Result<(), String> {
    let mut stdout = io::stdout();
    // At its end a Rust program writes what is left; the Python package does not.
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        // A reader that closes stdout early, as in `drivetwin list | head -1`, is not an error.
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
            Err(format!("stdout cannot be written: {error}"))
        }
        _ => Ok(()),
    }
}

/// Reads a trace. Returns true if its last line was incomplete and is left out.
///
/// # Errors
/// One sentence that names the file: it is not a trace.
pub(crate) fn trace(name: &str, bytes: &[u8]) -> Result<(Trace, bool), String> {
    let (lines, is_cut) = whole_lines(bytes);
    let text = std::str::from_utf8(lines).map_err(|_| format!("{name} is not UTF-8 text"))?;
    let make = |kind: &str| catalog::make(kind).ok();
    let trace = Trace::parse(text, &make).map_err(|error| format!("{name}: {error}"))?;
    Ok((trace, is_cut))
}
