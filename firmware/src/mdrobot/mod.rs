//! An MD400 of the MDROBOT MD series: a controller of brushless motors, on RS-485 with Modbus RTU. It has a
//! connector for switches and analogue inputs (CTRL), and a connector for pulses.
//!
//! Follows *Modbus Protocol on the MD Controller*, V1.1; numbers like p. 6 are its pages.

mod alarm;
mod command;
mod drive;
mod fields;
mod inputs;
mod reasons;
mod reference;
mod registers;
mod saved;
mod servo;
mod startup;
#[cfg(test)]
mod tests;

use drivetwin_protocol::modbus::Frame;
use drivetwin_protocol::modbus::pdu::{
    Exception, READ_HOLDING_REGISTERS, WRITE_MULTIPLE_REGISTERS, WRITE_SINGLE_REGISTER,
};
use drivetwin_protocol::modbus::rtu::RtuReceiver;
use drivetwin_protocol::modbus::server::Rules;
use drivetwin_protocol::registers::Register;

use self::drive::{Bus, Drive};
pub use self::registers::Pid;
use crate::device::{
    AxisSpec, Boot, Context, Device, Duration, EncoderSpec, Fault, Framing, Input, Instant, Level, Pin,
    PinSpec, Port, PortSpec, PresetError, Role, Spec, Writes, reported,
};
use crate::memory;
use crate::modbus_port::{ModbusPort, is_reception};
use crate::motor::{DriveWithMotor, MotorDrive, Parameters};

const RS485: Port = Port(0);

const INT_SPEED: Pin = Pin(0);
const ALARM_RESET: Pin = Pin(1);
const DIR: Pin = Pin(2);
const RUN_BRAKE: Pin = Pin(3);
const START_STOP: Pin = Pin(4);
const ENC_A: Pin = Pin(5);
const ENC_B: Pin = Pin(6);
const SPEED_IN: Pin = Pin(7);
const PULSE_IN: Pin = Pin(8);
const ALARM: Pin = Pin(9);
const CLUTCH: Pin = Pin(10);
const FAN: Pin = Pin(11);
const HU: Pin = Pin(12);
const HV: Pin = Pin(13);
const HW: Pin = Pin(14);

const OVER_VOLTAGE: Fault = Fault(0);
const OVER_TEMPERATURE: Fault = Fault(1);
const OVERLOAD: Fault = Fault(2);
const HALL_FAIL: Fault = Fault(3);
const ENCODER_FAIL: Fault = Fault(4);
const INVERSE_VELOCITY: Fault = Fault(5);
/// The motor's fault: its shaft is blocked.
const STALL: Fault = Fault(6);
const CTRL_FAIL: Fault = Fault(7);
const REGEN_OVER_TEMPERATURE: Fault = Fault(8);

/// Bytes of the non-volatile memory.
pub const MEMORY: usize = memory::two_copies(Pid::SAVED_WORDS) as usize;

const fn pin(name: &'static str, role: Role, idle: Level) -> PinSpec {
    PinSpec::new(name, role, idle)
}

/// The limits of the model, each with its reason.
static NOT_MODELLED: [&str; 9] = [
    "errors of the measured speed in the control loop: between two edges it uses the true position",
    "a supply that rises while the motor returns current, or drops under load: VOLT_IN is what the bench \
     sets; braking causes no OVER_VOLT and no regenerative over-temperature, only faults and a preset \
     VOLT_IN do",
    "VOLT_IN preset at run time, on a [[motor]]: that motor keeps its supply_v; the drive's own motor \
     follows",
    "ripple of speed or current: the motor has no cogging, commutation or inductance",
    "OVER_TEMP by heat: the manual gives no limit, so only the fault causes it",
    "the restart of 2.5 s after a write of ENC_PPR on real controllers: the manual has none",
    "a second motor and CAN: an MD400 has neither; their PIDs get exception 02",
    "functions of later controllers, except the PIDs marked \"not in V1.1\": PIDs get 02, codes of COMMAND \
     do nothing",
    "effect of a brake or clutch at CLUTCH: the manual does not say which",
];

static WRITES: Writes = Writes {
    refuses: |row, value| Pid::from_row(row).is_some_and(|pid| registers::validate(pid, value).is_err()),
    ..Writes::OF_ROWS
};

