//! The pins of J2 and J3: their levels and functions (7.8), and `IOPortData` (7.9).

use super::homing::{Homing, Target};
use super::{J2_4, J2_5, J2_9, J2_10, J2_12, J3_8, open_drain};
use crate::counter::Channel;
use crate::device::{Context, Instant, Level, Output, Pin};

/// Bits of J2 and J3 pins in `IOPortData`. The polarities of J2 pins 2 to 5 in `PinFunctionAndPolarity` are at the
/// same bits.
const BIT_3_8: u8 = 1 << 7;
const BIT_9: u8 = 1 << 6;
const BIT_10: u8 = 1 << 5;
const BIT_12: u8 = 1 << 4;
const BIT_2: u8 = 1 << 3;
const BIT_3: u8 = 1 << 2;
const BIT_4: u8 = 1 << 1;
const BIT_5: u8 = 1 << 0;
/// Pins that are always inputs.
const INPUTS: u8 = BIT_2 | BIT_3 | BIT_4 | BIT_5;
/// Pins that are inputs or outputs.
const GPIO: u8 = BIT_9 | BIT_10 | BIT_12;
/// The bit of `Pin(n)`, for the pins that are always or sometimes inputs.
const BITS: [u8; 7] = [BIT_2, BIT_3, BIT_4, BIT_5, BIT_9, BIT_10, BIT_12];

/// Bit of `PinFunctionAndPolarity`: J2 pins 9, 10 and 12 are outputs, and no encoder inputs. The manual's name
/// of the bit says the opposite.
const OUTPUTS: u16 = 1 << 12;

/// A new level of a pin.
#[derive(Clone, Copy, Debug)]
pub(super) enum Edge {
    /// Of J2 pin 2 or 3.
    Function,
    /// Of J2 pin 4 or 5, with its request.
    Request(Option<Request>),
    /// Of J2 pin 9, 10 or 12.
    Encoder(Channel),
}

/// Effects of new levels, polarities or functions of J2 pins 2 to 5, in this order. A new polarity is an
/// edge if it changes the pin between active and inactive (MD3-19).
#[derive(Clone, Copy, Debug)]
pub(super) struct Changes {
    /// A pin became active or inactive: the drive is not quiet.
    pub(super) has_edges: bool,
    /// The previous function of pins 4 and 5.
    pub(super) mode_before: Mode,
    /// SPEEDSEL selects the other speed.
    pub(super) selects_speed: bool,
    /// The function of pin 3 that has become active. HOME does so only by an edge.
    pub(super) begins: Pin3,
    /// Request of pins 4 and 5.
    pub(super) request: Option<Request>,
}

/// Request of an edge at pin 4 or 5.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Request {
    Step {
        backward: bool,
    },
    Profile {
        reversed: bool,
    },
    Home,
    /// A jog, or its end: see [`Io::jog`].
    Jog,
}

/// Function of pin 2.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Pin2 {
    /// The home sensor's flag.
    Flag,
    /// LOWCURRENT: while it is active, the motor gets the cutback current.
    LowCurrent,
    /// SPEEDSEL: while it is active, `AlternateSpeed` applies.
    SpeedSelect,
    /// "Invalid": the pin has no effect.
    None,
}

/// Function of pin 3.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Pin3 {
    /// INHIBIT: while it is active, the motor has no current.
    Inhibit,
    /// HOME: a home cycle starts when it becomes active.
    Home,
    /// `INHIBIT_MODBUS_MOTION`: while it is active, the bus cannot start motion.
    InhibitModbus,
    /// "Invalid": the pin has no effect.
    None,
}

