//! `drivetwin` with a sixth product: `own-drive run own-vfd`, and everything else that `drivetwin` does.

use std::process::ExitCode;

use own_drive::Vfd;

fn main() -> ExitCode {
    drivetwin_cli::main(&[|| Box::new(Vfd::new())])
}
