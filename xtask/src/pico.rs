//! The Raspberry Pi Pico, emulated for people: `cargo xtask pico <kind>`.

use std::path::PathBuf;
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail, ensure};
use xshell::{Shell, cmd};

use crate::checks::target_dir;
use crate::tools::{self, Tool};

const PACKAGE: &str = "standin-rp2040";
const TARGET: &str = "thumbv6m-none-eabi";
/// The binaries of [`PACKAGE`], one per kind of drive.
const BINARIES: &str = "firmware/boards/rp2040/src/bin";

/// Builds the image of a kind of drive and runs it at the pace of real time, its UART0 on a TCP port, until the
/// process is stopped.
///
/// # Errors
///
/// If there is no image of that kind, if it does not build, or if something to build or emulate it with is missing.
pub(crate) fn run(sh: &Shell, kind: &str) -> Result<()> {
    let kinds = kinds(sh)?;
    if !kinds.iter().any(|known| known == kind) {
        bail!("there is no drive `{kind}` for the Pico; there are: {}", kinds.join(", "));
    }
    let needed = [Tool::ThumbTargets, Tool::Node];
    if let Some(remedy) = tools::bring_only(sh, &needed).of(&needed) {
        bail!("{remedy}");
    }
    cmd!(sh, "cargo build --profile firmware --package {PACKAGE} --bin {kind} --target {TARGET}").run()?;
    let image = image(sh, kind);
    println!("connect a Modbus RTU master over TCP to the address below; Ctrl-C ends the board");
    serve(cmd!(sh, "node tests/pico/serve.mjs {image}").into())
}

/// Runs the board until it ends. It ends when its stdin does: when this process is gone, however it went.
fn serve(mut board: Command) -> Result<()> {
    let mut board = board.stdin(Stdio::piped()).spawn().context("cannot start node")?;
    let held = board.stdin.take();
    let status = board.wait()?;
    drop(held);
    ensure!(status.success(), "the emulated Pico ended with {status}");
    Ok(())
}

/// Lets the emulator's own tests say whether it is true to the chip.
///
/// # Errors
///
/// If one of them fails.
pub(crate) fn check_emulator(sh: &Shell) -> Result<()> {
    Ok(cmd!(sh, "npm test --prefix tests/pico --silent").run()?)
}

/// Where the image of a kind lies once it is built.
fn image(sh: &Shell, kind: &str) -> PathBuf {
    target_dir(sh).join(TARGET).join("firmware").join(kind)
}

/// The kinds of drive there is an image of, in order of their names.
fn kinds(sh: &Shell) -> Result<Vec<String>> {
    let mut kinds: Vec<String> = sh
        .read_dir(BINARIES)?
        .iter()
        .filter(|path| path.extension().is_some_and(|extension| extension == "rs"))
        .filter_map(|path| Some(path.file_stem()?.to_str()?.to_owned()))
        .collect();
    kinds.sort();
    Ok(kinds)
}
