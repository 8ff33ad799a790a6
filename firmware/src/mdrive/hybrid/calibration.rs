//! Calibration of a Hybrid, which aligns rotor and stator (MC 5-8, 5-9).

use fixed::types::U24F8;

use super::heat::SHUTDOWN;
use super::rotor::{Rotor, evenly};
use super::{Condition, Environment, Event, Hybrid, OFF};
use crate::device::{Duration, Instant};
use crate::mdrive::error::Error;
use crate::mdrive::motion::Circuit;
use crate::mdrive::registers::Reg;
use crate::mdrive::variables::Registers;
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

    /// Checks that motion commands are allowed.
    ///
    /// # Errors
    /// Error 88 during a calibration.
    pub(in crate::mdrive) fn takes_orders(&self) -> Result<(), Error> {
        if self.is_calibrating() { Err(Error::Calibrating) } else { Ok(()) }
    }
}

impl Hybrid {
    /// Starts a calibration, because of SC, CF (`clears`), AS, DE, MS, EE or power-on. If AS is 0 or the
    /// bridge is off, calibrates nothing and returns false. This queues no event.
    ///
    /// # Errors
    /// In motion 94 for CF, 89 for the others.
    pub(in crate::mdrive) fn calibrate(
        &mut self,
        env: &mut Environment<'_>,
        clears: bool,
    ) -> Result<bool, Error> {
        if env.motion.is_moving() || self.rotor.turns() {
            return Err(if clears { Error::ClearLockedInMotion } else { Error::CalibrationInMotion });
        }
        env.motion.end_circuit(env.at, env.out);
        self.rotor = Rotor::Free;
        (self.is_locked, self.at_bounds) = (false, None);
        // Overheated electronics that have cooled down are enabled again; if still hot, they stay off.
        self.is_overheated &= self.heat.celsius(env.at) >= SHUTDOWN;
        self.is_disabled = self.is_overheated;
        let works = env.registers.word(Reg::AS) != OFF && self.has_bridge(env.registers);
        let due = env.at + calibration_time(env.registers);
        self.calibration = Calibration::Not;
        env.disable_bridge(self.is_disabled);
        if works {
            self.calibration = Calibration::Runs(Run { stage: Stage::Settles, due, since: env.at });
            // The calibration takes control of the motor, so that nothing else moves it meanwhile.
            turn_full_steps(env, 0);
        }
        self.watch_rotor(env);
        Ok(works)
    }

    /// Begins the next stage of a calibration (MC 5-9).
    pub(super) fn calibrate_on(&mut self, env: &mut Environment<'_>) {
        let Calibration::Runs(Run { stage, due, since }) = self.calibration else { return };
        let (stage, lasts) = match stage {
            Stage::Settles => (Stage::Forth, FORTH_TAKES),
            Stage::Forth => (Stage::Waits, calibration_time(env.registers)),
            Stage::Waits => (Stage::Back, BACK_TAKES),
            Stage::Back => (Stage::Rests, calibration_time(env.registers)),
            Stage::Rests if self.is_rotor_blocked(env) => (Stage::Tries, (since + BLOCKED).since(due)),
            Stage::Rests => return self.end_calibration(env, Calibration::Done),
            Stage::Tries => return self.end_calibration(env, Calibration::Failed),
        };
        self.calibration = Calibration::Runs(Run { stage, due: due + lasts, since });
        match stage {
            Stage::Forth => turn_full_steps(env, FORTH),
            Stage::Back => turn_full_steps(env, -BACK),
            _ => {}
        }
    }

    fn end_calibration(&mut self, env: &mut Environment<'_>, outcome: Calibration) {
        env.motion.end_circuit(env.at, env.out);
        env.motion.shaft_mut().clear_lag(env.at);
        self.calibration = outcome;
        if outcome == Calibration::Failed {
            (self.is_locked, self.is_disabled) = (true, true);
            env.disable_bridge(true);
            self.events.push(Event::CalibrationFailed);
        }
        self.events.push(Event::Reached(Condition::Calibrated));
    }

    fn is_rotor_blocked(&self, env: &Environment<'_>) -> bool {
        let causes = self.causes;
        causes.has(CALIBRATION) || causes.has(LOCKED_ROTOR) || !env.motion.shaft().follows()
    }
}

/// CT, the duration of a wait.
fn calibration_time(registers: &Registers) -> Duration {
    Duration::millis(registers.word(Reg::CT).into())
}

/// Turns the rotor by full steps for the calibration.
fn turn_full_steps(env: &mut Environment<'_>, full_steps: i32) {
    let microsteps = env.registers.word(Reg::MS);
    let per_second = (u64::from(microsteps) << 8) * Duration::secs(1).ticks();
    // The speed is at least that of six steps in their time, so that the rotor is at rest when that time
    // ends.
    let bits = (per_second * u64::from(FORTH.unsigned_abs())).div_ceil(FORTH_TAKES.ticks());
    let speed = U24F8::from_bits(u32::try_from(bits).unwrap_or(u32::MAX));
    let percent = (env.registers.word(Reg::CC) & 0xFF) as u8;
    let circuit = Circuit::Turn { steps: full_steps * i32::from(microsteps), rates: evenly(speed) };
    env.motion.begin_circuit(env.at, circuit, percent, env.out);
}
