//! Saved registers in RAM: QEMU's flash can only be read.

use core::convert::Infallible;
use core::sync::atomic::{AtomicU8, AtomicU32, Ordering};

use embedded_storage::{ReadStorage, Storage};

/// What says that the memory was ever written. RAM that comes up by chance is not this.
const WRITTEN: [u32; 2] = [0x7374_616E, 0x6469_6E21];

/// `N` bytes that survive a reset, but not that the board has no power. They belong into a section that
/// nothing clears, `.uninit`.
#[repr(C)]
pub struct Saved<const N: usize> {
    written: [AtomicU32; 2],
    bytes: [AtomicU8; N],
}

impl<const N: usize> Default for Saved<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize> Saved<N> {
    /// A place for them.
    #[must_use]
    pub const fn new() -> Self {
        Self { written: [const { AtomicU32::new(0) }; 2], bytes: [const { AtomicU8::new(0) }; N] }
    }

    /// Reads them into `bytes`; a memory that was never written becomes a new one, all `0xFF`.
    pub(crate) fn begin<'a>(&'static self, bytes: &'a mut [u8; N]) -> Memory<'a, N> {
        let written = || self.written.iter().zip(WRITTEN);
        if !written().all(|(word, expected)| word.load(Ordering::Relaxed) == expected) {
            for byte in &self.bytes {
                byte.store(0xFF, Ordering::Relaxed);
            }
            written().for_each(|(word, expected)| word.store(expected, Ordering::Relaxed));
        }
        for (byte, stored) in bytes.iter_mut().zip(&self.bytes) {
            *byte = stored.load(Ordering::Relaxed);
        }
        Memory { saved: self, bytes }
    }
}

/// The memory of a drive.
pub(crate) struct Memory<'a, const N: usize> {
    saved: &'static Saved<N>,
    /// The same bytes, as the drive reads them.
    bytes: &'a mut [u8; N],
}

impl<const N: usize> AsRef<[u8]> for Memory<'_, N> {
    fn as_ref(&self) -> &[u8] {
        self.bytes
    }
}

impl<const N: usize> ReadStorage for Memory<'_, N> {
    type Error = Infallible;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Infallible> {
        for (byte, stored) in bytes.iter_mut().zip(self.bytes.iter().skip(offset as usize)) {
            *byte = *stored;
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        N
    }
}

impl<const N: usize> Storage for Memory<'_, N> {
    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Infallible> {
        let places = self.bytes.iter_mut().zip(&self.saved.bytes).skip(offset as usize);
        for (byte, (copy, stored)) in bytes.iter().zip(places) {
            *copy = *byte;
            stored.store(*byte, Ordering::Relaxed);
        }
        Ok(())
    }
}
