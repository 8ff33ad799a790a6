//! Frames: a message as postcard with a CRC, encoded with COBS, and a zero byte.

use core::fmt;

use drivetwin_protocol::modbus::rtu;
use serde::{Deserialize, Serialize};

/// Greatest length of a frame in bytes, with its zero byte. COBS adds one byte to at most 254.
pub const FRAME: usize = 256;

/// Greatest length of a message with its CRC.
const MESSAGE: usize = FRAME - 2;

/// Length of the CRC.
const CRC: usize = 2;

/// The message does not fit into a frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct TooLong;

impl fmt::Display for TooLong {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the message does not fit into a frame")
    }
}

impl core::error::Error for TooLong {}

/// The frame of a message, in `frame`.
///
/// # Errors
/// The message is too long.
pub fn encode<'a>(message: &impl Serialize, frame: &'a mut [u8; FRAME]) -> Result<&'a [u8], TooLong> {
    let mut plain = [0; MESSAGE];
    let used = postcard::to_slice(message, &mut plain).map_err(|_| TooLong)?.len();
    let crc = rtu::crc(plain.get(..used).unwrap_or_default()).to_le_bytes();
    plain.get_mut(used..used + CRC).ok_or(TooLong)?.copy_from_slice(&crc);
    let encoded =
        cobs::try_encode(plain.get(..used + CRC).unwrap_or_default(), frame).map_err(|_| TooLong)?;
    *frame.get_mut(encoded).ok_or(TooLong)? = 0;
    frame.get(..=encoded).ok_or(TooLong)
}

/// Finds messages in a stream of bytes.
#[derive(Clone, Debug)]
pub struct Decoder {
    bytes: [u8; FRAME],
    /// Number of bytes since the last zero byte; more than [`FRAME`] of them are no frame.
    count: usize,
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

impl Decoder {
    /// A decoder at the beginning of a stream.
    #[must_use]
    pub const fn new() -> Self {
        Self { bytes: [0; FRAME], count: 0 }
    }

    /// Takes the next byte of the stream. Returns the message that ends with it. Frames with a wrong CRC, too long ones
    /// and unknown messages are ignored.
    pub fn push<'a, M: Deserialize<'a>>(&'a mut self, byte: u8) -> Option<M> {
        if byte != 0 {
            if let Some(place) = self.bytes.get_mut(self.count) {
                *place = byte;
            }
            self.count = (self.count + 1).min(FRAME + 1);
            return None;
        }
        let count = core::mem::take(&mut self.count);
        let used = cobs::decode_in_place(self.bytes.get_mut(..count)?).ok()?;
        let (message, crc) = self.bytes.get(..used)?.split_last_chunk::<CRC>()?;
        if rtu::crc(message) != u16::from_le_bytes(*crc) {
            return None;
        }
        match postcard::take_from_bytes(message) {
            Ok((message, [])) => Some(message),
            _ => None,
        }
    }
}
