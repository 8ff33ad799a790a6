//! The banner of a bench that is ready: where to connect, and a command to try.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;

use drivetwin_firmware::device::{Framing, Line, Port, Spec};
use drivetwin_protocol::line::Parity;
use drivetwin_protocol::modbus::ascii;
use drivetwin_protocol::registers::Space;
use drivetwin_sim::bench::{Bench, DriveId, Outlet};
use drivetwin_sim::config::listen::Uri;
use serde::{Serialize, Serializer};

use crate::api::Places;

/// Address of a line or a TCP port.
pub(crate) enum Address {
    /// A URI.
    Uri(String),
    /// A pty.
    Pty {
        /// Path of the device.
        path: PathBuf,
        /// Path of its link.
        link: Option<PathBuf>,
    },
    /// The serial port of a board, which a master opens.
    Port(PathBuf),
}

impl Address {
    fn uris(&self) -> Vec<String> {
        match self {
            Self::Uri(uri) => vec![uri.clone()],
            Self::Pty { path, link } => {
                let names = std::iter::once(path).chain(link);
                names.map(|name| Uri::Pty(Some(name.clone())).to_string()).collect()
            }
            Self::Port(path) => vec![Uri::Serial(path.clone()).to_string()],
        }
    }
}

/// Maximum number of drives that are all listed.
const MAX_LISTED: usize = 12;

/// Number of drives that are listed if the bench has more than [`MAX_LISTED`] drives.
const LISTED: usize = 8;

/// A line or TCP port with its addresses.
struct Reached {
    name: String,
    /// The serial settings; `None` for a TCP port.
    line: Option<Line>,
    addresses: Vec<Address>,
}

/// A drive that is ready.
struct Drive {
    name: String,
    spec: &'static Spec,
    /// Bus address, if the drive has one.
    unit: Option<i64>,
    /// Place of the board that it is on, and the version of its image; empty for an emulated drive.
    board: String,
    /// Ports of the drive, and the line or TCP port of each.
    ports: Vec<(Port, Outlet)>,
}

/// A bench that is ready.
pub(crate) struct Banner {
    drives: Vec<Drive>,
    outlets: BTreeMap<Outlet, Reached>,
    control: Option<SocketAddr>,
}

impl Banner {
    /// The banner of a bench with these addresses. It lists the drives in the order of `ids`.
    pub(crate) fn new(bench: &Bench, ids: &[DriveId], mut addresses: BTreeMap<Outlet, Vec<Address>>) -> Self {
        let drives = ids.iter().map(|&id| {
            let spec = bench.spec(id);
            let ports = (0..).map(Port).take(spec.ports.len());
            Drive {
                name: bench.name(id).into(),
                spec,
                unit: spec.address.map(|row| bench.peek(id, row)),
                board: String::new(),
                ports: ports.map(|port| (port, bench.outlet(id, port))).collect(),
            }
        });
        let outlets = bench.outlets().into_iter().map(|outlet| {
            let addresses = addresses.remove(&outlet).unwrap_or_default();
            let line = match outlet {
                Outlet::Line(bus) => Some(bench.line(bus)),
                Outlet::Tcp(..) => None,
            };
            (outlet, Reached { name: bench.outlet_name(outlet), line, addresses })
        });
        Self { drives: drives.collect(), outlets: outlets.collect(), control: None }
    }

    /// Sets the address of the control API.
    pub(crate) fn set_control(&mut self, address: SocketAddr) {
        self.control = Some(address);
    }

    /// Sets the board that a drive is on, and the address and the settings of the bus that it has there.
    pub(crate) fn set_board(&mut self, drive: &str, board: &str, unit: Option<i64>, line: Option<Line>) {
        for drive in self.drives.iter_mut().filter(|other| other.name == drive) {
            (drive.board, drive.unit) = (board.to_owned(), unit);
            for (_, outlet) in &drive.ports {
                if let Some(reached) = self.outlets.get_mut(outlet) {
                    reached.line = line.or(reached.line);
                }
            }
        }
    }

    /// URIs of each line and TCP port.
    pub(crate) fn places(&self) -> Places {
        self.outlets.iter().map(|(&outlet, reached)| (outlet, reached.uris())).collect()
    }

    /// URL of the control API; `None` if it is off.
    pub(crate) fn control(&self) -> Option<String> {
        self.control.map(|address| format!("http://{address}"))
    }

