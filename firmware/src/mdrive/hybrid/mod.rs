//! The Hybrid's circuitry: calibration, the rotor's lag and lead, make-up, torque mode, temperature (FB 5.1, MC 5-2 to
//! 5-10, 5-38, 5-41 to 5-50, 5-70 to 5-81).
//!
//! The rotor lags while its shaft is held (a fault) or its load is too heavy, or when it has fallen in elsewhere after
//! that. It does not creep on at the bounds then, but stands until the motion does or the load changes. Make-up steps are not interleaved with those of a move, but made behind it.

mod calibration;
mod heat;
mod rotor;

use fixed::types::U24F8;

use self::calibration::Calibration;
use self::heat::{Heat, SHUTDOWN};
use super::drive::{Drive, Model};
use super::error::Error;
use super::registers::Reg;
use super::{CALIBRATION, LAG_LIMIT, LEAD_LIMIT, LOCKED_ROTOR, OVER_TEMPERATURE};
use crate::device::{Fault, Instant, Sink};
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

/// At once at that speed.
fn evenly(speed: U24F8) -> Rates {
    Rates { start: speed, speed, up: MAX_ACCELERATION, down: MAX_ACCELERATION }
}
