//! Modbus, the slave's side.
//!
//! Sources: *MODBUS Application Protocol Specification V1.1b3* ("application") and *MODBUS over
//! Serial Line V1.02* ("serial").
//!
//! [`pdu`] parses requests. [`rtu`] and [`ascii`] frame them on a serial line, [`tcp`] on a TCP connection.
//! [`server`] answers them from a register map by the rules of a drive's manual. [`identification`] reports
//! the product.

pub mod ascii;
pub mod identification;
pub mod pdu;
pub mod rtu;
pub mod server;
pub mod tcp;

use core::fmt;

use crate::line::Line;
use crate::time::Instant;

/// The longest frame on a serial line (serial 2.5.1): address, function, 252 bytes, CRC.
pub const FRAME_BYTES: usize = 256;

/// A frame of a serial line.
pub type Frame = heapless::Vec<u8, FRAME_BYTES>;

/// Buffer for a reply: a [`Frame`] on a serial line or a [`tcp::Adu`] on a TCP connection.
pub type Reply = heapless::VecView<u8>;

/// Reason why a slave does not answer a frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum DropReason {
    /// The checksum does not match.
    Crc,
    /// A silence of more than 1.5 characters inside the frame; in ASCII of more than a second.
    Gap,
    /// The frame is longer than any frame may be, or does not have the length that its function requires; in
    /// ASCII also an odd number of digits.
    Length,
    /// A character with an error; in ASCII also one that is not allowed in a message.
    RxError,
    /// The frame is addressed to another slave.
    Address,
    /// The drive is starting up and receives nothing yet.
    Starting,
}

impl fmt::Display for DropReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Crc => "the checksum does not match",
            Self::Gap => "a gap between two characters is too long",
            Self::Length => "no frame has this length",
            Self::RxError => "a character was received with an error",
            Self::Address => "the frame is for another slave",
            Self::Starting => "the drive is starting",
        })
    }
}

impl core::error::Error for DropReason {}

/// Result of [`scan`]: the frame at the front of a burst of characters. A host uses it, because a host does
/// not know the gaps between the characters.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Scan {
    /// The burst begins with a whole frame of this many bytes. The bench passes them to the drives together.
    Complete(usize),
    /// The frame is not complete yet.
    Incomplete,
    /// The bytes may be a whole frame, or have the length of a frame but no valid CRC. Only the following
    /// silence decides.
    Ambiguous,
    /// The burst begins with this many bytes that can no longer become a frame.
    Invalid(usize),
}

/// Senders whose frames may be received on a line.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Expect {
    /// Only the master: requests.
    Requests,
    /// Only slaves: replies.
    Replies,
    /// The master and slaves: requests and replies.
    Both,
}

/// Scans the front of `burst` for a frame, with the framing of `line`. More characters may follow.
#[must_use]
pub fn scan(line: Line, burst: &[u8], expect: Expect) -> Scan {
    if ascii::is_on(line) { ascii::scan(burst) } else { rtu::scan(burst, expect) }
}

/// Number of bytes of `burst` that go to the drives together after silence has ended the burst and [`scan`]
/// has found no frame.
#[must_use]
pub fn ended(line: Line, burst: &[u8], expect: Expect) -> usize {
    if ascii::is_on(line) { burst.len() } else { rtu::ended(burst, expect) }
}

/// Receiver of the messages of a serial line in one framing. Timestamps are the *ends* of characters.
pub trait Receiver {
    /// A message in this framing.
    type Message<'a>: AsRef<[u8]>;

    /// A receiver on a silent line.
    fn new(line: Line) -> Self;

    /// Changes the settings of the line from the next character after `at` on.
    fn set_line(&mut self, at: Instant, line: Line);

    /// Handles received characters that follow each other without a gap; `at` is the end of the first one. If a message
    /// has ended before them, the caller [takes](Self::take_body) it first.
    fn bytes(&mut self, at: Instant, bytes: &[u8]);

    /// Handles a character with an error that ended at `at`.
    fn rx_error(&mut self, at: Instant);

    /// Time at which a message ends if no more characters follow; [`Instant::NEVER`] without a message.
    fn deadline(&self) -> Instant;

    /// Takes the message that has ended, and returns its address and PDU; `None` without a message.
    ///
    /// # Errors
    /// The reason why the received characters are not a message.
    fn take_body(&mut self) -> Option<Result<&[u8], DropReason>>;

