//! An RS 434544 or 434546 without its serial port. It joins its parts, which own their state and do not know the drive.
//!
//! | file | contents |
//! |---|---|
//! | `registers` | the register table, and the differences of the models |
//! | `drive/access` | reads and writes of registers, by the bus, the program and presets |
//! | `drive/program_host` | the drive as its user program uses it |
//! | `startup` | start, factory reset, lights |
//! | `errors` | the register ERROR |
//! | `inputs` | IN1, IN2, HARD_STOP |
//! | `motion` | the motion that was started last |
//! | `reasons` | reasons why an accepted request has no effect |
//! | `program` | the user program |
//! | `saved` | settings in the flash |
//! | `servo` | control of the motor |
//! | `thermal` | temperatures |

mod access;
mod program_host;

use drivetwin_protocol::registers::{Bank, Register};

pub(super) use self::access::Bus;
pub(super) use self::program_host::run_program;
use super::errors::{Error, Errors};
use super::inputs::{Direction, Inputs, Orders, Run};
use super::motion::{self, Heading, Motion};
use super::program::{Program, Status};
use super::reasons::Why;
use super::registers::{Model, Reg, Words, line};
use super::servo::{Servo, Settings};
use super::startup::{self, Startup};
use super::thermal::Thermal;
use super::{BusSettings, CLR_FLASH, HA, HARD_STOP, HB, IN1, IN2, saved};
use crate::device::{Boot, Context, Duration, Input, Instant, Pin};
use crate::memory::{self, PendingSave};
use crate::motor::Parameters;

/// The drive behind the serial port.
#[derive(Clone, Debug)]
pub(super) struct Drive {
    model: Model,
    startup: Startup,
    /// State of the random numbers of TASK_COUNTER.
    random: u64,
    bank: Words,
    save: PendingSave,
    /// Time of the restart requested by FLAG_RESTART.
    restart_due: Instant,

    errors: Errors,
    thermal: Thermal,

    inputs: Inputs,
    servo: Servo,
    /// True if the motor that the servo expects has changed.
    other_motor: bool,
    motion: Motion,

    program: Program,
    /// Copy of the registers at the start of the program.
    snapshot: Words,
}

impl Drive {
    // Inlined, so that the drive is built in its final place: a copy takes 6 KB of a board's stack.
    #[inline(always)]
    pub(super) fn new(model: Model) -> Self {
        let bank = Bank::of(model.entries());
        Self {
            model,
            startup: Startup::OFF,
            random: 0,
            save: PendingSave::NONE,
            restart_due: Instant::NEVER,
            errors: Errors::NONE,
            thermal: Thermal::new(Instant::ZERO, model.rated_ma()),
            inputs: Inputs::OPEN,
            servo: Servo::new(Instant::ZERO, Settings::of(&bank, false)),
            other_motor: false,
            motion: Motion::NONE,
            program: Program::new(),
            snapshot: bank.clone(),
            bank,
        }
    }

    /// Switches the power on. The caller then passes the states of all inputs.
    pub(super) fn power_on(&mut self, at: Instant, boot: Boot, out: &mut dyn Context) {
        self.startup.power_on(at, boot.fast);
        self.random = boot.seed;
        self.errors = Errors::NONE;
        self.thermal = Thermal::new(at, self.model.rated_ma());
        self.inputs = Inputs::OPEN;
        self.begin(at, out);
    }

    /// Restarts the drive if that is due: finishes saves and keeps the states of the inputs. Returns true if it restarts.
    pub(super) fn restart(&mut self, at: Instant, out: &mut dyn Context) -> bool {
        let is_due = self.restart_due <= at;
        if is_due {
            self.save.finish(at, out);
            self.program.finish_save(at, out);
            self.startup.restart(at);
            self.begin(at, out);
        }
        is_due
    }

