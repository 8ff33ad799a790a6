//! The way from power-on, or a restart, to the sign-on.

use crate::device::{Boot, Duration, Instant};

/// Sign-on text, which is sent on MCode connections when the drive is ready (MC 5-26).
pub(super) const SIGN_ON: &[u8] = b"Copyright 2001-2010 by Schneider Electric Motion USA.\r\n";

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

    /// Power-on. The [start](Self::begin) follows.
    pub(super) fn power_on(&mut self, boot: Boot) {
        self.fast = boot.fast;
    }

    /// Begins the start: of all processors at power-on (`whole`), or of the drive alone.
    pub(super) fn begin(&mut self, at: Instant, whole: bool) {
        self.state = State::Booting { due: if self.fast { at } else { at + BOOT }, whole };
    }

    /// Returns true if the drive starts without delay.
    pub(super) fn is_fast(&self) -> bool {
        self.fast
    }

    /// Ends the calibration: the sign-on is sent.
    pub(super) fn sign_on(&mut self) {
        self.state = State::Ready;
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
