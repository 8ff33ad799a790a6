//! Control of the rotor by the circuitry: torque mode, make-up, bounds of the lag (MC 5-10, 5-44 to 5-50,
//! 5-72 to 5-76).
//!
//! In torque mode the drive makes no steps: the torque TQ and the inertia alone move the rotor. TQ accelerates
//! the rotor up to its speed limit, blocking the shaft stops it, and at the end of torque mode it slows down.

use fixed::types::{I24F8, U24F8};

use super::status::condition;
use super::{Hybrid, LOCKED_ROTOR, frequency};
use crate::device::{Context, Duration, Instant};
use crate::mdrive::drive::Drive;
use crate::mdrive::error::Error;
use crate::mdrive::registers::Reg;
use crate::motion::{Limits, MAX_ACCELERATION};

/// Full steps in a revolution, for the accelerations and speeds in this file.
const STEPS_PER_REV: u32 = 200;
/// Acceleration of the rotor by full torque, in full steps/s²; our value, because the manual gives no load
/// (MDRIVE-28).
const TORQUE_ACCELERATION: u32 = 39_062;
/// Minimum deceleration of the rotor without current, in full steps/s².
const LEAST_DECELERATION: u64 = 390;
/// Speed at which no torque is left, in full steps/s: 3,000 rpm.
const PULL_OUT: u32 = 10_000;

/// Present control of the rotor.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Rotor {
    /// No control: the rotor is in position, or the circuitry is off.
    Free,
    /// The circuitry makes up for the rotor's lag.
    MakesUp,
    /// Torque turns the rotor, unless something outside stops it.
    Spins { spin: Spin, is_stopped: bool },
    /// Torque mode has ended: the rotor slows down at this rate, in full steps/s².
    Slows(u32),
}

/// TQ and TS now, and TD when torque mode began.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Spin {
    torque: u16,
    speed: u16,
    forward: bool,
}

impl Hybrid {
    /// Returns true if torque mode is on, also while something stops the rotor.
    pub(in crate::mdrive) fn has_torque(&self) -> bool {
        matches!(self.rotor, Rotor::Spins { .. })
    }

    /// Returns true if the rotor turns without a commanded motion.
    pub(super) fn turns(&self) -> bool {
        matches!(self.rotor, Rotor::Spins { is_stopped: false, .. } | Rotor::Slows(_))
    }
}

impl Drive {
    /// Returns true if anything moves. S, SC, CF, MS and similar commands are refused then.
    pub(in crate::mdrive) fn is_in_motion(&self) -> bool {
        self.motion.is_moving() || self.hybrid.turns()
    }

    /// Blocks the shaft, or releases it.
    pub(in crate::mdrive) fn block_shaft(&mut self, at: Instant, held: bool, out: &mut dyn Context) {
        self.motion.block_shaft(at, held, out);
        self.apply_rotor_settings(at, out);
    }

    /// Handles a possible release of the shaft from a blocking or its load: the circuitry continues to drive
    /// it from its present position.
    pub(in crate::mdrive) fn apply_rotor_settings(&mut self, at: Instant, out: &mut dyn Context) {
        if !self.watches_rotor() {
            return;
        }
        self.motion.resynchronise_rotor(at, out);
        if let Rotor::Spins { spin, .. } = self.hybrid.rotor {
            self.spin(at, spin, out);
        }
    }

