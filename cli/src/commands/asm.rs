//! `drivetwin asm`: assembles the text of a user program of an RS drive.

use crate::args::Asm;
use drivetwin_host::rs_programs;

use super::print;

/// Assembles a program into a file, or prints it in hexadecimal.
///
/// # Errors
/// One sentence that names the file, the position in it and the error.
pub(crate) fn asm(options: &Asm) -> Result<(), String> {
    print(&rs_programs::asm(&options.source, options.output.as_deref(), options.hex)?)
}
