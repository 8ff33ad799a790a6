//! A recording of a bench, as text that people read and write.
//!
//! ```text
//! drivetwin trace 1                     the format, before anything else
//! seed 1                              of every random choice; 1 if not given
//! drive md3 md3                       name and kind; `fast`: no start-up delay; `from 12.5`: seated then;
//!                                     `apart`: without the motor that it brings; `untimed`: on a line on which
//!                                     characters take no time
//! memory md3 0x0000 01 00 9A          what its memory held; 0xFF where nothing is said
//! compare tx pins                     which outputs count: tx line pins motion stores; all if not given
//!
//! # A comment, here or behind a line.
//! 2500.000000 > rx 01 03 00 00 00 01 84 0A
//! 2513.176875 < tx 01 03 02 00 01 79 84
//! 2600.000000 end
//! ```
//!
//! A stamp is in milliseconds of the bench's time; it means the nearest tick of 62.5 ns. With several
//! drives the name of one follows it. `>` is fed to the drive, `<` is what it did and is compared;
//! `end` is how far time went, and a drive may have put something for later by then; without `end` time went to the
//! last stamp, and what else came at that one is not compared. A drive has power when it is seated. Of the ports of a
//! drive the first is meant unless the word says `rx:mcode`.
//!
//! Words may be added within a version of the format: who does not know one says so, in which line. A version
//! ends when what there is comes to mean something else.
//!
//! | fed | |
//! |---|---|
//! | `rx 01 03` `rx "W15\r"` | characters, back to back; the stamp is the end of the first |
//! | `spoiled` `idle` | a character nobody could read; the line says that the frame is over |
//! | `attached on` | somebody opens the port, or leaves (`off`) |
//! | `opened 0` `message 0 01 03` `closed 0` | somebody opens TCP connection 0, a message on it, it is closed |
//! | `pin J2.2 low` `millivolts ANALOG 2500` | an input changes |
//! | `pin DIR open` | nobody drives it any more, and it is not wired; only of a pin that is open at rest |
//! | `count 0 -4 high low` | encoder, quarter cycles, A, B |
//! | `slipped motor 1` | steps made too many |
//! | `draws motor 130` | mA that its motor draws |
//! | `motor motor 24000 3000 500 400 10000 0 4 2 0` | its motor is this one: supply in mV, speed without load in rpm, winding in mΩ, inertia in g·cm², friction and load in µN·m, pulses of a Hall sensor, Hall sensors, cycles of an encoder |
//! | `rotation motor 0 75000 0` | how its motor turns from now on: angle in 2⁻³² turns, speed in 2⁻⁵⁶ turns a tick, acceleration in 2⁻⁶⁴ turns a tick² |
//! | `fault stall on` | the cause of a fault comes or goes |
//! | `poke Speed 8000` | a register is preset past the bus |
//! | `power off` `power on` | `power cut`: fails in the next save; `power cut 1 0`: one store goes through, of the next 0 bytes do |
//!
//! | done | |
//! |---|---|
//! | `tx 01 03` `message 0 01` `close 0` | the stamp is the instant from which characters leave |
//! | `line 19200 8E1` | the line from the next character on |
//! | `pin J3.7 low` | or `high`, `float` |
//! | `wave D6 500.000000 of 1500.000000` | high for that long at the beginning of each period |
//! | `plan motor 0 500.000000@5000 500.000000@0 2500` | from a position, for so many ms (or `ever@`) to a speed in steps/s, …, to a position |
//! | `step motor 1` `current motor 1500` `duty motor -32768` | steps, mA, 1/65536 |
//! | `store 0x0010 01 02` | into the memory |
//! | `power off` | the cut has come, in the store before |

mod copy;
mod recording;
mod ring;
mod text;

use std::borrow::Cow;
use std::collections::VecDeque;

use drivetwin_firmware::device::{
    Axis, Device, Encoder, Fault, Input, Instant, Level, Line, Link, Output, Pin, Plan, Port, Rotation, Spec,
};
use drivetwin_firmware::motor::Parameters;
use drivetwin_protocol::time::Duration;

