//! RTU framing: silence ends a frame, a CRC holds it together (serial 2.5.1).

use crc::{CRC_16_MODBUS, Crc};

use super::pdu::{
    EXCEPTION_BIT, READ_COILS, READ_DISCRETE_INPUTS, READ_HOLDING_REGISTERS, READ_INPUT_REGISTERS,
    WRITE_MULTIPLE_COILS, WRITE_MULTIPLE_REGISTERS, WRITE_SINGLE_COIL, WRITE_SINGLE_REGISTER,
};
use super::{Burst, FRAME_BYTES, Frame, Why};
use crate::line::Line;
use crate::time::{Duration, Instant};

/// 512 bytes, or with the feature `large-crc-table` 8 KiB for twice the speed.
#[cfg(not(feature = "large-crc-table"))]
type Table = crc::Table<1>;
#[cfg(feature = "large-crc-table")]
type Table = crc::Table<16>;

static CRC: Crc<u16, Table> = Crc::<u16, Table>::new(&CRC_16_MODBUS);

/// The CRC of `bytes` (serial 2.5.1.2); its low byte goes first on the wire.
#[must_use]
pub fn crc(bytes: &[u8]) -> u16 {
    CRC.checksum(bytes)
}

/// A frame without its CRC, if the CRC holds.
#[must_use]
pub fn checked(frame: &[u8]) -> Option<&[u8]> {
    let (body, sum) = frame.split_last_chunk::<2>()?;
    (crc(body) == u16::from_le_bytes(*sum)).then_some(body)
}

/// Puts the CRC behind what is in `frame`; without effect where no room is left.
pub fn seal(frame: &mut Frame) {
    let sum = crc(frame);
    // Replies are at most 253 bytes long before this.
    let _ = frame.extend_from_slice(&sum.to_le_bytes());
}

/// The frame of an address and a PDU of at most 253 bytes; what is longer is cut.
#[must_use]
pub fn frame(unit: u8, pdu: &[u8]) -> Frame {
    let mut frame = Frame::new();
    let _ = frame.push(unit);
    let _ = frame.extend_from_slice(pdu.get(..FRAME_BYTES - 3).unwrap_or(pdu));
    seal(&mut frame);
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

/// The silences of a line.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Timing {
    /// A character.
    pub character: Duration,
    /// The longest silence inside a frame.
    pub t1_5: Duration,
    /// The shortest silence between frames.
    pub t3_5: Duration,
}

impl Timing {
    /// 1.5 and 3.5 characters, rounded up; above 19,200 baud 750 µs and 1.75 ms (serial 2.5.1.1).
    #[must_use]
    pub const fn of(line: Line) -> Self {
        let character = line.character();
        if line.baud > 19_200 {
            return Self { character, t1_5: Duration::micros(750), t3_5: Duration::micros(1_750) };
        }
        Self { character, t1_5: half_times(character, 3), t3_5: half_times(character, 7) }
    }
}

/// `n` halves of a span, rounded up.
const fn half_times(span: Duration, n: u64) -> Duration {
    Duration::from_ticks((span.ticks() * n).div_ceil(2))
}

/// What has come of a frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum State {
    /// Nothing: the line is silent.
    Idle,
    /// A frame that may still be good.
    Receiving,
    /// A frame that is over when the line falls silent, and then dropped.
    Bad(Why),
}

/// The receiving half of a slave: characters in, frames out.
///
/// A stamp is the *end* of a character. That a character began within 3.5 characters of the last
/// one is known only when it ends, one character later: that is the [`deadline`](Self::deadline).
#[derive(Clone, Debug)]
pub struct Receiver {
    timing: Timing,
    frame: Frame,
    state: State,
    /// End of the last character.
    last: Instant,
    /// When the frame is over, should nothing more come; never on a silent line.
    over: Instant,
}

impl Receiver {
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

    /// From the next character on the line is `line`.
    pub fn set_line(&mut self, line: Line) {
        self.timing = Timing::of(line);
        if self.state != State::Idle {
            self.heard(self.last);
        }
    }

