//! The contract between a drive and its caller. Read this first.
//!
//! A drive is a pure function from inputs with timestamps to outputs with timestamps. It owns no clock, no
//! port and no pin. The caller (the simulator's bench, the [shell](crate::shell) of a board, a test) passes
//! inputs with their timestamps and calls the drive at its [deadline](Device::deadline). The drive passes its
//! outputs to the [`Context`], and the caller executes them. Only [`advance`] merges inputs and deadlines.
//!
//! # Example
//!
//! An MD3 without a board and without the simulator. The example is the clock, the line and the EEPROM.
//!
//! ```
//! use drivetwin_firmware::device::{Boot, Context, Device, Input, Instant, Output, Plan, Port, advance};
//! use drivetwin_firmware::md3::Md3;
//! use drivetwin_protocol::modbus::rtu;
//!
//! struct World {
//!     eeprom: Vec<u8>,
//!     sent: Vec<(Instant, Vec<u8>)>,
//!     plan: Option<Plan>,
//! }
//!
//! impl Context for World {
//!     fn put(&mut self, at: Instant, output: Output<'_>) {
//!         match output {
//!             Output::Bytes { bytes, .. } => self.sent.push((at, bytes.to_vec())),
//!             Output::Plan { plan, .. } => self.plan = Some(*plan),
//!             Output::Store { offset, bytes } => {
//!                 self.eeprom[usize::from(offset)..][..bytes.len()].copy_from_slice(bytes);
//!             }
//!             _ => {} // Lights, motor current, log.
//!         }
//!     }
//!
//!     fn memory(&self) -> &[u8] {
//!         &self.eeprom
//!     }
//! }
//!
//! let mut drive = Md3::new();
//! let eeprom = vec![0xFF; usize::from(drive.spec().memory)];
//! let mut world = World { eeprom, sent: Vec::new(), plan: None };
//! // `fast` leaves out the start-up delay.
//! drive.power_on(Instant::ZERO, Boot { fast: true, ..Boot::default() }, &mut world);
//!
//! // At 1 s the first character of "MotionControl = move" ends: 10,000 steps at up to 5,000 steps/s, 10,000 steps/s².
//! let request = rtu::write(1, 0x11, 1);
//! let at = Instant::from_ticks(16_000_000);
//! let input = Input::Bytes { port: Port(0), bytes: &request };
//! let next = advance(&mut drive, at, [(at, input)].into_iter(), &mut world);
//! // The frame is complete after 7 more characters of 18,333 ticks, 3.5 characters of silence and one more.
//! assert_eq!(next, Instant::from_ticks(16_000_000 + 7 * 18_333 + 64_166 + 18_333));
//! assert_eq!(world.sent, []);
//!
//! advance(&mut drive, next, core::iter::empty(), &mut world);
//! // The reply echoes the request, and the move takes 0.5 s + 1.5 s + 0.5 s.
//! assert_eq!(world.sent, [(next, request.to_vec())]);
//! let plan = world.plan.expect("the axis moves");
//! assert_eq!(plan.end(), Instant::from_ticks(next.ticks() + 40_000_000));
//! assert_eq!(plan.position_at(plan.end()), 10_000);
//! ```

use core::fmt;
use core::ops::RangeInclusive;

pub use drivetwin_protocol::line::Line;
pub use drivetwin_protocol::modbus::DropReason;
use drivetwin_protocol::modbus::server::{Outcome, Rules};
use drivetwin_protocol::registers::{Named, Row, Table};
pub use drivetwin_protocol::time::{Duration, Instant};
use fixed::types::I48F16;

pub use crate::motion::Plan;
use crate::motor::Parameters;
pub use crate::motor::Rotation;

macro_rules! newtype_index {
    ($($(#[$doc:meta])* $Name:ident,)*) => {$(
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        pub struct $Name(pub u8);
    )*};
}

newtype_index! {
    /// Index in [`Spec::ports`].
    Port,
    /// Index in [`Spec::pins`].
    Pin,
    /// Index in [`Spec::axes`].
    Axis,
    /// Index in [`Spec::encoders`].
    Encoder,
    /// Index in [`Spec::faults`].
    Fault,
    /// Index in [`Spec::reasons`].
    Reason,
    /// Number of a TCP connection of a port. After a connection is closed, a later one may have the same
    /// number.
    Link,
}

/// A voltage above this limit, in mV, is a high level. The limit is in the middle of TTL's 0.8 V and 2.0 V.
pub const HIGH_MV: i32 = 1_400;

/// Voltage of a high level, in mV. The voltage of a low level is 0.
pub const LOGIC_HIGH_MV: i32 = 5_000;

/// Level of an output pin.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Level {
    /// Pulled to ground.
    Low,
    /// Driven high.
    High,
    /// Not driven: the wiring outside decides.
    Float,
}

