//! RTU framing: a silence ends each frame, a CRC protects it (serial 2.5.1).
//!
//! ```
//! use drivetwin_protocol::line::{Line, Parity};
//! use drivetwin_protocol::modbus::rtu::{self, RtuReceiver};
//! use drivetwin_protocol::time::Instant;
//!
//! // Slave 0x11: read 3 holding registers from 0x006B. The CRC is 0x8776, low byte first.
//! let request = rtu::read(0x11, 0x006B, 3);
//! assert_eq!(request, [0x11, 3, 0, 0x6B, 0, 3, 0x76, 0x87]);
//!
//! // 9600 8E1: a character has 11 bits, which are 18,333 ticks of 62.5 ns.
//! let mut receiver = RtuReceiver::new(Line::new(9_600, 8, Parity::Even, 1));
//! receiver.bytes(Instant::from_ticks(1_000_000), &request);
//! // Seven more characters, 3.5 characters of silence, and a character's time in which no other one ends.
//! let over = Instant::from_ticks(1_000_000 + 7 * 18_333 + 64_166 + 18_333);
//! assert_eq!(receiver.deadline(), over);
//! assert_eq!(receiver.take(), Some(Ok(&request[..])));
//! assert_eq!(rtu::verify_crc(&request), Some(&request[..6]));
//! ```

use super::pdu::{
    ENCAPSULATED_INTERFACE, EXCEPTION_BIT, READ_COILS, READ_DISCRETE_INPUTS, READ_HOLDING_REGISTERS,
    READ_INPUT_REGISTERS, WRITE_MULTIPLE_COILS, WRITE_MULTIPLE_REGISTERS, WRITE_SINGLE_COIL,
    WRITE_SINGLE_REGISTER,
};
use super::{DropReason, Expect, FRAME_BYTES, Frame, Scan};
use crate::line::Line;
use crate::time::{Duration, Instant};

/// The CRC before the first byte.
const INITIAL: u16 = 0xFFFF;
/// The polynomial of the CRC divided by x + 1: x^15 + x + 1, in the bit order of the CRC (the lowest bit is x^15).
const QUOTIENT: u16 = 0xC001;

/// The CRC of `bytes` (serial 2.5.1.2). A frame contains its low byte first. The CRC of a whole frame is 0.
///
/// Needs no table and handles 8 bytes at a time, because the polynomial x^16 + x^15 + x^2 + 1 is the product of x + 1
/// and the quotient Q = x^15 + x + 1 (PROJECT-10). Modulo Q, x^15 = x + 1, x^16 = x^2 + x, x^32 = x^4 + x^2 and x^64 = x^8 + x^4, so
/// shifts divide by Q. The remainder of the division by x + 1 is the parity of all bits.
#[must_use]
pub const fn crc(bytes: &[u8]) -> u16 {
    let Some(start) = bytes.first_chunk() else { return crc_of_few(bytes) };
    // The first word has 1 to 8 bytes, and zeros before them; the others have 8. The highest bit of a word is x^0.
    let zeros = bytes.len().wrapping_neg() % 8;
    let rest = if let Some((_, rest)) = bytes.split_at_checked(8 - zeros) { rest } else { &[] };
    let mut words = rest.as_chunks().0;
    let mut sum = (u64::from_le_bytes(*start) ^ INITIAL as u64) << (8 * zeros);
    let mut parity = sum;
    // The second byte of the message may be in the second word.
    let mut initial = if zeros == 7 { INITIAL as u64 >> 8 } else { 0 };
    while let [word, more @ ..] = words {
        let word = u64::from_le_bytes(*word) ^ initial;
        parity ^= word;
        // The lowest 8 bits are x^56 to x^63: times x^8 and x^4 they exceed the word, and are reduced once more.
        let reduced = sum ^ sum << 56 ^ sum << 60;
        sum = word ^ reduced >> 8 ^ reduced >> 4;
        (words, initial) = (more, 0);
    }
    // Reduce by x^32, multiply by x^16, reduce by x^15 twice. Then the highest 16 bits remain.
    let half = sum << 32;
    let sum = sum >> 32 << 32 ^ half >> 2 ^ half >> 4;
    let sum = reduced_by_x15(reduced_by_x15(sum >> 2 ^ sum >> 1)) >> 48;
    let is_odd = (parity ^ sum).count_ones() % 2 == 1;
    sum as u16 ^ if is_odd { QUOTIENT } else { 0 }
}

/// Replaces x^15 by x + 1 in all powers from x^15 on. The highest bit is x^0.
const fn reduced_by_x15(sum: u64) -> u64 {
    let high = sum << 15;
    sum >> 49 << 49 ^ high >> 1 ^ high
}

/// The CRC of fewer than 8 bytes, one after the other.
const fn crc_of_few(mut bytes: &[u8]) -> u16 {
    let mut sum = INITIAL;
    while let [byte, rest @ ..] = bytes {
        let low = (sum ^ *byte as u16) & 0xFF;
        let parity = if low.count_ones() % 2 == 1 { QUOTIENT } else { 0 };
        sum = sum >> 8 ^ low << 6 ^ low << 7 ^ parity;
        bytes = rest;
    }
    sum
}

/// The frame without its CRC; `None` if the CRC does not match.
#[must_use]
#[inline]
pub fn verify_crc(frame: &[u8]) -> Option<&[u8]> {
    let (body, _) = frame.split_last_chunk::<2>()?;
    (crc(frame) == 0).then_some(body)
}

/// Appends the CRC of `frame`. Does nothing if `frame` has no room for the CRC.
#[inline]
pub fn append_crc(frame: &mut Frame) {
    let sum = crc(frame);
    // A reply has at most 254 bytes here, so the CRC has room.
    let _ = frame.extend_from_slice(&sum.to_le_bytes());
}

