//! UART0 as the drive's bus (4.2): with a transceiver whose direction is GP2, or with a wire for each
//! direction.

use cortex_m::peripheral::NVIC;
use drivetwin_board::{Pl011Uart, SerialBus, Tap, Uart};
use drivetwin_firmware::device::{Duration, Line};

use crate::chip::clock::HZ;
use crate::chip::{Interrupt, UART0};
use crate::registers::Rp;
use crate::timer::{self, Alarm};
use crate::wires::DE;
use crate::{QUEUE, interrupt, pins, wires};

const UART: Pl011Uart<Rp> = Pl011Uart::at(UART0, HZ / 1_000_000);

/// The bus.
static BUS: SerialBus<Uart0> = SerialBus::new();
/// Alarm that polls for the end of the last character.
static END: Alarm = Alarm::new(2);

#[interrupt]
fn UART0_IRQ() {
    UART.serve::<Uart0, _>(timer::now(), &QUEUE);
}

#[interrupt]
fn TIMER_IRQ_2() {
    if END.has_come() {
        UART.look::<Uart0>(look_after);
    }
}

/// Sets the alarm to interrupt when `span` has passed.
fn look_after(span: Duration) {
    if !END.set(timer::nearest(timer::now() + span) + 1) {
        NVIC::pend(Interrupt::TIMER_IRQ_2);
    }
}

/// The UART of the bus.
pub(crate) enum Uart0 {}

impl Uart for Uart0 {
    fn bus() -> &'static SerialBus<Self> {
        &BUS
    }

    fn start() {
        pins::drive_low(DE);
        pins::give_to_uart(wires::TX | wires::RX);
        UART.listen();
    }

    fn configure(line: Line) {
        UART.set_line(line);
    }

    #[inline]
    fn has_room() -> bool {
        UART.has_room()
    }

    #[inline]
    fn write(byte: u8) {
        UART.write(byte);
    }

    fn lose() {
        crate::lose();
    }

    fn pend() {
        NVIC::pend(Interrupt::UART0_IRQ);
    }

    #[inline]
    fn turn(sends: bool) {
        pins::write(DE, sends);
    }

    fn tap() -> Option<&'static Tap> {
        crate::TAP
    }

    #[inline]
    fn end() {
        UART.end::<Self>(look_after);
    }
}