/// An input of a drive. A drive ignores the inputs that it does not know.
#[derive(Clone, Copy, PartialEq, Debug)]
#[non_exhaustive]
pub enum Input<'a> {
    /// Characters received on a serial port. The timestamp is the end of the first character's stop bit; the
    /// other characters follow back to back. An input has more than one character only if silence ends a
    /// frame ([`Framing::Silence`]). On a line of 7 data bits (Modbus ASCII) a line feed is the last
    /// character of its input. The caller may split the characters into inputs anywhere; the drive does the
    /// same.
    Bytes {
        /// Port.
        port: Port,
        /// The characters.
        bytes: &'a [u8],
    },
    /// A character was received with an error: parity, framing, overrun, collision, or another baud rate.
    RxError {
        /// Port.
        port: Port,
    },
    /// The line has been silent long enough to end a frame (`--line fast`, a UART's idle interrupt).
    Idle {
        /// Port.
        port: Port,
    },
    /// The host opened or closed the port (DTR; a pty was opened or closed).
    HostPresence {
        /// Port.
        port: Port,
        /// True if a program has the port open.
        here: bool,
    },
    /// A client has connected to a TCP port. The number of the connection is the lowest free one on this
    /// port.
    Opened {
        /// Port.
        port: Port,
        /// The new connection.
        link: Link,
    },
    /// A message received on a TCP connection: a whole Modbus ADU, or received bytes of MCode. The caller
    /// splits MCode after the end of each text line, as [`next_line`](drivetwin_protocol::text::next_line)
    /// does.
    Message {
        /// Port.
        port: Port,
        /// The connection.
        link: Link,
        /// Bytes of the message.
        bytes: &'a [u8],
    },
    /// A TCP connection was closed, but not by the drive.
    Closed {
        /// Port.
        port: Port,
        /// The connection.
        link: Link,
    },
    /// A digital input pin changed its level.
    Edge {
        /// The pin.
        pin: Pin,
        /// True if the level is now high.
        high: bool,
    },
    /// An input whose [idle level](PinSpec::idle) is [`Level::Float`] is no longer driven and not wired. Until its
    /// first event such a pin is open.
    Open {
        /// The pin.
        pin: Pin,
    },
    /// The voltage at an analogue input changed.
    Millivolts {
        /// The pin.
        pin: Pin,
        /// Voltage in mV.
        mv: i32,
    },
    /// Encoder steps (quarter cycles) from a hardware counter. Only boards send this, instead of edges.
    Count {
        /// The encoder.
        encoder: Encoder,
        /// Steps since the last input of this kind, signed.
        steps: i32,
        /// Level of channel A now.
        a: bool,
        /// Level of channel B now.
        b: bool,
    },
    /// The cause of a fault appears or disappears.
    Fault {
        /// The fault.
        fault: Fault,
        /// True while the cause is present.
        on: bool,
    },
    /// The current of the motor on an axis changed.
    MotorCurrent {
        /// Axis.
        axis: Axis,
        /// Current in mA. Its sign is that of the duty; a braking current has the opposite sign.
        ma: i32,
    },
    /// The motor on an axis has these parameters from the timestamp on. The drive's control loop computes
    /// with them.
    Motor {
        /// Axis.
        axis: Axis,
        /// Winding, rotor, supply and load.
        parameters: &'a Parameters,
    },
    /// Rotation of the motor on an axis from the timestamp on. The drive's control loop uses it between two
    /// edges of its sensors.
    Rotation {
        /// Axis.
        axis: Axis,
        /// Angle, speed and acceleration at the timestamp.
        rotation: Rotation,
    },
    /// A board started a plan late and therefore made more steps than the plan has. The simulator never sends
    /// this.
    StepsCorrection {
        /// Axis.
        axis: Axis,
        /// Number of steps made in addition to the plan, signed.
        steps: i32,
    },
}

