//! Status of the circuitry: AF, LL, LR, IT, the bridge (MC 5-2, 5-41, 5-42).

use super::calibration::Calibration;
use super::rotor::Rotor;
use super::{Hybrid, LAG_LIMIT, LEAD_LIMIT, OFF, is_in_torque_mode};
use crate::device::Instant;
use crate::mdrive::motion::Motion;
use crate::mdrive::reasons::Why;
use crate::mdrive::registers::Reg;
use crate::mdrive::variables::Registers;

// Bits of AF (MC 5-2).
const LEAD: u16 = 1;
const LAG: u16 = 2;
const LOCKED: u16 = 8;
const ACTIVE: u16 = 16;
const HARDWARE: u16 = 32;
const AT_ZERO: u16 = 64;
const CALIBRATED: u16 = 128;
const FAILED: u16 = 256;

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

    /// Returns true if torque mode is on, also while something stops the rotor.
    pub(in crate::mdrive) fn has_torque(&self) -> bool {
        self.rotor.has_torque()
    }

    /// Returns true if the rotor turns without a commanded motion.
    pub(in crate::mdrive) fn turns(&self) -> bool {
        self.rotor.turns()
    }

    pub(in crate::mdrive) fn is_making_up(&self) -> bool {
        self.rotor == Rotor::MakesUp
    }

    /// IT: internal temperature, in °C.
    pub(in crate::mdrive) fn temperature(&self, at: Instant) -> i32 {
        i32::try_from(self.heat.celsius(at)).unwrap_or(0)
    }

    /// AF, the status as bits.
    pub(in crate::mdrive) fn status(&self, at: Instant, registers: &Registers, motion: &Motion) -> u16 {
        let Self { limit, causes, rotor, calibration, is_locked, is_overheated, .. } = *self;
        let at_zero =
            self.watches_rotor(registers) && rotor == Rotor::Free && self.lag(at, registers, motion) == 0;
        [
            (limit == Some(Limit::Lead) || causes.has(LEAD_LIMIT), LEAD),
            (limit == Some(Limit::Lag) || causes.has(LAG_LIMIT), LAG),
            (is_locked, LOCKED),
            (self.corrects_rotor(motion), ACTIVE),
            (is_overheated, HARDWARE),
            (at_zero, AT_ZERO),
            (calibration.is_over(), CALIBRATED),
            (calibration == Calibration::Failed, FAILED),
        ]
        .into_iter()
        .filter(|&(is_so, _)| is_so)
        .fold(0, |bits, (_, bit)| bits | bit)
    }

    /// Returns true if the circuitry corrects the rotor at present.
    pub(in crate::mdrive) fn corrects_rotor(&self, motion: &Motion) -> bool {
        self.at_bounds.is_some() || self.rotor != Rotor::Free || motion.shaft().is_too_fast()
    }

    /// LL, the lag in steps. It is 0 in torque mode and until the rotor is at rest after it, during a
    /// calibration, and while the circuitry is off.
    pub(in crate::mdrive) fn lag(&self, at: Instant, registers: &Registers, motion: &Motion) -> i32 {
        let is_bound = self.watches_rotor(registers) && !is_in_torque_mode(registers) && !self.rotor.turns();
        if is_bound { motion.shaft().lag(at) } else { 0 }
    }

    /// Returns true if the circuitry controls the rotor.
    pub(super) fn watches_rotor(&self, registers: &Registers) -> bool {
        let is_on = registers.word(Reg::AS) != OFF && self.has_bridge(registers);
        is_on && self.calibration.is_over()
    }

    /// Checks that the bridge is on: DE is 1, and the circuitry has not switched it off.
    ///
    /// # Errors
    /// The bridge is off.
    pub(in crate::mdrive) fn needs_bridge(&self, registers: &Registers) -> Result<(), Why> {
        match self {
            _ if registers.word(Reg::DE) == 0 => Err(Why::NoBridge),
            Self { is_disabled: false, .. } => Ok(()),
            Self { is_overheated: true, .. } => Err(Why::TooHot),
            _ => Err(Why::RotorLocked),
        }
    }

    /// Returns true if the bridge is on.
    pub(in crate::mdrive) fn has_bridge(&self, registers: &Registers) -> bool {
        self.needs_bridge(registers).is_ok()
    }
}