    /// Checks the rotor, and reacts if it is off its position: makes up for the lag, reports it, or locks the
    /// rotor.
    pub(super) fn watch_rotor(&mut self, at: Instant, out: &mut dyn Context) {
        self.hybrid.rotor_due = Instant::NEVER;
        if self.hybrid.rotor != Rotor::Free && !self.motion.is_circuit_driven() {
            // A motion command has ended the control.
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

    /// Begins torque mode when all motion has ended, updates it when values change, or ends it.
    fn watch_torque(&mut self, at: Instant, out: &mut dyn Context) {
        let is_wanted = self.watches_rotor() && self.is_in_torque_mode();
        let (torque, speed) = (self.bank.word(Reg::TQ), self.bank.word(Reg::TS));
        match self.hybrid.rotor {
            Rotor::Spins { spin, is_stopped } if is_wanted => {
                // TD is read only when torque mode begins (MC 5-72).
                let now = Spin { torque, speed, ..spin };
                if now != spin {
                    self.spin(at, now, out);
                } else if !is_stopped && !self.motion.follows() {
                    self.spin_on(at, spin, out);
                } else if is_stopped && self.motion.follows() && self.motion.can_turn(spin.forward) {
                    // The load was too heavy, and has become lighter.
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

    /// Accelerates the rotor, or slows it down, with torque TQ to the speed that TS allows.
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

    /// Handles a rotor if no torque is left to accelerate it. The rotor keeps its present speed, or stops.
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

    /// Slows the rotor to standstill. RC brakes it; without a bridge its friction does.
    fn slow_down(&mut self, at: Instant, out: &mut dyn Context) {
        let (run, coasts) = (self.bank.word(Reg::RC), self.coasts());
        let by = if self.has_bridge() { by_torque(run) } else { coasts };
        let now = Rotor::Slows(by);
        let percent = (run & 0xFF) as u8;
        if core::mem::replace(&mut self.hybrid.rotor, now) != now {
            self.motion.circuit_slow(at, self.in_steps(by), percent, out);
        }
        if !self.motion.follows() {
            // The current RC is not enough for this deceleration.
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
        /// Acceleration by 1 µN·m at 1 g·cm², in full steps/s²: 10 rad/s², with 200 full steps in a
        /// revolution.
        const EACH: u64 = 318;
        let long = |reg| u64::try_from(self.bank.get(reg)).unwrap_or(0);
        let by = (long(Reg::Friction) * 1_000 * EACH).checked_div(long(Reg::Inertia)).unwrap_or(0);
        u32::try_from(by.max(LEAST_DECELERATION)).unwrap_or(u32::MAX)
    }

    /// Converts an acceleration or a speed from full steps to steps.
    fn in_steps(&self, full_steps: u32) -> u32 {
        let steps_per_rev = u64::from(self.bank.word(Reg::MS)) * u64::from(self.bank.word(Reg::FullSteps));
        let steps = u64::from(full_steps).saturating_mul(steps_per_rev) / u64::from(STEPS_PER_REV);
        u32::try_from(steps).unwrap_or(u32::MAX).min(MAX_ACCELERATION)
    }

    /// Ends the control of the rotor at its present position, where it neither lags nor leads.
    fn leave_rotor(&mut self, at: Instant, out: &mut dyn Context) {
        self.motion.circuit_end(at, out);
        self.motion.clear_lag(at);
        self.hybrid.rotor = Rotor::Free;
    }

    /// Makes up for the rotor's lag after a motion if MU is not 0, at the speed of MF or SS.
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

    /// Locks a rotor that has stayed at the bounds of CB for the time LT (MC 5-44). In torque mode a rotor
    /// that does not turn counts as at the bounds.
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

    /// Schedules a check for the time at which the rotor may reach this lag.
    pub(super) fn predict_lag(&mut self, at: Instant, lag: i32) {
        if !self.motion.is_circuit_driven() {
            self.hybrid.rotor_due = self.hybrid.rotor_due.min(self.motion.lag_time(at, lag));
        }
    }

    /// Marks the rotor as locked. Except in torque mode, this switches the bridge off and ends the motion
    /// like a stall (MDRIVE-30).
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

/// Acceleration by a percentage of the full torque, in full steps/s².
fn by_torque(percent: u16) -> u32 {
    TORQUE_ACCELERATION * u32::from(percent) / 100
}

/// Limits of a motion at constant speed, without ramps.
pub(super) fn evenly(speed: U24F8) -> Limits {
    Limits {
        start_speed: speed,
        max_speed: speed,
        acceleration: MAX_ACCELERATION,
        deceleration: MAX_ACCELERATION,
    }
}
