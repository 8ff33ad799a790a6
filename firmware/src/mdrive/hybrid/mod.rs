//! The Hybrid's circuitry: calibration, the rotor's lag and lead, make-up, torque mode, temperature (FB 5.1, MC 5-2 to
//! 5-10, 5-38, 5-41 to 5-50, 5-70 to 5-81).
//!
//! | file | what of it |
//! |---|---|
//! | `calibration` | brings rotor and stator together |
//! | `rotor` | what it does with the rotor: torque mode, make-up, bounds |
//! | `status` | what it tells: AF, LL, LR, trips |
//! | `heat` | its temperature |
//!
//! The rotor lags while its shaft is held (a fault) or its load is too heavy, or when it has fallen in elsewhere after
//! that. It does not creep on at the bounds then, but stands until the motion does or the load changes. Make-up steps
//! are not interleaved with those of a move, but made behind it (MDRIVE-27).

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
use super::registers::Reg;
use super::{LAG_LIMIT, LEAD_LIMIT, LOCKED_ROTOR, OVER_TEMPERATURE};
use crate::device::{Context, Fault, Instant};

/// Text printed where WT is exceeded; MC 5-81 does not give the text (MDRIVE-31).
const WARNING: &[u8] = b"Error 71\r\n";

/// Values of AS.
mod mode {
    pub(super) const OFF: u16 = 0;
    pub(super) const TORQUE: u16 = 3;
}

/// Frequency that SS and TS divide (FB 5.1; MDRIVE-23), in Hz.
const OSCILLATOR: i32 = 10_000_000;

/// The speed of SS and TS, 0 to 255, in steps/s.
pub(super) fn frequency(n: i32) -> i32 {
    OSCILLATOR.checked_div(n.saturating_add(2)).unwrap_or(0)
}

/// SS or TS for a speed in steps/s, the fastest that is not slower.
pub(super) fn divider(frequency: i32) -> i32 {
    OSCILLATOR.checked_div(frequency).unwrap_or(0) - 2
}

/// Faults that are there, a bit each.
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

/// State of the Hybrid's circuitry. An MDrivePlus² has none of it but a bridge that heat can switch off.
#[derive(Clone, Debug)]
pub(super) struct Hybrid {
    calibration: Calibration,
    rotor: Rotor,
    /// Since when the rotor, which does not move, has been at its bounds.
    at_bounds: Option<Instant>,
    /// Time at which the rotor comes to a state that counts, or has been locked for long enough.
    rotor_due: Instant,
    /// LG or LD to which it has come.
    limit: Option<Limit>,
    /// LR.
    is_locked: bool,
    /// The bridge is off, whatever the value of DE.
    is_disabled: bool,
    heat: Heat,
    heat_due: Instant,
    has_warned: bool,
    is_overheated: bool,
    /// Instant at which C1 comes to an end of its range.
    position_due: Instant,
    causes: Causes,
}

impl Hybrid {
    /// Without power.
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

    /// Power comes, or a restart: that leaves what causes faults, and its temperature. `whole`: that will be told anew.
    pub(super) fn restart(&mut self, whole: bool) {
        let Self { heat, causes, .. } = *self;
        *self = if whole { Self::NONE } else { Self { heat, causes, ..Self::NONE } };
    }

    /// Returns whether the bridge is off, whatever DE is.
    pub(super) fn is_disabled(&self) -> bool {
        self.is_disabled
    }

    pub(super) fn deadline(&self) -> Instant {
        self.calibration.due().min(self.rotor_due).min(self.heat_due).min(self.position_due)
    }

    /// DE of an MDrivePlus² is written: the bridge is back once its electronics are cool.
    pub(super) fn enable(&mut self) {
        self.is_overheated = self.causes.has(OVER_TEMPERATURE);
        self.is_disabled = self.is_overheated;
    }
}

impl Drive {
    /// The cause of one of its faults comes or goes.
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

    /// A calibration goes on. Rotor and temperature are looked at after everything that happens.
    pub(super) fn hybrid_timeout(&mut self, at: Instant, out: &mut dyn Context) {
        if self.hybrid.calibration.due() <= at {
            self.calibrate_on(at, out);
        }
    }

    /// Looks at rotor and temperature, after everything that happens.
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

    /// The motion has another plan, or C1 has come to an end of its range, beyond which it goes on at the other one:
    /// error 105 of a Hybrid.
    pub(super) fn watch_position(&mut self, at: Instant, out: &mut dyn Context) {
        if self.model != Model::Hybrid {
            return;
        }
        if self.hybrid.position_due <= at {
            self.fail(at, Error::MaximumPosition, out);
        }
        let steps = self.motion.steps(at);
        // From one end to the other it is a single step.
        let ends = [i32::MIN, i32::MAX].into_iter().filter(|&end| end != !steps);
        let dues = ends.map(|end| self.motion.reaches_steps(at, end)).filter(|&due| due > at);
        self.hybrid.position_due = dues.min().unwrap_or(Instant::NEVER);
    }

    /// The electronics are too hot: the bridge is off.
    fn overheat(&mut self, at: Instant, error: Error, out: &mut dyn Context) {
        if !self.hybrid.is_overheated {
            (self.hybrid.is_overheated, self.hybrid.is_disabled) = (true, true);
            self.set_motion(at, out);
            self.fail(at, error, out);
        }
    }

    /// Returns whether there is current, but for what the circuitry has switched off.
    pub(super) fn has_bridge(&self) -> bool {
        self.bank.word(Reg::DE) != 0 && !self.hybrid.is_disabled
    }

    /// Returns whether the circuitry controls the rotor.
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