/// The frame of an address and a PDU of at most 253 bytes. A longer PDU is truncated.
#[must_use]
pub fn frame(unit: u8, pdu: &[u8]) -> Frame {
    let mut frame = Frame::new();
    let _ = frame.push(unit);
    let _ = frame.extend_from_slice(pdu.get(..FRAME_BYTES - 3).unwrap_or(pdu));
    append_crc(&mut frame);
    frame
}

/// A master's request to read `count` holding registers from `first`.
#[must_use]
pub fn read(unit: u8, first: u16, count: u16) -> Frame {
    let ([a, b], [c, d]) = (first.to_be_bytes(), count.to_be_bytes());
    frame(unit, &[READ_HOLDING_REGISTERS, a, b, c, d])
}

/// A master's request to write one holding register.
#[must_use]
pub fn write(unit: u8, address: u16, value: u16) -> Frame {
    let ([a, b], [c, d]) = (address.to_be_bytes(), value.to_be_bytes());
    frame(unit, &[WRITE_SINGLE_REGISTER, a, b, c, d])
}

/// Durations of a serial line that decide where a frame ends.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Timing {
    /// Duration of a character.
    pub character: Duration,
    /// The longest silence inside a frame.
    pub t1_5: Duration,
    /// The shortest silence between frames.
    pub t3_5: Duration,
}

impl Timing {
    /// Silences of 1.5 and 3.5 characters, rounded up; above 19,200 baud 750 µs and 1.75 ms (serial 2.5.1.1;
    /// MODBUS-1).
    #[must_use]
    pub const fn of(line: Line) -> Self {
        let character = line.character();
        if line.baud > 19_200 {
            return Self { character, t1_5: Duration::micros(750), t3_5: Duration::micros(1_750) };
        }
        Self { character, t1_5: half_times(character, 3), t3_5: half_times(character, 7) }
    }
}

/// `n` halves of `span`, rounded up to a tick.
const fn half_times(span: Duration, n: u64) -> Duration {
    Duration::from_ticks((span.ticks() * n).div_ceil(2))
}

/// State of a receiver.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum State {
    /// The line is silent.
    Idle,
    /// Characters of a frame were received, without an error so far.
    Receiving,
    /// The frame received now has an error. The receiver drops it when silence ends it.
    Bad(DropReason),
}

/// Receiver of a slave: takes characters and returns frames.
///
/// Timestamps are the *ends* of characters. A character that began within 3.5 characters of the previous one
/// is known only when it ends, one character later. So the [`deadline`](Self::deadline) is 4.5 characters
/// after the last character (PROJECT-3).
#[derive(Clone, Debug)]
pub struct RtuReceiver {
    timing: Timing,
    frame: Frame,
    state: State,
    /// End of the last character.
    last: Instant,
    /// Time at which the frame ends if no more characters follow; never on a silent line.
    over: Instant,
}

impl RtuReceiver {
    /// A receiver on a silent line.
    #[must_use]
    pub const fn new(line: Line) -> Self {
        Self {
            timing: Timing::of(line),
            frame: Frame::new(),
            state: State::Idle,
            last: Instant::ZERO,
            over: Instant::NEVER,
        }
    }

    /// Changes the settings of the serial line from the next character after `at` on. If a frame would have
    /// ended before `at` with the new silences, it ends at `at`.
    pub fn set_line(&mut self, at: Instant, line: Line) {
        self.timing = Timing::of(line);
        if self.state != State::Idle {
            self.restart_silence(self.last);
            self.over = self.over.max(at);
        }
    }

    /// The silences of the present line settings.
    #[must_use]
    pub const fn timing(&self) -> Timing {
        self.timing
    }

    /// Handles received characters that follow each other without a gap; `at` is the end of the first one.
    ///
    /// If the silence before these characters ended a frame, the caller must first take this frame: see
    /// [`is_over`](Self::is_over).
    #[inline]
    pub fn bytes(&mut self, at: Instant, bytes: &[u8]) {
        let Some(others) = bytes.len().checked_sub(1) else { return };
        self.character_began(at);
        if self.state == State::Receiving && self.frame.extend_from_slice(bytes).is_err() {
            self.state = State::Bad(DropReason::Length);
        }
        self.restart_silence(at + self.timing.character * others as u64);
    }

    /// Handles a character with an error that ended at `at`.
    pub fn rx_error(&mut self, at: Instant) {
        self.character_began(at);
        self.state = State::Bad(DropReason::RxError);
        self.restart_silence(at);
    }

    /// Updates the state for a character that ended at `at`, by the silence before it.
    fn character_began(&mut self, at: Instant) {
        match self.state {
            State::Idle => {
                self.frame.clear();
                self.state = State::Receiving;
            }
            State::Receiving if (at - self.timing.character).since(self.last) > self.timing.t1_5 => {
                self.state = State::Bad(DropReason::Gap);
            }
            State::Receiving | State::Bad(_) => {}
        }
    }

    /// Starts the silence anew after the last character, which ended at `last`.
    fn restart_silence(&mut self, last: Instant) {
        self.last = last;
        self.over = last + self.timing.t3_5 + self.timing.character;
    }

    /// Time at which the frame ends if no more characters follow; [`Instant::NEVER`] on a silent line.
    #[must_use]
    #[inline]
    pub fn deadline(&self) -> Instant {
        self.over
    }

    /// Returns true if the frame has ended at `at`, or before a character that ends at `at`.
    #[must_use]
    pub fn is_over(&self, at: Instant) -> bool {
        self.deadline() <= at
    }

