//! Inputs and outputs of a drive on a board.

use serde::{Deserialize, Serialize};

/// Events in one message.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct Events<'a> {
    /// Number of the first event, counted from the beginning of the trace; it wraps. A number that does not follow the last
    /// one means that messages were lost on their way.
    pub number: u32,
    /// Time in ticks from which the first event counts its own.
    pub at: u64,
    /// The events, each as postcard: the ticks since the event before, signed, and the [`Event`]. An output may be earlier
    /// than the event before it: a reply is recorded when the drive gives it, with the time at which it begins.
    pub bytes: &'a [u8],
}

impl<'a> Events<'a> {
    /// The events with their times in ticks. Ends early at an event that cannot be decoded.
    pub fn decode(self) -> Decoded<'a> {
        Decoded { at: self.at, bytes: self.bytes }
    }
}

/// Iterator over [`Events`].
#[derive(Clone, Debug)]
pub struct Decoded<'a> {
    at: u64,
    bytes: &'a [u8],
}

impl<'a> Iterator for Decoded<'a> {
    type Item = (u64, Event<'a>);

    fn next(&mut self) -> Option<Self::Item> {
        let ((ticks, event), rest) = postcard::take_from_bytes::<(i64, Event<'a>)>(self.bytes).ok()?;
        self.at = self.at.wrapping_add_signed(ticks);
        self.bytes = rest;
        Some((self.at, event))
    }
}

/// An input or output of the drive, or a change of its power.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub enum Event<'a> {
    /// Events were left out here, because too many waited.
    Lost(u32),
    /// The drive has power, or none.
    Power(bool),
    /// The power failed in the middle of the last [`Store`](Self::Store), of which this number of bytes was written.
    Cut(u16),
    /// The port received a character.
    Received(u8, u8),
    /// The port received a character with an error.
    RxError(u8),
    /// The line of the port was idle.
    Idle(u8),
    /// The computer opened or closed the port.
    Present(u8, bool),
    /// An input pin became high or low.
    Edge(u8, bool),
    /// An input pin is no longer driven.
    Open(u8),
    /// An input pin has a voltage in mV.
    Millivolts(u8, i32),
    /// An encoder counted, and its channels A and B have these levels now.
    Count(u8, i32, bool, bool),
    /// The cause of a fault appeared or disappeared.
    Fault(u8, bool),
    /// A register was preset.
    Preset(u16, i64),
    /// Steps slipped on an axis.
    Slipped(u8, i32),
    /// The drive sends characters from now on, back to back.
    Sent(u8, &'a [u8]),
    /// The line of a port has other settings.
    Line(u8, Line),
    /// The drive drives a pin, or no longer.
    Level(u8, Level),
    /// The drive drives a pin with a wave: from now on high for `high` ticks of each `period`.
    Wave {
        /// Pin.
        pin: u8,
        /// Period in ticks.
        period: u64,
        /// Ticks for which the pin is high.
        high: u64,
    },
    /// An axis follows a plan.
    Plan(u8, Course),
    /// An axis makes steps without a plan.
    Step(u8, i32),
    /// The current limit of an axis, in mA.
    CurrentLimit(u8, u32),
    /// The duty of an axis, in 1/65536.
    Duty(u8, i32),
    /// The drive saves bytes from an offset on.
    Store(u16, &'a [u8]),
}

/// Level of a pin.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub enum Level {
    /// Low.
    Low,
    /// High.
    High,
    /// Not driven.
    Open,
}

/// Settings of a serial line.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
pub struct Line {
    /// Baud rate.
    pub baud: u32,
    /// Data bits.
    pub data: u8,
    /// Parity: 0 none, 1 odd, 2 even, as in the line coding of a USB serial port.
    pub parity: u8,
    /// Stop bits.
    pub stop: u8,
}

/// A plan of motion.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct Course {
    /// Start, in ticks.
    pub start: u64,
    /// Up to three stretches; a stretch that is not in use is `None`.
    pub stretches: [Option<Stretch>; 3],
}

/// A part of a plan with constant acceleration: a
/// [`Segment`](drivetwin_firmware::motion::Segment) of the firmware.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct Stretch {
    /// Length in ticks; `u64::MAX` for one without end.
    pub ticks: u64,
    /// Acceleration in steps/s².
    pub acceleration: i32,
    /// Speed at the first tick, in steps/s times ticks/s.
    pub start_speed: i64,
    /// Position at the first tick.
    pub base: i32,
    /// Phase beyond `base` at the first tick.
    pub phase_offset: i64,
    /// True if steps count down.
    pub reverse: bool,
}
