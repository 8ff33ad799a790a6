//! Power-on, restarts and the sign-on; what the drive loads, and presets of what it will load.

use super::Drive;
use crate::device::{Boot, Context, Instant, NullContext, PresetError};
use crate::mdrive::error::Error;
use crate::mdrive::io::Io;
use crate::mdrive::mcode::console::{Consoles, note_lost_input, prompt};
use crate::mdrive::mcode::names::Names;
use crate::mdrive::mcode::operand::Place;
use crate::mdrive::registers::{Model, Reg};
use crate::mdrive::saved::{Saving, load_globals};
use crate::mdrive::variables::{entry, is_number, words};

/// Label of the program that the drive runs when it is ready (MC 5-71).
const START_UP: Place = Place::Label(*b"SU");

impl Drive {
    /// Starts the drive at power-on. No connection is open, and the levels of all inputs follow as events.
    pub(in crate::mdrive) fn power_on(&mut self, at: Instant, boot: Boot, out: &mut dyn Context) {
        self.startup.power_on(boot);
        self.saving = Saving::NONE;
        self.mcode.consoles = Consoles::new();
        self.start(at, true, out);
    }

    /// Restarts the drive. Unlike at power-on, connections stay open (the Ethernet controller is another
    /// processor), and the levels of the inputs are known already.
    pub(in crate::mdrive) fn restart(&mut self, at: Instant, out: &mut dyn Context) {
        // A save in progress is finished first, because it was commanded before the restart.
        self.saving.finish(at, out);
        // What was typed, and a line in execution, is lost.
        note_lost_input(at, out);
        self.mcode.consoles.restart();
        self.start(at, false, out);
    }

    fn start(&mut self, at: Instant, whole: bool, out: &mut dyn Context) {
        self.mcode.clear(&mut self.motion);
        self.hybrid.restart(whole);
        let good = self.load(out);
        self.io.power_on(at, whole, out);
        if whole {
            self.motion.shaft_mut().unplug(at);
        }
        self.motion.power_on(at, self.io.motion_settings(&self.bank), out);
        self.apply_variables(at, out);
        if !good {
            self.mcode.errors.set(Error::Flash);
        }
        self.startup.begin(at, whole);
    }

    /// Begins to receive messages. A Hybrid calibrates now, unless it starts without delay.
    pub(super) fn ready(&mut self, at: Instant, out: &mut dyn Context) {
        self.io.ready();
        if self.bank.model() == Model::Hybrid {
            if self.startup.is_fast() {
                self.hybrid.set_calibrated();
            } else if let Err(error) = self.calibrate(at, false, out) {
                self.mcode.fail(at, error, &mut self.motion);
            }
        }
    }

    /// Sends the sign-on and runs SU. A Hybrid does so once it is calibrated (MC 5-9).
    pub(super) fn sign_on(&mut self, at: Instant, out: &mut dyn Context) {
        if !self.startup.is_calibrating() || self.hybrid.is_calibrating() {
            return;
        }
        self.startup.sign_on();
        self.mcode.consoles.greet(at, prompt(&self.bank, self.mcode.errors), out);
        if self.mcode.names.find(*b"SU").is_some()
            && let Err(error) = self.mcode.start(at, START_UP, 0, &mut self.motion)
        {
            self.mcode.fail(at, error, &mut self.motion);
        }
    }

    /// Loads variables, global user variables and the program when the drive starts. Returns true if the
    /// memory was good (error 70 if not). The factory's values replace bad parts.
    fn load(&mut self, out: &dyn Context) -> bool {
        let saved = self.bank.load(out) && load_globals(&mut self.mcode.names, out);
        if !saved {
            self.bank.factory_reset();
            self.mcode.names = Names::new();
        }
        self.mcode.load_program(self.bank.variants(), out) && saved
    }

    /// IP: loads the variables and flags that were saved.
    ///
    /// # Errors
    /// Error 70 if the saved values are bad, 74 in motion.
    pub(in crate::mdrive) fn initialize(&mut self, at: Instant, out: &mut dyn Context) -> Result<(), Error> {
        if self.reader(at).is_in_motion() {
            return Err(Error::ClearInMotion);
        }
        // A save in progress is finished first, because it was commanded before IP.
        self.saving.finish(at, out);
        let good = self.bank.load(out);
        self.apply_variables(at, out);
        if good { Ok(()) } else { Err(Error::Flash) }
    }

    /// Applies all variables to I/O and motion.
    pub(in crate::mdrive) fn apply_variables(&mut self, at: Instant, out: &mut dyn Context) {
        self.set_filters(at, out);
        self.apply_set_ups(at, out);
        self.set_motion(at, out);
    }

    /// Applies the set-ups of all I/O points. A set-up that is not possible is replaced by the factory's.
    fn apply_set_ups(&mut self, at: Instant, out: &mut dyn Context) {
        self.io.begin_load();
        for reg in [Reg::S1, Reg::S2, Reg::S3, Reg::S4, Reg::S5, Reg::S7, Reg::S8, Reg::S13] {
            if self.bank.has(reg) && self.set_up(at, reg, self.bank.set_up_of(reg), out).is_err() {
                self.bank.set(reg, entry(reg).reset);
                let _ = self.set_up(at, reg, self.bank.set_up_of(reg), out);
            }
        }
        self.io.end_load(at, out);
    }

    /// Presets a variable before power-on, as if it had been saved.
    pub(super) fn preset(
        &mut self,
        at: Instant,
        reg: Reg,
        value: i64,
        out: &mut dyn Context,
    ) -> Result<(), PresetError> {
        if !self.bank.load(out) || !load_globals(&mut self.mcode.names, out) {
            return Err(PresetError::BadMemory);
        }
        match i32::try_from(value) {
            _ if !is_number(reg) => {
                // The I/O points decide whether the set-up is possible, so they are set up as a trial. They
                // are new again at power-on.
                self.apply_set_ups(at, &mut NullContext);
                let validated = self.set_up(at, reg, words(reg, value), &mut NullContext);
                self.io = Io::OPEN;
                validated.map_err(|_| PresetError::OutOfRange)?;
            }
            Ok(value) => {
                let validated = self.reader(at).validate(reg, value, &|other| self.bank.stored(other));
                validated.map_err(|_| PresetError::OutOfRange)?;
                self.bank.store(reg, value);
            }
            Err(_) => return Err(PresetError::OutOfRange),
        }
        self.saving.begin(at, &mut self.bank, &self.mcode.names, out);
        self.saving.finish(at, out);
        Ok(())
    }
}
