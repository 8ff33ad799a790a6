//! Steps and counts: EE changes the units of A, D, VI and VM, and their ranges (MC 7.3.7; MDRIVE-22).

use drivetwin_protocol::registers::Legal;

use super::{Registers, entry};
use crate::mdrive::error::Error;
use crate::mdrive::registers::{Reg, mcode_accepts};
use crate::mdrive::settings::motion_settings;

/// Maximum of A and D in counts/s² (MC 5-1, 5-16).
const MAX_COUNTS_PER_S2: i32 = 61_035_160;
/// Maximum of VM and SL in counts/s (MC 5-68, 5-80).
const MAX_COUNTS_PER_S: i32 = 200_000;
/// Value of MS while EE is 1 (MC 7-16).
pub(in crate::mdrive) const CLOSED_MICROSTEPS: i32 = 256;

impl Registers {
    /// Stores a value in the bank. A change of EE converts A, D, VI and VM to their new units; EE = 1 also
    /// sets MS to 256 (MC 7-16).
    pub(in crate::mdrive) fn store(&mut self, reg: Reg, value: i32) {
        let closes = value != 0;
        if reg == Reg::EE && closes != self.is_closed() {
            for scaled in SCALED {
                let value = self.scaled(scaled, closes);
                self.set(scaled, value);
            }
            if closes {
                self.set(Reg::MS, CLOSED_MICROSTEPS.into());
            }
        }
        self.set(reg, value.into());
    }

    /// Returns true if a write of this value is in its range; with EE = 1 in the range for counts.
    pub(super) fn accepts(&self, reg: Reg, value: i32) -> bool {
        let fits = match reg {
            Reg::A | Reg::D => value <= MAX_COUNTS_PER_S2,
            Reg::VM | Reg::SL => value.unsigned_abs() <= MAX_COUNTS_PER_S.unsigned_abs(),
            _ => true,
        };
        mcode_accepts(reg, value.into()) && (fits || !self.is_closed())
    }

    /// Returns true if the unit of a variable is counts at present.
    pub(in crate::mdrive) fn is_in_counts(&self, reg: Reg) -> bool {
        self.is_closed() && SCALED.contains(&reg)
    }

    /// Returns true if a saved value is possible. EE can bring A, D, VI and VM below the least value that a
    /// write accepts.
    pub(in crate::mdrive) fn is_possible(&self, reg: Reg, value: i64) -> bool {
        if self.is_in_counts(reg) {
            (1..=max_counts(reg).into()).contains(&value)
        } else {
            mcode_accepts(reg, value)
        }
    }

    /// Returns true if an encoder with this number of lines fits this number of microsteps: MS is at least EL
    /// x 8 / 200 for a motor of 200 full steps (MC 5-21).
    pub(super) fn fits(&self, lines: i32, microsteps: i32) -> bool {
        lines * 8 <= microsteps * self.stored(Reg::FullSteps)
    }

    /// Checks that EE may become 1.
    ///
    /// # Errors
    /// Error 36 if MS is too low for EL; 90 if A, D, VI or VM would become too low in counts.
    pub(in crate::mdrive) fn validate_closing(&self) -> Result<(), Error> {
        if !self.fits(self.stored(Reg::EL), self.stored(Reg::MS)) {
            return Err(Error::IllegalRatio);
        }
        let too_low = SCALED.iter().any(|&reg| self.scaled(reg, true) < 1);
        if too_low || self.scaled(Reg::VI, true) >= self.scaled(Reg::VM, true) {
            return Err(Error::TooSlowForEncoder);
        }
        Ok(())
    }

    /// Converts A, D, VI or VM to counts, or to steps, within the limits of that unit.
    fn scaled(&self, reg: Reg, to_counts: bool) -> i64 {
        let (scale, value) = (motion_settings(self, None).closed_scale(), self.get(reg));
        let value = if to_counts { scale.in_counts(value) } else { scale.in_steps(value) };
        match entry(reg).legal {
            _ if to_counts => value.min(max_counts(reg).into()),
            Legal::Range(least, most) => value.max(least).min(most),
            _ => value,
        }
    }
}

/// Maximum of A, D, VI or VM in counts.
fn max_counts(reg: Reg) -> i32 {
    match reg {
        Reg::A | Reg::D => MAX_COUNTS_PER_S2,
        Reg::VI => MAX_COUNTS_PER_S - 1,
        _ => MAX_COUNTS_PER_S,
    }
}

/// Variables with another unit while EE is 1.
const SCALED: [Reg; 4] = [Reg::A, Reg::D, Reg::VI, Reg::VM];
