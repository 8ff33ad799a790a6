//! The start-up and the MD3's two lights (sections 2, 4 and 7.20; MD3-13).

use super::{GREEN, RED};
use crate::device::{Boot, Context, Duration, Instant, Level, Output};

/// Built-in delay before the drive supplies the motor and listens (7.4).
const STARTUP: Duration = Duration::millis(2_500);
/// A unit of the register StartupDelay (7.4).
const STARTUP_UNIT: Duration = Duration::millis(10);
/// Duration of two flashes of both lights, if the EEPROM passed. They are part of the built-in delay.
const GOOD_FLASHES: Duration = Duration::secs(1);
/// Duration of ten flashes of the red light, if the EEPROM failed. The built-in delay follows them.
const BAD_FLASHES: Duration = Duration::secs(5);
/// Period of a flash during start-up, dark time included.
const FLASH: Duration = Duration::millis(500);
/// Bright time of a flash or heartbeat.
const BRIGHT: Duration = Duration::millis(250);
/// Time for which each light is on while the two alternate.
const TURN: Duration = Duration::millis(500);
/// Period of the heartbeat, and of the flashes in a fault (about 1.5 s by section 2).
const HEARTBEAT: Duration = Duration::millis(1_500);

/// The way from power-on to ready.
#[derive(Clone, Copy, Debug)]
pub(super) struct Startup {
    phase: Phase,
    /// End of the phase.
    due: Instant,
    /// Time at which the drive is ready.
    ready: Instant,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Phase {
    /// No power.
    Off,
    /// Flashes that show if the EEPROM was good. During start-up the motor has no current, and the drive does
    /// not listen.
    Flashes,
    /// Green is on for the first time, before the lights alternate.
    Green,
    /// Green and red alternate.
    Alternate,
    /// Boot without start-up delay: the drive becomes ready after all inputs of this instant.
    Waking,
    /// Normal operation, or a fault.
    Ready,
}

impl Startup {
    /// No power.
    pub(super) const OFF: Self = Self { phase: Phase::Off, due: Instant::NEVER, ready: Instant::NEVER };
    const READY: Self = Self { phase: Phase::Ready, ..Self::OFF };

    /// Begins at power-on. `passed` is the result of the EEPROM, `delay` the register `StartupDelay`.
    pub(super) fn begin(at: Instant, boot: Boot, passed: bool, delay: u64, out: &mut dyn Context) -> Self {
        if boot.fast {
            return Self { phase: Phase::Waking, due: at, ready: at };
        }
        let flashes = |pin| Output::Wave { pin, period: FLASH, high: BRIGHT };
        out.put(at, flashes(RED));
        let (flashing, delayed) = if passed {
            out.put(at, flashes(GREEN));
            (GOOD_FLASHES, Duration::ZERO)
        } else {
            out.put(at, Output::Level { pin: GREEN, level: Level::Low });
            (BAD_FLASHES, BAD_FLASHES)
        };
        let ready = at + delayed + STARTUP + STARTUP_UNIT * delay;
        Self { phase: Phase::Flashes, due: at + flashing, ready }
    }

    /// Returns true without power.
    pub(super) fn is_off(&self) -> bool {
        self.phase == Phase::Off
    }

    /// Returns true after the start-up.
    pub(super) fn is_ready(&self) -> bool {
        self.phase == Phase::Ready
    }

    /// End of the start-up, asked at power-on.
    pub(super) fn ready_at(&self) -> Instant {
        self.ready
    }

    /// End of the present phase.
    pub(super) fn deadline(&self) -> Instant {
        self.due
    }

    /// Begins the next phase, if it is due. Returns true if the drive becomes ready.
    pub(super) fn timeout(&mut self, at: Instant, out: &mut dyn Context) -> bool {
        if at < self.due {
            return false;
        }
        if at >= self.ready {
            *self = Self::READY;
            return true;
        }
        let turns = |pin| Output::Wave { pin, period: TURN * 2, high: TURN };
        if self.phase == Phase::Flashes {
            out.put(at, turns(GREEN));
            out.put(at, Output::Level { pin: RED, level: Level::Low });
            (self.phase, self.due) = (Phase::Green, (at + TURN).min(self.ready));
        } else {
            out.put(at, turns(RED));
            (self.phase, self.due) = (Phase::Alternate, self.ready);
        }
        false
    }
}

/// States of the lights (section 2).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Lights {
    /// The lights show the start-up, see [`Startup`].
    Starting,
    /// Green shows the heartbeat.
    Normal,
    /// Green shows the heartbeat, red is on.
    Cutback,
    /// Red flashes.
    Fault,
}

impl Lights {
    /// Changes to `next`. A heartbeat that both states show continues without a break.
    pub(super) fn change(&mut self, next: Self, at: Instant, out: &mut dyn Context) {
        let beats = |lights| matches!(lights, Self::Normal | Self::Cutback);
        let wave = |pin| Output::Wave { pin, period: HEARTBEAT, high: BRIGHT };
        let level = |pin, level| Output::Level { pin, level };
        if *self == next {
            return;
        }
        if beats(next) && !beats(*self) {
            out.put(at, wave(GREEN));
        }
        match next {
            Self::Starting => {}
            Self::Normal => out.put(at, level(RED, Level::Low)),
            Self::Cutback => out.put(at, level(RED, Level::High)),
            Self::Fault => {
                out.put(at, wave(RED));
                out.put(at, level(GREEN, Level::Low));
            }
        }
        *self = next;
    }
}