/// Functions of pins 4 and 5, in the order of the codes. If pin 5 is the direction, active means reversed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Mode {
    /// 0000: a step when pin 4 becomes active; pin 5 is the direction.
    StepDirection,
    /// 0001: a profile move when pin 4 becomes active; pin 5 is the direction.
    MoveDirection,
    /// 0010: a profile move when pin 4 becomes active, the reversed move when pin 4 becomes inactive.
    MoveForwardBackward,
    /// 0011: a profile move when pin 4 becomes active, a home cycle when pin 4 becomes inactive.
    MoveThenHome,
    /// 0100: a profile move when pin 4 becomes active, the reversed move when pin 5 becomes active.
    MoveEitherWay,
    /// 0101: a profile move when pin 4 becomes active, a home cycle when pin 5 becomes active.
    MoveOrHome,
    /// 0110: a jog while pin 4 is active; pin 5 is the direction.
    JogDirection,
    /// 0111: a jog while pin 4 is active, a reversed jog while pin 5 is active.
    JogEitherWay,
    /// 1000: profile moves forward and backward, endlessly.
    EndlessMoves,
    /// 1001: a profile move and a home cycle, endlessly.
    EndlessHomes,
    /// 1111 and the codes that the manual does not print: no function.
    None,
}

impl Mode {
    /// Returns true if a motion may begin without an edge: by a level, or after another motion.
    pub(super) fn moves_by_itself(self) -> bool {
        matches!(self, Self::JogDirection | Self::JogEitherWay | Self::EndlessMoves | Self::EndlessHomes)
    }
}

/// The values of `PinFunctionAndPolarity` and `HomingConfiguration`, decoded.
#[derive(Clone, Copy, Debug)]
struct Functions {
    /// Bits of J2 pins 2 to 5, as in `IOPortData`, that are active high.
    polarity: u8,
    pin_2: Pin2,
    pin_3: Pin3,
    mode: Mode,
    /// True if J2 pins 9, 10 and 12 are outputs, and no encoder inputs.
    has_outputs: bool,
    /// The target of a home cycle.
    target: Option<Target>,
}

impl Functions {
    /// The functions for a stepper or a DC motor.
    fn new(function: u16, homing: Homing, dc: bool) -> Self {
        let target = homing.target();
        let pin_2 = match (target, function >> 10 & 3) {
            // While homing searches for the flag, pin 2 is the flag, whatever its function (MD3-18).
            (Some(Target::Flag), _) => Pin2::Flag,
            (_, 0) => Pin2::LowCurrent,
            (_, 1) => Pin2::SpeedSelect,
            _ => Pin2::None,
        };
        let pin_3 = match function >> 8 & 3 {
            0 => Pin3::Inhibit,
            1 => Pin3::Home,
            2 => Pin3::InhibitModbus,
            _ => Pin3::None,
        };
        let mode = match function >> 4 & 0xF {
            0b0110 => Mode::JogDirection,
            0b0111 => Mode::JogEitherWay,
            // A DC motor: "0110 or 0111 are the only allowed options."
            _ if dc => Mode::None,
            0b0000 => Mode::StepDirection,
            0b0001 => Mode::MoveDirection,
            0b0010 => Mode::MoveForwardBackward,
            0b0011 => Mode::MoveThenHome,
            0b0100 => Mode::MoveEitherWay,
            0b0101 => Mode::MoveOrHome,
            0b1000 => Mode::EndlessMoves,
            0b1001 => Mode::EndlessHomes,
            _ => Mode::None,
        };
        Self {
            polarity: function as u8 & INPUTS,
            pin_2,
            pin_3,
            mode,
            has_outputs: function & OUTPUTS != 0,
            target,
        }
    }
}

/// The pins of J2 and J3.
#[derive(Clone, Debug)]
pub(super) struct Io {
    functions: Functions,
    /// Levels of the pins of [`BITS`], as bits of `IOPortData`.
    levels: u8,
    /// Inputs that were active when they were last polled.
    active: u8,
    /// Value last written to `IOPortData`.
    written: u16,
}

impl Io {
    /// The pins without connections.
    pub(super) fn new() -> Self {
        let functions = Functions::new(0, Homing::ZERO, false);
        Self { functions, levels: INPUTS, active: 0, written: 0 }
    }

