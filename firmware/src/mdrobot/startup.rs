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

    /// End of the time in which the drive receives nothing; `None` if the drive receives.
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

    /// Ends the start-up: faults raise alarms, and the connectors take effect.
    pub(super) fn ready(&mut self, at: Instant, out: &mut dyn Context) {
        self.state = State::Ready;
        self.check_alarms(at, out);
        self.update_alarm_pin(at, out);
        self.sources_ready(at, out);
    }
}
