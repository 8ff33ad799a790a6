//! Reads and writes of registers: by the bus, by the user program, and by presets.

use drivetwin_protocol::modbus::pdu::Exception;
use drivetwin_protocol::modbus::server::RequestHandler;
use drivetwin_protocol::registers::{Entries, Register};

use super::Drive;
use crate::device::{Context, Instant, PresetError};
use crate::rs434::errors::Error;
use crate::rs434::motion::Heading;
use crate::rs434::program::Status;
use crate::rs434::reasons::Why;
use crate::rs434::registers::{Reg, VERSIONS, key};
use crate::rs434::thermal::Part;
use crate::rs434::{HARD_STOP, IN1, IN2, saved};

impl Drive {
    /// Value of a register at `at`.
    pub(in crate::rs434) fn value(&self, at: Instant, reg: Reg) -> i64 {
        match reg {
            Reg::IN1_bit => self.inputs.is_closed(IN1).into(),
            Reg::IN2_bit => self.inputs.is_closed(IN2).into(),
            Reg::IN_HARD_STOP_bit => self.inputs.is_closed(HARD_STOP).into(),
            Reg::STATUS => match self.servo.direction() {
                0 => 0,
                1.. => 1,
                _ => 2,
            },
            Reg::CURRENT_VALID => self.errors.injected_ma().unwrap_or_else(|| self.servo.current(at)).into(),
            Reg::SPEED_VALID => self.servo.speed(at).into(),
            Reg::CURRENT_POSITION => self.servo.position().into(),
            Reg::TEMPERATURE_MCU => self.thermal.temperature(at, Part::Mcu).into(),
            Reg::TEMPERATURE_MOSFET => self.thermal.temperature(at, Part::Power).into(),
            Reg::TEMPERATURE_BRAKE => self.thermal.temperature(at, Part::Brake).into(),
            Reg::TASK_COUNTER => i64::from(hash(self.random) as u16),
            Reg::STATUS_USER_PROGRAM => self.program.status() as i64,
            Reg::OFFSET => self.motion.offset(&self.servo, &self.bank),
            Reg::ERROR => self.errors.bits().into(),
            Reg::SUPPLY => self.errors.supply().into(),
            Reg::PC_REG => self.program.line().into(),
            _ => match reg.system().and_then(|n| self.program.register(n)) {
                Some(word) => word.into(),
                None => self.bank.get(reg),
            },
        }
    }

    /// Reads a live register; a read of TASK_COUNTER changes it.
    pub(super) fn read(&mut self, at: Instant, reg: Reg) -> i64 {
        let value = self.value(at, reg);
        if reg == Reg::TASK_COUNTER {
            self.random = self.random.wrapping_add(RANDOM_STEP);
        }
        value
    }

    /// Updates a live register in the bank, because it is read.
    fn refresh(&mut self, at: Instant, reg: Reg) {
        let value = self.read(at, reg);
        self.bank.set(reg, value);
    }

    /// Checks that a value accepted by its row may be written now. It may not while the drive is busy.
    pub(super) fn validate(&self, reg: Reg, value: i64) -> Result<(), Exception> {
        // A running program is read from the flash (RS434-28).
        let saves = reg == Reg::FLAG_SAVE_USER_PROGRAM && value == key::SAVE_PROGRAM;
        if saves && self.program.is_running() { Err(Exception::ServerDeviceFailure) } else { Ok(()) }
    }

