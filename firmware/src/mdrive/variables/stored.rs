//! Stored values of all variables: the last written ones, and whether values fit each other.
//!
//! EE changes the units of A, D, VI and VM between steps and counts, and their ranges (MC 7.3.7; MDRIVE-22).

use drivetwin_protocol::registers::{Bank, Legal, Register, characters};
use heapless::Vec;

use super::{NO_DELAY_MS, entry, is_number, words};
use crate::device::Context;
use crate::mdrive::error::{Error, illegal};
use crate::mdrive::motion::Scale;
use crate::mdrive::registers::{LASTING, Model, Reg, mcode_accepts};
use crate::memory::{self, Content};

/// Maximum sum of HT and MT, in ms (MC 5-32).
const MAX_DELAY_MS: i32 = 65_535;
/// Maximum of A and D in counts/s² (MC 5-1, 5-16).
const MAX_COUNTS_PER_S2: i32 = 61_035_160;
/// Maximum of VM and SL in counts/s (MC 5-68, 5-80).
const MAX_COUNTS_PER_S: i32 = 200_000;
/// Value of MS while EE is 1 (MC 7-16).
pub(in crate::mdrive) const CLOSED_MICROSTEPS: i32 = 256;

/// The stored values of a model's variables.
#[derive(Clone, Debug)]
pub(in crate::mdrive) struct Registers {
    model: Model,
    bank: Bank<Reg, { Reg::WORDS }>,
}

impl Registers {
    // Inlined to build the value in its final place: a copy would need room on a board's stack.
    #[inline(always)]
    pub(in crate::mdrive) fn new(model: Model) -> Self {
        Self { model, bank: Bank::of(model.entries()) }
    }

    pub(in crate::mdrive) fn model(&self) -> Model {
        self.model
    }

    /// Value of a row. If it has several values, they are packed into one number, the first one highest.
    pub(in crate::mdrive) fn get(&self, reg: Reg) -> i64 {
        self.bank.get(reg)
    }

    /// Value of a row of one word.
    pub(in crate::mdrive) fn word(&self, reg: Reg) -> u16 {
        self.bank.word(reg)
    }

    pub(in crate::mdrive) fn set(&mut self, reg: Reg, value: i64) {
        self.bank.set(reg, value);
    }

    /// All words, in the order of the rows.
    pub(in crate::mdrive) fn words(&self) -> &[u16] {
        self.bank.words()
    }

    pub(in crate::mdrive) fn words_mut(&mut self) -> &mut [u16] {
        self.bank.words_mut()
    }

    /// Last written value of a variable.
    pub(in crate::mdrive) fn stored(&self, reg: Reg) -> i32 {
        i32::try_from(self.get(reg)).unwrap_or(i32::MAX)
    }

    /// Stored values of a set-up. Unused values at the end are 0.
    pub(in crate::mdrive) fn set_up_of(&self, reg: Reg) -> [u16; 3] {
        words(reg, self.get(reg))
    }

    /// Identification text, joined from the registers of its halves, such as
    /// [`PART_NUMBER`](crate::mdrive::registers::PART_NUMBER).
    pub(in crate::mdrive) fn text(&self, halves: &[Reg]) -> Vec<u8, 16> {
        let mut text = Vec::new();
        for character in halves.iter().flat_map(|&half| characters(self.get(half))) {
            // The text has room for two halves.
            let _ = text.push(character);
        }
        text
    }

    /// Returns true if this drive's model has a row.
    pub(in crate::mdrive) fn has(&self, reg: Reg) -> bool {
        entry(reg).variants & self.model.variant() != 0
    }

    /// Returns true if EE is 1.
    pub(in crate::mdrive) fn is_closed(&self) -> bool {
        self.word(Reg::EE) != 0
    }