/// An output of a drive. Callers match all outputs, so that none is lost silently.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Output<'a> {
    /// Characters to send from the timestamp on, back to back at the rate of the line. The caller times each
    /// character. The timestamp may be in the future, because of a reply delay.
    Bytes {
        /// Port.
        port: Port,
        /// The characters.
        bytes: &'a [u8],
    },
    /// A message to send on a TCP connection.
    Message {
        /// Port.
        port: Port,
        /// The connection.
        link: Link,
        /// The message.
        bytes: &'a [u8],
    },
    /// The drive closes a TCP connection.
    Close {
        /// Port.
        port: Port,
        /// The connection.
        link: Link,
    },
    /// New line settings. They apply after all [`Output::Bytes`] put before have been sent.
    Line {
        /// Port.
        port: Port,
        /// The new settings.
        line: Line,
    },
    /// An output pin takes a level.
    Level {
        /// The pin.
        pin: Pin,
        /// The level.
        level: Level,
    },
    /// An output pin repeats a pulse from the timestamp on, until the next output for this pin: high for
    /// `high`, low for the rest of `period`. For LEDs, PWM and clocks. The drive is not called at the edges.
    Wave {
        /// The pin.
        pin: Pin,
        /// Duration of a cycle, not zero.
        period: Duration,
        /// High time at the beginning of each cycle.
        high: Duration,
    },
    /// Plan of an axis from the timestamp on.
    Plan {
        /// Axis.
        axis: Axis,
        /// The plan: the position at any instant from the timestamp on.
        plan: &'a Plan,
    },
    /// Steps at the timestamp, without a ramp (step/direction input).
    Step {
        /// Axis.
        axis: Axis,
        /// Number of steps, signed.
        steps: i32,
    },
    /// Current limit of the motor.
    CurrentLimit {
        /// Axis.
        axis: Axis,
        /// Peak current in mA; 0 opens the terminals.
        ma: u32,
    },
    /// Duty of a motor that is not a stepper motor.
    Duty {
        /// Axis.
        axis: Axis,
        /// Duty in 1/65536 of the supply voltage, signed; 0 shorts the terminals.
        duty: i32,
    },
    /// Bytes to write into the non-volatile memory. If power fails during the write, only the first of these
    /// bytes are written.
    Store {
        /// Offset of the first byte.
        offset: u16,
        /// The bytes.
        bytes: &'a [u8],
    },
    /// A note for logs and statistics; it has no effect.
    Log(LogEvent),
}

/// A note for a log.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum LogEvent {
    /// A request was executed.
    Request {
        /// Port.
        port: Port,
        /// The address in the request.
        unit: u8,
        /// Function code.
        function: u8,
    },
    /// A request was refused.
    Refused {
        /// Port.
        port: Port,
        /// Function code.
        function: u8,
        /// The exception code.
        code: u8,
    },
    /// A frame was ignored.
    Dropped {
        /// Port.
        port: Port,
        /// Reason.
        why: DropReason,
    },
    /// A reason why the drive does not do what the present request says, although it accepts the request. The
    /// [`Request`](Self::Request) of the same call follows. A request of several registers may have several
    /// reasons. A drive may also put a reason without a request, for instance for a pin or a user program;
    /// receivers ignore it.
    Reason(Reason),
}

impl LogEvent {
    /// The note for a Modbus message on a serial port.
    #[must_use]
    pub fn of(port: Port, outcome: Outcome) -> Self {
        match outcome {
            Outcome::Served { unit, function, refused: None } => Self::Request { port, unit, function },
            Outcome::Served { function, refused: Some(exception), .. } => {
                Self::Refused { port, function, code: exception.code() }
            }
            Outcome::Dropped(why) => Self::Dropped { port, why },
        }
    }
}

