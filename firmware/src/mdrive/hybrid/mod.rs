//! The Hybrid's circuitry: calibration, the rotor's lag and lead, make-up, torque mode, temperature (FB 5.1,
//! MC 5-2 to 5-10, 5-38, 5-41 to 5-50, 5-70 to 5-81).
//!
//! | file | content |
//! |---|---|
//! | `calibration` | aligns rotor and stator |
//! | `rotor` | control of the rotor: torque mode, make-up, limits, bounds |
//! | `status` | status: AF, LL, LR, bridge |
//! | `heat` | temperature of the electronics |
//!
//! The rotor lags while its shaft is blocked (a fault) or its load is too heavy, and also afterwards if it is
//! in step again at another position. At the bounds it does not creep on. It stops until the motion stops or
//! the load changes. Make-up steps are not interleaved with the steps of a move, but made after the move
//! (MDRIVE-27).

mod calibration;
mod heat;
mod rotor;
mod status;

use self::calibration::Calibration;
use self::heat::{Heat, SHUTDOWN};
use self::rotor::Rotor;
use self::status::Limit;
use super::error::Error;
use super::io::Io;
use super::motion::Motion;
use super::registers::{Model, Reg};
use super::variables::Registers;
use super::{LAG_LIMIT, LEAD_LIMIT, LOCKED_ROTOR, OVER_TEMPERATURE};
use crate::device::{Context, Fault, Instant};
use heapless::Deque;

/// Text printed when WT is exceeded; MC 5-81 does not give the text (MDRIVE-31).
pub(super) const WARNING: &[u8] = b"Error 71\r\n";

/// Values of AS: the circuitry is off; torque mode.
const OFF: u16 = 0;
const TORQUE: u16 = 3;

/// Present faults, one bit each.
#[derive(Clone, Copy, Debug)]
struct Causes(u8);

impl Causes {
    const NONE: Self = Self(0);

    fn has(self, Fault(n): Fault) -> bool {
        self.0 & 1 << (n & 7) != 0
    }

    /// Sets or clears a fault.
    fn set(&mut self, Fault(n): Fault, on: bool) {
        let bit = 1 << (n & 7);
        self.0 = if on { self.0 | bit } else { self.0 & !bit };
    }
}

/// Conditions of TA (MC 5-71).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[repr(u8)]
pub(super) enum Condition {
    Calibrated = 1,
    Active = 2,
    Locked = 4,
    Lag = 8,
    Lead = 16,
}

/// Event of the circuitry for the rest of the drive.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Event {
    /// An error.
    Failed(Error),
    CalibrationFailed,
    /// The temperature has exceeded WT.
    IsWarm,
    /// A condition of TA has become true.
    Reached(Condition),
    /// A condition of TA has become true. Unless TA trips on it, it is this error.
    Limit(Error, Condition),
}

/// Events that the drive has not handled yet.
#[derive(Clone, Debug)]
struct Events(Deque<Event, 8>);

impl Events {
    fn push(&mut self, event: Event) {
        let queued = self.0.push_back(event);
        debug_assert!(queued.is_ok(), "the drive takes events after each run of the circuitry");
    }
}

/// The rest of the drive as the circuitry sees it, at one instant.
pub(super) struct Environment<'a> {
    pub(super) at: Instant,
    pub(super) registers: &'a mut Registers,
    pub(super) io: &'a Io,
    pub(super) motion: &'a mut Motion,
    pub(super) out: &'a mut dyn Context,
}

impl Environment<'_> {
    /// Switches the bridge off, or on if DE is 1.
    fn disable_bridge(&mut self, is_disabled: bool) {
        set_motion(self.at, self.registers, self.io, is_disabled, self.motion, self.out);
    }
}

/// State of the Hybrid's circuitry. An MDrivePlus² uses only the bridge that heat can switch off.
#[derive(Clone, Debug)]
pub(super) struct Hybrid {
    calibration: Calibration,
    rotor: Rotor,
    /// Time since which the rotor has been at its bounds without moving.
    at_bounds: Option<Instant>,
    /// Time of the next check of the rotor: its lag reaches a limit, or it has been at its bounds for LT.
    rotor_due: Instant,
    /// Limit LG or LD that the rotor has reached.
    limit: Option<Limit>,
    /// LR: the rotor is locked.
    is_locked: bool,
    /// The bridge is switched off, whatever the value of DE.
    is_disabled: bool,
    heat: Heat,
    heat_due: Instant,
    has_warned: bool,
    is_overheated: bool,
    /// Time at which C1 reaches an end of its range.
    position_due: Instant,
    causes: Causes,
    events: Events,
}

impl Hybrid {
    /// State without power.
    pub(super) const NONE: Self = Self {
        calibration: Calibration::Not,
        rotor: Rotor::Free,
        at_bounds: None,
        rotor_due: Instant::NEVER,
        limit: None,
        is_locked: false,
        is_disabled: false,
        heat: Heat::COOL,
        heat_due: Instant::NEVER,
        has_warned: false,
        is_overheated: false,
        position_due: Instant::NEVER,
        causes: Causes::NONE,
        events: Events(Deque::new()),
    };

    /// Resets the state at power-on (`whole`) or a restart. A restart keeps the temperature and the causes of
    /// faults; at power-on the causes are reported again.
    pub(super) fn restart(&mut self, whole: bool) {
        let Self { heat, causes, .. } = *self;
        *self = if whole { Self::NONE } else { Self { heat, causes, ..Self::NONE } };
    }

