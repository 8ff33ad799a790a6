//! PIDs in the non-volatile memory: each is saved as it is written.

use standin_protocol::registers::{Bank, Register, Space};

use super::MEMORY;
use super::drive::{Drive, kept};
use super::registers::Pid;
use crate::device::{Duration, Instant, Refused, Sink};
use crate::memory::{self, Content, Save};

/// How long a save takes; the manual does not say.
pub(super) const SAVE: Duration = Duration::millis(10);

/// PIDs of one word each that the first memories did not have: such a memory is still good.
const LATER: [Pid; 3] = [Pid::TAR_POSI_VEL, Pid::POSI_SS, Pid::POSI_SD];

impl Drive {
    /// Loads what is saved, also by a save that power has cut in its 10 ms, since the drive cannot say that its
    /// memory is bad; any other bad memory is a new one.
    pub(super) fn load(&mut self, out: &dyn Sink) {
        self.bank = Bank::factory();
        match memory::content(out.memory(), Pid::SAVED_WORDS) {
            Content::New => {}
            Content::Good => memory::load(Pid::ENTRIES, out.memory(), self.bank.words_mut()),
            Content::Bad if memory::is_unfinished(out.memory(), Pid::SAVED_WORDS) => {
                memory::load(Pid::ENTRIES, out.memory(), self.bank.words_mut());
            }
            Content::Bad => {
                if memory::content(out.memory(), Pid::SAVED_WORDS - LATER.len()) == Content::Good {
                    let later = LATER.map(Register::row);
                    memory::load_without(Pid::ENTRIES, &later, out.memory(), self.bank.words_mut());
                }
            }
        }
        // A memory of nobody may hold what no write could bring.
        for (row, entry) in Pid::ENTRIES.list.iter().enumerate() {
            let value = Pid::ENTRIES.value(self.bank.words(), row);
            let written = Pid::from_row(row)
                .is_some_and(|pid| self.permits(pid, value).is_ok() && kept(pid, value) == value);
            if !(written && entry.accepts(value)) {
                Pid::ENTRIES.put(self.bank.words_mut(), row, entry.reset);
            }
        }
    }

    /// Begins to save; a save that runs begins again.
    pub(super) fn save(&mut self, at: Instant, out: &mut dyn Sink) {
        self.save = Some(Save::of_rows::<MEMORY>(Pid::ENTRIES, self.bank.words(), at, SAVE, out));
    }

    pub(super) fn save_due(&self) -> Instant {
        self.save.map_or(Instant::NEVER, Save::due)
    }

    /// Ends the save that runs.
    pub(super) fn finish_save(&mut self, at: Instant, out: &mut dyn Sink) {
        if let Some(save) = self.save.take() {
            save.finish(at, out);
        }
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
        out: &mut dyn Sink,
    ) -> Result<(), Refused> {
        self.load(out);
        self.bank.set(pid, kept(pid, value));
        self.save(at, out);
        self.finish_save(at, out);
        Ok(())
    }
}
