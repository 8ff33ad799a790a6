//! The Hybrid's circuitry: calibration, the rotor's lag and lead, make-up, torque mode, temperature (FB 5.1, MC 5-2 to
//! 5-10, 5-38, 5-41 to 5-50, 5-70 to 5-81).
//!
//! The rotor lags while its shaft is held (a fault) or its load is too heavy, or when it has fallen in elsewhere after
//! that. It does not creep on at the bounds then, but stands until the motion does or the load changes. Make-up steps are not interleaved with those of a move, but made behind it.

mod heat;

use fixed::types::{I24F8, U24F8};

use self::heat::{Heat, SHUTDOWN};
use super::drive::{Drive, Model};
use super::error::Error;
use super::registers::Reg;
use super::{CALIBRATION, LAG_LIMIT, LEAD_LIMIT, LOCKED_ROTOR, OVER_TEMPERATURE};
use crate::device::{Duration, Fault, Instant, Sink};
use crate::motion::{MAX_ACCELERATION, Rates};

/// Bits of AF (MC 5-2).
mod status {
    pub(super) const LEAD: u16 = 1;
    pub(super) const LAG: u16 = 2;
    pub(super) const LOCKED: u16 = 8;
    pub(super) const ACTIVE: u16 = 16;
    pub(super) const HARDWARE: u16 = 32;
    pub(super) const AT_ZERO: u16 = 64;
    pub(super) const CALIBRATED: u16 = 128;
    pub(super) const FAILED: u16 = 256;
}

/// Conditions of TA (MC 5-71).
mod condition {
    pub(super) const CALIBRATED: u8 = 1;
    pub(super) const ACTIVE: u8 = 2;
    pub(super) const LOCKED: u8 = 4;
    pub(super) const LAG: u8 = 8;
    pub(super) const LEAD: u8 = 16;
}

/// Values of AS.
mod mode {
    pub(super) const OFF: u16 = 0;
    pub(super) const TORQUE: u16 = 3;
}

/// Full steps of the moves of a calibration, and what they take: with three times a CT of 250 ms 3.12 s (MC 5-9).
const FORTH: i32 = 6;
const FORTH_TAKES: Duration = Duration::millis(1_580);
const BACK: i32 = 3;
const BACK_TAKES: Duration = Duration::millis(790);
/// How long one takes in all whose rotor cannot move (MC 5-9).
const BLOCKED: Duration = Duration::secs(10);

/// What full torque accelerates the rotor by, in full steps/s²: nothing is said of its load.
const TORQUE_ACCELERATION: u32 = 39_062;
/// Where no torque is left, in full steps/s: 3,000 rpm.
const PULL_OUT: u32 = 10_000;
/// Of SS and TS: 10 MHz/(n + 2).
const OSCILLATOR: u32 = 10_000_000;

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
struct Calibration {
    stage: Stage,
    due: Instant,
    since: Instant,
}

/// How far the circuitry is with the rotor.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Rotor {
    /// It is where it belongs, or nobody looks after it.
    Free,
    /// It makes up for what it lags.
    MakesUp,
    /// Torque turns it: TQ and TS as they are.
    Spins { torque: u16, speed: u16, forward: bool },
}

/// What it is at. An MDrivePlus² has none of it.
#[derive(Clone, Debug)]
pub(super) struct Hybrid {
    calibration: Option<Calibration>,
    is_calibrated: bool,
    has_failed: bool,
    is_locked: bool,
    /// The bridge is off, whatever DE says.
    is_disabled: bool,
    is_overheated: bool,
    has_warned: bool,
    rotor: Rotor,
    /// Since when the rotor, which does not move, has been at its bounds.
    at_bounds: Option<Instant>,
    /// The lag has come to LG, the lead to LD.
    lags: bool,
    leads: bool,
    /// When the rotor comes to something that counts, or has been locked for long enough.
    rotor_due: Instant,
    heat: Heat,
    heat_due: Instant,
    /// Faults that are there: LEAD_LIMIT, LAG_LIMIT, LOCKED_ROTOR, CALIBRATION.
    leads_anyway: bool,
    lags_anyway: bool,
    is_blocked: bool,
    cannot_calibrate: bool,
}

