//! Status of the circuitry: AF, LL, LR, IT, errors and trips (MC 5-2, 5-41, 5-42, 5-71).

use super::calibration::Calibration;
use super::rotor::Rotor;
use super::{Hybrid, LAG_LIMIT, LEAD_LIMIT};
use crate::device::{Context, Instant};
use crate::mdrive::drive::Drive;
use crate::mdrive::error::Error;
use crate::mdrive::registers::Reg;

/// Bits of AF (MC 5-2).
mod bit {
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
pub(super) mod condition {
    pub(in super::super) const CALIBRATED: u8 = 1;
    pub(in super::super) const ACTIVE: u8 = 2;
    pub(in super::super) const LOCKED: u8 = 4;
    pub(in super::super) const LAG: u8 = 8;
    pub(in super::super) const LEAD: u8 = 16;
}

/// A limit to which the rotor has come.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Limit {
    /// LG.
    Lag,
    /// LD.
    Lead,
}

impl Hybrid {
    /// LR.
    pub(in crate::mdrive) fn is_locked(&self) -> bool {
        self.is_locked
    }

    pub(in crate::mdrive) fn is_making_up(&self) -> bool {
        self.rotor == Rotor::MakesUp
    }

    /// IT.
    pub(in crate::mdrive) fn temperature(&self, at: Instant) -> i32 {
        i32::try_from(self.heat.celsius(at)).unwrap_or(0)
    }
}

impl Drive {
    /// AF.
    pub(in crate::mdrive) fn hybrid_status(&self, at: Instant) -> u16 {
        let Hybrid { limit, causes, rotor, calibration, is_locked, is_overheated, .. } = self.hybrid;
        let at_zero = self.watches_rotor() && rotor == Rotor::Free && self.lag(at) == 0;
        [
            (limit == Some(Limit::Lead) || causes.has(LEAD_LIMIT), bit::LEAD),
            (limit == Some(Limit::Lag) || causes.has(LAG_LIMIT), bit::LAG),
            (is_locked, bit::LOCKED),
            (self.corrects_rotor(), bit::ACTIVE),
            (is_overheated, bit::HARDWARE),
            (at_zero, bit::AT_ZERO),
            (calibration.is_over(), bit::CALIBRATED),
            (calibration == Calibration::Failed, bit::FAILED),
        ]
        .into_iter()
        .filter(|&(is_so, _)| is_so)
        .fold(0, |bits, (_, bit)| bits | bit)
    }

    /// Returns whether the circuitry corrects the rotor.
    pub(in crate::mdrive) fn corrects_rotor(&self) -> bool {
        self.hybrid.at_bounds.is_some() || self.hybrid.rotor != Rotor::Free || self.motion.is_too_fast()
    }

    /// LL, in steps. In torque mode and until the rotor stands after it, while it calibrates and while the circuitry is
    /// off there is none.
    pub(in crate::mdrive) fn lag(&self, at: Instant) -> i32 {
        let is_bound = self.watches_rotor() && !self.is_in_torque_mode() && !self.hybrid.turns();
        if is_bound { self.motion.lag(at) } else { 0 }
    }

    /// The second value of MU.
    pub(in crate::mdrive) fn clear_lag(&mut self, at: Instant) {
        self.motion.clear_lag(at);
    }

    /// LG and LD (MC 5-41).
    pub(super) fn watch_lag(&mut self, at: Instant, out: &mut dyn Context) {
        let limit = |reg| i32::try_from(self.bank.get(reg)).unwrap_or(i32::MAX);
        let (most, least) = (limit(Reg::LG), -limit(Reg::LD));
        let lag = self.lag(at);
        let now = if lag > 0 && lag >= most {
            Some(Limit::Lag)
        } else if lag < 0 && lag <= least {
            Some(Limit::Lead)
        } else {
            None
        };
        let before = core::mem::replace(&mut self.hybrid.limit, now);
        match now.filter(|_| now != before) {
            Some(Limit::Lag) => self.report(at, Error::LagLimit, condition::LAG, out),
            Some(Limit::Lead) => self.report(at, Error::LeadLimit, condition::LEAD, out),
            None => {}
        }
        if now != Some(Limit::Lag) {
            self.predict_lag(at, most);
        }
        if now != Some(Limit::Lead) {
            self.predict_lag(at, least);
        }
    }

    /// Reports an error of the rotor, which may trip.
    pub(super) fn report(&mut self, at: Instant, error: Error, condition: u8, out: &mut dyn Context) {
        // "There is no error generation when enabling trip" on these (MC 5-71): the trip takes its place.
        if !self.trips_on_status(condition) {
            self.fail(at, error, out);
        }
        self.trip_on_status(at, condition, out);
    }
}
