//! Simulated hardware for firmware and for drivers that use embedded-hal.

pub mod spi;
pub mod virtual_board;
