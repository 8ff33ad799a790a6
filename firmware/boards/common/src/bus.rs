//! The sending half of a bus: behind a transceiver that has to be turned around, or with a wire for each direction.

use core::cell::Cell;
use core::convert::Infallible;
use core::marker::PhantomData;
use core::sync::atomic::{AtomicBool, Ordering};

use critical_section::Mutex;
use drivetwin_firmware::device::{Duration, Line};
use drivetwin_protocol::line::Parity;
use embedded_io::{ErrorType, Write, WriteReady};

use crate::board_outputs::Bus;
use crate::queue::Queue;

/// Characters that may wait to be sent: one of the longest frames.
const MOST: usize = 256;

/// The UART of a bus.
pub trait Uart: Sized + 'static {
    /// The bus that it drives.
    fn bus() -> &'static SerialBus<Self>;

    /// Assigns its pins and enables its interrupt; the drive sets the line.
    fn start();

    /// Sets the line now; a character under way is lost.
    fn configure(line: Line);

    /// `true` if it takes a character to send.
    fn has_room() -> bool;

    /// Takes a character to send.
    fn write(byte: u8);

    /// Has the interrupt come that calls [`SerialBus::send`], now and whenever there is room.
    fn pend();

    /// Switches the transceiver to send (DE), or to receive.
    fn turn(sends: bool);

    /// Has [`SerialBus::sent`] called when the last stop bit has left: no more characters wait.
    fn end();
}

/// The characters that wait to be sent, and the direction of the bus.
#[derive(Debug)]
pub struct SerialBus<U> {
    to_send: Queue<u8, MOST>,
    /// Set from the first start bit to the last stop bit.
    sends: AtomicBool,
    /// Set while its end is looked for, where no interrupt signals it, and the last character is on its way.
    ends: AtomicBool,
    /// Set for a wire for each direction: the bus receives while it sends, and needs no change of direction.
    full_duplex: AtomicBool,
    /// Set when it takes more to send than it did.
    has_room: AtomicBool,
    /// The duration of a character.
    character: Mutex<Cell<Duration>>,
    /// The settings of the line when all has left, if they change.
    next: Mutex<Cell<Line>>,
    changes: AtomicBool,
    uart: PhantomData<fn() -> U>,
}

impl<U: Uart> SerialBus<U> {
    /// A bus on which nothing is sent.
    #[expect(clippy::new_without_default, reason = "a static needs a constant")]
    pub const fn new() -> Self {
        Self {
            to_send: Queue::new(),
            sends: AtomicBool::new(false),
            ends: AtomicBool::new(false),
            full_duplex: AtomicBool::new(false),
            has_room: AtomicBool::new(false),
            character: Mutex::new(Cell::new(Duration::ZERO)),
            // All zeros, as all else here: a static takes no place in flash.
            next: Mutex::new(Cell::new(Line::new(0, 0, Parity::None, 0))),
            changes: AtomicBool::new(false),
            uart: PhantomData,
        }
    }

    /// Has a wire for each direction, or one for both.
    pub fn start(&self, full_duplex: bool) {
        self.full_duplex.store(full_duplex, Ordering::Relaxed);
    }

    /// `true` if the drive receives: behind a transceiver not while it sends (BOARD-8).
    #[inline]
    pub fn hears(&self) -> bool {
        !self.sends() || self.full_duplex.load(Ordering::Relaxed)
    }

    /// The duration of a character.
    pub fn character(&self) -> Duration {
        critical_section::with(|cs| self.character.borrow(cs).get())
    }

    /// Gives the UART what it has room for, in its interrupt.
    #[inline]
    pub fn send(&self) {
        while U::has_room() {
            let Some(byte) = self.to_send.pop() else {
                U::end();
                return;
            };
            if !self.full_duplex.load(Ordering::Relaxed) {
                U::turn(true);
            }
            self.sends.store(true, Ordering::Relaxed);
            self.ends.store(false, Ordering::Relaxed);
            U::write(byte);
            // In time for what does not fit to be sent without a pause.
            if self.to_send.len() == MOST / 2 {
                self.has_room.store(true, Ordering::Relaxed);
            }
        }
    }

    /// Begins to look for the end of the last stop bit, in [`Uart::end`] of a UART without an interrupt for it. `false`
    /// if there is no need to, or it has begun.
    #[inline]
    pub fn begin_end(&self) -> bool {
        let begins = self.sends() && !self.ends();
        if begins {
            self.ends.store(true, Ordering::Relaxed);
        }
        begins
    }

    /// `true` while the end of the last stop bit is looked for; not any more once another character is sent.
    #[inline]
    pub fn ends(&self) -> bool {
        self.ends.load(Ordering::Relaxed)
    }

    /// The last stop bit has left.
    pub fn sent(&self) {
        U::turn(false);
        if self.changes.load(Ordering::Relaxed) {
            self.changes.store(false, Ordering::Relaxed);
            self.configure(critical_section::with(|cs| self.next.borrow(cs).get()));
        }
        self.ends.store(false, Ordering::Relaxed);
        self.sends.store(false, Ordering::Relaxed);
        self.has_room.store(true, Ordering::Relaxed);
    }

    /// `true` if it takes more to send than when the loop [looked](Self::look) last.
    pub(crate) fn has_room(&self) -> bool {
        self.has_room.load(Ordering::Relaxed)
    }

    /// The loop is about to look.
    pub(crate) fn look(&self) {
        self.has_room.store(false, Ordering::Relaxed);
    }

    fn sends(&self) -> bool {
        self.sends.load(Ordering::Relaxed)
    }

    fn configure(&self, line: Line) {
        critical_section::with(|cs| self.character.borrow(cs).set(line.character()));
        U::configure(line);
    }
}

/// The sending half of a bus, as the loop has it. It takes no place on the stack.
#[derive(Debug)]
pub struct Sender<U>(PhantomData<fn() -> U>);

impl<U: Uart> Sender<U> {
    /// The sending half.
    #[expect(clippy::new_without_default, reason = "there is only one")]
    #[must_use]
    pub const fn new() -> Self {
        Self(PhantomData)
    }
}

impl<U: Uart> Bus for Sender<U> {
    fn set_line(&mut self, line: Line) {
        let bus = U::bus();
        critical_section::with(|cs| {
            if !bus.sends() && bus.to_send.is_empty() {
                bus.configure(line);
            } else {
                bus.next.borrow(cs).set(line);
                bus.changes.store(true, Ordering::Relaxed);
            }
        });
    }
}

impl<U> ErrorType for Sender<U> {
    type Error = Infallible;
}

impl<U: Uart> WriteReady for Sender<U> {
    /// `false` while a change of the line waits: all that is written behind it waits, too.
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        let bus = U::bus();
        Ok(!bus.changes.load(Ordering::Relaxed) && !bus.to_send.is_full())
    }
}

impl<U: Uart> Write for Sender<U> {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        let written = bytes.iter().take_while(|byte| U::bus().to_send.push(**byte)).count();
        // The interrupt takes the first one, and comes again whenever there is room.
        U::pend();
        Ok(written)
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        while U::bus().sends() || !U::bus().to_send.is_empty() {}
        Ok(())
    }
}
