//! An ARM PL011, the UART of many chips (*PrimeCell UART Technical Reference Manual*, DDI 0183, 3.3). Its
//! FIFOs are off, so that every character has an interrupt and a timestamp of its own.

use drivetwin_firmware::device::{Duration, Instant, Line, Port};
use drivetwin_firmware::shell::BoardEvent;
use drivetwin_protocol::line::Parity;

use crate::bus::Uart;
use crate::queue::Queue;
use crate::register::{Chip, Register};

/// Register values for the settings of a line.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Pl011 {
    /// UARTIBRD: whole cycles of the UART's clock in 1/16 of a bit.
    pub divisor: u32,
    /// UARTFBRD: additional 64ths of a cycle.
    pub divisor_64ths: u32,
    /// UARTLCR_H: data bits, parity and stop bits, without FIFOs.
    pub format: u32,
}

impl Pl011 {
    /// UARTCR: enabled, in both directions.
    pub const ENABLE: u32 = 1 << 0 | 1 << 8 | 1 << 9;
    /// UARTFR: a character is being sent.
    pub const BUSY: u32 = 1 << 3;
    /// UARTFR: no received character.
    pub const RX_EMPTY: u32 = 1 << 4;
    /// UARTFR: no room to send.
    pub const TX_FULL: u32 = 1 << 5;
    /// UARTIMSC and UARTICR: a character was received.
    pub const RX: u32 = 1 << 4;
    /// UARTIMSC and UARTICR: there is room to send.
    pub const TX: u32 = 1 << 5;
    /// UARTDR: the character was received with an error.
    pub const ERRORS: u32 = 0xF00;

    /// Register values for a clock of `mhz`. The baud rate must be so high that the divisor fits in 16 bits.
    /// The divisor is rounded down, so that no character takes longer than the drive computes (BOARD-12).
    #[must_use]
    pub fn new(mhz: u32, line: Line) -> Self {
        // The divisor is 1/16 of a bit in 64ths of a cycle. `character` is in ticks, 16 in a microsecond.
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

/// A UART of a chip.
#[derive(Clone, Copy, Debug)]
pub struct Pl011Uart<C> {
    base: Register<C>,
    /// Frequency of the UART's clock in MHz.
    mhz: u32,
}

impl<C: Chip> Pl011Uart<C> {
    /// Interrupts for a received character and for room to send.
    const INTERRUPTS: u32 = Pl011::RX | Pl011::TX;

    /// The UART whose registers begin at `base`, with a clock of `mhz`.
    #[must_use]
    pub const fn at(base: Register<C>, mhz: u32) -> Self {
        Self { base, mhz }
    }

    /// Sets the line. A character that is being sent or received is lost.
    pub fn set_line(self, line: Line) {
        let Pl011 { divisor, divisor_64ths, format } = Pl011::new(self.mhz, line);
        self.base.plus(0x30).write(0);
        self.base.plus(0x24).write(divisor);
        self.base.plus(0x28).write(divisor_64ths);
        self.base.plus(0x2C).write(format);
        self.base.plus(0x30).write(Pl011::ENABLE);
    }

    /// Enables the interrupts for a received character and for room to send.
    pub fn listen(self) {
        self.base.plus(0x38).write(Self::INTERRUPTS);
    }

    /// Gives the UART a character to send.
    #[inline]
    pub fn write(self, byte: u8) {
        self.base.write(u32::from(byte));
    }

    /// Returns `true` if the UART accepts a character to send.
    #[inline]
    pub fn has_room(self) -> bool {
        self.flags() & Pl011::TX_FULL == 0
    }

    /// Handles the UART's interrupt, which occurred at `at`: queues received characters, and sends.
    #[inline]
    pub fn serve<U: Uart, const ROOM: usize>(self, at: Instant, queue: &Queue<(Instant, BoardEvent), ROOM>) {
        self.base.plus(0x44).write(Self::INTERRUPTS);
        while self.flags() & Pl011::RX_EMPTY == 0 {
            let character = self.base.read();
            if U::bus().hears() {
                let heard = match character & Pl011::ERRORS {
                    0 => BoardEvent::Byte(Port(0), (character & 0xFF) as u8),
                    _ => BoardEvent::RxError(Port(0)),
                };
                // If the loop is so late that the queue is full, the character is lost. A Modbus frame then
                // fails its CRC; a command of a QSB has none.
                if !queue.push((at, heard)) {
                    U::lose();
                }
            }
        }
        U::bus().send();
    }

    /// Implements [`Uart::end`] without an interrupt for the end of the last stop bit: begins to poll for it.
    /// `after` must have a timer call [`look`](Self::look) after the given time.
    #[inline]
    pub fn end<U: Uart>(self, after: impl FnOnce(Duration)) {
        if U::bus().begin_end() {
            self.end_or::<U>(U::bus().character(), after);
        }
    }

    /// Checks again whether the last stop bit has left.
    #[inline]
    pub fn look<U: Uart>(self, after: impl FnOnce(Duration)) {
        /// Time between two checks, without the additional delay of a timer.
        const PAUSE: Duration = Duration::micros(1);
        if U::bus().ends() {
            self.end_or::<U>(PAUSE, after);
        }
    }

    #[inline]
    fn end_or<U: Uart>(self, again: Duration, after: impl FnOnce(Duration)) {
        if self.flags() & Pl011::BUSY != 0 {
            after(again);
        } else {
            U::bus().sent();
        }
    }

    fn flags(self) -> u32 {
        self.base.plus(0x18).read()
    }
}
