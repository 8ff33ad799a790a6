//! ASCII framing: a colon begins a message and a line feed ends it. Between them each byte is two hexadecimal
//! digits (serial 2.5.2).
//!
//! ```
//! use drivetwin_protocol::line::{Line, Parity};
//! use drivetwin_protocol::modbus::ascii::{self, AsciiReceiver};
//! use drivetwin_protocol::time::Instant;
//!
//! // Slave 0x11: read 2 holding registers from 0x006B. 0x7F makes the sum of all bytes 0.
//! let body = [0x11, 3, 0, 0x6B, 0, 2];
//! assert_eq!(ascii::lrc(&body), 0x7F);
//! assert_eq!(ascii::encode(&body), b":1103006B00027F\r\n");
//! assert_eq!(ascii::decode(b":1103006B00027F\r\n").as_deref(), Some(&body[..]));
//!
//! // 9600 7E1: a character has 10 bits, which are 16,667 ticks of 62.5 ns. The line feed ends the message.
//! let mut receiver = AsciiReceiver::new(Line::new(9_600, 7, Parity::Even, 1));
//! receiver.bytes(Instant::from_ticks(1_000_000), b":1103006B00027F\r\n");
//! assert_eq!(receiver.deadline(), Instant::from_ticks(1_000_000 + 16 * 16_667));
//! assert_eq!(receiver.take(), Some(Ok(&body[..])));
//! ```

use super::pdu::{READ_HOLDING_REGISTERS, WRITE_SINGLE_REGISTER};
use super::{DropReason, FRAME_BYTES, Frame, Scan};
use crate::line::Line;
use crate::time::{Duration, Instant};

/// The longest message: a colon, then address, function, 252 bytes and LRC in two digits each, then CR and
/// LF.
pub const MESSAGE_CHARACTERS: usize = 513;

/// A message with all its characters, as sent on the line.
pub type Message = heapless::Vec<u8, MESSAGE_CHARACTERS>;

/// Bytes of the longest message: address, function, 252 bytes, LRC.
const MAX_BYTES: usize = FRAME_BYTES - 1;

/// The longest silence between two characters of a message.
const MAX_GAP: Duration = Duration::secs(1);

/// Returns true if a line uses ASCII framing, that is, has 7 data bits. RTU needs 8.
#[must_use]
pub const fn is_on(line: Line) -> bool {
    line.data == 7
}

/// The LRC of `bytes` (serial 2.5.2.2): the byte that makes the sum of all bytes 0.
#[must_use]
pub fn lrc(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0_u8, |sum, &byte| sum.wrapping_sub(byte))
}

/// The message of a body: an address and a PDU, together at most 254 bytes. A longer body is truncated.
#[must_use]
pub fn encode(body: &[u8]) -> Message {
    let body = body.get(..MAX_BYTES - 1).unwrap_or(body);
    let mut message = Message::new();
    let _ = message.push(b':');
    for &byte in body.iter().chain(&[lrc(body)]) {
        let _ = message.extend_from_slice(&[character(byte >> 4), character(byte & 0xF)]);
    }
    let _ = message.extend_from_slice(b"\r\n");
    message
}

/// The body of a message; `None` if the message is malformed or its LRC does not match.
#[must_use]
pub fn decode(message: &[u8]) -> Option<Frame> {
    let digits = message.strip_prefix(b":")?.strip_suffix(b"\r\n")?;
    let mut body = Frame::new();
    for pair in digits.chunks(2) {
        let &[high, low] = pair else { return None };
        body.push(digit(high)? << 4 | digit(low)?).ok()?;
    }
    let sum = body.pop()?;
    (sum == lrc(&body) && message.len() <= MESSAGE_CHARACTERS).then_some(body)
}

/// The message of an address and a PDU of at most 253 bytes. A longer PDU is truncated.
#[must_use]
pub fn frame(unit: u8, pdu: &[u8]) -> Message {
    let mut body = Frame::new();
    let _ = body.push(unit);
    let _ = body.extend_from_slice(pdu.get(..MAX_BYTES - 2).unwrap_or(pdu));
    encode(&body)
}

