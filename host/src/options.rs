//! Options of a run as plain data.

use std::path::PathBuf;
use std::str::FromStr;

use drivetwin_sim::config::listen::{Listen, is_host_and_port};
use drivetwin_sim::config::preset::Number;
use drivetwin_sim::config::time_mode::TimeMode;
use drivetwin_sim::line::LineMode;

/// Options of a run: those of `drivetwin run`, by the same names. `None` leaves it to the bench file or the default.
#[derive(Clone, Default, Debug)]
pub struct RunOptions {
    /// A kind of drive, or the path of a bench file, whose name ends in `.toml`.
    pub what: String,
    /// Listening places of a single drive's ports. A port that is not among them gets a free loopback TCP port, and a
    /// serial one a pty, too.
    pub listen: Vec<Listen>,
    /// Address of the control API.
    pub control: Control,
    /// Host names by which the control API may be asked, beside localhost and its own address.
    pub allow_host: Vec<String>,
    /// Time mode.
    pub time: Option<TimeMode>,
    /// Time that characters take on the line.
    pub line: Option<LineMode>,
    /// The bus address of a single drive, as if saved before power-on.
    pub address: Option<Number>,
    /// The file of a single drive's non-volatile memory.
    pub nv: Option<PathBuf>,
    /// Registers of a single drive that are preset.
    pub set: Vec<Assignment>,
    /// A user program for a single drive, as text.
    pub program: Option<PathBuf>,
    /// No start-up delay.
    pub fast_boot: bool,
    /// Seed of every random choice.
    pub seed: Option<u64>,
    /// The file of a recording, which can be replayed.
    pub record: Option<PathBuf>,
    /// The file of the waveforms of the pins (VCD).
    pub vcd: Option<PathBuf>,
    /// The file of the frames of the lines (pcapng).
    pub pcap: Option<PathBuf>,
}

/// Address of the control API.
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
    /// The register's name.
    pub register: String,
    /// The value as text.
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