    /// Sets the level of a pin. Returns the pin's kind if the level is new.
    pub(super) fn edge(&mut self, pin: Pin, high: bool) -> Option<Edge> {
        let &bit = BITS.get(usize::from(pin.0))?;
        let levels = if high { self.levels | bit } else { self.levels & !bit };
        if levels == self.levels {
            return None;
        }
        self.levels = levels;
        Some(match pin {
            J2_9 => Edge::Encoder(Channel::Index),
            J2_10 => Edge::Encoder(Channel::A),
            J2_12 => Edge::Encoder(Channel::B),
            J2_4 | J2_5 => {
                let before = self.active;
                self.note_active();
                Edge::Request(self.request(self.active ^ before))
            }
            _ => Edge::Function,
        })
    }

    /// Sets the levels of the encoder's channels, which a board counts.
    pub(super) fn set_channels(&mut self, a: bool, b: bool) {
        let channels = if a { BIT_10 } else { 0 } | if b { BIT_12 } else { 0 };
        self.levels = self.levels & !(BIT_10 | BIT_12) | channels;
    }

    /// Applies `PinFunctionAndPolarity` and `HomingConfiguration`, for a stepper or a DC motor. Returns what follows.
    pub(super) fn configure(&mut self, function: u16, homing: Homing, dc: bool) -> Changes {
        self.change(Functions::new(function, homing, dc))
    }

    /// Returns what follows from the present levels.
    pub(super) fn poll(&mut self) -> Changes {
        self.change(self.functions)
    }

    #[inline]
    fn change(&mut self, functions: Functions) -> Changes {
        let (active, mode_before) = (self.active, self.functions.mode);
        let (before_2, before_3) = (self.pin_2(), self.pin_3());
        self.functions = functions;
        self.note_active();
        let edges = self.active ^ active;
        Changes {
            has_edges: edges != 0,
            mode_before,
            selects_speed: self.selects_alternate() != (before_2 == Pin2::SpeedSelect),
            begins: match self.pin_3() {
                same if same == before_3 => Pin3::None,
                Pin3::Home if edges & BIT_3 == 0 => Pin3::None,
                begins => begins,
            },
            request: self.request(edges),
        }
    }

    fn note_active(&mut self) {
        // An input is active low unless its polarity is inverted.
        self.active = !(self.levels ^ self.functions.polarity) & INPUTS;
    }

    /// The function of pin 2 while it is active.
    fn pin_2(&self) -> Pin2 {
        if self.active & BIT_2 != 0 { self.functions.pin_2 } else { Pin2::None }
    }

    /// The function of pin 3 while it is active.
    fn pin_3(&self) -> Pin3 {
        if self.active & BIT_3 != 0 { self.functions.pin_3 } else { Pin3::None }
    }

    /// The request of these edges at pins 4 and 5.
    fn request(&self, edges: u8) -> Option<Request> {
        if edges & (BIT_4 | BIT_5) == 0 {
            return None;
        }
        let fell = |pin| edges & self.active & pin != 0;
        let (fell_4, fell_5) = (fell(BIT_4), fell(BIT_5));
        let rose_4 = edges & !self.active & BIT_4 != 0;
        // While pin 5 is inactive, the sign of the register is the direction (MD3-20).
        let pin_5 = self.active & BIT_5 != 0;
        let profile = |starts: bool, reversed| starts.then_some(Request::Profile { reversed });
        let home = |starts: bool| starts.then_some(Request::Home);
        match self.functions.mode {
            Mode::StepDirection => fell_4.then_some(Request::Step { backward: pin_5 }),
            Mode::JogDirection | Mode::JogEitherWay => Some(Request::Jog),
            Mode::MoveDirection => profile(fell_4, pin_5),
            Mode::MoveForwardBackward => profile(fell_4 || rose_4, rose_4),
            Mode::MoveThenHome => profile(fell_4, false).or(home(rose_4)),
            Mode::MoveEitherWay => profile(fell_4 || fell_5, !fell_4),
            Mode::MoveOrHome => profile(fell_4, false).or(home(fell_5)),
            Mode::EndlessMoves | Mode::EndlessHomes | Mode::None => None,
        }
    }

