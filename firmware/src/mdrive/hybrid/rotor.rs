//! Control of the rotor by the circuitry: torque mode, make-up, bounds of the lag (MC 5-10, 5-44 to 5-50,
//! 5-72 to 5-76).
//!
//! In torque mode the drive makes no steps: the torque TQ and the inertia alone move the rotor. TQ accelerates
//! the rotor up to its speed limit, blocking the shaft stops it, and at the end of torque mode it slows down.

use fixed::types::{I24F8, U24F8};

use super::status::Limit;
use super::{Condition, Environment, Event, Hybrid, LOCKED_ROTOR, is_in_torque_mode};
use crate::device::{Duration, Instant};
use crate::mdrive::error::Error;
use crate::mdrive::motion::Circuit;
use crate::mdrive::registers::Reg;
use crate::mdrive::variables::{Registers, frequency};
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

impl Rotor {
    /// Returns true if torque mode is on, also while something stops the rotor.
    pub(super) fn has_torque(self) -> bool {
        matches!(self, Self::Spins { .. })
    }

    /// Returns true if the rotor turns without a commanded motion.
    pub(super) fn turns(self) -> bool {
        matches!(self, Self::Spins { is_stopped: false, .. } | Self::Slows(_))
    }
}

impl Hybrid {
    /// Handles a possible release of the shaft from a blocking or its load: the circuitry continues to drive
    /// it from its present position.
    pub(in crate::mdrive) fn follow_rotor(&mut self, env: &mut Environment<'_>) {
        if !self.watches_rotor(env.registers) {
            return;
        }
        env.motion.resynchronise_rotor(env.at, env.out);
        if let Rotor::Spins { spin, .. } = self.rotor {
            self.spin(env, spin);
        }
    }

    /// Checks the rotor, and reacts if it is off its position: makes up for the lag, reports it, or locks the
    /// rotor.
    pub(super) fn watch_rotor(&mut self, env: &mut Environment<'_>) {
        self.rotor_due = Instant::NEVER;
        if self.rotor != Rotor::Free && !env.motion.activity().is_circuit_driven() {
            // A motion command has ended the control.
            self.rotor = Rotor::Free;
        }
        self.watch_torque(env);
        if !self.watches_rotor(env.registers) {
            self.at_bounds = None;
            if self.rotor == Rotor::MakesUp {
                self.leave_rotor(env);
            }
            return;
        }
        self.make_up(env);
        self.watch_lag(env);
        self.watch_bounds(env);
    }

    /// Begins torque mode when all motion has ended, updates it when values change, or ends it.
    fn watch_torque(&mut self, env: &mut Environment<'_>) {
        let is_wanted = self.watches_rotor(env.registers) && is_in_torque_mode(env.registers);
        let (torque, speed) = (env.registers.word(Reg::TQ), env.registers.word(Reg::TS));
        match self.rotor {
            Rotor::Spins { spin, is_stopped } if is_wanted => {
                // TD is read only when torque mode begins (MC 5-72).
                let now = Spin { torque, speed, ..spin };
                if now != spin {
                    self.spin(env, now);
                } else if !is_stopped && !env.motion.shaft().follows() {
                    self.spin_on(env, spin);
                } else if is_stopped
                    && env.motion.shaft().follows()
                    && env.motion.shaft().can_turn(spin.forward)
                {
                    // The load was too heavy, and has become lighter.
                    self.spin(env, spin);
                }
            }
            _ if is_wanted => {
                if env.motion.activity().is_rest() || env.motion.activity().is_circuit_driven() {
                    let forward = env.registers.word(Reg::TD) != 0;
                    self.spin(env, Spin { torque, speed, forward });
                }
            }
            Rotor::Spins { is_stopped: true, .. } => self.leave_rotor(env),
            Rotor::Spins { .. } | Rotor::Slows(_) => self.slow_down(env),
            Rotor::Free | Rotor::MakesUp => {}
        }
    }

    /// Accelerates the rotor, or slows it down, with torque TQ to the speed that TS allows.
    fn spin(&mut self, env: &mut Environment<'_>, spin: Spin) {
        let Spin { torque, speed, forward } = spin;
        let fastest = i64::from(in_steps(env.registers, PULL_OUT));
        let speed = i64::from(frequency(speed.into())).min(fastest);
        let turns = I24F8::saturating_from_num(if forward { speed } else { -speed });
        let acceleration = in_steps(env.registers, by_torque(torque));
        self.rotor = Rotor::Spins { spin, is_stopped: false };
        env.motion.begin_circuit(
            env.at,
            Circuit::Spin { speed: turns, acceleration },
            (torque & 0xFF) as u8,
            env.out,
        );
        if !env.motion.shaft().follows() {
            self.spin_on(env, spin);
        }
    }

