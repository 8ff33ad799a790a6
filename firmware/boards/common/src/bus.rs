//! The sending half of a bus: with a transceiver whose direction must be switched, or with a wire for each
//! direction.

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
use crate::tap::Tap;

/// Maximum number of characters that wait to be sent: the longest frame.
const MOST: usize = 256;

/// The UART of a bus.
pub trait Uart: Sized + 'static {
    /// The bus that this UART drives.
    fn bus() -> &'static SerialBus<Self>;

    /// Assigns the pins of the UART and enables its interrupt. The drive sets the line later.
    fn start();

    /// Sets the line now. A character that is being sent or received is lost.
    fn configure(line: Line);

    /// Returns `true` if the UART accepts a character to send.
    fn has_room() -> bool;

    /// Gives the UART a character to send.
    fn write(byte: u8);

    /// Triggers the interrupt that calls [`SerialBus::send`], now and whenever the UART has room.
    fn pend();

    /// Switches the transceiver to send (DE), or to receive.
    fn turn(sends: bool);

    /// Tap for the characters that the UART sends; `None` on a board without a cable.
    fn tap() -> Option<&'static Tap> {
        None
    }

    /// Called when a received character is lost because the queue of events is full. A board may count it.
    fn lose() {}

    /// Arranges a call of [`SerialBus::sent`] when the last stop bit has left. Called when no more characters
    /// wait.
    fn end();
}

/// The characters that wait to be sent, and the direction of the bus.
#[derive(Debug)]
pub struct SerialBus<U> {
    to_send: Queue<u8, MOST>,
    /// True from the first start bit to the last stop bit.
    sends: AtomicBool,
    /// True while the bus polls for the end of the last character, on a UART without an interrupt for that.
    ends: AtomicBool,
    /// True for a bus with a wire for each direction: it receives while it sends, and its direction is never
    /// switched.
    full_duplex: AtomicBool,
    /// Set when the queue has room for more characters again.
    has_room: AtomicBool,
    /// Duration of a character.
    character: Mutex<Cell<Duration>>,
    /// Settings that the line gets after all characters have been sent. Valid only if `changes` is set.
    next: Mutex<Cell<Line>>,
    changes: AtomicBool,
    uart: PhantomData<fn() -> U>,
}

impl<U: Uart> SerialBus<U> {
    /// A bus that sends nothing.
    #[expect(clippy::new_without_default, reason = "a static needs a constant")]
    pub const fn new() -> Self {
        Self {
            to_send: Queue::new(),
            sends: AtomicBool::new(false),
            ends: AtomicBool::new(false),
            full_duplex: AtomicBool::new(false),
            has_room: AtomicBool::new(false),
            character: Mutex::new(Cell::new(Duration::ZERO)),
            // All zeros, like the other fields, so that a static takes no space in flash.
            next: Mutex::new(Cell::new(Line::new(0, 0, Parity::None, 0))),
            changes: AtomicBool::new(false),
            uart: PhantomData,
        }
    }

    /// Sets whether the bus has a wire for each direction, or one for both.
    pub fn start(&self, full_duplex: bool) {
        self.full_duplex.store(full_duplex, Ordering::Relaxed);
    }

    /// Returns `true` if the drive receives. With a transceiver it receives nothing while it sends (BOARD-8).
    #[inline]
    pub fn hears(&self) -> bool {
        !self.sends() || self.full_duplex.load(Ordering::Relaxed)
    }

    /// Duration of a character.
    pub fn character(&self) -> Duration {
        critical_section::with(|cs| self.character.borrow(cs).get())
    }

    /// Gives the UART as many characters as it has room for. Called in its interrupt.
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
            if let Some(tap) = U::tap() {
                tap.put(byte);
            }
            // Set at half of the queue, so that the loop can add the remaining characters and they are sent
            // without a pause.
            if self.to_send.len() == MOST / 2 {
                self.has_room.store(true, Ordering::Relaxed);
            }
        }
    }

    /// Called in [`Uart::end`] of a UART without an interrupt for the end of the last stop bit: begins to
    /// poll for that end. Returns `false` if that is not necessary or has begun already.
    #[inline]
    pub fn begin_end(&self) -> bool {
        let begins = self.sends() && !self.ends();
        if begins {
            self.ends.store(true, Ordering::Relaxed);
        }
        begins
    }

    /// Returns `true` while the bus polls for the end of the last stop bit. Sending a further character ends
    /// that.
    #[inline]
    pub fn ends(&self) -> bool {
        self.ends.load(Ordering::Relaxed)
    }

    /// Called when the last stop bit has left.
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

    /// Returns `true` if the queue has gained room since the last [`look`](Self::look).
    pub(crate) fn has_room(&self) -> bool {
        self.has_room.load(Ordering::Relaxed)
    }

    /// Called when the loop is about to check for work.
    pub(crate) fn look(&self) {
        self.has_room.store(false, Ordering::Relaxed);
    }

    /// Drops the characters that wait. What the UART has already leaves.
    pub(crate) fn silence(&self) {
        while self.to_send.pop().is_some() {}
    }

    /// Returns `true` while the line is to get other settings, after the characters that wait.
    pub(crate) fn is_changing(&self) -> bool {
        self.changes.load(Ordering::Relaxed)
    }

    /// Returns `true` from the first start bit to the last stop bit.
    pub(crate) fn sends(&self) -> bool {
        self.sends.load(Ordering::Relaxed)
    }

    fn configure(&self, line: Line) {
        critical_section::with(|cs| self.character.borrow(cs).set(line.character()));
        U::configure(line);
    }
}

/// The sending half of a bus, for the loop. It takes no stack.
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
    /// Returns `false` while a change of the line is pending: everything that is written after it must wait.
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        let bus = U::bus();
        Ok(!bus.changes.load(Ordering::Relaxed) && !bus.to_send.is_full())
    }
}

impl<U: Uart> Write for Sender<U> {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        let written = bytes.iter().take_while(|byte| U::bus().to_send.push(**byte)).count();
        // The interrupt sends the first character, and is called again whenever there is room.
        U::pend();
        Ok(written)
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        while U::bus().sends() || !U::bus().to_send.is_empty() {}
        Ok(())
    }
}
