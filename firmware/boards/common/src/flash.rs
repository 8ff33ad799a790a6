//! Flash that a processor reads as memory, and erases and programs by itself.

use core::marker::PhantomData;
use core::ops::Range;

use embedded_storage_async::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};

/// The part of a board's flash that holds saved registers. Its functions return when they are done; interrupts go on
/// during that, and the events that they catch must fit into the queue.
pub trait Sectors: Copy {
    /// The part itself.
    const OURS: Range<u32>;
    /// Bytes of all of the flash.
    const CAPACITY: usize;
    /// Bytes that are erased at once.
    const SECTOR: usize;
    /// Bytes whose multiples can be programmed.
    const WORD: usize;
    /// Bytes that are programmed at once at most, from a multiple of them on.
    const PAGE: usize;

    /// A byte of ours.
    fn read(offset: u32) -> u8;

    /// Erases the sector that begins at `offset`.
    ///
    /// # Errors
    /// If the flash reports one.
    fn erase(offset: u32) -> Result<(), NorFlashErrorKind>;

    /// Programs words of one page.
    ///
    /// # Errors
    /// If the flash reports one.
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

    /// Checks that `count` bytes from `offset` on are ours, and both are multiples of `unit`.
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
