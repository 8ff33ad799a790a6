//! Saved registers of a drive in its non-volatile memory: an image and its CRC.
//!
//! The image is the words of the saved rows, in the order of the table, high byte first. Their CRC-16
//! follows. A save first stores the image with a wrong CRC, and at the end of the save time the right CRC. If
//! power is lost in between, the CRC does not match.
//!
//! A drive that cannot report a bad memory has two copies ([`latest`]). A save overwrites the older copy.

use drivetwin_protocol::modbus::rtu::crc;
use drivetwin_protocol::registers::Entries;

use crate::device::{Context, Duration, Instant, Output};

/// Size in bytes of a memory with `words` saved words.
#[must_use]
pub const fn bytes(words: usize) -> u16 {
    (2 * words + 2) as u16
}

/// State of a memory.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Content {
    /// New: nothing was ever saved, all bytes are `0xFF` (PROJECT-5).
    New,
    /// The CRC of the image matches.
    Good,
    /// The memory is neither new nor good.
    Bad,
}

/// State of the memory of a map with `words` saved words.
#[must_use]
pub fn content(memory: &[u8], words: usize) -> Content {
    let image = memory.get(..2 * words);
    let sum = memory.get(2 * words..).and_then(<[u8]>::first_chunk::<2>);
    match (image, sum) {
        (Some(image), Some([0xFF, 0xFF])) if image.iter().all(|&byte| byte == 0xFF) => Content::New,
        (Some(image), Some(sum)) if crc(image) == u16::from_be_bytes(*sum) => Content::Good,
        _ => Content::Bad,
    }
}

/// Returns true if a save stored its whole image in the memory but did not store the right CRC.
#[must_use]
pub fn is_unfinished(memory: &[u8], words: usize) -> bool {
    let image = memory.get(..2 * words);
    let sum = memory.get(2 * words..).and_then(<[u8]>::first_chunk::<2>);
    image.zip(sum).is_some_and(|(image, sum)| *sum == wrong(crc(image).to_be_bytes()))
}

/// Sets the saved rows of a bank to their factory values.
pub fn reset(entries: &Entries, bank: &mut [u16]) {
    for (index, row) in entries.list.iter().enumerate().filter(|(_, row)| row.saved != 0) {
        entries.put(bank, index, row.reset);
    }
}

/// Copies the saved words of a good image into a bank. Bits that are not saved are cleared.
pub fn load(entries: &Entries, memory: &[u8], bank: &mut [u16]) {
    load_without(entries, &[], memory, bank);
}

/// Like [`load`], for an image saved by a version without some of the rows. `later` has the indices of these
/// rows.
pub fn load_without(entries: &Entries, later: &[usize], memory: &[u8], bank: &mut [u16]) {
    for ((place, mask), word) in saved_words(entries, later).zip(memory.as_chunks().0) {
        if let Some(target) = bank.get_mut(place) {
            *target = u16::from_be_bytes(*word) & mask;
        }
    }
}

/// Resets the values that no save can have stored, because the memory may come from another model or another device: those
/// that their row does not accept, and those for which `is_possible` (index of the row, value) is false.
pub fn reset_impossible(entries: &Entries, bank: &mut [u16], is_possible: impl Fn(usize, i64) -> bool) {
    for (row, entry) in entries.list.iter().enumerate() {
        let value = entries.value(bank, row);
        if !(entry.accepts(value) && is_possible(row, value)) {
            entries.put(bank, row, entry.reset);
        }
    }
}

/// Saves the image of a bank at the beginning of the memory at once, for a preset before power-on. The image and its CRC take
/// `BYTES` bytes ([`bytes`]).
pub fn save_at_once<const BYTES: usize>(entries: &Entries, bank: &[u16], at: Instant, out: &mut dyn Context) {
    Save::of_rows::<BYTES>(entries, bank, at, Duration::ZERO, out).finish(at, out);
}

/// Size in bytes of a memory of two copies of `words` saved words.
#[must_use]
pub const fn two_copies(words: usize) -> u16 {
    (2 * copy(words)) as u16
}

/// Size in bytes of a copy: a count, the words, the CRC of both, and the count again.
#[must_use]
pub const fn copy(words: usize) -> usize {
    2 * words + 4
}

/// The words of the newest copy that is complete; `None` if neither copy is complete.
#[must_use]
pub fn latest(memory: &[u8], words: usize) -> Option<&[u8]> {
    latest_copy(memory, copy(words)).map(|copy| copy.words)
}

