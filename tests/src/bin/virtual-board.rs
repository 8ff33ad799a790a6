//! A board in memory, paced by the wall clock, whose cable is two TCP ports of 127.0.0.1:
//! `virtual-board KIND [fast] [CONTROL]`. `CONTROL` is the address of its control port, any free one if it is not given.
//!
//! The first line of its output is `control 127.0.0.1:PORT bus 127.0.0.1:PORT`. A connection is an open port of the cable;
//! a port has one connection at a time. The port of the bus has the settings of the drive's line. The program ends when
//! its standard input ends.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::process::ExitCode;
use std::sync::mpsc::{self, TryRecvError};
use std::time::Duration;

use drivetwin_board::CablePort;
use drivetwin_firmware::device::{self, Instant};
use drivetwin_tests::at_cable::Rig;

/// Time between two looks at the connections.
const PACE: Duration = Duration::from_micros(500);

/// Any free port of this machine.
const ANY: &str = "127.0.0.1:0";

/// A port of the cable as a TCP port.
struct Socket {
    port: CablePort,
    listener: TcpListener,
    stream: Option<TcpStream>,
    /// Bytes for the computer that the connection has not taken.
    unsent: Vec<u8>,
}

impl Socket {
    fn new(port: CablePort, address: &str) -> io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        Ok(Self { port, listener, stream: None, unsent: Vec::new() })
    }

    /// Accepts a connection, and passes bytes on in both directions.
    fn serve(&mut self, rig: &mut Rig) -> io::Result<()> {
        if self.stream.is_none()
            && let Ok((stream, _)) = self.listener.accept()
        {
            stream.set_nonblocking(true)?;
            stream.set_nodelay(true)?;
            self.stream = Some(stream);
            rig.open(self.port, true);
        }
        let Some(stream) = &mut self.stream else { return Ok(()) };
        let mut bytes = [0; 512];
        // A computer whose bytes the board does not take waits.
        let is_open = rig.untaken(self.port) > bytes.len()
            || match stream.read(&mut bytes) {
                Ok(0) => false,
                Ok(count) => {
                    rig.write(self.port, &bytes[..count]);
                    true
                }
                Err(error) => error.kind() == ErrorKind::WouldBlock,
            };
        if self.unsent.is_empty() {
            self.unsent = rig.read_raw(self.port);
        }
        let is_open = is_open
            && match stream.write(&self.unsent) {
                Ok(count) => {
                    self.unsent.drain(..count);
                    true
                }
                Err(error) => error.kind() == ErrorKind::WouldBlock,
            };
        if !is_open {
            self.stream = None;
            self.unsent.clear();
            rig.open(self.port, false);
        }
        Ok(())
    }
}

#[expect(clippy::disallowed_methods, reason = "the board is paced by the wall clock")]
fn serve(kind: &str, fast: bool, control: &str) -> io::Result<()> {
    let mut sockets = [Socket::new(CablePort::Control, control)?, Socket::new(CablePort::Bus, ANY)?];
    let [control, bus] = &sockets;
    println!("control {} bus {}", control.listener.local_addr()?, bus.listener.local_addr()?);
    io::stdout().flush()?;
    // The input ends with the program that has started this one.
    let (alive, ended) = mpsc::channel::<()>();
    std::thread::spawn(move || {
        let _ = io::copy(&mut io::stdin(), &mut io::sink());
        drop(alive);
    });
    let mut rig = Rig::new(kind, fast);
    rig.open(CablePort::Control, false);
    rig.open(CablePort::Bus, false);
    let start = std::time::Instant::now();
    while ended.try_recv() != Err(TryRecvError::Disconnected) {
        for socket in &mut sockets {
            socket.serve(&mut rig)?;
        }
        rig.set_line(rig.uart_line());
        let passed = u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX);
        rig.run_raw(Instant::ZERO + device::Duration::from_ticks(passed.saturating_mul(2) / 125));
        std::thread::sleep(PACE);
    }
    Ok(())
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (kind, fast, control) = match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        [kind] => (kind, false, ANY),
        [kind, "fast"] => (kind, true, ANY),
        [kind, "fast", control] => (kind, true, control),
        [kind, control] => (kind, false, control),
        _ => {
            eprintln!("usage: virtual-board KIND [fast] [CONTROL]");
            return ExitCode::FAILURE;
        }
    };
    if let Err(why) = drivetwin_sim::catalog::make(kind) {
        eprintln!("virtual-board: {why}");
        return ExitCode::FAILURE;
    }
    match serve(kind, fast, control) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("virtual-board: {error}");
            ExitCode::FAILURE
        }
    }
}
