//! The Raspberry Pi Pico, emulated for interactive use: `cargo xtask pico <kind>`.

use std::process::{Command, Stdio};

use anyhow::{Context, Result, ensure};
use xshell::{Shell, cmd};

use crate::board::{RP2040, hint};
use crate::tools::Tool;

/// Builds the image of a kind of drive and runs it in real time, with its UART0 on a TCP port, until the
/// process is stopped. With the option `--usb`, a computer is at its USB cable, whose ports are on TCP, too.
///
/// # Errors
///
/// There is no image of that kind, it does not build, or a tool to build or emulate it is missing; another option.
pub(crate) fn run(sh: &Shell, kind: &str, options: &[&str]) -> Result<()> {
    ensure!(matches!(options, [] | ["--usb"]), "the only option of `pico` is `--usb`");
    let image = RP2040.image_for(sh, kind, &[Tool::ThumbTargets, Tool::Node])?;
    println!("Ctrl-C ends the board; {}", hint(kind, "<the address below>"));
    serve(cmd!(sh, "node tests/pico/serve.mjs {image} {options...}").into())
}

/// Runs the board until it ends. The board ends when its stdin is closed, and therefore also when this
/// process ends in any way.
fn serve(mut board: Command) -> Result<()> {
    let mut board = board.stdin(Stdio::piped()).spawn().context("cannot start node")?;
    let held = board.stdin.take();
    let status = board.wait()?;
    drop(held);
    ensure!(status.success(), "the emulated Pico ended with {status}");
    Ok(())
}

/// Runs the tests of the emulator itself, which compare it with the chip.
///
/// # Errors
///
/// A test fails.
pub(crate) fn check_emulator(sh: &Shell) -> Result<()> {
    Ok(cmd!(sh, "npm test --prefix tests/pico --silent").run()?)
}
