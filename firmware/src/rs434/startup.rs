//! How the drive starts, resets itself to the factory, and what its two lights show (4, 7).

use super::drive::{Drive, State};
use super::program::Status;
use super::registers::Reg;
use super::{GREEN, RED};
use crate::device::{Duration, Instant, Level, Output, Pin, Sink};

/// From power-on to the first character that is heard.
const BOOT: Duration = Duration::millis(500);
/// How long CLR_FLASH must be closed (7).
const RESET: Duration = Duration::secs(5);
/// How long each light has its turn meanwhile.
const TURN: Duration = Duration::millis(250);

/// CLR_FLASH is closed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Clearing {
    /// When the other light has its turn.
    pub(super) next: Instant,
    /// When the settings are those of the factory.
    over: Instant,
    red: bool,
}

/// Which lights are on.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Lights {
    red: bool,
    green: bool,
}

impl Lights {
    pub(super) const DARK: Self = Self { red: false, green: false };
}

impl Drive {
    /// What its pins are was told in the instant in which it got power: now it begins to start.
    pub(super) fn wake(&mut self, at: Instant, out: &mut dyn Sink) {
        if self.state != (State::Waking { due: at }) {
            return;
        }
        if self.inputs.clr_flash {
            self.state = State::Clearing(Clearing { next: at + TURN, over: at + RESET, red: true });
        } else {
            self.boot(at, out);
        }
    }

    fn boot(&mut self, at: Instant, out: &mut dyn Sink) {
        if self.fast {
            self.ready(at, out);
        } else {
            self.state = State::Booting { due: at + BOOT };
        }
    }

    /// CLR_FLASH was opened too early.
    pub(super) fn clr_flash_changed(&mut self, at: Instant, out: &mut dyn Sink) {
        if matches!(self.state, State::Clearing(_)) && !self.inputs.clr_flash {
            self.boot(at, out);
        }
    }

    /// When its start goes on.
    pub(super) fn startup_due(&self) -> Instant {
        match self.state {
            State::Off | State::Ready => Instant::NEVER,
            State::Waking { due } | State::Booting { due } => due,
            State::Clearing(clearing) => clearing.next,
        }
    }

    /// Its start goes on.
    pub(super) fn startup_timeout(&mut self, at: Instant, out: &mut dyn Sink) {
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

    /// It is ready: what is wrong shows, contacts and levels act, and a program may begin.
    fn ready(&mut self, at: Instant, out: &mut dyn Sink) {
        self.state = State::Ready;
        self.look_for_errors(at, out);
        self.take_inputs(at, out);
        if self.bank.word(Reg::MODE_USER_PROGRAM) == 3 {
            self.start_program(at, Status::StartedByPower, out);
        }
    }

    /// Shows what it is: green when it is ready, red when an error keeps the motor from moving.
    pub(super) fn show_lights(&mut self, at: Instant, out: &mut dyn Sink) {
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
