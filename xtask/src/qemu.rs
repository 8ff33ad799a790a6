//! The LM3S6965 board under QEMU, for people: `cargo xtask qemu <kind>`.

use std::net::TcpListener;
use std::os::fd::OwnedFd;
use std::path::PathBuf;
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail, ensure};
use xshell::{Shell, cmd};

use crate::checks::target_dir;
use crate::tools::{self, Tool};

const PACKAGE: &str = "standin-lm3s6965";
const TARGET: &str = "thumbv7m-none-eabi";
/// The binaries of [`PACKAGE`], one per kind of drive.
const BINARIES: &str = "firmware/boards/lm3s6965/src/bin";

/// Builds the image of a kind of drive and runs it, its UART0 on a free TCP port of this machine, until the
/// process is stopped.
///
/// # Errors
///
/// If there is no image of that kind, if it does not build, or if something to build or emulate it with is missing.
pub(crate) fn run(sh: &Shell, kind: &str) -> Result<()> {
    let kinds = kinds(sh)?;
    if !kinds.iter().any(|known| known == kind) {
        bail!("there is no drive `{kind}` for the LM3S6965; there are: {}", kinds.join(", "));
    }
    let needed = [Tool::ThumbTargets, Tool::Qemu];
    if let Some(remedy) = tools::bring_only(sh, &needed).of(&needed) {
        bail!("{remedy}");
    }
    cmd!(sh, "cargo build --profile firmware --package {PACKAGE} --bin {kind} --target {TARGET}").run()?;

    let bus = TcpListener::bind(("127.0.0.1", 0)).context("cannot listen on 127.0.0.1")?;
    let address = bus.local_addr()?;
    println!(
        "{kind} is at {address}, RTU over TCP; Ctrl-C ends the board. All registers of an md3, with mbpoll:"
    );
    println!(
        "  socat pty,raw,echo=0,link={kind}.tty tcp:{address} & \
         sleep 1; mbpoll -m rtu -a 1 -b 9600 -P none -t 4:hex -r 1 -c 32 -1 {kind}.tty"
    );
    // QEMU dies with this process. It is handed the port as its standard input, so that nobody else can
    // have taken it meanwhile.
    let ended = Command::new("setpriv")
        .args(["--pdeathsig", "KILL", "qemu-system-arm", "-M", "lm3s6965evb", "-display", "none"])
        .args(["-monitor", "none", "-chardev", "socket,id=bus,fd=0,server=on,wait=off"])
        .args(["-serial", "chardev:bus", "-serial", "null", "-kernel"])
        .arg(image(sh, kind))
        .stdin(Stdio::from(OwnedFd::from(bus)))
        .status()
        .context("cannot start QEMU with setpriv, of util-linux")?;
    ensure!(ended.success(), "QEMU ended: {ended}");
    Ok(())
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
