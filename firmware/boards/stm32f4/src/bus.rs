//! USART1 as the drive's bus (19): behind a transceiver whose direction is PB8, or with a wire for each direction.
//!
//! It has no FIFO: every character interrupts, and is stamped, by itself. The end of the last stop bit interrupts,
//! too.

use core::cell::Cell;
use core::convert::Infallible;

use critical_section::Mutex;
use drivetwin_board::{Bus, Queue, Usart};
use drivetwin_firmware::device::{Line, Port};
use drivetwin_firmware::shell::Caught;
use embedded_io::{ErrorType, Write, WriteReady};

use crate::clock::{self, MHZ};
use crate::registers::Register;
use crate::vectors::interrupt;
use crate::wires::{DE, RX, TX};
use crate::{caught, timer};

/// USART1 (19.6).
const USART: usize = 0x4001_1000;
const STATUS: Register = Register::at(USART, 0x00);
const DATA: Register = Register::at(USART, 0x04);
const BIT: Register = Register::at(USART, 0x08);
const CONTROL: Register = Register::at(USART, 0x0C);
const STOP: Register = Register::at(USART, 0x10);

/// Its number among the functions of PB6 and PB7 (datasheet, table 9).
const FUNCTION: u32 = 7;

/// Characters that may wait to be sent: one of the longest frames.
const MOST: usize = 256;
/// Characters that wait to be sent.
static TO_SEND: Queue<u8, MOST> = Queue::new();
static STATE: Mutex<Cell<State>> =
    Mutex::new(Cell::new(State { sends: false, full_duplex: false, mask: 0xFF, next: None }));

#[derive(Clone, Copy)]
struct State {
    /// From the first start bit to the last stop bit.
    sends: bool,
    /// There is a wire for each direction: it hears while it sends, and there is nothing to turn around.
    full_duplex: bool,
    /// The data bits of a character.
    mask: u8,
    /// What the line becomes when all has left.
    next: Option<Line>,
}

fn state() -> State {
    critical_section::with(|cs| STATE.borrow(cs).get())
}

fn update(change: impl FnOnce(&mut State)) {
    critical_section::with(|cs| {
        let mut state = STATE.borrow(cs).get();
        change(&mut state);
        STATE.borrow(cs).set(state);
    });
}

/// Hands the pins to the UART; the drive sets the line.
pub(crate) fn start(full_duplex: bool) {
    update(|state| state.full_duplex = full_duplex);
    DE.drive_low();
    TX.give(FUNCTION);
    RX.give(FUNCTION);
}

/// Sets the line now; a character under way is lost.
fn configure(line: Line) {
    /// What the clock is divided by where a bit of a slow line has more cycles than the UART counts.
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
    update(|state| state.mask = mask);
}

#[interrupt]
fn USART1() {
    let at = timer::now();
    // Read before the data: that clears what it says of the character, and of the last one sent.
    let status = STATUS.read();
    if status & (Usart::CAN_READ | Usart::OVERRUN) != 0 {
        let character = DATA.read();
        let State { sends, full_duplex, mask, .. } = state();
        if !sends || full_duplex {
            let heard = match status & Usart::ERRORS {
                0 => Caught::Byte(Port(0), (character & u32::from(mask)) as u8),
                _ => Caught::Spoiled(Port(0)),
            };
            // Where the loop is so late that there is no room, the character is lost. Of a Modbus frame the CRC
            // tells; a QSB's command has none.
            let _ = caught::QUEUE.push((at, heard));
        }
    }
    if CONTROL.read() & Usart::CAN_WRITE != 0 && status & Usart::CAN_WRITE != 0 {
        send();
    } else if CONTROL.read() & Usart::HAS_SENT != 0 && status & Usart::HAS_SENT != 0 {
        end();
    }
}

/// Gives the UART the next character. Behind the last one it waits until that has left.
fn send() {
    let Some(byte) = TO_SEND.pop() else {
        CONTROL.replace(Usart::CAN_WRITE | Usart::HAS_SENT, Usart::HAS_SENT);
        return;
    };
    let State { full_duplex, .. } = state();
    if !full_duplex {
        DE.write(true);
    }
    update(|state| state.sends = true);
    DATA.write(u32::from(byte));
    // In time for what does not fit to be sent without a pause.
    if TO_SEND.len() == MOST / 2 {
        caught::bus_has_room();
    }
}

/// The last stop bit has left.
fn end() {
    CONTROL.clear(Usart::HAS_SENT);
    DE.write(false);
    if let Some(line) = state().next {
        configure(line);
    }
    update(|state| (state.sends, state.next) = (false, None));
    caught::bus_has_room();
}

/// The sending half of the bus.
pub(crate) struct Sender;

impl Bus for Sender {
    fn set_line(&mut self, line: Line) {
        critical_section::with(|_| {
            if !state().sends && TO_SEND.is_empty() {
                configure(line);
            } else {
                update(|state| state.next = Some(line));
            }
        });
    }
}

impl ErrorType for Sender {
    type Error = Infallible;
}

impl WriteReady for Sender {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        // What comes behind a change of the line waits for it.
        Ok(!TO_SEND.is_full() && state().next.is_none())
    }
}

impl Write for Sender {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        let written = bytes.iter().take_while(|byte| TO_SEND.push(**byte)).count();
        // The interrupt takes the first one, and comes again whenever there is room.
        CONTROL.replace(Usart::CAN_WRITE | Usart::HAS_SENT, Usart::CAN_WRITE);
        Ok(written)
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        while state().sends || !TO_SEND.is_empty() {}
        Ok(())
    }
}
