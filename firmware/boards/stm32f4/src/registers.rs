//! Registers of the STM32F411.

use drivetwin_board::Chip;

/// The chip.
#[derive(Clone, Copy)]
pub(crate) enum Stm32f411 {}

/// A register of this chip.
pub(crate) type Register = drivetwin_board::Register<Stm32f411>;

// SAFETY: only this crate makes registers of this chip, and only of peripherals, at the addresses of the
// manual.
unsafe impl Chip for Stm32f411 {}