    /// Names and descriptions of the drives.
    pub(crate) fn drives(&self) -> impl Iterator<Item = (&str, &'static Spec)> {
        self.drives.iter().map(|drive| (drive.name.as_str(), drive.spec))
    }

    /// URIs of a port of a drive; none if there is no such drive or port.
    pub(crate) fn uris(&self, drive: &str, port: &str) -> Vec<String> {
        let drive = self.drives.iter().find(|other| other.name == drive);
        let outlet = drive.and_then(|drive| {
            drive.ports.iter().find(|(other, _)| drive.port_name(*other) == port).map(|(_, outlet)| outlet)
        });
        outlet.and_then(|outlet| self.outlets.get(outlet)).map(Reached::uris).unwrap_or_default()
    }

    /// The banner as one line of JSON.
    ///
    /// # Errors
    /// The banner cannot be written as JSON.
    pub(crate) fn json(&self) -> io::Result<String> {
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
            let uris = |outlet| self.outlets.get(outlet).map(Reached::uris).unwrap_or_default();
            let ports = drive.ports.iter().map(|(port, outlet)| (drive.port_name(*port), uris(outlet)));
            Device { name: &drive.name, kind: drive.spec.kind, ports: ports.collect() }
        });
        let line = Line { devices: devices.collect(), control: self.control() };
        Ok(serde_json::to_string(&line)? + "\n")
    }

    /// Text for people.
    pub(crate) fn text(&self) -> String {
        let mut text = String::new();
        let mut listed = BTreeSet::new();
        let shown = if self.drives.len() > MAX_LISTED { LISTED } else { self.drives.len() };
        for drive in &self.drives[..shown] {
            let _ = writeln!(text, "{}: {}", drive.name, drive.spec.product);
            if !drive.board.is_empty() {
                let _ = writeln!(text, "  on the board at {}", drive.board);
            }
            for (_, outlet) in &drive.ports {
                let Some(reached) = self.outlets.get(outlet) else { continue };
                let _ = match reached.line {
                    Some(line) => write!(text, "  {}, {line}", reached.name),
                    None => write!(text, "  {}, TCP", reached.name),
                };
                let _ = drive.unit.map(|unit| write!(text, ", address {unit}"));
                text.push('\n');
                // The addresses of a shared line are listed with its first drive only.
                if listed.insert(outlet) {
                    for uri in reached.uris() {
                        let _ = writeln!(text, "    {uri}");
                    }
                    if let Some(socket) = reached.without_parity() {
                        let _ = writeln!(
                            text,
                            "    pymodbus and others cannot set a parity on a pty; {socket} works"
                        );
                    }
                }
            }
        }
        if shown < self.drives.len() {
            self.outline(&self.drives[shown..], &mut text);
        }
        if let Some(address) = self.control {
            let _ = writeln!(text, "panel\n    http://{address}/");
            let _ = writeln!(text, "control\n    http://{address}  (description: /openapi.json)");
            if !address.ip().is_loopback() {
                text.push_str("    any program that can reach this address can control the drives\n");
            }
        }
        let commands = self.commands();
        if !commands.is_empty() {
            let _ = writeln!(text, "Try:\n  {}", commands.join("\n  "));
        }
        text.push_str(match self.drives.iter().filter(|drive| !drive.board.is_empty()).count() {
            0 => "Ctrl-C ends it.\n",
            1 => "Ctrl-C ends it; the board goes on.\n",
            _ => "Ctrl-C ends it; the boards go on.\n",
        });
        text
    }

    /// Adds the number of the other drives, and a command that lists all drives.
    fn outline(&self, others: &[Drive], text: &mut String) {
        let mut kinds: BTreeMap<&str, usize> = BTreeMap::new();
        others.iter().for_each(|drive| *kinds.entry(drive.spec.kind).or_default() += 1);
        let kinds: Vec<String> = kinds.iter().map(|(kind, count)| format!("{count} {kind}")).collect();
        let _ = writeln!(text, "and {} more drives: {}", others.len(), kinds.join(", "));
        let _ = match self.control {
            Some(address) => writeln!(text, "  all of them: curl -s http://{address}/api/bench, or --json"),
            None => writeln!(text, "  all of them: --json"),
        };
    }

    /// Commands to try, one for each port of the first drive that has such a command.
    fn commands(&self) -> Vec<String> {
        let of_ports = self.drives.iter().map(|drive| {
            let ports = drive.ports.iter();
            ports.filter_map(|(port, outlet)| drive.command(*port, self.outlets.get(outlet)?)).collect()
        });
        let of_control = || {
            let (control, drive) = (self.control?, self.drives.first()?);
            Some(format!("curl -s http://{control}/api/drives/{}", drive.name))
        };
        of_ports
            .into_iter()
            .find(|commands: &Vec<_>| !commands.is_empty())
            .unwrap_or_else(|| of_control().into_iter().collect())
    }
}