    /// Ends the frame and returns it with its CRC, which is not checked; `None` on a silent line.
    ///
    /// # Errors
    /// The reason why the received characters are not a frame.
    #[inline]
    pub fn take(&mut self) -> Option<Result<&[u8], DropReason>> {
        let state = self.state;
        self.clear();
        match state {
            State::Idle => None,
            State::Receiving => Some(Ok(&self.frame)),
            State::Bad(why) => Some(Err(why)),
        }
    }

    /// Drops the characters received so far.
    #[inline]
    pub fn clear(&mut self) {
        self.state = State::Idle;
        self.over = Instant::NEVER;
    }
}

/// Finds a frame at the front of a burst that may still grow. The caller's reads may split the burst
/// anywhere.
///
/// A matching CRC alone does not end a frame, because the CRC of a prefix may match by chance. A frame is
/// complete if its CRC matches at the longest length that its function may have. It is also complete if its
/// CRC matches at a shorter length and another complete frame follows directly (PROJECT-4).
///
/// # Example
///
/// A write of two registers (function 0x10) to slave 0x30. A request has 7 + 4 + 2 = 13 bytes, a reply 8. By
/// chance bytes 7 and 8 of this request, `04 E3`, are the CRC of its first 6 bytes, low byte first:
///
/// ```
/// use drivetwin_protocol::modbus::{Expect, Scan, rtu};
///
/// let burst = [0x30, 0x10, 0x50, 0x21, 0x00, 0x02, 0x04, 0xE3, 0x10, 0x00, 0x00, 0x01, 0xC5];
/// assert_eq!(rtu::crc(&burst[..6]), 0xE304);
/// // A master sends requests only: byte 6 (4 data bytes) makes 13 the only possible length.
/// assert_eq!(rtu::scan(&burst[..8], Expect::Requests), Scan::Incomplete);
/// // With slaves on the line these 8 bytes may be a reply: silence decides, or the bytes that follow.
/// assert_eq!(rtu::scan(&burst[..8], Expect::Both), Scan::Ambiguous);
/// assert_eq!(rtu::scan(&burst, Expect::Both), Scan::Complete(13));
/// // 13 bytes with a wrong CRC: the frame directly after them shows that they are not a frame.
/// let mut wrong = burst.to_vec();
/// wrong[12] ^= 1;
/// wrong.extend(rtu::read(1, 0, 2));
/// assert_eq!(rtu::scan(&wrong, Expect::Requests), Scan::Invalid(13));
/// ```
#[must_use]
pub fn scan(burst: &[u8], expect: Expect) -> Scan {
    let Some(&function) = burst.get(1) else { return Scan::Incomplete };
    let lengths = lengths(burst, function, expect);
    let longest = lengths.longest();
    let frames = lengths.into_iter().filter(|&length| holds(burst, length));
    if let Some(length) = frames.clone().find(|&length| starts_with_frame(after(burst, length), expect)) {
        return Scan::Complete(length);
    }
    match frames.last() {
        Some(length) if burst.len() >= longest => Scan::Complete(length),
        Some(_) => Scan::Ambiguous,
        None if burst.len() < longest => Scan::Incomplete,
        None if starts_with_frame(after(burst, longest), expect) => Scan::Invalid(longest),
        // A frame of any length would have followed directly by now.
        None if burst.len() >= longest + FRAME_BYTES => Scan::Invalid(FRAME_BYTES + 1),
        None => Scan::Ambiguous,
    }
}

/// Number of bytes of `burst` that go to the drives together after silence has ended the burst and [`scan`]
/// has found no frame. It is the first of these lengths that exists:
///
/// - the whole burst, if its CRC matches;
/// - the bytes up to the first matching CRC that is directly before another frame;
/// - the longest known length of the function at which the CRC matches;
/// - the whole burst, as on a real serial line.
#[must_use]
pub fn ended(burst: &[u8], expect: Expect) -> usize {
    let is_whole = |frame: &[u8]| frame.len() <= FRAME_BYTES && verify_crc(frame).is_some();
    if is_whole(burst) {
        return burst.len();
    }
    let function = burst.get(1).copied().unwrap_or_default();
    let known = || lengths(burst, function, expect).into_iter().filter(|&length| holds(burst, length)).last();
    let mut frames = (MIN_BYTES..=FRAME_BYTES).filter(|&length| holds(burst, length));
    let before_next_frame = frames.find(|&length| {
        let rest = after(burst, length);
        starts_with_frame(rest, expect) || is_whole(rest)
    });
    before_next_frame.or_else(known).unwrap_or(burst.len())
}

/// Returns true if `burst` has at least `length` bytes and these end with a matching CRC.
fn holds(burst: &[u8], length: usize) -> bool {
    burst.get(..length).is_some_and(|frame| verify_crc(frame).is_some())
}

/// Bytes after the first `length`.
fn after(burst: &[u8], length: usize) -> &[u8] {
    burst.get(length..).unwrap_or_default()
}

/// Returns true if `burst` begins with a whole frame, and the frames of its function have known lengths.
fn starts_with_frame(burst: &[u8], expect: Expect) -> bool {
    let Some(&function) = burst.get(1) else { return false };
    let lengths = lengths(burst, function, expect);
    !matches!(lengths, Lengths::Any) && lengths.into_iter().any(|length| holds(burst, length))
}

/// The shortest frame: address, function, CRC.
const MIN_BYTES: usize = 4;

/// Functions whose requests have a known length and that no drive on a serial line implements (application
/// 6.7 to 6.18).
const READ_EXCEPTION_STATUS: u8 = 7;
const GET_EVENT_COUNTER: u8 = 11;
const GET_EVENT_LOG: u8 = 12;
const REPORT_SERVER_ID: u8 = 17;
const READ_FILE: u8 = 20;
const WRITE_FILE: u8 = 21;
const MASK_WRITE_REGISTER: u8 = 22;
const READ_AND_WRITE: u8 = 23;
const READ_FIFO: u8 = 24;

