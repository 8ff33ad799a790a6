//! The EEPROM that holds the registers (7.20).

use drivetwin_protocol::registers::Register;

use super::MEMORY;
use super::reasons::Why;
use super::registers::{Reg, eeprom_control};
use crate::device::{Context, Duration, Instant};
use crate::memory::{self, Content, PendingSave, Save};

/// Duration of a save (7.20 does not give it; MD3-12).
const SAVE: Duration = Duration::millis(20);

/// State of the EEPROM.
#[derive(Clone, Debug)]
pub(super) struct Eeprom {
    /// CRC status: the high byte of `EEPROMControl`.
    status: u16,
    save: PendingSave,
}

impl Eeprom {
    pub(super) fn new() -> Self {
        Self { status: eeprom_control::PASS, save: PendingSave::NONE }
    }

    /// Value of `EEPROMControl` when read.
    pub(super) fn control(&self) -> u16 {
        self.status | if self.save.is_running() { eeprom_control::WRITE } else { 0 }
    }

    /// Returns true if a save is running.
    pub(super) fn is_saving(&self) -> bool {
        self.save.is_running()
    }

    /// Loads the saved registers. A new memory gives the factory values; a bad memory leaves the registers
    /// unchanged. Returns false if the memory is bad.
    pub(super) fn load(&mut self, words: &mut [u16], out: &dyn Context) -> bool {
        let content = memory::content(out.memory(), Reg::SAVED_WORDS);
        match content {
            Content::New => memory::reset(Reg::ENTRIES, words),
            Content::Good => memory::load(Reg::ENTRIES, out.memory(), words),
            Content::Bad => {}
        }
        let passed = content != Content::Bad;
        self.status = if passed { eeprom_control::PASS } else { eeprom_control::FAIL };
        passed
    }

    /// Starts to save the registers.
    ///
    /// # Errors
    /// A save is running already.
    pub(super) fn save(&mut self, at: Instant, words: &[u16], out: &mut dyn Context) -> Result<(), Why> {
        if self.save.is_running() {
            return Err(Why::Saves);
        }
        self.save.begin(Save::of_rows::<MEMORY>(Reg::ENTRIES, words, at, SAVE, out));
        Ok(())
    }

    pub(super) fn deadline(&self) -> Instant {
        self.save.due()
    }

    /// Ends a save that is due.
    pub(super) fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        if self.save.timeout(at, out) {
            self.status = 0;
        }
    }
}