/// Saves the words of a bank in place of the older of two copies of `COPY` bytes ([`copy`]). If power is lost
/// during the store, the other copy remains valid, because the two counts of an incomplete copy differ.
pub fn save_copy<const COPY: usize>(entries: &Entries, bank: &[u16], at: Instant, out: &mut dyn Context) {
    let last = latest_copy(out.memory(), COPY);
    // The first save writes the second copy, because an old memory with a single image has this image at the
    // beginning.
    let (is_first, count) = last.map_or((true, 0), |copy| (copy.is_first, copy.count.wrapping_add(1)));
    let mut bytes = [count; COPY];
    if let Some((summed, [sum @ .., _])) = bytes.split_last_chunk_mut::<3>() {
        let words = summed.get_mut(1..).unwrap_or_default().as_chunks_mut().0;
        for ((place, mask), word) in saved_words(entries, &[]).zip(words) {
            *word = (bank.get(place).copied().unwrap_or(0) & mask).to_be_bytes();
        }
        *sum = crc(summed).to_be_bytes();
    }
    out.put(at, Output::Store { offset: if is_first { COPY as u16 } else { 0 }, bytes: &bytes });
}

/// A complete copy.
struct Copy<'a> {
    is_first: bool,
    count: u8,
    words: &'a [u8],
}

fn latest_copy(memory: &[u8], bytes: usize) -> Option<Copy<'_>> {
    let (first, second) = memory.split_at_checked(bytes)?;
    match (whole_copy(first, true), whole_copy(second, false)) {
        (Some(first), Some(second)) if second.count == first.count.wrapping_add(1) => Some(second),
        (first, second) => first.or(second),
    }
}

fn whole_copy(bytes: &[u8], is_first: bool) -> Option<Copy<'_>> {
    let (summed, &[high, low, again]) = bytes.split_last_chunk()?;
    let (&count, words) = summed.split_first()?;
    let is_whole = count == again && crc(summed) == u16::from_be_bytes([high, low]);
    is_whole.then_some(Copy { is_first, count, words })
}

/// A save in progress: its image is stored, followed by a wrong CRC.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Save {
    crc: [u8; 2],
    /// Offset of the CRC in the memory.
    place: u16,
    due: Instant,
}

impl Save {
    /// Starts to save the image of a bank at the beginning of the memory. The image and its CRC take `BYTES`
    /// bytes ([`bytes`]), the save takes `time`.
    pub fn of_rows<const BYTES: usize>(
        entries: &Entries,
        bank: &[u16],
        at: Instant,
        time: Duration,
        out: &mut dyn Context,
    ) -> Self {
        let mut memory = [0; BYTES];
        for ((place, mask), word) in saved_words(entries, &[]).zip(memory.as_chunks_mut().0) {
            *word = (bank.get(place).copied().unwrap_or(0) & mask).to_be_bytes();
        }
        let mut right = [0; 2];
        if let Some((image, sum)) = memory.split_last_chunk_mut::<2>() {
            right = crc(image).to_be_bytes();
            *sum = wrong(right);
        }
        out.put(at, Output::Store { offset: 0, bytes: &memory });
        Self { crc: right, place: (BYTES - 2) as u16, due: at + time }
    }

    /// Starts to save another image, which is too large for a local copy, from `offset` on. The save takes
    /// `time`.
    pub fn of_bytes(image: &[u8], offset: u16, at: Instant, time: Duration, out: &mut dyn Context) -> Self {
        let (crc, place) = (crc(image).to_be_bytes(), offset + image.len() as u16);
        // The wrong CRC is stored first, so that a right CRC never follows half an image.
        out.put(at, Output::Store { offset: place, bytes: &wrong(crc) });
        out.put(at, Output::Store { offset, bytes: image });
        Self { crc, place, due: at + time }
    }

    /// Time at which the save is complete.
    #[must_use]
    pub fn due(self) -> Instant {
        self.due
    }

    /// Stores the right CRC. From now on the image is good.
    pub fn finish(self, at: Instant, out: &mut dyn Context) {
        out.put(at, Output::Store { offset: self.place, bytes: &self.crc });
    }
}

/// The save in progress, if there is one. After a power failure there is none.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct PendingSave(Option<Save>);

impl PendingSave {
    /// No save is in progress.
    pub const NONE: Self = Self(None);

    /// Begins a save, which replaces the one in progress.
    pub fn begin(&mut self, save: Save) {
        self.0 = Some(save);
    }

    /// Returns true if a save is in progress.
    #[must_use]
    pub fn is_running(&self) -> bool {
        self.0.is_some()
    }

