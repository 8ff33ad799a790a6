//! RS 434544 and RS 434546: controllers of brush motors, on RS-485 with Modbus RTU or ASCII. They can also
//! run a program of their user.
//!
//! Follows the *User Manual* of RS Stock No. 434544 and 434546. Numbers like 6.5 are sections of this manual.

mod drive;
mod errors;
mod fields;
mod inputs;
mod motion;
pub mod program;
mod reasons;
mod registers;
mod saved;
mod servo;
mod startup;
#[cfg(test)]
mod tests;
mod thermal;

use drivetwin_protocol::modbus::pdu::{
    Exception, READ_COILS, READ_DISCRETE_INPUTS, READ_HOLDING_REGISTERS, READ_INPUT_REGISTERS,
    WRITE_MULTIPLE_COILS, WRITE_MULTIPLE_REGISTERS, WRITE_SINGLE_COIL, WRITE_SINGLE_REGISTER,
};
use drivetwin_protocol::modbus::server::Rules;
use drivetwin_protocol::modbus::{Frame, RtuOrAscii};
use drivetwin_protocol::registers::{Register, Table};

use self::drive::{Bus, Drive, run_program};
use self::registers::Model;
pub use self::registers::Reg;
use crate::device::{
    AxisSpec, Boot, Context, Device, Duration, Fault, Framing, Input, Instant, Level, Line, Pin, PinSpec,
    Port, PortSpec, PresetError, REPORTS_REASONS, Role, Spec, reported,
};
use crate::memory;
use crate::modbus_port::{ModbusPort, is_reception};
use crate::motor::{DriveWithMotor, MotorDrive, Parameters};

const RS485: Port = Port(0);
const IN1: Pin = Pin(0);
const IN2: Pin = Pin(1);
const HARD_STOP: Pin = Pin(2);
const HA: Pin = Pin(3);
const HB: Pin = Pin(4);
const CLR_FLASH: Pin = Pin(5);
const RED: Pin = Pin(6);
const GREEN: Pin = Pin(7);

/// Number of lines of a user program (6.6).
pub const LINES: usize = 1_024;
/// Bytes of the settings. The user program follows them in the memory: its lines, low byte first, and their
/// CRC.
const SETTINGS: usize = memory::bytes(Reg::SAVED_WORDS) as usize;
/// Bytes of the flash, which holds the settings and the user program.
pub const MEMORY: usize = SETTINGS + 4 * LINES + 2;

const fn pin(name: &'static str, role: Role, idle: Level) -> PinSpec {
    PinSpec::new(name, role, idle)
}

// A contact to ground is closed while its pin is low (6.1). An unused contact is open. Only an unused
// emergency stop is closed, because otherwise nothing would ever move (RS434-8).
#[rustfmt::skip]
static PINS: [PinSpec; 8] = [
    pin("IN1", Role::Input, Level::High),
    pin("IN2", Role::Input, Level::High),
    PinSpec { high_once_used: true, ..pin("HARD_STOP", Role::Input, Level::Low) },
    pin("HA", Role::Both, Level::High),
    pin("HB", Role::Both, Level::High),
    pin("CLR_FLASH", Role::Input, Level::High),
    pin("RED", Role::Led, Level::Low),
    pin("GREEN", Role::Led, Level::Low),
];

/// The fault in [`Spec::faults`] that belongs to the motor: its shaft is blocked.
const STALL: Fault = Fault(8);

static RS434544: Spec = spec("rs434544", "RS 434544 brush motor controller, 20 A", Reg::TABLE);
static RS434546: Spec = spec("rs434546", "RS 434546 brush motor controller, 40 A", &registers::TABLE_434546);

