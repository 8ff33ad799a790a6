//! Flash that a processor reads as memory, and erases and programs itself.

use core::marker::PhantomData;
use core::ops::Range;

use embedded_storage_async::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};

/// The part of a board's flash for saved registers. Each function returns when its operation is done.
/// Interrupts continue meanwhile, and their events must fit into the queue.
pub trait Sectors: Copy {
    /// Range of this part.
    const OURS: Range<u32>;
    /// Size of the whole flash in bytes.
    const CAPACITY: usize;
    /// Number of bytes that are erased at once.
    const SECTOR: usize;
    /// Smallest number of bytes that can be programmed. Offsets and lengths are multiples of this number.
    const WORD: usize;
    /// Largest number of bytes that are programmed at once. They do not cross an offset that is a multiple of
    /// this number.
    const PAGE: usize;

    /// Reads a byte of this part.
    fn read(offset: u32) -> u8;

    /// Erases the sector that begins at `offset`.
    ///
    /// # Errors
    /// The flash reports an error.
    fn erase(offset: u32) -> Result<(), NorFlashErrorKind>;

    /// Programs words of one page.
    ///
    /// # Errors
    /// The flash reports an error.
    fn program(offset: u32, words: &[u8]) -> Result<(), NorFlashErrorKind>;
}

/// The flash of a board.
#[derive(Clone, Copy, Debug)]
pub struct Flash<S>(PhantomData<S>);

impl<S: Sectors> Flash<S> {
    /// The flash.
    #[expect(clippy::new_without_default, reason = "there is only one")]
    #[must_use]
    pub const fn new() -> Self {
        Self(PhantomData)
    }

    /// Checks that `count` bytes from `offset` on are in this part, and that both numbers are multiples of
    /// `unit`.
    fn check(offset: u32, count: usize, unit: usize) -> Result<(), NorFlashErrorKind> {
        let end = u32::try_from(count).ok().and_then(|count| offset.checked_add(count));
        if !end.is_some_and(|end| S::OURS.start <= offset && end <= S::OURS.end) {
            return Err(NorFlashErrorKind::OutOfBounds);
        }
        let is_aligned = (offset as usize).is_multiple_of(unit) && count.is_multiple_of(unit);
        if is_aligned { Ok(()) } else { Err(NorFlashErrorKind::NotAligned) }
    }

    /// Programs words, page by page.
    #[inline(never)]
    fn program(offset: u32, words: &[u8]) -> Result<(), NorFlashErrorKind> {
        Self::check(offset, words.len(), S::WORD)?;
        let (mut at, mut rest) = (offset, words);
        while !rest.is_empty() {
            let room = S::PAGE - at as usize % S::PAGE;
            let (words, behind) = rest.split_at_checked(room).unwrap_or((rest, &[]));
            S::program(at, words)?;
            at += words.len() as u32;
            rest = behind;
        }
        Ok(())
    }
}

impl<S> ErrorType for Flash<S> {
    type Error = NorFlashErrorKind;
}

impl<S: Sectors> ReadNorFlash for Flash<S> {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        Self::check(offset, bytes.len(), Self::READ_SIZE)?;
        for (at, byte) in (offset..).zip(bytes) {
            *byte = S::read(at);
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        S::CAPACITY
    }
}

impl<S: Sectors> NorFlash for Flash<S> {
    const WRITE_SIZE: usize = S::WORD;
    const ERASE_SIZE: usize = S::SECTOR;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        Self::check(from, to.saturating_sub(from) as usize, S::SECTOR)?;
        (from..to).step_by(S::SECTOR).try_for_each(S::erase)
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        Self::program(offset, bytes)
    }
}