    /// Returns true if J2 pins 9, 10 and 12 are outputs, and no encoder inputs.
    pub(super) fn has_outputs(&self) -> bool {
        self.functions.has_outputs
    }

    /// The function of pins 4 and 5.
    pub(super) fn mode(&self) -> Mode {
        self.functions.mode
    }

    /// Direction in which pins 4 and 5 request a jog: true for reversed, `None` if they request none.
    /// `is_reversed` is the direction of the running jog.
    pub(super) fn jog(&self, is_reversed: bool) -> Option<bool> {
        let (pin_4, pin_5) = (self.active & BIT_4 != 0, self.active & BIT_5 != 0);
        match (self.functions.mode, pin_4, pin_5) {
            (Mode::JogDirection, true, reversed) => Some(reversed),
            // If both pins are active, a running jog keeps its direction; from standstill pin 4 decides.
            (Mode::JogEitherWay, true, true) => Some(is_reversed),
            (Mode::JogEitherWay, true, false) => Some(false),
            (Mode::JogEitherWay, false, true) => Some(true),
            _ => None,
        }
    }

    /// Returns true if the target of a home cycle is present.
    pub(super) fn is_at_target(&self) -> bool {
        match self.functions.target {
            Some(Target::Flag) => self.active & BIT_2 != 0,
            // "Active high encoder index pulse on J2 pin 9" (MD3-27)
            Some(Target::Index) => self.levels & BIT_9 != 0 && !self.functions.has_outputs,
            None => false,
        }
    }

    /// Returns true while LOWCURRENT is active.
    pub(super) fn lowers_current(&self) -> bool {
        self.pin_2() == Pin2::LowCurrent
    }

    /// Returns true while SPEEDSEL selects `AlternateSpeed`.
    pub(super) fn selects_alternate(&self) -> bool {
        self.pin_2() == Pin2::SpeedSelect
    }

    /// Returns true while INHIBIT is active.
    pub(super) fn is_inhibited(&self) -> bool {
        self.pin_3() == Pin3::Inhibit
    }

    /// Returns true while `INHIBIT_MODBUS_MOTION` is active.
    pub(super) fn is_bus_inhibited(&self) -> bool {
        self.pin_3() == Pin3::InhibitModbus
    }

    /// Value of `IOPortData` when read: input pins read their level, output pins the written value (MD3-11).
    pub(super) fn value(&self) -> u16 {
        let inputs = INPUTS | if self.functions.has_outputs { 0 } else { GPIO };
        self.written & !u16::from(inputs) | u16::from(self.levels & inputs)
    }

    /// Value last written to `IOPortData`.
    pub(super) fn written(&self) -> u16 {
        self.written
    }

    /// Applies a write of `IOPortData`.
    pub(super) fn write(&mut self, at: Instant, word: u16, out: &mut dyn Context) {
        self.written = word;
        self.put_outputs(at, out);
    }

    /// Puts the levels of the outputs.
    pub(super) fn put_outputs(&self, at: Instant, out: &mut dyn Context) {
        out.put(at, Output::Level { pin: J3_8, level: open_drain(self.written & u16::from(BIT_3_8) != 0) });
        for (pin, bit) in [(J2_9, BIT_9), (J2_10, BIT_10), (J2_12, BIT_12)] {
            let level = match (self.functions.has_outputs, self.written & u16::from(bit) != 0) {
                (false, _) => Level::Float,
                (true, false) => Level::Low,
                (true, true) => Level::High,
            };
            out.put(at, Output::Level { pin, level });
        }
    }
}
