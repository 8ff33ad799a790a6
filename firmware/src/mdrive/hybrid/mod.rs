//! The Hybrid's circuitry: calibration, the rotor's lag and lead, make-up, torque mode, temperature (FB 5.1,
//! MC 5-2 to 5-10, 5-38, 5-41 to 5-50, 5-70 to 5-81).
//!
//! | file | content |
//! |---|---|
//! | `calibration` | aligns rotor and stator |
//! | `rotor` | control of the rotor: torque mode, make-up, bounds |
//! | `status` | status: AF, LL, LR, trips |
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
use self::status::{Limit, condition};
use super::drive::{Drive, Model};
use super::error::Error;
use super::reasons::Why;
use super::registers::Reg;
use super::{LAG_LIMIT, LEAD_LIMIT, LOCKED_ROTOR, OVER_TEMPERATURE};
use crate::device::{Context, Fault, Instant};

/// Text printed when WT is exceeded; MC 5-81 does not give the text (MDRIVE-31).
const WARNING: &[u8] = b"Error 71\r\n";

/// Values of AS.
mod mode {
    pub(super) const OFF: u16 = 0;
    pub(super) const TORQUE: u16 = 3;
}

/// Frequency that SS and TS divide (FB 5.1; MDRIVE-23), in Hz.
const OSCILLATOR: i32 = 10_000_000;

/// Speed for a value 0 to 255 of SS or TS, in steps/s.
pub(super) fn frequency(n: i32) -> i32 {
    OSCILLATOR.checked_div(n.saturating_add(2)).unwrap_or(0)
}

/// Value of SS or TS for a speed in steps/s. Its speed is not below the given one.
pub(super) fn divider(frequency: i32) -> i32 {
    OSCILLATOR.checked_div(frequency).unwrap_or(0) - 2
}

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
}

impl Drive {
    /// Sets or clears the cause of a fault.
    pub(super) fn set_hybrid_fault(&mut self, at: Instant, fault: Fault, on: bool, out: &mut dyn Context) {
        let comes = on && !self.hybrid.causes.has(fault);
        self.hybrid.causes.set(fault, on);
        match fault {
            LEAD_LIMIT if comes => self.report(at, Error::LeadLimit, condition::LEAD, out),
            LAG_LIMIT if comes => self.report(at, Error::LagLimit, condition::LAG, out),
            LOCKED_ROTOR if on && self.watches_rotor() => self.lock(at, out),
            LOCKED_ROTOR if self.is_in_torque_mode() => self.hybrid.is_locked = false,
            OVER_TEMPERATURE if self.model == Model::Hybrid => self.hybrid.heat.set(at, on),
            _ => {}
        }
    }

    /// Begins the next stage of a calibration if it is due. Rotor and temperature need no handling here,
    /// because `update_hybrid` checks them after every event.
    pub(super) fn hybrid_timeout(&mut self, at: Instant, out: &mut dyn Context) {
        if self.hybrid.calibration.due() <= at {
            self.calibrate_on(at, out);
        }
    }

    /// Checks rotor and temperature. This runs after every event.
    pub(super) fn update_hybrid(&mut self, at: Instant, out: &mut dyn Context) {
        match self.model {
            _ if !self.is_started() => {}
            Model::Hybrid => {
                self.watch_rotor(at, out);
                self.watch_heat(at, out);
            }
            Model::Plus if self.hybrid.causes.has(OVER_TEMPERATURE) => {
                self.overheat(at, Error::LinearOverTemperature, out);
            }
            Model::Plus => {}
        }
    }

    /// Predicts when C1 reaches an end of its range, after a change of the plan or at that time. There C1
    /// wraps to the other end, and a Hybrid reports error 105.
    pub(super) fn watch_position(&mut self, at: Instant, out: &mut dyn Context) {
        if self.model != Model::Hybrid {
            return;
        }
        if self.hybrid.position_due <= at {
            self.fail(at, Error::MaximumPosition, out);
        }
        let steps = self.motion.steps(at);
        // The step from one end of the range to the other does not count as reaching it.
        let ends = [i32::MIN, i32::MAX].into_iter().filter(|&end| end != !steps);
        let dues = ends.map(|end| self.motion.reaches_steps(at, end)).filter(|&due| due > at);
        self.hybrid.position_due = dues.min().unwrap_or(Instant::NEVER);
    }

    /// Switches the bridge off, because the electronics are too hot.
    fn overheat(&mut self, at: Instant, error: Error, out: &mut dyn Context) {
        if !self.hybrid.is_overheated {
            (self.hybrid.is_overheated, self.hybrid.is_disabled) = (true, true);
            self.set_motion(at, out);
            self.fail(at, error, out);
        }
    }

    /// Checks that the bridge is on: DE is 1, and the circuitry has not switched it off.
    ///
    /// # Errors
    /// The bridge is off.
    pub(super) fn needs_bridge(&self) -> Result<(), Why> {
        match &self.hybrid {
            _ if self.bank.word(Reg::DE) == 0 => Err(Why::NoBridge),
            Hybrid { is_disabled: false, .. } => Ok(()),
            Hybrid { is_overheated: true, .. } => Err(Why::TooHot),
            _ => Err(Why::RotorLocked),
        }
    }

    /// Returns true if the bridge is on.
    pub(super) fn has_bridge(&self) -> bool {
        self.needs_bridge().is_ok()
    }

    /// Returns true if the circuitry controls the rotor.
    fn watches_rotor(&self) -> bool {
        let is_on = self.bank.word(Reg::AS) != mode::OFF && self.has_bridge();
        is_on && self.hybrid.calibration.is_over()
    }

    fn is_in_torque_mode(&self) -> bool {
        self.bank.word(Reg::AS) == mode::TORQUE
    }

    /// Warns above WT, and switches the bridge off at [`SHUTDOWN`].
    fn watch_heat(&mut self, at: Instant, out: &mut dyn Context) {
        let warning = i64::from(self.bank.word(Reg::WT)) + 1;
        let is_warm = self.hybrid.heat.celsius(at) >= warning;
        if is_warm && !self.hybrid.has_warned {
            // "The device will print an error 71 to the terminal screen" (MC 5-81).
            self.send_to_all(at, WARNING, out);
            self.fail(at, Error::TemperatureWarning, out);
        }
        self.hybrid.has_warned = is_warm;
        if self.hybrid.heat.celsius(at) >= SHUTDOWN {
            self.overheat(at, Error::OverTemperature, out);
            self.watch_rotor(at, out);
        }
        let dues = [warning, SHUTDOWN].map(|celsius| self.hybrid.heat.passes(celsius));
        self.hybrid.heat_due = dues.into_iter().filter(|&due| due > at).min().unwrap_or(Instant::NEVER);
    }
}
