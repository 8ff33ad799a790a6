//! Characters of the drive on their way to the computer.

use core::ops::Range;

use crate::cable::{Cable, CablePort};
use crate::tap::Tap;

/// Greatest number of characters in a packet, as of a USB serial port.
const MOST: usize = 63;

/// Characters that have left the UART, for the port of the bus. Together they are one packet: the computer may take fewer
/// packets than a fast drive sends characters.
#[derive(Debug)]
pub(crate) struct Packet {
    bytes: [u8; MOST],
    /// Places of the characters that the cable has not taken.
    waiting: Range<usize>,
}

impl Packet {
    /// No characters.
    pub(crate) const fn new() -> Self {
        Self { bytes: [0; MOST], waiting: 0..0 }
    }

    /// Takes characters that have left the UART, as many as there is room for. `sends` is true while the UART still sends.
    pub(crate) fn fill(&mut self, tap: &Tap, sends: bool) {
        let room = self.bytes.get_mut(self.waiting.end..).unwrap_or_default();
        for place in room.iter_mut().take(tap.count(sends)) {
            let Some(character) = tap.take() else { return };
            *place = character;
            self.waiting.end += 1;
        }
    }

    /// Gives the characters to the computer, as far as the cable has room.
    pub(crate) fn send(&mut self, cable: &mut impl Cable) {
        let bytes = self.bytes.get(self.waiting.clone()).unwrap_or_default();
        if !bytes.is_empty() {
            self.waiting.start += cable.write(CablePort::Bus, bytes);
        }
        if self.waiting.is_empty() {
            self.clear();
        }
    }

    /// Drops the characters.
    pub(crate) fn clear(&mut self) {
        self.waiting = 0..0;
    }
}
