//! The commands, one file each.

pub(crate) mod asm;
pub(crate) mod check;
pub(crate) mod describe;
pub(crate) mod disasm;
pub(crate) mod flash;
pub(crate) mod list;
pub(crate) mod plot;
pub(crate) mod reference;
pub(crate) mod replay;
pub(crate) mod run;
pub(crate) mod view;

use std::fs::File;
use std::io::{self, Read as _, Write as _};

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

/// Reads a trace from a file, or from standard input if the name is `-`. Returns its name for sentences, the trace, and
/// true if its last line was incomplete and is left out.
///
/// # Errors
/// One sentence that names the file: it cannot be read, or is not a trace.
pub(crate) fn read_trace(file: &str) -> Result<(&str, Trace, bool), String> {
    let mut bytes = Vec::new();
    let name = if file == "-" { "standard input" } else { file };
    let read = match file {
        "-" => io::stdin().lock().read_to_end(&mut bytes),
        file => File::open(file).and_then(|mut file| file.read_to_end(&mut bytes)),
    };
    read.map_err(|error| format!("{name}: {error}"))?;
    let (lines, is_cut) = whole_lines(&bytes);
    let text = std::str::from_utf8(lines).map_err(|_| format!("{name} is not UTF-8 text"))?;
    let make = |kind: &str| catalog::make(kind).ok();
    let trace = Trace::parse(text, &make).map_err(|error| format!("{name}: {error}"))?;
    Ok((name, trace, is_cut))
}
