//! Start of the drive, reset to the factory values, and the two lights (sections 4 and 7).

use super::drive::{Drive, State};
use super::program::Status;
use super::registers::Reg;
use super::{GREEN, RED};
use crate::device::{Context, Duration, Instant, Level, Output, Pin};

/// Time from power-on to the first received character (RS434-9).
const BOOT: Duration = Duration::millis(500);
/// Time for which CLR_FLASH must be closed for a reset (section 7; RS434-10).
const RESET: Duration = Duration::secs(5);
/// While CLR_FLASH is closed, the lights are on in turn, each for this time.
const TURN: Duration = Duration::millis(250);

/// State while CLR_FLASH is closed at the start.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Clearing {
    /// Time at which the lights change.
    pub(super) next: Instant,
    /// Time of the reset to the factory values.
    over: Instant,
    red: bool,
}

/// State of the two lights; true is on.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Lights {
    red: bool,
    green: bool,
}

impl Lights {
    pub(super) const DARK: Self = Self { red: false, green: false };
}

impl Drive {
    /// Starts the drive, after the inputs of the instant of power-on were received.
    pub(super) fn wake(&mut self, at: Instant, out: &mut dyn Context) {
        if self.state != (State::Waking { due: at }) {
            return;
        }
        if self.inputs.clr_flash {
            self.state = State::Clearing(Clearing { next: at + TURN, over: at + RESET, red: true });
        } else {
            self.boot(at, out);
        }
    }

    fn boot(&mut self, at: Instant, out: &mut dyn Context) {
        if self.fast {
            self.ready(at, out);
        } else {
            self.state = State::Booting { due: at + BOOT };
        }
    }

    /// Handles a change of CLR_FLASH: if it opens too early, there is no reset.
    pub(super) fn clr_flash_changed(&mut self, at: Instant, out: &mut dyn Context) {
        if matches!(self.state, State::Clearing(_)) && !self.inputs.clr_flash {
            self.boot(at, out);
        }
    }

    /// Time of the next step of the start.
    pub(super) fn startup_due(&self) -> Instant {
        match self.state {
            State::Off | State::Ready => Instant::NEVER,
            State::Waking { due } | State::Booting { due } => due,
            State::Clearing(clearing) => clearing.next,
        }
    }

    /// Executes the next step of the start.
    pub(super) fn startup_timeout(&mut self, at: Instant, out: &mut dyn Context) {
        match self.state {
            State::Off | State::Ready => {}
            State::Waking { .. } => self.wake(at, out),
            State::Booting { .. } => self.ready(at, out),
            State::Clearing(clearing) if at < clearing.over => {
                let next = (at + TURN).min(clearing.over);
                self.state = State::Clearing(Clearing { next, red: !clearing.red, ..clearing });
            }
            State::Clearing(_) => {
                self.reset_settings(at, out);
                self.boot(at, out);
            }
        }
    }

    /// Ends the start: reports errors, executes the inputs, and starts the program if it is selected.
    fn ready(&mut self, at: Instant, out: &mut dyn Context) {
        self.state = State::Ready;
        self.check_errors(at, out);
        self.apply_inputs(at, out);
        if self.bank.word(Reg::MODE_USER_PROGRAM) == 3 {
            let _ = self.start_program(at, Status::StartedByPower, out);
        }
    }

    /// Updates the lights: green when the drive is ready, red when an error stops the motor.
    pub(super) fn update_lights(&mut self, at: Instant, out: &mut dyn Context) {
        let lights = match self.state {
            State::Off | State::Waking { .. } | State::Booting { .. } => Lights::DARK,
            State::Clearing(Clearing { red, .. }) => Lights { red, green: !red },
            State::Ready => Lights { red: self.errors.stop(), green: true },
        };
        let mut change = |pin: Pin, was: bool, is: bool| {
            if was != is {
                let level = if is { Level::High } else { Level::Low };
                out.put(at, Output::Level { pin, level });
            }
        };
        change(RED, self.lights.red, lights.red);
        change(GREEN, self.lights.green, lights.green);
        self.lights = lights;
    }
}