/// A master's request to read `count` holding registers from `first`.
#[must_use]
pub fn read(unit: u8, first: u16, count: u16) -> Message {
    let ([a, b], [c, d]) = (first.to_be_bytes(), count.to_be_bytes());
    frame(unit, &[READ_HOLDING_REGISTERS, a, b, c, d])
}

/// A master's request to write one holding register.
#[must_use]
pub fn write(unit: u8, address: u16, value: u16) -> Message {
    let ([a, b], [c, d]) = (address.to_be_bytes(), value.to_be_bytes());
    frame(unit, &[WRITE_SINGLE_REGISTER, a, b, c, d])
}

/// The hexadecimal character of a digit below 16.
const fn character(digit: u8) -> u8 {
    if digit < 10 { b'0' + digit } else { b'A' + (digit - 10) }
}

/// The value of a hexadecimal character. Lower case is accepted, though the specification has only upper
/// case.
const fn digit(character: u8) -> Option<u8> {
    match character {
        b'0'..=b'9' => Some(character - b'0'),
        b'A'..=b'F' => Some(character - b'A' + 10),
        b'a'..=b'f' => Some(character - b'a' + 10),
        _ => None,
    }
}

/// State of a receiver.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum State {
    /// No colon received yet.
    Idle,
    /// Receiving digits. The value is the first digit of a pair while the second is missing.
    Receiving(Option<u8>),
    /// Received digits and a CR. An LF must follow.
    Ending,
    /// The message has an error. The receiver drops it at its LF.
    Bad(DropReason),
    /// The message has ended. The value is the reason why it is dropped, if any.
    Over(Option<DropReason>),
}

/// Receiver of a slave: takes characters and returns the bodies of messages.
///
/// Timestamps are the ends of characters. A message ends with its LF. The receiver holds one message until
/// the caller [takes](Self::take) it, and ignores all characters until then. So the caller must pass no
/// characters after an LF in the same call.
#[derive(Clone, Debug)]
pub struct AsciiReceiver {
    character: Duration,
    /// Body of the message. The LRC is at its end until the message is complete, and is then removed.
    body: Frame,
    state: State,
    /// End of the last character.
    last: Instant,
}

impl AsciiReceiver {
    /// A receiver on a silent line.
    #[must_use]
    pub const fn new(line: Line) -> Self {
        Self { character: line.character(), body: Frame::new(), state: State::Idle, last: Instant::ZERO }
    }

    /// Handles received characters that follow each other without a gap; `at` is the end of the first one.
    pub fn bytes(&mut self, at: Instant, bytes: &[u8]) {
        let mut end = at;
        for &byte in bytes {
            self.on_character(end, Some(byte));
            end += self.character;
        }
    }

    /// Handles a character with an error that ended at `at`.
    pub fn rx_error(&mut self, at: Instant) {
        self.on_character(at, None);
    }

    /// Handles a character that ended at `at`; `None` is a character with an error.
    fn on_character(&mut self, at: Instant, character: Option<u8>) {
        let silence = (at - self.character).since(self.last);
        let state = match self.state {
            State::Receiving(_) | State::Ending if silence > MAX_GAP => State::Bad(DropReason::Gap),
            state => state,
        };
        self.state = match (state, character) {
            (State::Over(_), _) => return,
            (_, Some(b':')) => {
                self.body.clear();
                State::Receiving(None)
            }
            (State::Idle, _) => State::Idle,
            (State::Ending, Some(b'\n')) => State::Over(self.check_lrc()),
            (State::Bad(why), Some(b'\n')) => State::Over(Some(why)),
            (State::Receiving(_), Some(b'\n')) => State::Over(Some(DropReason::RxError)),
            (State::Bad(why), _) => State::Bad(why),
            (State::Receiving(None), Some(b'\r')) => State::Ending,
            (State::Receiving(Some(_)), Some(b'\r')) => State::Bad(DropReason::Length),
            (State::Receiving(high), Some(character)) => self.digit(high, character),
            (State::Receiving(_), None) | (State::Ending, _) => State::Bad(DropReason::RxError),
        };
        self.last = at;
    }

