//! An RS 434544 or 434546 without its serial port: its registers, and the effects of writes.
//!
//! | file | contents |
//! |---|---|
//! | `registers` | the register table, and the differences of the models |
//! | `startup` | start, factory reset, lights |
//! | `errors` | the register ERROR |
//! | `inputs` | IN1, IN2, HARD_STOP |
//! | `motion` | starts and stops of the motor |
//! | `reasons` | reasons why an accepted request has no effect |
//! | `program` | the user program |
//! | `commands` | start and stop of the program, and its access to the drive |
//! | `saved` | settings in the flash |
//! | `servo` | control of the motor |
//! | `thermal` | temperatures |

use drivetwin_protocol::modbus::pdu::Exception;
use drivetwin_protocol::registers::{Bank, Register};

use super::errors::{Errors, error};
use super::inputs::Inputs;
use super::motion::{self, Motion};
use super::program::Program;
use super::reasons::Why;
use super::registers::{Model, Reg, VERSIONS, key, line};
use super::servo::Servo;
use super::startup::{Clearing, Lights};
use super::thermal::{Part, Thermal};
use crate::device::{Boot, Context, Duration, Instant, Line, PresetError};
use crate::memory::PendingSave;
use crate::motor::Parameters;

/// State of the drive, from power-on to ready.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum State {
    /// No power.
    Off,
    /// Power is on, but other inputs of the same instant may still follow.
    Waking {
        /// The instant of power-on.
        due: Instant,
    },
    /// Resetting to the factory values.
    Clearing(Clearing),
    /// Starting. No message is received yet.
    Booting {
        /// End of the start.
        due: Instant,
    },
    /// Normal operation, with or without an error.
    Ready,
}

/// The storage of the registers.
pub(super) type Words = Bank<Reg, { Reg::WORDS }>;

/// The drive behind the serial port.
#[derive(Clone, Debug)]
pub(super) struct Drive {
    pub(super) model: Model,
    pub(super) state: State,
    /// True if there is no start-up delay.
    pub(super) fast: bool,
    /// State of the random numbers of TASK_COUNTER.
    random: u64,
    pub(super) bank: Words,
    pub(super) save: PendingSave,
    /// Time of the restart requested by FLAG_RESTART.
    pub(super) restart_due: Instant,

    pub(super) errors: Errors,
    pub(super) thermal: Thermal,
    pub(super) lights: Lights,

    pub(super) inputs: Inputs,
    pub(super) servo: Servo,
    /// True if the motor that the servo expects has changed.
    pub(super) other_motor: bool,
    pub(super) motion: Motion,

    pub(super) program: Program,
    /// Copy of the registers at the start of the program.
    pub(super) snapshot: Words,
}

impl Drive {
    // Inlined, so that the drive is built in its final place: a copy takes 6 KB of a board's stack.
    #[inline(always)]
    pub(super) fn new(model: Model) -> Self {
        let bank = Bank::of(model.entries());
        let settings = motion::settings(&bank, Errors::NONE);
        Self {
            model,
            state: State::Off,
            fast: false,
            random: 0,
            save: PendingSave::NONE,
            restart_due: Instant::NEVER,
            errors: Errors::NONE,
            thermal: Thermal::new(Instant::ZERO, model.rated_ma()),
            lights: Lights::DARK,
            inputs: Inputs::OPEN,
            servo: Servo::new(Instant::ZERO, settings),
            other_motor: false,
            motion: Motion::None,
            program: Program::new(),
            snapshot: bank.clone(),
            bank,
        }
    }

    /// Switches the power on. The caller then passes the states of all inputs.
    pub(super) fn power_on(&mut self, at: Instant, boot: Boot, out: &mut dyn Context) {
        (self.fast, self.random) = (boot.fast, boot.seed);
        self.errors = Errors::NONE;
        self.thermal = Thermal::new(at, self.model.rated_ma());
        self.lights = Lights::DARK;
        self.inputs = Inputs::OPEN;
        self.begin(at, out);
    }

    /// Restarts the drive: finishes saves and keeps the states of the inputs.
    pub(super) fn restart(&mut self, at: Instant, out: &mut dyn Context) {
        self.save.finish(at, out);
        self.program.save.finish(at, out);
        self.begin(at, out);
    }

    /// Resets all volatile state.
    fn begin(&mut self, at: Instant, out: &mut dyn Context) {
        self.state = State::Waking { due: at };
        self.errors.clear(u16::MAX);
        if !self.load_settings(out) {
            self.errors.warn(error::SETTINGS);
        }
        if !self.program.power_on(out) {
            self.errors.warn(error::PROGRAM_TEST);
        }
        (self.save, self.restart_due) = (PendingSave::NONE, Instant::NEVER);
        self.motion = Motion::None;
        self.other_motor = true;
        self.servo.power_on(at, self.servo_settings(), out);
        self.inputs.cancel_debounce();
        self.update_halls(at);
    }

    /// Next deadline of everything except the program.
    pub(super) fn deadline(&self) -> Instant {
        self.startup_due()
            .min(self.inputs.due())
            .min(self.servo.deadline())
            .min(self.save.due())
            .min(self.program.save.due())
            .min(self.restart_due)
    }

