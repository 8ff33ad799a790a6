//! Calibration of a Hybrid, which aligns rotor and stator (MC 5-8, 5-9).

use fixed::types::U24F8;

use super::heat::SHUTDOWN;
use super::rotor::{Rotor, evenly};
use super::status::condition;
use super::{Hybrid, mode};
use crate::device::{Context, Duration, Instant};
use crate::mdrive::drive::{Drive, State};
use crate::mdrive::error::Error;
use crate::mdrive::reasons::{Why, report};
use crate::mdrive::registers::Reg;
use crate::mdrive::{CALIBRATION, LOCKED_ROTOR};

/// Moves of a calibration, in full steps, and their durations. With three waits of CT = 250 ms they make 3.12
/// s (MC 5-9; MDRIVE-26).
const FORTH: i32 = 6;
const FORTH_TAKES: Duration = Duration::millis(1_580);
const BACK: i32 = 3;
const BACK_TAKES: Duration = Duration::millis(790);
/// Duration of a calibration if the rotor cannot move (MC 5-9).
const BLOCKED: Duration = Duration::secs(10);

/// State of calibration.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Calibration {
    Not,
    Runs(Run),
    Done,
    /// The rotor could not move.
    Failed,
}

/// A calibration in progress.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Run {
    stage: Stage,
    due: Instant,
    since: Instant,
}

/// Stage of a calibration.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Stage {
    Settles,
    Forth,
    Waits,
    Back,
    Rests,
    /// The rotor is blocked, and the calibration continues to try.
    Tries,
}

impl Calibration {
    /// Returns true if the calibration has ended, with either result.
    pub(super) fn is_over(self) -> bool {
        matches!(self, Self::Done | Self::Failed)
    }

    pub(super) fn due(self) -> Instant {
        match self {
            Self::Runs(run) => run.due,
            Self::Not | Self::Done | Self::Failed => Instant::NEVER,
        }
    }
}

impl Hybrid {
    /// Marks the Hybrid as calibrated, for a start without delay.
    pub(in crate::mdrive) fn set_calibrated(&mut self) {
        self.calibration = Calibration::Done;
    }

    pub(in crate::mdrive) fn is_calibrating(&self) -> bool {
        matches!(self.calibration, Calibration::Runs(_))
    }
}

impl Drive {
    /// Executes SC, or CF if `clears` is true: starts a calibration.
    ///
    /// # Errors
    /// As [`Self::calibrate`].
    pub(in crate::mdrive) fn calibrate_by_command(
        &mut self,
        at: Instant,
        clears: bool,
        out: &mut dyn Context,
    ) -> Result<(), Error> {
        let is_cleared = clears && self.hybrid.is_locked;
        let calibrates = self.calibrate(at, clears, out)?;
        report(if calibrates || is_cleared { Ok(()) } else { Err(Why::NothingToCalibrate) }, at, out);
        Ok(())
    }

    /// Starts a calibration, because of SC, CF (`clears`), AS, DE, MS, EE or power-on. If AS is 0 or the
    /// bridge is off, calibrates nothing and returns false.
    ///
    /// # Errors
    /// In motion 94 for CF, 89 for the others.
    pub(in crate::mdrive) fn calibrate(
        &mut self,
        at: Instant,
        clears: bool,
        out: &mut dyn Context,
    ) -> Result<bool, Error> {
        if self.is_in_motion() {
            return Err(if clears { Error::ClearLockedInMotion } else { Error::CalibrationInMotion });
        }
        self.motion.circuit_end(at, out);
        self.hybrid.rotor = Rotor::Free;
        (self.hybrid.is_locked, self.hybrid.at_bounds) = (false, None);
        // Overheated electronics that have cooled down are enabled again; if still hot, they stay off.
        self.hybrid.is_overheated &= self.hybrid.heat.celsius(at) >= SHUTDOWN;
        self.hybrid.is_disabled = self.hybrid.is_overheated;
        let works = self.bank.word(Reg::AS) != mode::OFF && self.has_bridge();
        let due = at + self.calibration_time();
        self.hybrid.calibration = Calibration::Not;
        self.set_motion(at, out);
        if works {
            self.hybrid.calibration = Calibration::Runs(Run { stage: Stage::Settles, due, since: at });
            // The calibration takes control of the motor, so that nothing else moves it meanwhile.
            self.turn_full_steps(at, 0, out);
        }
        self.watch_rotor(at, out);
        Ok(works)
    }

    /// Begins the next stage of a calibration (MC 5-9).
    pub(super) fn calibrate_on(&mut self, at: Instant, out: &mut dyn Context) {
        let Calibration::Runs(Run { stage, due, since }) = self.hybrid.calibration else { return };
        let (stage, lasts) = match stage {
            Stage::Settles => (Stage::Forth, FORTH_TAKES),
            Stage::Forth => (Stage::Waits, self.calibration_time()),
            Stage::Waits => (Stage::Back, BACK_TAKES),
            Stage::Back => (Stage::Rests, self.calibration_time()),
            Stage::Rests if self.is_rotor_blocked() => (Stage::Tries, (since + BLOCKED).since(due)),
            Stage::Rests => return self.end_calibration(at, Calibration::Done, out),
            Stage::Tries => return self.end_calibration(at, Calibration::Failed, out),
        };
        self.hybrid.calibration = Calibration::Runs(Run { stage, due: due + lasts, since });
        match stage {
            Stage::Forth => self.turn_full_steps(at, FORTH, out),
            Stage::Back => self.turn_full_steps(at, -BACK, out),
            _ => {}
        }
    }

    fn end_calibration(&mut self, at: Instant, outcome: Calibration, out: &mut dyn Context) {
        self.motion.circuit_end(at, out);
        self.motion.clear_lag(at);
        self.hybrid.calibration = outcome;
        if outcome == Calibration::Failed {
            // MC 5-9 calls this "a locked rotor response".
            (self.hybrid.is_locked, self.hybrid.is_disabled) = (true, true);
            self.set_motion(at, out);
            let starts = self.state == State::Calibrating;
            let error = if starts { Error::StartupCalibration } else { Error::CalibrationFailed };
            self.fail(at, error, out);
        }
        self.trip_on_status(at, condition::CALIBRATED, out);
    }

    /// CT, the duration of a wait.
    fn calibration_time(&self) -> Duration {
        Duration::millis(self.bank.word(Reg::CT).into())
    }

    fn is_rotor_blocked(&self) -> bool {
        let causes = self.hybrid.causes;
        causes.has(CALIBRATION) || causes.has(LOCKED_ROTOR) || !self.motion.follows()
    }

    /// Turns the rotor by full steps for the calibration.
    fn turn_full_steps(&mut self, at: Instant, full_steps: i32, out: &mut dyn Context) {
        let microsteps = self.bank.word(Reg::MS);
        let per_second = (u64::from(microsteps) << 8) * Duration::secs(1).ticks();
        // The speed is at least that of six steps in their time, so that the rotor is at rest when that time
        // ends.
        let bits = (per_second * u64::from(FORTH.unsigned_abs())).div_ceil(FORTH_TAKES.ticks());
        let speed = U24F8::from_bits(u32::try_from(bits).unwrap_or(u32::MAX));
        let percent = (self.bank.word(Reg::CC) & 0xFF) as u8;
        self.motion.circuit_turn(at, full_steps * i32::from(microsteps), evenly(speed), percent, out);
    }
}
