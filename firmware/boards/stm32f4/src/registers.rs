//! Registers of the hardware: the one place that touches them.

use core::ptr::{read_volatile, write_volatile};

/// A 32-bit register of a peripheral.
#[derive(Clone, Copy)]
pub(crate) struct Register(usize);

impl Register {
    /// The register at `offset` of the peripheral at `base`, both from the reference manual.
    pub(crate) const fn at(base: usize, offset: usize) -> Self {
        Self(base + offset)
    }

    #[inline]
    pub(crate) fn read(self) -> u32 {
        // SAFETY: every `Register` is a word of a peripheral of the STM32F411: aligned, always mapped, and
        // nobody's memory.
        unsafe { read_volatile(self.0 as *const u32) }
    }

    #[inline]
    pub(crate) fn write(self, value: u32) {
        // SAFETY: as in `read`; no register that this crate names changes memory by itself.
        unsafe { write_volatile(self.0 as *mut u32, value) }
    }

    /// Sets bits; no interrupt comes between.
    pub(crate) fn set(self, bits: u32) {
        self.replace(bits, bits);
    }

    /// Clears bits as [`set`](Self::set) sets them.
    pub(crate) fn clear(self, bits: u32) {
        self.replace(bits, 0);
    }

    /// Makes the bits of `mask` those of `bits`; no interrupt comes between.
    pub(crate) fn replace(self, mask: u32, bits: u32) {
        critical_section::with(|_| self.write(self.read() & !mask | bits));
    }
}
