//! An MD3 without its serial port: its registers, its parts, and what follows from an event.
//!
//! | file | part of the drive |
//! |---|---|
//! | `startup` | start-up; the states of the lights |
//! | `io` | pins: levels, functions, outputs |
//! | `encoder` | the quadrature counter |
//! | `motion` | commands, moves, jogs, home cycles |
//! | `homing` | the settings of a home cycle, decoded |
//! | `motor` | outputs to the motor: plans, steps, duty, current |
//! | `current` | permission for the current, and its amount: faults, Disable, cutback; the lights |
//! | `eeprom` | saved registers |
//! | `reasons` | reasons why an accepted request has no effect |
//!
//! A part knows nothing of the drive. The drive passes it an event and what it needs, and then [settles](Drive::settle).

use drivetwin_protocol::modbus::server::RequestHandler;
use drivetwin_protocol::registers::{Bank, Register};

use super::current::Current;
use super::eeprom::Eeprom;
use super::encoder::Encoder;
use super::homing::Homing;
use super::io::{Edge, Io};
use super::motion::{Motion, Now};
use super::motor::Setting;
use super::reasons::Why;
use super::registers::{Reg, Version, motion_control};
use super::startup::Startup;
use super::{BUSY, MEMORY, Words, open_drain};
use crate::counter::Channel;
use crate::device::{Boot, Context, Fault, Instant, Output, Pin, PresetError, REPORTS_REASONS};
use crate::memory;

/// An MD3 without its serial port.
#[derive(Clone, Debug)]
pub(super) struct Drive {
    bank: Words,
    /// True if pins or counts have changed since the last [`Drive::bus`].
    stale: bool,
    startup: Startup,
    io: Io,
    encoder: Encoder,
    motion: Motion,
    current: Current,
    eeprom: Eeprom,
    /// True while BUSY is switched to ground.
    busy: bool,
    /// The earliest deadline of the parts. Characters and reads leave it as it is.
    due: Instant,
}

impl Drive {
    pub(super) fn new(version: Version) -> Self {
        let mut bank = Bank::factory();
        bank.set(Reg::ProductInformation, version.product());
        Self {
            bank,
            stale: false,
            startup: Startup::OFF,
            io: Io::new(),
            encoder: Encoder::new(),
            motion: Motion::new(Instant::ZERO),
            current: Current::new(version),
            eeprom: Eeprom::new(),
            busy: false,
            due: Instant::NEVER,
        }
    }

    /// Returns the end of the start-up.
    pub(super) fn power_on(&mut self, at: Instant, boot: Boot, out: &mut dyn Context) -> Instant {
        *self = Self::new(self.version());
        self.motion = Motion::new(at);
        let passed = self.eeprom.load(self.bank.words_mut(), out);
        self.current.disable(self.bank.word(Reg::MotionControl) & motion_control::DISABLE != 0);
        self.motion.begin(at, out);
        out.put(at, Output::Level { pin: BUSY, level: open_drain(false) });
        self.configure(at, out);
        self.io.write(at, self.bank.word(Reg::IOPortData), out);
        self.stale = true;
        self.settle(at, out);
        let delay = self.bank.clamped_value(Reg::StartupDelay).unsigned_abs();
        self.startup = Startup::begin(at, boot, passed, delay, out);
        self.due = self.earliest();
        self.startup.ready_at()
    }

    /// Switches the power off. Only presets follow until the next power-on.
    pub(super) fn power_off(&mut self) {
        self.startup = Startup::OFF;
        self.due = self.earliest();
    }

    /// Begins normal operation.
    fn ready(&mut self, at: Instant, out: &mut dyn Context) {
        self.current.switch_on(at);
        self.encoder.flush_filter();
        self.configure(at, out);
        if Homing::of(&self.bank).is_on_startup() {
            let _ = self.with_motion(at, out, Motion::home);
        }
        self.motion.arm();
    }

    pub(super) fn deadline(&self) -> Instant {
        debug_assert_eq!(self.due, self.earliest());
        self.due
    }

    fn earliest(&self) -> Instant {
        self.startup
            .deadline()
            .min(self.motion.deadline())
            .min(self.current.deadline())
            .min(self.eeprom.deadline())
            .min(self.encoder.deadline())
    }

