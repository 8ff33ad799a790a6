//! US Digital QSB: an adapter from an encoder to a serial port, with an LS7366R inside.
//!
//! Follows the *QSB Command List* 1.28; words in capitals are the titles of its registers. There are three
//! variants: the QSB-D for a differential encoder, with one digital line; the QSB-S for a single-ended
//! encoder; the QSB-M like the QSB-S, with four digital lines, two of which may step a motor.

mod adapter;
mod clock;
mod command;
mod encoder;
mod fields;
mod instrument;
mod motor;
mod port;
mod reasons;
mod registers;
mod saved;
mod serial;
mod stream;
#[cfg(test)]
mod tests;

use drivetwin_protocol::registers::{Bank, Register};

use self::adapter::Adapter;
pub use self::registers::Reg;
use self::registers::{D, M, S, Variant};
use crate::device::{
    Axis, AxisSpec, Boot, Context, Device, EncoderSpec, Framing, Input, Instant, Level, Pin, PinSpec, Port,
    PortSpec, PresetError, Role, Spec, Writes, reported,
};
use crate::memory;

const USB: Port = Port(0);
const AXIS: Axis = Axis(0);
/// Channel A. A PWM or analogue encoder also connects here.
const A: Pin = Pin(0);
const B: Pin = Pin(1);
const I: Pin = Pin(2);
const DIO0: Pin = Pin(3);
const DIO1: Pin = Pin(4);
const DIO2: Pin = Pin(5);
const DIO3: Pin = Pin(6);
/// The lines of the digital port, from bit 0 on.
const DIO: [Pin; 4] = [DIO0, DIO1, DIO2, DIO3];

/// The registers of a QSB.
type Words = Bank<Reg, { Reg::WORDS }>;

/// Bytes of the non-volatile memory.
pub const MEMORY: usize = memory::bytes(Reg::SAVED_WORDS) as usize;

const fn pin(name: &'static str, role: Role, idle: Level) -> PinSpec {
    PinSpec::new(name, role, idle)
}

/// Each variant has the first pins of this list: the QSB-S three, the QSB-D four, the QSB-M all.
#[rustfmt::skip]
static PINS: [PinSpec; 7] = [
    pin("A", Role::AnalogueOrDigital, Level::High),
    pin("B", Role::Input, Level::High),
    pin("I", Role::Input, Level::Low),
    pin("DIO0", Role::Both, Level::High),
    pin("DIO1", Role::Both, Level::High),
    pin("DIO2", Role::Both, Level::High),
    pin("DIO3", Role::Both, Level::High),
];

static WITHOUT_MOTOR: Writes = Writes {
    refuses: |row, value| row == Reg::Command as usize && adapter::is_for_motor(value),
    ..Writes::OF_ROWS
};

static QSB_D: Spec = spec("qsb-d", "US Digital QSB-D encoder to USB adapter, differential", D);
static QSB_M: Spec = spec("qsb-m", "US Digital QSB-M encoder to USB adapter with motor drive", M);
static QSB_S: Spec = spec("qsb-s", "US Digital QSB-S encoder to USB adapter, single-ended", S);

/// The limits of the model for all variants, each with its reason.
static NOT_MODELLED: [&str; 4] = [
    "DTR low: a real QSB stays in reset; here only the opening of the port (DTR high) resets it",
    "RTS: a QSB does not use it",
    "a PWM or analogue encoder on a shaft: an [[encoder]] makes A, B and index only; the control API sets a \
     PWM signal or a voltage at A",
    "noise of a PWM or analogue encoder: duty and voltage are measured exactly",
];

/// Returns the description of one variant.
const fn spec(kind: &'static str, product: &'static str, variant: Variant) -> Spec {
    let (pins, _) = PINS.split_at(DIO0.0 as usize + variant.lines.count_ones() as usize);
    Spec {
        kind,
        product,
        manual: "QSB Command List 1.28",
        ports: &[PortSpec { name: "usb", framing: Framing::Character, line: Some(registers::FACTORY_LINE) }],
        pins,
        aliases: &[("PWM", A), ("ANALOG", A)],
        axes: if variant.motor { &[AxisSpec { name: "motor", step_dir: Some((DIO1, DIO2)) }] } else { &[] },
        encoders: &[EncoderSpec { a: A, b: B, index: Some(I) }],
        memory: MEMORY as u16,
        registers: Reg::TABLE,
        variant: variant.bit,
        writes: if variant.motor { None } else { WITHOUT_MOTOR.reported() },
        reasons: reasons::REASONS,
        not_modelled: reported(&NOT_MODELLED),
        ..Spec::EMPTY
    }
}

/// A QSB.
#[derive(Clone, Debug)]
pub struct Qsb {
    spec: &'static Spec,
    adapter: Adapter,
}

impl Qsb {
    /// A QSB-D without power.
    #[must_use]
    pub fn d() -> Self {
        Self::of(&QSB_D, D)
    }

    /// A QSB-M without power.
    #[must_use]
    pub fn m() -> Self {
        Self::of(&QSB_M, M)
    }

    /// A QSB-S without power.
    #[must_use]
    pub fn s() -> Self {
        Self::of(&QSB_S, S)
    }

    fn of(spec: &'static Spec, variant: Variant) -> Self {
        Self { spec, adapter: Adapter::new(variant) }
    }
}

impl Device for Qsb {
    fn spec(&self) -> &'static Spec {
        self.spec
    }

    fn power_on(&mut self, at: Instant, boot: Boot, out: &mut dyn Context) {
        self.adapter.power_on(at, boot, out);
    }

    fn power_off(&mut self, _at: Instant) {
        self.adapter.power_off();
    }

    fn input(&mut self, at: Instant, input: Input<'_>, out: &mut dyn Context) {
        self.adapter.input(at, input, out);
    }

    fn receives_from(&self) -> Instant {
        self.adapter.receives_from()
    }

    fn deadline(&self) -> Instant {
        self.adapter.deadline()
    }

    fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        self.adapter.timeout(at, out);
    }

    fn peek(&self, at: Instant, row: usize) -> i64 {
        self.adapter.peek(at, row)
    }

    fn poke(
        &mut self,
        at: Instant,
        row: usize,
        value: i64,
        out: &mut dyn Context,
    ) -> Result<(), PresetError> {
        self.adapter.poke(at, row, value, out)
    }
}
