//! Trace: a recording of a bench, as text that people read and write.
//!
//! ```text
//! drivetwin trace 1                     the format, before anything else
//! seed 1                              of every random choice; 1 if not given
//! drive md3 md3                       name and kind; `fast`: no start-up delay; `from 12.5`: added then;
//!                                     `apart`: without the motor that it brings; `untimed`: on a line on which
//!                                     characters take no time
//! memory md3 0x0000 01 00 9A          content of its memory; 0xFF where not given
//! compare tx pins                     which outputs count: tx line pins motion stores; all if not given
//!
//! # A comment, here or behind a line.
//! 2500.000000 > rx 01 03 00 00 00 01 84 0A
//! 2513.176875 < tx 01 03 02 00 01 79 84
//! 2600.000000 end
//! ```
//!
//! A timestamp is the bench time in milliseconds; it means the nearest tick of 62.5 ns. With several drives,
//! the name of a drive follows the timestamp. `>` is an input of the drive; `<` is an output, which a replay
//! compares. `end` is the end of the recording; outputs with later timestamps were already scheduled then.
//! Without `end` the recording ends at its last timestamp, and further outputs at that timestamp are not
//! compared. A drive is powered on when it is added. A word without a port refers to the first port of the
//! drive; `rx:mcode` names a port.
//!
//! New words may be added without a new version of the format: a reader that does not know a word reports it
//! with its text line. A change in the meaning of existing words needs a new version.
//!
//! | input | |
//! |---|---|
//! | `rx 01 03` `rx "W15\r"` | characters, back to back; the timestamp is the end of the first one |
//! | `spoiled` `idle` | a character with a parity or framing error; the end of a frame |
//! | `attached on` | a program opens the port at the other end, or closes it (`off`) |
//! | `opened 0` `message 0 01 03` `closed 0` | TCP connection 0 is opened, carries a message, is closed |
//! | `pin J2.2 low` `millivolts ANALOG 2500` | an input changes |
//! | `pin DIR open` | an input is no longer driven and has no wire; only for a pin whose idle state is open |
//! | `count 0 -4 high low` | encoder, quarter cycles, A, B |
//! | `slipped motor 1` | number of steps that a board made in excess of the plan |
//! | `draws motor 130` | current of its motor in mA |
//! | `motor motor 24000 3000 500 400 10000 0 4 2 0` | parameters of its motor: supply in mV, speed without load in rpm, winding in mΩ, inertia in g·cm², friction and load in µN·m, pulses of a Hall sensor, Hall sensors, cycles of an encoder |
//! | `rotation motor 0 75000 0` | rotation of its motor from now on: angle in 2⁻³² turns, speed in 2⁻⁵⁶ turns per tick, acceleration in 2⁻⁶⁴ turns per tick² |
//! | `fault stall on` | the cause of a fault is set or cleared (`off`) |
//! | `poke Speed 8000` | a register is preset, not through the bus |
//! | `power off` `power on` | `power cut`: power fails in the next save; `power cut 1 0`: after one store and 0 bytes of the next |
//!
//! | output | |
//! |---|---|
//! | `tx 01 03` `message 0 01` `close 0` | output; the timestamp is the start of transmission |
//! | `line 19200 8E1` | serial settings from the next character on |
//! | `pin J3.7 low` | or `high`, `float` |
//! | `wave D6 500.000000 of 1500.000000` | a wave that is high for 500 ms at the beginning of each period of 1,500 ms |
//! | `plan motor 0 500.000000@5000 500.000000@0 2500` | start position, time in ms (or `ever`) and speed in steps/s at its end, …, end position |
//! | `step motor 1` `current motor 1500` `duty motor -32768` | steps, mA, 1/65536 |
//! | `store 0x0010 01 02` | a store to the memory |
//! | `power off` | power fails in the store before |

mod copy;
mod recording;
mod ring;
mod text;

