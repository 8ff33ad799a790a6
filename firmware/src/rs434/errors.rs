//! The register ERROR: causes of its bits, bits that stop the motor, and the clearing of bits (6.5).

use core::ops::RangeInclusive;

use super::registers::SUPPLY;
use crate::device::Fault;

/// The bits of ERROR.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[repr(u16)]
pub(super) enum Error {
    SupplyVoltage = 1 << 0,
    ShortCircuit = 1 << 1,
    BrakeOverheat = 1 << 2,
    PowerOverheat = 1 << 3,
    Hall = 1 << 4,
    EmergencyStop = 1 << 5,
    McuOverheat = 1 << 6,
    ProgramTest = 1 << 7,
    Program = 1 << 8,
    Settings = 1 << 9,
    Switches = 1 << 10,
    CurrentLimit = 1 << 11,
    Braking = 1 << 12,
    OutOfRange = 1 << 13,
    Parity = 1 << 14,
    TooFewHalls = 1 << 15,
}

/// Bits of errors that stop the motor.
const STOPS: u16 = Error::SupplyVoltage as u16
    | Error::ShortCircuit as u16
    | Error::BrakeOverheat as u16
    | Error::PowerOverheat as u16
    | Error::Hall as u16
    | Error::EmergencyStop as u16
    | Error::McuOverheat as u16
    | Error::Switches as u16;
/// Bits of errors that stay until a restart. All others are warnings, and a write can clear them (RS434-23).
const STAYS: u16 = STOPS | Error::ProgramTest as u16 | Error::Settings as u16;

/// The error that each fault of the drive causes, in the order of [`Spec::faults`](crate::device::Spec::faults)
/// (RS434-24).
const CAUSES: [Error; 8] = [
    Error::SupplyVoltage,
    Error::ShortCircuit,
    Error::BrakeOverheat,
    Error::PowerOverheat,
    Error::Hall,
    Error::McuOverheat,
    Error::Switches,
    Error::CurrentLimit,
];

/// Range of the supply voltage in which the drive works, in 0.1 V (section 3, power supply protection).
const GOOD_SUPPLY: RangeInclusive<u16> = 80..=300;

/// The register ERROR, and injected values that affect it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Errors {
    /// Value of ERROR.
    bits: u16,
    /// Bits whose cause is injected.
    causes: u16,
    /// Injected value of CURRENT_VALID, in mA.
    injected_ma: Option<u16>,
    /// Supply voltage that the drive measures, in 0.1 V.
    supply: u16,
}

impl Errors {
    pub(super) const NONE: Self = Self { bits: 0, causes: 0, injected_ma: None, supply: SUPPLY };

    /// Clears all bits at power-on or at a restart. Injected values remain.
    pub(super) fn restart(&mut self) {
        self.bits = 0;
    }

    /// Value of ERROR for a read.
    pub(super) fn bits(self) -> u16 {
        self.bits
    }

    /// Returns true if an error forbids motion.
    pub(super) fn stop(self) -> bool {
        self.bits & STOPS != 0
    }

    /// Sets bits. Returns true if one of them is new and stops the motor.
    pub(super) fn raise(&mut self, bits: u16) -> bool {
        let new = bits & !self.bits;
        self.bits |= new;
        new & STOPS != 0
    }

    /// Sets the bit of a warning, which does not stop the motor.
    pub(super) fn warn(&mut self, warning: Error) {
        self.bits |= warning as u16;
    }

    /// Clears the warnings that are 0 in a written `word`. Returns their bits, and true if an error that is 0 in `word`
    /// stays.
    pub(super) fn clear(&mut self, word: u16) -> (u16, bool) {
        let unwanted = self.bits & !word;
        let cleared = unwanted & !STAYS;
        self.bits &= !cleared;
        (cleared, unwanted & STAYS != 0)
    }

    /// Sets or clears the cause of a fault of the drive.
    pub(super) fn set_fault(&mut self, fault: Fault, on: bool) {
        if let Some(&error) = CAUSES.get(usize::from(fault.0)) {
            let bit = error as u16;
            self.causes = if on { self.causes | bit } else { self.causes & !bit };
        }
    }

    /// Returns true if the cause of [`Error::CurrentLimit`] is injected. It halves the limit, so that this fault has an
    /// effect though it does not stop the motor.
    pub(super) fn halves_limit(self) -> bool {
        self.causes & Error::CurrentLimit as u16 != 0
    }

    /// Injected value of CURRENT_VALID, in mA.
    pub(super) fn injected_ma(self) -> Option<u16> {
        self.injected_ma
    }

    /// Makes CURRENT_VALID read `ma` from now on.
    pub(super) fn inject_ma(&mut self, ma: u16) {
        self.injected_ma = Some(ma);
    }

    /// Supply voltage that the drive measures, in 0.1 V.
    pub(super) fn supply(self) -> u16 {
        self.supply
    }

    pub(super) fn set_supply(&mut self, supply: u16) {
        self.supply = supply;
    }

    /// Bits of the errors that injected values and the supply cause now. A current above `limit_ma` is beyond the limit,
    /// a current of `short_ma` is a short circuit.
    pub(super) fn caused(self, limit_ma: u16, short_ma: u32) -> u16 {
        let mut bits = self.causes;
        if !GOOD_SUPPLY.contains(&self.supply) {
            bits |= Error::SupplyVoltage as u16;
        }
        if let Some(ma) = self.injected_ma {
            if ma > limit_ma {
                bits |= Error::CurrentLimit as u16;
            }
            if u32::from(ma) >= short_ma {
                bits |= Error::ShortCircuit as u16;
            }
        }
        bits
    }
}