    /// Does what is due at `at`. Mostly nothing is, and this comes before each received character.
    #[inline(always)]
    pub(super) fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        if at >= self.due {
            self.advance(at, out);
        }
    }

    /// Passes the instant to all parts.
    #[inline(never)]
    fn advance(&mut self, at: Instant, out: &mut dyn Context) {
        self.encoder.timeout(at);
        self.stale = true;
        if self.startup.timeout(at, out) {
            self.ready(at, out);
        }
        self.with_motion(at, out, Motion::timeout);
        self.eeprom.timeout(at, out);
        self.settle(at, out);
        self.due = self.earliest();
    }

    /// Carries out what follows from an event: motion, current, lights, BUSY, and the registers that show the
    /// drive's state (MD3-2).
    fn settle(&mut self, at: Instant, out: &mut dyn Context) {
        self.with_motion(at, out, Motion::settle);
        // J3 pin 7 is switched to ground while the motor moves, and during a fault (section 2; MD3-36).
        let busy = self.motion.is_moving() || self.current.has_fault();
        if self.busy != busy {
            self.busy = busy;
            out.put(at, Output::Level { pin: BUSY, level: open_drain(busy) });
        }
        self.bank.set(Reg::EEPROMControl, i64::from(self.eeprom.control()));
        self.bank.set(Reg::MotionControl, i64::from(self.current.control() | self.motion.control()));
    }

    /// Calls a function of the motion with what it reads and changes.
    fn with_motion<T>(
        &mut self,
        at: Instant,
        out: &mut dyn Context,
        call: impl FnOnce(&mut Motion, &mut Now<'_>) -> T,
    ) -> T {
        let Self { motion, bank, io, current, .. } = self;
        call(motion, &mut Now { at, bank, io, current, out })
    }

    /// Adds quarter cycles that a hardware counter of a board has counted.
    pub(super) fn count(&mut self, steps: i32, a: bool, b: bool) {
        self.encoder.add_counts(steps, a, b);
        self.io.set_channels(a, b);
        self.stale = true;
        self.due = self.earliest();
    }

    /// Adds `steps` that a board has made in addition to the plan.
    pub(super) fn correct_steps(&mut self, steps: i32) {
        self.motion.correct_steps(steps);
        self.due = self.earliest();
    }

    /// Handles a level at a pin. During the start-up it has no effect on the motion. Never inlined, because
    /// `Md3::input` also handles each received character.
    #[inline(never)]
    pub(super) fn edge(&mut self, at: Instant, pin: Pin, high: bool, out: &mut dyn Context) {
        self.stale = true;
        let Some(edge) = self.io.edge(pin, high) else { return };
        match edge {
            Edge::Request(request) => {
                if self.startup.is_ready() {
                    self.with_motion(at, out, |motion, now| motion.on_edge(request, now));
                    self.settle(at, out);
                }
            }
            Edge::Function => {
                let changes = self.io.poll();
                if self.startup.is_ready() {
                    self.with_motion(at, out, |motion, now| motion.react(&changes, now));
                    self.settle(at, out);
                }
            }
            Edge::Encoder(channel) => {
                self.encoder.edge(at, channel, high);
                if channel == Channel::Index && self.startup.is_ready() {
                    self.with_motion(at, out, Motion::check_target);
                    self.settle(at, out);
                }
            }
        }
        self.due = self.earliest();
    }

    /// The cause of a fault appears or ends.
    pub(super) fn set_fault(&mut self, at: Instant, fault: Fault, on: bool, out: &mut dyn Context) {
        if self.current.set_cause(fault, on) {
            self.with_motion(at, out, Motion::halt);
            self.settle(at, out);
            self.due = self.earliest();
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

    /// Microsteps in a full step (7.2).
    pub(super) fn microsteps(&self) -> u16 {
        self.setting().microsteps()
    }

    fn setting(&self) -> Setting {
        Setting(self.bank.word(Reg::MotorCurrentAndMicrostepping))
    }

    pub(super) fn version(&self) -> Version {
        self.current.version()
    }

    /// Access to the registers for a request from the bus. Pins and counts change too often for a copy to the bank
    /// at each change, so this function copies them.
    pub(super) fn bus<'a>(&'a mut self, at: Instant, out: &'a mut dyn Context) -> Bus<'a> {
        if self.stale {
            self.stale = false;
            for reg in [Reg::IOPortData, Reg::EncoderIndexCount, Reg::QuadratureEncoderCount] {
                self.bank.set(reg, self.value(reg));
            }
        }
        Bus { drive: self, at, out }
    }

    /// Present value of a register.
    fn value(&self, reg: Reg) -> i64 {
        match reg {
            Reg::IOPortData => i64::from(self.io.value()),
            Reg::EncoderIndexCount => i64::from(self.encoder.index_count()),
            Reg::QuadratureEncoderCount => i64::from(self.encoder.count()),
            _ => self.bank.get(reg),
        }
    }

    pub(super) fn peek(&self, row: usize) -> i64 {
        Reg::from_row(row).map_or(0, |reg| self.value(reg))
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
        let legal = if identifies { self.version().is_product(value) } else { row.accepts(value) };
        if !legal {
            return Err(PresetError::OutOfRange);
        }
        if row.saved == 0 && (self.startup.is_off() || !row.access.writes() && !identifies) {
            return Err(PresetError::ReadOnly);
        }
        if self.startup.is_off() {
            if !self.eeprom.load(self.bank.words_mut(), out) {
                return Err(PresetError::BadMemory);
            }
            self.bank.set(reg, value);
            memory::save_at_once::<MEMORY>(Reg::ENTRIES, self.bank.words(), at, out);
        } else {
            self.bank.set(reg, value);
            self.written(at, reg, out);
        }
        self.due = self.earliest();
        Ok(())
    }

    /// Applies a written register.
    fn written(&mut self, at: Instant, reg: Reg, out: &mut dyn Context) {
        if let Err(why) = self.apply(at, reg, out) {
            why.put(at, out);
        }
    }

    /// Applies a register that was written or loaded. The cases are in the order of the manual.
    ///
    /// # Errors
    /// The reason why the drive does not do what a write says.
    fn apply(&mut self, at: Instant, reg: Reg, out: &mut dyn Context) -> Result<(), Why> {
        let word = self.bank.word(reg);
        let mut done = Ok(());
        match reg {
            Reg::MotorCurrentAndMicrostepping => {
                self.configure(at, out);
                // A new PWM range may limit the speed in counts differently.
                let _ = self.with_motion(at, out, Motion::speed_changed);
                done = self.check_current_code(word);
                if !Setting(word).has_parameter() {
                    done = done.and(Err(Why::ParameterCode));
                }
            }
            Reg::HomingConfiguration
            | Reg::QuadratureEncoderConfiguration
            | Reg::QuadratureEncoderMaxCount => self.configure(at, out),
            Reg::CurrentCutbackSettings => done = self.check_current_code(word),
            Reg::StartupDelay => done = Err(Why::NextPowerOn),
            Reg::PinFunctionAndPolarity => {
                // A write of this register starts the endless modes (7.8).
                self.motion.arm();
                self.configure(at, out);
                self.io.put_outputs(at, out);
                self.stale = true;
            }
            Reg::IOPortData => {
                self.io.write(at, word, out);
                self.stale = true;
            }
            Reg::EncoderIndexCount => self.encoder.set_index_count(self.bank.get(reg) as i32),
            Reg::QuadratureEncoderCount => self.encoder.set_count(word),
            Reg::MotionControl => done = self.with_motion(at, out, |motion, now| motion.command(word, now)),
            Reg::MoveSteps | Reg::Speed | Reg::AlternateSpeed => {
                done = self.with_motion(at, out, Motion::speed_changed);
            }
            Reg::AccelDecel => self.with_motion(at, out, Motion::acceleration_changed),
            Reg::EEPROMControl => {
                // Save the value written to the pins: the bank may hold the one read from them.
                self.bank.set(Reg::IOPortData, i64::from(self.io.written()));
                self.stale = true;
                match self.eeprom.command(at, word, self.bank.words_mut(), out) {
                    Ok(true) => self.loaded(at, out),
                    Ok(false) => {}
                    Err(why) => done = Err(why),
                }
            }
            // `DeviceAddress` and `SerialPortConfiguration` apply from the next frame on. The drive reads the
            // other registers when it uses them.
            _ => {}
        }
        self.settle(at, out);
        done
    }

    /// Checks a current code. A code beyond the table acts as the last one (MD3-10).
    fn check_current_code(&self, code: u16) -> Result<(), Why> {
        if self.current.has_code(code) || !REPORTS_REASONS { Ok(()) } else { Err(Why::CurrentCode) }
    }

    /// Reads the settings of the motor, the pins and the encoder from their registers.
    fn configure(&mut self, at: Instant, out: &mut dyn Context) {
        let setting = self.setting();
        self.with_motion(at, out, |motion, now| motion.configure(setting, now));
        let ready = self.startup.is_ready();
        let changes = self.io.configure(
            self.bank.word(Reg::PinFunctionAndPolarity),
            Homing::of(&self.bank),
            self.motion.is_dc(),
        );
        self.encoder.configure(
            at,
            self.bank.word(Reg::QuadratureEncoderConfiguration),
            self.bank.word(Reg::QuadratureEncoderMaxCount),
            ready && !self.io.has_outputs(),
        );
        if ready {
            self.with_motion(at, out, |motion, now| motion.react(&changes, now));
            // A motion begins before the outputs get new levels.
            self.with_motion(at, out, Motion::resume);
        }
    }

    /// Applies all saved registers after they were loaded at once. A running motion gets the new acceleration
    /// first; an endless mode starts with the new values. The reasons of the registers are not the request's.
    fn loaded(&mut self, at: Instant, out: &mut dyn Context) {
        let control = self.bank.word(Reg::MotionControl);
        self.with_motion(at, out, Motion::acceleration_changed);
        for reg in [
            Reg::MotorCurrentAndMicrostepping,
            Reg::CurrentCutbackSettings,
            Reg::IOPortData,
            Reg::Speed,
            Reg::PinFunctionAndPolarity,
        ] {
            let _ = self.apply(at, reg, out);
        }
        let _ = self.with_motion(at, out, |motion, now| motion.command(control, now));
    }
}

/// Access to the drive's registers during a request from the bus.
pub(super) struct Bus<'a> {
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

    fn refresh(&mut self, _register: Reg) {
        // `Drive::bus` has refreshed the whole bank.
    }

    fn written(&mut self, register: Reg) {
        self.drive.written(self.at, register, self.out);
        self.drive.due = self.drive.earliest();
    }
}
