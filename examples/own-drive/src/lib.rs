//! A frequency converter (VFD) of one's own: Modbus RTU, five registers, a ramp, a fault and a relay.
//!
//! It is not a real product. It shows what a drive needs: a register map, a description, and a state machine. Time is an
//! argument, so the drive runs in a test, as a process and on a board.
#![no_std]

use drivetwin_firmware::device::{
    Boot, Context, Device, Duration, Fault, Framing, Input, Instant, Level, Line, Output, Pin, PinSpec, Port,
    PortSpec, PresetError, Role, Spec,
};
use drivetwin_firmware::modbus_port::{ModbusPort, is_reception};
use drivetwin_protocol::line::Parity;
use drivetwin_protocol::modbus::Frame;
use drivetwin_protocol::modbus::pdu::{Exception, READ_HOLDING_REGISTERS, WRITE_SINGLE_REGISTER};
use drivetwin_protocol::modbus::rtu::RtuReceiver;
use drivetwin_protocol::modbus::server::{RequestHandler, Rules};
use drivetwin_protocol::registers::{Bank, Field, Register};

drivetwin_protocol::registers! {
    /// Registers of the VFD. The second argument of a row is the section of the manual.
    pub enum Reg: HighFirst {
        /// Stop, run forward or run in reverse. A stop clears a fault whose cause is gone.
        Command = rw(0, "1").range(0, 2),
        /// Frequency to reach, in 0.01 Hz.
        Setpoint = rw(1, "2").range(0, 5_000).reset(2_500),
        /// Time from standstill to 50 Hz, in 0.1 s.
        RampTime = rw(2, "3").range(1, 600).reset(50),
        /// Present frequency in 0.01 Hz, negative in reverse.
        Frequency = ro(3, "4").i16().live(),
        /// State of the drive.
        Status = ro(4, "5").live().fields(&[
            Field::bit(0, "running"),
            Field::bit(1, "at the setpoint"),
            Field::bit(2, "fault"),
        ]),
    }
}

const RS485: Port = Port(0);
const LINE: Line = Line::new(19_200, 8, Parity::Even, 1);
const UNIT: u8 = 1;
/// Closed, that is low, while the drive is at its setpoint.
const RELAY: Pin = Pin(0);
const OVERLOAD: Fault = Fault(0);
const START_UP: Duration = Duration::millis(500);

/// Frequency at the end of a ramp, in 0.01 Hz.
const FULL: i64 = 5_000;

static SPEC: Spec = Spec {
    kind: "own-vfd",
    product: "Frequency converter of examples/own-drive",
    manual: "examples/own-drive/README.md",
    ports: &[PortSpec { name: "rs485", framing: Framing::Silence, line: Some(LINE) }],
    pins: &[PinSpec::new("RELAY", Role::Output, Level::Float)],
    faults: &["overload"],
    registers: Reg::TABLE,
    rules: Some(&RULES),
    not_modelled: &[
        "the motor: the frequency is a number",
        "saved registers: each power-on gives factory values",
    ],
    ..Spec::EMPTY
};

static RULES: Rules = Rules {
    functions: &[READ_HOLDING_REGISTERS, WRITE_SINGLE_REGISTER],
    broadcast: Some(0),
    max_read: 5,
    max_written: 1,
    bits_per_word: 16,
    partial_writes: false,
    bad_quantity: Exception::IllegalDataValue,
    bad_value: Exception::IllegalDataValue,
    read_only: Exception::IllegalDataAddress,
};

/// A linear change of the frequency, in 0.01 Hz.
#[derive(Clone, Copy, Debug)]
struct Ramp {
    since: Instant,
    from: i64,
    to: i64,
    /// Time from standstill to [`FULL`].
    time: Duration,
}

impl Ramp {
    const STANDSTILL: Self = Self { since: Instant::ZERO, from: 0, to: 0, time: Duration::TICK };

    fn at(self, at: Instant) -> i64 {
        let change =
            i128::from(FULL) * i128::from(at.since(self.since).ticks()) / i128::from(self.time.ticks());
        let left = self.to - self.from;
        let change = i64::try_from(change).unwrap_or(i64::MAX).min(left.abs());
        self.from + left.signum() * change
    }

    fn end(self) -> Instant {
        let ticks = i128::from((self.to - self.from).abs()) * i128::from(self.time.ticks());
        // Rounded up, so that the ramp is over at its end.
        self.since
            + Duration::from_ticks(
                u64::try_from((ticks + i128::from(FULL) - 1) / i128::from(FULL)).unwrap_or(u64::MAX),
            )
    }
}

/// The frequency converter.
#[derive(Debug)]
pub struct Vfd {
    serial: ModbusPort<RtuReceiver>,
    drive: Drive,
}

/// The frequency converter without its serial port.
#[derive(Debug)]
struct Drive {
    bank: Bank<Reg, { Reg::WORDS }>,
    ramp: Ramp,
    /// Time at which the ramp ends; never if that has been handled.
    due: Instant,
    overloaded: bool,
    fault: bool,
}

impl Drive {
    fn new() -> Self {
        Self {
            bank: Bank::factory(),
            ramp: Ramp::STANDSTILL,
            due: Instant::NEVER,
            overloaded: false,
            fault: false,
        }
    }

