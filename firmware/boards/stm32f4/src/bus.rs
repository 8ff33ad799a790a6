//! USART1 as the drive's bus (19): with a transceiver whose direction is PB8, or with a wire for each
//! direction.
//!
//! USART1 has no FIFO, so every received character has an interrupt and a timestamp of its own. The end of
//! the last stop bit causes an interrupt, too.

use core::sync::atomic::{AtomicU32, Ordering};

use drivetwin_board::{SerialBus, Tap, Uart, Usart};
use drivetwin_firmware::device::{Line, Port};
use drivetwin_firmware::shell::BoardEvent;

use crate::clock::{self, MHZ};
use crate::registers::Register;
use crate::vectors::interrupt;
use crate::wires::{DE, RX, TX};
use crate::{QUEUE, timer};

/// Registers of USART1 (19.6).
const USART: usize = 0x4001_1000;
const STATUS: Register = Register::at(USART, 0x00);
const DATA: Register = Register::at(USART, 0x04);
const BIT: Register = Register::at(USART, 0x08);
const CONTROL: Register = Register::at(USART, 0x0C);
const STOP: Register = Register::at(USART, 0x10);

/// Number of the alternate function of PB6 and PB7 (datasheet, table 9).
const FUNCTION: u32 = 7;

/// The bus.
static BUS: SerialBus<Usart1> = SerialBus::new();
/// Mask of the data bits of a character.
static MASK: AtomicU32 = AtomicU32::new(0xFF);

#[interrupt]
fn USART1() {
    let at = timer::now();
    // The status must be read before the data. Then reading the data clears the flags of the received
    // character, and writing data later clears the flag of the last character sent.
    let status = STATUS.read();
    if status & (Usart::CAN_READ | Usart::OVERRUN) != 0 {
        let character = DATA.read();
        if BUS.hears() {
            let heard = match status & Usart::ERRORS {
                0 => BoardEvent::Byte(Port(0), (character & MASK.load(Ordering::Relaxed)) as u8),
                _ => BoardEvent::RxError(Port(0)),
            };
            // If the loop is so late that the queue is full, the character is lost. A Modbus frame then fails
            // its CRC; a command of a QSB has none.
            if !QUEUE.push((at, heard)) {
                crate::lose();
            }
        }
    }
    if CONTROL.read() & Usart::CAN_WRITE != 0 {
        BUS.send();
    } else if CONTROL.read() & Usart::HAS_SENT != 0 && status & Usart::HAS_SENT != 0 {
        CONTROL.clear(Usart::HAS_SENT);
        BUS.sent();
    }
}

/// The UART of the bus.
pub(crate) enum Usart1 {}

impl Uart for Usart1 {
    fn bus() -> &'static SerialBus<Self> {
        &BUS
    }

    fn start() {
        DE.drive_low();
        TX.give(FUNCTION);
        RX.give(FUNCTION);
    }

    fn configure(line: Line) {
        /// Divisor of the USART's clock for a slow line, on which a bit has more cycles than the USART can
        /// count.
        const SLOW: u32 = 4;
        let fast = Usart::new(MHZ, line);
        let Some(Usart { bit, control, stop, mask }) = fast.or_else(|| Usart::new(MHZ / SLOW, line)) else {
            return;
        };
        CONTROL.write(0);
        clock::divide_uart(fast.is_none());
        BIT.write(bit);
        STOP.write(stop);
        CONTROL.write(control | Usart::ENABLE | Usart::CAN_READ);
        MASK.store(u32::from(mask), Ordering::Relaxed);
    }

    fn has_room() -> bool {
        STATUS.read() & Usart::CAN_WRITE != 0
    }

    fn write(byte: u8) {
        DATA.write(u32::from(byte));
    }

    fn pend() {
        CONTROL.replace(Usart::CAN_WRITE | Usart::HAS_SENT, Usart::CAN_WRITE);
    }

    fn tap() -> Option<&'static Tap> {
        Some(&crate::TAP)
    }

    fn turn(sends: bool) {
        DE.write(sends);
    }

    fn end() {
        CONTROL.replace(Usart::CAN_WRITE | Usart::HAS_SENT, Usart::HAS_SENT);
    }
}
