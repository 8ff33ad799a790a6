//! The interrupts that have handlers, and their vectors. Both chips have the same interrupts, in other places of the table.

use crate::chip::{Interrupt, VECTORS};

/// A function that handles an interrupt.
type Handler = unsafe extern "C" fn();

unsafe extern "C" {
    fn TIMER_IRQ_0();
    fn TIMER_IRQ_1();
    fn TIMER_IRQ_2();
    fn USBCTRL_IRQ();
    fn IO_IRQ_BANK0();
    fn UART0_IRQ();
    /// Handler of the interrupts that are never enabled.
    fn DefaultHandler();
}

/// The vectors that follow those of the processor itself.
#[unsafe(link_section = ".vector_table.interrupts")]
#[unsafe(no_mangle)]
static __INTERRUPTS: [Handler; VECTORS] = {
    let mut vectors: [Handler; VECTORS] = [DefaultHandler; VECTORS];
    vectors[Interrupt::TIMER_IRQ_0 as usize] = TIMER_IRQ_0;
    vectors[Interrupt::TIMER_IRQ_1 as usize] = TIMER_IRQ_1;
    vectors[Interrupt::TIMER_IRQ_2 as usize] = TIMER_IRQ_2;
    vectors[Interrupt::USBCTRL_IRQ as usize] = USBCTRL_IRQ;
    vectors[Interrupt::IO_IRQ_BANK0 as usize] = IO_IRQ_BANK0;
    vectors[Interrupt::UART0_IRQ as usize] = UART0_IRQ;
    vectors
};

// SAFETY: the numbers are those of the chip, and are constant.
unsafe impl cortex_m::interrupt::InterruptNumber for Interrupt {
    fn number(self) -> u16 {
        self as u16
    }
}
