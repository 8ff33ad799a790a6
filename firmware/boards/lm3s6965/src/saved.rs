//! Saved registers in RAM, because QEMU's flash is read-only.

use core::cell::UnsafeCell;
use core::convert::Infallible;
use core::ptr::write_volatile;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use cortex_m::peripheral::SCB;
use embedded_storage::{ReadStorage, Storage};

/// Marks a memory that was written. RAM with random content after power-on does not have this mark.
const WRITTEN: [u32; 2] = [0x7374_616E, 0x6469_6E21];

/// `N` bytes that survive a reset, but not a loss of power. They must be in a section that the start does not
/// clear, `.uninit`.
#[repr(C)]
pub struct Saved<const N: usize> {
    written: [AtomicU32; 2],
    bytes: UnsafeCell<[u8; N]>,
}

// SAFETY: `begin` lends the bytes once, and no other code accesses them.
unsafe impl<const N: usize> Sync for Saved<N> {}

impl<const N: usize> Default for Saved<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize> Saved<N> {
    /// Memory that is not marked as written yet.
    #[must_use]
    pub const fn new() -> Self {
        Self { written: [const { AtomicU32::new(0) }; 2], bytes: UnsafeCell::new([0; N]) }
    }

    /// Lends the bytes, once after each start. If the memory was never written, all bytes become `0xFF`.
    pub(crate) fn begin(&'static self) -> Memory<N> {
        /// True after the memory was lent. A board has one memory. Unlike the memory, this flag is cleared at
        /// a start.
        static LENT: AtomicBool = AtomicBool::new(false);
        if LENT.swap(true, Ordering::Relaxed) {
            SCB::sys_reset();
        }
        // SAFETY: this line runs only once, so there is no other reference to the bytes; every byte value is
        // valid.
        let bytes = unsafe { &mut *self.bytes.get() };
        let written = || self.written.iter().zip(WRITTEN);
        if !written().all(|(word, expected)| word.load(Ordering::Relaxed) == expected) {
            bytes.fill(0xFF);
            written().for_each(|(word, expected)| word.store(expected, Ordering::Relaxed));
        }
        Memory { bytes }
    }
}

/// The memory of a drive.
pub(crate) struct Memory<const N: usize> {
    bytes: &'static mut [u8; N],
}

impl<const N: usize> AsRef<[u8]> for Memory<N> {
    fn as_ref(&self) -> &[u8] {
        self.bytes
    }
}

impl<const N: usize> ReadStorage for Memory<N> {
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

impl<const N: usize> Storage for Memory<N> {
    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Infallible> {
        for (stored, byte) in self.bytes.iter_mut().skip(offset as usize).zip(bytes) {
            // The bytes are written in order and at once, because a reset may occur at any time.
            // SAFETY: `stored` is a valid reference.
            unsafe { write_volatile(stored, *byte) };
        }
        Ok(())
    }
}
