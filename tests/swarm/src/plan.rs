//! A plan: a bench and the events on it, as data that can be printed and shrunk.

use std::fmt;

use drivetwin_firmware::device::{Duration, Encoder, Fault, Pin};
use drivetwin_sim::bench::{PinStimulus, PowerAction};
use drivetwin_sim::line::faults::LineFaults;

/// Name of a drive. The name of its motor is this name after `motor-`.
pub(crate) type Name = &'static str;

/// Names of drives.
pub(crate) const NAMES: [Name; 4] = ["a", "b", "c", "d"];

/// Complete input of a run.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct Plan {
    /// Seed of every random choice that the bench makes.
    pub(crate) seed: u64,
    /// True if characters take no time.
    pub(crate) fast: bool,
    /// Tables of a bench file. The shrinker may remove each of them.
    pub(crate) parts: Vec<String>,
    pub(crate) steps: Vec<Step>,
}

impl Plan {
    /// The bench file, which `drivetwin run` accepts, too.
    pub(crate) fn bench_file(&self) -> String {
        let line = if self.fast { "fast" } else { "timed" };
        format!("seed = {}\nline = \"{line}\"\n\n{}", self.seed, self.parts.join("\n"))
    }
}

/// A client at a port of a drive.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(crate) struct Who {
    pub(crate) drive: Name,
    pub(crate) port: u8,
    pub(crate) number: u8,
}

/// Faults of a line or TCP port.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct Faults {
    pub(crate) faults: LineFaults,
    /// True if all rules are for the drive of the step only.
    pub(crate) own: bool,
}

/// An event. An event whose drive or pin is not on the bench does nothing.
#[derive(Clone, PartialEq, Debug)]
pub(crate) enum Step {
    /// Time passes.
    Wait(Duration),
    /// A client sends arbitrary bytes and ignores the answers.
    Say(Who, Vec<u8>),
    Leave(Who),
    Hand(Name, Pin, PinStimulus),
    /// Pulses: number, and rate per second.
    Pulse(Name, Pin, u32, u32),
    /// Counts of an encoder: number, and rate per second.
    Turn(Name, Encoder, i32, u32),
    Cause(Name, Fault, bool),
    /// Presets a register, not through the bus. The row is the register's index in the register table.
    Preset(Name, usize, i64),
    Power(Name, PowerAction),
    /// A program opens the host's end of the drive's serial line (`true`), or closes it (`false`).
    Attach(Name, bool),
    /// Sets the faults of a port's line, or of a TCP port.
    Disturb(Name, u8, Box<Faults>),
    /// A well-behaved client writes, reads back, and requests registers that do not exist. The number is the
    /// seed of the requests, and of the pieces in which they are sent.
    Ask(Name, u64),
    /// A well-behaved client saves values and reads them back after a power failure. Power fails during the
    /// save or is switched off after it.
    Save(Name, u64, Failing),
    /// The emulator ends and starts again with the memories of all drives.
    Restart,
}

/// Moment at which power goes off in a step that saves values.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Failing {
    /// Power fails at some byte of the save.
    Amid,
    /// Power is switched off after the save.
    Later,
}

impl fmt::Display for Who {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "client {} of {}:{}", self.number, self.drive, self.port)
    }
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Wait(time) => write!(f, "wait {:.4} ms", time.ticks() as f64 / 16_000.0),
            Self::Say(who, bytes)
                if bytes.iter().all(|byte| byte.is_ascii_graphic() || b" \r\n".contains(byte)) =>
            {
                write!(f, "{who} says \"{}\"", bytes.escape_ascii())
            }
            Self::Say(who, bytes) => write!(f, "{who} says {bytes:02X?}"),
            Self::Leave(who) => write!(f, "{who} leaves"),
            Self::Hand(drive, pin, driving) => write!(f, "pin {} of {drive} is {driving:?}", pin.0),
            Self::Pulse(drive, pin, count, hz) => {
                write!(f, "{count} pulses at {hz} Hz on pin {} of {drive}", pin.0)
            }
            Self::Turn(drive, encoder, counts, hz) => {
                write!(f, "encoder {} of {drive} turns {counts} counts at {hz} Hz", encoder.0)
            }
            Self::Cause(drive, fault, on) => write!(f, "fault {} of {drive}: {on}", fault.0),
            Self::Preset(drive, row, value) => write!(f, "row {row} of {drive} is preset to {value}"),
            Self::Power(drive, action) => write!(f, "power of {drive}: {action:?}"),
            Self::Attach(drive, here) => write!(f, "the port of {drive} is open: {here}"),
            Self::Disturb(drive, port, faults) => write!(f, "the line of {drive}:{port}: {faults:?}"),
            Self::Ask(drive, seed) => write!(f, "{drive} is asked ({seed})"),
            Self::Save(drive, seed, failing) => write!(f, "{drive} saves ({seed}), power fails {failing:?}"),
            Self::Restart => f.write_str("all begin again with their memories"),
        }
    }
}

impl fmt::Display for Plan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}", self.bench_file())?;
        self.steps.iter().enumerate().try_for_each(|(n, step)| writeln!(f, "{:3}  {step}", n + 1))
    }
}