    /// Time at which the save in progress is complete.
    #[must_use]
    pub fn due(&self) -> Instant {
        self.0.map_or(Instant::NEVER, Save::due)
    }

    /// Finishes a save that is due. Returns true if there was one.
    pub fn timeout(&mut self, at: Instant, out: &mut dyn Context) -> bool {
        let is_due = self.due() <= at;
        if is_due {
            self.finish(at, out);
        }
        is_due
    }

    /// Finishes the save in progress, for instance before a restart.
    pub fn finish(&mut self, at: Instant, out: &mut dyn Context) {
        if let Some(save) = self.0.take() {
            save.finish(at, out);
        }
    }
}

/// A CRC that differs from `crc`.
fn wrong(crc: [u8; 2]) -> [u8; 2] {
    crc.map(|byte| !byte)
}

/// Index in the bank and saved bits of every saved word, except those of the rows `without`.
fn saved_words<'a>(entries: &'a Entries, without: &'a [usize]) -> impl Iterator<Item = (usize, u16)> + 'a {
    let rows = entries.list.iter().enumerate().filter(|(_, row)| row.saved != 0);
    rows.filter(|(index, _)| !without.contains(index)).flat_map(|(index, row)| {
        let place = entries.offset(index);
        (0..usize::from(row.shape.words())).map(move |n| (place + n, row.saved))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivetwin_protocol::registers::{Bank, Register as _};
    use std::vec::Vec;

    use crate::testing::{Recorder, Treatment};

    drivetwin_protocol::registers! {
        /// Saved and other rows.
        enum Reg: HighFirst {
            /// Saved.
            Address = rw(0, "1").reset(0x1234).saved(),
            /// Not saved.
            Motion = rw(1, "2").reset(7),
            /// A pair, saved.
            Speed = rw(2, "3").u32().reset(0xA1A2_A3A4).saved(),
            /// Four of its bits are saved.
            Pins = rw(4, "4").reset(0xF).saved_bits(0xF0),
        }
    }

    drivetwin_protocol::registers! {
        /// Rows that do not accept every word.
        enum Narrow: HighFirst {
            /// At most 9.
            Level = rw(0, "1").range(0, 9).reset(3).saved(),
            /// Any word.
            Code = rw(1, "2").reset(4).saved(),
        }
    }

    const WORDS: usize = 4;
    const BYTES: usize = 10;
    /// The bytes 12 34 and A1 A2 A3 A4, and those bits of 000F that are in F0h.
    const FACTORY: [u8; 8] = [0x12, 0x34, 0xA1, 0xA2, 0xA3, 0xA4, 0, 0];
    const START: Instant = Instant::from_ticks(5);
    const TIME: Duration = Duration::millis(3);

    /// A recorder with a new memory. It accepts stores only.
    fn recorder(size: usize) -> Recorder {
        Recorder::new(size).ruled(|output| match output {
            Output::Store { .. } => Treatment::Keep,
            _ => Treatment::Refuse,
        })
    }

    /// Instant of the last store.
    fn stored_at(out: &Recorder) -> Instant {
        out.stores.last().unwrap().0
    }

    /// Offsets of all stores.
    fn places(out: &Recorder) -> Vec<u16> {
        out.stores.iter().map(|(_, offset, _)| *offset).collect()
    }

    /// A memory with the bytes of `image` and their CRC, high byte first.
    fn sealed(image: &[u8]) -> Vec<u8> {
        [image, &crc(image).to_be_bytes()].concat()
    }

    #[test]
    fn a_memory_is_new_good_or_bad() {
        assert_eq!(bytes(WORDS), 10);
        assert_eq!(content(&[0xFF; BYTES], WORDS), Content::New);
        assert_eq!(content(&sealed(&FACTORY), WORDS), Content::Good);
        // Bytes after the CRC are not part of the image.
        assert_eq!(content(&[&sealed(&FACTORY)[..], &[1, 2, 3]].concat(), WORDS), Content::Good);
        for place in 0..BYTES {
            let mut memory = sealed(&FACTORY);
            memory[place] ^= 0x40;
            assert_eq!(content(&memory, WORDS), Content::Bad, "byte {place}");
            let mut almost_new = [0xFF; BYTES];
            almost_new[place] = 0;
            assert_eq!(content(&almost_new, WORDS), Content::Bad, "byte {place}");
            assert_eq!(content(&sealed(&FACTORY)[..place], WORDS), Content::Bad, "{place} bytes");
        }
        assert_eq!(content(&[0; BYTES], WORDS), Content::Bad);
    }

    #[test]
    fn a_save_passes_when_its_time_is_over_and_not_before() {
        let mut bank: Bank<Reg, { Reg::WORDS }> = Bank::factory();
        bank.set(Reg::Speed, 0x0102_0304);
        bank.set(Reg::Pins, 0xFFFF);
        let mut out = recorder(BYTES + 2);
        let save = Save::of_rows::<BYTES>(Reg::ENTRIES, bank.words(), START, TIME, &mut out);
        assert_eq!((stored_at(&out), save.due()), (START, START + TIME));
        assert_eq!(out.memory[..8], [0x12, 0x34, 1, 2, 3, 4, 0, 0xF0]);
        assert_eq!(out.memory[10..], [0xFF; 2], "somebody else's");
        assert_eq!(content(&out.memory, WORDS), Content::Bad);
        assert!(is_unfinished(&out.memory, WORDS));
        save.finish(START + TIME, &mut out);
        assert_eq!(stored_at(&out), START + TIME);
        assert_eq!(out.memory[..10], sealed(&[0x12, 0x34, 1, 2, 3, 4, 0, 0xF0]));
        assert_eq!(content(&out.memory, WORDS), Content::Good);
        assert!(!is_unfinished(&out.memory, WORDS));
        assert!(!is_unfinished(&[0xFF; BYTES], WORDS) && !is_unfinished(&[0; 3], WORDS));
    }

    #[test]
    fn a_pending_save_ends_when_it_is_due_or_before_a_restart() {
        let bank: Bank<Reg, { Reg::WORDS }> = Bank::factory();
        let mut out = recorder(BYTES);
        let mut pending = PendingSave::NONE;
        assert_eq!((pending.is_running(), pending.due()), (false, Instant::NEVER));
        pending.finish(START, &mut out);
        assert!(!pending.timeout(START, &mut out) && out.stores.is_empty(), "there is no save");
        pending.begin(Save::of_rows::<BYTES>(Reg::ENTRIES, bank.words(), START, TIME, &mut out));
        assert_eq!((pending.is_running(), pending.due()), (true, START + TIME));
        assert!(!pending.timeout(START + TIME - Duration::TICK, &mut out));
        assert_eq!(content(&out.memory, WORDS), Content::Bad);
        assert!(pending.timeout(START + TIME, &mut out));
        assert_eq!((pending.is_running(), out.memory.clone()), (false, sealed(&FACTORY)));
        // A restart finishes a save that is not due yet.
        pending.begin(Save::of_rows::<BYTES>(Reg::ENTRIES, bank.words(), START, TIME, &mut out));
        pending.finish(START, &mut out);
        assert_eq!((pending.is_running(), out.memory), (false, sealed(&FACTORY)));
    }

    #[test]
    fn a_preset_is_saved_at_once() {
        let bank: Bank<Reg, { Reg::WORDS }> = Bank::factory();
        let mut out = recorder(BYTES);
        save_at_once::<BYTES>(Reg::ENTRIES, bank.words(), START, &mut out);
        assert_eq!((stored_at(&out), out.memory), (START, sealed(&FACTORY)));
    }

    #[test]
    fn impossible_values_become_factory_values() {
        let mut bank: Bank<Narrow, { Narrow::WORDS }> = Bank::factory();
        bank.set(Narrow::Level, 10);
        bank.set(Narrow::Code, 5);
        reset_impossible(Narrow::ENTRIES, bank.words_mut(), |_, _| true);
        assert_eq!([Narrow::Level, Narrow::Code].map(|row| bank.get(row)), [3, 5], "10 is out of range");
        reset_impossible(Narrow::ENTRIES, bank.words_mut(), |row, value| {
            (row, value) != (Narrow::Code.row(), 5)
        });
        assert_eq!([Narrow::Level, Narrow::Code].map(|row| bank.get(row)), [3, 4]);
    }

    #[test]
    fn what_was_saved_comes_back_and_nothing_else() {
        let image = [0xAB, 0xCD, 1, 2, 3, 4, 0xFF, 0xFF];
        let mut bank: Bank<Reg, { Reg::WORDS }> = Bank::factory();
        bank.set(Reg::Motion, 99);
        load(Reg::ENTRIES, &sealed(&image), bank.words_mut());
        let values = [Reg::Address, Reg::Motion, Reg::Speed, Reg::Pins].map(|row| bank.get(row));
        assert_eq!(values, [0xABCD, 99, 0x0102_0304, 0xF0]);
        reset(Reg::ENTRIES, bank.words_mut());
        let values = [Reg::Address, Reg::Motion, Reg::Speed, Reg::Pins].map(|row| bank.get(row));
        assert_eq!(values, [0x1234, 99, 0xA1A2_A3A4, 0xF]);
        // An image saved by a version without the pair.
        load_without(Reg::ENTRIES, &[Reg::Speed.row()], &sealed(&[0xAB, 0xCD, 0, 0x30]), bank.words_mut());
        let values = [Reg::Address, Reg::Motion, Reg::Speed, Reg::Pins].map(|row| bank.get(row));
        assert_eq!(values, [0xABCD, 99, 0xA1A2_A3A4, 0x30]);
    }

    #[test]
    fn a_wrong_crc_is_another_one() {
        for crc in (0..=u16::MAX).map(u16::to_be_bytes) {
            assert_ne!(wrong(crc), crc);
        }
    }

    const COPY: usize = 12;

    /// A copy as stored in a memory: count, words, CRC, count.
    fn counted(count: u8, image: &[u8]) -> Vec<u8> {
        [&sealed(&[&[count], image].concat())[..], &[count]].concat()
    }

    #[test]
    fn two_copies_are_written_in_turn() {
        assert_eq!((copy(WORDS), two_copies(WORDS)), (COPY, 24));
        let mut bank: Bank<Reg, { Reg::WORDS }> = Bank::factory();
        let mut out = recorder(2 * COPY);
        assert_eq!(latest(&out.memory, WORDS), None, "a new memory has none");
        for save in 0_u16..600 {
            bank.set(Reg::Address, save.into());
            bank.set(Reg::Pins, 0xFFFF);
            save_copy::<COPY>(Reg::ENTRIES, bank.words(), START, &mut out);
            let [high, low] = save.to_be_bytes();
            let image = [high, low, 0xA1, 0xA2, 0xA3, 0xA4, 0, 0xF0];
            assert_eq!(latest(&out.memory, WORDS), Some(&image[..]));
            // The first copy is written after the place of an old memory with a single image.
            let place = if save % 2 == 0 { COPY } else { 0 };
            assert_eq!(out.memory[place..place + COPY], counted(low, &image));
        }
        assert_eq!(stored_at(&out), START);
        assert_eq!(places(&out)[..4], [12, 0, 12, 0]);
    }

    #[test]
    fn the_copy_that_was_saved_last_counts_if_it_is_whole() {
        const OLD: [u8; 8] = [1; 8];
        const NEW: [u8; 8] = [2; 8];
        for (old, new) in [(0, 1), (7, 8), (255, 0)] {
            for memory in [[counted(old, &OLD), counted(new, &NEW)], [counted(new, &NEW), counted(old, &OLD)]]
            {
                let is_new = |copy: &[u8]| copy[1] == NEW[0];
                let behind = is_new(&memory[1]);
                let memory = memory.concat();
                assert_eq!(latest(&memory, WORDS), Some(&NEW[..]));
                for place in 0..COPY {
                    let mut damaged = memory.clone();
                    damaged[place + if behind { COPY } else { 0 }] ^= 0x40;
                    assert_eq!(latest(&damaged, WORDS), Some(&OLD[..]), "byte {place}");
                    damaged[place + if behind { 0 } else { COPY }] ^= 0x40;
                    assert_eq!(latest(&damaged, WORDS), None, "byte {place}");
                }
            }
        }
        // Copies with equal counts but a wrong CRC.
        assert_eq!(latest(&[[3; COPY], [4; COPY]].concat(), WORDS), None);
        assert_eq!(latest(&[5; COPY - 1], WORDS), None);
    }

    #[test]
    fn bytes_of_another_kind_are_saved_behind_the_rows() {
        let mut out = recorder(20);
        out.memory[..BYTES].copy_from_slice(&sealed(&FACTORY));
        let program = [7, 6, 5, 4];
        let save = Save::of_bytes(&program, 12, START, TIME, &mut out);
        assert_eq!((stored_at(&out), save.due()), (START, START + TIME));
        assert_eq!(out.memory[..12], [&sealed(&FACTORY)[..], &[0xFF; 2]].concat());
        assert_eq!(out.memory[12..16], program);
        assert_eq!(places(&out), [16, 12], "never a right sum behind half an image");
        assert_eq!(content(&out.memory[12..], 2), Content::Bad);
        assert!(is_unfinished(&out.memory[12..], 2));
        save.finish(START + TIME, &mut out);
        assert_eq!(out.memory[12..18], sealed(&program));
        assert_eq!(out.memory[18..], [0xFF; 2]);
    }
}
