//! The LM3S6965 board under QEMU, for people: `cargo xtask qemu <kind>`.

use std::net::TcpListener;
use std::os::fd::OwnedFd;
use std::process::{Command, Stdio};

use anyhow::{Context, Result, ensure};
use xshell::Shell;

use crate::board::{LM3S6965, hint};
use crate::tools::Tool;

/// Builds the image of a kind of drive and runs it, its UART0 on a free TCP port of this machine, until the
/// process is stopped.
///
/// # Errors
///
/// If there is no image of that kind, if it does not build, or if something to build or emulate it with is missing.
pub(crate) fn run(sh: &Shell, kind: &str) -> Result<()> {
    let image = LM3S6965.image_for(sh, kind, &[Tool::ThumbTargets, Tool::Qemu])?;
    let bus = TcpListener::bind(("127.0.0.1", 0)).context("cannot listen on 127.0.0.1")?;
    let address = bus.local_addr()?;
    println!("{kind} is at {address}; Ctrl-C ends the board; {}", hint(kind, &address.to_string()));
    // QEMU dies with this process. It is handed the port as its standard input, so that nobody else can
    // have taken it meanwhile.
    let ended = Command::new("setpriv")
        .args(["--pdeathsig", "KILL", "qemu-system-arm", "-M", "lm3s6965evb", "-display", "none"])
        .args(["-monitor", "none", "-chardev", "socket,id=bus,fd=0,server=on,wait=off"])
        .args(["-serial", "chardev:bus", "-serial", "null", "-kernel"])
        .arg(image)
        .stdin(Stdio::from(OwnedFd::from(bus)))
        .status()
        .context("cannot start QEMU with setpriv, of util-linux")?;
    ensure!(ended.success(), "QEMU ended: {ended}");
    Ok(())
}