/// MEI type of function 43 that reads the identification (application 6.21).
const IDENTIFICATION: u8 = 14;

/// Lengths that a frame may have.
#[derive(Clone, Copy)]
enum Lengths {
    /// The length of a request and the length of a reply.
    Known([Option<usize>; 2]),
    /// Any length.
    Any,
}

impl Lengths {
    fn longest(self) -> usize {
        match self {
            Self::Known(lengths) => lengths.into_iter().flatten().max().unwrap_or(MIN_BYTES),
            Self::Any => FRAME_BYTES,
        }
    }

    /// The lengths in ascending order.
    fn into_iter(self) -> impl Iterator<Item = usize> + Clone {
        let (mut known, any) = match self {
            Self::Known(lengths) => (lengths, None),
            Self::Any => ([None; 2], Some(MIN_BYTES..=FRAME_BYTES)),
        };
        known.sort_unstable();
        known.into_iter().flatten().chain(any.into_iter().flatten())
    }
}

/// Possible lengths of a frame of `function`, as far as `burst` determines them (application 6.1 to 6.21).
fn lengths(burst: &[u8], function: u8, expect: Expect) -> Lengths {
    // Length of a frame with a byte count at `at`: bytes up to the count, the counted bytes, CRC; at most the
    // longest frame.
    let counted = |at: usize| match burst.get(at) {
        Some(&count) => (at + 1 + usize::from(count) + 2).min(FRAME_BYTES),
        None => FRAME_BYTES,
    };
    let brings =
        |at: usize, odd: bool| burst.get(at).is_none_or(|&count| count > 0 && (odd || count % 2 == 0));
    let (request, reply) = match function {
        READ_COILS | READ_DISCRETE_INPUTS => (8, Some(counted(2)).filter(|_| brings(2, true))),
        READ_HOLDING_REGISTERS | READ_INPUT_REGISTERS => (8, Some(counted(2)).filter(|_| brings(2, false))),
        WRITE_SINGLE_COIL | WRITE_SINGLE_REGISTER => (8, Some(8)),
        WRITE_MULTIPLE_COILS | WRITE_MULTIPLE_REGISTERS => (counted(6), Some(8)),
        _ if function & EXCEPTION_BIT != 0 && expect != Expect::Requests => {
            return Lengths::Known([Some(5), None]);
        }
        // Requests of other functions of the specification. The drives refuse most of them.
        READ_EXCEPTION_STATUS | GET_EVENT_COUNTER | GET_EVENT_LOG | REPORT_SERVER_ID
            if expect == Expect::Requests =>
        {
            (4, None)
        }
        READ_FIFO if expect == Expect::Requests => (6, None),
        MASK_WRITE_REGISTER if expect == Expect::Requests => (10, None),
        READ_FILE | WRITE_FILE if expect == Expect::Requests => (counted(2), None),
        READ_AND_WRITE if expect == Expect::Requests => (counted(10), None),
        ENCAPSULATED_INTERFACE if expect == Expect::Requests && burst.get(2) == Some(&IDENTIFICATION) => {
            (7, None)
        }
        _ => return Lengths::Any,
    };
    Lengths::Known(match expect {
        Expect::Requests => [Some(request), None],
        Expect::Replies => [None, reply],
        Expect::Both => [Some(request), reply.filter(|&reply| reply != request)],
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::line::Parity;
    use proptest::prelude::*;
    use std::vec;
    use std::vec::Vec;

    const LINE: Line = Line::new(9_600, 8, Parity::Even, 1);

    #[test]
    fn the_crc_of_the_specification() {
        // Serial, appendix B: 02 07 gives 0x1241, sent as 41 12.
        assert_eq!(crc(&[0x02, 0x07]), 0x1241);
        assert_eq!(frame(2, &[7])[..], [0x02, 0x07, 0x41, 0x12]);
        assert_eq!(verify_crc(&[0x02, 0x07, 0x41, 0x12]), Some(&[0x02, 0x07][..]));
        assert_eq!(verify_crc(&[0x02, 0x07, 0x12, 0x41]), None);
        assert_eq!(verify_crc(&[0x02]), None);
    }

    #[test]
    fn requests_of_a_master() {
        // Application 6.3 and 6.6 to slave 0x11.
        assert_eq!(read(0x11, 0x6B, 3)[..], [0x11, 0x03, 0x00, 0x6B, 0x00, 0x03, 0x76, 0x87]);
        assert_eq!(write(0x11, 1, 3)[..], [0x11, 0x06, 0x00, 0x01, 0x00, 0x03, 0x9A, 0x9B]);
        // Serial 2.5.1: at most 256 bytes, of which 253 are the PDU.
        assert_eq!(frame(1, &[0x5A; 253]).len(), 256);
        assert_eq!(frame(1, &[0x5A; 254]), frame(1, &[0x5A; 253]));
    }

    /// A request, and the time at which its first character ends.
    const REQUEST: [u8; 8] = [0x11, 0x03, 0x00, 0x6B, 0x00, 0x03, 0x76, 0x87];
    const START: Instant = Instant::from_ticks(1_000_000);
    /// 11 bits at 9,600 baud, and 1.5 and 3.5 characters, in ticks of 62.5 ns.
    const CHARACTER: Duration = Duration::from_ticks(18_333);
    const T1_5: Duration = Duration::from_ticks(27_500);
    const T3_5: Duration = Duration::from_ticks(64_166);

    #[test]
    fn a_silence_of_3_5_characters_ends_a_frame() {
        let mut receiver = RtuReceiver::new(LINE);
        assert_eq!((receiver.deadline(), receiver.take()), (Instant::NEVER, None));
        for start in [START, START + Duration::secs(1)] {
            receiver.bytes(start, &[]);
            assert_eq!(receiver.deadline(), Instant::NEVER, "nothing has come");
            receiver.bytes(start, &REQUEST);
            // A character that begins within the silence ends one character later.
            let over = start + CHARACTER * 7 + T3_5 + CHARACTER;
            assert_eq!(receiver.deadline(), over);
            assert!(!receiver.is_over(over - Duration::TICK) && receiver.is_over(over));
            assert_eq!(receiver.take(), Some(Ok(&REQUEST[..])));
            assert_eq!((receiver.deadline(), receiver.take()), (Instant::NEVER, None));
        }
    }

    #[test]
    fn a_silence_of_more_than_1_5_characters_inside_a_frame_spoils_it() {
        for (silence, frame) in [(T1_5, Ok(&REQUEST[..])), (T1_5 + Duration::TICK, Err(DropReason::Gap))] {
            for cut in 1..7 {
                let mut receiver = RtuReceiver::new(LINE);
                receiver.bytes(START, &REQUEST[..cut]);
                let next = START + CHARACTER * cut as u64 + silence;
                receiver.bytes(next, &REQUEST[cut..7]);
                let last = next + CHARACTER * (7 - cut as u64);
                receiver.bytes(last, &REQUEST[7..]);
                assert_eq!(receiver.deadline(), last + T3_5 + CHARACTER, "before character {cut}");
                assert_eq!(receiver.take(), Some(frame), "before character {cut}");
            }
        }
    }

    #[test]
    fn a_character_that_nobody_could_read_spoils_a_frame_and_no_other() {
        let mut receiver = RtuReceiver::new(LINE);
        let mut start = START;
        for cut in 0..8 {
            receiver.bytes(start, &REQUEST[..cut]);
            let spoiled = start + CHARACTER * cut as u64;
            receiver.rx_error(spoiled);
            assert_eq!(receiver.deadline(), spoiled + T3_5 + CHARACTER);
            receiver.bytes(spoiled + CHARACTER, &REQUEST[cut + 1..]);
            assert_eq!(receiver.take(), Some(Err(DropReason::RxError)), "character {cut}");
            start += Duration::secs(1);
            receiver.bytes(start, &REQUEST);
            assert_eq!(receiver.take(), Some(Ok(&REQUEST[..])));
            start += Duration::secs(1);
        }
    }

    #[test]
    fn the_longest_frame_has_256_bytes() {
        let mut receiver = RtuReceiver::new(LINE);
        receiver.bytes(START, &[0x5A; 256]);
        assert_eq!(receiver.take(), Some(Ok(&[0x5A; 256][..])));
        let mut receiver = RtuReceiver::new(LINE);
        receiver.bytes(START, &[0x5A; 256]);
        receiver.bytes(START + CHARACTER * 256, &[0x5A]);
        assert_eq!(receiver.deadline(), START + CHARACTER * 256 + T3_5 + CHARACTER);
        assert_eq!(receiver.take(), Some(Err(DropReason::Length)));
    }

    #[test]
    fn a_receiver_forgets_what_is_cleared() {
        let mut receiver = RtuReceiver::new(LINE);
        receiver.bytes(START, &REQUEST[..4]);
        receiver.clear();
        assert_eq!((receiver.deadline(), receiver.take()), (Instant::NEVER, None));
        receiver.bytes(START + CHARACTER * 4, &REQUEST);
        assert_eq!(receiver.take(), Some(Ok(&REQUEST[..])));
    }

    #[test]
    fn another_line_has_other_silences() {
        let fast = Line::new(38_400, 8, Parity::Even, 1);
        let mut receiver = RtuReceiver::new(LINE);
        receiver.set_line(START, fast);
        assert_eq!((receiver.timing(), receiver.deadline()), (Timing::of(fast), Instant::NEVER));
        receiver.bytes(START, &REQUEST[..1]);
        // 11 bits at 38,400 baud; the silence is 1.75 ms above 19,200 baud.
        let over = START + Duration::micros(1_750) + Duration::from_ticks(4_583);
        assert_eq!(receiver.deadline(), over);
    }

    #[test]
    fn a_faster_line_ends_a_frame_now_and_not_in_the_past() {
        let slow = Line::new(1_200, 8, Parity::Even, 1);
        let mut receiver = RtuReceiver::new(slow);
        let end = Instant::from(Duration::millis(100));
        receiver.bytes(end, &[1]);
        // 3.5 + 1 characters: a character takes 9.17 ms at 1,200 baud and 1.15 ms at 9,600.
        let changes = end + Duration::millis(20);
        assert!(!receiver.is_over(changes));
        receiver.set_line(changes, LINE);
        assert_eq!(receiver.deadline(), changes);
        receiver.set_line(changes, slow);
        assert!(receiver.deadline() > changes);
    }

    #[test]
    fn silences_of_a_slow_and_of_a_fast_line() {
        let slow = Timing::of(LINE);
        assert_eq!((slow.t1_5.ticks(), slow.t3_5.ticks()), (27_500, 64_166));
        let fast = Timing::of(Line::new(38_400, 8, Parity::Even, 1));
        assert_eq!((fast.t1_5, fast.t3_5), (Duration::micros(750), Duration::micros(1_750)));
        let last_slow = Timing::of(Line::new(19_200, 8, Parity::Even, 1));
        assert_eq!(last_slow.character.ticks(), 9_167);
        assert_eq!(last_slow.t3_5.ticks(), 32_085);
    }

    use Expect::{Both, Replies, Requests};

    #[test]
    fn a_burst_is_split_at_whole_frames() {
        let request = read(1, 0, 2);
        assert_eq!(scan(&request, Requests), Scan::Complete(8));
        assert_eq!(scan(&request[..7], Requests), Scan::Incomplete);
        assert_eq!(scan(&[], Requests), Scan::Incomplete);
        let two: Vec<u8> = request.iter().chain(&request).copied().collect();
        assert_eq!(scan(&two, Requests), Scan::Complete(8));
        // A reply of function 3 has its byte count in its third byte.
        let reply = frame(1, &[3, 6, 0, 1, 0, 2, 0, 3]);
        assert_eq!(scan(&reply, Replies), Scan::Complete(11));
        assert_eq!(scan(&reply, Both), Scan::Complete(11));
        assert_eq!(scan(&frame(1, &[0x83, 2]), Both), Scan::Complete(5));
        assert_eq!(scan(&frame(1, &[16, 0, 1, 0, 1, 2, 0, 7]), Requests), Scan::Complete(11));
        assert_eq!(scan(&frame(1, &[16, 0, 1, 0, 1]), Replies), Scan::Complete(8));
    }

    /// A request of function 16 to an RS 434544. By chance its first eight bytes end with a matching CRC.
    const BY_CHANCE: [u8; 13] =
        [0x30, 0x10, 0x50, 0x21, 0x00, 0x02, 0x04, 0xE3, 0x10, 0x00, 0x00, 0x01, 0xC5];

    #[test]
    fn the_crc_of_a_prefix_may_hold_by_chance() {
        assert!(verify_crc(&BY_CHANCE).is_some() && verify_crc(&BY_CHANCE[..8]).is_some());
        for length in 0..13 {
            assert_eq!(scan(&BY_CHANCE[..length], Requests), Scan::Incomplete, "{length} bytes");
        }
        assert_eq!(scan(&BY_CHANCE, Requests), Scan::Complete(13));
    }

    #[test]
    fn where_slaves_are_heard_silence_decides_what_is_ambiguous() {
        assert_eq!(scan(&BY_CHANCE[..8], Both), Scan::Ambiguous, "a reply, or the begin of a request");
        assert_eq!(ended(&BY_CHANCE[..8], Both), 8);
        assert_eq!(scan(&BY_CHANCE[..12], Both), Scan::Ambiguous);
        assert_eq!(scan(&BY_CHANCE, Both), Scan::Complete(13));
        // The request directly after these 8 bytes shows that they were a reply.
        let both: Vec<u8> = BY_CHANCE[..8].iter().chain(&read(7, 0, 1)).copied().collect();
        assert_eq!(scan(&both, Both), Scan::Complete(8));
    }

    #[test]
    fn a_burst_with_all_its_length_and_no_crc_waits_for_silence_or_a_frame() {
        let mut request = read(1, 0, 2);
        request[7] ^= 1;
        assert_eq!(scan(&request, Requests), Scan::Ambiguous);
        assert_eq!(ended(&request, Requests), 8);
        let both: Vec<u8> = request.iter().chain(&read(1, 0, 2)).copied().collect();
        assert_eq!(scan(&both[..15], Requests), Scan::Ambiguous);
        assert_eq!(scan(&both, Requests), Scan::Invalid(8));
        assert_eq!(scan(&[0x55; 200], Requests), Scan::Incomplete, "function 0x55 may have any length");
        assert_eq!(scan(&[0x55; 256], Requests), Scan::Ambiguous, "a frame may be as long");
        // It is too long, but a frame of 256 bytes may begin behind its first 256.
        assert_eq!(scan(&[0x55; 511], Requests), Scan::Ambiguous);
        assert_eq!(scan(&[0x55; 512], Requests), Scan::Invalid(257));
    }

    #[test]
    fn a_frame_whose_byte_count_is_wrong_goes_whole_to_the_drive_that_refuses_it() {
        for count in [2, 6] {
            let request = frame(1, &[16, 0, 1, 0, 2, count, 0, 7, 0, 8]);
            for length in 0..=request.len() {
                assert!(!matches!(scan(&request[..length], Requests), Scan::Complete(_) | Scan::Invalid(_)));
            }
            assert_eq!(ended(&request, Requests), 13);
        }
    }

    #[test]
    fn a_function_that_is_not_listed_may_have_any_length() {
        for length in 1..250 {
            let pdu: Vec<u8> = core::iter::once(65).chain((0..length).map(|n| n as u8)).collect();
            let frame = frame(1, &pdu);
            assert_eq!(ended(&frame, Requests), frame.len());
            let both: Vec<u8> = frame.iter().chain(&read(1, 0, 2)).copied().collect();
            assert_eq!(scan(&both, Requests), Scan::Complete(frame.len()));
        }
    }

    #[test]
    fn a_frame_whose_byte_count_is_wrong_ends_where_another_one_begins() {
        let wrong = frame(1, &[16, 0, 1, 0, 2, 2, 0, 7, 0, 8]);
        let other = frame(1, &[65, 1, 2, 3]);
        let alone = [&wrong[..], &other].concat();
        assert_eq!(ended(&alone, Requests), 13, "a frame that may have any length is all of the rest");
        let begun = [&wrong[..], &read(1, 0, 1), &[1, 3, 0]].concat();
        assert_eq!(ended(&begun, Requests), 13, "one that has a length is there");
        let neither = [&wrong[..], &other, &[1, 3, 0]].concat();
        assert_eq!(ended(&neither, Requests), neither.len());
    }

    #[test]
    fn a_reply_brings_a_byte_at_least_and_of_registers_whole_words() {
        for (function, count, is_reply) in [
            (1, 0, false),
            (1, 1, true),
            (2, 3, true),
            (3, 0, false),
            (3, 1, false),
            (3, 2, true),
            (4, 5, false),
            (4, 4, true),
        ] {
            let reply = frame(1, &[&[function, count][..], &vec![7; usize::from(count)]].concat());
            let found = scan(&reply, Replies) == Scan::Complete(reply.len());
            assert_eq!(found, is_reply, "function {function}, {count} bytes");
        }
    }

    #[test]
    fn where_slaves_are_heard_a_function_that_no_drive_knows_may_have_any_length() {
        // Requests of known length (application 6.7 to 6.21), and a function that is not listed.
        let requests: [&[u8]; 10] = [
            &[7],
            &[11],
            &[12],
            &[17],
            &[20, 7, 6, 0, 4, 0, 1, 0, 2],
            &[21, 9, 6, 0, 4, 0, 7, 0, 1, 6, 0xAF],
            &[22, 0, 4, 0, 0xF2, 0, 0x25],
            &[23, 0, 3, 0, 6, 0, 14, 0, 1, 2, 0, 0xFF],
            &[24, 4, 0xDE],
            &[43, 14, 1, 0],
        ];
        for pdu in requests {
            let request = frame(1, pdu);
            assert_eq!(scan(&request, Requests), Scan::Complete(request.len()), "function {}", pdu[0]);
            for expect in [Replies, Both] {
                assert_eq!(scan(&request, expect), Scan::Ambiguous, "function {}", pdu[0]);
                assert_eq!(ended(&request, expect), request.len(), "function {}", pdu[0]);
            }
        }
        for expect in [Replies, Both] {
            assert_eq!(scan(&frame(1, &[65, 1, 2, 3, 4, 5])[..7], expect), Scan::Incomplete);
            // An exception has five bytes.
            assert_eq!(scan(&frame(1, &[0xC1, 1]), expect), Scan::Complete(5));
        }
        assert_eq!(scan(&frame(1, &[0xC1, 1]), Requests), Scan::Ambiguous, "no master says it");
    }

    /// Frames that a host finds in `stream`. The host reads the stream in pieces of the lengths `reads`; the
    /// line is silent after the last piece.
    fn frames(stream: &[u8], reads: &[usize], expect: Expect) -> Vec<Vec<u8>> {
        let (mut waiting, mut frames) = (Vec::new(), Vec::new());
        let mut sizes = reads.iter().copied().cycle();
        let mut rest = stream;
        while !rest.is_empty() {
            let (came, later) = rest.split_at(sizes.next().unwrap_or(1).clamp(1, rest.len()));
            waiting.extend_from_slice(came);
            rest = later;
            while let Scan::Complete(length) | Scan::Invalid(length) = scan(&waiting, expect) {
                frames.push(waiting.drain(..length).collect());
            }
        }
        while !waiting.is_empty() {
            let length = match scan(&waiting, expect) {
                Scan::Complete(length) | Scan::Invalid(length) => length,
                Scan::Incomplete | Scan::Ambiguous => ended(&waiting, expect),
            };
            frames.push(waiting.drain(..length).collect());
        }
        frames
    }

    /// A variant of `request` whose first `length` bytes end with a matching CRC. Tries all values of the
    /// word at `place`; `None` if none fits.
    fn by_chance(request: &[u8], place: usize, length: usize) -> Option<Vec<u8>> {
        let body = request.get(..request.len() - 2)?;
        (0..=u16::MAX).find_map(|value| {
            let mut body = body.to_vec();
            body.get_mut(place..place + 2)?.copy_from_slice(&value.to_be_bytes());
            verify_crc(&body[..length]).map(|_| frame(body[0], &body[1..]).to_vec())
        })
    }

    /// A valid request of a function that the specification lists, or of one that it does not list.
    fn request() -> impl Strategy<Value = Vec<u8>> {
        let pdu = prop_oneof![
            (1_u8..=6, any::<[u8; 4]>()).prop_map(|(function, data)| { [&[function][..], &data].concat() }),
            (any::<[u8; 2]>(), proptest::collection::vec(any::<[u8; 2]>(), 1..=123)).prop_map(
                |(first, values)| {
                    let count = values.len() as u8;
                    [&[16][..], &first, &[0, count, 2 * count], &values.concat()].concat()
                }
            ),
            (any::<[u8; 2]>(), proptest::collection::vec(any::<u8>(), 1..=246)).prop_map(
                |(first, values)| {
                    let bits = (values.len() as u16 * 8).to_be_bytes();
                    [&[15][..], &first, &bits, &[values.len() as u8], &values].concat()
                }
            ),
            proptest::sample::select(vec![7_u8, 11, 12, 17]).prop_map(|function| vec![function]),
            any::<[u8; 6]>().prop_map(|data| [&[22][..], &data].concat()),
            (any::<[u8; 8]>(), proptest::collection::vec(any::<[u8; 2]>(), 1..=121)).prop_map(
                |(head, values)| { [&[23][..], &head, &[2 * values.len() as u8], &values.concat()].concat() }
            ),
            any::<[u8; 2]>().prop_map(|data| [&[24][..], &data].concat()),
            any::<[u8; 2]>().prop_map(|data| [&[43, 14][..], &data].concat()),
            (65_u8..=72, proptest::collection::vec(any::<u8>(), 0..=252))
                .prop_map(|(function, data)| { [&[function][..], &data].concat() }),
        ];
        (0_u8..=247, pdu).prop_map(|(unit, pdu)| frame(unit, &pdu).to_vec())
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        #[test]
        fn a_request_is_whole_though_the_crc_of_its_begin_holds(
            head in (1_u8..=247, any::<[u8; 2]>()),
            registers in proptest::collection::vec(any::<[u8; 2]>(), 1..=123),
            reads in proptest::collection::vec(1_usize..20, 1..8),
            behind in request(),
        ) {
            let (unit, [first, _]) = head;
            let count = registers.len() as u8;
            let bytes = 2 * count;
            let sixteen = frame(unit, &[&[16, first, 0, 0, count, bytes][..], &registers.concat()].concat());
            let values = &registers.concat()[1..];
            let bits = values.len() as u16 * 8;
            let [high, low] = bits.to_be_bytes();
            let fifteen = frame(unit, &[&[15, first, 0, high, low, values.len() as u8][..], values].concat());
            // Choose the low byte of the first address and of the first value so that the first eight bytes
            // end with a matching CRC.
            for request in [sixteen, fifteen] {
                let chance = (0..=u8::MAX).find_map(|low| {
                    let mut request = request.to_vec();
                    request[3] = low;
                    let sum = crc(&request[..6]).to_le_bytes();
                    request[7] = sum[1];
                    (request[6] == sum[0]).then(|| frame(unit, &request[1..request.len() - 2]).to_vec())
                });
                // On average one of 256 addresses fits. If none fits, there is no such request.
                let Some(request) = chance else { continue };
                prop_assert!(verify_crc(&request[..8]).is_some() && verify_crc(&request).is_some());
                // By chance a whole frame may also follow the first eight bytes, which are a reply. Then nothing tells
                // that they are the begin of a request.
                let is_reply = starts_with_frame(&request[8..], Both);
                for expect in [Requests, Both].into_iter().filter(|&expect| expect == Requests || !is_reply) {
                    prop_assert_eq!(frames(&request, &reads, expect), std::slice::from_ref(&request));
                    prop_assert_eq!(frames(&request, &[8], expect), std::slice::from_ref(&request));
                }
                let both = [request.as_slice(), &behind].concat();
                prop_assert_eq!(frames(&both, &reads, Requests), [request, behind.clone()]);
            }
        }

        #[test]
        fn a_request_of_an_unlisted_function_is_whole_though_the_crc_of_its_begin_holds(
            unit in 1_u8..=247,
            data in proptest::collection::vec(any::<u8>(), 8..=100),
            length in 6_usize..=10,
            reads in proptest::collection::vec(1_usize..20, 1..8),
            behind in request(),
        ) {
            let request = frame(unit, &[&[65], data.as_slice()].concat());
            let request = by_chance(&request, 2, length).unwrap();
            prop_assert!(verify_crc(&request[..length]).is_some() && verify_crc(&request).is_some());
            // By chance a whole frame may also follow this begin. Then nothing tells that it is one.
            let both = [request.as_slice(), &behind].concat();
            prop_assume!(!starts_with_frame(&both[length..], Requests));
            prop_assert_eq!(frames(&request, &reads, Requests), std::slice::from_ref(&request));
            prop_assert_eq!(frames(&request, &[length], Requests), std::slice::from_ref(&request));
            // By chance the CRC may also hold at a later byte. Then nothing tells where the request ends.
            prop_assume!((request.len() + 1..both.len()).all(|end| verify_crc(&both[..end]).is_none()));
            prop_assert_eq!(frames(&both, &reads, Requests), [request, behind]);
        }
    }

    proptest! {
        #[test]
        fn the_crc_is_that_of_another_implementation(bytes in proptest::collection::vec(any::<u8>(), 0..=FRAME_BYTES)) {
            const OTHER: crc::Crc<u16> = crc::Crc::<u16>::new(&crc::CRC_16_MODBUS);
            for length in 0..=bytes.len() {
                prop_assert_eq!(crc(&bytes[..length]), OTHER.checksum(&bytes[..length]));
            }
        }

        #[test]
        fn requests_are_found_whole_in_any_split(
            one in request(), other in request(), reads in proptest::collection::vec(1_usize..40, 1..8),
        ) {
            prop_assert_eq!(frames(&one, &reads, Requests), std::slice::from_ref(&one));
            let both = [one.as_slice(), &other].concat();
            // An unlisted function has any length that has a right CRC, also by chance: a frame and a zero have one, too.
            let by_chance = |length: usize| length != one.len() && verify_crc(&both[..length]).is_some();
            prop_assume!(one[1] < 65 || !(4..both.len()).any(by_chance));
            prop_assert_eq!(frames(&both, &reads, Requests), [one, other]);
        }

        #[test]
        fn any_split_of_any_bytes_gives_the_same_frames(
            garbage in proptest::collection::vec(any::<u8>(), 0..40), behind in request(),
            reads in proptest::collection::vec(1_usize..40, 1..8),
        ) {
            let stream = [garbage.as_slice(), &behind].concat();
            for expect in [Requests, Both] {
                prop_assert_eq!(frames(&stream, &reads, expect), frames(&stream, &[stream.len()], expect));
            }
        }
    }

    proptest! {
        #[test]
        fn any_bytes_are_judged(burst in proptest::collection::vec(any::<u8>(), 0..600)) {
            for expect in [Requests, Replies, Both] {
                if let Scan::Complete(length) = scan(&burst, expect) {
                    prop_assert!(verify_crc(&burst[..length]).is_some());
                }
                prop_assert!(ended(&burst, expect) <= burst.len());
            }
        }

        #[test]
        fn splitting_a_frame_anywhere_changes_nothing(
            bytes in proptest::collection::vec(any::<u8>(), 1..300), cut in 0_usize..300,
        ) {
            let cut = cut.min(bytes.len());
            let first = Instant::from_ticks(1_000_000);
            let mut whole = RtuReceiver::new(LINE);
            whole.bytes(first, &bytes);
            let mut parts = RtuReceiver::new(LINE);
            parts.bytes(first, &bytes[..cut]);
            parts.bytes(first + LINE.character() * cut as u64, &bytes[cut..]);
            prop_assert_eq!(whole.deadline(), parts.deadline());
            prop_assert_eq!(whole.take(), parts.take());
        }
    }
}
