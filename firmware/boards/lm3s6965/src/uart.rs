//! UART0 as the drive's bus, UART1 for a word to whoever brings the board up (12.6).
//!
//! The FIFOs are off, so that the interrupt sees, and stamps, every character by itself.

use core::convert::Infallible;

use cortex_m::peripheral::NVIC;
use embedded_io::{ErrorType, Write, WriteReady};
use lm3s6965::{Interrupt, interrupt};
use standin_firmware::device::{Instant, Line, Port};
use standin_firmware::shell::Caught;
use standin_protocol::line::Parity;

use crate::clock::{self, HZ};
use crate::gpio::{self, PORT_A, PORT_D};
use crate::registers::Register;
use standin_board::Queue;

/// What the bus heard: two of the longest frames.
static CAUGHT: Queue<(Instant, Caught), 512> = Queue::new();
/// Characters that wait to be sent: one of the longest frames.
static TO_SEND: Queue<u8, 256> = Queue::new();

const BUS: Uart = Uart(0x4000_C000);
const LOG: Uart = Uart(0x4000_D000);

/// What UART1 speaks.
const LOG_LINE: Line = Line::new(115_200, 8, Parity::None, 1);

#[derive(Clone, Copy)]
struct Uart(usize);

/// Flags: nothing received, no room to send, something being sent.
const RX_EMPTY: u32 = 1 << 4;
const TX_FULL: u32 = 1 << 5;
const BUSY: u32 = 1 << 3;
/// Interrupts: a character has come, there is room to send.
const RX: u32 = 1 << 4;
const TX: u32 = 1 << 5;

impl Uart {
    const fn register(self, offset: usize) -> Register {
        Register::at(self.0, offset)
    }

    const fn data(self) -> Register {
        self.register(0x000)
    }

    const fn flags(self) -> Register {
        self.register(0x018)
    }

    const fn control(self) -> Register {
        self.register(0x030)
    }

    const fn interrupt_mask(self) -> Register {
        self.register(0x038)
    }

    const fn interrupt_clear(self) -> Register {
        self.register(0x044)
    }

    /// Sets the line; a character under way is lost.
    fn set_line(self, line: Line) {
        const ENABLE: u32 = 1 << 0 | 1 << 8 | 1 << 9;
        // 64ths of the clock's cycles in a sixteenth of a bit.
        let divisor = (4 * HZ + line.baud / 2).checked_div(line.baud).unwrap_or(u32::MAX);
        let parity = match line.parity {
            Parity::None => 0,
            Parity::Odd => 1 << 1,
            Parity::Even => 1 << 1 | 1 << 2,
        };
        let stop = u32::from(line.stop == 2) << 3;
        let data = if line.data == 7 { 2 << 5 } else { 3 << 5 };
        self.control().write(0);
        self.register(0x024).write(divisor >> 6);
        self.register(0x028).write(divisor & 0x3F);
        self.register(0x02C).write(data | stop | parity);
        self.control().write(ENABLE);
    }

    fn receive(self) -> Option<u32> {
        (self.flags().read() & RX_EMPTY == 0).then(|| self.data().read())
    }

    fn has_room(self) -> bool {
        self.flags().read() & TX_FULL == 0
    }
}

/// Starts both UARTs.
pub(crate) fn start() {
    gpio::give(PORT_A, 0b11);
    gpio::give(PORT_D, 0b1100);
    LOG.set_line(LOG_LINE);
    BUS.interrupt_mask().write(RX | TX);
    // SAFETY: no critical section of this crate relies on the interrupt's mask.
    unsafe { NVIC::unmask(Interrupt::UART0) };
}

/// The oldest thing that the bus heard, if it is not after `until`.
pub(crate) fn caught(until: Instant) -> Option<(Instant, Caught)> {
    CAUGHT.pop_if(|(at, _)| *at <= until)
}

/// Says a line on UART1.
pub(crate) fn say(words: &[u8]) {
    for &byte in words {
        while !LOG.has_room() {}
        LOG.data().write(u32::from(byte));
    }
}

#[interrupt]
fn UART0() {
    const ERRORS: u32 = 0xF00;

    let at = clock::now();
    BUS.interrupt_clear().write(RX | TX);
    while let Some(character) = BUS.receive() {
        let caught = match character & ERRORS {
            0 => Caught::Byte(Port(0), (character & 0xFF) as u8),
            _ => Caught::Spoiled(Port(0)),
        };
        // Should the loop ever be that late, the frame is short of a character, and its CRC tells.
        let _ = CAUGHT.push((at, caught));
    }
    while BUS.has_room() {
        let Some(byte) = TO_SEND.pop() else { return };
        BUS.data().write(u32::from(byte));
    }
}

/// The sending half of the bus.
pub(crate) struct Sender;

impl Sender {
    /// Changes the line when all that was written has left: waits, for a reply's time at most.
    pub(crate) fn set_line(&mut self, line: Line) {
        while !TO_SEND.is_empty() || BUS.flags().read() & BUSY != 0 {}
        BUS.set_line(line);
    }
}

impl ErrorType for Sender {
    type Error = Infallible;
}

impl WriteReady for Sender {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        Ok(!TO_SEND.is_full())
    }
}

impl Write for Sender {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        let written = bytes.iter().take_while(|byte| TO_SEND.push(**byte)).count();
        // The interrupt takes the first one, and comes again whenever there is room.
        NVIC::pend(Interrupt::UART0);
        Ok(written)
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        while !TO_SEND.is_empty() {}
        Ok(())
    }
}
