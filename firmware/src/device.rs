//! The contract between a drive and the world. Read this first.
//!
//! A drive is a pure function from stamped inputs to stamped outputs: it owns no clock, no port and no pin. Its caller
//! (the simulator's bench, the [shell](crate::shell) of a board, a test) passes inputs with their time, wakes the drive
//! at its [deadline](Device::deadline), and carries out the outputs that the drive puts into the [`Context`].
//! [`advance`] is the one place where inputs and deadlines are merged.
//!
//! # Example
//!
//! An MD3 without a board and without the simulator: the caller is the clock, the line and the EEPROM.
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

pub use drivetwin_protocol::line::Line;
pub use drivetwin_protocol::modbus::DropReason;
use drivetwin_protocol::modbus::server::Outcome;
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
    /// Place in [`Spec::ports`].
    Port,
    /// Place in [`Spec::pins`].
    Pin,
    /// Place in [`Spec::axes`].
    Axis,
    /// Place in [`Spec::encoders`].
    Encoder,
    /// Place in [`Spec::faults`].
    Fault,
    /// A TCP connection of a port; numbers are used again, but never while open.
    Link,
}

/// A voltage above this, in mV, is a high level: the middle of TTL's 0.8 V and 2.0 V.
pub const HIGH_MV: i32 = 1_400;

/// A high level as a voltage, in mV; a low one is 0.
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

/// An input of a drive.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Input<'a> {
    /// Characters of a serial port. The stamp is the end of the first one's stop bit; the others follow back to back.
    /// More than one only where silence ends a frame ([`Framing::Silence`]), and nothing behind a line feed on a line
    /// of 7 data bits (Modbus ASCII); splitting them anywhere changes nothing.
    Bytes {
        /// Port.
        port: Port,
        /// The characters.
        bytes: &'a [u8],
    },
    /// A character with an error: parity, framing, overrun, collision, another baud rate.
    RxError {
        /// Port.
        port: Port,
    },
    /// The line has been silent long enough to end a frame (`--line fast`, a UART's idle interrupt).
    Idle {
        /// Port.
        port: Port,
    },
    /// The host opened or left the port (DTR; a pty opened or closed).
    HostPresence {
        /// Port.
        port: Port,
        /// True once a program is there.
        here: bool,
    },
    /// A client has connected to a TCP port. The number is the lowest that is free on that port.
    Opened {
        /// Port.
        port: Port,
        /// Which connection that is.
        link: Link,
    },
    /// A message on a TCP connection: a whole Modbus ADU; of MCode the bytes that came, cut behind the end of each
    /// line, as [`next_line`](drivetwin_protocol::text::next_line) does.
    Message {
        /// Port.
        port: Port,
        /// On which connection.
        link: Link,
        /// Bytes of the message.
        bytes: &'a [u8],
    },
    /// A TCP connection was closed, and not by the drive itself.
    Closed {
        /// Port.
        port: Port,
        /// Which.
        link: Link,
    },
    /// An input pin changed.
    Edge {
        /// Which.
        pin: Pin,
        /// To high.
        high: bool,
    },
    /// An input whose [idle level](PinSpec::idle) is [`Level::Float`] is no longer driven and not wired. Until its
    /// first event such a pin is open.
    Open {
        /// Which.
        pin: Pin,
    },
    /// An analogue input changed.
    Millivolts {
        /// Which.
        pin: Pin,
        /// Voltage in mV.
        mv: i32,
    },
    /// Quarter cycles from a counter in hardware; boards only, instead of edges.
    Count {
        /// Which encoder.
        encoder: Encoder,
        /// Steps since the last count, signed.
        steps: i32,
        /// Channel A now.
        a: bool,
        /// Channel B now.
        b: bool,
    },
    /// The cause of a fault comes or goes.
    Fault {
        /// Which.
        fault: Fault,
        /// True while the cause is present.
        on: bool,
    },
    /// Current limit, to a motor: as [`Output::CurrentLimit`].
    CurrentLimit {
        /// Which axis.
        axis: Axis,
        /// Peak current in mA; 0 opens the terminals.
        ma: u32,
    },
    /// Duty, to a motor: as [`Output::Duty`].
    Duty {
        /// Which axis.
        axis: Axis,
        /// Duty in 1/65536 of the supply, signed.
        duty: i32,
    },
    /// The motor on an axis draws another current.
    MotorCurrent {
        /// Which axis.
        axis: Axis,
        /// In mA, signed as the duty is: what brakes it has the other sign.
        ma: i32,
    },
    /// The motor on an axis is this one from the stamp on: what the drive's control loop computes with.
    Motor {
        /// Which axis.
        axis: Axis,
        /// Winding, rotor, supply and load.
        parameters: &'a Parameters,
    },
    /// Rotation of the motor on an axis from the stamp on. The drive's control loop uses it between two edges of its
    /// sensors.
    Rotation {
        /// Which axis.
        axis: Axis,
        /// Angle, speed and acceleration at the stamp.
        rotation: Rotation,
    },
    /// Plan of the drive's axis, to a stepper motor: as [`Output::Plan`].
    Plan {
        /// Which axis.
        axis: Axis,
        /// In steps of the drive.
        plan: &'a Plan,
    },
    /// Steps without a ramp, to a stepper motor: as [`Output::Step`].
    Step {
        /// Which axis.
        axis: Axis,
        /// Number of steps, signed.
        steps: i32,
    },
    /// A board started a plan late, so that it made this many steps more than the plan; never in the simulator.
    StepsCorrection {
        /// Which axis.
        axis: Axis,
        /// Steps more, signed.
        steps: i32,
    },
}

