//! Settings in the flash: the registers 5000h to 5020h (6.5).

use drivetwin_protocol::registers::{Bank, Register};

use super::SETTINGS;
use super::drive::Drive;
use super::registers::{Reg, VERSIONS};
use crate::device::{Context, Duration, Instant, PresetError};
use crate::memory::{self, Content, Save};

/// Duration of a save, of the settings or of the user program. The manual does not specify it (RS434-11).
pub(super) const SAVE: Duration = Duration::millis(10);

impl Drive {
    /// Loads the settings. Uses the factory values if the flash is new or bad. Returns false if the flash is
    /// bad.
    pub(super) fn load_settings(&mut self, out: &dyn Context) -> bool {
        let entries = self.model.entries();
        let versions = VERSIONS.map(|reg| self.bank.get(reg));
        self.bank = Bank::of(entries);
        for (reg, version) in VERSIONS.into_iter().zip(versions) {
            self.bank.set(reg, version);
        }
        let content = memory::content(out.memory(), Reg::SAVED_WORDS);
        if content == Content::Good {
            memory::load(entries, out.memory(), self.bank.words_mut());
            memory::reset_impossible(entries, self.bank.words_mut(), |_, _| true);
        }
        content != Content::Bad
    }

    /// Starts to save the settings. A save in progress starts again.
    pub(super) fn save_settings(&mut self, at: Instant, out: &mut dyn Context) {
        self.refresh(at, Reg::OFFSET);
        let (entries, words) = (self.model.entries(), self.bank.words());
        self.save.begin(Save::of_rows::<SETTINGS>(entries, words, at, SAVE, out));
    }

    /// Resets the settings to the factory values, also in the flash (section 7).
    pub(super) fn reset_settings(&mut self, at: Instant, out: &mut dyn Context) {
        memory::reset(self.model.entries(), self.bank.words_mut());
        self.set_servo(at, out);
        self.save_settings(at, out);
    }

    /// Presets a register before power-on, as if the value had been saved.
    pub(super) fn preset(
        &mut self,
        at: Instant,
        reg: Reg,
        value: i64,
        out: &mut dyn Context,
    ) -> Result<(), PresetError> {
        if !self.load_settings(out) {
            return Err(PresetError::BadMemory);
        }
        let entries = self.model.entries();
        entries.put(self.bank.words_mut(), reg.row(), value);
        memory::save_at_once::<SETTINGS>(entries, self.bank.words(), at, out);
        Ok(())
    }
}
