//! Control of the rotor by the circuitry: torque mode, make-up, its bounds (MC 5-10, 5-44 to 5-50, 5-72 to 5-76).
//!
//! In torque mode the rotor turns on its own, with its inertia: it is as fast as torque has made it, a hand that holds
//! it stops it, and what ends torque mode slows it down.

use fixed::types::{I24F8, U24F8};

use super::status::condition;
use super::{Hybrid, LOCKED_ROTOR, frequency};
use crate::device::{Context, Duration, Instant};
use crate::mdrive::drive::Drive;
use crate::mdrive::error::Error;
use crate::mdrive::registers::Reg;
use crate::motion::{Limits, MAX_ACCELERATION};

/// Accelerations here are in full steps of so many in a turn.
const STEPS_PER_REV: u32 = 200;
/// Acceleration of the rotor by full torque, in full steps/s²: the manual gives no load (MDRIVE-28).
const TORQUE_ACCELERATION: u32 = 39_062;
/// The least that slows it down without a current, in full steps/s².
const LEAST_DECELERATION: u64 = 390;
/// Speed at which no torque is left, in full steps/s: 3,000 rpm.
const PULL_OUT: u32 = 10_000;

/// Control of the rotor.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Rotor {
    /// None: it is where it belongs, or is not controlled.
    Free,
    /// Makes up for its lag.
    MakesUp,
    /// Torque turns it, unless it is stopped from outside.
    Spins { spin: Spin, is_stopped: bool },
    /// Torque mode is over: it slows down by so many full steps/s².
    Slows(u32),
}

/// TQ, TS and TD as they are, or were when it began.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Spin {
    torque: u16,
    speed: u16,
    forward: bool,
}

impl Hybrid {
    /// Returns whether the rotor turns without a commanded motion.
    pub(super) fn turns(&self) -> bool {
        matches!(self.rotor, Rotor::Spins { is_stopped: false, .. } | Rotor::Slows(_))
    }
}

impl Drive {
    /// Returns whether anything moves: S, SC, CF, MS and the like are refused then.
    pub(in crate::mdrive) fn is_in_motion(&self) -> bool {
        self.motion.is_moving() || self.hybrid.turns()
    }

    /// The shaft is blocked, or released.
    pub(in crate::mdrive) fn block_shaft(&mut self, at: Instant, held: bool, out: &mut dyn Context) {
        self.motion.block_shaft(at, held, out);
        self.apply_rotor_settings(at, out);
    }

    /// The shaft may have been released, by a hand or by its load: the circuitry drives it on from its present
    /// position.
    pub(in crate::mdrive) fn apply_rotor_settings(&mut self, at: Instant, out: &mut dyn Context) {
        if !self.watches_rotor() {
            return;
        }
        self.motion.resynchronise_rotor(at, out);
        if let Rotor::Spins { spin, .. } = self.hybrid.rotor {
            self.spin(at, spin, out);
        }
    }

    /// The rotor is off its position: the circuitry makes up for it, reports it, or gives up.
    pub(super) fn watch_rotor(&mut self, at: Instant, out: &mut dyn Context) {
        self.hybrid.rotor_due = Instant::NEVER;
        if self.hybrid.rotor != Rotor::Free && !self.motion.is_circuit_driven() {
            // An order has ended it.
            self.hybrid.rotor = Rotor::Free;
        }
        self.watch_torque(at, out);
        if !self.watches_rotor() {
            self.hybrid.at_bounds = None;
            if self.hybrid.rotor == Rotor::MakesUp {
                self.leave_rotor(at, out);
            }
            return;
        }
        self.make_up(at, out);
        self.watch_lag(at, out);
        self.watch_bounds(at, out);
    }

