//! Places of boards: a serial port, a USB serial number, a TCP address, or the only board there is.

use std::fmt;
use std::fs;
use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, ToSocketAddrs as _};
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::time::Duration;

use rustix::event::PollFlags;
use rustix::io::Errno;
use rustix::net::sockopt::{set_tcp_nodelay, socket_error};
use rustix::net::{AddressFamily, SocketFlags, SocketType, socket_with};

use super::link::Stop;
use crate::options::BoardPlace;
use crate::ports::Device;

/// Folder in which Linux lists serial ports.
pub(crate) const PORTS: &str = "/sys/class/tty";

/// USB identification of a board.
const VENDOR: &str = "1209";
const PRODUCT: &str = "0001";

/// Name of the USB interface of the control port, and of the port of the bus.
const CONTROL: &str = "drivetwin control";
const BUS: &str = "drivetwin bus";

/// Longest wait for a TCP connection.
const CONNECTED: Duration = Duration::from_secs(2);

/// A board at a USB cable.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) struct Plugged {
    /// USB serial number.
    pub(super) serial: String,
    control: PathBuf,
    /// The serial port of the drive's bus.
    bus: Option<PathBuf>,
}

/// A place that has been looked up.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Target {
    /// Port or address at which the board is now.
    reach: Reach,
    /// USB serial number, by which a board is found again that was unplugged.
    serial: Option<String>,
    /// The serial port of the drive's bus.
    pub(super) bus: Option<PathBuf>,
}

#[derive(Clone, PartialEq, Eq, Debug)]
enum Reach {
    Serial(PathBuf),
    Tcp(String),
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (&self.reach, &self.serial) {
            (Reach::Serial(path), Some(serial)) => write!(f, "{} (usb:{serial})", path.display()),
            (Reach::Serial(path), None) => write!(f, "{}", path.display()),
            (Reach::Tcp(address), _) => write!(f, "tcp:{address}"),
        }
    }
}

impl Target {
    /// Looks up a place.
    ///
    /// # Errors
    /// One sentence: there is no board, or there are several.
    pub(crate) fn find(place: &BoardPlace) -> Result<Self, String> {
        Self::find_in(Path::new(PORTS), place)
    }

    /// Looks up a place among the serial ports in a folder.
    ///
    /// # Errors
    /// One sentence: there is no board, or there are several.
    pub(super) fn find_in(ports: &Path, place: &BoardPlace) -> Result<Self, String> {
        let listed = |boards: &[Plugged]| {
            let names: Vec<String> = boards.iter().map(|board| format!("usb:{}", board.serial)).collect();
            names.join(", ")
        };
        let boards = plugged(ports);
        match place {
            BoardPlace::Tcp(address) => {
                Ok(Self { reach: Reach::Tcp(address.clone()), serial: None, bus: None })
            }
            BoardPlace::Port(path) => {
                let is_same = |board: &&Plugged| same(&board.control, path);
                if let Some(board) = boards.iter().find(|board| board.bus.as_ref().is_some_and(|bus| same(bus, path))) {
                    return Err(format!(
                        "{} is the port of the drive's bus; the control port of this board is {}",
                        path.display(),
                        board.control.display()
                    ));
                }
                Ok(match boards.iter().find(is_same) {
                    Some(board) => Self { reach: Reach::Serial(path.clone()), ..board.clone().into() },
                    None => Self { reach: Reach::Serial(path.clone()), serial: None, bus: None },
                })
            }
            BoardPlace::Usb(serial) => match boards.iter().find(|board| board.serial == *serial) {
                Some(board) => Ok(board.clone().into()),
                None if boards.is_empty() => Err(format!("no board is plugged in, so usb:{serial} is not there")),
                None => Err(format!("usb:{serial} is not plugged in; there is {}", listed(&boards))),
            },
            BoardPlace::Only => match boards.as_slice() {
                [] => Err(
                    "no board is plugged in; name its control port if the system does not know it, like /dev/ttyACM1"
                        .into(),
                ),
                [board] => Ok(board.clone().into()),
                several => Err(format!("several boards are plugged in: {}; name one of them", listed(several))),
            },
        }
    }

    /// Returns true if this is the same board as another one.
    pub(crate) fn is_same(&self, other: &Self) -> bool {
        match (&self.serial, &other.serial, &self.reach, &other.reach) {
            (Some(own), Some(other), ..) => own == other,
            (.., Reach::Serial(own), Reach::Serial(other)) => same(own, other),
            (.., Reach::Tcp(own), Reach::Tcp(other)) => is_same_address(own, other),
            _ => false,
        }
    }

    /// Returns true if the board is behind TCP.
    pub(super) fn is_tcp(&self) -> bool {
        matches!(self.reach, Reach::Tcp(_))
    }

