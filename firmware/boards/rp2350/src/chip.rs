//! Addresses and interrupts of what the RP2350 and the RP2040 have in common, for the modules that this crate
//! shares with that of the Pico.

use cortex_m::interrupt::InterruptNumber;
pub(crate) use cortex_m_rt::interrupt;

use crate::registers::Register;
pub(crate) use crate::registers::Rp2350 as This;

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

/// An interrupt, with its position in the vector table as its value (3.2). The names are those of the RP2040.
#[derive(Clone, Copy)]
#[expect(non_camel_case_types, reason = "the names are those of the RP2040")]
pub(crate) enum Interrupt {
    TIMER_IRQ_0 = 0,
    TIMER_IRQ_1 = 1,
    TIMER_IRQ_2 = 2,
    IO_IRQ_BANK0 = 21,
    UART0_IRQ = 33,
}

pub(crate) use Interrupt as interrupt;

// SAFETY: the numbers are those of the chip, and are constant.
unsafe impl InterruptNumber for Interrupt {
    fn number(self) -> u16 {
        self as u16
    }
}

/// A function that handles an interrupt.
type Handler = unsafe extern "C" fn();

unsafe extern "C" {
    fn TIMER_IRQ_0();
    fn TIMER_IRQ_1();
    fn TIMER_IRQ_2();
    fn IO_IRQ_BANK0();
    fn UART0_IRQ();
    /// Handler of the interrupts that are never enabled.
    fn DefaultHandler();
}

/// Number of vectors in the table.
const VECTORS: usize = 52;

/// The vectors that follow those of the processor itself.
#[unsafe(link_section = ".vector_table.interrupts")]
#[unsafe(no_mangle)]
static __INTERRUPTS: [Handler; VECTORS] = {
    let mut vectors: [Handler; VECTORS] = [DefaultHandler; VECTORS];
    vectors[Interrupt::TIMER_IRQ_0 as usize] = TIMER_IRQ_0;
    vectors[Interrupt::TIMER_IRQ_1 as usize] = TIMER_IRQ_1;
    vectors[Interrupt::TIMER_IRQ_2 as usize] = TIMER_IRQ_2;
    vectors[Interrupt::IO_IRQ_BANK0 as usize] = IO_IRQ_BANK0;
    vectors[Interrupt::UART0_IRQ as usize] = UART0_IRQ;
    vectors
};