    /// Handles a rotor if no torque is left to accelerate it. The rotor keeps its present speed, or stops.
    fn spin_on(&mut self, env: &mut Environment<'_>, spin: Spin) {
        let speed = env.motion.shaft().speed(env.at);
        if speed != 0 {
            let acceleration = in_steps(env.registers, coasts(env.registers));
            let percent = (spin.torque & 0xFF) as u8;
            env.motion.begin_circuit(env.at, Circuit::Spin { speed, acceleration }, percent, env.out);
            env.motion.resynchronise_rotor(env.at, env.out);
        }
        let is_stopped = speed == 0 || !env.motion.shaft().follows();
        if is_stopped {
            env.motion.stop_circuit(env.at, env.out);
        }
        self.rotor = Rotor::Spins { spin, is_stopped };
    }

    /// Slows the rotor to standstill. RC brakes it; without a bridge its friction does.
    fn slow_down(&mut self, env: &mut Environment<'_>) {
        let (run, coasts) = (env.registers.word(Reg::RC), coasts(env.registers));
        let by = if self.has_bridge(env.registers) { by_torque(run) } else { coasts };
        let now = Rotor::Slows(by);
        let percent = (run & 0xFF) as u8;
        if core::mem::replace(&mut self.rotor, now) != now {
            let deceleration = in_steps(env.registers, by);
            env.motion.begin_circuit(env.at, Circuit::Slow { deceleration }, percent, env.out);
        }
        if !env.motion.shaft().follows() {
            // The current RC is not enough for this deceleration.
            let deceleration = in_steps(env.registers, coasts);
            env.motion.begin_circuit(env.at, Circuit::Slow { deceleration }, percent, env.out);
            env.motion.resynchronise_rotor(env.at, env.out);
        }
        let ends = env.motion.shaft().plan().end();
        if ends <= env.at || !env.motion.shaft().follows() {
            self.leave_rotor(env);
        } else {
            self.rotor_due = ends;
        }
    }

    /// Ends the control of the rotor at its present position, where it neither lags nor leads.
    fn leave_rotor(&mut self, env: &mut Environment<'_>) {
        env.motion.end_circuit(env.at, env.out);
        env.motion.shaft_mut().clear_lag(env.at);
        self.rotor = Rotor::Free;
    }

    /// Makes up for the rotor's lag after a motion if MU is not 0, at the speed of MF or SS.
    fn make_up(&mut self, env: &mut Environment<'_>) {
        if self.rotor == Rotor::MakesUp {
            let ends = env.motion.shaft().plan().end();
            if ends > env.at {
                self.rotor_due = ends;
                return;
            }
            env.motion.end_circuit(env.at, env.out);
            self.rotor = Rotor::Free;
        }
        let system = frequency(env.registers.word(Reg::SS).into());
        let frequency = match env.registers.word(Reg::MU) {
            1 => i32::try_from(env.registers.get(Reg::MF)).unwrap_or(i32::MAX).min(system),
            2 => system,
            _ => return,
        };
        let lag = self.lag(env.at, env.registers, env.motion);
        if lag == 0 || !env.motion.activity().is_rest() || !env.motion.shaft().stands() {
            return;
        }
        let percent = (env.registers.word(Reg::RC) & 0xFF) as u8;
        let rates = evenly(U24F8::saturating_from_num(frequency));
        env.motion.begin_circuit(env.at, Circuit::Turn { steps: lag, rates }, percent, env.out);
        self.rotor = Rotor::MakesUp;
        self.rotor_due = env.motion.shaft().plan().end();
        self.events.push(Event::Reached(Condition::Active));
    }