    /// Torque mode begins when all motion is over, goes on with other values, or ends.
    fn watch_torque(&mut self, at: Instant, out: &mut dyn Context) {
        let is_wanted = self.watches_rotor() && self.is_in_torque_mode();
        let (torque, speed) = (self.bank.word(Reg::TQ), self.bank.word(Reg::TS));
        match self.hybrid.rotor {
            Rotor::Spins { spin, is_stopped } if is_wanted => {
                // TD counts when it begins (MC 5-72).
                let now = Spin { torque, speed, ..spin };
                if now != spin {
                    self.spin(at, now, out);
                } else if !is_stopped && !self.motion.follows() {
                    self.spin_on(at, spin, out);
                } else if is_stopped && self.motion.follows() && self.motion.can_turn(spin.forward) {
                    // The load that was too heavy for it is lighter.
                    self.spin(at, spin, out);
                }
            }
            _ if is_wanted => {
                if self.motion.is_at_rest() || self.motion.is_circuit_driven() {
                    let forward = self.bank.word(Reg::TD) != 0;
                    self.spin(at, Spin { torque, speed, forward }, out);
                }
            }
            Rotor::Spins { is_stopped: true, .. } => self.leave_rotor(at, out),
            Rotor::Spins { .. } | Rotor::Slows(_) => self.slow_down(at, out),
            Rotor::Free | Rotor::MakesUp => {}
        }
    }

    /// The rotor is accelerated, or slowed down, by TQ to what TS allows.
    fn spin(&mut self, at: Instant, spin: Spin, out: &mut dyn Context) {
        let Spin { torque, speed, forward } = spin;
        let fastest = i64::from(self.in_steps(PULL_OUT));
        let speed = i64::from(frequency(speed.into())).min(fastest);
        let turns = I24F8::saturating_from_num(if forward { speed } else { -speed });
        let acceleration = self.in_steps(by_torque(torque));
        self.hybrid.rotor = Rotor::Spins { spin, is_stopped: false };
        self.motion.circuit_spin(at, turns, acceleration, (torque & 0xFF) as u8, out);
        if !self.motion.follows() {
            self.spin_on(at, spin, out);
        }
    }

    /// No torque is left to accelerate the rotor: it turns as fast as it does, or is stopped.
    fn spin_on(&mut self, at: Instant, spin: Spin, out: &mut dyn Context) {
        let speed = self.motion.circuit_speed(at);
        if speed != 0 {
            let rounds_by = self.in_steps(self.coasts());
            self.motion.circuit_spin(at, speed, rounds_by, (spin.torque & 0xFF) as u8, out);
            self.motion.resynchronise_rotor(at, out);
        }
        let is_stopped = speed == 0 || !self.motion.follows();
        if is_stopped {
            self.motion.circuit_stop(at, out);
        }
        self.hybrid.rotor = Rotor::Spins { spin, is_stopped };
    }

    /// The rotor comes to standstill: RC brakes it, or without a bridge its friction.
    fn slow_down(&mut self, at: Instant, out: &mut dyn Context) {
        let (run, coasts) = (self.bank.word(Reg::RC), self.coasts());
        let by = if self.has_bridge() { by_torque(run) } else { coasts };
        let now = Rotor::Slows(by);
        let percent = (run & 0xFF) as u8;
        if core::mem::replace(&mut self.hybrid.rotor, now) != now {
            self.motion.circuit_slow(at, self.in_steps(by), percent, out);
        }
        if !self.motion.follows() {
            // RC is not enough for that.
            self.motion.circuit_slow(at, self.in_steps(coasts), percent, out);
            self.motion.resynchronise_rotor(at, out);
        }
        let ends = self.motion.plan_ends();
        if ends <= at || !self.motion.follows() {
            self.leave_rotor(at, out);
        } else {
            self.hybrid.rotor_due = ends;
        }
    }

    /// Deceleration of the rotor by friction, in full steps/s².
    fn coasts(&self) -> u32 {
        /// Full steps/s² of 1 µN·m at 1 g·cm²: 10 rad/s², 200 full steps a turn.
        const EACH: u64 = 318;
        let long = |reg| u64::try_from(self.bank.get(reg)).unwrap_or(0);
        let by = (long(Reg::Friction) * 1_000 * EACH).checked_div(long(Reg::Inertia)).unwrap_or(0);
        u32::try_from(by.max(LEAST_DECELERATION)).unwrap_or(u32::MAX)
    }

    /// An acceleration in steps/s², or a speed in steps/s, of one in full steps.
    fn in_steps(&self, full_steps: u32) -> u32 {
        let steps_per_rev = u64::from(self.bank.word(Reg::MS)) * u64::from(self.bank.word(Reg::FullSteps));
        let steps = u64::from(full_steps).saturating_mul(steps_per_rev) / u64::from(STEPS_PER_REV);
        u32::try_from(steps).unwrap_or(u32::MAX).min(MAX_ACCELERATION)
    }