use std::borrow::Cow;
use std::collections::VecDeque;
use std::sync::Arc;

use drivetwin_firmware::device::{
    Axis, Device, Encoder, Fault, Input, Instant, Level, Line, Link, Output, Pin, Plan, Port, Rotation,
    Shaft, Spec,
};
use drivetwin_firmware::motor::Parameters;
use drivetwin_protocol::time::Duration;

use crate::record::journal;
pub use recording::Recording;
pub(crate) use ring::{allocated, make_room};
pub use text::{ParseError, whole_lines};
pub(crate) use text::{is_name, without_comment};

/// Function that makes a device of a kind; `None` if there is no such kind.
pub type Make<'a> = dyn Fn(&str) -> Option<Box<dyn Device>> + 'a;

/// Number of events that a trace or capture retains in memory.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Retention {
    /// No events.
    Off,
    /// The most recent events, up to this number of bytes of memory.
    Ring(usize),
    /// Like `Ring`, but events that are not [written](crate::bench::Bench::mark_written) yet are never
    /// dropped.
    Written(usize),
    /// All events.
    All,
}

impl Retention {
    /// Default size of the ring: 64 MiB (HOST-20).
    pub const RING: usize = 64 << 20;
}

/// Default: a ring of [`Retention::RING`] bytes.
impl Default for Retention {
    fn default() -> Self {
        Self::Ring(Self::RING)
    }
}

/// Inputs and outputs of the drives of a bench, recorded by [`Bench::trace`](crate::bench::Bench::trace) or read from
/// text.
///
/// ```
/// use drivetwin_firmware::device::{Duration, Instant};
/// use drivetwin_firmware::md3::Md3;
/// use drivetwin_protocol::modbus::rtu;
/// use drivetwin_sim::bench::Bench;
/// use drivetwin_sim::record::trace::Trace;
/// use drivetwin_sim::{catalog, replay};
///
/// let mut bench = Bench::new();
/// let drive = bench.add::<Md3>("x");
/// bench.run_until(Instant::ZERO + Duration::secs(3));
/// bench.ask(drive, &rtu::read(1, 0, 1));
/// let text = bench.trace().to_text();
/// assert!(text.contains(" > rx 01 03"));
///
/// // A replay gives the same outputs.
/// let make = |kind: &str| catalog::make(kind).ok();
/// let trace = Trace::parse(&text, &make)?;
/// assert_eq!(replay::run(&trace, &make)?, None);
/// # Ok::<(), replay::Unplayable>(())
/// ```
#[derive(Clone, Debug)]
pub struct Trace {
    /// Seed of all random choices.
    pub seed: u64,
    /// Drives of the recorded bench, in the order in which they were added.
    pub drives: Vec<TraceDrive>,
    /// Groups of outputs that a replay compares.
    pub compare: Vec<Group>,
    /// Number of events that a full ring has dropped. If the beginning is missing, a trace cannot be
    /// replayed.
    pub lost: u64,
    /// End of the recording; in a text without `end`, the last timestamp.
    pub end: Instant,
    /// True if the trace is complete up to `end`. A text without `end` may break off within its last
    /// timestamp.
    pub ended: bool,
    /// Number of events that are marked as written.
    written: u64,
    /// Number of benches before this one, whose events the numbers of these events follow.
    pub(crate) generation: u32,
    events: VecDeque<Entry>,
    /// Events that wait for earlier ones of drives that are elsewhere, in the order of recording; `None` if events do not
    /// wait.
    waiting: Option<Vec<Entry>>,
    retention: Retention,
    /// Memory that `events` uses, in bytes.
    bytes: usize,
}