/// An output of a drive.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Output<'a> {
    /// Characters to send from the stamp on, back to back at the line's rate; the caller paces them. The stamp may lie
    /// ahead: a reply delay.
    Bytes {
        /// Port.
        port: Port,
        /// The characters.
        bytes: &'a [u8],
    },
    /// A message on a TCP connection.
    Message {
        /// Port.
        port: Port,
        /// On which connection.
        link: Link,
        /// The message.
        bytes: &'a [u8],
    },
    /// The drive closes a TCP connection.
    Close {
        /// Port.
        port: Port,
        /// Which.
        link: Link,
    },
    /// The line from the next character on: after all [`Output::Bytes`] put before it have left.
    Line {
        /// Port.
        port: Port,
        /// The new settings.
        line: Line,
    },
    /// An output pin takes a level.
    Level {
        /// Which.
        pin: Pin,
        /// The level.
        level: Level,
    },
    /// An output pin repeats from the stamp on, until its next output: high for `high`, low for the rest of `period`.
    /// LEDs, PWM, clocks; no edge wakes the drive.
    Wave {
        /// Which.
        pin: Pin,
        /// Time of a cycle, not zero.
        period: Duration,
        /// High at its beginning.
        high: Duration,
    },
    /// Plan of an axis from the stamp on.
    Plan {
        /// Which.
        axis: Axis,
        /// Position at any instant from now on.
        plan: &'a Plan,
    },
    /// Steps at the stamp, without a ramp (step/direction input).
    Step {
        /// Which axis.
        axis: Axis,
        /// Number of steps, signed.
        steps: i32,
    },
    /// Current limit of the motor.
    CurrentLimit {
        /// Which axis.
        axis: Axis,
        /// Peak current in mA; 0 opens the terminals.
        ma: u32,
    },
    /// Duty of a motor without steps.
    Duty {
        /// Which axis.
        axis: Axis,
        /// Duty in 1/65536, signed; 0 shorts the terminals.
        duty: i32,
    },
    /// Current that a motor draws from now on, from a motor.
    MotorCurrent {
        /// Which axis.
        axis: Axis,
        /// In mA, signed as the duty is.
        ma: i32,
    },
    /// Parameters of a motor, put at power-on and when they change.
    Motor {
        /// Which axis.
        axis: Axis,
        /// Winding, rotor, supply and load.
        parameters: &'a Parameters,
    },
    /// Rotation of a motor's shaft from the stamp on.
    Rotation {
        /// Which axis.
        axis: Axis,
        /// Angle, speed and acceleration at the stamp.
        rotation: Rotation,
    },
    /// Bytes of the non-volatile memory. A power cut leaves any prefix of them.
    Store {
        /// Offset of the first byte.
        offset: u16,
        /// The bytes.
        bytes: &'a [u8],
    },
    /// For logs and statistics; nothing depends on it.
    Log(LogEvent),
}

