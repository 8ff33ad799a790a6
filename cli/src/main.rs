//! `drivetwin`: emulated motion drives on ptys and TCP ports.

use std::process::ExitCode;

fn main() -> ExitCode {
    drivetwin_cli::main(&[])
}