    /// Handles a character between the colon and the CR. `high` is the first digit of a pair if `character`
    /// is the second.
    fn digit(&mut self, high: Option<u8>, character: u8) -> State {
        let Some(digit) = digit(character) else { return State::Bad(DropReason::RxError) };
        let Some(high) = high else { return State::Receiving(Some(digit)) };
        if self.body.len() >= MAX_BYTES {
            return State::Bad(DropReason::Length);
        }
        let _ = self.body.push(high << 4 | digit);
        State::Receiving(None)
    }

    /// Removes the LRC from the body and checks it. Returns the reason if the message is invalid.
    fn check_lrc(&mut self) -> Option<DropReason> {
        match self.body.pop() {
            None => Some(DropReason::Length),
            Some(sum) => (sum != lrc(&self.body)).then_some(DropReason::Crc),
        }
    }

    /// End of the received message; [`Instant::NEVER`] if no message has ended.
    #[must_use]
    pub fn deadline(&self) -> Instant {
        match self.state {
            State::Over(_) => self.last,
            _ => Instant::NEVER,
        }
    }

    /// Returns true if a message has ended at `at` or before.
    #[must_use]
    pub fn is_over(&self, at: Instant) -> bool {
        self.deadline() <= at
    }

    /// Takes the body of the received message, an address and a PDU; `None` while no message is complete.
    ///
    /// # Errors
    /// The reason why the received characters are not a message.
    pub fn take(&mut self) -> Option<Result<&[u8], DropReason>> {
        let State::Over(bad) = self.state else { return None };
        self.clear();
        Some(bad.map_or(Ok(&self.body), Err))
    }

    /// Drops the characters received so far.
    pub fn clear(&mut self) {
        self.state = State::Idle;
    }
}

