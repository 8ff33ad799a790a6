//! Values that a reset does not change: the parameters that command 3 saves, and the baud rate (COMMAND).

use drivetwin_protocol::registers::{Bank, Register};

use super::adapter::Adapter;
use super::registers::Reg;
use super::{MEMORY, Words};
use crate::device::{Context, Duration, Instant, PresetError};
use crate::memory::{self, Content, Save};

/// Duration of a save; the QSB Command List does not give it (QSB-8).
const SAVE: Duration = Duration::millis(10);

/// Rows of one word each that the oldest memories do not have. A memory without them is still valid.
const LATER: [Reg; 1] = [Reg::Firmware];

/// Returns true if a memory is valid but lacks the rows of [`LATER`].
fn is_older(memory: &[u8]) -> bool {
    memory::content(memory, Reg::SAVED_WORDS - LATER.len()) == Content::Good
}

impl Adapter {
    /// The values that were saved last; the factory values if the memory is new or bad.
    pub(super) fn stored(&self, out: &dyn Context) -> Words {
        let mut words = Bank::factory();
        // While a save runs, its image is stored already, and only the check sum is missing.
        if self.save.is_running() || memory::content(out.memory(), Reg::SAVED_WORDS) == Content::Good {
            memory::load(Reg::ENTRIES, out.memory(), words.words_mut());
        } else if is_older(out.memory()) {
            let later = LATER.map(Register::row);
            memory::load_without(Reg::ENTRIES, &later, out.memory(), words.words_mut());
        }
        words
    }

    /// Executes command 3: saves the parameters.
    pub(super) fn save_parameters(&mut self, at: Instant, out: &mut dyn Context) {
        self.bank.set(Reg::Streams, i64::from(self.streams.running()));
        self.bank.set(Reg::MotorDrive, i64::from(self.motor.is_active()));
        let words = self.bank.clone();
        self.store(at, &words, out);
    }

    /// Executes command A: saves the baud rate and nothing else (QSB-7).
    pub(super) fn save_rate(&mut self, at: Instant, rate: i64, out: &mut dyn Context) {
        self.bank.set(Reg::BaudRate, rate);
        let mut words = self.stored(out);
        words.set(Reg::BaudRate, rate);
        self.store(at, &words, out);
    }

    fn store(&mut self, at: Instant, words: &Words, out: &mut dyn Context) {
        self.save.begin(Save::of_rows::<MEMORY>(Reg::ENTRIES, words.words(), at, SAVE, out));
    }

    /// Presets a value before power-on, with the same effect as a save.
    pub(super) fn preset(
        &self,
        at: Instant,
        reg: Reg,
        value: i64,
        out: &mut dyn Context,
    ) -> Result<(), PresetError> {
        if memory::content(out.memory(), Reg::SAVED_WORDS) == Content::Bad && !is_older(out.memory()) {
            return Err(PresetError::BadMemory);
        }
        let mut words = self.stored(out);
        words.set(reg, value);
        memory::save_at_once::<MEMORY>(Reg::ENTRIES, words.words(), at, out);
        Ok(())
    }
}
