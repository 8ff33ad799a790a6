//! The LM3S6965 board under QEMU, for interactive use: `cargo xtask qemu <kind>`.

use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;
use std::os::fd::OwnedFd;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::{io, thread};

use anyhow::{Context, Result, bail, ensure};
use drivetwin_firmware::device::Spec;
use xshell::Shell;

use crate::board::{LM3S6965, hint, network_hint, spec};
use crate::tools::Tool;

/// The TCP ports of a drive on the board: Modbus and MCode (FB 6.3).
const PORTS: [u16; 2] = [502, 503];
/// QEMU's virtual network, with the factory address range of an MDrive (FB 6.3).
const NETWORK: &str = "user,model=stellaris,net=192.168.33.0/24,host=192.168.33.2,dhcpstart=192.168.33.15";
/// Address of the drive in this network.
const DRIVE: &str = "192.168.33.1";
/// End of the line that the board logs when the drive can receive.
const BOOTED: &str = " has power";

/// Builds the image of a kind of drive and runs it until the process is stopped. Its UART0, or its TCP ports,
/// are on free TCP ports of this machine.
///
/// # Errors
///
/// There is no image of that kind, it does not build, or a tool to build or emulate it is missing.
pub(crate) fn run(sh: &Shell, kind: &str) -> Result<()> {
    let image = LM3S6965.image_for(sh, kind, &[Tool::ThumbTargets, Tool::Qemu])?;
    let run = if spec(kind).is_some_and(Spec::is_on_network) { run_on_network } else { run_on_line };
    let ended = run(kind, &image)?;
    ensure!(ended.success(), "QEMU ended: {ended}");
    Ok(())
}

/// A command that runs QEMU. QEMU is killed when this process ends.
fn qemu(image: &Path) -> Command {
    let mut qemu = Command::new("setpriv");
    qemu.args(["--pdeathsig", "KILL", "qemu-system-arm", "-M", "lm3s6965evb", "-display", "none", "-kernel"]);
    qemu.arg(image);
    qemu
}

/// Error message if QEMU cannot be started.
const CANNOT_START: &str = "cannot start QEMU with setpriv, of util-linux";

/// Runs a drive with a serial port.
fn run_on_line(kind: &str, image: &Path) -> Result<ExitStatus> {
    let bus = TcpListener::bind(("127.0.0.1", 0)).context("cannot listen on 127.0.0.1")?;
    let address = bus.local_addr()?;
    println!("{kind} is at {address}; Ctrl-C ends the board; {}", hint(kind, &address.to_string()));
    // QEMU gets the listening socket as its standard input, so that no other process can take the port in
    // between.
    let ended = qemu(image)
        .args(["-monitor", "none", "-chardev", "socket,id=bus,fd=0,server=on,wait=off"])
        .args(["-serial", "chardev:bus", "-serial", "null"])
        .stdin(Stdio::from(OwnedFd::from(bus)))
        .status()
        .context(CANNOT_START)?;
    Ok(ended)
}

/// Runs a drive with TCP ports.
fn run_on_network(kind: &str, image: &Path) -> Result<ExitStatus> {
    let mut qemu = qemu(image)
        .args(on_network())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .context(CANNOT_START)?;
    let mut said = BufReader::new(qemu.stderr.take().context("its standard error is a pipe")?);
    // Waits, because a client that connects before the drive accepts connections is delayed for seconds.
    wait_for_power(&mut said)?;
    thread::spawn(move || io::copy(&mut said, &mut io::stderr()));
    let ports = ports(&mut qemu)?;
    // Kept open, because `wait` would close the standard input, which is the monitor.
    let _monitor = qemu.stdin.take();
    let [modbus, mcode] = ports;
    println!(
        "{kind} is at 127.0.0.1:{modbus} (Modbus/TCP) and 127.0.0.1:{mcode} (MCode); Ctrl-C ends the board; {}",
        network_hint(kind, ports)
    );
    Ok(qemu.wait()?)
}

/// Options of QEMU that forward the TCP ports of the drive to free ports of this machine. The monitor reports
/// these ports.
pub(crate) fn on_network() -> Vec<String> {
    let forward = PORTS.map(|port| format!("hostfwd=tcp:127.0.0.1:0-{DRIVE}:{port}"));
    let mut arguments = ["-monitor", "stdio", "-serial", "null", "-serial", "file:/dev/stderr", "-nic"]
        .map(str::to_owned)
        .to_vec();
    arguments.push(format!("{NETWORK},{}", forward.join(",")));
    arguments
}

/// Reads the forwarded ports from the monitor of a QEMU that was started with the options of [`on_network`]
/// and with pipes as standard input and output.
pub(crate) fn ports(qemu: &mut Child) -> Result<[u16; 2]> {
    let monitor = qemu.stdin.as_mut().context("its standard input is a pipe")?;
    let told = qemu.stdout.take().context("its standard output is a pipe")?;
    writeln!(monitor, "info usernet")?;
    forwarded(BufReader::new(told))
}

/// Waits until the board reports that the drive has power.
pub(crate) fn wait_for_power(said: &mut impl BufRead) -> Result<()> {
    let mut all = String::new();
    while !all.trim_end().ends_with(BOOTED) {
        ensure!(said.read_line(&mut all)? > 0, "the board did not start: {all}");
    }
    Ok(())
}

/// Ports of this machine that QEMU forwards to the ports of the drive. QEMU's monitor lists them.
fn forwarded(told: impl BufRead) -> Result<[u16; 2]> {
    let mut found = [None; PORTS.len()];
    for line in told.lines() {
        let line = line?;
        let words: Vec<&str> = line.split_whitespace().collect();
        let [what, _, "127.0.0.1", here, DRIVE, there, ..] = words.as_slice() else { continue };
        let place = PORTS.iter().position(|port| port.to_string() == *there);
        if let Some(place) = place.filter(|_| what.contains("HOST_FORWARD")) {
            found[place] = Some(here.parse().with_context(|| format!("`{line}` names no port"))?);
        }
        if let [Some(modbus), Some(mcode)] = found {
            return Ok([modbus, mcode]);
        }
    }
    bail!("QEMU does not say where the ports are")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_monitor_tells_where_the_ports_are() {
        let told = "QEMU 7.2.22 monitor - type 'help' for more information\r\n\
            (qemu) info usernet\r\nHub -1 (#net032):\r\n\
            \x20 Protocol[State]    FD  Source Address  Port   Dest. Address  Port RecvQ SendQ\r\n\
            \x20 TCP[HOST_FORWARD]   8       127.0.0.1 44871    192.168.33.1   503     0     0\r\n\
            \x20 TCP[HOST_FORWARD]   3       127.0.0.1 44621    192.168.33.1   502     0     0\r\n(qemu) ";
        assert_eq!(forwarded(told.as_bytes()).expect("both are there"), [44_621, 44_871]);
        assert!(forwarded(&told.as_bytes()[..300]).is_err());
    }

    #[test]
    fn a_board_that_ends_has_not_started() {
        assert!(
            wait_for_power(&mut "Timer with period zero\ndrivetwin: mdrive has power\r\n".as_bytes()).is_ok()
        );
        let error = wait_for_power(&mut "no such machine\n".as_bytes()).expect_err("it ended");
        assert_eq!(error.to_string(), "the board did not start: no such machine\n");
    }
}
