//! Registers of the LM3S6965.

use drivetwin_board::Chip;

/// The chip.
#[derive(Clone, Copy)]
pub(crate) enum Lm3s6965 {}

/// A register of this chip.
pub(crate) type Register = drivetwin_board::Register<Lm3s6965>;

// SAFETY: only this crate makes registers of this chip, and only of peripherals, at the addresses of the
// datasheet.
unsafe impl Chip for Lm3s6965 {
    /// Sets bits. Must not be used for a register that an interrupt also changes.
    fn set(register: Register, bits: u32) {
        register.write(register.read() | bits);
    }

    fn clear(register: Register, bits: u32) {
        register.write(register.read() & !bits);
    }
}
