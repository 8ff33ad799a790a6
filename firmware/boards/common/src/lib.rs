//! Code that boards share.
//!
//! A board provides a UART, pins, a memory, a step timer and a clock. Its interrupts put events into a
//! [`Queue`], call the [`SerialBus`] to send, and fire the [`Axis`]. Its loop, [`run`], runs a
//! [`Shell`](drivetwin_firmware::shell::Shell) over [`BoardOutputs`]. The trait [`Board`] lists what a board
//! must provide for that. On a board with a USB [`Cable`] the loop has a [`station`] for the computer at its other end.
#![no_std]

mod axis;
mod board;
mod board_outputs;
mod boot;
mod bus;
mod cable;
mod flash;
mod kinds;
#[cfg(feature = "network")]
mod long;
#[cfg(feature = "network")]
pub mod network;
mod output;
mod pl011;
mod queue;
#[expect(unsafe_code, reason = "registers of the hardware are `unsafe` to touch")]
mod register;
mod saved;
mod slips;
pub mod station;
mod steps;
mod tap;
mod usart;
mod usb_cable;
mod usb_serial;
mod wire;

pub use axis::{Axis, Timer};
pub use board::{Board, Leave, is_awake, made, run, sleep_until};
pub use board_outputs::{BoardOutputs, Bus, Release};
pub use bus::{Sender, SerialBus, Uart};
pub use cable::{Cable, CablePort, NoCable};
pub use flash::{Flash, Sectors};
pub use kinds::{Choice, Directory, Image, sum};
pub use output::{Gpio, Output};
pub use pl011::{Pl011, Pl011Uart};
pub use queue::Queue;
pub use register::{Chip, Register};
pub use saved::{Saved, Unreadable};
pub use slips::{SLIPPED, untold};
pub use steps::{StepPins, StepPort};
pub use tap::Tap;
pub use usart::Usart;
pub use usb_cable::{UsbCable, hex};
pub use usb_serial::{Endpoints, UsbSerial, line_of};
pub use wire::{AxisPins, End, is_full_duplex};