pub use recording::Recording;
pub(crate) use ring::{allocated, make_room};
pub use text::{ParseError, whole_lines};
pub(crate) use text::{is_name, without_comment};

/// Makes a device of a kind; `None` if there is no such kind.
pub type Make<'a> = dyn Fn(&str) -> Option<Box<dyn Device>> + 'a;

/// Retention of a trace.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Retention {
    /// No events.
    Off,
    /// The last so many bytes, in memory.
    Ring(usize),
    /// The same, and whatever has not been [written](crate::bench::Bench::has_written) yet.
    Written(usize),
    /// Everything.
    All,
}

impl Retention {
    /// Bytes of the ring that is kept by default: 64 MiB (HOST-20).
    pub const RING: usize = 64 << 20;
}

/// The default: [`Retention::RING`].
impl Default for Retention {
    fn default() -> Self {
        Self::Ring(Self::RING)
    }
}

/// A recording, or a scenario.
#[derive(Clone, Debug)]
pub struct Trace {
    /// Seed of every random choice.
    pub seed: u64,
    /// Drives on the bench.
    pub drives: Vec<TraceDrive>,
    /// Which outputs count when it is replayed.
    pub compare: Vec<Group>,
    /// Events that a full ring has dropped; a trace without its beginning cannot be replayed.
    pub lost: u64,
    /// Time at the end; of a text without `end` its last stamp.
    pub end: Instant,
    /// True if it tells all until then. A text without `end` may break off within its last stamp.
    pub ended: bool,
    /// Number of events written, of those that wait for it.
    written: u64,
    events: VecDeque<Entry>,
    keep: Retention,
    /// Bytes that `events` holds on to.
    bytes: usize,
}

/// A drive that takes part.
#[derive(Clone, Debug)]
pub struct TraceDrive {
    /// Name of the drive.
    pub name: String,
    /// Description of its kind.
    pub spec: &'static Spec,
    /// True without start-up delay.
    pub boot_fast: bool,
    /// Characters take no time on its serial lines.
    pub fast_line: bool,
    /// True if its motor is one of the bench, and not its own.
    pub apart: bool,
    /// Time at which it was added and powered on.
    pub from: Instant,
    /// Content of its memory then, [`Spec::memory`] bytes.
    pub memory: Vec<u8>,
}

/// A line of a trace.
#[derive(Clone, PartialEq, Debug)]
pub struct Entry {
    /// Time of the event.
    pub at: Instant,
    /// Drive: place in [`Trace::drives`].
    pub drive: usize,
    /// The event.
    pub event: Event,
    /// The line it was read from, from 1; 0 if it was recorded.
    pub line: usize,
}

/// An event: an input or an output of a drive.
#[derive(Clone, PartialEq, Debug)]
pub enum Event {
    /// Fed to a drive.
    Input(InputRecord),
    /// Done by a drive.
    Output(OutputRecord),
}

/// An input of a drive: an [`Input`] that owns its bytes, a change of power, or a preset.
#[derive(Clone, PartialEq, Eq, Debug)]
#[expect(missing_docs, reason = "the fields are those of `Input`")]
pub enum InputRecord {
    /// Change of power.
    Power(Power),
    /// [`Input::Fault`]
    Fault { fault: Fault, on: bool },
    /// [`Input::Edge`]
    Edge { pin: Pin, high: bool },
    /// [`Input::Open`]
    Open { pin: Pin },
    /// [`Input::Millivolts`]
    Millivolts { pin: Pin, mv: i32 },
    /// [`Input::Count`]
    Count { encoder: Encoder, steps: i32, a: bool, b: bool },
    /// [`Input::StepsCorrection`]
    StepsCorrection { axis: Axis, steps: i32 },
    /// [`Input::MotorCurrent`]
    MotorCurrent { axis: Axis, ma: i32 },
    /// [`Input::Motor`]
    Motor { axis: Axis, parameters: Box<Parameters> },
    /// [`Input::Rotation`]
    Rotation { axis: Axis, rotation: Rotation },
    /// [`Input::Bytes`]; on a port where each character has its time, of several those after the
    /// first follow back to back.
    Bytes { port: Port, bytes: Vec<u8> },
    /// [`Input::RxError`]
    RxError { port: Port },
    /// [`Input::Idle`]
    Idle { port: Port },
    /// [`Input::HostPresence`]
    HostPresence { port: Port, here: bool },
    /// [`Input::Opened`]
    Opened { port: Port, link: Link },
    /// [`Input::Message`]
    Message { port: Port, link: Link, bytes: Vec<u8> },
    /// [`Input::Closed`]
    Closed { port: Port, link: Link },
    /// [`Device::poke`]: after all else at its instant.
    Poke { row: usize, value: i64 },
}

