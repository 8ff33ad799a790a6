//! Registers of the hardware: the one place that touches them (BOARD-4).

use core::marker::PhantomData;
use core::ptr::{read_volatile, write_volatile};

/// A chip, defined by the crate of a board.
///
/// # Safety
/// Every [`Register`] that is made of it is a word of a peripheral of the chip: aligned, always mapped, and no
/// memory. None of them changes memory by itself.
pub unsafe trait Chip: Copy {
    /// Sets bits of a register; no interrupt comes between.
    fn set(register: Register<Self>, bits: u32) {
        register.replace(bits, bits);
    }

    /// Clears bits as [`set`](Self::set) sets them.
    fn clear(register: Register<Self>, bits: u32) {
        register.replace(bits, 0);
    }
}

/// A 32-bit register of a peripheral.
#[derive(Clone, Copy, Debug)]
pub struct Register<C>(usize, PhantomData<C>);

impl<C: Chip> Register<C> {
    /// The register at `offset` of the peripheral at `base`, both from the datasheet.
    #[must_use]
    pub const fn at(base: usize, offset: usize) -> Self {
        Self(base + offset, PhantomData)
    }

    /// The register that is that many bytes after this one.
    #[must_use]
    pub const fn plus(self, bytes: usize) -> Self {
        Self::at(self.0, bytes)
    }

    /// Reads it.
    #[must_use]
    #[inline]
    pub fn read(self) -> u32 {
        // SAFETY: `Chip` promises a word that is aligned and always mapped.
        unsafe { read_volatile(self.0 as *const u32) }
    }

    /// Writes it.
    #[inline]
    pub fn write(self, value: u32) {
        // SAFETY: as in `read`; `Chip` promises that it is no memory, and changes none.
        unsafe { write_volatile(self.0 as *mut u32, value) }
    }

    /// Sets bits, as the [chip](Chip::set) does that.
    pub fn set(self, bits: u32) {
        C::set(self, bits);
    }

    /// Clears bits, as the [chip](Chip::clear) does that.
    pub fn clear(self, bits: u32) {
        C::clear(self, bits);
    }

    /// Makes the bits of `mask` those of `bits`; no interrupt comes between.
    pub fn replace(self, mask: u32, bits: u32) {
        critical_section::with(|_| self.write(self.read() & !mask | bits));
    }
}