    /// Resets all volatile state.
    fn begin(&mut self, at: Instant, out: &mut dyn Context) {
        self.errors.restart();
        if !saved::load(self.model.entries(), &mut self.bank, out.memory()) {
            self.errors.warn(Error::Settings);
        }
        if !self.program.power_on(out) {
            self.errors.warn(Error::ProgramTest);
        }
        (self.save, self.restart_due) = (PendingSave::NONE, Instant::NEVER);
        self.motion = Motion::NONE;
        self.other_motor = true;
        self.servo.power_on(at, self.servo_settings(), out);
        self.inputs.cancel_debounce();
        // No event reports the levels of the Hall sensors after a restart.
        for (a, high) in self.inputs.halls() {
            self.servo.edge(at, a, high);
        }
    }

    /// Switches the power off. Only presets follow until the next power-on.
    pub(super) fn power_off(&mut self) {
        self.startup.power_off();
    }

    /// Next deadline of everything except the program.
    pub(super) fn deadline(&self) -> Instant {
        self.startup
            .deadline()
            .min(self.save.due())
            .min(self.program.save_due())
            .min(self.servo.deadline())
            .min(self.inputs.deadline())
            .min(self.restart_due)
    }

    /// Handles all deadlines up to `at`, except those of the program and of the restart.
    pub(super) fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        self.continue_start(at, out);
        self.save.timeout(at, out);
        self.program.save_timeout(at, out);
        self.servo.timeout(at, out);
        if let Some(orders) = self.inputs.timeout(at, self.input_mode()) {
            self.obey(at, orders, out);
        }
    }

    /// Takes errors and the end of a motion from the servo, and updates the lights. Called after every event.
    pub(super) fn settle(&mut self, at: Instant, out: &mut dyn Context) {
        let errors = self.servo.errors();
        self.raise(at, errors, out);
        self.motion.follow(&self.servo, &mut self.bank);
        self.startup.show(at, self.errors.stop(), out);
    }

    fn continue_start(&mut self, at: Instant, out: &mut dyn Context) {
        while let Some(step) = self.startup.timeout(at) {
            match step {
                startup::Step::Reset => self.reset_settings(at, out),
                startup::Step::Ready => self.ready(at, out),
            }
        }
    }

    /// Resets the settings to the factory values, also in the flash (section 7).
    fn reset_settings(&mut self, at: Instant, out: &mut dyn Context) {
        memory::reset(self.model.entries(), self.bank.words_mut());
        self.set_servo(at, out);
        self.save_settings(at, out);
    }

    /// Ends the start: reports errors, executes the inputs, and starts the program if it is selected.
    fn ready(&mut self, at: Instant, out: &mut dyn Context) {
        self.check_errors(at, out);
        self.inputs.accept();
        self.obey_levels(at, out);
        if self.bank.word(Reg::MODE_USER_PROGRAM) == 3 {
            let _ = self.start_program(at, Status::StartedByPower, out);
        }
    }

    /// End of the start; `None` while it is unknown.
    pub(super) fn ready_at(&self) -> Option<Instant> {
        self.startup.ready_at()
    }

    /// Settings of the bus for the next start (6.4; RS434-3).
    pub(super) fn bus_settings(&self) -> BusSettings {
        let word = |reg| self.bank.word(reg);
        BusSettings {
            line: line(word(Reg::TYPE_MODBUS), word(Reg::BITRATE_MODBUS)),
            unit: (word(Reg::SLAVE_ADDRESS_MODBUS) & 0xFF) as u8,
            delay: Duration::millis(word(Reg::TIMEOUT_BROADCAST_MODBUS).into()),
        }
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

    pub(super) fn model(&self) -> Model {
        self.model
    }

    /// Parameters of the motor, from the registers (RS434-12).
    pub(super) fn motor(&self) -> Parameters {
        self.servo_settings().motor()
    }

    /// The parameters, if they may have changed since the last call of this function.
    pub(super) fn new_motor(&mut self) -> Option<Parameters> {
        core::mem::take(&mut self.other_motor).then(|| self.motor())
    }

    /// Handles an input other than characters.
    pub(super) fn input(&mut self, at: Instant, input: &Input<'_>, out: &mut dyn Context) {
        match *input {
            Input::Edge { pin, high } => self.edge(at, pin, high, out),
            Input::Fault { fault, on } => {
                self.errors.set_fault(fault, on);
                self.set_servo(at, out);
                self.check_errors(at, out);
            }
            Input::MotorCurrent { ma, .. } => {
                let brakes = ma.signum() * i32::from(self.servo.direction()) < 0;
                self.thermal.draws(at, ma.unsigned_abs(), brakes);
                self.servo.report(at, input);
            }
            _ => self.servo.report(at, input),
        }
    }

    /// Handles a change of a contact or a Hall sensor.
    fn edge(&mut self, at: Instant, pin: Pin, high: bool, out: &mut dyn Context) {
        match pin {
            IN1 | IN2 | HARD_STOP => {
                let time = |reg| Duration::millis(self.bank.word(reg).into());
                let times = [time(Reg::PRESSED_INPUTS_EXTERN), time(Reg::WAITED_INPUTS_EXTERN)];
                self.inputs.contact(at, pin, !high, times);
                if !self.startup.is_ready() {
                    self.inputs.cancel_debounce();
                } else if !self.inputs.is_closed(HARD_STOP) {
                    self.raise(at, Error::EmergencyStop as u16, out);
                }
            }
            CLR_FLASH if self.startup.clr_flash(at, !high) => self.continue_start(at, out),
            HA | HB => {
                self.inputs.hall(pin == HA, high);
                self.servo.edge(at, pin == HA, high);
            }
            _ => {}
        }
    }

    /// Called when a character had a parity error or another error (RS434-5).
    pub(super) fn rx_error(&mut self) {
        self.errors.warn(Error::Parity);
    }

    /// Sets bits of ERROR. Stops the motor if a newly set bit requires it.
    fn raise(&mut self, at: Instant, errors: u16, out: &mut dyn Context) {
        if self.errors.raise(errors) {
            self.motion.halt(at, &mut self.servo, out);
        }
    }

    /// Sets the bits of the present errors. Called at the end of the start, and after any change of a cause.
    fn check_errors(&mut self, at: Instant, out: &mut dyn Context) {
        if !self.startup.is_ready() {
            return;
        }
        let mut errors = self.errors.caused(self.bank.word(Reg::REF_CURRENT), self.model.short_ma());
        if !self.inputs.is_closed(HARD_STOP) {
            errors |= Error::EmergencyStop as u16;
        }
        self.raise(at, errors | self.thermal.errors(at), out);
    }

    /// MODE_EXT_IN if the inputs control the motor; 0 if the bus does.
    fn input_mode(&self) -> u16 {
        if self.bank.word(Reg::MODE_DEVICE) == 2 { self.bank.word(Reg::MODE_EXT_IN) } else { 0 }
    }

    /// Executes the present levels of the contacts. Called when the drive is ready, and when MODE_DEVICE or MODE_EXT_IN
    /// is written (RS434-22).
    fn obey_levels(&mut self, at: Instant, out: &mut dyn Context) {
        if self.startup.is_ready() {
            self.obey(at, self.inputs.levels(self.input_mode()), out);
        }
    }

    fn obey(&mut self, at: Instant, Orders { direction, run }: Orders, out: &mut dyn Context) {
        if let Some(direction) = direction {
            let forward = match direction {
                Direction::Forward => true,
                Direction::Backward => false,
                Direction::Reversed => !motion::is_forward(&self.bank),
            };
            self.bank.set(Reg::DIRECTION, if forward { 1 } else { 2 });
            let _ = self.direction_changed(at, out);
        }
        match run {
            Some(Run::Start(heading)) => {
                if self.motion.is_against(heading) {
                    self.motion.stop(&mut self.servo);
                }
                let _ = self.start(at, heading, out);
            }
            Some(Run::Toggle) if self.servo.direction() == 0 => {
                let _ = self.start(at, Heading::Registers, out);
            }
            Some(Run::Stop | Run::Toggle) => self.motion.stop(&mut self.servo),
            None => {}
        }
    }

    /// Starts the motor as MODE_ROTATION selects, unless an error forbids it or a move is in progress.
    ///
    /// # Errors
    /// The reason why nothing starts.
    fn start(&mut self, at: Instant, heading: Heading, out: &mut dyn Context) -> Result<(), Why> {
        if !self.startup.is_ready() {
            return Ok(());
        }
        if self.errors.stop() {
            return Err(Why::HasError);
        }
        let done = self.motion.start(at, heading, &mut self.servo, &mut self.bank, out);
        if done == Err(Why::TooFewHalls) {
            self.errors.warn(Error::TooFewHalls);
        }
        done
    }

    /// Applies a new DIRECTION to continuous rotation at once.
    ///
    /// # Errors
    /// DIRECTION has no effect now, because each input has a direction of its own.
    fn direction_changed(&mut self, at: Instant, out: &mut dyn Context) -> Result<(), Why> {
        if self.input_mode() == 5 {
            return Err(Why::DirectionOfInputs);
        }
        self.motion.direction_changed(at, motion::is_forward(&self.bank), &mut self.servo, out);
        Ok(())
    }

    /// Passes the settings to the servo. Returns true if they have changed.
    fn set_servo(&mut self, at: Instant, out: &mut dyn Context) -> bool {
        let settings = self.servo_settings();
        let changed = self.servo.set(at, settings, out);
        self.other_motor |= changed;
        changed
    }

    fn servo_settings(&self) -> Settings {
        Settings::of(&self.bank, self.errors.halves_limit())
    }

    /// Starts to save the settings. A save in progress starts again.
    fn save_settings(&mut self, at: Instant, out: &mut dyn Context) {
        self.store_offset();
        self.save.begin(saved::save(self.model.entries(), &self.bank, at, out));
    }

    /// Stores the present value of OFFSET in the bank.
    fn store_offset(&mut self) {
        self.bank.set(Reg::OFFSET, self.motion.offset(&self.servo, &self.bank));
    }

    /// Time of the next line of the program.
    pub(super) fn line_due(&self) -> Instant {
        self.program.line_due()
    }

    /// Number of the line that is executed next, if lines are executed.
    pub(super) fn program_line(&self) -> Option<u16> {
        self.program.next_line()
    }

    /// Starts the program, unless it already runs. Saves a copy of the registers, which the program's end may
    /// restore.
    ///
    /// # Errors
    /// The reason why no line of a saved program will be executed.
    fn start_program(&mut self, at: Instant, status: Status, out: &mut dyn Context) -> Result<(), Why> {
        if !self.startup.is_ready() {
            return Ok(());
        }
        if self.program.status() == Status::Running {
            return Err(Why::ProgramRuns);
        }
        self.store_offset();
        self.snapshot = self.bank.clone();
        self.errors.clear(!(Error::Program as u16));
        self.program.start(at, status);
        if self.program.status() == Status::Failed {
            self.program_failed(at, out);
            return Err(Why::BadProgram);
        }
        if self.program.is_new() { Err(Why::NoProgram) } else { Ok(()) }
    }

    /// Handles CMD_FULL_STOP_PROGRAM: restores the registers from before the start, and stops the motor
    /// (RS434-27).
    fn program_fully_ended(&mut self, at: Instant, out: &mut dyn Context) {
        let mode = self.bank.word(Reg::MODE_USER_PROGRAM);
        let offset = |reg: Reg| Reg::ENTRIES.offset(reg.row());
        // 5004h to 5022h, which are contiguous in the bank.
        let (first, end) = (offset(Reg::MODE_DEVICE), offset(Reg::ERROR));
        let words = self.bank.words_mut().iter_mut().zip(self.snapshot.words());
        for (word, before) in words.take(end).skip(first) {
            *word = *before;
        }
        self.bank.set(Reg::MODE_USER_PROGRAM, mode.into());
        self.set_servo(at, out);
        self.motion.brake(&mut self.servo);
    }

    /// Handles a program line that cannot be executed, or a missing one (RS434-33).
    fn program_failed(&mut self, at: Instant, out: &mut dyn Context) {
        self.raise(at, Error::Program as u16, out);
        self.motion.stop(&mut self.servo);
    }
}