/// Limits of the model, with reasons. They apply to both models of the drive.
static NOT_MODELLED: [&str; 6] = [
    "errors of a real control loop: the speed follows its ramp without lag; a load changes it only if \
     current or supply do not suffice",
    "a supply that rises while the motor returns current: the braking circuit (4) takes it all, and only \
     TEMPERATURE_BRAKE shows it; a supply that drops under load: it has no resistance",
    "effect of the supply on the drive's own motor (3): RATED_SPEED is its speed at any supply (6.5, 500Ah); \
     a [[motor]] has supply_v",
    "ripple of speed or current: the motor has no cogging, no commutation and no inductance",
    "short circuits and faults of the switches (bits 1 and 10 of ERROR): no motor causes them, only a fault \
     or a preset CURRENT_VALID does",
    "overheating (bits 2, 3 and 6): no current within REF_CURRENT is enough for it, only a fault or a preset \
     temperature; the winding keeps its resistance",
];

/// The description, as far as both models share it.
const fn spec(kind: &'static str, product: &'static str, registers: &'static Table) -> Spec {
    Spec {
        kind,
        product,
        manual: "User Manual, RS Stock No. 434544, 434546",
        ports: &[PortSpec { name: "rs485", framing: Framing::Silence, line: Some(registers::FACTORY_LINE) }],
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
        supply: Some(Reg::SUPPLY as usize),
        reasons: reasons::REASONS,
        rules: Some(&RULES),
        failure: if REPORTS_REASONS { "a user program is running, so no program can be saved" } else { "" },
        not_modelled: reported(&NOT_MODELLED),
        ..Spec::EMPTY
    }
}

/// A wrong quantity or value gets exception 03. An address that does not exist or cannot be written gets 02
/// (RS434-1).
static RULES: Rules = Rules {
    functions: &[
        READ_COILS,
        READ_DISCRETE_INPUTS,
        READ_HOLDING_REGISTERS,
        READ_INPUT_REGISTERS,
        WRITE_SINGLE_COIL,
        WRITE_SINGLE_REGISTER,
        WRITE_MULTIPLE_COILS,
        WRITE_MULTIPLE_REGISTERS,
    ],
    broadcast: Some(0),
    max_read: 125,
    max_written: 123,
    bits_per_word: 16,
    partial_writes: true,
    bad_quantity: Exception::IllegalDataValue,
    bad_value: Exception::IllegalDataValue,
    read_only: Exception::IllegalDataAddress,
};

/// Bus settings from the registers at the start of the drive (6.4).
#[derive(Clone, Copy, Debug)]
struct BusSettings {
    /// TYPE_MODBUS and BITRATE_MODBUS.
    line: Line,
    /// SLAVE_ADDRESS_MODBUS.
    unit: u8,
    /// Delay of every reply: TIMEOUT_BROADCAST_MODBUS.
    delay: Duration,
}

/// An RS 434544 or 434546, without a motor.
#[derive(Clone, Debug)]
pub struct Rs434 {
    serial: ModbusPort<RtuOrAscii>,
    /// Bus settings; `None` until the time is known from which the drive receives.
    manners: Option<BusSettings>,
    drive: Drive,
    /// Next deadline of everything except the program.
    due: Instant,
}

impl Rs434 {
    /// An RS 434544 with a motor, without power.
    #[must_use]
    pub fn rs434544() -> DriveWithMotor<Self> {
        DriveWithMotor::new(Self::of(Model::Rs434544))
    }

    /// An RS 434546 with a motor, without power.
    #[must_use]
    pub fn rs434546() -> DriveWithMotor<Self> {
        DriveWithMotor::new(Self::of(Model::Rs434546))
    }

    // Inlined, so that the drive is built in its final place: a copy takes 6 KB of a board's stack.
    #[inline(always)]
    fn of(model: Model) -> Self {
        Self {
            serial: ModbusPort::new(RS485, registers::FACTORY_LINE),
            manners: None,
            drive: Drive::new(model),
            due: Instant::NEVER,
        }
    }

    /// Starts or restarts the reception.
    fn start(&mut self, at: Instant, out: &mut dyn Context) {
        self.manners = None;
        self.serial.mute();
        self.after_event(at, out);
    }