impl Hybrid {
    /// Without power.
    pub(super) const NONE: Self = Self {
        calibration: None,
        is_calibrated: false,
        has_failed: false,
        is_locked: false,
        is_disabled: false,
        is_overheated: false,
        has_warned: false,
        rotor: Rotor::Free,
        at_bounds: None,
        lags: false,
        leads: false,
        rotor_due: Instant::NEVER,
        heat: Heat::COOL,
        heat_due: Instant::NEVER,
        leads_anyway: false,
        lags_anyway: false,
        is_blocked: false,
        cannot_calibrate: false,
    };

    /// Power comes, or a restart: that leaves what causes faults, and its temperature. `whole`: that will be told anew.
    pub(super) fn restart(&mut self, whole: bool) {
        let Self { heat, leads_anyway, lags_anyway, is_blocked, cannot_calibrate, .. } = *self;
        *self = Self::NONE;
        if !whole {
            *self = Self { heat, leads_anyway, lags_anyway, is_blocked, cannot_calibrate, ..Self::NONE };
        }
    }

    /// It starts without a delay: calibrated.
    pub(super) fn set_calibrated(&mut self) {
        self.is_calibrated = true;
    }

    /// LR.
    pub(super) fn is_locked(&self) -> bool {
        self.is_locked
    }

    /// Whether the bridge is off, whatever DE says.
    pub(super) fn is_disabled(&self) -> bool {
        self.is_disabled
    }

    pub(super) fn is_calibrating(&self) -> bool {
        self.calibration.is_some()
    }

    /// Whether the circuitry corrects what the rotor does.
    pub(super) fn is_active(&self) -> bool {
        self.at_bounds.is_some() || self.rotor != Rotor::Free
    }

    pub(super) fn makes_up(&self) -> bool {
        self.rotor == Rotor::MakesUp
    }

    /// IT.
    pub(super) fn temperature(&self, at: Instant) -> i32 {
        i32::try_from(self.heat.celsius(at)).unwrap_or(0)
    }

    pub(super) fn deadline(&self) -> Instant {
        let calibration = self.calibration.map_or(Instant::NEVER, |calibration| calibration.due);
        calibration.min(self.rotor_due).min(self.heat_due)
    }
}

impl Drive {
    /// AF.
    pub(super) fn hybrid_status(&self, at: Instant) -> u16 {
        let Hybrid { leads, lags, leads_anyway, lags_anyway, .. } = self.hybrid;
        let at_zero = self.watches_rotor() && self.hybrid.rotor == Rotor::Free && self.lag(at) == 0;
        [
            (leads || leads_anyway, status::LEAD),
            (lags || lags_anyway, status::LAG),
            (self.hybrid.is_locked, status::LOCKED),
            (self.hybrid.is_active(), status::ACTIVE),
            (self.hybrid.is_overheated, status::HARDWARE),
            (at_zero, status::AT_ZERO),
            (self.hybrid.is_calibrated, status::CALIBRATED),
            (self.hybrid.has_failed, status::FAILED),
        ]
        .into_iter()
        .filter(|&(is_so, _)| is_so)
        .fold(0, |bits, (_, bit)| bits | bit)
    }

    /// LL, in steps. In torque mode, while it calibrates and while the circuitry is off there is none.
    pub(super) fn lag(&self, at: Instant) -> i32 {
        if self.watches_rotor() && !self.is_in_torque_mode() { self.motion.lag(at) } else { 0 }
    }

    /// The second value of MU.
    pub(super) fn clear_lag(&mut self, at: Instant) {
        self.motion.clear_lag(at);
    }

