//! Settings in the flash: the registers 5000h to 5020h (6.5).

use drivetwin_protocol::registers::{Bank, Entries, Register};

use super::SETTINGS;
use super::registers::{Reg, VERSIONS, Words};
use crate::device::{Context, Duration, Instant, PresetError};
use crate::memory::{self, Content, Save};

/// Duration of a save, of the settings or of the user program. The manual does not specify it (RS434-11).
pub(super) const SAVE: Duration = Duration::millis(10);

/// Loads the settings. Uses the factory values if the flash is new or bad. Returns false if the flash is bad.
pub(super) fn load(entries: &'static Entries, bank: &mut Words, memory: &[u8]) -> bool {
    let versions = VERSIONS.map(|reg| bank.get(reg));
    *bank = Bank::of(entries);
    for (reg, version) in VERSIONS.into_iter().zip(versions) {
        bank.set(reg, version);
    }
    let content = memory::content(memory, Reg::SAVED_WORDS);
    if content == Content::Good {
        memory::load(entries, memory, bank.words_mut());
        memory::reset_impossible(entries, bank.words_mut(), |_, _| true);
    }
    content != Content::Bad
}

/// Starts to save the settings.
pub(super) fn save(entries: &Entries, bank: &Words, at: Instant, out: &mut dyn Context) -> Save {
    Save::of_rows::<SETTINGS>(entries, bank.words(), at, SAVE, out)
}

/// Presets a register before power-on, as if the value had been saved.
pub(super) fn preset(
    entries: &'static Entries,
    bank: &mut Words,
    at: Instant,
    (reg, value): (Reg, i64),
    out: &mut dyn Context,
) -> Result<(), PresetError> {
    if !load(entries, bank, out.memory()) {
        return Err(PresetError::BadMemory);
    }
    entries.put(bank.words_mut(), reg.row(), value);
    memory::save_at_once::<SETTINGS>(entries, bank.words(), at, out);
    Ok(())
}
