//! Modbus as slaves speak it.
//!
//! Sources: *MODBUS Application Protocol Specification V1.1b3* ("application") and *MODBUS over
//! Serial Line V1.02* ("serial").
//!
//! [`pdu`] reads requests, [`rtu`] and [`ascii`] put them on a serial line, [`tcp`] on a connection, [`server`]
//! answers them from a register map by the rules of a drive's manual, [`identification`] says who it is.

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
pub enum Why {
    /// The check sum does not hold.
    Crc,
    /// A silence of more than 1.5 characters inside the frame; in ASCII of more than a second.
    Gap,
    /// Longer than any frame, or not as long as its function says; in ASCII half a byte.
    Length,
    /// A character that nobody could read; in ASCII also one that has no place in a message.
    Spoiled,
    /// For somebody else.
    Address,
    /// The drive is starting and has no ears.
    Starting,
}

/// Result of [`front`]: the first frame in a burst of characters, for a host whose own gaps say nothing.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Burst {
    /// A whole frame of that many bytes, which go to the drives together.
    Frame(usize),
    /// The rest is still to come.
    Partial,
    /// Perhaps whole, or as long as a frame and none: silence decides.
    Unsure,
    /// Length of a front that can become no frame any more.
    Broken(usize),
}

/// Speakers that are heard on a line.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Voices {
    /// A master.
    Master,
    /// Slaves that answer it.
    Slaves,
    /// A master and slaves.
    All,
}

/// Judges the front of a burst on `line`, by the framing that is spoken there, if more may come.
#[must_use]
pub fn front(line: Line, burst: &[u8], voices: Voices) -> Burst {
    if ascii::is_on(line) { ascii::front(burst) } else { rtu::front(burst, voices) }
}

/// Bytes of a burst that go to the drives together when silence has ended it and [`front`] has found no frame.
#[must_use]
pub fn ended(line: Line, burst: &[u8], voices: Voices) -> usize {
    if ascii::is_on(line) { burst.len() } else { rtu::ended(burst, voices) }
}
