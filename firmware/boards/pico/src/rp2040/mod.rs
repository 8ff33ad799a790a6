//! The RP2040: addresses, interrupts, and code that the RP2350 has not. Sections cited are those of the *RP2040 Datasheet*.

mod boot;
pub(crate) mod clock;
pub(crate) mod rom;

use core::ops::Range;

use crate::registers::Register;

/// Name of the Pico for `drivetwin flash`.
pub(crate) const BOARD: &str = "pico";
/// Size of the Pico's flash chip in bytes.
pub(crate) const FLASH: usize = 2 << 20;
/// RAM for an image. The stack of the selector is behind it.
pub(crate) const RAM: Range<usize> = 0x2000_0000..0x2004_0000;

/// An interrupt, with its position in the vector table as its value (2.3.2).
#[derive(Clone, Copy)]
#[expect(non_camel_case_types, reason = "the names are those of the chip")]
pub(crate) enum Interrupt {
    TIMER_IRQ_0 = 0,
    TIMER_IRQ_1 = 1,
    TIMER_IRQ_2 = 2,
    USBCTRL_IRQ = 5,
    IO_IRQ_BANK0 = 13,
    UART0_IRQ = 20,
}

/// Number of vectors in the table.
pub(crate) const VECTORS: usize = 32;

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

/// The watchdog (4.7.6), and the parts of the chip that its reset resets (2.13.5): all except the oscillators.
pub(crate) const WATCHDOG: Register = Register::at(0x4005_8000, 0);
pub(crate) const PSM_WDSEL: Register = Register::at(0x4001_0000, 0x8);
pub(crate) const RESET_PARTS: u32 = 0x1_FFFC;
/// Counts of the watchdog in a microsecond: it counts down by two (RP2040-E1).
pub(crate) const WATCHDOG_COUNTS: u32 = 2;

/// Revision of the chip (2.20.2).
const CHIP_ID: Register = Register::at(0x4000_0000, 0x00);

/// Returns `true` if the USB controller can take back a packet. The first revisions cannot (RP2040-E2).
pub(crate) fn can_abort() -> bool {
    CHIP_ID.read() >> 28 >= 2
}
