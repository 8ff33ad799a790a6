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

    /// Makes a memory that was never written a new one, all `0xFF`.
    pub(crate) fn begin(&'static self) -> Memory<N> {
        let written = || self.written.iter().zip(WRITTEN);
        if !written().all(|(word, expected)| word.load(Ordering::Relaxed) == expected) {
            for byte in &self.bytes {
                byte.store(0xFF, Ordering::Relaxed);
            }
            written().for_each(|(word, expected)| word.store(expected, Ordering::Relaxed));
        }
        Memory(self)
    }
}

/// The memory of a drive.
pub(crate) struct Memory<const N: usize>(&'static Saved<N>);

impl<const N: usize> ReadStorage for Memory<N> {
    type Error = Infallible;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Infallible> {
        for (byte, stored) in bytes.iter_mut().zip(self.0.bytes.iter().skip(offset as usize)) {
            *byte = stored.load(Ordering::Relaxed);
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        N
    }
}

impl<const N: usize> Storage for Memory<N> {
    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Infallible> {
        for (byte, stored) in bytes.iter().zip(self.0.bytes.iter().skip(offset as usize)) {
            stored.store(*byte, Ordering::Relaxed);
        }
        Ok(())
    }
}