/// A drive of a trace: its kind, and its state when it was added.
#[derive(Clone, Debug)]
pub struct TraceDrive {
    /// Name of the drive.
    pub name: String,
    /// Description of the drive's kind, with names of pins, ports and registers.
    pub spec: &'static Spec,
    /// True if the start-up delay is skipped.
    pub boot_fast: bool,
    /// True if characters take no time on its serial lines.
    pub fast_line: bool,
    /// True if a motor of the bench replaces its internal motor.
    pub external_motor: bool,
    /// True if the drive is on a board, which reported its events. A replay does not repeat them.
    pub elsewhere: bool,
    /// True if the drive turns a brush or brushless motor, internal or of the bench. The motion of its axis is
    /// then that of the motor, which only [`Event::Shaft`] shows.
    pub turns_motor: bool,
    /// Time at which the drive was added and powered on.
    pub from: Instant,
    /// Content of the memory at that time, [`Spec::memory`] bytes.
    pub memory: Arc<[u8]>,
}

/// An event of a trace, with its time and drive.
#[derive(Clone, PartialEq, Debug)]
pub struct Entry {
    /// Bench time of the event. The time of an output may be later than the time at which it was recorded.
    pub at: Instant,
    /// Index of the drive in [`Trace::drives`].
    pub drive: usize,
    /// The event.
    pub event: Event,
    /// Number of the text line from which the event was read, from 1; 0 if it was recorded.
    pub line: usize,
}

/// An event: an input or an output of a drive, or the motion of its motor.
#[derive(Clone, PartialEq, Debug)]
pub enum Event {
    /// Input of a drive.
    Input(InputRecord),
    /// Output of a drive.
    Output(OutputRecord),
    /// State of the motor on an axis, for waveforms. Only a bench with
    /// [`Settings::shafts`](crate::bench::Settings::shafts) records it, and a text does not contain it.
    Shaft {
        /// Axis.
        axis: Axis,
        /// State of the motor's shaft.
        shaft: Shaft,
    },
    /// Outcome of a message, for waveforms, recorded when it is known and again when it changes. Only a bench with
    /// [`Settings::outcomes`](crate::bench::Settings::outcomes) records it, and a text does not contain it.
    Received(Box<journal::Entry>),
    /// Events before this one are missing, because a board could not send them. In a text it is a comment.
    Missing {
        /// Number of missing events; `None` if it is unknown.
        events: Option<u64>,
    },
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
    /// [`Input::Bytes`]; on a port with timed characters, those after the first follow back to back.
    Bytes { port: Port, bytes: Arc<[u8]> },
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
    /// [`Device::poke`]; it comes after all other events of its instant.
    Poke { row: usize, value: i64 },
}

impl InputRecord {
    /// The input as the drive receives it; `None` for power and presets.
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

/// Change of a drive's power, as recorded in a trace.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Power {
    /// Power on.
    On,
    /// Power off.
    Off,
    /// Power fails in the next save. `None`: the seed determines the point.
    Cut(Option<Cut>),
}

/// Point in a save at which power fails (HOST-9).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Cut {
    /// Number of stores that are completed.
    pub stores: u32,
    /// Bytes of the next store that are written.
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
    /// [`Output::Plan`] as recorded.
    Plan { axis: Axis, plan: Box<Plan> },
    /// [`Output::Plan`] as read from text.
    Course { axis: Axis, course: Box<Course> },
    /// [`Output::Step`]
    Step { axis: Axis, steps: i32 },
    /// [`Output::CurrentLimit`]
    CurrentLimit { axis: Axis, ma: u32 },
    /// [`Output::Duty`]: 1/65536 of full on, signed.
    Duty { axis: Axis, duty: i32 },
    /// [`Output::Store`]
    Store { offset: u16, bytes: Vec<u8> },
    /// Power fails in the store before, because of a [cut](Power::Cut).
    PowerOff,
}

impl OutputRecord {
    /// The record of `output`; `None` for a log event.
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
            Output::Log(_) => return None,
        })
    }

    /// The record in the form that text can represent at that timestamp: a plan becomes its course. Traces
    /// are compared in this form.
    #[must_use]
    pub fn as_text(&self, at: Instant) -> Cow<'_, Self> {
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