/// Receiver of a drive's outputs, with the drive's non-volatile memory.
pub trait Context {
    /// Puts an output, which takes effect at `at`. `at` is the time of the call of the drive, except where
    /// the docs of [`Output`] allow a later time.
    fn put(&mut self, at: Instant, output: Output<'_>);

    /// The non-volatile memory, [`Spec::memory`] bytes: the result of all [`Output::Store`] so far. A new
    /// memory is all `0xFF`.
    fn memory(&self) -> &[u8];
}

/// A context that discards all outputs and has no memory.
#[derive(Clone, Copy, Debug, Default)]
pub struct NullContext;

impl Context for NullContext {
    fn put(&mut self, _at: Instant, _output: Output<'_>) {}

    fn memory(&self) -> &[u8] {
        &[]
    }
}

/// Conditions at power-on.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Boot {
    /// Seed of all random choices.
    pub seed: u64,
    /// True if the drive skips its start-up delay.
    pub fast: bool,
    /// True if characters take no time on the drive's serial lines (`--line fast`).
    pub fast_line: bool,
}

/// Reason why a register cannot be preset.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum PresetError {
    /// There is no such register.
    NoSuchRegister,
    /// The register cannot be preset.
    ReadOnly,
    /// The register does not accept the value.
    OutOfRange,
    /// The saved values cannot be changed, because the memory is corrupt.
    BadMemory,
    /// The drive cannot change the register now, because of what it is doing.
    Busy,
}

impl fmt::Display for PresetError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NoSuchRegister => "the drive has no such register",
            Self::ReadOnly => "the drive sets it itself",
            Self::OutOfRange => "the drive does not take the value",
            Self::BadMemory => "the drive's memory is bad, so what is saved there cannot be changed",
            Self::Busy => "other settings or the present state of the drive do not allow it",
        })
    }
}

impl core::error::Error for PresetError {}

/// The sign that ends a message on a port.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Framing {
    /// 3.5 characters of silence (Modbus RTU), or, on a line of 7 data bits, a line feed (Modbus ASCII).
    Silence,
    /// A certain character, which the drive finds. The drive gets each character at the time when it is
    /// received.
    Character,
    /// The length in the message's header (Modbus/TCP).
    Mbap,
    /// A carriage return or a line feed, on a TCP connection (MCode).
    Return,
}

/// A port of a drive.
#[derive(Clone, Copy, Debug)]
pub struct PortSpec {
    /// Name of the port, as users type it.
    pub name: &'static str,
    /// The sign that ends a message on this port.
    pub framing: Framing,
    /// Factory settings of the serial line; `None` for a TCP port.
    pub line: Option<Line>,
}

impl PortSpec {
    /// Returns true for a TCP port, false for a serial port.
    #[must_use]
    pub fn is_tcp(&self) -> bool {
        self.line.is_none()
    }
}

/// Role of a pin.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Role {
    /// The drive reads the level.
    Input,
    /// The drive sets the level.
    Output,
    /// Input or output, as the registers select.
    Both,
    /// An analogue input.
    Analogue,
    /// The drive reads a level or a voltage. It gets an edge if the pin is driven low or high or is no longer
    /// driven. It gets the voltage if the pin is driven to a voltage.
    AnalogueOrDigital,
    /// A light.
    Led,
}

/// A pin of a drive.
#[derive(Clone, Copy, Debug)]
pub struct PinSpec {
    /// Name of the pin in the manual.
    pub name: &'static str,
    /// Role of the pin.
    pub role: Role,
    /// Idle level, while the pin is not driven. With `Float` the drive distinguishes a contact that is not
    /// wired ([`Input::Open`]) from a wired contact that is open (high).
    pub idle: Level,
    /// True if the pin idles high, whatever `idle` is, as soon as a wire or a switch is connected or a user
    /// has set the pin. Until then the contact counts as closed.
    pub high_once_used: bool,
    /// Shunt of an analogue input that can measure a current, in Ω; otherwise 0.
    pub shunt_ohm: u16,
}

impl PinSpec {
    /// A pin that measures no current, with the idle level `idle`.
    #[must_use]
    pub const fn new(name: &'static str, role: Role, idle: Level) -> Self {
        Self { name, role, idle, high_once_used: false, shunt_ohm: 0 }
    }

    /// Returns true if the drive distinguishes a contact that is not wired, by [`Input::Open`].
    #[must_use]
    pub fn reports_open(&self) -> bool {
        self.idle == Level::Float && matches!(self.role, Role::Input | Role::Both | Role::AnalogueOrDigital)
    }
}

/// An axis of a drive.
#[derive(Clone, Copy, Debug)]
pub struct AxisSpec {
    /// Name of the axis.
    pub name: &'static str,
    /// The pins for step pulses and direction. If their role is [`Role::Both`], a plan takes them and keeps
    /// them low until its first step. A level or a wave put at one of these pins takes this pin back from the
    /// plan.
    pub step_dir: Option<(Pin, Pin)>,
}

