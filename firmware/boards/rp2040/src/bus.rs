//! UART0 as the drive's bus (4.2): behind a transceiver whose direction is GP2, or with a wire for each
//! direction.
//!
//! The FIFOs are off, so that the interrupt sees, and stamps, every character by itself.

use core::cell::Cell;
use core::convert::Infallible;

use cortex_m::peripheral::NVIC;
use critical_section::Mutex;
use drivetwin_board::{Bus, Pl011, Queue};
use drivetwin_firmware::device::{Line, Port};
use drivetwin_firmware::shell::Caught;
use drivetwin_protocol::line::Parity;
use embedded_io::{ErrorType, Write, WriteReady};
use rp2040_pac::{Interrupt, interrupt};

use crate::clock::HZ;
use crate::registers::Register;
use crate::timer::{self, Alarm};
use crate::wires::DE;
use crate::{caught, pins, wires};

const UART: usize = 0x4003_4000;
const DATA: Register = Register::at(UART, 0x00);
const FLAGS: Register = Register::at(UART, 0x18);
const DIVISOR: Register = Register::at(UART, 0x24);
const DIVISOR_64THS: Register = Register::at(UART, 0x28);
const FORMAT: Register = Register::at(UART, 0x2C);
const CONTROL: Register = Register::at(UART, 0x30);
const INTERRUPT_MASK: Register = Register::at(UART, 0x38);
const INTERRUPT_CLEAR: Register = Register::at(UART, 0x44);

/// Characters that may wait to be sent: one of the longest frames.
const MOST: usize = 256;
/// Characters that wait to be sent.
static TO_SEND: Queue<u8, MOST> = Queue::new();
/// When sending may be over.
static END: Alarm = Alarm::new(2);
static STATE: Mutex<Cell<State>> = Mutex::new(Cell::new(State {
    turn: Turn::Hear,
    full_duplex: false,
    line: Line::new(9_600, 8, Parity::None, 1),
    next: None,
}));

#[derive(Clone, Copy)]
struct State {
    turn: Turn,
    /// There is a wire for each direction: it hears while it sends, and there is nothing to turn around.
    full_duplex: bool,
    line: Line,
    /// What the line becomes when all has left.
    next: Option<Line>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Turn {
    Hear,
    Send,
    /// The last character is on its way.
    End,
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

/// Starts the UART; the drive sets the line.
pub(crate) fn start(full_duplex: bool) {
    update(|state| state.full_duplex = full_duplex);
    pins::drive_low(DE);
    pins::give_to_uart(wires::TX | wires::RX);
    INTERRUPT_MASK.write(Pl011::RX | Pl011::TX);
}

/// Sets the line now; a character under way is lost.
fn configure(line: Line) {
    let Pl011 { divisor, divisor_64ths, format } = Pl011::new(HZ / 1_000_000, line);
    CONTROL.write(0);
    DIVISOR.write(divisor);
    DIVISOR_64THS.write(divisor_64ths);
    FORMAT.write(format);
    CONTROL.write(Pl011::ENABLE);
    update(|state| state.line = line);
}

#[interrupt]
fn UART0_IRQ() {
    let at = timer::now();
    INTERRUPT_CLEAR.write(Pl011::RX | Pl011::TX);
    while FLAGS.read() & Pl011::RX_EMPTY == 0 {
        let character = DATA.read();
        let State { turn, full_duplex, .. } = state();
        if turn == Turn::Hear || full_duplex {
            // Where the loop is so late that there is no room, the character is lost. Of a Modbus frame the CRC
            // tells; a QSB's command has none.
            let _ = caught::QUEUE.push((at, heard(character)));
        }
    }
    send();
}

fn heard(character: u32) -> Caught {
    match character & Pl011::ERRORS {
        0 => Caught::Byte(Port(0), (character & 0xFF) as u8),
        _ => Caught::Spoiled(Port(0)),
    }
}

/// Gives the UART what it has room for. Behind the last character it asks for an alarm when that has left:
/// there is no interrupt for it.
fn send() {
    while FLAGS.read() & Pl011::TX_FULL == 0 {
        let Some(byte) = TO_SEND.pop() else {
            if state().turn == Turn::Send {
                update(|state| state.turn = Turn::End);
                let end = timer::now() + state().line.character();
                if !END.set(timer::nearest(end) + 1) {
                    NVIC::pend(Interrupt::TIMER_IRQ_2);
                }
            }
            return;
        };
        if !state().full_duplex {
            pins::set_high(DE);
        }
        update(|state| state.turn = Turn::Send);
        DATA.write(u32::from(byte));
        // In time for what does not fit to be sent without a pause.
        if TO_SEND.len() == MOST / 2 {
            caught::bus_has_room();
        }
    }
}

#[interrupt]
fn TIMER_IRQ_2() {
    /// Between two looks whether the last stop bit has left, in µs.
    const PAUSE: u64 = 2;
    if !END.has_come() || state().turn != Turn::End {
        return;
    }
    if FLAGS.read() & Pl011::BUSY != 0 {
        if !END.set(timer::micros() + PAUSE) {
            NVIC::pend(Interrupt::TIMER_IRQ_2);
        }
        return;
    }
    END.set(u64::MAX);
    pins::set_low(DE);
    if let Some(line) = state().next {
        configure(line);
    }
    update(|state| (state.turn, state.next) = (Turn::Hear, None));
    caught::bus_has_room();
}

/// The sending half of the bus.
pub(crate) struct Sender;

impl Bus for Sender {
    fn set_line(&mut self, line: Line) {
        critical_section::with(|_| {
            if state().turn == Turn::Hear && TO_SEND.is_empty() {
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
        NVIC::pend(Interrupt::UART0_IRQ);
        Ok(written)
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        while state().turn != Turn::Hear || !TO_SEND.is_empty() {}
        Ok(())
    }
}
