//! Addresses and interrupts of what the RP2040 and the RP2350 have in common. The code of the Pico 2 uses the
//! modules `bus`, `log`, `pins`, `steps`, `timer` and `wires` with a module `chip` of its own.

pub(crate) use rp2040_pac::{Interrupt, interrupt};

use crate::registers::Register;
pub(crate) use crate::registers::Rp2040 as This;

/// UART0 (4.2.8).
pub(crate) const UART0: Register = Register::at(0x4003_4000, 0);

/// TIMER (4.6.5).
const TIMER: usize = 0x4005_4000;
/// The first of the alarms.
pub(crate) const ALARM: Register = Register::at(TIMER, 0x10);
pub(crate) const ARMED: Register = Register::at(TIMER, 0x20);
pub(crate) const RAW_HIGH: Register = Register::at(TIMER, 0x24);
pub(crate) const RAW_LOW: Register = Register::at(TIMER, 0x28);
pub(crate) const INTR: Register = Register::at(TIMER, 0x34);
pub(crate) const INTE: Register = Register::at(TIMER, 0x38);

/// The single-cycle IO (2.3.1.7).
const SIO: usize = 0xD000_0000;
pub(crate) const IN: Register = Register::at(SIO, 0x04);
pub(crate) const OUT_SET: Register = Register::at(SIO, 0x14);
pub(crate) const OUT_CLEAR: Register = Register::at(SIO, 0x18);
pub(crate) const DRIVEN_SET: Register = Register::at(SIO, 0x24);
pub(crate) const DRIVEN_CLEAR: Register = Register::at(SIO, 0x28);

/// The functions of the pins, and their interrupts (2.19.6.1).
const IO: usize = 0x4001_4000;
/// Function of GP0. That of the next pin is two words further.
pub(crate) const FUNCTION: Register = Register::at(IO, 0x04);
/// Interrupts of GP0 to GP7. Those of the next eight pins are in the next register.
pub(crate) const RAISED: Register = Register::at(IO, 0xF0);
pub(crate) const ENABLED: Register = Register::at(IO, 0x100);
pub(crate) const STATUS: Register = Register::at(IO, 0x120);

/// Pull resistors of GP0 (2.19.6.3). Those of the next pin are in the next register.
pub(crate) const PAD: Register = Register::at(0x4001_C000, 0x04);