    /// Returns true if the bridge is switched off, whatever the value of DE.
    pub(super) fn is_disabled(&self) -> bool {
        self.is_disabled
    }

    pub(super) fn deadline(&self) -> Instant {
        self.calibration.due().min(self.rotor_due).min(self.heat_due).min(self.position_due)
    }

    /// Handles a write of DE on an MDrivePlus²: the bridge is on again if the electronics are cool.
    pub(super) fn enable(&mut self) {
        self.is_overheated = self.causes.has(OVER_TEMPERATURE);
        self.is_disabled = self.is_overheated;
    }

    /// Takes the oldest event, if any.
    pub(super) fn next_event(&mut self) -> Option<Event> {
        self.events.0.pop_front()
    }

    /// Sets or clears the cause of a fault.
    pub(super) fn set_fault(&mut self, env: &mut Environment<'_>, fault: Fault, on: bool) {
        let comes = on && !self.causes.has(fault);
        self.causes.set(fault, on);
        match fault {
            LEAD_LIMIT if comes => self.events.push(Event::Limit(Error::LeadLimit, Condition::Lead)),
            LAG_LIMIT if comes => self.events.push(Event::Limit(Error::LagLimit, Condition::Lag)),
            LOCKED_ROTOR if on && self.watches_rotor(env.registers) => self.lock(env),
            LOCKED_ROTOR if is_in_torque_mode(env.registers) => self.is_locked = false,
            OVER_TEMPERATURE if env.registers.model() == Model::Hybrid => self.heat.set(env.at, on),
            _ => {}
        }
    }

    /// Begins the next stage of a calibration if it is due. Rotor and temperature need no handling here,
    /// because they are checked after every event.
    pub(super) fn timeout(&mut self, env: &mut Environment<'_>) {
        if self.calibration.due() <= env.at {
            self.calibrate_on(env);
        }
    }

    /// Predicts when C1 reaches an end of its range, after a change of the plan or at that time. There C1
    /// wraps to the other end, and a Hybrid reports error 105.
    pub(super) fn watch_position(&mut self, env: &mut Environment<'_>) {
        if env.registers.model() == Model::Plus {
            return;
        }
        let (at, motion) = (env.at, &*env.motion);
        if self.position_due <= at {
            self.events.push(Event::Failed(Error::MaximumPosition));
        }
        let steps = motion.shaft().steps(at);
        // The step from one end of the range to the other does not count as reaching it.
        let ends = [i32::MIN, i32::MAX].into_iter().filter(|&end| end != !steps);
        let dues = ends.map(|end| motion.shaft().reaches_steps(at, end)).filter(|&due| due > at);
        self.position_due = dues.min().unwrap_or(Instant::NEVER);
    }

    /// Checks the rotor of a Hybrid, and warns above WT.
    pub(super) fn watch(&mut self, env: &mut Environment<'_>) {
        if env.registers.model() == Model::Plus {
            return;
        }
        self.watch_rotor(env);
        let is_warm = self.heat.celsius(env.at) >= warning(env.registers);
        if is_warm && !self.has_warned {
            self.events.push(Event::IsWarm);
        }
        self.has_warned = is_warm;
    }

    /// Switches the bridge off at [`SHUTDOWN`]. An MDrivePlus² does so as soon as its electronics heat up.
    pub(super) fn watch_heat(&mut self, env: &mut Environment<'_>) {
        if env.registers.model() == Model::Plus {
            if self.causes.has(OVER_TEMPERATURE) {
                self.overheat(env, Error::LinearOverTemperature);
            }
            return;
        }
        if self.heat.celsius(env.at) >= SHUTDOWN {
            self.overheat(env, Error::OverTemperature);
            self.watch_rotor(env);
        }
        let dues = [warning(env.registers), SHUTDOWN].map(|celsius| self.heat.passes(celsius));
        self.heat_due = dues.into_iter().filter(|&due| due > env.at).min().unwrap_or(Instant::NEVER);
    }

    /// Switches the bridge off, because the electronics are too hot.
    fn overheat(&mut self, env: &mut Environment<'_>, error: Error) {
        if !self.is_overheated {
            (self.is_overheated, self.is_disabled) = (true, true);
            env.disable_bridge(true);
            self.events.push(Event::Failed(error));
        }
    }
}

/// Returns true if AS selects torque mode.
pub(super) fn is_in_torque_mode(registers: &Registers) -> bool {
    registers.word(Reg::AS) == TORQUE
}

/// Temperature of the warning, in °C: above WT.
fn warning(registers: &Registers) -> i64 {
    i64::from(registers.word(Reg::WT)) + 1
}

/// Passes the settings to motion. The bridge is on if DE is 1, unless the circuitry has switched it off
/// (`is_disabled`).
pub(super) fn set_motion(
    at: Instant,
    registers: &mut Registers,
    io: &Io,
    is_disabled: bool,
    motion: &mut Motion,
    out: &mut dyn Context,
) {
    let settings = io.motion_settings(registers).switched_off(is_disabled);
    if motion.set(at, settings, out) {
        // "Make up mode will be cleared when bridges are disabled and Hybrid is enabled" (MC 5-50).
        registers.set(Reg::MU, 0);
    }
}