    /// Opens the control port. A board that was unplugged may have another path now.
    ///
    /// # Errors
    /// The port cannot be opened, or the stop has come.
    pub(super) fn open(&mut self, stop: &Stop) -> io::Result<OwnedFd> {
        if let Some(serial) = &self.serial
            && let Ok(there) = Self::find(&BoardPlace::Usb(serial.clone()))
        {
            *self = there;
        }
        match &self.reach {
            Reach::Serial(path) => Device::open(path)?.into_raw(),
            Reach::Tcp(address) => {
                let mut error = io::Error::new(io::ErrorKind::NotFound, "the name has no address");
                for address in address.to_socket_addrs()? {
                    match connect(&address, stop) {
                        Ok(port) => return Ok(port),
                        Err(refused) => error = refused,
                    }
                }
                Err(error)
            }
        }
    }
}

impl From<Plugged> for Target {
    fn from(Plugged { serial, control, bus }: Plugged) -> Self {
        Self { reach: Reach::Serial(control), serial: Some(serial), bus }
    }
}

/// Connects a non-blocking port of a server.
///
/// # Errors
/// The server is not there or does not answer in time, or the stop has come.
fn connect(address: &SocketAddr, stop: &Stop) -> io::Result<OwnedFd> {
    let family = if address.is_ipv4() { AddressFamily::INET } else { AddressFamily::INET6 };
    let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
    let port = socket_with(family, SocketType::STREAM, flags, None)?;
    match rustix::net::connect(&port, address) {
        Err(Errno::INPROGRESS) => {}
        done => done?,
    }
    stop.wait(&port, PollFlags::OUT, CONNECTED)?;
    socket_error(&port)??;
    // A port that is not connected yet has no address at its other end.
    rustix::net::getpeername(&port).map_err(|_| io::Error::from(io::ErrorKind::TimedOut))?;
    set_tcp_nodelay(&port, true)?;
    Ok(port)
}

/// Returns whether two addresses, `HOST:PORT`, lead to the same server.
fn is_same_address(one: &str, other: &str) -> bool {
    fn all(address: &str) -> Vec<SocketAddr> {
        let all = address.to_socket_addrs().into_iter().flatten();
        // A connection to no address in particular goes to this computer.
        let reached = |address: IpAddr| match address.to_canonical() {
            IpAddr::V4(own) if own.is_unspecified() => Ipv4Addr::LOCALHOST.into(),
            IpAddr::V6(own) if own.is_unspecified() => Ipv6Addr::LOCALHOST.into(),
            other => other,
        };
        all.map(|address| SocketAddr::new(reached(address.ip()), address.port())).collect()
    }
    let port = |address: &str| address.rsplit_once(':').map(|(_, port)| port.to_owned());
    one == other
        || port(one) == port(other) && {
            let others = all(other);
            all(one).iter().any(|address| others.contains(address))
        }
}

/// Returns whether two paths name the same device.
fn same(one: &Path, other: &Path) -> bool {
    one == other
        || fs::canonicalize(one).is_ok_and(|one| fs::canonicalize(other).is_ok_and(|other| one == other))
}

/// Boards that are plugged in, sorted by their serial numbers.
pub(super) fn plugged(ports: &Path) -> Vec<Plugged> {
    let mut boards: Vec<Plugged> = Vec::new();
    let entries = fs::read_dir(ports).into_iter().flatten().flatten();
    let mut found: Vec<(String, bool, PathBuf)> =
        entries.filter_map(|entry| usb_port(&entry.path())).collect();
    found.sort();
    for (serial, is_control, path) in &found {
        if *is_control {
            let bus = found.iter().find(|(other, is_control, _)| other == serial && !is_control);
            let bus = bus.map(|(.., path)| path.clone());
            boards.push(Plugged { serial: serial.clone(), control: path.clone(), bus });
        }
    }
    boards
}

