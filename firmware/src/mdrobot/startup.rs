//! Start of the drive.

use super::drive::{Drive, State};
use crate::device::{Boot, Context, Duration, Instant};

/// From power-on to the first character that is received; the manual does not specify it (MDROBOT-11).
const BOOT: Duration = Duration::millis(300);

impl Drive {
    /// Powers the drive; its inputs come in the same instant, also if it starts at once.
    pub(super) fn boot(&mut self, at: Instant, boot: Boot) {
        self.state = State::Booting { due: if boot.fast { at } else { at + BOOT } };
    }

    /// End of the time in which nothing is received; `None` once the drive receives.
    pub(super) fn deaf_until(&self) -> Option<Instant> {
        match self.state {
            State::Off => Some(Instant::NEVER),
            State::Booting { due } => Some(due),
            State::Ready => None,
        }
    }

    pub(super) fn startup_due(&self) -> Instant {
        match self.state {
            State::Booting { due } => due,
            State::Off | State::Ready => Instant::NEVER,
        }
    }

    /// Ends the start: faults show, and the connectors act.
    pub(super) fn ready(&mut self, at: Instant, out: &mut dyn Context) {
        self.state = State::Ready;
        self.check_alarms(at, out);
        self.update_alarm_pin(at, out);
        self.sources_ready(at, out);
    }
}