    /// The silences it keeps.
    #[must_use]
    pub const fn timing(&self) -> Timing {
        self.timing
    }

    /// Characters that follow each other without a gap; `at` is the end of the first one.
    ///
    /// A frame that the silence before them ends is taken first: see [`is_over`](Self::is_over).
    pub fn bytes(&mut self, at: Instant, bytes: &[u8]) {
        let Some(others) = bytes.len().checked_sub(1) else { return };
        self.hear(at);
        if self.state == State::Receiving && self.frame.extend_from_slice(bytes).is_err() {
            self.state = State::Bad(Why::Length);
        }
        self.heard(at + self.timing.character * others as u64);
    }

    /// A character that nobody could read ended at `at`.
    pub fn spoiled(&mut self, at: Instant) {
        self.hear(at);
        self.state = State::Bad(Why::Spoiled);
        self.heard(at);
    }

    /// A character ended at `at`: what its distance from the last one means.
    fn hear(&mut self, at: Instant) {
        match self.state {
            State::Idle => {
                self.frame.clear();
                self.state = State::Receiving;
            }
            State::Receiving if (at - self.timing.character).since(self.last) > self.timing.t1_5 => {
                self.state = State::Bad(Why::Gap);
            }
            State::Receiving | State::Bad(_) => {}
        }
    }

    /// The last character ended at `last`: from then on the line may be silent.
    fn heard(&mut self, last: Instant) {
        self.last = last;
        self.over = last + self.timing.t3_5 + self.timing.character;
    }

    /// When a frame is over, should nothing more come; [`Instant::NEVER`] on a silent line.
    #[must_use]
    pub fn deadline(&self) -> Instant {
        self.over
    }

    /// Whether a frame is over at `at`, or before a character that ends then.
    #[must_use]
    pub fn is_over(&self, at: Instant) -> bool {
        self.deadline() <= at
    }

    /// Ends the frame and hands it over, CRC included and unchecked; `None` on a silent line.
    ///
    /// # Errors
    /// Why it is no frame.
    pub fn take(&mut self) -> Option<Result<&[u8], Why>> {
        let state = self.state;
        self.clear();
        match state {
            State::Idle => None,
            State::Receiving => Some(Ok(&self.frame)),
            State::Bad(why) => Some(Err(why)),
        }
    }

    /// Forgets what has come.
    pub fn clear(&mut self) {
        self.state = State::Idle;
        self.over = Instant::NEVER;
    }
}

/// Judges the front of a burst: a frame is whole when its CRC holds at the length of a request or a
/// reply of its function, at any length for a function that is not listed.
#[must_use]
pub fn front(burst: &[u8]) -> Burst {
    let whole = |length: usize| burst.get(..length).is_some_and(|frame| checked(frame).is_some());
    let Some(&function) = burst.get(1) else { return Burst::Partial };
    let Some(lengths) = lengths(burst, function) else {
        let longest = burst.len().min(FRAME_BYTES);
        // All of it, or else the shortest front: a CRC may hold by chance inside a long frame.
        let mut tried = core::iter::once(longest).chain(4..longest);
        return match tried.find(|&length| length >= 4 && whole(length)) {
            Some(length) => Burst::Frame(length),
            None if burst.len() > FRAME_BYTES => Burst::Broken,
            None => Burst::Partial,
        };
    };
    if let Some(length) = lengths.into_iter().flatten().find(|&length| whole(length)) {
        return Burst::Frame(length);
    }
    let longest = lengths.into_iter().flatten().max().unwrap_or(0);
    if burst.len() >= longest { Burst::Broken } else { Burst::Partial }
}

