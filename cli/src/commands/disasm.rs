//! `drivetwin disasm`: converts a user program of an RS drive to text.

use std::path::Path;

use drivetwin_host::rs_programs;

use super::print;

/// Prints an assembled program as text.
///
/// # Errors
/// One sentence that names the file and the error.
pub(crate) fn disasm(file: &Path) -> Result<(), String> {
    print(&rs_programs::disasm(file)?)
}
