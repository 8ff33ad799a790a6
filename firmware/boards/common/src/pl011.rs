//! The line's settings in an ARM PL011, the UART of many chips (*PrimeCell UART Technical Reference Manual*,
//! DDI 0183, 3.3).

use drivetwin_firmware::device::Line;
use drivetwin_protocol::line::Parity;

/// What its registers need for a line.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Pl011 {
    /// UARTIBRD: whole cycles of its clock in a sixteenth of a bit.
    pub divisor: u32,
    /// UARTFBRD: 64ths of a cycle more.
    pub divisor_64ths: u32,
    /// UARTLCR_H: data bits, parity and stop bits, without FIFOs.
    pub format: u32,
}

impl Pl011 {
    /// UARTCR: enabled, both ways.
    pub const ENABLE: u32 = 1 << 0 | 1 << 8 | 1 << 9;
    /// UARTFR: something is being sent.
    pub const BUSY: u32 = 1 << 3;
    /// UARTFR: nothing received.
    pub const RX_EMPTY: u32 = 1 << 4;
    /// UARTFR: no room to send.
    pub const TX_FULL: u32 = 1 << 5;
    /// UARTIMSC and UARTICR: a character has come.
    pub const RX: u32 = 1 << 4;
    /// UARTIMSC and UARTICR: there is room to send.
    pub const TX: u32 = 1 << 5;
    /// UARTDR: the character could not be read.
    pub const ERRORS: u32 = 0xF00;

    /// For a clock of so many `mhz`, and a line of as many baud at least: the divisor has 16 bits. It is rounded
    /// down, so that no character takes longer than the drive reckons.
    #[must_use]
    pub fn new(mhz: u32, line: Line) -> Self {
        // A sixteenth of a bit, in 64ths of a cycle. A character is in ticks, 16 in a microsecond.
        let character = u32::try_from(line.character().ticks()).unwrap_or(u32::MAX);
        let divisor = mhz.saturating_mul(character).checked_div(4 * line.bits()).unwrap_or(u32::MAX);
        let parity = match line.parity {
            Parity::None => 0,
            Parity::Odd => 1 << 1,
            Parity::Even => 1 << 1 | 1 << 2,
        };
        let stop = u32::from(line.stop == 2) << 3;
        let data = if line.data == 7 { 2 << 5 } else { 3 << 5 };
        Self { divisor: divisor >> 6, divisor_64ths: divisor & 0x3F, format: data | stop | parity }
    }
}
