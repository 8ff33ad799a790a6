//! PIDs in the non-volatile memory: each is saved as it is written.

use drivetwin_protocol::registers::{Bank, Register, Space};

use super::drive::{Drive, stored_value};
use super::registers::Pid;
use crate::device::{Context, Instant, PresetError};
use crate::memory::{self, Content};

/// Bytes of one of the two copies.
const COPY: usize = memory::copy(Pid::SAVED_WORDS);

/// PIDs of one word each that the first memories did not have: such a memory is still good.
const LATER: [Pid; 3] = [Pid::TAR_POSI_VEL, Pid::POSI_SS, Pid::POSI_SD];

impl Drive {
    /// Loads the saved values: the younger copy, or the one image of memories from before there were two, also where
    /// its save was cut. Any other memory counts as new, since the drive cannot report a bad one (MDROBOT-6).
    pub(super) fn load(&mut self, out: &dyn Context) {
        self.bank = Bank::factory();
        let later = LATER.map(Register::row);
        let is_image = |later: &[usize]| {
            let words = Pid::SAVED_WORDS - later.len();
            memory::content(out.memory(), words) == Content::Good
                || memory::is_unfinished(out.memory(), words)
        };
        if let Some(words) = memory::latest(out.memory(), Pid::SAVED_WORDS) {
            memory::load(Pid::ENTRIES, words, self.bank.words_mut());
        } else if let Some(later) = [&[][..], &later].into_iter().find(|later| is_image(later)) {
            memory::load_without(Pid::ENTRIES, later, out.memory(), self.bank.words_mut());
        }
        // A foreign memory may hold values that no write could have stored.
        for (row, entry) in Pid::ENTRIES.list.iter().enumerate() {
            let value = Pid::ENTRIES.value(self.bank.words(), row);
            let written = Pid::from_row(row)
                .is_some_and(|pid| self.validate(pid, value).is_ok() && stored_value(pid, value) == value);
            if !(written && entry.accepts(value)) {
                Pid::ENTRIES.put(self.bank.words_mut(), row, entry.reset);
            }
        }
    }

    /// Saves all that is saved, at once.
    pub(super) fn save(&self, at: Instant, out: &mut dyn Context) {
        memory::save_copy::<COPY>(Pid::ENTRIES, self.bank.words(), at, out);
    }

    /// Brings every PID that is saved to its factory value. Id, baud and the volume are no PIDs.
    pub(super) fn restore(&mut self) {
        for (row, entry) in Pid::ENTRIES.list.iter().enumerate() {
            if entry.saved != 0 && entry.space == Space::Holding {
                Pid::ENTRIES.put(self.bank.words_mut(), row, entry.reset);
            }
        }
    }

    /// A preset before power comes, as if written and saved.
    pub(super) fn preset(
        &mut self,
        at: Instant,
        pid: Pid,
        value: i64,
        out: &mut dyn Context,
    ) -> Result<(), PresetError> {
        self.load(out);
        self.bank.set(pid, stored_value(pid, value));
        self.save(at, out);
        Ok(())
    }
}
