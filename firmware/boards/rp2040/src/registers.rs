//! Registers of the RP2040.

use drivetwin_board::Chip;

/// The chip.
#[derive(Clone, Copy)]
pub(crate) enum Rp2040 {}

/// A register of this chip.
pub(crate) type Register = drivetwin_board::Register<Rp2040>;

// SAFETY: this crate alone makes registers of it, of peripherals as the datasheet has them.
unsafe impl Chip for Rp2040 {
    /// Sets bits in one write that nothing comes between (2.1.2); not of the SIO.
    fn set(register: Register, bits: u32) {
        register.plus(0x2000).write(bits);
    }

    /// Clears bits as `set` sets them.
    fn clear(register: Register, bits: u32) {
        register.plus(0x3000).write(bits);
    }
}