/// Finds a message at the front of a burst: everything up to an LF is one message, valid or not. Without a
/// colon no message has begun.
#[must_use]
pub fn scan(burst: &[u8]) -> Scan {
    if let Some(end) = burst.iter().position(|&character| character == b'\n') {
        return Scan::Complete(end + 1);
    }
    match burst.iter().rposition(|&character| character == b':') {
        Some(start) if burst.len() - start < MESSAGE_CHARACTERS => Scan::Incomplete,
        None if burst.is_empty() => Scan::Incomplete,
        _ => Scan::Invalid(burst.len()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::line::Parity;
    use proptest::prelude::*;
    use std::vec::Vec;

    const LINE: Line = Line::new(9_600, 7, Parity::Even, 1);
    /// 10 bits at 9,600 baud, in ticks of 62.5 ns.
    const CHARACTER: u64 = 16_667;
    const START: Instant = Instant::from_ticks(1_000_000);

    /// Reads 2 registers from 006Bh of slave 11h. LRC: 11 + 03 + 00 + 6B + 00 + 02 = 81h, and 81h + 7Fh =
    /// 100h.
    const REQUEST: &[u8] = b":1103006B00027F\r\n";
    const BODY: &[u8] = &[0x11, 3, 0, 0x6B, 0, 2];

    /// Result of a new receiver that gets all `characters` in one call.
    fn received(characters: &[u8]) -> Option<Result<Vec<u8>, DropReason>> {
        let mut receiver = AsciiReceiver::new(LINE);
        receiver.bytes(START, characters);
        receiver.take().map(|body| body.map(<[u8]>::to_vec))
    }

    #[test]
    fn a_message_and_its_body() {
        assert_eq!(lrc(BODY), 0x7F);
        assert_eq!(encode(BODY)[..], *REQUEST);
        assert_eq!(frame(0x11, &BODY[1..])[..], *REQUEST);
        assert_eq!(read(0x11, 0x6B, 2)[..], *REQUEST);
        // LRC: 01 + 06 + 50 + 0B + 03 + E8 = 14Dh, and 4Dh + B3h = 100h.
        assert_eq!(write(1, 0x500B, 1_000)[..], *b":0106500B03E8B3\r\n");
        assert_eq!(decode(REQUEST).as_deref(), Some(BODY));
        assert_eq!(received(REQUEST), Some(Ok(BODY.to_vec())));
    }

    #[test]
    fn lower_case_is_understood() {
        assert_eq!(received(b":1103006b00027f\r\n"), Some(Ok(BODY.to_vec())));
        assert_eq!(decode(b":1103006b00027f\r\n").as_deref(), Some(BODY));
    }

    #[test]
    fn a_message_is_over_with_its_line_feed() {
        let mut receiver = AsciiReceiver::new(LINE);
        assert_eq!(receiver.deadline(), Instant::NEVER);
        receiver.bytes(START, &REQUEST[..16]);
        assert_eq!((receiver.deadline(), receiver.take()), (Instant::NEVER, None), "half a message waits");
        let end = START + Duration::millis(900);
        receiver.bytes(end, &REQUEST[16..]);
        assert_eq!(receiver.deadline(), end);
        assert!(!receiver.is_over(end - Duration::TICK) && receiver.is_over(end));
        assert_eq!(receiver.take(), Some(Ok(BODY)));
        assert_eq!((receiver.deadline(), receiver.take()), (Instant::NEVER, None));
        receiver.bytes(end + Duration::secs(100), REQUEST);
        assert_eq!(receiver.deadline(), end + Duration::secs(100) + Duration::from_ticks(16 * CHARACTER));
        assert_eq!(receiver.take(), Some(Ok(BODY)));
    }

    #[test]
    fn why_a_message_is_dropped() {
        for (message, why) in [
            (&b":1103006B00027E\r\n"[..], DropReason::Crc),
            (b":1103006B00027\r\n", DropReason::Length),
            (b":\r\n", DropReason::Length),
            (b":1103006G00027F\r\n", DropReason::RxError),
            (b":1103 006B00027F\r\n", DropReason::RxError),
            (b":1103006B00027F\r\r\n", DropReason::RxError),
            (b":1103006B00027F\n", DropReason::RxError),
            (b":1103\x80006B00027F\r\n", DropReason::RxError),
        ] {
            assert_eq!(received(message), Some(Err(why)), "{}", message.escape_ascii());
            assert_eq!(decode(message), None, "{}", message.escape_ascii());
        }
        // A body of one byte with its LRC is a valid message here. The server checks addresses and functions.
        assert_eq!(received(b":01FF\r\n"), Some(Ok([1].to_vec())));
    }

    #[test]
    fn the_longest_message_has_513_characters() {
        let longest = [0x5A; 254];
        let message = encode(&longest);
        assert_eq!(message.len(), 513);
        assert_eq!(received(&message), Some(Ok(longest.to_vec())));
        assert_eq!(encode(&[0x5A; 300])[..], message[..]);
        assert_eq!(frame(0x5A, &[0x5A; 300])[..], message[..]);
        let longer = [&message[..511], b"00\r\n"].concat();
        assert_eq!(received(&longer), Some(Err(DropReason::Length)));
    }

    #[test]
    fn a_character_that_nobody_could_read_spoils_a_message() {
        for cut in 1..REQUEST.len() - 1 {
            let mut receiver = AsciiReceiver::new(LINE);
            receiver.bytes(START, &REQUEST[..cut]);
            let spoiled = START + LINE.character() * cut as u64;
            receiver.rx_error(spoiled);
            receiver.bytes(spoiled + LINE.character(), &REQUEST[cut + 1..]);
            assert_eq!(receiver.take(), Some(Err(DropReason::RxError)), "character {cut}");
        }
    }

    #[test]
    fn a_second_of_silence_is_the_longest() {
        let second = Duration::from_ticks(16_000_000);
        for (silence, body) in [(second, Ok(BODY)), (second + Duration::TICK, Err(DropReason::Gap))] {
            for cut in 1..REQUEST.len() {
                let mut receiver = AsciiReceiver::new(LINE);
                receiver.bytes(START, &REQUEST[..cut]);
                let next = START + Duration::from_ticks(cut as u64 * CHARACTER) + silence;
                receiver.bytes(next, &REQUEST[cut..]);
                assert_eq!(receiver.take(), Some(body), "before character {cut}");
            }
        }
    }

    #[test]
    fn a_burst_is_split_behind_line_feeds() {
        let two = [REQUEST, REQUEST].concat();
        assert_eq!(scan(&two), Scan::Complete(17));
        assert_eq!(scan(&[b"noise", REQUEST].concat()), Scan::Complete(22));
        assert_eq!(scan(b":1103\n:"), Scan::Complete(6));
        assert_eq!(scan(b"\n"), Scan::Complete(1));
        assert_eq!(scan(&REQUEST[..16]), Scan::Incomplete);
        assert_eq!(scan(b"noise:"), Scan::Incomplete);
        assert_eq!(scan(b""), Scan::Incomplete);
        assert_eq!(scan(b"noise"), Scan::Invalid(5));
        assert_eq!(
            scan(&[&[b'.'; 300][..], b":", &[b'0'; 300]].concat()),
            Scan::Incomplete,
            "the colon counts"
        );
        let endless = [&b":"[..], &[b'0'; 512]].concat();
        assert_eq!(scan(&endless[..512]), Scan::Incomplete);
        assert_eq!(scan(&endless), Scan::Invalid(513), "an LF would make it 514 characters");
    }

    /// Random characters, mostly those that have a meaning in a message.
    fn characters(most: usize) -> impl Strategy<Value = Vec<u8>> {
        let any_of = prop_oneof![
            8 => prop::sample::select(&b"0123456789ABCDEFabcdef"[..]),
            1 => prop::sample::select(&b":\r\n"[..]),
            1 => any::<u8>(),
        ];
        prop::collection::vec(any_of, 0..most)
    }

    proptest! {
        #[test]
        fn every_body_comes_back(body in prop::collection::vec(any::<u8>(), 0..=254)) {
            let message = encode(&body);
            prop_assert_eq!(scan(&message), Scan::Complete(message.len()));
            let decoded = decode(&message);
            prop_assert_eq!(decoded.as_deref(), Some(&body[..]));
            prop_assert_eq!(received(&message), Some(Ok(body)));
        }

        #[test]
        fn noise_before_a_colon_never_matters(noise in characters(600), spoiled in any::<bool>()) {
            let mut receiver = AsciiReceiver::new(LINE);
            let mut end = START;
            for burst in noise.split_inclusive(|&character| character == b'\n') {
                receiver.bytes(end, burst);
                end += LINE.character() * burst.len() as u64;
                if burst.ends_with(b"\n") {
                    receiver.take();
                }
            }
            if spoiled {
                receiver.rx_error(end);
                end += LINE.character();
            }
            receiver.bytes(end, REQUEST);
            prop_assert_eq!(receiver.take(), Some(Ok(BODY)));
        }

        #[test]
        fn any_characters_are_judged(burst in characters(1_100)) {
            match scan(&burst) {
                Scan::Complete(length) => {
                    prop_assert_eq!(burst.iter().position(|&c| c == b'\n'), Some(length - 1));
                    let start = burst[..length].iter().rposition(|&c| c == b':');
                    let message = start.map(|start| &burst[start..length]);
                    let body = message.and_then(decode).map(|body| body.to_vec());
                    prop_assert_eq!(received(&burst[..length]).and_then(Result::ok), body);
                }
                Scan::Incomplete | Scan::Invalid(_) => prop_assert!(!burst.contains(&b'\n')),
                Scan::Ambiguous => prop_assert!(false, "a line feed ends a message"),
            }
        }

        #[test]
        fn splitting_a_message_anywhere_changes_nothing(noise in characters(300), cut in 0_usize..=300) {
            let end = noise.iter().position(|&c| c == b'\n').map_or(noise.len(), |lf| lf + 1);
            let (burst, cut) = (&noise[..end], cut.min(end));
            let mut whole = AsciiReceiver::new(LINE);
            whole.bytes(START, burst);
            let mut parts = AsciiReceiver::new(LINE);
            parts.bytes(START, &burst[..cut]);
            parts.bytes(START + Duration::from_ticks(CHARACTER * cut as u64), &burst[cut..]);
            prop_assert_eq!(whole.deadline(), parts.deadline());
            prop_assert_eq!(whole.take(), parts.take());
        }
    }
}
