//! `drivetwin check`: checks a bench file.

use drivetwin_host::Configuration;
use drivetwin_host::options::RunOptions;

use crate::commands::print;
use crate::log;

/// Prints a summary of a bench file to stdout, and warnings to stderr.
///
/// # Errors
/// One sentence that names the place in the file, and the error.
pub(crate) fn check(file: String) -> Result<(), String> {
    if !(file.ends_with(".toml") || file == "-") {
        return Err(format!(
            "'{file}' is not a bench file: the name of a bench file ends in .toml; - is standard input"
        ));
    }
    let (summary, warnings) =
        Configuration::read(RunOptions { what: file, ..RunOptions::default() })?.check()?;
    for warning in warnings {
        log::write_line(format!("warning: {warning}\n").as_bytes());
    }
    // The summary comes last, also where stdout and stderr are the same terminal.
    log::finish();
    print(&format!("{summary}\n"))
}
