//! RS 434544 and RS 434546: controllers of brush motors, on RS-485 with Modbus RTU or ASCII, which also
//! carry out a program of their user.
//!
//! Follows the *User Manual* of RS Stock No. 434544 and 434546; numbers like 6.5 are its sections.

#![expect(dead_code, reason = "being built")]

mod drive;
mod port;
pub mod program;
mod registers;
mod servo;

use standin_protocol::registers::{Register, Table};

use self::drive::Drive;
use self::registers::Model;
pub use self::registers::Reg;
use crate::device::{
    Axis, AxisSpec, Boot, Device, Ends, Fault, Input, Instant, Level, Pin, PinSpec, Port, PortSpec, Refused,
    Role, Sink, Spec,
};
use crate::memory;
use crate::motor::{Parameters, Rig, Turns};

const RS485: Port = Port(0);
const AXIS: Axis = Axis(0);
const IN1: Pin = Pin(0);
const IN2: Pin = Pin(1);
const HARD_STOP: Pin = Pin(2);
const HA: Pin = Pin(3);
const HB: Pin = Pin(4);
const CLR_FLASH: Pin = Pin(5);
const RED: Pin = Pin(6);
const GREEN: Pin = Pin(7);

/// Lines of a user program (6.6).
pub const LINES: usize = 1_024;
/// Bytes of the settings, behind which the user program lies: its lines, low byte first, and their CRC.
const SETTINGS: usize = memory::bytes(Reg::SAVED_WORDS) as usize;
/// Bytes of the flash that hold settings and user program.
pub const MEMORY: usize = SETTINGS + 4 * LINES + 2;

const fn pin(name: &'static str, role: Role, rest: Level) -> PinSpec {
    PinSpec { name, role, rest }
}

// A contact to ground is closed while it is low (6.1). One that nobody wired is open; that of the emergency
// stop is closed, or nothing would ever move.
#[rustfmt::skip]
static PINS: [PinSpec; 8] = [
    pin("IN1", Role::Input, Level::High),
    pin("IN2", Role::Input, Level::High),
    pin("HARD_STOP", Role::Input, Level::Low),
    pin("HA", Role::Both, Level::High),
    pin("HB", Role::Both, Level::High),
    pin("CLR_FLASH", Role::Input, Level::High),
    pin("RED", Role::Led, Level::Low),
    pin("GREEN", Role::Led, Level::Low),
];

/// The fault of [`Spec::faults`] that is the motor's: its shaft is held.
const STALL: Fault = Fault(8);

static RS434544: Spec = spec("rs434544", "RS 434544 brush motor controller, 20 A", Reg::TABLE);
static RS434546: Spec = spec("rs434546", "RS 434546 brush motor controller, 40 A", &registers::TABLE_434546);

/// What both models have in common.
const fn spec(kind: &'static str, product: &'static str, registers: &'static Table) -> Spec {
    Spec {
        kind,
        product,
        manual: "User Manual, RS Stock No. 434544, 434546",
        ports: &[PortSpec { name: "rs485", ends: Ends::Silence, line: Some(registers::FACTORY_LINE) }],
        pins: &PINS,
        axes: &[AxisSpec { name: "motor", step_dir: None }],
        faults: &[
            "supply_voltage",
            "short_circuit",
            "brake_overheat",
            "power_overheat",
            "hall",
            "mcu_overheat",
            "switches",
            "current_limit",
            "stall",
        ],
        memory: MEMORY as u16,
        registers,
        address: Some(Reg::SLAVE_ADDRESS_MODBUS as usize),
        ..Spec::BARE
    }
}

/// An RS 434544 with a motor, without power.
#[must_use]
pub fn rs434544() -> Rig<Rs434> {
    Rig::new(Rs434::of(Model::Rs434544))
}

/// An RS 434546 with a motor, without power.
#[must_use]
pub fn rs434546() -> Rig<Rs434> {
    Rig::new(Rs434::of(Model::Rs434546))
}

/// An RS 434544 or 434546, without a motor.
#[derive(Clone, Debug)]
pub struct Rs434 {
    drive: Drive,
}

impl Rs434 {
    fn of(model: Model) -> Self {
        Self { drive: Drive::new(model) }
    }
}

impl Turns for Rs434 {
    const HALLS: &'static [Pin] = &[HA, HB];
    const STALL: Option<Fault> = Some(STALL);

    fn motor(&self) -> Parameters {
        self.drive.motor()
    }
}

impl Device for Rs434 {
    fn spec(&self) -> &'static Spec {
        match self.drive.model {
            Model::Rs434544 => &RS434544,
            Model::Rs434546 => &RS434546,
        }
    }

    fn power_on(&mut self, _at: Instant, _boot: Boot, _out: &mut dyn Sink) {}

    fn input(&mut self, _at: Instant, _input: Input<'_>, _out: &mut dyn Sink) {}

    fn deadline(&self) -> Instant {
        Instant::NEVER
    }

    fn timeout(&mut self, _at: Instant, _out: &mut dyn Sink) {}

    fn peek(&self, _at: Instant, row: usize) -> i64 {
        Reg::from_row(row).map_or(0, |reg| self.drive.bank.get(reg))
    }

    fn poke(&mut self, _at: Instant, _row: usize, _value: i64, _out: &mut dyn Sink) -> Result<(), Refused> {
        Err(Refused::ReadOnly)
    }
}
