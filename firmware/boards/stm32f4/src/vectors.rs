//! The interrupts of the chip that have handlers, and their vectors (10.1.3).

use cortex_m::interrupt::InterruptNumber;
pub(crate) use cortex_m_rt::interrupt;

/// An interrupt, with its position in the vector table as its value. The attribute `interrupt` uses the same
/// names.
#[derive(Clone, Copy)]
#[expect(non_camel_case_types, reason = "the names are those of the chip")]
pub(crate) enum Interrupt {
    EXTI0 = 6,
    EXTI1 = 7,
    EXTI2 = 8,
    EXTI3 = 9,
    EXTI4 = 10,
    EXTI9_5 = 23,
    TIM2 = 28,
    USART1 = 37,
    EXTI15_10 = 40,
    OTG_FS = 67,
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
    fn EXTI0();
    fn EXTI1();
    fn EXTI2();
    fn EXTI3();
    fn EXTI4();
    fn EXTI9_5();
    fn TIM2();
    fn USART1();
    fn EXTI15_10();
    fn OTG_FS();
    /// Handler of the interrupts that are never enabled.
    fn DefaultHandler();
}

/// Number of vectors in the table.
const VECTORS: usize = 86;

/// The vectors that follow those of the processor itself.
#[unsafe(link_section = ".vector_table.interrupts")]
#[unsafe(no_mangle)]
static __INTERRUPTS: [Handler; VECTORS] = {
    let mut vectors: [Handler; VECTORS] = [DefaultHandler; VECTORS];
    vectors[Interrupt::EXTI0 as usize] = EXTI0;
    vectors[Interrupt::EXTI1 as usize] = EXTI1;
    vectors[Interrupt::EXTI2 as usize] = EXTI2;
    vectors[Interrupt::EXTI3 as usize] = EXTI3;
    vectors[Interrupt::EXTI4 as usize] = EXTI4;
    vectors[Interrupt::EXTI9_5 as usize] = EXTI9_5;
    vectors[Interrupt::TIM2 as usize] = TIM2;
    vectors[Interrupt::USART1 as usize] = USART1;
    vectors[Interrupt::EXTI15_10 as usize] = EXTI15_10;
    vectors[Interrupt::OTG_FS as usize] = OTG_FS;
    vectors
};
