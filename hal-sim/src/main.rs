//! `drivetwin`: emulated motion drives on ptys and TCP ports.

mod api;
mod cli;
mod describe;
#[cfg(test)]
mod echo;
mod followed;
mod log;
mod nv;
mod output;
mod ports;
mod programs;
mod ready;
mod realtime;
mod run;

use std::io::{self, Write as _};
use std::path::Path;
use std::process::ExitCode;

use clap::Parser as _;
use drivetwin_sim::trace::{Trace, whole_lines};
use drivetwin_sim::{kinds, nearest, replay};

use crate::cli::{Cli, Command};

/// A comparison failed.
const DIFFERENT: u8 = 1;
/// Bad usage or configuration.
const BAD_USAGE: u8 = 2;

fn main() -> ExitCode {
    let code = drivetwin();
    log::finish();
    code
}

fn drivetwin() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) if error.use_stderr() => return fail(&cli::sentence(&error)),
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
        Command::Run(options) => run::run(&options)?,
        Command::List { json } => print(&list(json))?,
        Command::Describe { kind, json, markdown } => {
            let device = kinds::make(&kind)?;
            let spec = device.spec();
            print(&match (json, markdown) {
                (true, _) => describe::json(spec) + "\n",
                (_, true) => describe::markdown(spec),
                _ => describe::text(spec),
            })?;
        }
        Command::Replay { file } => return replay(&file),
        Command::Asm(options) => print(&programs::asm(&options)?)?,
        Command::Disasm { file } => print(&programs::disasm(&file)?)?,
    }
    Ok(ExitCode::SUCCESS)
}

/// The kinds of drive.
fn list(json: bool) -> String {
    if json {
        let kinds: Vec<_> = kinds::specs()
            .map(
                |spec| serde_json::json!({"kind": spec.kind, "product": spec.product, "manual": spec.manual}),
            )
            .collect();
        return format!("{}\n", serde_json::Value::from(kinds));
    }
    let width = kinds::specs().map(|spec| spec.kind.len()).max().unwrap_or(0);
    kinds::specs()
        .map(|spec| format!("{:<width$}  {}, after {}\n", spec.kind, spec.product, spec.manual))
        .collect()
}

fn replay(file: &Path) -> Result<ExitCode, String> {
    let place = file.display();
    let bytes = std::fs::read(file).map_err(|error| format!("{place}: {error}"))?;
    let (lines, is_cut) = whole_lines(&bytes);
    let text = std::str::from_utf8(lines).map_err(|_| format!("{place} is no text"))?;
    let make = |kind: &str| kinds::make(kind).ok();
    let trace = Trace::parse(text, &make).map_err(|error| format!("{place}: {error}"))?;
    if is_cut {
        print(&format!("{place}: its last line has no end, so it is left out\n"))?;
    }
    match replay::run(&trace, &make).map_err(|error| format!("{place}: {error}"))? {
        None => {
            print(&format!("{place}: as expected\n"))?;
            Ok(ExitCode::SUCCESS)
        }
        Some(difference) => {
            print(&format!("{place}: {difference}\n"))?;
            Ok(ExitCode::from(DIFFERENT))
        }
    }
}

fn print(text: &str) -> Result<(), String> {
    match io::stdout().write_all(text.as_bytes()) {
        // Who has read enough, as in `drivetwin list | head -1`, is content.
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
            Err(format!("stdout cannot be written: {error}"))
        }
        _ => Ok(()),
    }
}

fn fail(sentence: &str) -> ExitCode {
    log::say(format!("drivetwin: {sentence}\n").as_bytes());
    ExitCode::from(BAD_USAGE)
}
