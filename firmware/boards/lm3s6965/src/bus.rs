//! The bus: UART0, behind an RS-485 transceiver, which sends while DE is high, or with a wire for each
//! direction.
//!
//! The UART has no interrupt for the end of the last stop bit. When the last character goes to its shift
//! register a timer is set to the time of a character, and looks whether it has gone.

use core::cell::Cell;
use core::convert::Infallible;
use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m::peripheral::NVIC;
use critical_section::Mutex;
use drivetwin_board::{Bus, Queue};
use drivetwin_firmware::device::{Duration, Line, Port};
use drivetwin_firmware::shell::Caught;
use embedded_io::{ErrorType, Write, WriteReady};
use lm3s6965::{Interrupt, interrupt};

use crate::gpio::{self, Gpio};
use crate::timer::SENT;
use crate::uart::BUS;
use crate::{caught, clock};

/// What the transceiver hears. Behind it is the UART's output.
const RX: Gpio = gpio::A.pin(0);
/// The direction of the transceiver: it sends while this is high.
const DE: Gpio = gpio::B.pin(5);

/// Characters that wait to be sent: one of the longest frames.
static TO_SEND: Queue<u8, 256> = Queue::new();
/// What the line becomes when all has been sent.
static THEN: Mutex<Cell<Option<Line>>> = Mutex::new(Cell::new(None));
/// How long a character takes.
static CHARACTER: Mutex<Cell<Duration>> = Mutex::new(Cell::new(Duration::ZERO));
/// There is a wire for each direction: it hears while it sends, and there is nothing to turn around.
static FULL_DUPLEX: AtomicBool = AtomicBool::new(false);
/// Something is being sent.
static SENDS: AtomicBool = AtomicBool::new(false);
/// There is room where there was none.
static ROOM: AtomicBool = AtomicBool::new(false);

/// Starts to listen.
pub(crate) fn start(full_duplex: bool) {
    FULL_DUPLEX.store(full_duplex, Ordering::Relaxed);
    DE.push_pull();
    // A transceiver may let it go while it sends.
    RX.pulled(true);
    gpio::A.give(0b11);
    BUS.listen();
}

/// Whether it has room again since the last time.
pub(crate) fn take_room() -> bool {
    ROOM.swap(false, Ordering::Relaxed)
}

#[interrupt]
fn UART0() {
    let at = clock::now();
    BUS.acknowledge();
    while let Some(character) = BUS.receive() {
        // The receiver of a transceiver is off while it sends.
        if !sends() || FULL_DUPLEX.load(Ordering::Relaxed) {
            let caught = character.map_or(Caught::Spoiled(Port(0)), |byte| Caught::Byte(Port(0), byte));
            // Should the loop ever be that late, the character is lost. Of a Modbus frame the CRC tells; a QSB's
            // command has none.
            let _ = caught::QUEUE.push((at, caught));
        }
    }
    while BUS.has_room() {
        let was_full = TO_SEND.is_full();
        let Some(byte) = TO_SEND.pop() else {
            if sends() && !SENT.is_running() {
                end(character());
            }
            return;
        };
        set_sends(true);
        BUS.send(byte);
        if was_full {
            ROOM.store(true, Ordering::Relaxed);
        }
    }
}

#[interrupt]
fn TIMER_2A() {
    SENT.acknowledge();
    if TO_SEND.is_empty() {
        end(Duration::from_ticks(character().ticks() >> 4));
    }
}

fn sends() -> bool {
    SENDS.load(Ordering::Relaxed)
}

/// Begins to send, or has sent all.
fn set_sends(sends: bool) {
    SENDS.store(sends, Ordering::Relaxed);
    DE.write(sends && !FULL_DUPLEX.load(Ordering::Relaxed));
}

fn character() -> Duration {
    critical_section::with(|cs| CHARACTER.borrow(cs).get())
}

/// Everything has left, or the last character is still in the shift register: then looks `again` later.
fn end(again: Duration) {
    critical_section::with(|cs| {
        if BUS.is_busy() {
            SENT.start(again);
            return;
        }
        set_sends(false);
        if let Some(line) = THEN.borrow(cs).take() {
            set_line(line);
        }
        ROOM.store(true, Ordering::Relaxed);
    });
}

fn set_line(line: Line) {
    critical_section::with(|cs| CHARACTER.borrow(cs).set(line.character()));
    BUS.set_line(line);
}

/// The sending half of the bus.
pub(crate) struct Sender;

impl Bus for Sender {
    fn set_line(&mut self, line: Line) {
        critical_section::with(|cs| {
            if TO_SEND.is_empty() && !sends() {
                set_line(line);
            } else {
                THEN.borrow(cs).set(Some(line));
            }
        });
    }
}

impl ErrorType for Sender {
    type Error = Infallible;
}

impl WriteReady for Sender {
    /// What is written behind a change of the line waits for it.
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        let changes = critical_section::with(|cs| THEN.borrow(cs).get().is_some());
        Ok(!changes && !TO_SEND.is_full())
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
        while !TO_SEND.is_empty() || sends() {}
        Ok(())
    }
}