/// Group of outputs that a replay compares or ignores together.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Group {
    /// Characters and messages that are sent.
    Tx,
    /// Changes of a line's serial settings.
    Line,
    /// Levels and waves.
    Pins,
    /// Plans, steps, currents and duties.
    Motion,
    /// Stores to the memory, and power cuts.
    Stores,
}

impl Group {
    /// All groups, which a replay compares by default.
    pub const ALL: [Self; 5] = [Self::Tx, Self::Line, Self::Pins, Self::Motion, Self::Stores];

    /// Name of the group in a trace.
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

/// A motion plan as a trace describes it: start position, segments, end position.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Course {
    /// Start position in steps.
    pub from: i32,
    /// Segments of constant acceleration, in the order of time.
    pub legs: Vec<Leg>,
    /// Final position; `None` for a motion without end.
    pub to: Option<i32>,
}

/// A segment of constant acceleration of a [`Course`].
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Leg {
    /// Duration of the segment; [`Duration::FOREVER`] if it has no end.
    pub time: Duration,
    /// The speed at the end of the segment, in thousandths of a step per second, signed.
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
            // Rounded to the nearest thousandth.
            let speed = i64::try_from((bits + (1 << 15)) >> 16).unwrap_or(i64::MAX);
            legs.push(Leg { time, speed });
        }
        let to = (at < Instant::NEVER).then(|| plan.position_at(at));
        Self { from, legs, to }
    }
}

impl Entry {
    /// Memory of the entry, in bytes.
    fn size(&self) -> usize {
        let owned = match &self.event {
            Event::Input(InputRecord::Bytes { bytes, .. }) => allocated(bytes.len()),
            Event::Input(InputRecord::Message { bytes, .. }) => allocated(bytes.len()),
            Event::Output(
                OutputRecord::Bytes { bytes, .. }
                | OutputRecord::Message { bytes, .. }
                | OutputRecord::Store { bytes, .. },
            ) => allocated(bytes.len()),
            Event::Output(OutputRecord::Plan { .. }) => allocated(size_of::<Plan>()),
            Event::Output(OutputRecord::Course { course, .. }) => {
                allocated(size_of::<Course>()) + allocated(course.legs.len() * size_of::<Leg>())
            }
            Event::Received(_) => allocated(size_of::<journal::Entry>()),
            Event::Input(_) | Event::Output(_) | Event::Shaft { .. } | Event::Missing { .. } => 0,
        };
        size_of::<Self>() + owned
    }
}

impl Trace {
    /// A trace of a recording without events.
    pub(crate) fn new(seed: u64, retention: Retention) -> Self {
        Self {
            seed,
            drives: Vec::new(),
            compare: Group::ALL.to_vec(),
            lost: 0,
            end: Instant::ZERO,
            ended: true,
            written: 0,
            generation: 0,
            events: VecDeque::new(),
            waiting: None,
            retention,
            bytes: 0,
        }
    }

    /// All events, in the order in which they were read or recorded.
    pub fn events(&self) -> impl ExactSizeIterator<Item = &Entry> {
        self.events.iter()
    }

    /// Records an input of a drive.
    pub(crate) fn record_input(&mut self, at: Instant, drive: u32, input: &InputRecord) {
        if self.retention != Retention::Off {
            self.record(at, drive, Event::Input(input.clone()));
        }
    }

    /// Records a frame that a drive has received, and its end.
    pub(crate) fn record_frame(&mut self, at: Instant, drive: u32, port: Port, bytes: &Arc<[u8]>) {
        if self.retention != Retention::Off {
            self.record(at, drive, Event::Input(InputRecord::Bytes { port, bytes: Arc::clone(bytes) }));
            self.record(at, drive, Event::Input(InputRecord::Idle { port }));
        }
    }