    /// Executes a write of a register, in the manual's order. Returns true if the write has an immediate
    /// effect.
    pub(super) fn written(&mut self, at: Instant, reg: Reg, out: &mut dyn Context) -> bool {
        match reg {
            _ if reg.is_control() => self.apply_coils(at, out),
            Reg::MODE_DEVICE | Reg::MODE_EXT_IN => self.obey_levels(at, out),
            Reg::MODE_USER_PROGRAM => self.command_program(at, out),
            Reg::REF_CURRENT => {
                self.set_servo(at, out);
                self.check_errors(at, out);
            }
            Reg::USE_HALL => {
                if self.motion.halls_changed(&mut self.servo, &mut self.bank) {
                    self.errors.warn(Error::TooFewHalls);
                }
                self.set_servo(at, out);
            }
            Reg::SPEED | Reg::ACC | Reg::DEC => {
                if self.servo.keeps_rates() {
                    Why::KeepsRates.put(at, out);
                }
                if reg == Reg::SPEED && self.bank.word(reg) > self.bank.word(Reg::RATED_SPEED) {
                    Why::TooFast.put(at, out);
                }
                return self.set_servo(at, out);
            }
            Reg::RATED_SPEED | Reg::PULSES_PER_REVOLUTION | Reg::MODE_COIL => {
                return self.set_servo(at, out);
            }
            Reg::OFFSET => self.offset_written(at, out),
            Reg::DIRECTION => Why::put_if(at, self.direction_changed(at, out), out),
            Reg::ERROR => self.error_written(at, out),
            Reg::SUPPLY => {
                self.errors.set_supply(self.bank.word(reg));
                self.check_errors(at, out);
            }
            Reg::FLAG_SAVE_INI => match self.take_unlock_key(reg) {
                key::SAVE => self.save_settings(at, out),
                _ => Why::NoKey.put(at, out),
            },
            Reg::FLAG_SAVE_USER_PROGRAM => match self.take_unlock_key(reg) {
                key::SAVE_PROGRAM => self.program.save(at, out),
                key::LOAD_PROGRAM if self.program.load(out) => {}
                key::LOAD_PROGRAM => {
                    Why::BadProgram.put(at, out);
                    self.errors.warn(Error::ProgramTest);
                }
                _ => Why::NoKey.put(at, out),
            },
            Reg::FLAG_RESTART => match self.take_unlock_key(reg) {
                key::RESTART => self.restart_due = at,
                _ => Why::NoKey.put(at, out),
            },
            Reg::WRITE_CMD => {
                self.program.write_line(self.bank.word(reg), self.bank.get(Reg::CMD_W) as u32);
            }
            Reg::READ_CMD => {
                let line = self.program.read_line(self.bank.word(reg));
                self.bank.set(Reg::CMD_R, line.into());
            }
            _ => {
                match reg.system().and_then(|n| self.program.register_mut(n)) {
                    Some(register) => *register = self.bank.word(reg),
                    None => self.put_postponed(at, reg, out),
                }
                return false;
            }
        }
        true
    }

    /// Executes written coils and resets them to 0. If one write sets several of them, HARD_STOP has priority
    /// over STOP, and STOP over START (6.2) (RS434-6).
    fn apply_coils(&mut self, at: Instant, out: &mut dyn Context) {
        let mut take = |reg| {
            let set = self.bank.word(reg) != 0;
            self.bank.set(reg, 0);
            set
        };
        let (start, stop, hard_stop) = (take(Reg::START_bit), take(Reg::STOP_bit), take(Reg::HARD_STOP_bit));
        let clears = take(Reg::CLR_POSITION_bit);
        if clears {
            self.servo.clear_position();
        }
        let mut done = Ok(());
        if hard_stop {
            self.motion.halt(at, &mut self.servo, out);
        } else if stop {
            self.motion.stop(&mut self.servo);
        } else if start && self.input_mode() != 0 {
            done = Err(Why::StartedByInputs);
        } else if start {
            done = self.start(at, Heading::Registers, out);
        } else if !clears {
            done = Err(Why::ZeroCoil);
        }
        Why::put_if(at, done, out);
    }

    /// Executes a written MODE_USER_PROGRAM. The value 3 is only stored (RS434-26).
    fn command_program(&mut self, at: Instant, out: &mut dyn Context) {
        let done = match self.bank.word(Reg::MODE_USER_PROGRAM) {
            1 => {
                self.program.stop();
                Ok(())
            }
            2 => self.start_program(at, Status::StartedByBus, out),
            _ => Err(Why::StartOfProgram),
        };
        Why::put_if(at, done, out);
    }

    /// Executes a written ERROR: clears the warnings that are 0 in it. A warning whose cause remains is set again.
    fn error_written(&mut self, at: Instant, out: &mut dyn Context) {
        let (cleared, stays) = self.errors.clear(self.bank.word(Reg::ERROR));
        if stays {
            Why::ErrorStays.put(at, out);
        }
        self.check_errors(at, out);
        if cleared & self.errors.bits() != 0 {
            Why::CauseRemains.put(at, out);
        }
    }

    /// Called after OFFSET was written.
    fn offset_written(&mut self, at: Instant, out: &mut dyn Context) {
        Why::put_if(at, self.motion.offset_written(&self.servo), out);
        if self.bank.get(Reg::OFFSET_CONST) != 0 {
            Why::CopiedOffset.put(at, out);
        }
    }

