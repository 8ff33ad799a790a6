//! How the circuitry learns where the rotor is (MC 5-8 to 5-15).

use fixed::types::U24F8;

use super::heat::SHUTDOWN;
use super::{Rotor, condition, evenly, mode};
use crate::device::{Duration, Instant, Sink};
use crate::mdrive::drive::Drive;
use crate::mdrive::error::Error;
use crate::mdrive::registers::Reg;

/// Full steps of the moves of a calibration, and what they take: with three times a CT of 250 ms 3.12 s (MC 5-9).
const FORTH: i32 = 6;
const FORTH_TAKES: Duration = Duration::millis(1_580);
const BACK: i32 = 3;
const BACK_TAKES: Duration = Duration::millis(790);
/// How long one takes in all whose rotor cannot move (MC 5-9).
const BLOCKED: Duration = Duration::secs(10);

/// What a calibration is at.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Stage {
    Settles,
    Forth,
    Waits,
    Back,
    Rests,
    /// The rotor is blocked: it tries on.
    Tries,
}

/// A calibration.
#[derive(Clone, Copy, Debug)]
pub(super) struct Calibration {
    stage: Stage,
    pub(super) due: Instant,
    since: Instant,
}

impl Drive {
    /// Calibrates: SC, CF (`clears`), AS, DE, MS, power-on. Without the circuitry or the bridge there is nothing to do.
    ///
    /// # Errors
    /// 89 or 94 in motion.
    pub(in crate::mdrive) fn calibrate(
        &mut self,
        at: Instant,
        clears: bool,
        out: &mut dyn Sink,
    ) -> Result<(), Error> {
        if self.motion.is_moving() {
            return Err(if clears { Error::ClearLockedInMotion } else { Error::CalibrationInMotion });
        }
        self.motion.end_uncounted(at, out);
        self.hybrid.rotor = Rotor::Free;
        (self.hybrid.is_calibrated, self.hybrid.has_failed) = (false, false);
        (self.hybrid.is_locked, self.hybrid.at_bounds) = (false, None);
        // It has cooled down, or stays off.
        self.hybrid.is_overheated &= self.hybrid.heat.celsius(at) >= SHUTDOWN;
        self.hybrid.is_disabled = self.hybrid.is_overheated;
        let works = self.bank.word(Reg::AS) != mode::OFF && self.has_bridge();
        let due = at + self.calibration_time();
        self.hybrid.calibration = works.then_some(Calibration { stage: Stage::Settles, due, since: at });
        self.set_motion(at, out);
        if works {
            // Nothing else moves it meanwhile.
            self.turn_full_steps(at, 0, out);
        }
        self.watch_rotor(at, out);
        Ok(())
    }

    /// CT.
    fn calibration_time(&self) -> Duration {
        Duration::millis(self.bank.word(Reg::CT).into())
    }

    /// What comes behind a stage of a calibration (MC 5-9).
    pub(super) fn calibrate_on(
        &mut self,
        at: Instant,
        Calibration { stage, due, since }: Calibration,
        out: &mut dyn Sink,
    ) {
        let (stage, lasts) = match stage {
            Stage::Settles => (Stage::Forth, FORTH_TAKES),
            Stage::Forth => (Stage::Waits, self.calibration_time()),
            Stage::Waits => (Stage::Back, BACK_TAKES),
            Stage::Back => (Stage::Rests, self.calibration_time()),
            Stage::Rests if self.is_rotor_blocked() => (Stage::Tries, (since + BLOCKED).since(due)),
            Stage::Rests | Stage::Tries => return self.end_calibration(at, stage == Stage::Tries, out),
        };
        self.hybrid.calibration = Some(Calibration { stage, due: due + lasts, since });
        match stage {
            Stage::Forth => self.turn_full_steps(at, FORTH, out),
            Stage::Back => self.turn_full_steps(at, -BACK, out),
            _ => {}
        }
    }

    fn is_rotor_blocked(&self) -> bool {
        self.hybrid.cannot_calibrate || self.hybrid.is_blocked || !self.motion.follows()
    }

    /// Turns the rotor for the calibration.
    fn turn_full_steps(&mut self, at: Instant, full_steps: i32, out: &mut dyn Sink) {
        let microsteps = self.bank.word(Reg::MS);
        let per_second = (u64::from(microsteps) << 8) * Duration::secs(1).ticks();
        // Not below the speed of six steps in their time, so that it stands when that is over.
        let bits = (per_second * u64::from(FORTH.unsigned_abs())).div_ceil(FORTH_TAKES.ticks());
        let speed = U24F8::from_bits(u32::try_from(bits).unwrap_or(u32::MAX));
        let percent = (self.bank.word(Reg::CC) & 0xFF) as u8;
        self.motion.turn_uncounted(at, full_steps * i32::from(microsteps), evenly(speed), percent, out);
    }

    fn end_calibration(&mut self, at: Instant, has_failed: bool, out: &mut dyn Sink) {
        self.motion.end_uncounted(at, out);
        self.motion.clear_lag(at);
        self.hybrid.calibration = None;
        (self.hybrid.is_calibrated, self.hybrid.has_failed) = (true, has_failed);
        if has_failed {
            // "A locked rotor response" (MC 5-9).
            (self.hybrid.is_locked, self.hybrid.is_disabled) = (true, true);
            self.set_motion(at, out);
            self.fail(at, Error::CalibrationFailed, out);
        }
        self.trip_on_status(at, condition::CALIBRATED, out);
    }
}
