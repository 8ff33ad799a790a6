//! PIDs in the non-volatile memory: each is saved when it is written.

use drivetwin_protocol::registers::{Bank, Register, Space};

use super::registers::{Pid, Words, stored_value, validate};
use crate::device::{Context, Instant};
use crate::memory::{self, Content};

/// Size of one of the two copies, in bytes.
const COPY: usize = memory::copy(Pid::SAVED_WORDS);

/// PIDs of one word each that the oldest memories do not have. A memory without them is still valid.
const LATER: [Pid; 3] = [Pid::TAR_POSI_VEL, Pid::POSI_SS, Pid::POSI_SD];

/// Loads the saved values: those of the newer copy. An older memory has one image instead of two copies;
/// it is loaded even if its last save was interrupted. Any other memory counts as new, because the drive
/// cannot report a bad one (MDROBOT-6).
pub(super) fn load(bank: &mut Words, memory: &[u8]) {
    *bank = Bank::factory();
    let later = LATER.map(Register::row);
    let is_image = |later: &[usize]| {
        let words = Pid::SAVED_WORDS - later.len();
        memory::content(memory, words) == Content::Good || memory::is_unfinished(memory, words)
    };
    if let Some(words) = memory::latest(memory, Pid::SAVED_WORDS) {
        memory::load(Pid::ENTRIES, words, bank.words_mut());
    } else if let Some(later) = [&[][..], &later].into_iter().find(|later| is_image(later)) {
        memory::load_without(Pid::ENTRIES, later, memory, bank.words_mut());
    }
    memory::reset_impossible(Pid::ENTRIES, bank.words_mut(), |row, value| {
        Pid::from_row(row)
            .is_some_and(|pid| validate(pid, value).is_ok() && stored_value(pid, value) == value)
    });
}

/// Saves all values that are saved, at once.
pub(super) fn save(bank: &Words, at: Instant, out: &mut dyn Context) {
    memory::save_copy::<COPY>(Pid::ENTRIES, bank.words(), at, out);
}

/// Restores the factory value of every saved PID. The id, the baud rate and the volume are not PIDs.
pub(super) fn restore(bank: &mut Words) {
    for (row, entry) in Pid::ENTRIES.list.iter().enumerate() {
        if entry.saved != 0 && entry.space == Space::Holding {
            Pid::ENTRIES.put(bank.words_mut(), row, entry.reset);
        }
    }
}

/// Presets a value before power-on, with the same effect as a write and a save.
pub(super) fn preset(bank: &mut Words, pid: Pid, value: i64, at: Instant, out: &mut dyn Context) {
    load(bank, out.memory());
    bank.set(pid, stored_value(pid, value));
    save(bank, at, out);
}