    /// Checks that a value is in its range and fits the values of other variables.
    ///
    /// # Errors
    /// Error 21, 22, 23, 26, 36, 61, 81 or 87.
    pub(in crate::mdrive) fn validate_together(
        &self,
        reg: Reg,
        value: i32,
        as_is: &dyn Fn(Reg) -> i32,
    ) -> Result<(), Error> {
        match reg {
            // The next two checks come before the range checks: a value below VI is too low for VM, whatever
            // else is wrong with the value.
            Reg::VI if value >= as_is(Reg::VM) => Err(Error::InitialVelocity),
            Reg::VM if value <= as_is(Reg::VI) => Err(Error::MaximumVelocity),
            _ if !self.accepts(reg, value) => Err(illegal(reg)),
            Reg::HT if value == NO_DELAY_MS || value + as_is(Reg::MT) > MAX_DELAY_MS => {
                Err(Error::IllegalValue)
            }
            Reg::MT if value + as_is(Reg::HT) > MAX_DELAY_MS => Err(Error::IllegalValue),
            Reg::MS if self.is_closed() && value != CLOSED_MICROSTEPS => Err(Error::IllegalRatio),
            Reg::EL if self.is_closed() && !self.fits(value, CLOSED_MICROSTEPS) => Err(Error::IllegalRatio),
            Reg::JE if value == 1 && as_is(Reg::CM) == 1 => Err(Error::JogInClockMode),
            Reg::CM if value == 1 && as_is(Reg::JE) == 1 => Err(Error::JogInClockMode),
            _ => Ok(()),
        }
    }

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
    fn accepts(&self, reg: Reg, value: i32) -> bool {
        let fits = match reg {
            Reg::A | Reg::D => value <= MAX_COUNTS_PER_S2,
            Reg::VM | Reg::SL => value.unsigned_abs() <= MAX_COUNTS_PER_S.unsigned_abs(),
            _ => true,
        };
        mcode_accepts(reg, value.into()) && (fits || !self.is_closed())
    }

    /// Returns true if the unit of a variable is counts at present.
    fn is_in_counts(&self, reg: Reg) -> bool {
        self.is_closed() && SCALED.contains(&reg)
    }

    /// Returns true if a saved value is possible. EE can bring A, D, VI and VM below the least value that a
    /// write accepts.
    fn is_possible(&self, reg: Reg, value: i64) -> bool {
        if self.is_in_counts(reg) {
            (1..=max_counts(reg).into()).contains(&value)
        } else {
            mcode_accepts(reg, value)
        }
    }

    /// Returns true if an encoder with this number of lines fits this number of microsteps: MS is at least EL
    /// x 8 / 200 for a motor of 200 full steps (MC 5-21).
    fn fits(&self, lines: i32, microsteps: i32) -> bool {
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
        let [full_steps, microsteps, lines] = [Reg::FullSteps, Reg::MS, Reg::EL].map(|reg| self.word(reg));
        let (scale, value) = (Scale::of_encoder(full_steps, microsteps, lines), self.get(reg));
        let value = if to_counts { scale.in_counts(value) } else { scale.in_steps(value) };
        match entry(reg).legal {
            _ if to_counts => value.min(max_counts(reg).into()),
            Legal::Range(least, most) => value.max(least).min(most),
            _ => value,
        }
    }

    /// Loads the variables. If nothing was ever saved, they have the factory's values. Returns false if the
    /// memory is bad.
    pub(in crate::mdrive) fn load(&mut self, out: &dyn Context) -> bool {
        let entries = self.model.entries();
        self.factory_reset();
        let content = memory::content(out.memory(), Reg::SAVED_WORDS);
        if content == Content::Good {
            memory::load(entries, out.memory(), self.bank.words_mut());
            let [method, mode] = self.word(Reg::CA).to_be_bytes();
            self.set(Reg::CalibrationMethod, (method & 1).into());
            self.set(Reg::CA, mode.into());
            self.sanitize();
        }
        content != Content::Bad
    }

    /// Resets values that no save could have stored, for example because the memory is from the other model.
    fn sanitize(&mut self) {
        let entries = self.model.entries();
        for (row, entry) in entries.list.iter().enumerate() {
            let value = entries.value(self.bank.words(), row);
            if entry.saved != 0 && !Reg::from_row(row).is_some_and(|reg| self.is_possible(reg, value)) {
                entries.put(self.bank.words_mut(), row, entry.reset);
            }
        }
        // Each value alone is possible now. The values must also fit each other.
        let rows = entries.list.iter().enumerate().filter(|(_, entry)| entry.saved != 0);
        let mut numbers = rows.filter_map(|(row, _)| Reg::from_row(row)).filter(|&reg| is_number(reg));
        let stored = |reg| self.stored(reg);
        let conflicts = |reg| {
            self.has(reg)
                && !self.is_in_counts(reg)
                && self.validate_together(reg, stored(reg), &stored).is_err()
        };
        if stored(Reg::VI) >= stored(Reg::VM) || numbers.any(conflicts) {
            self.factory_reset();
        }
    }

    /// Resets all variables to the factory's values, except [`LASTING`], which the drive itself never
    /// changes.
    pub(in crate::mdrive) fn factory_reset(&mut self) {
        let lasting = LASTING.map(|reg| self.get(reg));
        self.bank = Bank::of(self.model.entries());
        for (reg, value) in LASTING.into_iter().zip(lasting) {
            self.set(reg, value);
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
