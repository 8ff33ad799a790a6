//! Requests of the computer, and the board's answers.
//!
//! Registers, pins, faults and encoders are numbers: their places in the tables of the drive's
//! [`Spec`]. The computer knows the tables by the kind of the drive; [`Hello`] shows whether they are the same ones.
//! Times and spans are ticks of 1/16 µs.

use drivetwin_firmware::device::Spec;
use drivetwin_protocol::modbus::rtu;
use serde::{Deserialize, Deserializer, Serialize};

use crate::events::{Level, Line};

/// A request of the computer.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct Request<'a> {
    /// Number that the reply will have.
    pub number: u16,
    /// Call of the request.
    #[serde(borrow)]
    pub call: Call<'a>,
}

/// A call: the action or the answer that the computer wants.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub enum Call<'a> {
    /// Tells what board this is: [`Answer::Hello`]. The call and its answer are the same in all versions.
    Hello,
    /// Power, pins, faults and motion at this instant: [`Answer::State`].
    State,
    /// Value of a register at this instant, without side effects of a read: [`Answer::Value`].
    Read {
        /// Row of the register.
        row: u16,
    },
    /// Values of registers from `row` on, as many as fit: [`Answer::Values`].
    ReadMany {
        /// First row.
        row: u16,
    },
    /// Words of a register of more than four words: [`Answer::Words`].
    ReadWords {
        /// Row of the register.
        row: u16,
        /// First word, in bus order.
        word: u16,
    },
    /// Presets a register past the bus. While the drive has no power, a saved register gets the value as if it had been
    /// written and saved.
    Preset {
        /// Row of the register.
        row: u16,
        /// New value.
        value: i64,
    },
    /// Drives an input pin instead of its wire.
    Drive {
        /// Pin.
        pin: u8,
        /// Level.
        stimulus: Stimulus,
    },
    /// Sends a train of pulses into an input pin.
    Pulse {
        /// Pin.
        pin: u8,
        /// Number of pulses, at least one.
        count: u32,
        /// From one pulse to the next.
        period: u64,
        /// Length of a pulse, less than `period`.
        high: u64,
    },
    /// Turns an encoder.
    Turn {
        /// Encoder.
        encoder: u8,
        /// Number of edges; negative for the other direction.
        counts: i32,
        /// From one edge to the next.
        period: u64,
    },
    /// Sets or clears the cause of a fault.
    Fault {
        /// Fault.
        fault: u8,
        /// True if the cause is present.
        on: bool,
    },
    /// Switches the power of the drive. The board itself stays on.
    Power(Power),
    /// Statistics: [`Answer::Statistics`].
    Statistics,
    /// A piece of the saved memory, from `offset` on: [`Answer::Memory`].
    ReadMemory {
        /// Offset of the first byte.
        offset: u16,
    },
    /// Writes a piece of the saved memory. The drive must have no power; it reads its memory at the next power-on.
    WriteMemory {
        /// Offset of the first byte.
        offset: u16,
        /// New bytes, at most [`PIECE`].
        bytes: &'a [u8],
    },
    /// Begins to send events, or ends it.
    Trace(bool),
    /// Name of a kind of drive that the board can be, by its number from 0 on: [`Answer::Kind`].
    Kind(u8),
    /// Makes the board a drive of this kind, now and after its own power-on. A drive of another kind stops, as if its power
    /// failed, and the board starts again 50 ms after its reply. Until then it answers nothing more; then the connection
    /// breaks. A drive of this kind goes on.
    Become(&'a str),
    /// Starts the boot loader, which takes a new image. The drive stops and the board ends as after [`Call::Become`].
    Bootloader,
}

/// Level at an input pin.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub enum Stimulus {
    /// Pulled low.
    Low,
    /// Driven high.
    High,
    /// Not driven, whatever is wired to the pin.
    Open,
    /// A voltage in mV, at an analogue input.
    Millivolts(i32),
    /// Driven again by the wire at the pin.
    Wire,
}

/// Action on the power of the drive.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub enum Power {
    /// Off.
    Off,
    /// On.
    On,
    /// Off, and on again.
    Cycle,
    /// Fails in the middle of the next save, and stays off.
    Cut,
    /// Does not fail in the next save: takes back [`Cut`](Self::Cut).
    Keep,
}

/// Reply to the request with the same number.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct Reply<'a> {
    /// Number of the request.
    pub number: u16,
    /// The answer, or why there is none.
    #[serde(borrow)]
    pub answer: Result<Answer<'a>, Refused>,
}