    /// Records an output of a drive.
    pub(crate) fn record_output(&mut self, at: Instant, drive: u32, output: Output<'_>) {
        if self.retention == Retention::Off {
            return;
        }
        if let Some(record) = OutputRecord::of(output) {
            self.record(at, drive, Event::Output(record));
        }
    }

    /// Records the state of a drive's motor.
    pub(crate) fn record_shaft(&mut self, at: Instant, drive: u32, axis: Axis, shaft: Shaft) {
        if self.retention != Retention::Off {
            self.record(at, drive, Event::Shaft { axis, shaft });
        }
    }

    /// Records the outcome of a message.
    pub(crate) fn record_received(&mut self, at: Instant, drive: u32, entry: journal::Entry) {
        if self.retention != Retention::Off {
            self.record(at, drive, Event::Received(Box::new(entry)));
        }
    }

    /// Records that power fails in a store.
    pub(crate) fn record_power_cut(&mut self, at: Instant, drive: u32) {
        if self.retention != Retention::Off {
            self.record(at, drive, Event::Output(OutputRecord::PowerOff));
        }
    }

    /// Records what a drive that is elsewhere reports.
    pub(crate) fn record_reported(&mut self, at: Instant, drive: u32, event: Event) {
        if self.retention != Retention::Off {
            self.record(at, drive, event);
        }
    }

    /// Returns true if no event is missing.
    #[must_use]
    pub fn is_whole(&self) -> bool {
        self.retention != Retention::Off && self.lost == 0
    }

    // Inlined so that an entry is written once and not copied.
    #[inline(always)]
    fn record(&mut self, at: Instant, drive: u32, event: Event) {
        let entry = Entry { at, drive: drive as usize, event, line: 0 };
        match &mut self.waiting {
            None => self.append(entry),
            Some(waiting) => waiting.push(entry),
        }
    }

    #[inline(always)]
    fn append(&mut self, entry: Entry) {
        self.bytes += entry.size();
        let bound = match self.retention {
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

    /// Lets events wait until [`settle`](Self::settle) from now on.
    pub(crate) fn wait(&mut self) {
        self.waiting = Some(Vec::new());
    }

    /// Returns true if an event waits.
    pub(crate) fn is_waiting(&self) -> bool {
        self.waiting.as_ref().is_some_and(|waiting| !waiting.is_empty())
    }

    /// Takes the events until `until` that wait, in the order of their times. Those of one instant keep the order of their
    /// recording.
    pub(crate) fn settle(&mut self, until: Instant) {
        let Some(waiting) = &mut self.waiting else { return };
        let mut ready: Vec<Entry> = waiting.extract_if(.., |entry| entry.at <= until).collect();
        ready.sort_by_key(|entry| entry.at);
        ready.into_iter().for_each(|entry| self.append(entry));
    }

    /// Number of events so far, including those that wait, for [`rewind`](Self::rewind).
    pub(crate) fn position(&self) -> u64 {
        self.mark() + self.waiting.as_ref().map_or(0, |waiting| waiting.len() as u64)
    }

    /// Number of events so far, including those that a ring has dropped.
    #[must_use]
    pub fn mark(&self) -> u64 {
        self.lost + self.events.len() as u64
    }

    /// Number of benches before this one, after which the numbers of events go on. The drives are others in each.
    #[must_use]
    pub fn generation(&self) -> u32 {
        self.generation
    }

    /// Marks all events as written.
    pub(crate) fn mark_written(&mut self) {
        self.written = self.mark();
    }

    /// Drops all events that were recorded after a [position](Self::position).
    pub(crate) fn rewind(&mut self, position: u64) {
        if let Some(waiting) = &mut self.waiting {
            let left = position.saturating_sub(self.lost + self.events.len() as u64);
            waiting.truncate(usize::try_from(left).unwrap_or(usize::MAX));
        }
        while self.mark() > position
            && let Some(newest) = self.events.pop_back()
        {
            self.bytes -= newest.size();
        }
    }
}

#[cfg(test)]
mod tests;
