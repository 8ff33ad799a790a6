//! What the circuitry does about the rotor: torque mode, make-up, lag and lead, a rotor that is locked (MC 5-41 to 5-50,
//! 5-70 to 5-76).

use fixed::types::{I24F8, U24F8};

use super::{Rotor, condition, evenly};
use crate::device::{Duration, Instant, Sink};
use crate::mdrive::drive::Drive;
use crate::mdrive::error::Error;
use crate::mdrive::registers::Reg;
use crate::motion::MAX_ACCELERATION;

/// What full torque accelerates the rotor by, in full steps/s²: nothing is said of its load.
const TORQUE_ACCELERATION: u32 = 39_062;
/// Where no torque is left, in full steps/s: 3,000 rpm.
const PULL_OUT: u32 = 10_000;
/// Of SS and TS: 10 MHz/(n + 2).
const OSCILLATOR: u32 = 10_000_000;

impl Drive {
    /// The rotor is where it is not to be: the circuitry makes up for it, tells of it, gives it up.
    pub(super) fn watch_rotor(&mut self, at: Instant, out: &mut dyn Sink) {
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
    pub(super) fn lock(&mut self, at: Instant, out: &mut dyn Sink) {
        self.hybrid.is_locked = true;
        if self.is_in_torque_mode() {
            return self.trip_on_status(at, condition::LOCKED, out);
        }
        (self.hybrid.is_disabled, self.hybrid.at_bounds) = (true, None);
        self.set_motion(at, out);
        self.tell(at, Error::LockedRotor, condition::LOCKED, out);
    }
}

/// The speed of SS and TS, in steps/s.
fn frequency(n: u16) -> u32 {
    OSCILLATOR / (u32::from(n) + 2)
}
