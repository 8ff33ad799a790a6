//! An ARM PL011, the UART of many chips (*PrimeCell UART Technical Reference Manual*, DDI 0183, 3.3). Its FIFOs are off,
//! so that an interrupt sees, and stamps, every character by itself.

use drivetwin_firmware::device::{Duration, Instant, Line, Port};
use drivetwin_firmware::shell::BoardEvent;
use drivetwin_protocol::line::Parity;

use crate::bus::Uart;
use crate::queue::Queue;
use crate::register::{Chip, Register};

/// Register values for a line.
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

    /// For a clock of `mhz`, and a line of at least that many baud: the divisor has 16 bits. It is rounded
    /// down, so that no character takes longer than the drive reckons (BOARD-12).
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

/// A UART of a chip.
#[derive(Clone, Copy, Debug)]
pub struct Pl011Uart<C> {
    base: Register<C>,
    /// The frequency of its clock.
    mhz: u32,
}

impl<C: Chip> Pl011Uart<C> {
    /// A character has come, and there is room to send.
    const INTERRUPTS: u32 = Pl011::RX | Pl011::TX;

    /// The UART whose registers begin there, with a clock of `mhz`.
    #[must_use]
    pub const fn at(base: Register<C>, mhz: u32) -> Self {
        Self { base, mhz }
    }

    /// Sets the line; a character under way is lost.
    pub fn set_line(self, line: Line) {
        let Pl011 { divisor, divisor_64ths, format } = Pl011::new(self.mhz, line);
        self.base.plus(0x30).write(0);
        self.base.plus(0x24).write(divisor);
        self.base.plus(0x28).write(divisor_64ths);
        self.base.plus(0x2C).write(format);
        self.base.plus(0x30).write(Pl011::ENABLE);
    }

    /// Interrupts when a character has come, and when there is room to send.
    pub fn listen(self) {
        self.base.plus(0x38).write(Self::INTERRUPTS);
    }

    /// Takes a character to send.
    #[inline]
    pub fn write(self, byte: u8) {
        self.base.write(u32::from(byte));
    }

    /// `true` if it takes a character to send.
    #[inline]
    pub fn has_room(self) -> bool {
        self.flags() & Pl011::TX_FULL == 0
    }

    /// Serves its interrupt, which came at `at`: queues received characters, and sends.
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
                // Where the loop is so late that there is no room, the character is lost. A Modbus frame then fails
                // its CRC; a QSB's command has none.
                let _ = queue.push((at, heard));
            }
        }
        U::bus().send();
    }

    /// Begins to look for the end of the last stop bit, for which there is no interrupt: [`Uart::end`]. `after` has a
    /// timer call [`look`](Self::look) so much later.
    #[inline]
    pub fn end<U: Uart>(self, after: impl FnOnce(Duration)) {
        if U::bus().begin_end() {
            self.end_or::<U>(U::bus().character(), after);
        }
    }

    /// Looks again whether the last stop bit has left.
    #[inline]
    pub fn look<U: Uart>(self, after: impl FnOnce(Duration)) {
        /// The time between two looks, and what a timer adds to it.
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