    /// Drops the characters received so far.
    fn clear(&mut self);

    /// The message with `body`, an address and a PDU, in the framing of this receiver.
    fn message<'a>(&self, body: &'a mut Frame) -> Self::Message<'a>;
}

impl Receiver for rtu::RtuReceiver {
    type Message<'a> = &'a [u8];

    fn new(line: Line) -> Self {
        Self::new(line)
    }

    fn set_line(&mut self, at: Instant, line: Line) {
        self.set_line(at, line);
    }

    #[inline]
    fn bytes(&mut self, at: Instant, bytes: &[u8]) {
        self.bytes(at, bytes);
    }

    fn rx_error(&mut self, at: Instant) {
        self.rx_error(at);
    }

    #[inline]
    fn deadline(&self) -> Instant {
        self.deadline()
    }

    #[inline]
    fn take_body(&mut self) -> Option<Result<&[u8], DropReason>> {
        Some(self.take()?.and_then(|frame| rtu::verify_crc(frame).ok_or(DropReason::Crc)))
    }

    #[inline]
    fn clear(&mut self) {
        self.clear();
    }

    #[inline]
    fn message<'a>(&self, body: &'a mut Frame) -> &'a [u8] {
        rtu::append_crc(body);
        body
    }
}

/// Receiver of RTU, or of ASCII on a line of 7 data bits.
#[derive(Clone, Debug)]
pub enum RtuOrAscii {
    /// On a line of 8 data bits.
    Rtu(rtu::RtuReceiver),
    /// On a line of 7 data bits.
    Ascii(ascii::AsciiReceiver),
}

/// Message to send in RTU or in ASCII.
#[derive(Debug)]
#[expect(clippy::large_enum_variant, reason = "it is sent at once, and there is no heap")]
pub enum RtuOrAsciiMessage<'a> {
    /// In RTU.
    Rtu(&'a [u8]),
    /// In ASCII.
    Ascii(ascii::Message),
}

impl AsRef<[u8]> for RtuOrAsciiMessage<'_> {
    fn as_ref(&self) -> &[u8] {
        match self {
            Self::Rtu(message) => message,
            Self::Ascii(message) => message,
        }
    }
}

impl Receiver for RtuOrAscii {
    type Message<'a> = RtuOrAsciiMessage<'a>;

    fn new(line: Line) -> Self {
        if ascii::is_on(line) {
            Self::Ascii(ascii::AsciiReceiver::new(line))
        } else {
            Self::Rtu(rtu::RtuReceiver::new(line))
        }
    }

    /// Changes the line. An incomplete message of another framing is lost.
    fn set_line(&mut self, at: Instant, line: Line) {
        match self {
            Self::Rtu(receiver) if !ascii::is_on(line) => receiver.set_line(at, line),
            _ => *self = Self::new(line),
        }
    }

    fn bytes(&mut self, at: Instant, bytes: &[u8]) {
        match self {
            Self::Rtu(receiver) => receiver.bytes(at, bytes),
            Self::Ascii(receiver) => receiver.bytes(at, bytes),
        }
    }

    fn rx_error(&mut self, at: Instant) {
        match self {
            Self::Rtu(receiver) => receiver.rx_error(at),
            Self::Ascii(receiver) => receiver.rx_error(at),
        }
    }

    fn deadline(&self) -> Instant {
        match self {
            Self::Rtu(receiver) => receiver.deadline(),
            Self::Ascii(receiver) => receiver.deadline(),
        }
    }

    /// In ASCII an incomplete message stays in the receiver.
    fn take_body(&mut self) -> Option<Result<&[u8], DropReason>> {
        match self {
            Self::Rtu(receiver) => receiver.take_body(),
            Self::Ascii(receiver) => receiver.take(),
        }
    }

    fn clear(&mut self) {
        match self {
            Self::Rtu(receiver) => receiver.clear(),
            Self::Ascii(receiver) => receiver.clear(),
        }
    }

    fn message<'a>(&self, body: &'a mut Frame) -> RtuOrAsciiMessage<'a> {
        match self {
            Self::Rtu(receiver) => RtuOrAsciiMessage::Rtu(receiver.message(body)),
            Self::Ascii(_) => RtuOrAsciiMessage::Ascii(ascii::encode(body)),
        }
    }
}
