//! The saved registers of a drive in its non-volatile memory: an image and its CRC.
//!
//! The image is the words of the saved rows, in the order of the table, high byte first; behind it
//! comes their CRC-16. A save stores the image with a CRC that is certainly wrong, and the right one
//! when its time is over: power lost in between leaves a memory that does not pass.

use standin_protocol::modbus::rtu::crc;
use standin_protocol::registers::Entries;

use crate::device::{Instant, Output, Sink};

/// Bytes of the memory for `words` saved words.
#[must_use]
pub const fn bytes(words: usize) -> u16 {
    (2 * words + 2) as u16
}

/// What a memory holds.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Content {
    /// Nothing was ever saved: the drive is new.
    New,
    /// An image that passes.
    Good,
    /// Something else.
    Bad,
}

/// Judges the memory of a map with `words` saved words.
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

/// Brings the saved rows of a bank to their factory values.
pub fn reset(entries: &Entries, bank: &mut [u16]) {
    for (index, row) in entries.list.iter().enumerate().filter(|(_, row)| row.saved != 0) {
        entries.put(bank, index, row.reset);
    }
}

/// Brings the saved words of an image that passes into a bank; bits that are not saved are cleared.
pub fn load(entries: &Entries, memory: &[u8], bank: &mut [u16]) {
    for ((place, mask), word) in saved_words(entries).zip(memory.as_chunks().0) {
        if let Some(target) = bank.get_mut(place) {
            *target = u16::from_be_bytes(*word) & mask;
        }
    }
}

/// Stores the image of a bank with a wrong CRC, and returns the right one for [`finish`].
pub fn begin<const BYTES: usize>(
    entries: &Entries,
    bank: &[u16],
    at: Instant,
    out: &mut dyn Sink,
) -> [u8; 2] {
    let mut memory = [0; BYTES];
    for ((place, mask), word) in saved_words(entries).zip(memory.as_chunks_mut().0) {
        *word = (bank.get(place).copied().unwrap_or(0) & mask).to_be_bytes();
    }
    let mut right = [0; 2];
    if let Some((image, sum)) = memory.split_last_chunk_mut::<2>() {
        right = crc(image).to_be_bytes();
        *sum = right.map(|byte| !byte);
    }
    out.put(at, Output::Store { offset: 0, bytes: &memory });
    right
}

/// Stores the CRC that [`begin`] returned: now the image passes.
pub fn finish<const BYTES: usize>(crc: [u8; 2], at: Instant, out: &mut dyn Sink) {
    out.put(at, Output::Store { offset: (BYTES - 2) as u16, bytes: &crc });
}

/// Place in the bank and saved bits of every saved word.
fn saved_words(entries: &Entries) -> impl Iterator<Item = (usize, u16)> + '_ {
    entries.list.iter().enumerate().filter(|(_, row)| row.saved != 0).flat_map(|(index, row)| {
        let place = entries.place(index);
        (0..usize::from(row.shape.words())).map(move |n| (place + n, row.saved))
    })
}
