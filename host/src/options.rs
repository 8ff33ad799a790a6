//! Options of a run as plain data.

use std::path::PathBuf;
use std::str::FromStr;

pub use drivetwin_sim::config::board_place::BoardPlace;
use drivetwin_sim::config::listen::{Listen, Uri, is_host_and_port};
use drivetwin_sim::config::preset::Number;
use drivetwin_sim::config::time_mode::TimeMode;
use drivetwin_sim::line::LineMode;

/// Options of a run, named like those of `drivetwin run`. `None` means the value of the bench file, or else
/// the default.
#[derive(Clone, Default, Debug)]
pub struct RunOptions {
    /// A kind of drive, or the path of a bench file, whose name ends in `.toml`.
    pub what: String,
    /// Listening addresses of a single drive's ports. A port without an address gets a free loopback TCP
    /// port, and a serial port also gets a pty.
    pub listen: Vec<Listen>,
    /// Listening address of the control API; default: none.
    pub control: Control,
    /// Additional host names that requests to the control API may use, besides localhost and its own address.
    pub allow_host: Vec<String>,
    /// Relation of bench time to the wall clock; default: real time.
    pub time: Option<TimeMode>,
    /// Timing of serial lines: characters take time or not.
    pub line: Option<LineMode>,
    /// Bus address of a single drive, as if saved before power-on.
    pub address: Option<Number>,
    /// File of a single drive's non-volatile memory.
    pub nv: Option<PathBuf>,
    /// Registers of a single drive that are preset.
    pub set: Vec<Assignment>,
    /// File with the text of a user program for a single RS drive.
    pub program: Option<PathBuf>,
    /// True to skip the start-up delay.
    pub fast_boot: bool,
    /// True to drop requests that are too early on all Modbus lines.
    pub strict: bool,
    /// Seed of every random choice; default: 1.
    pub seed: Option<u64>,
    /// File for a recording (trace), which can be replayed.
    pub record: Option<PathBuf>,
    /// File for the waveforms of the pins (VCD).
    pub vcd: Option<PathBuf>,
    /// File for the frames of the lines (pcapng).
    pub pcap: Option<PathBuf>,
    /// True if the bench keeps its recording also without a control API, for a [`Lender`](crate::Lender).
    pub recorded: bool,
}

/// Options of an attached board, named like those of `drivetwin attach`.
#[derive(Clone, Default, Debug)]
pub struct AttachOptions {
    /// Place of the board's control port.
    pub place: BoardPlace,
    /// Address of the drive's bus, for users: of a board at a USB cable it is known without.
    pub bus: Option<Uri>,
    /// Listening address of the control API; default: none.
    pub control: Control,
    /// Additional host names that requests to the control API may use, besides localhost and its own address.
    pub allow_host: Vec<String>,
    /// File for a recording (trace).
    pub record: Option<PathBuf>,
    /// File for the waveforms of the pins (VCD).
    pub vcd: Option<PathBuf>,
    /// File for the frames of the lines (pcapng).
    pub pcap: Option<PathBuf>,
    /// True if the recording is kept also without a control API, for a [`Lender`](crate::Lender).
    pub recorded: bool,
}

/// Listening address of the control API, as users write it.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub enum Control {
    /// No control API.
    #[default]
    Off,
    /// `HOST:PORT`.
    At(String),
}

impl FromStr for Control {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "off" => Ok(Self::Off),
            _ if is_host_and_port(text) => Ok(Self::At(text.into())),
            _ => Err("it takes HOST:PORT, like 127.0.0.1:8080 (port 0: any free one), or off".into()),
        }
    }
}

/// A register and its value: `Speed=8000`, `PartNumber=MDI3CRL23A7`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Assignment {
    /// Name of the register, as in the manual.
    pub register: String,
    /// Value as text: a number, `0x` and hexadecimal digits, words, or text.
    pub value: String,
}

impl FromStr for Assignment {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (register, value) = text.split_once('=').ok_or("it takes REG=VALUE, like Speed=8000")?;
        Ok(Self { register: register.trim().into(), value: value.trim().into() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn assignments() {
        let set = |text: &str| text.parse::<Assignment>();
        let value = |value: &str| Ok(Assignment { register: "Speed".into(), value: value.into() });
        assert_eq!(set("Speed=-5"), value("-5"));
        assert_eq!(set("Speed = 0x10"), value("0x10"));
        assert_eq!(set("Speed=a=b"), value("a=b"));
        assert!(set("Speed").is_err());
    }
}
