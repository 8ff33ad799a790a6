//! `drivetwin disasm`: a user program of an RS drive as text.

use std::path::Path;

use drivetwin_host::rs_programs;

use super::print;

/// Shows an assembled program as text.
///
/// # Errors
/// One sentence: what is wrong, and where.
pub(crate) fn disasm(file: &Path) -> Result<(), String> {
    print(&rs_programs::disasm(file)?)
}
