//! Places of boards, as users write them, and the reasons why a board cannot do what a bench does.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use crate::config::listen::{Uri, is_host_and_port};

/// Place of a board.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub enum BoardPlace {
    /// The only board that is plugged in.
    #[default]
    Only,
    /// `usb:SERIAL`: the USB serial number.
    Usb(String),
    /// Path of the serial port for control.
    Port(PathBuf),
    /// `tcp:HOST:PORT`: the control port behind a server of serial ports, or of an emulator.
    Tcp(String),
}

impl FromStr for BoardPlace {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || "it takes the path of a serial port, usb:SERIAL or tcp:HOST:PORT".to_owned();
        match text.split_once(':') {
            Some(("usb", serial)) if !serial.is_empty() => Ok(Self::Usb(serial.into())),
            None if text == "usb" => Err("it needs the USB serial number of the board, usb:SERIAL".into()),
            Some(("tcp", address)) if is_host_and_port(address) => Ok(Self::Tcp(address.into())),
            Some(("serial", path)) if !path.is_empty() => Ok(Self::Port(path.into())),
            Some(("usb" | "tcp" | "serial", _)) => Err(wrong()),
            _ if text.is_empty() => Err(wrong()),
            _ => Ok(Self::Port(text.into())),
        }
    }
}

impl fmt::Display for BoardPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Only => f.write_str("usb"),
            Self::Usb(serial) => write!(f, "usb:{serial}"),
            Self::Port(path) => write!(f, "{}", path.display()),
            Self::Tcp(address) => write!(f, "tcp:{address}"),
        }
    }
}

/// Checks that an address is one at which masters can open the bus of a board.
///
/// # Errors
/// One sentence: it is one that only an emulated drive can have.
pub fn check_bus(bus: &Uri) -> Result<(), String> {
    match bus {
        Uri::Pty(_) | Uri::Stdio => Err(format!(
            "{bus} is not where the bus of a board can be; it takes serial:DEVICE, tcp:HOST:PORT or rfc2217:HOST:PORT"
        )),
        Uri::Serial(_) | Uri::Tcp(_) | Uri::Rfc2217(_) => Ok(()),
    }
}

/// Reasons why a board cannot do what a bench does.
pub mod reasons {
    /// Time.
    pub const NO_TIME: &str = "a board has no virtual time: its clock goes on by itself";
    /// Faults of lines.
    pub const NO_LINE_FAULTS: &str =
        "the line of a board is a real one, so drivetwin cannot put faults on it; use an emulated drive";
    /// Scenarios.
    pub const NO_SCENARIO: &str =
        "a scenario is played by a bench, and not on a board; switch pins, faults and power from the test";
    /// Programs of users.
    pub const NO_PROGRAM: &str = "a board does not tell which line of its program runs; GET /api/drives/NAME/memory has the saved memory with the program";
    /// Journals.
    pub const NO_JOURNAL: &str = "a board does not report the outcomes of messages; GET /api/trace has its characters, and ports of the drive its statistics";
    /// Motors, switches, wires, further drives.
    pub const NO_BENCH: &str =
        "a board is one drive, with real pins and a real motor; a bench of emulated drives has this";
    /// Streams on virtual time.
    pub const NO_STREAM: &str =
        "the port of a board is a real one; open the address that uri() returns, for instance with pyserial";
    /// Shared lines of a bench.
    pub const NO_BUS: &str = "the line of a board is a real one, which a master opens by itself";
    /// Motors of a bench.
    pub const NO_MOTOR: &str = "a board turns a real motor";
    /// Wires, encoders and switches of a bench (BENCH-24).
    pub const NO_WIRE: &str = "the pins of a board are real, and so are their wires: connect them with copper, or set them by the control API";
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_of_boards() {
        let place = |text: &str| text.parse::<BoardPlace>();
        assert_eq!(place("/dev/ttyACM1"), Ok(BoardPlace::Port("/dev/ttyACM1".into())));
        assert_eq!(place("serial:/dev/ttyACM1"), Ok(BoardPlace::Port("/dev/ttyACM1".into())));
        assert_eq!(place("usb:E661"), Ok(BoardPlace::Usb("E661".into())));
        assert_eq!(place("tcp:localhost:5000"), Ok(BoardPlace::Tcp("localhost:5000".into())));
        let no_serial = "it needs the USB serial number of the board, usb:SERIAL";
        assert_eq!(place("usb"), Err(no_serial.to_owned()));
        for wrong in ["", "usb:", "tcp:", "tcp:5000", "serial:"] {
            assert!(place(wrong).is_err(), "{wrong}");
        }
        for text in ["/dev/ttyACM1", "usb:E661", "tcp:localhost:5000"] {
            assert_eq!(place(text).unwrap().to_string(), text);
        }
    }
}
