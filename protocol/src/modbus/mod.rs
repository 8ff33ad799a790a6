//! Modbus as a slave uses it.
//!
//! Sources: *MODBUS Application Protocol Specification V1.1b3* ("application") and *MODBUS over
//! Serial Line V1.02* ("serial").
//!
//! [`pdu`] parses requests, [`rtu`] and [`ascii`] frame them on a serial line, [`tcp`] on a connection, [`server`]
//! answers them from a register map by the rules of a drive's manual, [`identification`] reports the product.

pub mod ascii;
pub mod identification;
pub mod pdu;
pub mod rtu;
pub mod server;
pub mod tcp;

use crate::line::Line;

/// The longest frame on a serial line (serial 2.5.1): address, function, 252 bytes, CRC.
pub const FRAME_BYTES: usize = 256;

/// A frame of a serial line.
pub type Frame = heapless::Vec<u8, FRAME_BYTES>;

/// Buffer of a reply, whatever carries it: a [`Frame`] or a [`tcp::Adu`].
pub type Reply = heapless::VecView<u8>;

/// Reason why a slave is silent.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum DropReason {
    /// The check sum does not hold.
    Crc,
    /// A silence of more than 1.5 characters inside the frame; in ASCII of more than a second.
    Gap,
    /// Longer than any frame, or not the length that its function requires; in ASCII an odd number of digits.
    Length,
    /// A character with an error; in ASCII also one that is not allowed in a message.
    RxError,
    /// For another slave.
    Address,
    /// The drive is starting and has no ears.
    Starting,
}

/// Result of [`scan`]: the frame at the front of a burst of characters. For a host, where the gaps between characters
/// are unknown.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Scan {
    /// A whole frame of that many bytes, which go to the drives together.
    Complete(usize),
    /// The rest is still to come.
    Incomplete,
    /// Perhaps whole, or as long as a frame and none: silence decides.
    Ambiguous,
    /// Length of a front that can become no frame any more.
    Invalid(usize),
}

/// Frames that may come on a line.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Expect {
    /// Those of a master.
    Requests,
    /// Those of slaves.
    Replies,
    /// Those of a master and of slaves.
    Both,
}

/// Scans a burst on `line` for a frame at its front, by the framing of the line. More characters may follow.
#[must_use]
pub fn scan(line: Line, burst: &[u8], expect: Expect) -> Scan {
    if ascii::is_on(line) { ascii::scan(burst) } else { rtu::scan(burst, expect) }
}

/// Bytes of a burst that go to the drives together when silence has ended it and [`scan`] has found no frame.
#[must_use]
pub fn ended(line: Line, burst: &[u8], expect: Expect) -> usize {
    if ascii::is_on(line) { burst.len() } else { rtu::ended(burst, expect) }
}