/// Answer to a call.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub enum Answer<'a> {
    /// The call has had its effect.
    Done,
    /// To [`Call::Hello`].
    #[serde(borrow)]
    Hello(Hello<'a>),
    /// To [`Call::State`].
    State(State),
    /// To [`Call::Read`].
    Value(i64),
    /// To [`Call::ReadMany`]: values of successive rows, each as postcard. Decode them with [`postcard::take_from_bytes`].
    Values {
        /// First row.
        row: u16,
        /// Number of values; 0 behind the last row.
        count: u8,
        /// The values.
        bytes: &'a [u8],
    },
    /// To [`Call::ReadWords`]: two bytes for each word, the higher one first.
    Words(&'a [u8]),
    /// To [`Call::Statistics`].
    Statistics(Statistics),
    /// To [`Call::ReadMemory`]; empty behind the last byte.
    Memory(&'a [u8]),
    /// To [`Call::Kind`]; `None` behind the last one.
    Kind(Option<&'a str>),
}

/// Greatest number of bytes in one piece of memory, words or values.
pub const PIECE: usize = 192;

/// Reason why a board does not do what a call says.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub enum Refused {
    /// The drive has no such register, pin, fault, encoder or kind, or the memory has no such byte.
    Unknown,
    /// The register cannot be preset.
    ReadOnly,
    /// The register or the pin does not take the value.
    OutOfRange,
    /// The saved values cannot be changed, because the memory is corrupt.
    BadMemory,
    /// The drive cannot change the register now, because of what it is doing.
    Busy,
    /// A pulse train or an encoder drives the pin already.
    Driven,
    /// The drive has no power.
    NoPower,
    /// The drive must have no power for this.
    HasPower,
    /// The pulses are faster than the board makes them.
    TooFast,
    /// The board cannot do this.
    NotHere,
    /// The flash does not take the data.
    Flash,
}

/// Description of a board.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct Hello<'a> {
    /// [`VERSION`](crate::VERSION) of the board.
    pub version: u16,
    /// Kind of the drive.
    pub kind: &'a str,
    /// Version of the board's image, as of its crate.
    pub image: &'a str,
    /// [`fingerprint`] of the tables of the drive.
    pub tables: u16,
    /// True if the drive starts without its start-up delay.
    pub fast_boot: bool,
    /// Name of the board, as `drivetwin flash` has it; empty if an older image does not say it.
    #[serde(borrow, deserialize_with = "text_if_any")]
    pub board: &'a str,
}

/// The text at the end of a message, which older boards do not send.
fn text_if_any<'de, D: Deserializer<'de>>(from: D) -> Result<&'de str, D::Error> {
    Ok(Deserialize::deserialize(from).unwrap_or_default())
}

/// Power, pins, faults and motion.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct State {
    /// Time since the board started.
    pub at: u64,
    /// True if the drive has power.
    pub powered: bool,
    /// One bit for each pin: high.
    pub high: u64,
    /// One bit for each pin: nothing drives it.
    pub open: u64,
    /// One bit for each pin: a [stimulus](Call::Drive) drives it.
    pub driven: u64,
    /// One bit for each fault: its cause is present.
    pub faults: u32,
    /// Motion of the first axis.
    pub motion: Option<Motion>,
}

/// Motion of an axis.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct Motion {
    /// Position in steps or counts.
    pub position: i32,
    /// Speed in 1/65536 of a step or count per second, signed.
    pub speed: i64,
    /// True if a plan is not finished, or the shaft turns.
    pub moving: bool,
    /// Current in mA.
    pub ma: i32,
    /// Duty in 1/65536, signed.
    pub duty: i32,
    /// Pulses made at STEP since the board started, of both directions.
    pub pulses: u32,
}

/// Statistics since the board started.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
pub struct Statistics {
    /// Settings of the line of the first port.
    pub line: Line,
    /// Requests that were executed.
    pub requests: u32,
    /// Requests that were refused.
    pub refused: u32,
    /// Frames with a wrong checksum.
    pub crc: u32,
    /// Frames with a gap inside.
    pub gap: u32,
    /// Frames of a wrong length.
    pub length: u32,
    /// Frames with a parity or framing error.
    pub spoiled: u32,
    /// Frames for another address.
    pub foreign: u32,
    /// Frames that arrived while the drive was starting.
    pub starting: u32,
    /// Inputs that were lost because too many waited.
    pub lost_inputs: u32,
    /// Events that were not sent because too many waited.
    pub lost_events: u32,
    /// Characters of the drive that the computer did not read in time.
    pub lost_characters: u32,
    /// Failures of pins, ports and the memory.
    pub failures: u32,
    /// Steps that were made in addition to those planned.
    pub slipped: i32,
}

/// A number for the tables of a kind of drive: it differs if a row, a pin or a fault has been added, moved or renamed.
#[must_use]
pub fn fingerprint(spec: &Spec) -> u16 {
    let names = spec.pin_names().map(|(name, _)| name).chain(spec.faults.iter().copied());
    names.fold(spec.memory ^ spec.registers.names, |sum, name| sum.rotate_left(1) ^ rtu::crc(name.as_bytes()))
}

/// Levels of pins as bits.
impl State {
    /// Level of a pin.
    #[must_use]
    pub fn level(&self, pin: u8) -> Level {
        let is_in = |bits: u64| bits >> (pin & 63) & 1 == 1;
        match (is_in(self.open), is_in(self.high)) {
            (true, _) => Level::Open,
            (false, true) => Level::High,
            (false, false) => Level::Low,
        }
    }
}
