//! Settings of a line for the USART of an STM32F1, F2, F4 or L1 (*STM32F411xC/E Reference Manual*, RM0383,
//! 19.6).

use drivetwin_firmware::device::Line;
use drivetwin_protocol::line::Parity;

/// Register values for the settings of a line.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Usart {
    /// USART_BRR: cycles of the USART's clock in a bit.
    pub bit: u32,
    /// USART_CR1: length of a character and parity.
    pub control: u32,
    /// USART_CR2: stop bits.
    pub stop: u32,
    /// Mask of a received character's data bits. A parity bit is above them.
    pub mask: u8,
}

impl Usart {
    /// USART_CR1: enabled, in both directions.
    pub const ENABLE: u32 = 1 << 13 | 1 << 3 | 1 << 2;
    /// USART_SR, and USART_CR1 for the interrupt: a character was received.
    pub const CAN_READ: u32 = 1 << 5;
    /// USART_SR, and USART_CR1 for the interrupt: all characters have been sent, including the last stop bit.
    pub const HAS_SENT: u32 = 1 << 6;
    /// USART_SR, and USART_CR1 for the interrupt: there is room to send.
    pub const CAN_WRITE: u32 = 1 << 7;
    /// USART_SR: a received character was lost. The interrupt is that of a received character, and may occur
    /// after that character has been read.
    pub const OVERRUN: u32 = 1 << 3;
    /// USART_SR: the character has an error, or a character after it was lost. Noise does not count as an
    /// error, because the majority of the samples decides.
    pub const ERRORS: u32 = Self::OVERRUN | 1 << 1 | 1 << 0;

    /// Register values for a clock of `mhz`. Returns `None` if a bit has more cycles than the USART can
    /// count, 65,535, or fewer than it needs, 16. Cycles are rounded down, so that no character takes longer
    /// than the drive computes (BOARD-12).
    ///
    /// A character has eight data bits, or seven and a parity bit. The USART has no shorter characters.
    #[must_use]
    pub fn new(mhz: u32, line: Line) -> Option<Self> {
        // `character` is in ticks, 16 in a microsecond.
        let character = u32::try_from(line.character().ticks()).ok()?;
        let bit = mhz.checked_mul(character)?.checked_div(16 * line.bits())?;
        let parity = match line.parity {
            Parity::None => 0,
            Parity::Even => 1 << 10,
            Parity::Odd => 1 << 10 | 1 << 9,
        };
        // The USART counts the parity bit as one of its eight bits or, with this flag, nine bits.
        let nine = if line.data == 8 && parity != 0 { 1 << 12 } else { 0 };
        (16..=0xFFFF).contains(&bit).then_some(Self {
            bit,
            control: nine | parity,
            stop: if line.stop == 2 { 0b10 << 12 } else { 0 },
            mask: if line.data == 7 { 0x7F } else { 0xFF },
        })
    }
}
