//! An MD3 without its serial port: its registers, and the effect of a write.
//!
//! | file | part of the drive |
//! |---|---|
//! | `startup` | start-up and lights |
//! | `current` | faults, cutback and motor current |
//! | `eeprom` | saved registers |
//! | `encoder` | the quadrature counter |
//! | `inputs` | reactions to changes of pins |
//! | `motion` | commands, moves, home cycles |
//! | `motor` | outputs to the motor: plans, steps, duty |
//! | `pins` | functions of J2 pins 2 to 5 |
//! | `reasons` | reasons why an accepted request has no effect |

use drivetwin_protocol::registers::{Bank, Register};

use super::eeprom::Eeprom;
use super::encoder::Encoder;
use super::motion::Motion;
use super::motor::Motor;
use super::pins::Pins;
use super::reasons::Why;
use super::registers::{
    LAST_PARAMETER, Reg, Version, eeprom_control, homing, io_port, microsteps, motion_control, parameter,
    pin_function, pwm,
};
use super::startup::{Lights, Startup};
use super::{BUSY, J2_9, J2_10, J2_12, J3_8, MEMORY};
use crate::device::{self, Context, Duration, Instant, Level, Output, PresetError, REPORTS_REASONS};
use crate::memory;

/// State of the drive, from power-on to ready.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum State {
    /// No power.
    Off,
    /// The start-up delay runs: the motor has no current and the drive does not listen.
    Starting(Startup),
    /// Boot without start-up delay: the drive becomes ready after all inputs of this instant.
    Waking(Instant),
    /// Normal operation, or a fault.
    Ready,
}

/// An MD3 without its serial port.
#[derive(Clone, Debug)]
pub(super) struct Drive {
    pub(super) version: Version,
    pub(super) state: State,
    pub(super) bank: Bank<Reg, { Reg::WORDS }>,
    /// True if pins or counts have changed since the last [`Drive::refresh`] of the bank.
    pub(super) stale: bool,
    eeprom: Eeprom,

    pub(super) pins: Pins,
    /// Levels of J2 pins 2, 3, 4, 5 and 9, 10, 12, in the bit positions of `IOPortData`.
    pub(super) levels: u16,
    /// Pins among J2 pins 2, 3, 4 and 5 that were active when the drive last read the pins, one bit each.
    pub(super) active: u16,
    /// True while INHIBIT is active.
    pub(super) inhibited: bool,
    /// True while `INHIBIT_MODBUS_MOTION` is active.
    pub(super) bus_inhibited: bool,
    /// True while SPEEDSEL selects `AlternateSpeed`.
    pub(super) alternate: bool,
    /// Step pulses before this instant are too fast and are lost.
    pub(super) next_step_allowed: Instant,
    /// Value last written to `IOPortData`.
    latch: u16,
    pub(super) encoder: Encoder,

    pub(super) motor: Motor,
    pub(super) motion: Motion,
    /// True while the levels of pins 4 and 5 and the endless modes may move the motor. A stop clears it. The
    /// next edge at pins 4 or 5 in a jog mode, a write of the pins' functions, the end of Disable, or a
    /// cleared fault sets it again.
    pub(super) armed: bool,

    /// True while MotionControl's Disable bit is set: the motor has no current (7.15).
    pub(super) disabled: bool,
    /// Bits of the faults that have their cause present.
    pub(super) causes: u8,
    pub(super) fault: bool,
    /// Time of the last command, input change, or start or end of a motion.
    pub(super) quiet_since: Instant,
    /// True once the cutback timeout has passed.
    pub(super) cut_back: bool,
    /// Time of the next cutback, stored because the drive's deadline is read often.
    cutback_at: Instant,
    /// Peak phase current, in mA.
    pub(super) current: u32,
    pub(super) lights: Lights,
    /// True while BUSY is switched to ground.
    busy: bool,
}

impl Drive {
    pub(super) fn new(version: Version) -> Self {
        let mut bank = Bank::factory();
        bank.set(Reg::ProductInformation, version.product());
        Self {
            version,
            state: State::Off,
            bank,
            stale: false,
            eeprom: Eeprom::new(),
            pins: Pins::new(0, 0, false),
            levels: io_port::INPUTS,
            active: 0,
            inhibited: false,
            bus_inhibited: false,
            alternate: false,
            next_step_allowed: Instant::ZERO,
            latch: 0,
            encoder: Encoder::new(),
            motor: Motor::new(Instant::ZERO),
            motion: Motion::None,
            armed: false,
            disabled: false,
            causes: 0,
            fault: false,
            quiet_since: Instant::ZERO,
            cut_back: false,
            cutback_at: Instant::NEVER,
            current: 0,
            lights: Lights::Starting,
            busy: false,
        }
    }