/// Serial number of the board that a port belongs to, true if it is the control port, and the path of its device; `None`
/// for any other port.
fn usb_port(port: &Path) -> Option<(String, bool, PathBuf)> {
    let interface = fs::canonicalize(port.join("device")).ok()?;
    let text = |path: PathBuf| Some(fs::read_to_string(path).ok()?.trim().to_owned());
    let device = interface.parent()?;
    if text(device.join("idVendor"))? != VENDOR || text(device.join("idProduct"))? != PRODUCT {
        return None;
    }
    let is_control = match text(interface.join("interface"))?.as_str() {
        CONTROL => true,
        BUS => false,
        _ => return None,
    };
    Some((text(device.join("serial"))?, is_control, Path::new("/dev").join(port.file_name()?)))
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    /// A folder like `/sys/class/tty`, with boards of these serial numbers, two ports each.
    struct Sys(PathBuf);

    impl Sys {
        fn new(name: &str, boards: &[&str]) -> Self {
            let root = std::env::temp_dir().join(format!("drivetwin-sys-{}-{name}", std::process::id()));
            let sys = Self(root);
            fs::create_dir_all(sys.ports()).unwrap();
            // The first port of a PC has a device that is no USB.
            sys.port("ttyS0", "platform/serial8250", None);
            for (n, serial) in boards.iter().enumerate() {
                let device = format!("usb1/1-{n}");
                for (name, value) in [("idVendor", "1209\n"), ("idProduct", "0001\n"), ("serial", serial)] {
                    fs::create_dir_all(sys.0.join(&device)).unwrap();
                    fs::write(sys.0.join(&device).join(name), value).unwrap();
                }
                let port = |m: usize| format!("ttyACM{}", 2 * n + m);
                sys.port(&port(0), &format!("{device}/1-{n}:1.0"), Some("drivetwin bus\n"));
                sys.port(&port(1), &format!("{device}/1-{n}:1.2"), Some("drivetwin control\n"));
            }
            sys
        }

        fn ports(&self) -> PathBuf {
            self.0.join("tty")
        }

        fn port(&self, name: &str, device: &str, interface: Option<&str>) {
            let (device, port) = (self.0.join(device), self.ports().join(name));
            fs::create_dir_all(&device).unwrap();
            fs::create_dir_all(&port).unwrap();
            symlink(&device, port.join("device")).unwrap();
            if let Some(interface) = interface {
                fs::write(device.join("interface"), interface).unwrap();
            }
        }

        fn find(&self, place: &str) -> Result<Target, String> {
            Target::find_in(&self.ports(), &place.parse().unwrap())
        }
    }

    impl Drop for Sys {
        fn drop(&mut self) {
            let _ = fs::remove_dir_all(&self.0);
        }
    }

    #[test]
    fn the_only_board_is_found_with_both_ports() {
        let sys = Sys::new("one", &["E661"]);
        let board = Target::find_in(&sys.ports(), &BoardPlace::Only).unwrap();
        assert_eq!(board.to_string(), "/dev/ttyACM1 (usb:E661)");
        assert_eq!(board.bus.as_deref(), Some(Path::new("/dev/ttyACM0")));
        assert_eq!(sys.find("usb:E661").unwrap(), board);
        assert_eq!(sys.find("/dev/ttyACM1").unwrap(), board);
        assert_eq!(
            sys.find("/dev/ttyACM0").unwrap_err(),
            "/dev/ttyACM0 is the port of the drive's bus; the control port of this board is /dev/ttyACM1"
        );
        assert_eq!(sys.find("usb:E7").unwrap_err(), "usb:E7 is not plugged in; there is usb:E661");
        assert_eq!(sys.find("tcp:localhost:5000").unwrap().to_string(), "tcp:localhost:5000");
        // A port that the system does not know as that of a board is tried.
        assert_eq!(sys.find("/dev/ttyUSB7").unwrap().to_string(), "/dev/ttyUSB7");
    }

    #[test]
    fn the_same_server_has_several_addresses() {
        let sys = Sys::new("tcp", &[]);
        let is_same = |one: &str, other: &str| sys.find(one).unwrap().is_same(&sys.find(other).unwrap());
        for (one, other, expected) in [
            ("tcp:127.0.0.1:5000", "tcp:localhost:5000", true),
            ("tcp:localhost:5000", "tcp:127.0.0.1:5000", true),
            ("tcp:0.0.0.0:5000", "tcp:127.0.0.1:5000", true),
            ("tcp:[::ffff:127.0.0.1]:5000", "tcp:127.0.0.1:5000", true),
            ("tcp:127.0.0.1:5000", "tcp:localhost:5001", false),
            ("tcp:127.0.0.1:5000", "tcp:127.0.0.2:5000", false),
            ("tcp:127.0.0.1:5000", "/dev/ttyACM7", false),
        ] {
            assert_eq!(is_same(one, other), expected, "{one} {other}");
        }
    }

    #[test]
    fn of_several_boards_one_must_be_named() {
        let sys = Sys::new("two", &["E661", "E662"]);
        let several = Target::find_in(&sys.ports(), &BoardPlace::Only).unwrap_err();
        assert_eq!(several, "several boards are plugged in: usb:E661, usb:E662; name one of them");
        assert_eq!(sys.find("usb:E662").unwrap().to_string(), "/dev/ttyACM3 (usb:E662)");
        let none = Sys::new("none", &[]);
        assert!(
            Target::find_in(&none.ports(), &BoardPlace::Only)
                .unwrap_err()
                .starts_with("no board is plugged in")
        );
        assert!(none.find("usb:E661").unwrap_err().starts_with("no board is plugged in"));
    }
}