impl Reached {
    /// URL that a program with pyserial can open instead, for a line with parity that has a pty (HOST-2). A URL of
    /// RFC 2217 does not help, because pymodbus does not open one.
    fn without_parity(&self) -> Option<String> {
        let has_pty = self.addresses.iter().any(|address| matches!(address, Address::Pty { .. }));
        let has_parity = self.line.is_some_and(|line| line.parity != Parity::None);
        self.at("tcp:").map(|address| format!("socket://{address}")).filter(|_| has_pty && has_parity)
    }

    /// URL that a program with pyserial can open like a serial port.
    fn remote_port(&self) -> Option<String> {
        self.at("rfc2217:").map(|address| format!("rfc2217://{address}"))
    }

    /// The first address with this scheme, without the scheme.
    fn at(&self, scheme: &str) -> Option<String> {
        self.uris().iter().find_map(|uri| uri.strip_prefix(scheme).map(ToOwned::to_owned))
    }

    fn uris(&self) -> Vec<String> {
        self.addresses.iter().flat_map(Address::uris).collect()
    }
}

impl Drive {
    fn port_name(&self, port: Port) -> &'static str {
        self.spec.ports.get(usize::from(port.0)).map_or("", |port| port.name)
    }

    /// A command that reads the drive's registers or opens a terminal. It uses the pty of `port`, or the TCP
    /// address.
    fn command(&self, port: Port, reached: &Reached) -> Option<String> {
        let ends = self.spec.ports.get(usize::from(port.0))?.framing;
        let Some(line) = reached.line else { return self.command_by_tcp(ends, reached) };
        let pty = reached.addresses.iter().find_map(|address| match address {
            Address::Pty { path, link } => Some(link.as_ref().unwrap_or(path).display().to_string()),
            Address::Port(path) => Some(path.display().to_string()),
            Address::Uri(_) => None,
        });
        let Line { baud, parity, stop, .. } = line;
        if ends == Framing::Character {
            let port = pty.or_else(|| reached.remote_port())?;
            return Some(format!("python3 -m serial.tools.miniterm {port} {baud}"));
        }
        // mbpoll opens no remote port.
        let pty = pty?;
        let (first, count) = self.readable()?;
        // mbpoll does not support Modbus ASCII.
        (ends == Framing::Silence && !ascii::is_on(line)).then(|| {
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
                "mbpoll -m rtu -a {unit} -b {baud} -P {parity}{stop} -t 4:hex -r {first} -c {count} -1 {pty}"
            )
        })
    }

    fn command_by_tcp(&self, ends: Framing, reached: &Reached) -> Option<String> {
        let address: SocketAddr = reached.at("tcp:")?.parse().ok()?;
        if ends == Framing::Return {
            return Some(format!("python3 -m serial.tools.miniterm socket://{address}"));
        }
        let (first, count) = self.readable().filter(|_| ends == Framing::Mbap)?;
        // mbpoll counts registers from 1.
        let first = u32::from(first) + 1;
        Some(format!(
            "mbpoll -m tcp -p {} -t 4:hex -r {first} -c {count} -1 {}",
            address.port(),
            address.ip()
        ))
    }

    /// First holding register that can be read, and the number of registers that one request may read from
    /// there.
    fn readable(&self) -> Option<(u16, u16)> {
        /// Most registers that fit into one reply.
        const MOST: u16 = 125;
        let table = self.spec.registers;
        let first = table.rows.iter().find(|row| row.space == Space::Holding && row.access.reads())?.address;
        let count = (1..=MOST).rev().find(|&count| table.readable(Space::Holding, first, count).is_some())?;
        Some((first, count))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivetwin_firmware::md3::Md3;
    use drivetwin_sim::bench::Setup;
    use drivetwin_sim::catalog;
    use drivetwin_sim::testing::echo_device::{EchoDevice, MCODE, MODBUS};

    #[test]
    fn a_pty_is_listed_by_both_names_and_tried_by_its_link() {
        let mut bench = Bench::new();
        let md3 = bench.add::<Md3>("md3");
        let address = |link: Option<&str>| {
            let (path, link) = ("/dev/pts/4".into(), link.map(PathBuf::from));
            [(bench.outlet(md3, Port(0)), vec![Address::Pty { path, link }])].into()
        };
        let banner = Banner::new(&bench, &[md3], address(Some("md3.tty")));
        let text = "md3: US Digital MD3 stepper drive, 7 A
  rs485, 9600 8E1, address 1
    pty:/dev/pts/4
    pty:md3.tty
Try:
  mbpoll -m rtu -a 1 -b 9600 -P even -t 4:hex -r 1 -c 32 -1 md3.tty
Ctrl-C ends it.
";
        assert_eq!(banner.text(), text);
        assert!(banner.json().unwrap().contains(r#""rs485":["pty:/dev/pts/4","pty:md3.tty"]"#));
        let banner = Banner::new(&bench, &[md3], address(None));
        assert_eq!(banner.text(), text.replace("    pty:md3.tty\n", "").replace("md3.tty", "/dev/pts/4"));
    }

    #[test]
    fn a_remote_port_is_tried_if_there_is_no_pty() {
        let mut bench = Bench::new();
        let device = catalog::make("qsb-d").unwrap();
        let qsb = bench.add_with("qsb-d", device, Setup::default()).unwrap();
        let uri = "rfc2217:127.0.0.1:5020".to_owned();
        let addresses = [(bench.outlet(qsb, Port(0)), vec![Address::Uri(uri)])].into();
        let text = "qsb-d: US Digital QSB-D encoder to USB adapter, differential
  usb, 230400 8N1
    rfc2217:127.0.0.1:5020
Try:
  python3 -m serial.tools.miniterm rfc2217://127.0.0.1:5020 230400
Ctrl-C ends it.
";
        assert_eq!(Banner::new(&bench, &[qsb], addresses).text(), text);
    }

    #[test]
    fn of_many_drives_the_first_ones_are_listed() {
        let text = |count: usize| {
            let mut bench = Bench::new();
            let mut drives: Vec<DriveId> = (1..count).map(|n| bench.add::<Md3>(&format!("x{n}"))).collect();
            drives.push(bench.add::<EchoDevice>("echo"));
            let mut banner = Banner::new(&bench, &drives, BTreeMap::new());
            banner.set_control(([127, 0, 0, 1], 8080).into());
            banner.text()
        };
        assert_eq!(text(12).matches("stepper drive").count(), 11);
        let many = text(300);
        assert_eq!(many.matches("stepper drive").count(), 8);
        let outline = "x8: US Digital MD3 stepper drive, 7 A
  x8.rs485, 9600 8E1, address 1
and 292 more drives: 1 echo, 291 md3
  all of them: curl -s http://127.0.0.1:8080/api/bench, or --json
panel
    http://127.0.0.1:8080/
control
    http://127.0.0.1:8080  (description: /openapi.json)
";
        assert!(many.contains(outline), "{many}");
    }

    #[test]
    fn tcp_ports_are_listed_like_lines() {
        let mut bench = Bench::new();
        let echo = bench.add::<EchoDevice>("echo");
        let places = [(MODBUS, "tcp:127.0.0.1:5020"), (MCODE, "tcp:127.0.0.1:5030")];
        let addresses =
            places.map(|(port, uri)| (bench.outlet(echo, port), vec![Address::Uri(uri.into())])).into();
        let banner = Banner::new(&bench, &[echo], addresses);
        let json = r#"{"devices":[{"name":"echo","kind":"echo","ports":{"modbus":["tcp:127.0.0.1:5020"],"mcode":["tcp:127.0.0.1:5030"]}}],"control":null}"#;
        assert_eq!(banner.json().unwrap().trim_end(), json);
        let text = "echo: an echo
  modbus, TCP
    tcp:127.0.0.1:5020
  mcode, TCP
    tcp:127.0.0.1:5030
Try:
  python3 -m serial.tools.miniterm socket://127.0.0.1:5030
Ctrl-C ends it.
";
        assert_eq!(banner.text(), text);
        assert_eq!(banner.places()[&bench.outlet(echo, MCODE)], ["tcp:127.0.0.1:5030"]);
    }
}