    pub(super) fn power_on(&mut self, at: Instant, boot: device::Boot, out: &mut dyn Context) {
        *self = Self::new(self.version);
        self.motor = Motor::new(at);
        let passed = self.eeprom.load(self.bank.words_mut(), out);
        self.latch = self.bank.word(Reg::IOPortData);
        self.disabled = self.bank.word(Reg::MotionControl) & motion_control::DISABLE != 0;
        self.motor.begin(at, out);
        out.put(at, Output::CurrentLimit { axis: super::AXIS, ma: 0 });
        out.put(at, Output::Level { pin: BUSY, level: open_drain(false) });
        self.configure(at, out);
        self.update_port(at, out);
        self.update_outputs(at, out);
        self.state = if boot.fast {
            State::Waking(at)
        } else {
            let delay = self.bank.clamped_value(Reg::StartupDelay).unsigned_abs();
            State::Starting(Startup::begin(at, passed, delay, out))
        };
    }

    /// Ends a start-up without delay. It is called before the first character is handled, when all other
    /// inputs of this instant have been handled.
    pub(super) fn wake(&mut self, at: Instant, out: &mut dyn Context) {
        if let State::Waking(due) = self.state
            && due <= at
        {
            self.ready(at, out);
        }
    }

    /// Ends the start-up. If the cause of a fault is present now, the drive is in a fault (MD3-15).
    fn ready(&mut self, at: Instant, out: &mut dyn Context) {
        self.state = State::Ready;
        self.restart_cutback(at);
        self.fault = self.causes != 0;
        // A pin that became active before this instant causes no edge now. Functions that depend on its level
        // apply.
        self.latch_inputs();
        self.encoder.flush_filter();
        self.configure(at, out);
        if self.bank.word(Reg::HomingConfiguration) & homing::ON_STARTUP != 0 {
            let _ = self.home(at, out);
        }
        self.armed = true;
        self.resume(at, out);
        self.update_outputs(at, out);
    }

    pub(super) fn deadline(&self) -> Instant {
        let starting = match self.state {
            State::Starting(startup) => startup.due,
            State::Waking(due) => due,
            State::Off | State::Ready => Instant::NEVER,
        };
        starting
            .min(self.motion_due())
            .min(self.motor.deadline())
            .min(self.cutback_at)
            .min(self.eeprom.deadline())
            .min(self.encoder.deadline())
    }

