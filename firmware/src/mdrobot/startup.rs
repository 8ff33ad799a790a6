//! Start-up of the drive.

use super::drive::{Drive, State};
use crate::device::{Boot, Context, Duration, Instant};

/// Time from power-on to the first character that the drive receives; the manual does not specify it
/// (MDROBOT-11).
const BOOT: Duration = Duration::millis(300);

impl Drive {
    /// Starts the start-up. Even without a delay, the inputs of this instant are handled before the drive is
    /// ready.
    pub(super) fn boot(&mut self, at: Instant, boot: Boot) {
        self.state = State::Booting { due: if boot.fast { at } else { at + BOOT } };
    }

    /// Time from which the drive receives, after the power-on at `at`: with a delay the tick after its end.
    pub(super) fn receives_from(&self, at: Instant) -> Instant {
        match self.state {
            State::Off => Instant::NEVER,
            State::Booting { due } if due > at => due + Duration::TICK,
            State::Booting { .. } | State::Ready => Instant::ZERO,
        }
    }

    pub(super) fn startup_due(&self) -> Instant {
        match self.state {
            State::Booting { due } => due,
            State::Off | State::Ready => Instant::NEVER,
        }
    }

    /// Ends the start-up: faults raise alarms, and the connectors take effect.
    pub(super) fn ready(&mut self, at: Instant, out: &mut dyn Context) {
        self.state = State::Ready;
        self.check_alarms(at, out);
        self.update_alarm_pin(at, out);
        self.sources_ready(at, out);
    }
}
