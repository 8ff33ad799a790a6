//! The functions that START/STOP and FUNC_CMD start (p. 17, 18; MDROBOT-20).

use super::{Command, Release};
use crate::device::{Context, Duration, Instant};
use crate::mdrobot::drive::Drive;
use crate::mdrobot::reasons::Why;
use crate::mdrobot::registers::{Pid, function};

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
    fn is_position(self) -> bool {
        matches!(self, Self::Position { .. })
    }
}

impl Drive {
    /// The signal has changed to ON: starts the function that `FUNC_CMD_TYPE` selects. Returns the reason why
    /// the motor does not move.
    pub(super) fn start_function(&mut self, at: Instant, out: &mut dyn Context) -> Option<Why> {
        // A running speed function ignores the signal; a position function starts again from the motor's
        // position.
        if matches!(self.reference.command, Command::Function(running) if !running.is_position()) {
            return Some(Why::FunctionRuns);
        }
        let (rpm, units) = self.two_words(Pid::FUNC_SPEED);
        let rpm = i32::from(rpm);
        let until = at + RUN_TIME * u64::from(units.cast_unsigned());
        let begun = match self.bank.word(Pid::FUNC_CMD_TYPE) {
            function::SPEED if until > at => Function::Speed { rpm, until },
            function::POSITION => {
                let (rpm, counts) = self.two_words(Pid::FUNC_POSI);
                let (rpm, count) = (i32::from(rpm).abs(), self.relative(self.turned(counts.into())));
                self.reference.command = Command::Function(Function::Position { rpm });
                return self.apply(at, self.position(count, rpm), out);
            }
            function::SPEED_MOMENTARY => Function::Momentary { rpm },
            function::SPEED_ADD => Function::Add { rpm, until },
            _ => return Some(Why::NoRunTime),
        };
        self.reference.command = Command::Function(begun);
        None
    }

    /// The signal has changed to OFF.
    pub(super) fn release_function(&mut self) {
        if let Command::Function(Function::Momentary { .. } | Function::Add { until: Instant::NEVER, .. }) =
            self.reference.command
        {
            self.reference.command = Command::Nothing(Release::Stop);
        }
    }

    /// End of the running function.
    pub(super) fn function_due(&self) -> Instant {
        match self.reference.command {
            Command::Function(Function::Speed { until, .. } | Function::Add { until, .. }) => until,
            _ => Instant::NEVER,
        }
    }

    /// Handles the deadline of [`Drive::function_due`]. Returns true if the order to the motor changes.
    pub(super) fn function_timeout(&mut self, at: Instant) -> bool {
        if self.function_due() > at {
            return false;
        }
        let held = self.reference.start;
        match &mut self.reference.command {
            Command::Function(Function::Add { until, .. }) if held => *until = Instant::NEVER,
            command => *command = Command::Nothing(Release::Stop),
        }
        true
    }

    /// The two words of a PID as signed numbers.
    fn two_words(&self, pid: Pid) -> (i16, i16) {
        let words = self.bank.get(pid);
        (words as i16, (words >> 16) as i16)
    }
}
