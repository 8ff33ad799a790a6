//! Several kinds of drive on one board: a directory of their images in flash, and the kind that was chosen (BOARD-13).

use core::str;

use drivetwin_control::Refused;

use crate::flash::Sectors;

/// Number of bytes for the name of a kind. A shorter name ends in zeros.
const NAME: usize = 16;

/// Name of a kind, from its bytes; `None` if they are no name.
fn name(bytes: &[u8]) -> Option<&str> {
    let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
    let name = bytes.get(..end).and_then(|name| str::from_utf8(name).ok());
    name.filter(|name| !name.is_empty() && name.is_ascii())
}

/// The bytes of a name; `None` if the name is too long or empty.
fn padded(name: &str) -> Option<[u8; NAME]> {
    let mut bytes = [0; NAME];
    bytes.get_mut(..name.len()).filter(|place| !place.is_empty())?.copy_from_slice(name.as_bytes());
    Some(bytes)
}

/// An image in flash.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Image<'a> {
    /// Kind of the drive.
    pub kind: &'a str,
    /// Offset in flash, in bytes, a multiple of four.
    pub offset: u32,
    /// Length in bytes, a multiple of four.
    pub bytes: u32,
    /// [Sum](sum()) of its words.
    pub sum: u32,
}

/// Sum of words, which depends on their order.
#[must_use]
pub fn sum(words: &[u32]) -> u32 {
    words.iter().fold(0, |sum: u32, word| sum.rotate_left(1).wrapping_add(*word))
}

impl Image<'_> {
    /// The image's words in `flash`; `None` if they are not all there.
    #[must_use]
    pub fn words<'f>(&self, flash: &'f [u32]) -> Option<&'f [u32]> {
        let (begin, count) = (self.offset as usize / 4, self.bytes as usize / 4);
        flash.get(begin..begin.checked_add(count)?)
    }

    /// Returns `true` if these are the words that the directory was made for.
    #[must_use]
    pub fn is(&self, words: &[u32]) -> bool {
        size_of_val(words) == self.bytes as usize && sum(words) == self.sum
    }
}

/// The images in the flash of a board. The first one is that of the kind that the board is before any choice.
#[derive(Clone, Copy, Debug)]
pub struct Directory<'a>(&'a [u8]);

/// Bytes at the beginning of a directory.
const MARK: [u8; 8] = *b"drives\x001";
/// Number of bytes of an entry: a name, and three words with the lower byte first.
const ENTRY: usize = NAME + 12;

impl<'a> Directory<'a> {
    /// Number of bytes of a directory.
    pub const BYTES: usize = 256;
    /// Greatest number of images in a directory.
    pub const MOST: usize = (Self::BYTES - MARK.len()) / ENTRY;

    /// The directory in these bytes; `None` if they are none.
    #[must_use]
    pub fn read(bytes: &'a [u8]) -> Option<Self> {
        bytes.get(..Self::BYTES)?.strip_prefix(&MARK).map(Self)
    }

    /// The bytes of a directory; `None` if there are too many images, or a name is too long.
    #[must_use]
    pub fn write(images: &[Image<'_>]) -> Option<[u8; Directory::BYTES]> {
        let mut bytes = [0; Self::BYTES];
        let (mark, places) = bytes.split_at_mut(MARK.len());
        mark.copy_from_slice(&MARK);
        let mut places = places.chunks_exact_mut(ENTRY);
        for image in images {
            let (kind, numbers) = places.next()?.split_at_mut(NAME);
            kind.copy_from_slice(&padded(image.kind)?);
            for (place, number) in numbers.chunks_exact_mut(4).zip([image.offset, image.bytes, image.sum]) {
                place.copy_from_slice(&number.to_le_bytes());
            }
        }
        Some(bytes)
    }

    /// The image with this number, from 0 on; `None` behind the last one.
    #[must_use]
    pub fn image(&self, number: usize) -> Option<Image<'a>> {
        let (kind, numbers) = self.0.chunks_exact(ENTRY).nth(number)?.split_at_checked(NAME)?;
        let mut numbers = numbers.as_chunks().0.iter().map(|word| u32::from_le_bytes(*word));
        let mut next = || numbers.next().unwrap_or(0);
        Some(Image { kind: name(kind)?, offset: next(), bytes: next(), sum: next() })
    }

    /// The image of a kind.
    #[must_use]
    pub fn find(&self, kind: &str) -> Option<Image<'a>> {
        (0..Self::MOST).map_while(|number| self.image(number)).find(|image| image.kind == kind)
    }
}

/// Number of bytes of a choice without their complement: its number, lower byte first, and the name of the kind.
const PLAIN: usize = 4 + NAME;

/// A kind that was chosen, as one of two sectors holds it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Choice {
    /// Offset of the sector.
    offset: u32,
    /// Number of the choice; that of the next one is higher.
    number: u32,
    kind: [u8; NAME],
}

impl Choice {
    /// The last choice. `sectors` are the offsets of the two sectors, and `read` reads a byte at an offset.
    #[must_use]
    pub fn last(sectors: [u32; 2], read: impl Fn(u32) -> u8) -> Option<Self> {
        sectors.into_iter().filter_map(|offset| Self::at(offset, &read)).max_by_key(|choice| choice.number)
    }

    /// The choice in the sector at `offset`. After each byte follows its complement. So nothing is a choice in which bits
    /// are not yet programmed or not yet erased: in a part of a choice, all bits of a pair are equal.
    fn at(offset: u32, read: &impl Fn(u32) -> u8) -> Option<Self> {
        let mut plain = [0; PLAIN];
        for (byte, at) in plain.iter_mut().zip((offset..).step_by(2)) {
            *byte = read(at);
            if read(at + 1) != !*byte {
                return None;
            }
        }
        let (number, kind) = plain.split_first_chunk()?;
        Some(Self { offset, number: u32::from_le_bytes(*number), kind: kind.try_into().ok()? })
    }

    /// Kind that was chosen.
    #[must_use]
    pub fn kind(&self) -> Option<&str> {
        name(&self.kind)
    }

    /// Stores a choice in one of the two `sectors`, while the other one keeps the last choice. After a power cut the last
    /// choice or the new one is there.
    ///
    /// # Errors
    /// The flash does not take the choice, or the name is too long.
    pub fn store<S: Sectors>(sectors: [u32; 2], kind: &str) -> Result<(), Refused> {
        let last = Self::last(sectors, S::read);
        if last.is_some_and(|last| last.kind() == Some(kind)) {
            return Ok(());
        }
        let [first, second] = sectors;
        let (offset, number) = match last {
            Some(last) => (if last.offset == first { second } else { first }, last.number.wrapping_add(1)),
            None => (first, 0),
        };
        let new = Self { offset, number, kind: padded(kind).ok_or(Refused::Unknown)? };
        let mut bytes = [0; 2 * PLAIN];
        let plain = new.number.to_le_bytes().into_iter().chain(new.kind);
        for (place, byte) in bytes.iter_mut().zip(plain.flat_map(|byte| [byte, !byte])) {
            *place = byte;
        }
        S::erase(offset).map_err(|_| Refused::Flash)?;
        S::program(offset, &bytes).map_err(|_| Refused::Flash)?;
        if Self::last(sectors, S::read) == Some(new) { Ok(()) } else { Err(Refused::Flash) }
    }
}
