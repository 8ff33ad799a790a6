//! Registers of the hardware. Only this file accesses them (BOARD-4).

use core::marker::PhantomData;
use core::ptr::{read_volatile, write_volatile};

/// A chip. The crate of a board defines it.
///
/// # Safety
/// Every [`Register`] that is made with this type is a word of a peripheral of the chip: aligned, always
/// mapped, and not memory. No register changes memory by itself.
pub unsafe trait Chip: Copy {
    /// Sets bits of a register; no interrupt can occur in between.
    fn set(register: Register<Self>, bits: u32) {
        register.replace(bits, bits);
    }

    /// Clears bits, in the same way as [`set`](Self::set).
    fn clear(register: Register<Self>, bits: u32) {
        register.replace(bits, 0);
    }
}

/// A 32-bit register of a peripheral.
#[derive(Clone, Copy, Debug)]
pub struct Register<C>(usize, PhantomData<C>);

impl<C: Chip> Register<C> {
    /// The register at `offset` in the peripheral at `base`, both as in the datasheet.
    #[must_use]
    pub const fn at(base: usize, offset: usize) -> Self {
        Self(base + offset, PhantomData)
    }

    /// The register `bytes` bytes after this one.
    #[must_use]
    pub const fn plus(self, bytes: usize) -> Self {
        Self::at(self.0, bytes)
    }

    /// The address of the register.
    #[must_use]
    pub const fn address(self) -> usize {
        self.0
    }

    /// Reads the register.
    #[must_use]
    #[inline]
    pub fn read(self) -> u32 {
        // SAFETY: `Chip` guarantees a word that is aligned and always mapped.
        unsafe { read_volatile(self.0 as *const u32) }
    }

    /// Writes the register.
    #[inline]
    pub fn write(self, value: u32) {
        // SAFETY: as in `read`. `Chip` guarantees that the register is not memory and changes none.
        unsafe { write_volatile(self.0 as *mut u32, value) }
    }

    /// Sets bits, in the way of the [chip](Chip::set).
    pub fn set(self, bits: u32) {
        C::set(self, bits);
    }

    /// Clears bits, in the way of the [chip](Chip::clear).
    pub fn clear(self, bits: u32) {
        C::clear(self, bits);
    }

    /// Replaces the bits in `mask` by those of `bits`; no interrupt can occur in between.
    pub fn replace(self, mask: u32, bits: u32) {
        critical_section::with(|_| self.write(self.read() & !mask | bits));
    }
}
