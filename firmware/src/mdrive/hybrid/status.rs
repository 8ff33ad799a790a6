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

/// Limit that the rotor has reached.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Limit {
    /// LG, the limit of the lag.
    Lag,
    /// LD, the limit of the lead.
    Lead,
}

impl Hybrid {
    /// LR: true if the rotor is locked.
    pub(in crate::mdrive) fn is_locked(&self) -> bool {
        self.is_locked
    }

    pub(in crate::mdrive) fn is_making_up(&self) -> bool {
        self.rotor == Rotor::MakesUp
    }

    /// IT: internal temperature, in °C.
    pub(in crate::mdrive) fn temperature(&self, at: Instant) -> i32 {
        i32::try_from(self.heat.celsius(at)).unwrap_or(0)
    }
}

impl Drive {
    /// AF, the status as bits.
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

    /// Returns true if the circuitry corrects the rotor at present.
    pub(in crate::mdrive) fn corrects_rotor(&self) -> bool {
        self.hybrid.at_bounds.is_some() || self.hybrid.rotor != Rotor::Free || self.motion.is_too_fast()
    }

    /// LL, the lag in steps. It is 0 in torque mode and until the rotor is at rest after it, during a
    /// calibration, and while the circuitry is off.
    pub(in crate::mdrive) fn lag(&self, at: Instant) -> i32 {
        let is_bound = self.watches_rotor() && !self.is_in_torque_mode() && !self.hybrid.turns();
        if is_bound { self.motion.lag(at) } else { 0 }
    }

    /// Clears the lag. MCode does this if the second value of MU is 1, as in `MU=2,1`.
    pub(in crate::mdrive) fn clear_lag(&mut self, at: Instant) {
        self.motion.clear_lag(at);
    }

    /// Reports a lag beyond LG or a lead beyond LD (MC 5-41).
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

    /// Reports an error of the rotor and triggers its trip.
    pub(super) fn report(&mut self, at: Instant, error: Error, condition: u8, out: &mut dyn Context) {
        // If TA is enabled for this condition, the trip replaces the error: "There is no error generation
        // when enabling trip" (MC 5-71).
        if !self.trips_on_status(condition) {
            self.fail(at, error, out);
        }
        self.trip_on_status(at, condition, out);
    }
}