    /// Called after every event, except a program line that only calculates. Updates the outputs, the start
    /// of reception, and the deadlines.
    fn after_event(&mut self, at: Instant, out: &mut dyn Context) {
        self.drive.settle(at, out);
        if self.manners.is_none()
            && let Some(ready) = self.drive.ready_at()
        {
            let manners = self.drive.bus_settings();
            self.serial.start(at, manners.line, ready, out);
            self.manners = Some(manners);
        }
        self.due = self.drive.deadline().min(self.serial.deadline());
    }

    /// Handles a deadline other than that of a program line.
    #[inline(never)]
    fn more_is_due(&mut self, at: Instant, out: &mut dyn Context) {
        self.drive.timeout(at, out);
        if self.serial.is_over(at) {
            self.serve(at, out);
        }
        if self.drive.restart(at, out) {
            self.start(at, out);
        } else {
            self.after_event(at, out);
        }
    }

    /// Serves a message that has ended.
    fn serve(&mut self, at: Instant, out: &mut dyn Context) {
        let Self { serial, manners: Some(manners), drive, .. } = self else { return };
        let mut reply = Frame::new();
        let mut bus = Bus::new(drive, at, out);
        let Some(outcome) = serial.serve(manners.unit, &RULES, &mut bus, &mut reply) else { return };
        let sent = serial.answer(at, manners.delay, outcome, &mut reply, out);
        if sent > 0 && drive.restart_after(at + manners.delay + serial.duration(sent)) {
            serial.mute();
        }
    }
}

impl MotorDrive for Rs434 {
    const HALLS: &'static [Pin] = &[HA, HB];
    const STALL: Option<Fault> = Some(STALL);

    fn motor(&self) -> Parameters {
        self.drive.motor()
    }

    fn new_motor(&mut self) -> Option<Parameters> {
        self.drive.new_motor()
    }
}

impl Device for Rs434 {
    fn spec(&self) -> &'static Spec {
        match self.drive.model() {
            Model::Rs434544 => &RS434544,
            Model::Rs434546 => &RS434546,
        }
    }

    fn power_on(&mut self, at: Instant, boot: Boot, out: &mut dyn Context) {
        self.drive.power_on(at, boot, out);
        self.start(at, out);
    }

    fn power_off(&mut self, _at: Instant) {
        self.drive.power_off();
        self.serial.mute();
    }

    fn input(&mut self, at: Instant, input: Input<'_>, out: &mut dyn Context) {
        if is_reception(&input) {
            self.timeout(at, out);
            if matches!(input, Input::RxError { .. }) && at >= self.serial.receives_from() {
                self.drive.rx_error();
            }
            if self.serial.input(at, &input, out) {
                self.serve(at, out);
            }
        } else {
            self.drive.input(at, &input, out);
        }
        self.after_event(at, out);
    }

    fn receives_from(&self) -> Instant {
        self.serial.receives_from()
    }

    fn is_for_others(&self, at: Instant, _port: Port, address: u8) -> bool {
        let unit = self.manners.as_ref().map(|manners| manners.unit);
        unit.is_some_and(|unit| self.serial.is_for_others(at, unit, &RULES, address))
    }

    fn deadline(&self) -> Instant {
        self.due.min(self.drive.line_due())
    }

    fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        // Usually only the program is due.
        if at >= self.due {
            self.more_is_due(at, out);
        }
        if run_program(&mut self.drive, at, out) {
            self.after_event(at, out);
        }
    }

    fn peek(&self, at: Instant, row: usize) -> i64 {
        Reg::from_row(row).map_or(0, |reg| self.drive.value(at, reg))
    }

    fn poke(
        &mut self,
        at: Instant,
        row: usize,
        value: i64,
        out: &mut dyn Context,
    ) -> Result<(), PresetError> {
        let reg = Reg::from_row(row).ok_or(PresetError::NoSuchRegister)?;
        self.drive.poke(at, reg, value, out)?;
        self.after_event(at, out);
        Ok(())
    }

    fn program_line(&self) -> Option<u16> {
        self.drive.program_line()
    }
}