static MD400: Spec = Spec {
    kind: "mdrobot",
    product: "MDROBOT MD400 brushless motor controller, 20 A",
    manual: "Modbus Protocol on the MD Controller V1.1",
    ports: &[PortSpec { name: "rs485", framing: Framing::Silence, line: Some(registers::FACTORY_LINE) }],
    // A contact that is not wired is neither open nor closed: without a limit switch the motor may move.
    pins: &[
        pin("INT_SPEED", Role::Input, Level::Float),
        pin("ALARM_RESET", Role::Input, Level::Float),
        pin("DIR", Role::Input, Level::Float),
        pin("RUN_BRAKE", Role::Input, Level::Float),
        pin("START_STOP", Role::Input, Level::Float),
        pin("ENC_A", Role::Input, Level::High),
        pin("ENC_B", Role::Input, Level::High),
        pin("SPEED_IN", Role::AnalogueOrDigital, Level::Low),
        pin("PULSE_IN", Role::Input, Level::Low),
        pin("ALARM", Role::Output, Level::High),
        pin("CLUTCH", Role::Output, Level::Low),
        pin("FAN", Role::Output, Level::Low),
        pin("HU", Role::Both, Level::High),
        pin("HV", Role::Both, Level::High),
        pin("HW", Role::Both, Level::High),
    ],
    axes: &[AxisSpec { name: "motor", step_dir: None }],
    encoders: &[EncoderSpec { a: ENC_A, b: ENC_B, index: None }],
    faults: &[
        "over_voltage",
        "over_temperature",
        "overload",
        "hall_fail",
        "encoder_fail",
        "inverse_velocity",
        "stall",
        "ctrl_fail",
        "regen_over_temperature",
    ],
    memory: MEMORY as u16,
    registers: Pid::TABLE,
    commands: reported(&command::COMMANDS),
    decimal: true,
    prefix: "PID_",
    writes: WRITES.reported(),
    address: Some(Pid::CONTROLLER_ID as usize),
    supply: Some(Pid::VOLT_IN as usize),
    reasons: reasons::REASONS,
    rules: Some(&RULES),
    not_modelled: reported(&NOT_MODELLED),
    ..Spec::EMPTY
};

/// Exception 03 answers a quantity or value that is not allowed, exception 02 an address that does not exist
/// or cannot be written (MDROBOT-2).
static RULES: Rules = Rules {
    functions: &[READ_HOLDING_REGISTERS, WRITE_SINGLE_REGISTER, WRITE_MULTIPLE_REGISTERS],
    broadcast: Some(0xFE),
    max_read: 125,
    max_written: 123,
    bits_per_word: 16,
    partial_writes: true,
    bad_quantity: Exception::IllegalDataValue,
    bad_value: Exception::IllegalDataValue,
    read_only: Exception::IllegalDataAddress,
};

/// An MD400 without its motor.
#[derive(Clone, Debug)]
pub struct Mdrobot {
    serial: ModbusPort<RtuReceiver>,
    drive: Drive,
}

impl Mdrobot {
    /// An MD400 with a motor, without power.
    #[must_use]
    pub fn md400() -> DriveWithMotor<Self> {
        DriveWithMotor::new(Self::new())
    }

    // Inlined, so that the value is built in place: a copy takes space on a board's stack.
    #[inline(always)]
    fn new() -> Self {
        Self { serial: ModbusPort::new(RS485, registers::FACTORY_LINE), drive: Drive::new() }
    }

    /// Processes the received frame when it is complete.
    fn serve(&mut self, at: Instant, out: &mut dyn Context) {
        let unit = self.drive.unit();
        let mut reply = Frame::new();
        let mut bus = Bus::new(&mut self.drive, at, out);
        let Some(outcome) = self.serial.serve(unit, &RULES, &mut bus, &mut reply) else { return };
        self.serial.answer(at, Duration::ZERO, outcome, &mut reply, out);
    }
}

impl MotorDrive for Mdrobot {
    const HALLS: &'static [Pin] = &[HU, HV, HW];
    const STALL: Option<Fault> = Some(STALL);

    fn motor(&self) -> Parameters {
        self.drive.motor()
    }

    fn new_motor(&mut self) -> Option<Parameters> {
        self.drive.new_motor()
    }
}

impl Device for Mdrobot {
    fn spec(&self) -> &'static Spec {
        &MD400
    }

    fn power_on(&mut self, at: Instant, boot: Boot, out: &mut dyn Context) {
        self.drive.power_on(at, boot, out);
        self.serial.start(at, self.drive.line(), self.drive.ready_at(), out);
    }

    fn power_off(&mut self, _at: Instant) {
        self.drive.power_off();
        self.serial.mute();
    }

    fn input(&mut self, at: Instant, input: Input<'_>, out: &mut dyn Context) {
        if is_reception(&input) {
            self.timeout(at, out);
            if self.serial.input(at, &input, out) {
                self.serve(at, out);
            }
        } else {
            self.drive.input(at, &input, out);
        }
    }

    fn receives_from(&self) -> Instant {
        self.serial.receives_from()
    }

    fn is_for_others(&self, at: Instant, _port: Port, address: u8) -> bool {
        self.serial.is_for_others(at, self.drive.unit(), &RULES, address)
    }

    fn deadline(&self) -> Instant {
        self.drive.deadline().min(self.serial.deadline())
    }

    fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        self.drive.timeout(at, out);
        if self.serial.is_over(at) {
            self.serve(at, out);
        }
    }

    fn peek(&self, at: Instant, row: usize) -> i64 {
        Pid::from_row(row).map_or(0, |pid| self.drive.value(at, pid))
    }

    fn peek_word(&self, at: Instant, row: usize, word: usize) -> u16 {
        let words = Pid::from_row(row).map(|pid| self.drive.report(at, pid)).unwrap_or_default();
        words.get(word).copied().unwrap_or(0)
    }

    fn poke(
        &mut self,
        at: Instant,
        row: usize,
        value: i64,
        out: &mut dyn Context,
    ) -> Result<(), PresetError> {
        let pid = Pid::from_row(row).ok_or(PresetError::NoSuchRegister)?;
        self.drive.poke(at, pid, value, out)
    }
}