    /// Handles all deadlines up to `at`, except those of the program.
    pub(super) fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        if self.startup_due() <= at {
            self.startup_timeout(at, out);
        }
        self.save.timeout(at, out);
        self.program.save.timeout(at, out);
        if self.servo.deadline() <= at {
            self.servo.timeout(at, out);
        }
        self.inputs_timeout(at, out);
    }

    /// First instant at which characters are received; `None` while it is unknown.
    pub(super) fn receives_from(&self) -> Option<Instant> {
        match self.state {
            State::Off | State::Waking { .. } | State::Clearing(_) => None,
            State::Booting { due } => Some(due + Duration::TICK),
            State::Ready => Some(Instant::ZERO),
        }
    }

    /// Line settings for the next start (6.4).
    pub(super) fn line(&self) -> Line {
        line(self.bank.word(Reg::TYPE_MODBUS), self.bank.word(Reg::BITRATE_MODBUS))
    }

    /// Bus address for the next start (6.4; RS434-3).
    pub(super) fn unit(&self) -> u8 {
        (self.bank.word(Reg::SLAVE_ADDRESS_MODBUS) & 0xFF) as u8
    }

    /// Delay of every reply from the next start on (6.4).
    pub(super) fn reply_delay(&self) -> Duration {
        Duration::millis(self.bank.word(Reg::TIMEOUT_BROADCAST_MODBUS).into())
    }

    /// Delays a requested restart until `instant`, the end of the reply. Returns true if a restart is
    /// requested.
    pub(super) fn restart_after(&mut self, instant: Instant) -> bool {
        let wanted = self.restart_due != Instant::NEVER;
        if wanted {
            self.restart_due = self.restart_due.max(instant);
        }
        wanted
    }

    /// Parameters of the motor, from the registers (RS434-12).
    pub(super) fn motor(&self) -> Parameters {
        self.servo_settings().motor()
    }

    /// The parameters, if they may have changed since the last call of this function.
    pub(super) fn new_motor(&mut self) -> Option<Parameters> {
        if !self.other_motor {
            return None;
        }
        self.other_motor = false;
        Some(self.motor())
    }

    /// Handles a new motor current, in mA.
    pub(super) fn draws(&mut self, at: Instant, ma: i32) {
        let brakes = ma.signum() * i32::from(self.servo.direction()) < 0;
        self.thermal.draws(at, ma.unsigned_abs(), brakes);
        self.servo.draws(ma);
    }

    /// Value of a register at `at`.
    pub(super) fn value(&self, at: Instant, reg: Reg) -> i64 {
        match reg {
            Reg::IN1_bit => self.inputs.in1.closed.into(),
            Reg::IN2_bit => self.inputs.in2.closed.into(),
            Reg::IN_HARD_STOP_bit => self.inputs.hard_stop.into(),
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
            Reg::OFFSET => self.offset(),
            Reg::ERROR => self.errors.bits().into(),
            Reg::SUPPLY => self.errors.supply().into(),
            Reg::PC_REG => self.program.vm.line.into(),
            _ => match reg.system().and_then(|n| self.program.vm.registers.get(n)) {
                Some(&word) => word.into(),
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
    pub(super) fn refresh(&mut self, at: Instant, reg: Reg) {
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
            Reg::MODE_DEVICE | Reg::MODE_EXT_IN => self.levels_act(at, out),
            Reg::MODE_USER_PROGRAM => self.command_program(at, out),
            Reg::REF_CURRENT => {
                self.set_servo(at, out);
                self.check_errors(at, out);
            }
            Reg::USE_HALL => {
                self.halls_changed(at, out);
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
            Reg::DIRECTION => {
                if let Err(why) = self.direction_changed(at, out) {
                    why.put(at, out);
                }
            }
            Reg::ERROR => self.write_errors(at, self.bank.word(reg), out),
            Reg::SUPPLY => self.set_supply(at, self.bank.word(reg), out),
            Reg::FLAG_SAVE_INI => match self.take_unlock_key(reg) {
                key::SAVE => self.save_settings(at, out),
                _ => Why::NoKey.put(at, out),
            },
            Reg::FLAG_SAVE_USER_PROGRAM => match self.take_unlock_key(reg) {
                key::SAVE_PROGRAM => self.program.save(at, out),
                key::LOAD_PROGRAM => self.load_program(at, out),
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
                match reg.system().and_then(|n| self.program.vm.registers.get_mut(n)) {
                    Some(register) => *register = self.bank.word(reg),
                    None => self.put_postponed(at, reg, out),
                }
                return false;
            }
        }
        true
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

    /// Called when a value was outside the range of its row.
    pub(super) fn on_out_of_range(&mut self) {
        self.errors.warn(error::OUT_OF_RANGE);
    }

    /// Called when a character had a parity error or another error (RS434-5).
    pub(super) fn rx_error(&mut self) {
        self.errors.warn(error::PARITY);
    }

    /// Switches the power off. Only presets follow until the next power-on.
    pub(super) fn power_off(&mut self) {
        self.state = State::Off;
    }

    pub(super) fn poke(
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
        if self.state == State::Off {
            return if row.saved == 0 {
                Err(PresetError::ReadOnly)
            } else {
                self.preset(at, reg, value, out)
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

    /// Updates the state of the motion from the servo, then the lights.
    pub(super) fn update_outputs(&mut self, at: Instant, out: &mut dyn Context) {
        self.update_motion(at, out);
        self.update_lights(at, out);
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
