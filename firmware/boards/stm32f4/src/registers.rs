//! Registers of the STM32F411.

use drivetwin_board::Chip;

/// The chip.
#[derive(Clone, Copy)]
pub(crate) enum Stm32f411 {}

/// A register of this chip.
pub(crate) type Register = drivetwin_board::Register<Stm32f411>;

// SAFETY: this crate alone makes registers of it, of peripherals as the reference manual has them.
unsafe impl Chip for Stm32f411 {}