    /// Reports a lag beyond LG or a lead beyond LD (MC 5-41).
    fn watch_lag(&mut self, env: &mut Environment<'_>) {
        let limit = |reg| i32::try_from(env.registers.get(reg)).unwrap_or(i32::MAX);
        let (most, least) = (limit(Reg::LG), -limit(Reg::LD));
        let lag = self.lag(env.at, env.registers, env.motion);
        let now = if lag > 0 && lag >= most {
            Some(Limit::Lag)
        } else if lag < 0 && lag <= least {
            Some(Limit::Lead)
        } else {
            None
        };
        let before = core::mem::replace(&mut self.limit, now);
        match now.filter(|_| now != before) {
            Some(Limit::Lag) => self.events.push(Event::Limit(Error::LagLimit, Condition::Lag)),
            Some(Limit::Lead) => self.events.push(Event::Limit(Error::LeadLimit, Condition::Lead)),
            None => {}
        }
        if now != Some(Limit::Lag) {
            self.predict_lag(env, most);
        }
        if now != Some(Limit::Lead) {
            self.predict_lag(env, least);
        }
    }

    /// Locks a rotor that has stayed at the bounds of CB for the time LT (MC 5-44). In torque mode a rotor
    /// that does not turn counts as at the bounds.
    fn watch_bounds(&mut self, env: &mut Environment<'_>) {
        // CB 0 to 3 are 11, 13, 15 and 17 tenths of a full step.
        let tenths = 11 + 2 * i32::from(env.registers.word(Reg::CB));
        let bounds = i32::from(env.registers.word(Reg::MS)) * tenths / 10;
        let stands = !env.motion.shaft().follows();
        let is_at_bounds = match self.rotor {
            Rotor::Spins { is_stopped, .. } => is_stopped,
            _ => {
                stands && self.lag(env.at, env.registers, env.motion).unsigned_abs() >= bounds.unsigned_abs()
            }
        };
        if !is_at_bounds {
            self.at_bounds = None;
            if is_in_torque_mode(env.registers) && !self.causes.has(LOCKED_ROTOR) {
                self.is_locked = false;
            }
            if stands {
                self.predict_lag(env, bounds);
                self.predict_lag(env, -bounds);
            }
            return;
        }
        let begins = self.at_bounds.is_none();
        let since = *self.at_bounds.get_or_insert(env.at);
        if begins {
            self.events.push(Event::Reached(Condition::Active));
        }
        let timeout = Duration::millis(u64::try_from(env.registers.get(Reg::LT)).unwrap_or(0));
        if self.is_locked {
            return;
        }
        if since + timeout <= env.at {
            self.lock(env);
        } else {
            self.rotor_due = self.rotor_due.min(since + timeout);
        }
    }

    /// Schedules a check for the time at which the rotor may reach this lag.
    fn predict_lag(&mut self, env: &Environment<'_>, lag: i32) {
        if !env.motion.activity().is_circuit_driven() {
            self.rotor_due = self.rotor_due.min(env.motion.shaft().lag_time(env.at, lag));
        }
    }

    /// Marks the rotor as locked. Except in torque mode, this switches the bridge off and ends the motion
    /// like a stall (MDRIVE-30).
    pub(super) fn lock(&mut self, env: &mut Environment<'_>) {
        self.is_locked = true;
        if is_in_torque_mode(env.registers) {
            return self.events.push(Event::Reached(Condition::Locked));
        }
        (self.is_disabled, self.at_bounds) = (true, None);
        env.motion.halt(env.at, env.out);
        env.disable_bridge(true);
        self.events.push(Event::Limit(Error::LockedRotor, Condition::Locked));
    }
}

/// Deceleration of the rotor by friction, in full steps/s².
fn coasts(registers: &Registers) -> u32 {
    /// Acceleration by 1 µN·m at 1 g·cm², in full steps/s²: 10 rad/s², with 200 full steps in a
    /// revolution.
    const EACH: u64 = 318;
    let long = |reg| u64::try_from(registers.get(reg)).unwrap_or(0);
    let by = (long(Reg::Friction) * 1_000 * EACH).checked_div(long(Reg::Inertia)).unwrap_or(0);
    u32::try_from(by.max(LEAST_DECELERATION)).unwrap_or(u32::MAX)
}

/// Converts an acceleration or a speed from full steps to steps.
fn in_steps(registers: &Registers, full_steps: u32) -> u32 {
    let steps_per_rev = u64::from(registers.word(Reg::MS)) * u64::from(registers.word(Reg::FullSteps));
    let steps = u64::from(full_steps).saturating_mul(steps_per_rev) / u64::from(STEPS_PER_REV);
    u32::try_from(steps).unwrap_or(u32::MAX).min(MAX_ACCELERATION)
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
