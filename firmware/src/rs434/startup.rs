//! Start of the drive, reset to the factory values, and the two lights (sections 4 and 7).

use super::{GREEN, RED};
use crate::device::{Context, Duration, Instant, Level, Output, Pin};

/// Time from power-on to the first received character (RS434-9).
const BOOT: Duration = Duration::millis(500);
/// Time for which CLR_FLASH must be closed for a reset (section 7; RS434-10).
const RESET: Duration = Duration::secs(5);
/// While CLR_FLASH is closed, the lights are on in turn, each for this time.
const TURN: Duration = Duration::millis(250);

/// State of the drive, from power-on to ready.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum State {
    /// No power.
    Off,
    /// Power is on, but other inputs of the same instant may still follow.
    Waking {
        /// The instant of power-on.
        due: Instant,
    },
    /// CLR_FLASH is closed since the start.
    Clearing {
        /// Time at which the lights change.
        next: Instant,
        /// Time of the reset to the factory values.
        over: Instant,
        red: bool,
    },
    /// Starting. No message is received yet.
    Booting {
        /// End of the start.
        due: Instant,
    },
    /// Normal operation, with or without an error.
    Ready,
}

/// A step of the start that concerns the whole drive.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Step {
    /// The settings become the factory values.
    Reset,
    /// The drive is ready.
    Ready,
}

/// The start of the drive, and its lights.
#[derive(Clone, Copy, Debug)]
pub(super) struct Startup {
    state: State,
    /// True if there is no start-up delay.
    fast: bool,
    /// True while the contact CLR_FLASH is closed.
    clr_flash: bool,
    /// True while the red light is on.
    red: bool,
    /// True while the green light is on.
    green: bool,
}

impl Startup {
    /// No power.
    pub(super) const OFF: Self =
        Self { state: State::Off, fast: false, clr_flash: false, red: false, green: false };

    /// Begins the start at power-on. The state of CLR_FLASH follows.
    pub(super) fn power_on(&mut self, at: Instant, fast: bool) {
        *self = Self { fast, ..Self::OFF };
        self.restart(at);
    }

    /// Begins the start again.
    pub(super) fn restart(&mut self, at: Instant) {
        self.state = State::Waking { due: at };
    }

    pub(super) fn power_off(&mut self) {
        *self = Self::OFF;
    }

    pub(super) fn is_off(&self) -> bool {
        self.state == State::Off
    }

    pub(super) fn is_ready(&self) -> bool {
        self.state == State::Ready
    }

    /// End of the start; `None` while it is unknown.
    pub(super) fn ready_at(&self) -> Option<Instant> {
        match self.state {
            State::Off | State::Waking { .. } | State::Clearing { .. } => None,
            State::Booting { due } => Some(due),
            State::Ready => Some(Instant::ZERO),
        }
    }

    /// Handles a change of CLR_FLASH. Returns true if it opens too early for a reset, so that the start continues.
    pub(super) fn clr_flash(&mut self, at: Instant, closed: bool) -> bool {
        self.clr_flash = closed;
        let continues = matches!(self.state, State::Clearing { .. }) && !closed;
        if continues {
            self.boot(at);
        }
        continues
    }

    fn boot(&mut self, at: Instant) {
        self.state = State::Booting { due: if self.fast { at } else { at + BOOT } };
    }

    /// Time of the next step.
    pub(super) fn deadline(&self) -> Instant {
        match self.state {
            State::Off | State::Ready => Instant::NEVER,
            State::Waking { due } | State::Booting { due } => due,
            State::Clearing { next, .. } => next,
        }
    }

    /// Continues the start up to `at`. Returns the next step that the drive must execute; more may follow.
    pub(super) fn timeout(&mut self, at: Instant) -> Option<Step> {
        while self.deadline() <= at {
            match self.state {
                State::Off | State::Ready => return None,
                State::Waking { .. } if self.clr_flash => {
                    self.state = State::Clearing { next: at + TURN, over: at + RESET, red: true };
                }
                State::Waking { .. } => self.boot(at),
                State::Clearing { over, red, .. } if at < over => {
                    self.state = State::Clearing { next: (at + TURN).min(over), over, red: !red };
                }
                State::Clearing { .. } => {
                    self.boot(at);
                    return Some(Step::Reset);
                }
                State::Booting { .. } => {
                    self.state = State::Ready;
                    return Some(Step::Ready);
                }
            }
        }
        None
    }

    /// Updates the lights: green when the drive is ready, red when an error stops the motor.
    pub(super) fn show(&mut self, at: Instant, has_error: bool, out: &mut dyn Context) {
        let (red, green) = match self.state {
            State::Off | State::Waking { .. } | State::Booting { .. } => (false, false),
            State::Clearing { red, .. } => (red, !red),
            State::Ready => (has_error, true),
        };
        let mut change = |pin: Pin, light: &mut bool, is: bool| {
            if *light != is {
                *light = is;
                out.put(at, Output::Level { pin, level: if is { Level::High } else { Level::Low } });
            }
        };
        change(RED, &mut self.red, red);
        change(GREEN, &mut self.green, green);
    }
}
