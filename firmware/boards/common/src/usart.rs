//! The line's settings in the USART of an STM32F1, F2, F4 or L1 (*STM32F411xC/E Reference Manual*, RM0383, 19.6).

use drivetwin_firmware::device::Line;
use drivetwin_protocol::line::Parity;

/// Register values for a line.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Usart {
    /// USART_BRR: cycles of its clock in a bit.
    pub bit: u32,
    /// USART_CR1: length of a character and parity.
    pub control: u32,
    /// USART_CR2: stop bits.
    pub stop: u32,
    /// Data bits of a character as it is read: a parity bit is above them.
    pub mask: u8,
}

impl Usart {
    /// USART_CR1: enabled, both ways.
    pub const ENABLE: u32 = 1 << 13 | 1 << 3 | 1 << 2;
    /// USART_SR, and USART_CR1 for the interrupt: a character has come.
    pub const CAN_READ: u32 = 1 << 5;
    /// USART_SR, and USART_CR1 for the interrupt: all characters have left, to their last stop bit.
    pub const HAS_SENT: u32 = 1 << 6;
    /// USART_SR, and USART_CR1 for the interrupt: there is room to send.
    pub const CAN_WRITE: u32 = 1 << 7;
    /// USART_SR: a character was lost. It interrupts as one that has come does, and may do so when that has been read.
    pub const OVERRUN: u32 = 1 << 3;
    /// USART_SR: the character could not be read, or one behind it was lost. Noise is not among them: the
    /// majority of the samples decides.
    pub const ERRORS: u32 = Self::OVERRUN | 1 << 1 | 1 << 0;

    /// For a clock of `mhz`; `None` where a bit has more cycles than the UART counts, 65,535, or fewer
    /// than it needs, 16. They are rounded down, so that no character takes longer than the drive reckons (BOARD-12).
    ///
    /// A character has eight data bits, or seven and a parity bit: the UART has no shorter ones.
    #[must_use]
    pub fn new(mhz: u32, line: Line) -> Option<Self> {
        // A character is in ticks, 16 in a microsecond.
        let character = u32::try_from(line.character().ticks()).ok()?;
        let bit = mhz.checked_mul(character)?.checked_div(16 * line.bits())?;
        let parity = match line.parity {
            Parity::None => 0,
            Parity::Even => 1 << 10,
            Parity::Odd => 1 << 10 | 1 << 9,
        };
        // The parity bit is one of those that it counts: eight or, with this, nine.
        let nine = if line.data == 8 && parity != 0 { 1 << 12 } else { 0 };
        (16..=0xFFFF).contains(&bit).then_some(Self {
            bit,
            control: nine | parity,
            stop: if line.stop == 2 { 0b10 << 12 } else { 0 },
            mask: if line.data == 7 { 0x7F } else { 0xFF },
        })
    }
}