/// A note for a log.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum LogEvent {
    /// A request was carried out.
    Request {
        /// Port.
        port: Port,
        /// The address it was for.
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

/// Destination of a drive's outputs, and its non-volatile memory.
pub trait Context {
    /// `output` holds from `at` on. Stamps are those of the call they are put in, except where the docs of [`Output`]
    /// allow them to lie ahead.
    fn put(&mut self, at: Instant, output: Output<'_>);

    /// The non-volatile memory, [`Spec::memory`] bytes, as every `Store` so far left it. A new one is
    /// all `0xFF`.
    fn memory(&self) -> &[u8];
}

/// A sink that drops all outputs and has no memory.
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
    /// Seed of every random choice.
    pub seed: u64,
    /// No start-up delay.
    pub fast: bool,
    /// Characters take no time on its serial lines (`--line fast`): they have left as soon as they are sent.
    pub fast_line: bool,
}

/// Reason why a register cannot be preset.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum PresetError {
    /// There is no such row.
    NoSuchRegister,
    /// The register cannot be preset.
    ReadOnly,
    /// The row does not accept the value.
    OutOfRange,
    /// The saved values cannot be changed, because the memory is bad.
    BadMemory,
    /// Not now, because of what the drive does.
    Busy,
}

/// End of a message on a port.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Framing {
    /// By 3.5 characters of silence (Modbus RTU), or, on a line of 7 data bits, by a line feed (Modbus
    /// ASCII).
    Silence,
    /// By a character that the drive knows: it wants each one at its time.
    Character,
    /// By the length in its header (Modbus/TCP).
    Mbap,
    /// By a carriage return or a line feed, on a TCP connection (MCode).
    Return,
}

/// A port of a drive.
#[derive(Clone, Copy, Debug)]
pub struct PortSpec {
    /// Name, as users type it.
    pub name: &'static str,
    /// End of its messages.
    pub framing: Framing,
    /// The factory line of a serial port; `None` for TCP.
    pub line: Option<Line>,
}

impl PortSpec {
    /// Returns whether it takes TCP connections, and is no serial port.
    #[must_use]
    pub fn is_tcp(&self) -> bool {
        self.line.is_none()
    }
}

/// Role of a pin.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Role {
    /// The drive reads it.
    Input,
    /// The drive drives it.
    Output,
    /// Input or output, as the registers select.
    Both,
    /// An analogue input.
    Analogue,
    /// Read as a level or as a voltage: the drive gets edges of a pin that is driven low, high or not at all, and the
    /// voltage of a pin that is driven to one.
    AnalogueOrDigital,
    /// A light.
    Led,
}

/// A pin of a drive.
#[derive(Clone, Copy, Debug)]
pub struct PinSpec {
    /// The manual's name.
    pub name: &'static str,
    /// Role.
    pub role: Role,
    /// Idle level, while the pin is not driven. With `Float` the drive distinguishes a contact that is not wired
    /// ([`Input::Open`]) from an open contact (high, once a wire leads there).
    pub idle: Level,
    /// The pin idles high, whatever `idle` is, once a wire or a switch is connected or a user has set it: a contact
    /// that counts as closed until it is used.
    pub high_once_used: bool,
    /// Shunt of an analogue input that can measure a current, in Ω; 0 of one that cannot.
    pub shunt_ohm: u16,
}

impl PinSpec {
    /// A pin that measures no current, with the idle level `idle`.
    #[must_use]
    pub const fn new(name: &'static str, role: Role, idle: Level) -> Self {
        Self { name, role, idle, high_once_used: false, shunt_ohm: 0 }
    }

