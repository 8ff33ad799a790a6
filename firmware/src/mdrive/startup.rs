//! Start and restart of the drive: Ctrl-C, a reset input.

use super::drive::{Drive, Model, State, motion_settings};
use super::error::{Error, Errors};
use super::mcode::console::Consoles;
use super::mcode::statement::Place;
use super::mcode::trip::Trips;
use super::mcode::vm::Vm;
use crate::device::{Boot, Context, Duration, Instant};

/// Text that it sends when it is ready, on MCode (MC 5-26).
pub(super) const SIGN_ON: &[u8] = b"Copyright 2001-2010 by Schneider Electric Motion USA.\r\n";

/// The program that runs when it is ready (MC 5-71).
const START_UP: Place = Place::Label(*b"SU");

/// From power-on to the first request that is answered; the manuals do not specify it (MDRIVE-7).
const BOOT: Duration = Duration::millis(300);

impl Drive {
    /// Power comes: no connection is open, and all inputs follow.
    pub(super) fn power_on(&mut self, at: Instant, boot: Boot, out: &mut dyn Context) {
        self.boot = boot;
        self.saving = None;
        self.mcode.consoles = Consoles::new();
        self.start(at, true, out);
    }

    /// As power-on, but the connections stay (the Ethernet controller is another processor), and levels are known.
    pub(super) fn restart(&mut self, at: Instant, out: &mut dyn Context) {
        // A save in progress is finished first: the order of the commands counts.
        self.finish_save(at, out);
        self.mcode.consoles.restart();
        self.start(at, false, out);
    }

    fn start(&mut self, at: Instant, whole: bool, out: &mut dyn Context) {
        self.clear_activity();
        self.hybrid.restart(whole);
        let good = self.load(out);
        self.io.power_on(at, whole, out);
        if whole {
            self.motion.unplug(at);
        }
        self.motion.power_on(at, motion_settings(&self.bank, Some(&self.io)), out);
        self.apply_variables(at, out);
        if !good {
            self.errors.set(Error::Flash);
        }
        self.state = State::Booting { due: if self.boot.fast { at } else { at + BOOT }, whole };
    }

    /// Ends all activity: errors, the program that runs, trips.
    pub(super) fn clear_activity(&mut self) {
        self.errors = Errors::NONE;
        self.end_program();
        self.mcode.vm = Vm::new();
        self.mcode.trips = Trips::NONE;
    }

    /// Returns whether input on its ports reaches it.
    pub(super) fn is_started(&self) -> bool {
        matches!(self.state, State::Calibrating | State::Ready)
    }

    /// Returns whether its ports accept connections: the Ethernet controller, of both of them, starts with the power,
    /// and works while the drive alone starts again.
    pub(super) fn accepts_connections(&self) -> bool {
        !matches!(self.state, State::Off | State::Booting { whole: true, .. })
    }

    pub(super) fn startup_due(&self) -> Instant {
        match self.state {
            State::Booting { due, .. } => due,
            State::Off | State::Calibrating | State::Ready => Instant::NEVER,
        }
    }

    /// Begins to receive: a Hybrid calibrates, unless it starts without delay.
    pub(super) fn ready(&mut self, at: Instant, out: &mut dyn Context) {
        self.state = State::Calibrating;
        if self.model == Model::Hybrid {
            if self.boot.fast {
                self.hybrid.set_calibrated();
            } else if let Err(error) = self.calibrate(at, false, out) {
                self.fail(at, error, out);
            }
        }
    }

    /// Signs on and runs SU, once it is calibrated (MC 5-9).
    pub(super) fn sign_on(&mut self, at: Instant, out: &mut dyn Context) {
        if self.state != State::Calibrating || self.hybrid.is_calibrating() {
            return;
        }
        self.state = State::Ready;
        self.greet(at, out);
        if self.mcode.names.find(*b"SU").is_some()
            && let Err(error) = self.start_program(at, START_UP, 0)
        {
            self.fail(at, error, out);
        }
    }
}
