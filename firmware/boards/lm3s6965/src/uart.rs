//! UARTs (12.6). The FIFOs are off, so that an interrupt sees, and stamps, every character by itself.

use drivetwin_board::Pl011;
use drivetwin_firmware::device::Line;

use crate::clock::HZ;
use crate::registers::Register;

/// The drive's bus.
pub(crate) const BUS: Uart = Uart(0x4000_C000);
/// For whoever brings the board up.
pub(crate) const LOG: Uart = Uart(0x4000_D000);

/// A character has come, and there is room to send.
const INTERRUPTS: u32 = Pl011::RX | Pl011::TX;

/// A UART.
#[derive(Clone, Copy)]
pub(crate) struct Uart(usize);

impl Uart {
    /// Sets the line; a character under way is lost.
    pub(crate) fn set_line(self, line: Line) {
        let Pl011 { divisor, divisor_64ths, format } = Pl011::new(HZ / 1_000_000, line);
        self.control().write(0);
        self.register(0x024).write(divisor);
        self.register(0x028).write(divisor_64ths);
        self.register(0x02C).write(format);
        self.control().write(Pl011::ENABLE);
    }

    /// Interrupts when a character has come, and when there is room to send.
    pub(crate) fn listen(self) {
        self.register(0x038).write(INTERRUPTS);
    }

    pub(crate) fn acknowledge(self) {
        self.register(0x044).write(INTERRUPTS);
    }

    /// The next character; `Err` if it could not be read.
    pub(crate) fn receive(self) -> Option<Result<u8, ()>> {
        if self.flags() & Pl011::RX_EMPTY != 0 {
            return None;
        }
        let character = self.data().read();
        Some(if character & Pl011::ERRORS == 0 { Ok((character & 0xFF) as u8) } else { Err(()) })
    }

    pub(crate) fn has_room(self) -> bool {
        self.flags() & Pl011::TX_FULL == 0
    }

    /// Whether the last stop bit has not left yet.
    pub(crate) fn is_busy(self) -> bool {
        self.flags() & Pl011::BUSY != 0
    }

    pub(crate) fn send(self, byte: u8) {
        self.data().write(u32::from(byte));
    }

    fn flags(self) -> u32 {
        self.register(0x018).read()
    }

    const fn data(self) -> Register {
        self.register(0x000)
    }

    const fn control(self) -> Register {
        self.register(0x030)
    }

    const fn register(self, offset: usize) -> Register {
        Register::at(self.0, offset)
    }
}