    /// Returns whether the drive distinguishes a contact that is not wired, by [`Input::Open`].
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
    /// The pins that carry its step pulses and its direction. Where they are [`Role::Both`], a plan takes
    /// them, low until its first step; a level or a wave put at one of them takes that one back.
    pub step_dir: Option<(Pin, Pin)>,
}

/// An encoder input of a drive.
#[derive(Clone, Copy, Debug)]
pub struct EncoderSpec {
    /// Channel A.
    pub a: Pin,
    /// Channel B.
    pub b: Pin,
    /// The index; `None` if the drive does not look at one.
    pub index: Option<Pin>,
}

/// A code that one of its registers takes for a command.
#[derive(Clone, Copy, Debug)]
pub struct CommandSpec {
    /// The code.
    pub code: u16,
    /// The manual's name.
    pub name: &'static str,
    /// The section of the manual.
    pub section: &'static str,
    /// Effect, also if it is not modelled.
    pub doc: &'static str,
    /// Reason why it is not modelled; empty if it is.
    pub missing: &'static str,
}

/// Description of a kind of drive.
#[derive(Debug)]
pub struct Spec {
    /// The kind, as users type it.
    pub kind: &'static str,
    /// The product.
    pub product: &'static str,
    /// The manual that it follows.
    pub manual: &'static str,
    /// Ports.
    pub ports: &'static [PortSpec],
    /// Pins.
    pub pins: &'static [PinSpec],
    /// Other names of some of them.
    pub aliases: &'static [(&'static str, Pin)],
    /// Axes.
    pub axes: &'static [AxisSpec],
    /// Encoder inputs.
    pub encoders: &'static [EncoderSpec],
    /// The faults its manual knows, as users type them.
    pub faults: &'static [&'static str],
    /// Bytes of its non-volatile memory.
    pub memory: u16,
    /// Registers, with those of all variants of the product.
    pub registers: &'static Table,
    /// Which variant it is, as in [`Entry::variants`](drivetwin_protocol::registers::Entry::variants).
    pub variant: u8,
    /// True if its manual counts registers in decimal, and not in hexadecimal.
    pub decimal: bool,
    /// Prefix of register names in the manual, which users may type.
    pub prefix: &'static str,
    /// Commands, where a row alone does not list them.
    pub commands: &'static [CommandSpec],
    /// The row that holds its bus address.
    pub address: Option<usize>,
    /// The row that shows what feeds it, and its motor, in 0.1 V; a bench sets it at each power-on.
    pub supply: Option<usize>,
    /// The row and its bit that select a brush motor instead of a stepper; `None` if the drive has no such choice.
    pub dc_motor: Option<(usize, u16)>,
    /// Limits of the model that no row states.
    pub not_modelled: &'static [&'static str],
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
        commands: &[],
        address: None,
        supply: None,
        dc_motor: None,
        not_modelled: &[],
    };

    /// The pin of that name, which may be another one than [`PinSpec::name`].
    #[must_use]
    pub fn pin(&self, name: &str) -> Option<Pin> {
        self.pin_names().find_map(|(known, pin)| (known == name).then_some(pin))
    }

    /// All names of pins.
    pub fn pin_names(&self) -> impl Iterator<Item = (&'static str, Pin)> + Clone + use<> {
        let own = (0..).map(Pin).zip(self.pins).map(|(pin, spec)| (spec.name, pin));
        own.chain(self.aliases.iter().copied())
    }

    /// Returns whether it is reached by TCP alone.
    #[must_use]
    pub fn is_on_network(&self) -> bool {
        !self.ports.is_empty() && self.ports.iter().all(PortSpec::is_tcp)
    }

    /// The rows that this variant of the product has, and their places in the table.
    pub fn rows(&self) -> impl DoubleEndedIterator<Item = (usize, &'static Row)> + Clone + use<> {
        let variant = self.variant;
        self.registers.rows.iter().enumerate().filter(move |(_, row)| row.variants & variant != 0)
    }

    /// Finds a register by its name, with the prefix or without, if this variant of the product has it.
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
    /// Position in counts: each edge of its Hall sensors is one, 4 a pulse of two sensors and 6 of three, also for a
    /// drive that uses one sensor or none; wraps.
    pub position: i32,
    /// Counts per second, signed.
    pub speed: I48F16,
    /// Duty of the supply, in 1/65536, signed.
    pub duty: i32,
    /// Current in mA, signed as the duty is.
    pub ma: i32,
}

