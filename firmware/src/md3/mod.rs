//! US Digital MD3: a stepper drive with a motion controller, on RS-485 with Modbus RTU.
//!
//! Follows the *MD3 User Guide V1.7*; numbers like 7.15 are its sections. There are two products: the high
//! current version, and the low current version of 1.8 A (7.2, 7.21). The model covers all of the guide
//! except what `NOT_MODELLED` lists.

mod current;
mod drive;
mod eeprom;
mod encoder;
mod fields;
mod homing;
mod io;
mod motion;
mod motor;
mod reasons;
mod registers;
mod startup;
#[cfg(test)]
mod tests;

use drivetwin_protocol::modbus::Frame;
use drivetwin_protocol::modbus::pdu::{Exception, READ_HOLDING_REGISTERS, WRITE_SINGLE_REGISTER};
use drivetwin_protocol::modbus::rtu::RtuReceiver;
use drivetwin_protocol::modbus::server::Rules;
use drivetwin_protocol::registers::{Bank, Register, Table};

use self::drive::Drive;
use self::registers::Version;
pub use self::registers::{Reg, line, motion_control};
use crate::device::{
    Axis, AxisSpec, Boot, Context, Device, Duration, EncoderSpec, Fault, Framing, Input, Instant, Level,
    Line, Pin, PinSpec, Port, PortSpec, PresetError, Role, Spec, reported,
};
use crate::memory;
use crate::modbus_port::{ModbusPort, is_reception};

const RS485: Port = Port(0);
const AXIS: Axis = Axis(0);
const OVER_TEMPERATURE: Fault = Fault(0);
const J2_4: Pin = Pin(2);
const J2_5: Pin = Pin(3);
const J2_9: Pin = Pin(4);
const J2_10: Pin = Pin(5);
const J2_12: Pin = Pin(6);
const BUSY: Pin = Pin(7);
const J3_8: Pin = Pin(8);
const STEP: Pin = Pin(9);
const DIR: Pin = Pin(10);
const RED: Pin = Pin(11);
const GREEN: Pin = Pin(12);

/// The registers of an MD3.
type Words = Bank<Reg, { Reg::WORDS }>;

/// Size of the EEPROM that holds the registers, in bytes.
pub const MEMORY: usize = memory::bytes(Reg::SAVED_WORDS) as usize;

const fn pin(name: &'static str, role: Role, idle: Level) -> PinSpec {
    PinSpec::new(name, role, idle)
}

/// Level of a transistor to ground: low if it is on.
fn open_drain(on: bool) -> Level {
    if on { Level::Low } else { Level::Float }
}

#[rustfmt::skip]
static PINS: [PinSpec; 13] = [
    pin("J2.2", Role::Input, Level::High),
    pin("J2.3", Role::Input, Level::High),
    pin("J2.4", Role::Input, Level::High),
    pin("J2.5", Role::Input, Level::High),
    pin("J2.9", Role::Both, Level::Low),
    pin("J2.10", Role::Both, Level::Low),
    pin("J2.12", Role::Both, Level::Low),
    pin("J3.7", Role::Output, Level::Float),
    pin("J3.8", Role::Output, Level::Float),
    pin("STEP", Role::Output, Level::Low),
    pin("DIR", Role::Output, Level::Low),
    pin("D5", Role::Led, Level::Low),
    pin("D6", Role::Led, Level::Low),
];

static HIGH_CURRENT: Spec = spec("md3", "US Digital MD3 stepper drive, 7 A", Reg::TABLE);
static LOW_CURRENT: Spec = spec("md3-low", "US Digital MD3 stepper drive, 1.8 A", &registers::LOW_TABLE);

static NOT_MODELLED: [&str; 14] = [
    "\"Reset Device\" and updates of firmware and serial number (3.2, 7.20): not published",
    "heat and short circuits (7.15): over_temperature and over_current occur only if set",
    "the supply (2): any voltage works, and a motor that brakes does not raise it",
    "delay and supply of the isolators (5.2): inputs act at once, without supply",
    "\"small timing deviations\" while many commands come (7.8): every step is at its tick",
    "a final velocity that \"may not match\" (7.15): it matches",
    "resonance, ringing, ripple of speed and current: a stepper follows its steps exactly, or is out of step",
    "the angle by which a load turns a shaft that is in step (up to a full step), and the momentum of a \
     shaft that falls out of step: it stops at once, then its load turns it",
    "detent torque: without current only friction holds the shaft of a [[motor]]",
    "a shaft without a [[motor]]: steps are only pulses at STEP and DIR, and turn no encoder",
    "inductance of a DC motor and its erratic running (7.2)",
    "a motor that does not fit the motor mode (7.2): it stands still",
    "a DC motor without a [[motor]], as on a board (7.2): the duty is a number",
    "memory of where the first index began (7.13): a shaft that reverses on the index counts it again",
];