    pub(super) fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        if self.encoder.deadline() <= at {
            self.encoder.timeout(at);
            self.stale = true;
        }
        self.wake(at, out);
        if let State::Starting(startup) = self.state
            && startup.due <= at
        {
            match startup.next(at, out) {
                Some(next) => self.state = State::Starting(next),
                None => self.ready(at, out),
            }
        }
        self.motor.timeout(at, out);
        if self.motion_due() <= at {
            self.motion_over(at, out);
        }
        if self.cutback_due() <= at {
            self.cut_back = true;
        }
        self.eeprom.timeout(at, out);
        self.update_outputs(at, out);
    }

    /// Time from which the drive receives.
    pub(super) fn receives_from(&self) -> Instant {
        match self.state {
            State::Off => Instant::NEVER,
            State::Starting(startup) => startup.ready + Duration::TICK,
            State::Waking(_) | State::Ready => Instant::ZERO,
        }
    }

    /// The bus address (7.1).
    pub(super) fn address(&self) -> u8 {
        (self.bank.word(Reg::DeviceAddress) & 0xFF) as u8
    }

    /// The value of `SerialPortConfiguration` (7.22).
    pub(super) fn serial_port(&self) -> u16 {
        self.bank.word(Reg::SerialPortConfiguration)
    }

    pub(super) fn words(&self) -> &[u16] {
        self.bank.words()
    }

    pub(super) fn words_mut(&mut self) -> &mut [u16] {
        self.bank.words_mut()
    }

    /// Copies pins and counts to the bank. They change too often for a copy at each change, so a request
    /// calls this first.
    pub(super) fn refresh(&mut self) {
        if self.stale {
            self.stale = false;
            for reg in [Reg::IOPortData, Reg::EncoderIndexCount, Reg::QuadratureEncoderCount] {
                self.bank.set(reg, self.value(reg));
            }
        }
    }

    /// Present value of a register.
    fn value(&self, reg: Reg) -> i64 {
        match reg {
            Reg::IOPortData => {
                // Input pins read their level, output pins the written value (MD3-11).
                let gpio = if self.gpio_outputs() { 0 } else { io_port::GPIO };
                let pins = io_port::INPUTS | gpio;
                i64::from(self.latch & !pins | self.levels & pins)
            }
            Reg::EncoderIndexCount => i64::from(self.encoder.index_count()),
            Reg::QuadratureEncoderCount => i64::from(self.encoder.count()),
            _ => self.bank.get(reg),
        }
    }

    pub(super) fn peek(&self, row: usize) -> i64 {
        Reg::from_row(row).map_or(0, |reg| self.value(reg))
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
        let row = Reg::ENTRIES.list.get(reg.row()).ok_or(PresetError::NoSuchRegister)?;
        let identifies = reg == Reg::ProductInformation;
        let legal = if identifies { self.version.is_product(value) } else { row.accepts(value) };
        if !legal {
            return Err(PresetError::OutOfRange);
        }
        if row.saved == 0 && (self.state == State::Off || !row.access.writes() && !identifies) {
            return Err(PresetError::ReadOnly);
        }
        if self.state == State::Off {
            if !self.eeprom.load(self.bank.words_mut(), out) {
                return Err(PresetError::BadMemory);
            }
            self.bank.set(reg, value);
            memory::save_at_once::<MEMORY>(Reg::ENTRIES, self.bank.words(), at, out);
        } else {
            self.bank.set(reg, value);
            self.written(at, reg, out);
        }
        Ok(())
    }

    /// Applies a written register.
    pub(super) fn written(&mut self, at: Instant, reg: Reg, out: &mut dyn Context) {
        if let Err(why) = self.apply(at, reg, out) {
            why.put(at, out);
        }
    }

    /// Applies a register that was written or loaded. The cases are in the order of the manual.
    ///
    /// # Errors
    /// The reason why the drive does not do what a write says.
    fn apply(&mut self, at: Instant, reg: Reg, out: &mut dyn Context) -> Result<(), Why> {
        let mut done = Ok(());
        match reg {
            Reg::MotorCurrentAndMicrostepping => {
                self.configure(at, out);
                // A new PWM range may limit the speed in counts differently.
                self.speed_changed(at, out);
                done = self.check_current_code(reg);
                if parameter(self.bank.word(reg)) > LAST_PARAMETER {
                    done = done.and(Err(Why::ParameterCode));
                }
            }
            Reg::HomingConfiguration
            | Reg::QuadratureEncoderConfiguration
            | Reg::QuadratureEncoderMaxCount => self.configure(at, out),
            Reg::CurrentCutbackSettings => {
                // The time since the last activity counts toward the new timeout.
                self.cut_back = false;
                self.cut_back = self.cutback_due() <= at;
                done = self.check_current_code(reg);
            }
            Reg::StartupDelay => done = Err(Why::NextPowerOn),
            Reg::PinFunctionAndPolarity => {
                // A write of this register starts the endless modes (7.8).
                self.armed = true;
                self.configure(at, out);
                self.update_port(at, out);
            }
            Reg::IOPortData => {
                self.latch = self.bank.word(reg);
                self.update_port(at, out);
            }
            Reg::EncoderIndexCount => self.encoder.set_index_count(self.bank.get(reg) as i32),
            Reg::QuadratureEncoderCount => self.encoder.set_count(self.bank.word(reg)),
            Reg::MotionControl => done = self.command(at, self.bank.word(reg), out),
            Reg::MoveSteps | Reg::Speed | Reg::AlternateSpeed if self.motion == Motion::Profile => {
                done = Err(Why::NextMove);
            }
            Reg::PreHomeOffset | Reg::HomeOffset | Reg::MoveSteps => self.resume(at, out),
            Reg::Speed | Reg::AlternateSpeed => self.speed_changed(at, out),
            Reg::AccelDecel => self.acceleration_changed(at, out),
            Reg::EEPROMControl => done = self.eeprom_command(at, self.bank.word(reg), out),
            // `DeviceAddress` and `SerialPortConfiguration` apply from the next frame on. The drive reads the
            // other registers when it uses them.
            _ => {}
        }
        self.update_outputs(at, out);
        done
    }

    /// Checks the current code of a register. A code beyond the table acts as the last one (MD3-10).
    fn check_current_code(&self, reg: Reg) -> Result<(), Why> {
        let exists = self.bank.word(reg) & 0xFF <= self.version.last_current_code();
        if exists || !REPORTS_REASONS { Ok(()) } else { Err(Why::CurrentCode) }
    }

    /// Microsteps in a full step (7.2). This setting does not change counts, which are always microsteps
    /// (MD3-17).
    pub(super) fn microsteps(&self) -> u16 {
        microsteps(self.bank.word(Reg::MotorCurrentAndMicrostepping))
    }

    /// Reads the settings of the motor, the pins and the encoder from their registers.
    fn configure(&mut self, at: Instant, out: &mut dyn Context) {
        let pwm = pwm(self.bank.word(Reg::MotorCurrentAndMicrostepping));
        let function = self.bank.word(Reg::PinFunctionAndPolarity);
        let ready = self.state == State::Ready;
        if self.motor.is_dc() != pwm.is_some() {
            self.halt(at, out);
        }
        self.motor.set_pwm(at, pwm, out);
        self.encoder.configure(
            at,
            self.bank.word(Reg::QuadratureEncoderConfiguration),
            self.bank.word(Reg::QuadratureEncoderMaxCount),
            ready && !self.gpio_outputs(),
        );
        let homing = self.bank.word(Reg::HomingConfiguration);
        let before = self.pins.mode;
        self.pins = Pins::new(function, homing, self.motor.is_dc());
        if ready {
            self.mode_changed(before, at, out);
            self.poll_inputs(at, out);
        }
    }

    /// Applies a write of `EEPROMControl` (7.20). If both bits are set, the drive saves.
    ///
    /// # Errors
    /// The reason why the drive does not save, or does not read.
    fn eeprom_command(&mut self, at: Instant, word: u16, out: &mut dyn Context) -> Result<(), Why> {
        let reads = word & eeprom_control::READ != 0;
        if word & eeprom_control::WRITE != 0 {
            // Save the value written to the pins: the bank may hold the one read from them.
            self.bank.set(Reg::IOPortData, i64::from(self.latch));
            self.stale = true;
            self.eeprom.save(at, self.bank.words(), out)?;
            return if reads { Err(Why::SavesOnly) } else { Ok(()) };
        }
        if reads {
            if self.eeprom.is_saving() {
                return Err(Why::Saves);
            }
            if !self.eeprom.load(self.bank.words_mut(), out) {
                return Err(Why::BadCrc);
            }
            self.loaded(at, out);
        }
        Ok(())
    }

    /// Applies all saved registers after they were loaded at once. A running motion gets the new acceleration
    /// first; an endless mode starts with the new values. The reasons of the registers are not the request's.
    fn loaded(&mut self, at: Instant, out: &mut dyn Context) {
        let control = self.bank.word(Reg::MotionControl);
        self.acceleration_changed(at, out);
        for reg in [
            Reg::MotorCurrentAndMicrostepping,
            Reg::CurrentCutbackSettings,
            Reg::IOPortData,
            Reg::Speed,
            Reg::PinFunctionAndPolarity,
        ] {
            let _ = self.apply(at, reg, out);
        }
        let _ = self.command(at, control, out);
    }

    /// A board has made `steps` more steps than the plan has.
    pub(super) fn correct_steps(&mut self, steps: i32) {
        self.motor.correct_steps(steps);
    }

    /// Returns true if J2 pins 9, 10 and 12 are outputs.
    pub(super) fn gpio_outputs(&self) -> bool {
        self.bank.word(Reg::PinFunctionAndPolarity) & pin_function::OUTPUTS != 0
    }

    /// Updates the current, the lights, BUSY, and the registers that show the drive's state (MD3-2).
    pub(super) fn update_outputs(&mut self, at: Instant, out: &mut dyn Context) {
        self.update_current(at, out);
        self.cutback_at = self.cutback_due();
        // J3 pin 7 is switched to ground while the motor moves, and during a fault (section 2; MD3-36).
        let moves = if self.motor.is_dc() { self.motor.is_driven() } else { self.motion != Motion::None };
        let busy = moves || self.fault;
        if self.busy != busy {
            self.busy = busy;
            out.put(at, Output::Level { pin: BUSY, level: open_drain(busy) });
        }
        self.bank.set(Reg::EEPROMControl, i64::from(self.eeprom.control()));
        let disable = if self.disabled { motion_control::DISABLE } else { 0 };
        let fault = if self.fault { motion_control::FAULT } else { 0 };
        self.bank.set(Reg::MotionControl, i64::from(fault | disable | self.motion.bit()));
    }

    /// Drives the outputs of IOPortData (7.9).
    fn update_port(&mut self, at: Instant, out: &mut dyn Context) {
        self.stale = true;
        out.put(at, Output::Level { pin: J3_8, level: open_drain(self.latch & io_port::J3_8 != 0) });
        for (pin, bit) in [(J2_9, io_port::J2_9), (J2_10, io_port::J2_10), (J2_12, io_port::J2_12)] {
            let level = match (self.gpio_outputs(), self.latch & bit != 0) {
                (false, _) => Level::Float,
                (true, false) => Level::Low,
                (true, true) => Level::High,
            };
            out.put(at, Output::Level { pin, level });
        }
    }
}

/// Level of a transistor to ground: low if it is on.
fn open_drain(on: bool) -> Level {
    if on { Level::Low } else { Level::Float }
}
