//! `drivetwin asm`: a user program of an RS drive from text.

use crate::args::Asm;
use drivetwin_host::rs_programs;

use super::print;

/// Assembles a program into a file, or shows it in hexadecimal.
///
/// # Errors
/// One sentence: what is wrong, and where.
pub(crate) fn asm(options: &Asm) -> Result<(), String> {
    print(&rs_programs::asm(&options.source, options.output.as_deref(), options.hex)?)
}
