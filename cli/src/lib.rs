//! The command `drivetwin`: emulated motion drives on ptys and TCP ports.
//!
//! A library, because the command is two programs: that of this crate, and that of the Python package.

mod args;
mod commands;
mod log;
mod png;

use std::ffi::OsString;
use std::process::ExitCode;

use args::{Cli, Command};
use clap::Parser as _;
use commands::print;
use drivetwin_host::options::{AttachOptions, RunOptions};
use drivetwin_sim::catalog::{self, Kind};

/// Exit code: the command is done.
const SUCCESS: u8 = 0;
/// Exit code: a replay differs from its recording.
const DIFFERENT: u8 = 1;
/// Exit code: wrong usage or configuration.
const BAD_USAGE: u8 = 2;

/// The `main` of a program that is `drivetwin` with further kinds of drive. `examples/own-drive` is such a program:
///
/// ```ignore
/// fn main() -> std::process::ExitCode {
///     drivetwin_cli::main(&[|| Box::new(Vfd::new())])
/// }
/// ```
pub fn main(kinds: &'static [Kind]) -> ExitCode {
    match catalog::add(kinds) {
        Ok(()) => run(std::env::args_os()),
        Err(sentence) => fail(&sentence),
    }
    .into()
}

/// Runs the command with these arguments, the first of which is its own name, and returns its exit code. It catches
/// signals and prints as a program does, so a process calls it once.
#[must_use]
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    let code = drivetwin(arguments);
    log::finish();
    code
}

/// Reads the arguments of `drivetwin run`, without the name of the command: a kind or a bench file, and options.
///
/// # Errors
/// One sentence.
pub fn run_options(arguments: impl IntoIterator<Item = OsString>) -> Result<RunOptions, String> {
    let all = ["drivetwin", "run"].map(OsString::from).into_iter().chain(arguments);
    match Cli::try_parse_from(all).map_err(args::sentence)?.command {
        Command::Run(run) => Ok((*run).into()),
        _ => Err("these are not the arguments of a run".to_owned()),
    }
}

/// Reads the arguments of `drivetwin attach`, without the name of the command.
///
/// # Errors
/// One sentence.
pub fn attach_options(arguments: impl IntoIterator<Item = OsString>) -> Result<AttachOptions, String> {
    let all = ["drivetwin", "attach"].map(OsString::from).into_iter().chain(arguments);
    match Cli::try_parse_from(all).map_err(args::sentence)?.command {
        Command::Attach(attach) => Ok((*attach).into()),
        _ => Err("these are not the arguments of an attached board".to_owned()),
    }
}

fn drivetwin(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    let cli = match Cli::try_parse_from(arguments) {
        Ok(cli) => cli,
        Err(error) if error.use_stderr() => return fail(&args::sentence(error)),
        Err(help) => {
            return print(&help.render().to_string()).map_or_else(|error| fail(&error), |()| SUCCESS);
        }
    };
    log::start(&cli);
    match execute(cli.command) {
        Ok(code) => code,
        Err(sentence) => fail(&sentence),
    }
}

fn execute(command: Command) -> Result<u8, String> {
    match command {
        Command::Run(run) => commands::run::run(*run)?,
        Command::Attach(attach) => commands::run::attach(*attach)?,
        Command::View { url } => commands::view::view(url)?,
        Command::Check { file } => commands::check::check(file)?,
        Command::List { json } => commands::list::list(json)?,
        Command::Describe { kinds, json, markdown } => commands::describe::describe(&kinds, json, markdown)?,
        Command::Replay { file } => {
            let same = commands::replay::replay(&file)?;
            return Ok(if same { SUCCESS } else { DIFFERENT });
        }
        Command::Plot(plot) => commands::plot::plot(plot)?,
        Command::Asm(asm) => commands::asm::asm(&asm)?,
        Command::Disasm { file } => commands::disasm::disasm(&file)?,
        Command::Flash(flash) => commands::flash::flash(&flash)?,
        Command::Reference => commands::reference::reference()?,
    }
    Ok(SUCCESS)
}

fn fail(sentence: &str) -> u8 {
    log::write_line(format!("drivetwin: {sentence}\n").as_bytes());
    BAD_USAGE
}