/// An encoder input of a drive.
#[derive(Clone, Copy, Debug)]
pub struct EncoderSpec {
    /// Channel A.
    pub a: Pin,
    /// Channel B.
    pub b: Pin,
    /// The index; `None` if the drive does not use an index.
    pub index: Option<Pin>,
}

/// A code that is a command when it is written to a certain register.
#[derive(Clone, Copy, Debug)]
pub struct CommandSpec {
    /// The code.
    pub code: u16,
    /// The manual's name.
    pub name: &'static str,
    /// The section of the manual.
    pub section: &'static str,
    /// Effect of the command, also if it is not modelled.
    pub doc: &'static str,
    /// Reason why the command is not modelled; empty if it is modelled.
    pub missing: &'static str,
}

/// Effect of a request that the drive accepts and answers as usual.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Effect {
    /// No effect: the drive ignores the request, or a part of it.
    Nothing,
    /// The usual effect at a later time: after a save, at the next power-on, with the next command.
    Later,
    /// Another effect: the drive uses another value.
    Other,
    /// None of its own: the drive stores the request as a line of a program.
    Stored,
}

/// A reason why a drive does not do what a request says, although it accepts the request.
#[derive(Clone, Copy, Debug)]
pub struct ReasonSpec {
    /// Effect of the request.
    pub effect: Effect,
    /// The reason in the manual's names, and what to do: one clause of at most 80 characters, for users.
    pub text: &'static str,
    /// The section of the manual, or the decision.
    pub section: &'static str,
}

impl ReasonSpec {
    /// A reason for which a request has no effect.
    #[must_use]
    pub const fn nothing(text: &'static str, section: &'static str) -> Self {
        Self { effect: Effect::Nothing, text, section }
    }

    /// A reason for which a request has its effect later.
    #[must_use]
    pub const fn later(text: &'static str, section: &'static str) -> Self {
        Self { effect: Effect::Later, text, section }
    }

    /// A reason for which a request has another effect.
    #[must_use]
    pub const fn other(text: &'static str, section: &'static str) -> Self {
        Self { effect: Effect::Other, text, section }
    }

    /// A reason for which a request becomes a line of a program.
    #[must_use]
    pub const fn stored(text: &'static str, section: &'static str) -> Self {
        Self { effect: Effect::Stored, text, section }
    }
}

/// True if drives report reasons. Nothing on a board shows them, so an image has neither their texts nor the code
/// that finds them, and no other text for users.
pub(crate) const REPORTS_REASONS: bool = cfg!(any(test, feature = "reasons"));

/// Texts about a drive if the feature `reasons` is on, otherwise none, so that an image for a board has no texts.
#[must_use]
pub const fn reported<T>(texts: &'static [T]) -> &'static [T] {
    if REPORTS_REASONS { texts } else { &[] }
}

impl Reason {
    /// Reports the reason for the request that the drive is executing, before the report of the request itself. Nothing
    /// without the feature `reasons`.
    pub fn put(self, at: Instant, out: &mut dyn Context) {
        if REPORTS_REASONS {
            out.put(at, Output::Log(LogEvent::Reason(self)));
        }
    }
}

/// Description of a kind of drive.
#[derive(Debug)]
pub struct Spec {
    /// Name of the kind, as users type it.
    pub kind: &'static str,
    /// The product.
    pub product: &'static str,
    /// The manual that the model follows.
    pub manual: &'static str,
    /// Ports.
    pub ports: &'static [PortSpec],
    /// Pins.
    pub pins: &'static [PinSpec],
    /// Other names of some of the pins.
    pub aliases: &'static [(&'static str, Pin)],
    /// Axes.
    pub axes: &'static [AxisSpec],
    /// Encoder inputs.
    pub encoders: &'static [EncoderSpec],
    /// The faults in the manual, with the names that users type.
    pub faults: &'static [&'static str],
    /// Size of the non-volatile memory in bytes.
    pub memory: u16,
    /// Registers of all variants of the product. Without the feature `reasons` the table has no rows, only their entries.
    pub registers: &'static Table,
    /// Bit of this variant, as in [`Entry::variants`](drivetwin_protocol::registers::Entry::variants).
    pub variant: u8,
    /// True if the manual numbers registers in decimal, false if in hexadecimal.
    pub decimal: bool,
    /// Prefix of register names in the manual. Users may type it or leave it out.
    pub prefix: &'static str,
    /// Values of writes, if the rows alone do not tell them. Without the feature `reasons` there are none.
    pub writes: Option<&'static Writes>,
    /// Commands, if the rows alone do not list them. Without the feature `reasons` there are none.
    pub commands: &'static [CommandSpec],
    /// Row of the bus address.
    pub address: Option<usize>,
    /// Row of the supply voltage of the drive and its motor, in 0.1 V. A bench sets it at each power-on.
    pub supply: Option<usize>,
    /// The row and its bit that select a brush motor instead of a stepper; `None` if the drive has no such choice.
    pub dc_motor: Option<(usize, u16)>,
    /// Reasons why the drive does not do what a request says, although it accepts the request. Without the feature
    /// `reasons` there are none.
    pub reasons: &'static [ReasonSpec],
    /// Rules of the Modbus ports.
    pub rules: Option<&'static Rules>,
    /// Errors by their numbers, in the manual's words, if the drive refuses messages with them. Without the feature
    /// `reasons` there are none.
    pub errors: &'static [(u8, &'static str)],
    /// Row of the number of the last error.
    pub last_error: Option<usize>,
    /// The only reason of Modbus exception 04; empty if there are several, and without the feature `reasons`.
    pub failure: &'static str,
    /// Limits of the model, for users, except those that a row of `registers` or `commands` states. Without the
    /// feature `reasons` there are none.
    pub not_modelled: &'static [&'static str],
}