/// Returns the description of one version. The versions differ only in the arguments.
const fn spec(kind: &'static str, product: &'static str, registers: &'static Table) -> Spec {
    Spec {
        kind,
        product,
        manual: "MD3 User Guide V1.7",
        ports: &[PortSpec { name: "rs485", framing: Framing::Silence, line: Some(registers::FACTORY_LINE) }],
        pins: &PINS,
        axes: &[AxisSpec { name: "motor", step_dir: Some((STEP, DIR)) }],
        encoders: &[EncoderSpec { a: J2_10, b: J2_12, index: Some(J2_9) }],
        faults: &["over_temperature", "over_current"],
        memory: MEMORY as u16,
        registers,
        address: Some(Reg::DeviceAddress as usize),
        dc_motor: Some((Reg::MotorCurrentAndMicrostepping as usize, motor::DC)),
        reasons: reasons::REASONS,
        rules: Some(&RULES),
        not_modelled: reported(&NOT_MODELLED),
        ..Spec::EMPTY
    }
}

/// The drive answers with exceptions 01 and 02 only (6.1, 6.2; MD3-1).
static RULES: Rules = Rules {
    functions: &[READ_HOLDING_REGISTERS, WRITE_SINGLE_REGISTER],
    broadcast: Some(0),
    max_read: 32,
    max_written: 1,
    bits_per_word: 16,
    partial_writes: true,
    bad_quantity: Exception::IllegalDataAddress,
    bad_value: Exception::IllegalDataAddress,
    read_only: Exception::IllegalDataAddress,
};

/// An MD3.
#[derive(Clone, Debug)]
pub struct Md3 {
    serial: ModbusPort<RtuReceiver>,
    drive: Drive,
}

impl Default for Md3 {
    fn default() -> Self {
        Self::new()
    }
}

impl Md3 {
    /// An MD3 of the high current version, without power.
    #[must_use]
    pub fn new() -> Self {
        Self::of(Version::HighCurrent)
    }

    /// An MD3 of the low current version, without power.
    #[must_use]
    pub fn low() -> Self {
        Self::of(Version::LowCurrent)
    }

    fn of(version: Version) -> Self {
        Self { serial: ModbusPort::new(RS485, registers::FACTORY_LINE), drive: Drive::new(version) }
    }

    /// Does what is due at `at`.
    // Inlined, because it comes before each received character.
    #[inline(always)]
    fn advance(&mut self, at: Instant, out: &mut dyn Context) {
        self.drive.timeout(at, out);
        if self.serial.is_over(at) {
            self.serve(at, out);
        }
    }

    /// Processes the received frame when it is complete.
    fn serve(&mut self, at: Instant, out: &mut dyn Context) {
        let setting = self.drive.serial_port();
        let unit = self.drive.address();
        let mut reply = Frame::new();
        let mut bus = self.drive.bus(at, out);
        let Some(outcome) = self.serial.serve(unit, &RULES, &mut bus, &mut reply) else { return };
        let sent = self.serial.answer(at, Duration::ZERO, outcome, &mut reply, out);
        if self.drive.serial_port() != setting {
            // The reply still uses the old line settings; the next frame is received with the new ones
            // (MODBUS-5).
            self.serial.set_line(at + self.serial.duration(sent), self.line(), out);
        }
    }

    /// The settings of the serial line that `SerialPortConfiguration` selects (7.22).
    fn line(&self) -> Line {
        registers::line(self.drive.serial_port())
    }
}

impl Device for Md3 {
    fn spec(&self) -> &'static Spec {
        match self.drive.version() {
            Version::HighCurrent => &HIGH_CURRENT,
            Version::LowCurrent => &LOW_CURRENT,
        }
    }

    fn power_on(&mut self, at: Instant, boot: Boot, out: &mut dyn Context) {
        let ready = self.drive.power_on(at, boot, out);
        self.serial.start(at, self.line(), ready, out);
    }

    fn power_off(&mut self, _at: Instant) {
        self.drive.power_off();
        self.serial.mute();
    }

    fn input(&mut self, at: Instant, input: Input<'_>, out: &mut dyn Context) {
        if is_reception(&input) {
            self.advance(at, out);
            if self.serial.input(at, &input, out) {
                self.serve(at, out);
            }
            return;
        }
        match input {
            Input::Edge { pin, high } => self.drive.edge(at, pin, high, out),
            Input::Count { steps, a, b, .. } => self.drive.count(steps, a, b),
            Input::Fault { fault, on } => self.drive.set_fault(at, fault, on, out),
            Input::StepsCorrection { steps, .. } => self.drive.correct_steps(steps),
            _ => {}
        }
    }

    fn receives_from(&self) -> Instant {
        self.serial.receives_from()
    }

    fn is_for_others(&self, at: Instant, _port: Port, address: u8) -> bool {
        self.serial.is_for_others(at, self.drive.address(), &RULES, address)
    }

    fn deadline(&self) -> Instant {
        self.drive.deadline().min(self.serial.deadline())
    }

    fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        self.advance(at, out);
    }

    fn peek(&self, _at: Instant, row: usize) -> i64 {
        self.drive.peek(row)
    }

    fn poke(
        &mut self,
        at: Instant,
        row: usize,
        value: i64,
        out: &mut dyn Context,
    ) -> Result<(), PresetError> {
        let setting = self.drive.serial_port();
        let reg = Reg::from_row(row).ok_or(PresetError::NoSuchRegister)?;
        self.drive.poke(at, reg, value, out)?;
        if self.drive.serial_port() != setting {
            self.serial.set_line(at, self.line(), out);
        }
        Ok(())
    }

    fn microsteps(&self, _axis: Axis) -> u16 {
        self.drive.microsteps()
    }
}