    fn value(&self, at: Instant, register: Reg) -> i64 {
        let frequency = self.ramp.at(at);
        match register {
            Reg::Frequency => frequency,
            Reg::Status => {
                let is_there = frequency == self.ramp.to && self.bank.get(Reg::Command) != 0;
                i64::from(frequency != 0) | i64::from(is_there) << 1 | i64::from(self.fault) << 2
            }
            _ => self.bank.get(register),
        }
    }

    /// Begins a ramp from the present frequency to what the registers say.
    fn follow(&mut self, at: Instant, out: &mut dyn Context) {
        let setpoint = self.bank.get(Reg::Setpoint);
        let to = match self.bank.get(Reg::Command) {
            1 => setpoint,
            2 => -setpoint,
            _ => 0,
        };
        let time = Duration::millis(100) * self.bank.get(Reg::RampTime).unsigned_abs();
        self.ramp = Ramp { since: at, from: self.ramp.at(at), to, time };
        self.due = self.ramp.end();
        self.switch_relay(at, out);
    }

    fn switch_relay(&self, at: Instant, out: &mut dyn Context) {
        let is_closed = self.value(at, Reg::Status) & 2 != 0;
        out.put(at, Output::Level { pin: RELAY, level: if is_closed { Level::Low } else { Level::Float } });
    }

    fn written(&mut self, at: Instant, register: Reg, out: &mut dyn Context) {
        if register == Reg::Command && self.bank.get(Reg::Command) == 0 {
            self.fault = self.overloaded;
        }
        if self.fault {
            self.bank.set(Reg::Command, 0);
        }
        self.follow(at, out);
    }

    /// A fault switches the output off at once: the motor coasts.
    fn set_overload(&mut self, at: Instant, overloaded: bool, out: &mut dyn Context) {
        self.overloaded = overloaded;
        if overloaded {
            self.fault = true;
            self.bank.set(Reg::Command, 0);
            self.ramp = Ramp { since: at, ..Ramp::STANDSTILL };
            self.follow(at, out);
        }
    }
}

impl Vfd {
    /// A frequency converter without power.
    #[must_use]
    pub fn new() -> Self {
        Self { serial: ModbusPort::new(RS485, LINE), drive: Drive::new() }
    }

    fn serve(&mut self, at: Instant, out: &mut dyn Context) {
        let mut reply = Frame::new();
        let mut bus = Bus { drive: &mut self.drive, at, out };
        let Some(outcome) = self.serial.serve(UNIT, &RULES, &mut bus, &mut reply) else { return };
        self.serial.answer(at, Duration::ZERO, outcome, &mut reply, out);
    }
}

impl Default for Vfd {
    fn default() -> Self {
        Self::new()
    }
}

impl Device for Vfd {
    fn spec(&self) -> &'static Spec {
        &SPEC
    }

    fn power_on(&mut self, at: Instant, boot: Boot, out: &mut dyn Context) {
        let overloaded = self.drive.overloaded;
        self.drive = Drive { overloaded, fault: overloaded, ..Drive::new() };
        self.drive.switch_relay(at, out);
        let ready = if boot.fast { at } else { at + START_UP };
        self.serial.start(at, LINE, ready, out);
    }

    fn power_off(&mut self, _at: Instant) {
        self.serial.mute();
    }

    fn input(&mut self, at: Instant, input: Input<'_>, out: &mut dyn Context) {
        if is_reception(&input) {
            self.timeout(at, out);
            if self.serial.input(at, &input, out) {
                self.serve(at, out);
            }
        }
        if let Input::Fault { fault: OVERLOAD, on } = input {
            self.drive.set_overload(at, on, out);
        }
    }

    fn receives_from(&self) -> Instant {
        self.serial.receives_from()
    }

    fn deadline(&self) -> Instant {
        self.serial.deadline().min(self.drive.due)
    }

    fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        if self.drive.due <= at {
            self.drive.due = Instant::NEVER;
            self.drive.switch_relay(at, out);
        }
        if self.serial.is_over(at) {
            self.serve(at, out);
        }
    }

    fn peek(&self, at: Instant, row: usize) -> i64 {
        Reg::from_row(row).map_or(0, |register| self.drive.value(at, register))
    }

    fn poke(
        &mut self,
        at: Instant,
        row: usize,
        value: i64,
        out: &mut dyn Context,
    ) -> Result<(), PresetError> {
        let register = Reg::from_row(row).ok_or(PresetError::NoSuchRegister)?;
        let entry = Reg::ENTRIES.list.get(row).ok_or(PresetError::NoSuchRegister)?;
        // Without power only saved registers can be preset, and there are none.
        if !entry.access.writes() || self.serial.receives_from() == Instant::NEVER {
            return Err(PresetError::ReadOnly);
        }
        if !entry.accepts(value) {
            return Err(PresetError::OutOfRange);
        }
        self.drive.bank.set(register, value);
        self.drive.written(at, register, out);
        Ok(())
    }
}

/// The drive as the Modbus server uses it during a request.
struct Bus<'a> {
    drive: &'a mut Drive,
    at: Instant,
    out: &'a mut dyn Context,
}

impl RequestHandler for Bus<'_> {
    type Register = Reg;

    fn words(&self) -> &[u16] {
        self.drive.bank.words()
    }

    fn words_mut(&mut self) -> &mut [u16] {
        self.drive.bank.words_mut()
    }

    fn refresh(&mut self, register: Reg) {
        let value = self.drive.value(self.at, register);
        self.drive.bank.set(register, value);
    }

    fn written(&mut self, register: Reg) {
        self.drive.written(self.at, register, self.out);
    }
}
