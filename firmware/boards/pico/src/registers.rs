//! Registers of the chip.

use drivetwin_board::Chip;

/// The chip.
#[derive(Clone, Copy)]
pub(crate) enum Rp {}

/// A register of this chip.
pub(crate) type Register = drivetwin_board::Register<Rp>;

// SAFETY: only this crate makes registers of this chip, and only of peripherals, at the addresses of the
// datasheet. The memory of the USB controller is among them: no variable lies there.
unsafe impl Chip for Rp {
    /// Sets bits by one atomic write (2.1.2; RP2350: 2.1.3). Not possible for registers of the SIO.
    fn set(register: Register, bits: u32) {
        register.plus(0x2000).write(bits);
    }

    /// Clears bits, in the same way as `set`.
    fn clear(register: Register, bits: u32) {
        register.plus(0x3000).write(bits);
    }
}
