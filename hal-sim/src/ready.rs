//! What `standin run` says when it is ready: where to connect, and a command to try.

use std::fmt::Write as _;
use std::io::{self, Write as _};
use std::net::SocketAddr;
use std::path::PathBuf;

use serde::{Serialize, Serializer};
use standin_firmware::device::{Ends, Line, Port, Spec};
use standin_protocol::line::Parity;
use standin_protocol::modbus::ascii;
use standin_protocol::registers::Space;

use crate::api::Places;

/// Where a port is reached.
pub(crate) enum Address {
    /// By TCP: the whole URI.
    Tcp(String),
    /// By the pty of that name.
    Pty(PathBuf),
}

impl Address {
    fn uri(&self) -> String {
        match self {
            Self::Tcp(uri) => uri.clone(),
            Self::Pty(path) => format!("pty:{}", path.display()),
        }
    }
}

/// A port and everywhere it is reached.
struct Reached {
    port: Port,
    bus: String,
    line: Line,
    addresses: Vec<Address>,
}

/// A drive that is ready.
pub(crate) struct Ready {
    spec: &'static Spec,
    ports: Vec<Reached>,
    control: Option<SocketAddr>,
}

impl Ready {
    /// A drive that nobody can reach yet, named like its kind.
    pub(crate) fn new(spec: &'static Spec) -> Self {
        Self { spec, ports: Vec::new(), control: None }
    }

    /// `port`, on the line `bus`, is reached at `address`.
    pub(crate) fn reached(&mut self, port: Port, bus: &str, line: Line, address: Address) {
        match self.ports.iter_mut().find(|reached| reached.port == port) {
            Some(reached) => reached.addresses.push(address),
            None => self.ports.push(Reached { port, bus: bus.into(), line, addresses: vec![address] }),
        }
    }

    /// The control API listens there.
    pub(crate) fn controlled_at(&mut self, address: SocketAddr) {
        self.control = Some(address);
    }

    /// Where each line is reached.
    pub(crate) fn places(&self) -> Places {
        let uris = |reached: &Reached| reached.addresses.iter().map(Address::uri).collect();
        self.ports.iter().map(|reached| (reached.bus.clone(), uris(reached))).collect()
    }

    /// Says it on stdout, of a drive with the bus address `unit`.
    ///
    /// # Errors
    /// Nobody can hear it.
    pub(crate) fn print(&self, json: bool, unit: Option<i64>) -> io::Result<()> {
        let text = if json { self.json()? + "\n" } else { self.text(unit) };
        let mut stdout = io::stdout();
        stdout.write_all(text.as_bytes())?;
        stdout.flush()
    }

    fn json(&self) -> io::Result<String> {
        #[derive(Serialize)]
        struct Line<'a> {
            devices: [Device<'a>; 1],
            control: Option<String>,
        }
        #[derive(Serialize)]
        struct Device<'a> {
            name: &'a str,
            kind: &'a str,
            #[serde(serialize_with = "ports")]
            ports: &'a Ready,
        }
        fn ports<S: Serializer>(ready: &&Ready, serializer: S) -> Result<S::Ok, S::Error> {
            serializer.collect_map(ready.ports.iter().map(|reached| {
                let uris: Vec<String> = reached.addresses.iter().map(Address::uri).collect();
                (ready.port_name(reached), uris)
            }))
        }
        let line = Line {
            devices: [Device { name: self.spec.kind, kind: self.spec.kind, ports: self }],
            control: self.control.map(|address| format!("http://{address}")),
        };
        Ok(serde_json::to_string(&line)?)
    }

    fn text(&self, unit: Option<i64>) -> String {
        let mut text = format!("{}: {}\n", self.spec.kind, self.spec.product);
        for reached in &self.ports {
            let _ = write!(text, "  {}, {}", self.port_name(reached), reached.line);
            let _ = unit.map(|unit| write!(text, ", address {unit}"));
            text.push('\n');
            for address in &reached.addresses {
                let _ = writeln!(text, "    {}", address.uri());
            }
        }
        if let Some(address) = self.control {
            let _ = writeln!(text, "  control\n    http://{address}  (what it does: /openapi.json)");
        }
        if let Some(command) = self.command(unit) {
            let _ = writeln!(text, "Try:\n  {command}");
        }
        text.push_str("Ctrl-C ends it.\n");
        text
    }

    /// A command that reads the drive's registers, or opens a terminal where somebody may type.
    fn command(&self, unit: Option<i64>) -> Option<String> {
        let by_pty = self.ports.iter().find_map(|reached| {
            let ends = self.spec.ports.get(usize::from(reached.port.0))?.ends;
            let pty = reached.addresses.iter().find_map(|address| match address {
                Address::Pty(path) => Some(path),
                Address::Tcp(_) => None,
            })?;
            if ends == Ends::Character {
                let pty = pty.display();
                return Some(format!("python3 -m serial.tools.miniterm {pty} {}", reached.line.baud));
            }
            let (first, count) = self.readable()?;
            // mbpoll has no ASCII.
            (ends == Ends::Silence && !ascii::is_on(reached.line)).then(|| {
                let Line { baud, parity, stop, .. } = reached.line;
                let parity = match parity {
                    Parity::None => "none",
                    Parity::Even => "even",
                    Parity::Odd => "odd",
                };
                let stop = if stop == 1 { "" } else { " -s 2" };
                let unit = unit.unwrap_or(1);
                // mbpoll counts registers from 1.
                let first = u32::from(first) + 1;
                let pty = pty.display();
                format!(
                    "mbpoll -m rtu -a {unit} -b {baud} -P {parity}{stop} -t 4:hex -r {first} -c {count} {pty}"
                )
            })
        });
        by_pty.or_else(|| {
            let control = self.control?;
            Some(format!("curl -s http://{control}/api/drives/{}", self.spec.kind))
        })
    }

    /// The first holding register, and how many from there one request may read.
    fn readable(&self) -> Option<(u16, u16)> {
        /// What a reply has room for.
        const MOST: u16 = 125;
        let table = self.spec.registers;
        let first = table.rows.iter().find(|row| row.space == Space::Holding && row.access.reads())?.address;
        let count = (1..=MOST).rev().find(|&count| table.readable(Space::Holding, first, count).is_some())?;
        Some((first, count))
    }

    fn port_name(&self, reached: &Reached) -> &'static str {
        self.spec.ports.get(usize::from(reached.port.0)).map_or("", |port| port.name)
    }
}