    /// Reports the reason if a register that the drive reads only when it needs it has no effect now.
    fn put_postponed(&self, at: Instant, reg: Reg, out: &mut dyn Context) {
        let turns = self.servo.direction() != 0;
        let why = match reg {
            Reg::SLAVE_ADDRESS_MODBUS
            | Reg::TYPE_MODBUS
            | Reg::BITRATE_MODBUS
            | Reg::TIMEOUT_BROADCAST_MODBUS => Why::StartOfBus,
            Reg::MODE_ROTATION
            | Reg::POSITION_N
            | Reg::OFFSET_COMPENSATION
            | Reg::OFFSET_CONST
            | Reg::TARGET_POSITION1
            | Reg::TARGET_POSITION2
            | Reg::TARGET_POSITION3
            | Reg::TARGET_POSITION4
                if turns =>
            {
                Why::NextStart
            }
            Reg::TARGET_POSITION => Why::CopiedPosition,
            Reg::CMD_R => Why::ShownLine,
            _ => return,
        };
        why.put(at, out);
    }

    /// Value of a key register. Resets the register to 0 (RS434-2).
    fn take_unlock_key(&mut self, reg: Reg) -> i64 {
        let key = self.bank.get(reg);
        self.bank.set(reg, 0);
        key
    }

    pub(in crate::rs434) fn poke(
        &mut self,
        at: Instant,
        reg: Reg,
        value: i64,
        out: &mut dyn Context,
    ) -> Result<(), PresetError> {
        let row = self.model.entries().list.get(reg.row()).ok_or(PresetError::NoSuchRegister)?;
        if !row.accepts(value) {
            return Err(PresetError::OutOfRange);
        }
        if self.startup.is_off() {
            return if row.saved == 0 {
                Err(PresetError::ReadOnly)
            } else {
                saved::preset(self.model.entries(), &mut self.bank, at, (reg, value), out)
            };
        }
        if !row.access.writes() {
            return self.inject(at, reg, value as u16, out);
        }
        self.validate(reg, value).map_err(|_| PresetError::Busy)?;
        self.bank.set(reg, value);
        self.written(at, reg, out);
        Ok(())
    }

    /// Makes a register show an injected value instead of a measured one.
    fn inject(
        &mut self,
        at: Instant,
        reg: Reg,
        value: u16,
        out: &mut dyn Context,
    ) -> Result<(), PresetError> {
        match reg {
            Reg::CURRENT_VALID => self.errors.inject_ma(value),
            Reg::TEMPERATURE_MCU => self.thermal.inject(Part::Mcu, value),
            Reg::TEMPERATURE_MOSFET => self.thermal.inject(Part::Power, value),
            Reg::TEMPERATURE_BRAKE => self.thermal.inject(Part::Brake, value),
            _ if VERSIONS.contains(&reg) => self.bank.set(reg, value.into()),
            _ => return Err(PresetError::ReadOnly),
        }
        self.check_errors(at, out);
        Ok(())
    }
}

/// The drive as the server uses it during a request.
pub(in crate::rs434) struct Bus<'a> {
    drive: &'a mut Drive,
    at: Instant,
    out: &'a mut dyn Context,
    /// True after the first coil of the request, which applies all of them.
    has_applied_coils: bool,
}

impl<'a> Bus<'a> {
    pub(in crate::rs434) fn new(drive: &'a mut Drive, at: Instant, out: &'a mut dyn Context) -> Self {
        Self { drive, at, out, has_applied_coils: false }
    }
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
        self.drive.refresh(self.at, register);
    }

    fn written(&mut self, register: Reg) {
        if register.is_control() && core::mem::replace(&mut self.has_applied_coils, true) {
            return;
        }
        self.drive.written(self.at, register, self.out);
    }

    fn entries(&self) -> &'static Entries {
        self.drive.model.entries()
    }

    fn validate(&self, register: Reg, value: i64) -> Result<(), Exception> {
        self.drive.validate(register, value)
    }

    fn on_out_of_range(&mut self, _register: Reg, _value: i64) {
        self.drive.errors.warn(Error::OutOfRange);
    }
}

/// Increment of the state of the random numbers: splitmix64 (Steele, Lea, Flood: *Fast Splittable
/// Pseudorandom Number Generators*).
const RANDOM_STEP: u64 = 0x9E37_79B9_7F4A_7C15;

/// A pseudo-random number computed from `n`.
fn hash(n: u64) -> u64 {
    let n = (n ^ n >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let n = (n ^ n >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
    n ^ n >> 31
}