/// A drive, or anything else that sits on a bench.
pub trait Device {
    /// Description of its kind.
    fn spec(&self) -> &'static Spec;

    /// Power comes: everything volatile is forgotten. Also how a drive restarts itself.
    fn power_on(&mut self, at: Instant, boot: Boot, out: &mut dyn Context);

    /// Handles an input.
    fn input(&mut self, at: Instant, input: Input<'_>, out: &mut dyn Context);

    /// Returns whether a TCP port accepts connections; only an input or a timeout changes it.
    fn accepts(&self, _port: Port) -> bool {
        true
    }

    /// Returns whether it takes messages on the connections of a TCP port; only an input or a timeout changes it. Until
    /// it does a message, or the end of a connection, waits outside.
    fn takes(&self, _port: Port) -> bool {
        true
    }

    /// Next wake-up; [`Instant::NEVER`] if only an input can change anything.
    fn deadline(&self) -> Instant;

    /// Wakes the drive. At an instant that is not its deadline nothing happens.
    fn timeout(&mut self, at: Instant, out: &mut dyn Context);

    /// A register as it reads at `at`, without the bus's side effects; 0 for a row that is not there. Of more than four
    /// words the first four count.
    fn peek(&self, at: Instant, row: usize) -> i64;

    /// A word, counted in bus order, of a row of more than four words, which no number holds; 0 for one that is not
    /// there.
    fn peek_word(&self, _at: Instant, _row: usize, _word: usize) -> u16 {
        0
    }

    /// Presets a register, past the bus. Before the first `power_on` a saved row goes into the
    /// memory, as if written and saved; afterwards the value acts as if the bus had written it.
    ///
    /// # Errors
    /// The row refuses it; nothing has changed then.
    fn poke(&mut self, at: Instant, row: usize, value: i64, out: &mut dyn Context)
    -> Result<(), PresetError>;

    /// State of the motor on an axis; `None` where a plan has it, or it is unknown.
    fn shaft(&self, _at: Instant, _axis: Axis) -> Option<Shaft> {
        None
    }

    /// The motor of its own, one of duty, as its registers describe it now; `None` if it brings none.
    fn internal_motor(&self) -> Option<crate::motor::Parameters> {
        None
    }

    /// Detaches [the internal motor](Self::internal_motor). Call before the first power-on. Afterwards current limit
    /// and duty are outputs, and the motor's feedback is an input. Returns the pins for its Hall sensors, A first;
    /// `None` if there is no internal motor.
    fn detach_motor(&mut self) -> Option<&'static [Pin]> {
        None
    }

    /// Steps of its plans in a full step of the motor.
    fn microsteps(&self, _axis: Axis) -> u16 {
        1
    }
}

/// A device by reference.
impl<D: Device + ?Sized> Device for &mut D {
    fn spec(&self) -> &'static Spec {
        (**self).spec()
    }

    fn power_on(&mut self, at: Instant, boot: Boot, out: &mut dyn Context) {
        (**self).power_on(at, boot, out);
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
}

/// Brings `device` to `now` and returns its next deadline.
///
/// Stamps of `inputs` ascend and are not after `now`. An input comes before a deadline at the same
/// instant. Being called late changes latency, never what happens.
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

/// Carries out one input of [`advance`]: the deadlines before it, of which `due` is the first, then `input`. Returns
/// the next deadline. For callers that cannot lend all inputs at once.
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

/// Wakes `device` at its deadlines, of which `due` is the first, before `now`, and at `now` if `inclusive`.
/// Returns the next one.
pub(crate) fn wake<D: Device + ?Sized>(
    device: &mut D,
    mut due: Instant,
    now: Instant,
    inclusive: bool,
    out: &mut dyn Context,
) -> Instant {
    while due < now || (due == now && inclusive && due != Instant::NEVER) {
        device.timeout(due, out);
        due = device.deadline();
    }
    due
}
