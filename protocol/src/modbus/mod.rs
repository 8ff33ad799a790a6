//! Modbus as slaves speak it.
//!
//! Sources: *MODBUS Application Protocol Specification V1.1b3* ("application") and *MODBUS over
//! Serial Line V1.02* ("serial").
//!
//! [`pdu`] reads requests, [`rtu`] puts them on a serial line, [`server`] answers them from a
//! register map by the rules of a drive's manual.

pub mod pdu;
pub mod rtu;
pub mod server;

/// The longest frame on a serial line (serial 2.5.1): address, function, 252 bytes, CRC.
pub const FRAME_BYTES: usize = 256;

/// A frame of a serial line.
pub type Frame = heapless::Vec<u8, FRAME_BYTES>;

/// Why a slave is silent.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Why {
    /// The check sum does not hold.
    Crc,
    /// A silence of more than 1.5 characters inside the frame.
    Gap,
    /// Longer than any frame, or not as long as its function says.
    Length,
    /// A character that nobody could read.
    Spoiled,
    /// For somebody else.
    Address,
    /// The drive is starting and has no ears.
    Starting,
}
