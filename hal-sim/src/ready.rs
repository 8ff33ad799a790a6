//! What `standin run` says when it is ready: where to connect, and a command to try.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::io::{self, Write as _};
use std::net::SocketAddr;
use std::path::PathBuf;

use serde::{Serialize, Serializer};
use standin_firmware::device::{Ends, Line, Port, Spec};
use standin_protocol::line::Parity;
use standin_protocol::modbus::ascii;
use standin_protocol::registers::Space;
use standin_sim::bench::{Bench, Bus, Seat};
use standin_sim::listen::Uri;

use crate::api::Places;
use crate::log;

/// Where a line is reached.
pub(crate) enum Address {
    /// By what a whole URI says.
    Uri(String),
    /// By the pty of that name.
    Pty(PathBuf),
}

impl Address {
    fn uri(&self) -> String {
        match self {
            Self::Uri(uri) => uri.clone(),
            Self::Pty(path) => format!("pty:{}", path.display()),
        }
    }
}

/// A line, and everywhere it is reached.
struct Reached {
    name: String,
    line: Line,
    addresses: Vec<Address>,
}

/// A drive that is ready.
struct Drive {
    name: String,
    spec: &'static Spec,
    /// Its bus address, if it has one.
    unit: Option<i64>,
    /// Its serial ports, and their lines.
    ports: Vec<(Port, Bus)>,
}

/// A bench that is ready.
pub(crate) struct Ready {
    drives: Vec<Drive>,
    lines: BTreeMap<Bus, Reached>,
    control: Option<SocketAddr>,
}

impl Ready {
    /// A bench whose lines are reached at `addresses`; its drives in the order of `seats`.
    pub(crate) fn new(bench: &Bench, seats: &[Seat], mut addresses: BTreeMap<Bus, Vec<Address>>) -> Self {
        let drives = seats.iter().map(|&seat| {
            let spec = bench.spec(seat);
            let ports = (0..).map(Port).take(spec.ports.len());
            Drive {
                name: bench.name(seat).into(),
                spec,
                unit: spec.address.map(|row| bench.peek(seat, row)),
                ports: ports.filter_map(|port| Some((port, bench.bus(seat, port)?))).collect(),
            }
        });
        let lines = bench.buses().into_iter().map(|bus| {
            let addresses = addresses.remove(&bus).unwrap_or_default();
            (bus, Reached { name: bench.bus_name(bus).into(), line: bench.line(bus), addresses })
        });
        Self { drives: drives.collect(), lines: lines.collect(), control: None }
    }

    /// The control API listens there.
    pub(crate) fn controlled_at(&mut self, address: SocketAddr) {
        self.control = Some(address);
    }

    /// Where each line is reached.
    pub(crate) fn places(&self) -> Places {
        self.lines.values().map(|line| (line.name.clone(), line.uris())).collect()
    }

    /// Says it: on stdout, if that does not belong to a line.
    ///
    /// # Errors
    /// Nobody can hear it.
    pub(crate) fn print(&self, json: bool) -> io::Result<()> {
        let text = if json { self.json()? + "\n" } else { self.text() };
        let stdio = Uri::Stdio.to_string();
        if self.lines.values().any(|line| line.uris().contains(&stdio)) {
            log::say(text.as_bytes());
            return Ok(());
        }
        let mut stdout = io::stdout();
        stdout.write_all(text.as_bytes())?;
        stdout.flush()
    }

    fn json(&self) -> io::Result<String> {
        #[derive(Serialize)]
        struct Line<'a> {
            devices: Vec<Device<'a>>,
            control: Option<String>,
        }
        #[derive(Serialize)]
        struct Device<'a> {
            name: &'a str,
            kind: &'a str,
            #[serde(serialize_with = "in_order")]
            ports: Vec<(&'a str, Vec<String>)>,
        }
        fn in_order<S: Serializer>(ports: &[(&str, Vec<String>)], serializer: S) -> Result<S::Ok, S::Error> {
            serializer.collect_map(ports.iter().map(|(name, uris)| (name, uris)))
        }
        let devices = self.drives.iter().map(|drive| {
            let uris = |bus| self.lines.get(bus).map(Reached::uris).unwrap_or_default();
            let ports = drive.ports.iter().map(|(port, bus)| (drive.port_name(*port), uris(bus)));
            Device { name: &drive.name, kind: drive.spec.kind, ports: ports.collect() }
        });
        let line = Line {
            devices: devices.collect(),
            control: self.control.map(|address| format!("http://{address}")),
        };
        Ok(serde_json::to_string(&line)?)
    }

    fn text(&self) -> String {
        let mut text = String::new();
        let mut told = BTreeSet::new();
        for drive in &self.drives {
            let _ = writeln!(text, "{}: {}", drive.name, drive.spec.product);
            for (_, bus) in &drive.ports {
                let Some(reached) = self.lines.get(bus) else { continue };
                let _ = write!(text, "  {}, {}", reached.name, reached.line);
                let _ = drive.unit.map(|unit| write!(text, ", address {unit}"));
                text.push('\n');
                // Who shares a line is reached where its first drive is.
                if told.insert(bus) {
                    for uri in reached.uris() {
                        let _ = writeln!(text, "    {uri}");
                    }
                }
            }
        }
        if let Some(address) = self.control {
            let _ = writeln!(text, "control\n    http://{address}  (what it does: /openapi.json)");
        }
        if let Some(command) = self.command() {
            let _ = writeln!(text, "Try:\n  {command}");
        }
        text.push_str("Ctrl-C ends it.\n");
        text
    }

    /// A command to begin with.
    fn command(&self) -> Option<String> {
        let by_pty = self.drives.iter().find_map(|drive| {
            drive.ports.iter().find_map(|(port, bus)| drive.command(*port, self.lines.get(bus)?))
        });
        by_pty.or_else(|| {
            let (control, drive) = (self.control?, self.drives.first()?);
            Some(format!("curl -s http://{control}/api/drives/{}", drive.name))
        })
    }
}

impl Reached {
    fn uris(&self) -> Vec<String> {
        self.addresses.iter().map(Address::uri).collect()
    }
}

impl Drive {
    fn port_name(&self, port: Port) -> &'static str {
        self.spec.ports.get(usize::from(port.0)).map_or("", |port| port.name)
    }

    /// A command that reads the drive's registers, or opens a terminal where somebody may type, by a pty of
    /// `port`.
    fn command(&self, port: Port, reached: &Reached) -> Option<String> {
        let ends = self.spec.ports.get(usize::from(port.0))?.ends;
        let pty = reached.addresses.iter().find_map(|address| match address {
            Address::Pty(path) => Some(path.display()),
            Address::Uri(_) => None,
        })?;
        let Line { baud, parity, stop, .. } = reached.line;
        if ends == Ends::Character {
            return Some(format!("python3 -m serial.tools.miniterm {pty} {baud}"));
        }
        let (first, count) = self.readable()?;
        // mbpoll has no ASCII.
        (ends == Ends::Silence && !ascii::is_on(reached.line)).then(|| {
            let parity = match parity {
                Parity::None => "none",
                Parity::Even => "even",
                Parity::Odd => "odd",
            };
            let stop = if stop == 1 { "" } else { " -s 2" };
            let unit = self.unit.unwrap_or(1);
            // mbpoll counts registers from 1.
            let first = u32::from(first) + 1;
            format!(
                "mbpoll -m rtu -a {unit} -b {baud} -P {parity}{stop} -t 4:hex -r {first} -c {count} {pty}"
            )
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
}