    /// Calibrates: SC, CF (`clears`), AS, DE, MS, power-on. Without the circuitry or the bridge there is nothing to do.
    ///
    /// # Errors
    /// 89 or 94 in motion.
    pub(super) fn calibrate(&mut self, at: Instant, clears: bool, out: &mut dyn Sink) -> Result<(), Error> {
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

    /// The cause of one of its faults comes or goes.
    pub(super) fn set_hybrid_cause(&mut self, at: Instant, fault: Fault, on: bool, out: &mut dyn Sink) {
        match fault {
            LEAD_LIMIT => {
                let was_on = core::mem::replace(&mut self.hybrid.leads_anyway, on);
                if on && !was_on {
                    self.tell(at, Error::LeadLimit, condition::LEAD, out);
                }
            }
            LAG_LIMIT => {
                let was_on = core::mem::replace(&mut self.hybrid.lags_anyway, on);
                if on && !was_on {
                    self.tell(at, Error::LagLimit, condition::LAG, out);
                }
            }
            LOCKED_ROTOR => {
                self.hybrid.is_blocked = on;
                if on && self.watches_rotor() {
                    self.lock(at, out);
                } else if self.is_in_torque_mode() {
                    self.hybrid.is_locked = false;
                }
            }
            OVER_TEMPERATURE => self.hybrid.heat.set(at, on),
            CALIBRATION => self.hybrid.cannot_calibrate = on,
            _ => {}
        }
    }

    /// The shaft is held, or let go.
    pub(super) fn hold_shaft(&mut self, at: Instant, held: bool, out: &mut dyn Sink) {
        self.motion.hold_shaft(at, held, out);
        self.take_rotor_on(at, out);
    }

    /// Hands, or the load, have let go of the rotor, perhaps: the circuitry takes it on from where it is.
    pub(super) fn take_rotor_on(&mut self, at: Instant, out: &mut dyn Sink) {
        if self.watches_rotor() {
            self.motion.catch_rotor(at, out);
        }
    }

    /// A calibration goes on, or the rotor or the temperature has come to what was foreseen.
    pub(super) fn hybrid_timeout(&mut self, at: Instant, out: &mut dyn Sink) {
        if let Some(calibration) = self.hybrid.calibration.filter(|calibration| calibration.due <= at) {
            self.calibrate_on(at, calibration, out);
        }
    }

    /// Looks at rotor and temperature, after everything that happens.
    pub(super) fn look_at_hybrid(&mut self, at: Instant, out: &mut dyn Sink) {
        if self.model == Model::Hybrid && self.hears() {
            self.watch_rotor(at, out);
            self.watch_heat(at, out);
        }
    }

    /// CT.
    fn calibration_time(&self) -> Duration {
        Duration::millis(self.bank.word(Reg::CT).into())
    }

    /// What comes behind a stage of a calibration (MC 5-9).
    fn calibrate_on(
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

    /// Whether there is current, but for what the circuitry has switched off.
    fn has_bridge(&self) -> bool {
        self.bank.word(Reg::DE) != 0 && !self.hybrid.is_disabled
    }

    /// Whether the circuitry looks after the rotor.
    fn watches_rotor(&self) -> bool {
        let is_on = self.bank.word(Reg::AS) != mode::OFF && self.has_bridge();
        is_on && self.hybrid.is_calibrated && self.hybrid.calibration.is_none()
    }

    fn is_in_torque_mode(&self) -> bool {
        self.bank.word(Reg::AS) == mode::TORQUE
    }

    /// The rotor is where it is not to be: the circuitry makes up for it, tells of it, gives it up.
    fn watch_rotor(&mut self, at: Instant, out: &mut dyn Sink) {
        self.hybrid.rotor_due = Instant::NEVER;
        if self.hybrid.rotor != Rotor::Free && !self.motion.is_uncounted() {
            // An order has ended it.
            self.hybrid.rotor = Rotor::Free;
        }
        if !self.watches_rotor() {
            self.hybrid.at_bounds = None;
            if self.hybrid.rotor != Rotor::Free {
                self.motion.end_uncounted(at, out);
                self.motion.clear_lag(at);
                self.hybrid.rotor = Rotor::Free;
            }
            return;
        }
        self.spin(at, out);
        self.make_up(at, out);
        self.watch_lag(at, out);
        self.watch_bounds(at, out);
    }

    /// Torque mode: the rotor turns as fast as TS allows. TD counts when it begins (MC 5-72).
    fn spin(&mut self, at: Instant, out: &mut dyn Sink) {
        let (torque, speed) = (self.bank.word(Reg::TQ), self.bank.word(Reg::TS));
        let direction = self.bank.word(Reg::TD) != 0;
        let before = self.hybrid.rotor;
        let forward = match before {
            Rotor::Spins { forward, .. } if self.is_in_torque_mode() => forward,
            Rotor::Spins { .. } => {
                self.motion.end_uncounted(at, out);
                self.motion.clear_lag(at);
                self.hybrid.rotor = Rotor::Free;
                return;
            }
            _ if self.is_in_torque_mode() && (self.motion.is_at_rest() || self.motion.is_uncounted()) => {
                direction
            }
            _ => return,
        };
        let now = Rotor::Spins { torque, speed, forward };
        if now == before {
            return;
        }
        self.hybrid.rotor = now;
        let microsteps = u32::from(self.bank.word(Reg::MS));
        let most = frequency(speed).min(PULL_OUT * microsteps).cast_signed();
        let acceleration = (TORQUE_ACCELERATION * microsteps / 100 * u32::from(torque)).min(MAX_ACCELERATION);
        let turns = I24F8::saturating_from_num(if forward { most } else { -most });
        self.motion.spin_uncounted(at, turns, acceleration, (torque & 0xFF) as u8, out);
    }

    /// What the rotor lags when a motion is over is made up for with MU, at the speed of MF or SS.
    fn make_up(&mut self, at: Instant, out: &mut dyn Sink) {
        if self.hybrid.rotor == Rotor::MakesUp {
            let ends = self.motion.plan_ends();
            if ends > at {
                self.hybrid.rotor_due = ends;
                return;
            }
            self.motion.end_uncounted(at, out);
            self.hybrid.rotor = Rotor::Free;
        }
        let frequency = match self.bank.word(Reg::MU) {
            1 => u32::try_from(self.bank.get(Reg::MF)).unwrap_or(0),
            2 => frequency(self.bank.word(Reg::SS)),
            _ => return,
        };
        let lag = self.lag(at);
        if lag == 0 || !self.motion.is_at_rest() || !self.motion.shaft_stands() {
            return;
        }
        let percent = (self.bank.word(Reg::RC) & 0xFF) as u8;
        self.motion.turn_uncounted(at, lag, evenly(U24F8::saturating_from_num(frequency)), percent, out);
        self.hybrid.rotor = Rotor::MakesUp;
        self.hybrid.rotor_due = self.motion.plan_ends();
        self.trip_on_status(at, condition::ACTIVE, out);
    }

    /// LG and LD (MC 5-41).
    fn watch_lag(&mut self, at: Instant, out: &mut dyn Sink) {
        let limit = |reg| i32::try_from(self.bank.get(reg)).unwrap_or(i32::MAX);
        let (most, least) = (limit(Reg::LG), -limit(Reg::LD));
        let lag = self.lag(at);
        let lags = lag > 0 && lag >= most;
        let leads = lag < 0 && lag <= least;
        if lags && !core::mem::replace(&mut self.hybrid.lags, lags) {
            self.tell(at, Error::LagLimit, condition::LAG, out);
        }
        if leads && !core::mem::replace(&mut self.hybrid.leads, leads) {
            self.tell(at, Error::LeadLimit, condition::LEAD, out);
        }
        (self.hybrid.lags, self.hybrid.leads) = (lags, leads);
        if !lags {
            self.foresee_lag(at, most);
        }
        if !leads {
            self.foresee_lag(at, least);
        }
    }

    /// A rotor that does not move at the bounds of CB is locked after LT (MC 5-44). In torque mode that is one that
    /// does not turn.
    fn watch_bounds(&mut self, at: Instant, out: &mut dyn Sink) {
        // CB 0 to 3 are 11, 13, 15 and 17 tenths of a full step.
        let tenths = 11 + 2 * i32::from(self.bank.word(Reg::CB));
        let bounds = i32::from(self.bank.word(Reg::MS)) * tenths / 10;
        let stands = !self.motion.follows();
        let is_at_bounds =
            stands && (self.is_in_torque_mode() || self.lag(at).unsigned_abs() >= bounds.unsigned_abs());
        if !is_at_bounds {
            self.hybrid.at_bounds = None;
            if self.is_in_torque_mode() && !self.hybrid.is_blocked {
                self.hybrid.is_locked = false;
            }
            if stands {
                self.foresee_lag(at, bounds);
                self.foresee_lag(at, -bounds);
            }
            return;
        }
        let begins = self.hybrid.at_bounds.is_none();
        let since = *self.hybrid.at_bounds.get_or_insert(at);
        if begins {
            self.trip_on_status(at, condition::ACTIVE, out);
        }
        let timeout = Duration::millis(u64::try_from(self.bank.get(Reg::LT)).unwrap_or(0));
        if self.hybrid.is_locked {
            return;
        }
        if since + timeout <= at {
            self.lock(at, out);
        } else {
            self.hybrid.rotor_due = self.hybrid.rotor_due.min(since + timeout);
        }
    }

    /// A rotor that stands comes to that lag.
    fn foresee_lag(&mut self, at: Instant, lag: i32) {
        if !self.motion.follows() && !self.motion.is_uncounted() {
            self.hybrid.rotor_due = self.hybrid.rotor_due.min(self.motion.lags(at, lag));
        }
    }

    /// The rotor is locked: but in torque mode the bridge is switched off.
    fn lock(&mut self, at: Instant, out: &mut dyn Sink) {
        self.hybrid.is_locked = true;
        if self.is_in_torque_mode() {
            return self.trip_on_status(at, condition::LOCKED, out);
        }
        (self.hybrid.is_disabled, self.hybrid.at_bounds) = (true, None);
        self.set_motion(at, out);
        self.tell(at, Error::LockedRotor, condition::LOCKED, out);
    }

    /// Warns above WT, and switches the bridge off at [`SHUTDOWN`].
    fn watch_heat(&mut self, at: Instant, out: &mut dyn Sink) {
        let warning = i64::from(self.bank.word(Reg::WT)) + 1;
        let is_warm = self.hybrid.heat.celsius(at) >= warning;
        if is_warm && !self.hybrid.has_warned {
            self.fail(at, Error::TemperatureWarning, out);
        }
        self.hybrid.has_warned = is_warm;
        if self.hybrid.heat.celsius(at) >= SHUTDOWN && !self.hybrid.is_overheated {
            (self.hybrid.is_overheated, self.hybrid.is_disabled) = (true, true);
            self.set_motion(at, out);
            self.fail(at, Error::OverTemperature, out);
            self.watch_rotor(at, out);
        }
        let dues = [warning, SHUTDOWN].map(|celsius| self.hybrid.heat.passes(celsius));
        self.hybrid.heat_due = dues.into_iter().filter(|&due| due > at).min().unwrap_or(Instant::NEVER);
    }

    /// Something is wrong with the rotor, and may trip.
    fn tell(&mut self, at: Instant, error: Error, condition: u8, out: &mut dyn Sink) {
        // "There is no error generation when enabling trip" on these (MC 5-71): the trip takes its place.
        if !self.trips_on_status(condition) {
            self.fail(at, error, out);
        }
        self.trip_on_status(at, condition, out);
    }
}

/// The speed of SS and TS, in steps/s.
fn frequency(n: u16) -> u32 {
    OSCILLATOR / (u32::from(n) + 2)
}

/// At once at that speed.
fn evenly(speed: U24F8) -> Rates {
    Rates { start: speed, speed, up: MAX_ACCELERATION, down: MAX_ACCELERATION }
}
