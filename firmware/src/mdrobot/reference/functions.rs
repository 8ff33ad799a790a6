//! The functions that START/STOP and FUNC_CMD start (p. 17, 18; MDROBOT-20).

use super::Environment;
use crate::device::{Duration, Instant};
use crate::mdrobot::registers::{Pid, Words, function};
use crate::mdrobot::servo::Order;

/// Unit of the run time in FUNC_SPEED.
const RUN_TIME: Duration = Duration::millis(100);

/// A running function.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Function {
    /// SPEED: turns until its time has passed, independently of the signal.
    Speed {
        /// Speed in rpm, positive CCW.
        rpm: i32,
        /// End of the run time.
        until: Instant,
    },
    /// POSITION: moves by a number of counts, and holds the position.
    Position {
        /// Greatest speed in rpm, not negative.
        rpm: i32,
    },
    /// SPEED_MOMENTARY: turns while the signal is ON.
    Momentary {
        /// Speed in rpm, positive CCW.
        rpm: i32,
    },
    /// `SPEED_ADD`: turns until its time has passed and the signal is OFF.
    Add {
        /// Speed in rpm, positive CCW.
        rpm: i32,
        /// End of the run time; [`Instant::NEVER`] once it has passed.
        until: Instant,
    },
}

impl Function {
    /// The function that `FUNC_CMD_TYPE` selects, from now on, with the order of a position function; `None` if it would
    /// end at once.
    pub(super) fn selected(env: &Environment<'_>) -> Option<(Self, Option<Order>)> {
        let (rpm, units) = two_words(env.bank, Pid::FUNC_SPEED);
        let rpm = i32::from(rpm);
        let until = env.at + RUN_TIME * u64::from(units.cast_unsigned());
        let function = match env.bank.word(Pid::FUNC_CMD_TYPE) {
            function::SPEED if until > env.at => Self::Speed { rpm, until },
            function::POSITION => {
                let (rpm, counts) = two_words(env.bank, Pid::FUNC_POSI);
                let (rpm, count) = (i32::from(rpm).abs(), env.relative(env.turned(counts.into())));
                return Some((Self::Position { rpm }, Some(env.position(count, rpm))));
            }
            function::SPEED_MOMENTARY => Self::Momentary { rpm },
            function::SPEED_ADD => Self::Add { rpm, until },
            _ => return None,
        };
        Some((function, None))
    }

    pub(super) fn is_position(self) -> bool {
        matches!(self, Self::Position { .. })
    }

    /// Returns true if the function ends when its signal changes to OFF.
    pub(super) fn needs_signal(self) -> bool {
        matches!(self, Self::Momentary { .. } | Self::Add { until: Instant::NEVER, .. })
    }

    /// End of the run time.
    pub(super) fn end(self) -> Instant {
        match self {
            Self::Speed { until, .. } | Self::Add { until, .. } => until,
            Self::Position { .. } | Self::Momentary { .. } => Instant::NEVER,
        }
    }
}

/// The two words of a PID as signed numbers.
fn two_words(bank: &Words, pid: Pid) -> (i16, i16) {
    let words = bank.get(pid);
    (words as i16, (words >> 16) as i16)
}
