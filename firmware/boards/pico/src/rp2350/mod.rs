//! The RP2350: addresses, interrupts, and code that the RP2040 has not. Sections cited are those of the *RP2350 Datasheet*.

mod boot;
pub(crate) mod clock;
pub(crate) mod rom;

use core::ops::Range;

use crate::registers::Register;

/// Name of the Pico 2 for `drivetwin flash`.
pub(crate) const BOARD: &str = "pico2";
/// Size of the Pico 2's flash chip in bytes.
pub(crate) const FLASH: usize = 4 << 20;
/// RAM for an image. The stack of the selector is behind it.
pub(crate) const RAM: Range<usize> = 0x2000_0000..0x2008_0000;

/// An interrupt, with its position in the vector table as its value (3.2). The names are those of the RP2040.
#[derive(Clone, Copy)]
#[expect(non_camel_case_types, reason = "the names are those of the RP2040")]
pub(crate) enum Interrupt {
    TIMER_IRQ_0 = 0,
    TIMER_IRQ_1 = 1,
    TIMER_IRQ_2 = 2,
    USBCTRL_IRQ = 14,
    IO_IRQ_BANK0 = 21,
    UART0_IRQ = 33,
}

/// Number of vectors in the table.
pub(crate) const VECTORS: usize = 52;

/// UART0 (12.1).
pub(crate) const UART0: Register = Register::at(0x4007_0000, 0);

/// TIMER0 (12.8).
const TIMER: usize = 0x400B_0000;
/// The first of the alarms.
pub(crate) const ALARM: Register = Register::at(TIMER, 0x10);
pub(crate) const ARMED: Register = Register::at(TIMER, 0x20);
pub(crate) const RAW_HIGH: Register = Register::at(TIMER, 0x24);
pub(crate) const RAW_LOW: Register = Register::at(TIMER, 0x28);
pub(crate) const INTR: Register = Register::at(TIMER, 0x3C);
pub(crate) const INTE: Register = Register::at(TIMER, 0x40);

/// The single-cycle IO (3.1.11).
const SIO: usize = 0xD000_0000;
pub(crate) const IN: Register = Register::at(SIO, 0x04);
pub(crate) const OUT_SET: Register = Register::at(SIO, 0x18);
pub(crate) const OUT_CLEAR: Register = Register::at(SIO, 0x20);
pub(crate) const DRIVEN_SET: Register = Register::at(SIO, 0x38);
pub(crate) const DRIVEN_CLEAR: Register = Register::at(SIO, 0x40);

/// The functions of the pins, and their interrupts (9.11).
const IO: usize = 0x4002_8000;
/// Function of GP0. That of the next pin is two words further.
pub(crate) const FUNCTION: Register = Register::at(IO, 0x04);
/// Interrupts of GP0 to GP7. Those of the next eight pins are in the next register.
pub(crate) const RAISED: Register = Register::at(IO, 0x230);
pub(crate) const ENABLED: Register = Register::at(IO, 0x248);
pub(crate) const STATUS: Register = Register::at(IO, 0x278);

/// Pull resistors of GP0 (9.11). Those of the next pin are in the next register. A write without the bit ISO also
/// connects the pin, which the reset has isolated.
pub(crate) const PAD: Register = Register::at(0x4003_8000, 0x04);

/// The watchdog (12.9.7), and the parts of the chip that its reset resets (7.4): all except the oscillators.
pub(crate) const WATCHDOG: Register = Register::at(0x400D_8000, 0);
pub(crate) const PSM_WDSEL: Register = Register::at(0x4001_8000, 0x8);
pub(crate) const RESET_PARTS: u32 = 0x1FF_FFF3;
/// Counts of the watchdog in a microsecond.
pub(crate) const WATCHDOG_COUNTS: u32 = 1;

/// Returns `true` if the USB controller can take back a packet: every revision of this chip can.
pub(crate) fn can_abort() -> bool {
    true
}
