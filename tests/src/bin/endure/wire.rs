//! A connection of a master to a port: raw TCP, a remote serial port (RFC 2217) or a pty.

use std::fs::{File, OpenOptions};
use std::io::{self, ErrorKind, Read, Write};
use std::net::TcpStream;
use std::process::Command;
use std::time::Duration;

use crate::now;

/// Longest single wait of a read. A pty has it as its setting, in tenths of a second.
const STEP: Duration = Duration::from_millis(100);

/// Commands of Telnet (RFC 854).
const IAC: u8 = 255;
const SB: u8 = 250;
const SE: u8 = 240;

/// WILL COM-PORT-OPTION, and the settings 115,200 8E1 (RFC 2217).
const NEGOTIATION: [u8; 34] = [
    IAC, 251, 44, //
    IAC, SB, 44, 1, 0x00, 0x01, 0xC2, 0x00, IAC, SE, // SET-BAUDRATE
    IAC, SB, 44, 2, 8, IAC, SE, // SET-DATASIZE
    IAC, SB, 44, 3, 3, IAC, SE, // SET-PARITY: even
    IAC, SB, 44, 4, 1, IAC, SE, // SET-STOPSIZE
];

/// A connection.
pub(crate) struct Wire {
    stream: Stream,
    telnet: Option<Telnet>,
}

enum Stream {
    Tcp(TcpStream),
    Pty(File),
}

/// Place in the stream of a Telnet peer.
#[derive(Clone, Copy, PartialEq)]
enum Telnet {
    Data,
    Command,
    Option,
    Sub,
    SubCommand,
}

/// Reason why an exchange has no right reply.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Failed {
    /// The time is over.
    Silent,
    /// The connection is closed.
    Closed,
}

impl Wire {
    /// Connects to a place as the bench names it.
    pub(crate) fn open(place: &str) -> io::Result<Self> {
        let (kind, address) = place.split_once(':').unwrap_or((place, ""));
        if kind == "pty" {
            let file = OpenOptions::new().read(true).write(true).open(address)?;
            // A pty has no even parity.
            let settings = ["115200", "raw", "-echo", "cs8", "-cstopb", "min", "0", "time", "1"];
            let done = Command::new("stty").args(settings).stdin(file.try_clone()?).status()?;
            if !done.success() {
                return Err(io::Error::other("stty has failed"));
            }
            return Ok(Self { stream: Stream::Pty(file), telnet: None });
        }
        let stream = TcpStream::connect(address)?;
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(STEP))?;
        let mut wire = Self { stream: Stream::Tcp(stream), telnet: None };
        if kind == "rfc2217" {
            wire.put(&NEGOTIATION)?;
            wire.telnet = Some(Telnet::Data);
        }
        Ok(wire)
    }

    fn put(&mut self, bytes: &[u8]) -> io::Result<()> {
        match &mut self.stream {
            Stream::Tcp(stream) => stream.write_all(bytes),
            Stream::Pty(file) => file.write_all(bytes),
        }
    }

    /// Sends a request.
    pub(crate) fn send(&mut self, bytes: &[u8]) -> Result<(), Failed> {
        let doubled: Vec<u8>;
        let bytes = if self.telnet.is_some() {
            doubled = bytes.iter().flat_map(|&byte| vec![byte; if byte == IAC { 2 } else { 1 }]).collect();
            &doubled
        } else {
            bytes
        };
        self.put(bytes).map_err(|_| Failed::Closed)
    }

    /// Appends what has arrived to `to`, after at most [`STEP`].
    fn get(&mut self, to: &mut Vec<u8>) -> Result<(), Failed> {
        let mut bytes = [0; 512];
        let count = match &mut self.stream {
            Stream::Tcp(stream) => match stream.read(&mut bytes) {
                Ok(0) => return Err(Failed::Closed),
                other => other,
            },
            // A pty returns nothing when the time is over.
            Stream::Pty(file) => file.read(&mut bytes),
        };
        match count {
            Ok(count) => self.filter(&bytes[..count], to),
            Err(error)
                if matches!(
                    error.kind(),
                    ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted
                ) => {}
            Err(_) => return Err(Failed::Closed),
        }
        Ok(())
    }

    /// Appends the data without the commands of Telnet.
    fn filter(&mut self, bytes: &[u8], to: &mut Vec<u8>) {
        let Some(state) = &mut self.telnet else { return to.extend_from_slice(bytes) };
        for &byte in bytes {
            *state = match (*state, byte) {
                (Telnet::Data, IAC) => Telnet::Command,
                (Telnet::Command, SB) => Telnet::Sub,
                (Telnet::Command, 251..=254) => Telnet::Option,
                (Telnet::Data, byte) | (Telnet::Command, byte @ IAC) => {
                    to.push(byte);
                    Telnet::Data
                }
                (Telnet::Command | Telnet::Option, _) => Telnet::Data,
                (Telnet::Sub, IAC) => Telnet::SubCommand,
                (Telnet::SubCommand, SE) => Telnet::Data,
                (Telnet::Sub | Telnet::SubCommand, _) => Telnet::Sub,
            };
        }
    }

    /// Receives `count` bytes into `to`.
    pub(crate) fn receive(
        &mut self,
        count: usize,
        patience: Duration,
        to: &mut Vec<u8>,
    ) -> Result<(), Failed> {
        to.clear();
        let mut end = None;
        loop {
            self.get(to)?;
            if to.len() >= count {
                return Ok(());
            }
            let end = *end.get_or_insert_with(|| now() + patience);
            if now() > end {
                return Err(Failed::Silent);
            }
        }
    }

    /// Drops what arrives until nothing has arrived for [`STEP`].
    pub(crate) fn drain(&mut self) -> Result<(), Failed> {
        let mut dropped = Vec::new();
        for _ in 0..50 {
            let before = dropped.len();
            self.get(&mut dropped)?;
            if dropped.len() == before {
                break;
            }
        }
        Ok(())
    }
}