/// Values of writes that the rows of a kind alone do not tell.
#[derive(Debug)]
pub struct Writes {
    /// The values that a row takes in the drive's own language, if they are not those of the bus.
    pub language: fn(row: usize) -> Option<RangeInclusive<i64>>,
    /// Returns true for a value of a row that the drive refuses in every state, although the row accepts the value.
    pub refuses: fn(row: usize, value: i64) -> bool,
}

impl Writes {
    /// Each row takes the values that it states.
    pub const OF_ROWS: Self = Self { language: |_| None, refuses: |_, _| false };

    /// These values, if drives report reasons.
    pub(crate) const fn reported(&'static self) -> Option<&'static Self> {
        if REPORTS_REASONS { Some(self) } else { None }
    }
}

impl Spec {
    /// A device without ports, pins, axes and registers.
    pub const EMPTY: Self = Self {
        kind: "",
        product: "",
        manual: "",
        ports: &[],
        pins: &[],
        aliases: &[],
        axes: &[],
        encoders: &[],
        faults: &[],
        memory: 0,
        registers: &Table::EMPTY,
        variant: u8::MAX,
        decimal: false,
        prefix: "",
        writes: None,
        commands: &[],
        address: None,
        supply: None,
        dc_motor: None,
        reasons: &[],
        rules: None,
        errors: &[],
        last_error: None,
        failure: "",
        not_modelled: &[],
    };

    /// The pin with the name `name`, which may also be an alias.
    #[must_use]
    pub fn pin(&self, name: &str) -> Option<Pin> {
        self.pin_names().find_map(|(known, pin)| (known == name).then_some(pin))
    }

    /// All names of pins, with the aliases.
    pub fn pin_names(&self) -> impl Iterator<Item = (&'static str, Pin)> + Clone + use<> {
        let own = (0..).map(Pin).zip(self.pins).map(|(pin, spec)| (spec.name, pin));
        own.chain(self.aliases.iter().copied())
    }

    /// Returns true if the drive has only TCP ports.
    #[must_use]
    pub fn is_on_network(&self) -> bool {
        !self.ports.is_empty() && self.ports.iter().all(PortSpec::is_tcp)
    }

    /// The rows that this variant of the product has, and their indices in the table.
    pub fn rows(&self) -> impl DoubleEndedIterator<Item = (usize, &'static Row)> + Clone + use<> {
        let variant = self.variant;
        self.registers.rows.iter().enumerate().filter(move |(_, row)| row.variants & variant != 0)
    }