impl InputRecord {
    /// The input as the drive gets it; `None` for power and presets.
    #[must_use]
    pub fn input(&self) -> Option<Input<'_>> {
        Some(match *self {
            Self::Power(_) | Self::Poke { .. } => return None,
            Self::Fault { fault, on } => Input::Fault { fault, on },
            Self::Edge { pin, high } => Input::Edge { pin, high },
            Self::Open { pin } => Input::Open { pin },
            Self::Millivolts { pin, mv } => Input::Millivolts { pin, mv },
            Self::Count { encoder, steps, a, b } => Input::Count { encoder, steps, a, b },
            Self::StepsCorrection { axis, steps } => Input::StepsCorrection { axis, steps },
            Self::MotorCurrent { axis, ma } => Input::MotorCurrent { axis, ma },
            Self::Motor { axis, ref parameters } => Input::Motor { axis, parameters },
            Self::Rotation { axis, rotation } => Input::Rotation { axis, rotation },
            Self::Bytes { port, ref bytes } => Input::Bytes { port, bytes },
            Self::RxError { port } => Input::RxError { port },
            Self::Idle { port } => Input::Idle { port },
            Self::HostPresence { port, here } => Input::HostPresence { port, here },
            Self::Opened { port, link } => Input::Opened { port, link },
            Self::Message { port, link, ref bytes } => Input::Message { port, link, bytes },
            Self::Closed { port, link } => Input::Closed { port, link },
        })
    }
}

/// Change of a drive's power.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Power {
    /// Power comes.
    On,
    /// Power goes.
    Off,
    /// Power fails in the next save; `None` leaves the place to the seed.
    Cut(Option<Cut>),
}

/// Place in a save at which power fails (HOST-9).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Cut {
    /// So many stores go through.
    pub stores: u32,
    /// Bytes of the next store that go through.
    pub bytes: usize,
}

/// An output of a drive: an [`Output`] that owns its data.
#[derive(Clone, PartialEq, Debug)]
#[expect(missing_docs, reason = "the fields are those of `Output`")]
pub enum OutputRecord {
    /// [`Output::Bytes`]
    Bytes { port: Port, bytes: Vec<u8> },
    /// [`Output::Message`]
    Message { port: Port, link: Link, bytes: Vec<u8> },
    /// [`Output::Close`]
    Close { port: Port, link: Link },
    /// [`Output::Line`]
    Line { port: Port, line: Line },
    /// [`Output::Level`]
    Level { pin: Pin, level: Level },
    /// [`Output::Wave`]
    Wave { pin: Pin, period: Duration, high: Duration },
    /// [`Output::Plan`], as it was recorded.
    Plan { axis: Axis, plan: Box<Plan> },
    /// [`Output::Plan`], as a text tells it.
    Course { axis: Axis, course: Box<Course> },
    /// [`Output::Step`]
    Step { axis: Axis, steps: i32 },
    /// [`Output::CurrentLimit`]
    CurrentLimit { axis: Axis, ma: u32 },
    /// [`Output::Duty`]: 1/65536 of full on, signed.
    Duty { axis: Axis, duty: i32 },
    /// [`Output::Store`]
    Store { offset: u16, bytes: Vec<u8> },
    /// Power fails in that store: a [cut](Power::Cut) has come.
    PowerOff,
}

