//! Values that a reset does not change: the parameters that command 3 saves, and the baud rate (COMMAND).

use drivetwin_protocol::registers::{Bank, Register};

use super::registers::Reg;
use super::{MEMORY, Words};
use crate::device::{Context, Duration, Instant, PresetError};
use crate::memory::{self, Content, PendingSave, Save};

/// Duration of a save; the QSB Command List does not give it (QSB-8).
const SAVE: Duration = Duration::millis(10);

/// Rows of one word each that the oldest memories do not have. A memory without them is still valid.
const LATER: [Reg; 1] = [Reg::Firmware];

/// Returns true if a memory is valid but lacks the rows of [`LATER`].
fn is_older(memory: &[u8]) -> bool {
    memory::content(memory, Reg::SAVED_WORDS - LATER.len()) == Content::Good
}

/// The non-volatile memory.
#[derive(Clone, Debug)]
pub(super) struct Saved {
    save: PendingSave,
}

impl Saved {
    pub(super) fn new() -> Self {
        Self { save: PendingSave::NONE }
    }

    /// The values that were saved last; the factory values if the memory is new or bad.
    pub(super) fn words(&self, out: &dyn Context) -> Words {
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

    /// Saves all values.
    pub(super) fn save(&mut self, at: Instant, words: &Words, out: &mut dyn Context) {
        self.save.begin(Save::of_rows::<MEMORY>(Reg::ENTRIES, words.words(), at, SAVE, out));
    }

    /// Saves one value, and nothing else (QSB-7).
    pub(super) fn save_value(&mut self, at: Instant, reg: Reg, value: i64, out: &mut dyn Context) {
        let mut words = self.words(out);
        words.set(reg, value);
        self.save(at, &words, out);
    }

    /// Presets a value before power-on, with the same effect as a save.
    ///
    /// # Errors
    /// The memory is bad.
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
        let mut words = self.words(out);
        words.set(reg, value);
        memory::save_at_once::<MEMORY>(Reg::ENTRIES, words.words(), at, out);
        Ok(())
    }

    /// Finishes a running save before a reset.
    pub(super) fn finish(&mut self, at: Instant, out: &mut dyn Context) {
        self.save.finish(at, out);
    }

    /// End of a running save.
    pub(super) fn deadline(&self) -> Instant {
        self.save.due()
    }

    /// Ends a save that is due.
    pub(super) fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        self.save.timeout(at, out);
    }
}