    /// The circuitry leaves the rotor where it is: there it neither lags nor leads.
    fn leave_rotor(&mut self, at: Instant, out: &mut dyn Context) {
        self.motion.circuit_end(at, out);
        self.motion.clear_lag(at);
        self.hybrid.rotor = Rotor::Free;
    }

    /// Makes up for the rotor's lag at the end of a motion with MU, at the speed of MF or SS.
    fn make_up(&mut self, at: Instant, out: &mut dyn Context) {
        if self.hybrid.rotor == Rotor::MakesUp {
            let ends = self.motion.plan_ends();
            if ends > at {
                self.hybrid.rotor_due = ends;
                return;
            }
            self.motion.circuit_end(at, out);
            self.hybrid.rotor = Rotor::Free;
        }
        let system = frequency(self.bank.word(Reg::SS).into());
        let frequency = match self.bank.word(Reg::MU) {
            1 => i32::try_from(self.bank.get(Reg::MF)).unwrap_or(i32::MAX).min(system),
            2 => system,
            _ => return,
        };
        let lag = self.lag(at);
        if lag == 0 || !self.motion.is_at_rest() || !self.motion.shaft_stands() {
            return;
        }
        let percent = (self.bank.word(Reg::RC) & 0xFF) as u8;
        self.motion.circuit_turn(at, lag, evenly(U24F8::saturating_from_num(frequency)), percent, out);
        self.hybrid.rotor = Rotor::MakesUp;
        self.hybrid.rotor_due = self.motion.plan_ends();
        self.trip_on_status(at, condition::ACTIVE, out);
    }

    /// A rotor that does not move at the bounds of CB is locked after LT (MC 5-44). In torque mode that is one that
    /// does not turn.
    fn watch_bounds(&mut self, at: Instant, out: &mut dyn Context) {
        // CB 0 to 3 are 11, 13, 15 and 17 tenths of a full step.
        let tenths = 11 + 2 * i32::from(self.bank.word(Reg::CB));
        let bounds = i32::from(self.bank.word(Reg::MS)) * tenths / 10;
        let stands = !self.motion.follows();
        let is_at_bounds = match self.hybrid.rotor {
            Rotor::Spins { is_stopped, .. } => is_stopped,
            _ => stands && self.lag(at).unsigned_abs() >= bounds.unsigned_abs(),
        };
        if !is_at_bounds {
            self.hybrid.at_bounds = None;
            if self.is_in_torque_mode() && !self.hybrid.causes.has(LOCKED_ROTOR) {
                self.hybrid.is_locked = false;
            }
            if stands {
                self.predict_lag(at, bounds);
                self.predict_lag(at, -bounds);
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

    /// The rotor comes to that lag, or may.
    pub(super) fn predict_lag(&mut self, at: Instant, lag: i32) {
        if !self.motion.is_circuit_driven() {
            self.hybrid.rotor_due = self.hybrid.rotor_due.min(self.motion.lag_time(at, lag));
        }
    }

    /// The rotor is locked: but in torque mode the bridge is switched off, and the motion ends as with a stall
    /// (MDRIVE-30).
    pub(super) fn lock(&mut self, at: Instant, out: &mut dyn Context) {
        self.hybrid.is_locked = true;
        if self.is_in_torque_mode() {
            return self.trip_on_status(at, condition::LOCKED, out);
        }
        (self.hybrid.is_disabled, self.hybrid.at_bounds) = (true, None);
        self.motion.halt(at, out);
        self.set_motion(at, out);
        self.report(at, Error::LockedRotor, condition::LOCKED, out);
    }
}

/// Acceleration by a share of the torque, in full steps/s².
fn by_torque(percent: u16) -> u32 {
    TORQUE_ACCELERATION * u32::from(percent) / 100
}

/// At once at that speed.
pub(super) fn evenly(speed: U24F8) -> Limits {
    Limits {
        start_speed: speed,
        max_speed: speed,
        acceleration: MAX_ACCELERATION,
        deceleration: MAX_ACCELERATION,
    }
}