impl OutputRecord {
    /// The record of `output`; `None` for a note, and for reports of a motor to its drive.
    #[must_use]
    pub fn of(output: Output<'_>) -> Option<Self> {
        Some(match output {
            Output::Bytes { port, bytes } => Self::Bytes { port, bytes: bytes.to_vec() },
            Output::Message { port, link, bytes } => Self::Message { port, link, bytes: bytes.to_vec() },
            Output::Close { port, link } => Self::Close { port, link },
            Output::Line { port, line } => Self::Line { port, line },
            Output::Level { pin, level } => Self::Level { pin, level },
            Output::Wave { pin, period, high } => Self::Wave { pin, period, high },
            Output::Plan { axis, plan } => Self::Plan { axis, plan: Box::new(*plan) },
            Output::Step { axis, steps } => Self::Step { axis, steps },
            Output::CurrentLimit { axis, ma } => Self::CurrentLimit { axis, ma },
            Output::Duty { axis, duty } => Self::Duty { axis, duty },
            Output::Store { offset, bytes } => Self::Store { offset, bytes: bytes.to_vec() },
            Output::Log(_) | Output::MotorCurrent { .. } | Output::Motor { .. } | Output::Rotation { .. } => {
                return None;
            }
        })
    }

    /// The record as a text has it at that stamp: of a plan its course. Traces are compared in this form.
    #[must_use]
    pub fn told(&self, at: Instant) -> Cow<'_, Self> {
        match self {
            Self::Plan { axis, plan } => {
                Cow::Owned(Self::Course { axis: *axis, course: Box::new(Course::of(plan, at)) })
            }
            other => Cow::Borrowed(other),
        }
    }

    /// Group of the record.
    #[must_use]
    pub fn group(&self) -> Group {
        match self {
            Self::Bytes { .. } | Self::Message { .. } | Self::Close { .. } => Group::Tx,
            Self::Line { .. } => Group::Line,
            Self::Level { .. } | Self::Wave { .. } => Group::Pins,
            Self::Plan { .. }
            | Self::Course { .. }
            | Self::Step { .. }
            | Self::CurrentLimit { .. }
            | Self::Duty { .. } => Group::Motion,
            Self::Store { .. } | Self::PowerOff => Group::Stores,
        }
    }
}

/// Outputs that are compared, or not, together.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Group {
    /// Characters and messages that are sent.
    Tx,
    /// Changes of the line's settings.
    Line,
    /// Levels and waves.
    Pins,
    /// Plans, steps, currents and duties.
    Motion,
    /// Stores to the memory, and power cuts.
    Stores,
}

impl Group {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Tx, Self::Line, Self::Pins, Self::Motion, Self::Stores];

    /// As a trace names it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Tx => "tx",
            Self::Line => "line",
            Self::Pins => "pins",
            Self::Motion => "motion",
            Self::Stores => "stores",
        }
    }
}

/// A plan as a trace tells it.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Course {
    /// The position at its beginning.
    pub from: i32,
    /// Stretches of the course.
    pub legs: Vec<Leg>,
    /// Final position; `None` if there is none.
    pub to: Option<i32>,
}

/// A stretch of constant acceleration.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Leg {
    /// Time of the stretch; [`Duration::FOREVER`] without end.
    pub time: Duration,
    /// The speed at its end, in thousandths of a step per second, signed.
    pub speed: i64,
}

impl Course {
    /// Course of a plan from `at` on.
    #[must_use]
    pub fn of(plan: &Plan, at: Instant) -> Self {
        let from = plan.position_at(at);
        let waits = plan.start().since(at);
        let mut legs = Vec::new();
        if waits > Duration::ZERO {
            legs.push(Leg { time: waits, speed: 0 });
        }
        let mut at = at.max(plan.start());
        for segment in plan.continued_from(at, from).segments().iter().filter(|segment| segment.ticks > 0) {
            let time = Duration::from_ticks(segment.ticks);
            at += time;
            let bits = i128::from(plan.speed_at(at).to_bits()) * 1_000;
            // To the nearest thousandth.
            let speed = i64::try_from((bits + (1 << 15)) >> 16).unwrap_or(i64::MAX);
            legs.push(Leg { time, speed });
        }
        let to = (at < Instant::NEVER).then(|| plan.position_at(at));
        Self { from, legs, to }
    }
}