    /// Finds a register by its name, with or without the prefix, if this variant of the product has it.
    #[must_use]
    pub fn find(&self, name: &str) -> Option<Named> {
        let named = self.registers.find(name.strip_prefix(self.prefix).unwrap_or(name))?;
        let row = self.registers.rows.get(named.row)?;
        (row.variants & self.variant != 0).then_some(named)
    }
}

/// State of a motor's shaft at an instant.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Shaft {
    /// Position in counts; it wraps. Each edge of a Hall sensor is a count: 4 counts per pulse for two
    /// sensors, 6 for three. This also holds for a drive that uses only one sensor or none.
    pub position: i32,
    /// Speed in counts per second, signed.
    pub speed: I48F16,
    /// Duty in 1/65536 of the supply voltage, signed.
    pub duty: i32,
    /// Current in mA, with the sign of the duty.
    pub ma: i32,
}

/// A drive. What it turns is a [`Plant`](crate::motor::Plant).
pub trait Device: Send {
    /// Description of this kind of device.
    fn spec(&self) -> &'static Spec;

    /// Switches the power on: the device loses all volatile state. Until its first input of this instant a pin has its
    /// [idle](PinSpec::idle) level, and a fault has no cause. The caller passes the causes of faults that are there, then
    /// the pins that differ, then what has arrived at the ports.
    fn power_on(&mut self, at: Instant, boot: Boot, out: &mut dyn Context);

    /// Switches the power off, also before the first [`power_on`](Self::power_on). Until the next one the caller only peeks,
    /// at the instant `at`, and pokes: a [`poke`](Self::poke) acts as before the first power-on. There are no outputs; the
    /// caller takes all pins for floating and all axes for free.
    fn power_off(&mut self, _at: Instant) {}

    /// Handles an input.
    fn input(&mut self, at: Instant, input: Input<'_>, out: &mut dyn Context);

    /// Returns true if a TCP port accepts connections. Only an input or a timeout changes this.
    fn accepts(&self, _port: Port) -> bool {
        true
    }

    /// Returns true if the drive takes messages on the connections of a TCP port. Only an input or a timeout
    /// changes this. While the drive takes no messages, the caller holds back messages and the ends of
    /// connections.
    fn takes(&self, _port: Port) -> bool {
        true
    }

    /// Time from which the drive receives what arrives at its ports: in the past if it receives now, in the
    /// future while it starts, [`Instant::NEVER`] if the drive does not know the time yet. For logs and faults of lines
    /// only.
    fn receives_from(&self) -> Instant {
        Instant::ZERO
    }

    /// Returns true if a whole Modbus frame for the slave `address` would have no effect but the report
    /// [`DropReason::Address`]. Its characters end at `at`, before the next [deadline](Self::deadline), and the line is
    /// silent before and after them. The caller need not pass such a frame to the drive.
    fn is_for_others(&self, _at: Instant, _port: Port, _address: u8) -> bool {
        false
    }

    /// Time of the next deadline; [`Instant::NEVER`] if only an input can change anything.
    fn deadline(&self) -> Instant;

    /// Handles the deadline. If `at` is not the deadline, nothing happens.
    fn timeout(&mut self, at: Instant, out: &mut dyn Context);

    /// The value that a read of register `row` at `at` would return, without side effects of a read; 0 if
    /// there is no such row. A row of more than four words gives the value of its first four words.
    fn peek(&self, at: Instant, row: usize) -> i64;

    /// A word, by its index in bus order, of a row of more than four words, whose value is too long for a
    /// number; 0 if there is no such word.
    fn peek_word(&self, _at: Instant, _row: usize, _word: usize) -> u16 {
        0
    }

    /// Presets a register without a bus request. Without power the value of a saved row is
    /// stored in the memory, as if written and saved. Later the value has the same effect as a write by the
    /// bus.
    ///
    /// # Errors
    /// The drive refuses the value; then nothing has changed.
    fn poke(&mut self, at: Instant, row: usize, value: i64, out: &mut dyn Context)
    -> Result<(), PresetError>;

    /// State of the motor on an axis; `None` if the axis follows a plan, or if the state is unknown.
    fn shaft(&self, _at: Instant, _axis: Axis) -> Option<Shaft> {
        None
    }

    /// Parameters of the internal motor, which is driven by duty, as the registers describe it now; `None` if
    /// the drive has no internal motor.
    fn internal_motor(&self) -> Option<crate::motor::Parameters> {
        None
    }

    /// Detaches [the internal motor](Self::internal_motor). Must be called before the first power-on.
    /// Afterwards current limit and duty are outputs, and the motor's feedback is an input. Returns the pins
    /// for its Hall sensors, A first; `None` if there is no internal motor.
    fn detach_motor(&mut self) -> Option<&'static [Pin]> {
        None
    }

