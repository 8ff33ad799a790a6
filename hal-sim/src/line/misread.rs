//! Characters as a port with other serial settings reads them.

use drivetwin_firmware::device::{Duration, Line};
use drivetwin_protocol::line::Parity;

/// Characters back to back, as bits on the wire.
struct Wire<'a> {
    bytes: &'a [u8],
    line: Line,
    /// Ticks that a character lasts.
    character: u64,
    /// Bits of a character.
    bits: u64,
}

/// Returns what a port with the settings `reader` reads from characters that are sent back to back with the settings
/// `sent`: the time from the start of the first character to the end of each, and its bits as a byte. Like a UART, the
/// port waits for a start bit and samples each bit in its middle. It passes on characters with a parity or framing
/// error as it has read them.
pub(super) fn misread(sent: Line, bytes: &[u8], reader: Line) -> Vec<(Duration, u8)> {
    let wire = Wire { bytes, line: sent, character: sent.character().ticks(), bits: u64::from(sent.bits()) };
    let (character, bits) = (reader.character().ticks(), u64::from(reader.bits()));
    let middle = |bit: u64| character * (2 * bit + 1) / (2 * bits);
    let mut read = Vec::new();
    let mut from = 0;
    while let Some(start) = wire.next(from, false) {
        if wire.is_one(start + middle(0)) {
            // The zero was too short for a start bit.
            from = start + middle(0);
            continue;
        }
        let byte = (0..u64::from(reader.data))
            .fold(0, |byte, bit| byte | u8::from(wire.is_one(start + middle(bit + 1))) << bit);
        read.push((Duration::from_ticks(start + character), byte));
        // After a zero in place of the stop bit, the next start bit needs a one before it.
        let Some(rest) = wire.next(start + middle(bits - u64::from(reader.stop)), true) else { break };
        from = rest;
    }
    read
}

impl Wire<'_> {
    /// The first time, not before `from`, at which the wire has this value; `None` if it never has this value.
    fn next(&self, from: u64, one: bool) -> Option<u64> {
        if self.is_one(from) == one {
            return Some(from);
        }
        let last = self.bytes.len() as u64 * self.bits;
        let bit = (self.bit_at(from) + 1..=last).find(|&bit| self.is_bit_one(bit) == one)?;
        let (whole, within) = (bit / self.bits, bit % self.bits);
        Some(whole * self.character + (within * self.character).div_ceil(self.bits))
    }

    fn is_one(&self, at: u64) -> bool {
        self.is_bit_one(self.bit_at(at))
    }

    /// The bit that is on the wire at a time.
    fn bit_at(&self, at: u64) -> u64 {
        let (whole, within) = (at / self.character, at % self.character);
        whole * self.bits + within * self.bits / self.character
    }

    /// Returns whether a bit is a one. After the characters the wire is at rest, which is a one.
    fn is_bit_one(&self, bit: u64) -> bool {
        let Some(&byte) = self.bytes.get((bit / self.bits) as usize) else { return true };
        let data = u64::from(self.line.data);
        let value = byte & (0xFF >> (8 - self.line.data.min(8)));
        match bit % self.bits {
            0 => false,
            bit if bit <= data => value >> (bit - 1) & 1 == 1,
            bit if bit == data + 1 && self.line.parity != Parity::None => {
                (value.count_ones() % 2 == 1) == (self.line.parity == Parity::Even)
            }
            _ => true,
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Bytes that a receiver with the settings `reader` reads if `bytes` are sent with the settings `sent`.
    fn bytes(sent: Line, bytes: &[u8], reader: Line) -> Vec<u8> {
        misread(sent, bytes, reader).into_iter().map(|(_, byte)| byte).collect()
    }

    fn line(baud: u32, data: u8, parity: Parity) -> Line {
        Line::new(baud, data, parity, 1)
    }

    #[test]
    fn parity_is_read_as_the_eighth_bit() {
        let (seven, eight) = (line(9_600, 7, Parity::Even), line(9_600, 8, Parity::None));
        // 0x31 has three ones, so its even parity bit is a one; 0x41 has two.
        assert_eq!(bytes(seven, b"1A:", eight), [0xB1, 0x41, 0x3A]);
        assert_eq!(bytes(eight, &[0xB1, 0x41], seven), b"1A");
    }

    #[test]
    fn another_parity_shifts_the_bits() {
        let (even, none) = (line(9_600, 8, Parity::Even), line(9_600, 8, Parity::None));
        // 0x07 has an odd number of ones: its parity bit is a one, like a stop bit.
        assert_eq!(bytes(even, &[0x07, 0x07], none), [0x07, 0x07]);
        // 0x03 has a parity bit of zero, which the reader takes for a bad stop bit. The real stop bit follows. It
        // is a one, so the reader finds the next start bit.
        assert_eq!(bytes(even, &[0x03, 0x07], none), [0x03, 0x07]);
        // The sender has no parity, the reader expects it. So the reader takes the stop bit for the parity bit, and
        // the start bit of the second character for the stop bit. Bits 0 to 7 of this 0x55 are 1 0 1 0 1 0 1 0. The
        // reader takes bit 1, the first zero, for a start bit. It reads bits 2 to 7 (1 0 1 0 1 0), then the stop bit
        // and the idle line, which are ones.
        assert_eq!(bytes(none, &[0x55, 0x55], even), [0x55, 0b1101_0101]);
    }

    #[test]
    fn at_twice_the_rate_each_bit_is_read_twice() {
        let (fast, slow) = (line(9_600, 8, Parity::None), line(4_800, 8, Parity::None));
        // The receiver sees 00 11 11 11 11 00 00 00 00 11, which are two characters of ten bits.
        assert_eq!(bytes(slow, &[0x0F], fast), [0xFE, 0x80]);
        // A slow reader reads one character while two fast ones pass.
        let read = misread(fast, &[0x33, 0x33], slow);
        assert_eq!((read.len(), read[0].0), (1, slow.character()));
    }

    fn some_line() -> impl Strategy<Value = Line> {
        let parity = prop_oneof![Just(Parity::None), Just(Parity::Even), Just(Parity::Odd)];
        let baud = prop_oneof![Just(50), Just(4_000_000), 50..=4_000_000_u32];
        (baud, 5..=8_u8, parity, 1..=2_u8)
            .prop_map(|(baud, data, parity, stop)| Line::new(baud, data, parity, stop))
    }

    proptest! {
        #[test]
        fn a_reader_with_the_same_settings_reads_what_was_sent(line in some_line(), sent: Vec<u8>) {
            let sent: Vec<u8> = sent.into_iter().map(|byte| byte & (0xFF >> (8 - line.data))).collect();
            let ends: Vec<Duration> = (1..=sent.len() as u64).map(|n| line.character() * n).collect();
            let read = misread(line, &sent, line);
            prop_assert_eq!(read, ends.into_iter().zip(sent).collect::<Vec<_>>());
        }

        #[test]
        fn a_reader_reads_no_more_characters_than_fit(sent in some_line(), reader in some_line(), bytes: Vec<u8>) {
            let read = misread(sent, &bytes, reader);
            let zeros = bytes.len() as u64 * u64::from(sent.bits()) / 2 + 1;
            prop_assert!(read.len() as u64 <= zeros);
            prop_assert!(read.is_sorted_by(|a, b| a.0 < b.0));
            prop_assert!(read.iter().all(|(_, byte)| *byte <= 0xFF >> (8 - reader.data)));
        }
    }
}
