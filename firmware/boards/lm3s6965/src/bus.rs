//! The bus: UART0 (12.6), with an RS-485 transceiver that sends while DE is high, or with a wire for each
//! direction.

use cortex_m::peripheral::NVIC;
use drivetwin_board::{Pl011Uart, SerialBus, Uart};
use drivetwin_firmware::device::{Duration, Line};
use lm3s6965::{Interrupt, interrupt};

use crate::clock::MHZ;
use crate::gpio::{self, Gpio};
use crate::registers::{Lm3s6965, Register};
use crate::timer::SENT;
use crate::{QUEUE, clock};

const UART: Pl011Uart<Lm3s6965> = Pl011Uart::at(Register::at(0x4000_C000, 0), MHZ);
/// Input from the transceiver. The next pin of the port is the UART's output.
const RX: Gpio = gpio::A.pin(0);
/// Direction of the transceiver: it sends while this pin is high.
const DE: Gpio = gpio::B.pin(5);

/// The bus.
static BUS: SerialBus<Uart0> = SerialBus::new();

#[interrupt]
fn UART0() {
    UART.serve::<Uart0, _>(clock::now(), &QUEUE);
}

#[interrupt]
fn TIMER_2A() {
    SENT.acknowledge();
    UART.look::<Uart0>(look_after);
}

/// Sets the timer to interrupt after `span`.
#[inline(never)]
fn look_after(span: Duration) {
    SENT.start(span);
}

/// The UART of the bus.
pub(crate) enum Uart0 {}

impl Uart for Uart0 {
    fn bus() -> &'static SerialBus<Self> {
        &BUS
    }

    fn start() {
        DE.push_pull();
        // Pulled up, because a transceiver may release the input while it sends.
        RX.pulled(true);
        gpio::A.give(0b11);
        UART.listen();
    }

    fn configure(line: Line) {
        UART.set_line(line);
    }

    fn has_room() -> bool {
        UART.has_room()
    }

    fn write(byte: u8) {
        UART.write(byte);
    }

    fn pend() {
        NVIC::pend(Interrupt::UART0);
    }

    fn turn(sends: bool) {
        DE.write(sends);
    }

    fn end() {
        UART.end::<Self>(look_after);
    }
}