impl Entry {
    /// Bytes of memory that it takes.
    fn size(&self) -> usize {
        let owned = match &self.event {
            Event::Input(InputRecord::Bytes { bytes, .. } | InputRecord::Message { bytes, .. }) => {
                allocated(bytes.len())
            }
            Event::Output(
                OutputRecord::Bytes { bytes, .. }
                | OutputRecord::Message { bytes, .. }
                | OutputRecord::Store { bytes, .. },
            ) => allocated(bytes.len()),
            Event::Output(OutputRecord::Plan { .. }) => allocated(size_of::<Plan>()),
            Event::Output(OutputRecord::Course { course, .. }) => {
                allocated(size_of::<Course>()) + allocated(course.legs.len() * size_of::<Leg>())
            }
            Event::Input(_) | Event::Output(_) => 0,
        };
        size_of::<Self>() + owned
    }
}

impl Trace {
    /// A recording that has not begun.
    pub(crate) fn new(seed: u64, keep: Retention) -> Self {
        Self {
            seed,
            drives: Vec::new(),
            compare: Group::ALL.to_vec(),
            lost: 0,
            end: Instant::ZERO,
            ended: true,
            written: 0,
            events: VecDeque::new(),
            keep,
            bytes: 0,
        }
    }

    /// Events: as read, or as recorded.
    pub fn events(&self) -> impl ExactSizeIterator<Item = &Entry> {
        self.events.iter()
    }

    /// Records what was fed to a drive.
    pub(crate) fn fed(&mut self, at: Instant, drive: u32, fed: &InputRecord) {
        if self.keep != Retention::Off {
            self.record(at, drive, Event::Input(fed.clone()));
        }
    }

    /// Records what a drive did.
    pub(crate) fn did(&mut self, at: Instant, drive: u32, output: Output<'_>) {
        if self.keep == Retention::Off {
            return;
        }
        if let Some(did) = OutputRecord::of(output) {
            self.record(at, drive, Event::Output(did));
        }
    }

    /// Records that power fails in a store.
    pub(crate) fn power_fails(&mut self, at: Instant, drive: u32) {
        if self.keep != Retention::Off {
            self.record(at, drive, Event::Output(OutputRecord::PowerOff));
        }
    }

    /// Returns whether no event is missing.
    pub(crate) fn is_whole(&self) -> bool {
        self.keep != Retention::Off && self.lost == 0
    }

    // Where it is inlined an entry is written once, and not copied about on its way to its place.
    #[inline(always)]
    fn record(&mut self, at: Instant, drive: u32, event: Event) {
        let entry = Entry { at, drive: drive as usize, event, line: 0 };
        self.bytes += entry.size();
        let bound = match self.keep {
            Retention::Ring(most) => Some((most, u64::MAX)),
            Retention::Written(most) => Some((most, self.written)),
            Retention::Off | Retention::All => None,
        };
        if let Some((most, droppable)) = bound {
            while self.bytes > most
                && self.lost < droppable
                && let Some(oldest) = self.events.pop_front()
            {
                self.bytes -= oldest.size();
                self.lost += 1;
            }
            make_room(&mut self.events);
        }
        self.events.push_back(entry);
    }

    /// Mark behind the last event: events so far, with those that a ring has dropped.
    #[must_use]
    pub fn mark(&self) -> u64 {
        self.lost + self.events.len() as u64
    }

    /// All that has happened by now is written.
    pub(crate) fn has_written(&mut self) {
        self.written = self.mark();
    }

    /// Forgets what was recorded since a [mark](Self::mark).
    pub(crate) fn rewind(&mut self, mark: u64) {
        while self.mark() > mark
            && let Some(newest) = self.events.pop_back()
        {
            self.bytes -= newest.size();
        }
    }
}

#[cfg(test)]
mod tests;
