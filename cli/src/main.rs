//! `drivetwin`: emulated motion drives on ptys and TCP ports.

mod args;
mod commands;
mod log;

use std::process::ExitCode;

use args::{Cli, Command};
use clap::Parser as _;
use commands::print;

/// Exit code: a replay differs from its recording.
const DIFFERENT: u8 = 1;
/// Exit code: wrong usage or configuration.
const BAD_USAGE: u8 = 2;

fn main() -> ExitCode {
    let code = drivetwin();
    log::finish();
    code
}

fn drivetwin() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) if error.use_stderr() => return fail(&args::sentence(error)),
        Err(help) => {
            return print(&help.render().to_string())
                .map_or_else(|error| fail(&error), |()| ExitCode::SUCCESS);
        }
    };
    log::start(&cli);
    match execute(cli.command) {
        Ok(code) => code,
        Err(sentence) => fail(&sentence),
    }
}

fn execute(command: Command) -> Result<ExitCode, String> {
    match command {
        Command::Run(run) => commands::run::run(*run)?,
        Command::Check { file } => commands::check::check(file)?,
        Command::List { json } => commands::list::list(json)?,
        Command::Describe { kinds, json, markdown } => commands::describe::describe(&kinds, json, markdown)?,
        Command::Replay { file } => {
            let same = commands::replay::replay(&file)?;
            return Ok(if same { ExitCode::SUCCESS } else { ExitCode::from(DIFFERENT) });
        }
        Command::Plot(plot) => commands::plot::plot(plot)?,
        Command::Asm(asm) => commands::asm::asm(&asm)?,
        Command::Disasm { file } => commands::disasm::disasm(&file)?,
        Command::Reference => commands::reference::reference()?,
    }
    Ok(ExitCode::SUCCESS)
}

fn fail(sentence: &str) -> ExitCode {
    log::write_line(format!("drivetwin: {sentence}\n").as_bytes());
    ExitCode::from(BAD_USAGE)
}