    /// Number of steps of a plan per full step of the motor.
    fn microsteps(&self, _axis: Axis) -> u16 {
        1
    }

    /// Number of the line of the user program that is executed next; `None` if no program runs. Only for those who
    /// watch the drive.
    fn program_line(&self) -> Option<u16> {
        None
    }
}

/// A device can be used by reference.
impl<D: Device + ?Sized> Device for &mut D {
    fn spec(&self) -> &'static Spec {
        (**self).spec()
    }

    fn power_on(&mut self, at: Instant, boot: Boot, out: &mut dyn Context) {
        (**self).power_on(at, boot, out);
    }

    fn power_off(&mut self, at: Instant) {
        (**self).power_off(at);
    }

    fn input(&mut self, at: Instant, input: Input<'_>, out: &mut dyn Context) {
        (**self).input(at, input, out);
    }

    fn accepts(&self, port: Port) -> bool {
        (**self).accepts(port)
    }

    fn takes(&self, port: Port) -> bool {
        (**self).takes(port)
    }

    fn receives_from(&self) -> Instant {
        (**self).receives_from()
    }

    fn is_for_others(&self, at: Instant, port: Port, address: u8) -> bool {
        (**self).is_for_others(at, port, address)
    }

    fn deadline(&self) -> Instant {
        (**self).deadline()
    }

    fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        (**self).timeout(at, out);
    }

    fn peek(&self, at: Instant, row: usize) -> i64 {
        (**self).peek(at, row)
    }

    fn peek_word(&self, at: Instant, row: usize, word: usize) -> u16 {
        (**self).peek_word(at, row, word)
    }

    fn poke(
        &mut self,
        at: Instant,
        row: usize,
        value: i64,
        out: &mut dyn Context,
    ) -> Result<(), PresetError> {
        (**self).poke(at, row, value, out)
    }

    fn shaft(&self, at: Instant, axis: Axis) -> Option<Shaft> {
        (**self).shaft(at, axis)
    }

    fn internal_motor(&self) -> Option<crate::motor::Parameters> {
        (**self).internal_motor()
    }

    fn detach_motor(&mut self) -> Option<&'static [Pin]> {
        (**self).detach_motor()
    }

    fn microsteps(&self, axis: Axis) -> u16 {
        (**self).microsteps(axis)
    }

    fn program_line(&self) -> Option<u16> {
        (**self).program_line()
    }
}

/// Runs `device` up to `now` and returns its next deadline.
///
/// The timestamps of `inputs` must ascend and must not be after `now`. At the same instant an input is
/// handled before a deadline. If the caller is late, outputs are put later, but with the same timestamps and
/// contents.
pub fn advance<'a, D: Device + ?Sized>(
    device: &mut D,
    now: Instant,
    inputs: impl Iterator<Item = (Instant, Input<'a>)>,
    out: &mut dyn Context,
) -> Instant {
    let mut due = device.deadline();
    for (at, input) in inputs {
        due = feed(device, due, at, input, out);
    }
    wake(device, due, now, true, out)
}

/// Processes one input as [`advance`] does: first the deadlines before `at`, the first of which is `due`,
/// then `input`. Returns the next deadline. For callers that cannot pass all inputs as one iterator.
pub fn feed<D: Device + ?Sized>(
    device: &mut D,
    due: Instant,
    at: Instant,
    input: Input<'_>,
    out: &mut dyn Context,
) -> Instant {
    wake(device, due, at, false, out);
    device.input(at, input, out);
    device.deadline()
}

/// Handles all deadlines of `device` before `now`, and the one at `now` if `inclusive`. `due` is the first of
/// them. Returns the next deadline.
pub(crate) fn wake<D: Device + ?Sized>(
    device: &mut D,
    mut due: Instant,
    now: Instant,
    inclusive: bool,
    out: &mut dyn Context,
) -> Instant {
    let mut calls_at_once = 0_u32;
    while due < now || (due == now && inclusive && due != Instant::NEVER) {
        device.timeout(due, out);
        let next = device.deadline();
        calls_at_once = if next > due { 0 } else { calls_at_once.wrapping_add(1) };
        debug_assert!(
            calls_at_once < 1_000_000,
            "the deadline {due:?} is set again and again, so time cannot advance"
        );
        due = next;
    }
    due
}
