//! What boards have in common.
//!
//! A board brings a UART, pins, a memory, a step timer and a clock. Its interrupts put what they catch
//! into a [`Queue`] and fire the [`Axis`]; its loop turns a [`Shell`](drivetwin_firmware::shell::Shell) over
//! [`Hands`].
#![no_std]

mod axis;
mod hands;
#[cfg(feature = "network")]
mod long;
#[cfg(feature = "network")]
pub mod network;
mod pl011;
mod queue;
mod saved;
mod slips;
mod usart;
mod wire;

pub use axis::{Axis, Timer};
pub use hands::{Bus, Hands, Release};
pub use pl011::Pl011;
pub use queue::Queue;
pub use saved::{Saved, Unreadable};
pub use slips::{SLIPPED, untold};
pub use usart::Usart;
pub use wire::{AxisPins, End, is_full_duplex};

/// Makes a drive where it stays. What that takes of the stack beside the drive itself is free again when it returns.
#[inline(never)]
pub fn made<D>(make: fn() -> D) -> D {
    make()
}
