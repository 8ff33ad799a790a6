//! Simulated hardware for firmware and drivers over embedded-hal.

pub mod spi;
pub mod virtual_board;
