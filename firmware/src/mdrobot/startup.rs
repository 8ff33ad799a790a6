//! Start-up of the drive.

use crate::device::{Boot, Duration, Instant};

/// Time from power-on to the first character that the drive receives; the manual does not specify it
/// (MDROBOT-11).
const BOOT: Duration = Duration::millis(300);

/// State of the drive, from power-on to ready.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum State {
    /// No power.
    Off,
    /// During start-up the drive receives no message.
    Booting {
        /// End of the start-up.
        due: Instant,
    },
    /// Normal operation, or an alarm.
    Ready,
}

/// The start-up of the drive.
#[derive(Clone, Copy, Debug)]
pub(super) struct Startup {
    state: State,
}

impl Startup {
    /// No power.
    pub(super) const OFF: Self = Self { state: State::Off };

    /// Begins the start-up. Even without a delay, the inputs of this instant are handled before the drive is
    /// ready.
    pub(super) fn power_on(&mut self, at: Instant, boot: Boot) {
        self.state = State::Booting { due: if boot.fast { at } else { at + BOOT } };
    }

    pub(super) fn power_off(&mut self) {
        self.state = State::Off;
    }

    pub(super) fn is_off(self) -> bool {
        self.state == State::Off
    }

    pub(super) fn is_ready(self) -> bool {
        self.state == State::Ready
    }

    pub(super) fn deadline(self) -> Instant {
        match self.state {
            State::Booting { due } => due,
            State::Off | State::Ready => Instant::NEVER,
        }
    }

    /// Ends the start-up if that is due. Returns true if the drive is ready now.
    pub(super) fn timeout(&mut self, at: Instant) -> bool {
        let ends = self.deadline() <= at;
        if ends {
            self.state = State::Ready;
        }
        ends
    }
}
