//! The EEPROM that holds the registers (7.20).

use drivetwin_protocol::registers::Register;

use super::MEMORY;
use super::reasons::Why;
use super::registers::Reg;
use crate::device::{Context, Duration, Instant};
use crate::memory::{self, Content, PendingSave, Save};

/// Duration of a save (7.20 does not give it; MD3-12).
const SAVE: Duration = Duration::millis(20);

/// Bits of `EEPROMControl`: load all registers, save all registers.
const READ: u16 = 1 << 1;
const WRITE: u16 = 1 << 0;
/// CRC status in `EEPROMControl`: the image passed, or failed.
const PASS: u16 = 0x9a00;
const FAIL: u16 = 0xf100;

/// State of the EEPROM.
#[derive(Clone, Debug)]
pub(super) struct Eeprom {
    /// CRC status: the high byte of `EEPROMControl`.
    status: u16,
    save: PendingSave,
}

impl Eeprom {
    pub(super) fn new() -> Self {
        Self { status: PASS, save: PendingSave::NONE }
    }

    /// Value of `EEPROMControl` when read.
    pub(super) fn control(&self) -> u16 {
        self.status | if self.save.is_running() { WRITE } else { 0 }
    }

    /// Executes a write of `EEPROMControl`. If both bits are set, the drive saves. Returns true if it has loaded
    /// the registers.
    ///
    /// # Errors
    /// The reason why the drive does not save, or does not load.
    pub(super) fn command(
        &mut self,
        at: Instant,
        word: u16,
        words: &mut [u16],
        out: &mut dyn Context,
    ) -> Result<bool, Why> {
        match (word & WRITE != 0, word & READ != 0) {
            (false, false) => Ok(false),
            _ if self.save.is_running() => Err(Why::Saves),
            (false, true) => {
                if self.load(words, out) {
                    Ok(true)
                } else {
                    Err(Why::BadCrc)
                }
            }
            (true, reads) => {
                self.save.begin(Save::of_rows::<MEMORY>(Reg::ENTRIES, words, at, SAVE, out));
                if reads { Err(Why::SavesOnly) } else { Ok(false) }
            }
        }
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
        self.status = if passed { PASS } else { FAIL };
        passed
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