/// Lengths that a request and a reply of `function` may have, as far as `burst` tells; `None` for
/// any length.
fn lengths(burst: &[u8], function: u8) -> Option<[Option<usize>; 2]> {
    // Address, function, a fixed part, as many bytes as a count in it says, CRC.
    let counted = |at: usize| match burst.get(at) {
        Some(&count) => Some(at + 1 + usize::from(count) + 2).filter(|&n| count > 0 && n <= FRAME_BYTES),
        None => Some(FRAME_BYTES),
    };
    Some(match function {
        READ_COILS | READ_DISCRETE_INPUTS => [Some(8), counted(2)],
        READ_HOLDING_REGISTERS | READ_INPUT_REGISTERS => {
            [Some(8), counted(2).filter(|_| burst.get(2).is_none_or(|count| count % 2 == 0))]
        }
        WRITE_SINGLE_COIL | WRITE_SINGLE_REGISTER => [Some(8), None],
        WRITE_MULTIPLE_COILS | WRITE_MULTIPLE_REGISTERS => [Some(8), counted(6)],
        _ if function & EXCEPTION_BIT != 0 => [Some(5), None],
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::line::Parity;
    use proptest::prelude::*;

    const LINE: Line = Line::new(9_600, 8, Parity::Even, 1);

    #[test]
    fn the_crc_of_the_specification() {
        // Serial, appendix B: 02 07 gives 0x1241, sent as 41 12.
        assert_eq!(crc(&[0x02, 0x07]), 0x1241);
        assert_eq!(frame(2, &[7])[..], [0x02, 0x07, 0x41, 0x12]);
        assert_eq!(checked(&[0x02, 0x07, 0x41, 0x12]), Some(&[0x02, 0x07][..]));
        assert_eq!(checked(&[0x02, 0x07, 0x12, 0x41]), None);
        assert_eq!(checked(&[0x02]), None);
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

    #[test]
    fn a_burst_is_split_at_whole_frames() {
        let request = read(1, 0, 2);
        assert_eq!(front(&request), Burst::Frame(8));
        assert_eq!(front(&request[..7]), Burst::Partial);
        assert_eq!(front(&[]), Burst::Partial);
        let two: std::vec::Vec<u8> = request.iter().chain(&request).copied().collect();
        assert_eq!(front(&two), Burst::Frame(8));
        // A reply of function 3 has its length in its third byte.
        let reply = frame(1, &[3, 6, 0, 1, 0, 2, 0, 3]);
        assert_eq!(front(&reply), Burst::Frame(11));
        assert_eq!(front(&frame(1, &[0x83, 2])), Burst::Frame(5));
        assert_eq!(front(&frame(1, &[16, 0, 1, 0, 1, 2, 0, 7])), Burst::Frame(11));
        assert_eq!(front(&frame(1, &[16, 0, 1, 0, 1])), Burst::Frame(8));
    }

    #[test]
    fn a_burst_with_all_its_length_and_no_crc_is_broken() {
        let mut request = read(1, 0, 2);
        request[7] ^= 1;
        assert_eq!(front(&request), Burst::Broken);
        assert_eq!(front(&[0x55; 200]), Burst::Partial, "function 0x55 may have any length");
        assert_eq!(front(&[0x55; 257]), Burst::Broken);
    }

    #[test]
    fn a_function_that_is_not_listed_may_have_any_length() {
        for length in 1..250 {
            let pdu: std::vec::Vec<u8> = core::iter::once(65).chain((0..length).map(|n| n as u8)).collect();
            let frame = frame(1, &pdu);
            assert_eq!(front(&frame), Burst::Frame(frame.len()));
        }
    }

    proptest! {
        #[test]
        fn any_bytes_are_judged(burst in proptest::collection::vec(any::<u8>(), 0..600)) {
            if let Burst::Frame(length) = front(&burst) {
                prop_assert!(checked(&burst[..length]).is_some());
            }
        }

        #[test]
        fn splitting_a_frame_anywhere_changes_nothing(
            bytes in proptest::collection::vec(any::<u8>(), 1..300), cut in 0_usize..300,
        ) {
            let cut = cut.min(bytes.len());
            let first = Instant::from_ticks(1_000_000);
            let mut whole = Receiver::new(LINE);
            whole.bytes(first, &bytes);
            let mut parts = Receiver::new(LINE);
            parts.bytes(first, &bytes[..cut]);
            parts.bytes(first + LINE.character() * cut as u64, &bytes[cut..]);
            prop_assert_eq!(whole.deadline(), parts.deadline());
            prop_assert_eq!(whole.take(), parts.take());
        }
    }
}
