//! The register ERROR: causes of its bits, bits that stop the motor, and the clearing of bits (6.5).

use core::ops::RangeInclusive;

use super::drive::{Drive, State};
use super::reasons::Why;
use super::registers::{Reg, SUPPLY};
use super::thermal::Part;
use crate::device::{Context, Fault, Instant};

/// The bits of ERROR.
pub(super) mod error {
    pub(in crate::rs434) const SUPPLY_VOLTAGE: u16 = 1 << 0;
    pub(in crate::rs434) const SHORT_CIRCUIT: u16 = 1 << 1;
    pub(in crate::rs434) const BRAKE_OVERHEAT: u16 = 1 << 2;
    pub(in crate::rs434) const POWER_OVERHEAT: u16 = 1 << 3;
    pub(in crate::rs434) const HALL: u16 = 1 << 4;
    pub(in crate::rs434) const EMERGENCY_STOP: u16 = 1 << 5;
    pub(in crate::rs434) const MCU_OVERHEAT: u16 = 1 << 6;
    pub(in crate::rs434) const PROGRAM_TEST: u16 = 1 << 7;
    pub(in crate::rs434) const PROGRAM: u16 = 1 << 8;
    pub(in crate::rs434) const SETTINGS: u16 = 1 << 9;
    pub(in crate::rs434) const SWITCHES: u16 = 1 << 10;
    pub(in crate::rs434) const CURRENT_LIMIT: u16 = 1 << 11;
    pub(in crate::rs434) const BRAKING: u16 = 1 << 12;
    pub(in crate::rs434) const OUT_OF_RANGE: u16 = 1 << 13;
    pub(in crate::rs434) const PARITY: u16 = 1 << 14;
    pub(in crate::rs434) const TOO_FEW_HALLS: u16 = 1 << 15;

    /// Errors that stop the motor.
    pub(in crate::rs434) const STOPS: u16 = SUPPLY_VOLTAGE
        | SHORT_CIRCUIT
        | BRAKE_OVERHEAT
        | POWER_OVERHEAT
        | HALL
        | EMERGENCY_STOP
        | MCU_OVERHEAT
        | SWITCHES;
    /// Errors that stay until a restart. All others are warnings, and a write can clear them (RS434-23).
    pub(in crate::rs434) const STAYS: u16 = STOPS | PROGRAM_TEST | SETTINGS;
}

/// The bit that each fault of the drive sets, in the order of [`Spec::faults`](crate::device::Spec::faults)
/// (RS434-24).
const CAUSES: [u16; 8] = [
    error::SUPPLY_VOLTAGE,
    error::SHORT_CIRCUIT,
    error::BRAKE_OVERHEAT,
    error::POWER_OVERHEAT,
    error::HALL,
    error::MCU_OVERHEAT,
    error::SWITCHES,
    error::CURRENT_LIMIT,
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

    /// Value of ERROR for a read.
    pub(super) fn bits(self) -> u16 {
        self.bits
    }

    /// Returns true if an error forbids motion.
    pub(super) fn stop(self) -> bool {
        self.bits & error::STOPS != 0
    }

    /// Returns true if the cause of `bit` is injected.
    pub(super) fn has_cause(self, bit: u16) -> bool {
        self.causes & bit != 0
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

    /// Sets bits of warnings, which do not stop the motor.
    pub(super) fn warn(&mut self, bits: u16) {
        self.bits |= bits;
    }

    /// Clears bits.
    pub(super) fn clear(&mut self, bits: u16) {
        self.bits &= !bits;
    }
}

impl Drive {
    /// Sets bits of ERROR. Stops the motor if a newly set bit requires it.
    pub(super) fn raise(&mut self, at: Instant, errors: u16, out: &mut dyn Context) {
        let new = errors & !self.errors.bits;
        self.errors.bits |= new;
        if new & error::STOPS != 0 {
            self.halt(at, out);
        }
    }

    /// Handles a write of ERROR: clears the warnings that are 0 in `word`. A warning whose cause remains is
    /// set again.
    pub(super) fn write_errors(&mut self, at: Instant, word: u16, out: &mut dyn Context) {
        let unwanted = self.errors.bits & !word;
        self.errors.clear(unwanted & !error::STAYS);
        if unwanted & error::STAYS != 0 {
            Why::ErrorStays.put(at, out);
        }
        self.check_errors(at, out);
        if unwanted & !error::STAYS & self.errors.bits != 0 {
            Why::CauseRemains.put(at, out);
        }
    }

    /// Sets or clears the cause of a fault.
    pub(super) fn set_fault(&mut self, at: Instant, fault: Fault, on: bool, out: &mut dyn Context) {
        let Some(&bit) = CAUSES.get(usize::from(fault.0)) else { return };
        let causes = &mut self.errors.causes;
        *causes = if on { *causes | bit } else { *causes & !bit };
        self.set_servo(at, out);
        self.check_errors(at, out);
    }

    /// Sets the measured supply voltage, in 0.1 V.
    pub(super) fn set_supply(&mut self, at: Instant, supply: u16, out: &mut dyn Context) {
        self.errors.supply = supply;
        self.check_errors(at, out);
    }

    /// Sets the bits of the present errors. Called at the end of the start, and after any change of a cause.
    pub(super) fn check_errors(&mut self, at: Instant, out: &mut dyn Context) {
        if self.state != State::Ready {
            return;
        }
        let mut errors = self.errors.causes;
        if !GOOD_SUPPLY.contains(&self.errors.supply) {
            errors |= error::SUPPLY_VOLTAGE;
        }
        if !self.inputs.hard_stop {
            errors |= error::EMERGENCY_STOP;
        }
        for (part, bit) in [
            (Part::Mcu, error::MCU_OVERHEAT),
            (Part::Power, error::POWER_OVERHEAT),
            (Part::Brake, error::BRAKE_OVERHEAT),
        ] {
            if self.thermal.is_too_hot(at, part) {
                errors |= bit;
            }
        }
        if let Some(ma) = self.errors.injected_ma {
            if ma > self.bank.word(Reg::REF_CURRENT) {
                errors |= error::CURRENT_LIMIT;
            }
            if u32::from(ma) >= self.model.short_ma() {
                errors |= error::SHORT_CIRCUIT;
            }
        }
        self.raise(at, errors, out);
    }
}
