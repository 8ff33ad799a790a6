//! Start of the drive at power-on, and restart by Ctrl-C or a reset input.

use super::drive::{Drive, Model};
use super::error::Error;
use super::mcode::console::{Consoles, note_lost_input, prompt};
use super::mcode::statement::Place;
use super::motion;
use super::saved::Saving;
use crate::device::{Boot, Context, Duration, Instant};

/// Sign-on text, which is sent on MCode connections when the drive is ready (MC 5-26).
pub(super) const SIGN_ON: &[u8] = b"Copyright 2001-2010 by Schneider Electric Motion USA.\r\n";

/// Label of the program that the drive runs when it is ready (MC 5-71).
const START_UP: Place = Place::Label(*b"SU");

/// Time from power-on to the first request that is answered; the manuals do not specify it (MDRIVE-7).
const BOOT: Duration = Duration::millis(300);

/// State of the drive, from power-on to ready.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum State {
    /// No power.
    Off,
    /// Starting: the drive does not receive messages yet.
    Booting {
        /// Time at which the start ends.
        due: Instant,
        /// True after power-on, when the Ethernet controller starts, too. False after a restart of the drive
        /// alone.
        whole: bool,
    },
    /// Receiving messages. A Hybrid calibrates before it signs on.
    Calibrating,
    /// The sign-on has been sent.
    Ready,
}

/// The start of the drive.
#[derive(Clone, Debug)]
pub(super) struct Startup {
    /// True if the drive starts without delay.
    fast: bool,
    state: State,
}

impl Startup {
    /// No power.
    pub(super) const OFF: Self = Self { fast: false, state: State::Off };

    /// Begins the start: of all processors at power-on (`whole`), or of the drive alone.
    fn begin(&mut self, at: Instant, whole: bool) {
        self.state = State::Booting { due: if self.fast { at } else { at + BOOT }, whole };
    }

    /// Returns true if the drive has no power.
    pub(super) fn is_off(&self) -> bool {
        self.state == State::Off
    }

    /// Returns true until the sign-on, from the first message that the drive receives.
    pub(super) fn is_calibrating(&self) -> bool {
        self.state == State::Calibrating
    }

    /// Returns true if the drive receives input on its ports.
    pub(super) fn is_started(&self) -> bool {
        matches!(self.state, State::Calibrating | State::Ready)
    }

    /// Time from which the drive receives input on its ports.
    pub(super) fn receives_from(&self) -> Instant {
        match self.state {
            State::Off => Instant::NEVER,
            State::Booting { due, .. } => due,
            State::Calibrating | State::Ready => Instant::ZERO,
        }
    }

    /// Returns true if the ports accept connections. The Ethernet controller serves both ports: it starts at
    /// power-on, and continues to work while the drive alone restarts.
    pub(super) fn accepts_connections(&self) -> bool {
        !matches!(self.state, State::Off | State::Booting { whole: true, .. })
    }

    /// End of the start.
    pub(super) fn deadline(&self) -> Instant {
        match self.state {
            State::Booting { due, .. } => due,
            State::Off | State::Calibrating | State::Ready => Instant::NEVER,
        }
    }

    /// Handles the deadline. Returns true if the drive receives messages from now on.
    pub(super) fn timeout(&mut self, at: Instant) -> bool {
        let is_due = self.deadline() <= at;
        if is_due {
            self.state = State::Calibrating;
        }
        is_due
    }
}

impl Drive {
    /// Starts the drive at power-on. No connection is open, and the levels of all inputs follow as events.
    pub(super) fn power_on(&mut self, at: Instant, boot: Boot, out: &mut dyn Context) {
        self.startup.fast = boot.fast;
        self.saving = Saving::NONE;
        self.mcode.consoles = Consoles::new();
        self.start(at, true, out);
    }

    /// Restarts the drive. Unlike at power-on, connections stay open (the Ethernet controller is another
    /// processor), and the levels of the inputs are known already.
    pub(super) fn restart(&mut self, at: Instant, out: &mut dyn Context) {
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
        self.motion.power_on(at, motion::Settings::of(&self.bank, Some(&self.io)), out);
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
            if self.startup.fast {
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
        self.startup.state = State::Ready;
        self.mcode.consoles.greet(at, prompt(&self.bank, self.mcode.errors), out);
        if self.mcode.names.find(*b"SU").is_some()
            && let Err(error) = self.mcode.start(at, START_UP, 0, &mut self.motion)
        {
            self.mcode.fail(at, error, &mut self.motion);
        }
    }
}
