//! RTU framing: silence ends a frame, a CRC holds it together (serial 2.5.1).

use crc::{CRC_16_MODBUS, Crc};

use super::pdu::{
    EXCEPTION_BIT, READ_COILS, READ_DISCRETE_INPUTS, READ_HOLDING_REGISTERS, READ_INPUT_REGISTERS,
    WRITE_MULTIPLE_COILS, WRITE_MULTIPLE_REGISTERS, WRITE_SINGLE_COIL, WRITE_SINGLE_REGISTER,
};
use super::{FRAME_BYTES, Frame, Why};
use crate::line::Line;
use crate::time::{Duration, Instant};

static CRC: Crc<u16> = Crc::<u16>::new(&CRC_16_MODBUS);

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
}

impl Receiver {
    /// A receiver on a silent line.
    #[must_use]
    pub const fn new(line: Line) -> Self {
        Self { timing: Timing::of(line), frame: Frame::new(), state: State::Idle, last: Instant::ZERO }
    }

    /// From the next character on the line is `line`.
    pub fn set_line(&mut self, line: Line) {
        self.timing = Timing::of(line);
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
        self.last = at + self.timing.character.times(others as u64);
    }

    /// A character that nobody could read ended at `at`.
    pub fn spoiled(&mut self, at: Instant) {
        self.hear(at);
        self.state = State::Bad(Why::Spoiled);
        self.last = at;
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

    /// When a frame is over, should nothing more come; [`Instant::NEVER`] on a silent line.
    #[must_use]
    pub fn deadline(&self) -> Instant {
        match self.state {
            State::Idle => Instant::NEVER,
            State::Receiving | State::Bad(_) => self.last + self.timing.t3_5 + self.timing.character,
        }
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
        match core::mem::replace(&mut self.state, State::Idle) {
            State::Idle => None,
            State::Receiving => Some(Ok(&self.frame)),
            State::Bad(why) => Some(Err(why)),
        }
    }

    /// Forgets what has come.
    pub fn clear(&mut self) {
        self.state = State::Idle;
    }
}

/// What the front of a burst of characters is, for a host whose own gaps say nothing.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Burst {
    /// That many bytes are a whole frame.
    Frame(usize),
    /// The rest is still to come.
    Partial,
    /// It has all the length its function may have, and is no frame.
    Broken,
}

/// Judges the front of a burst: a frame is whole when its CRC holds at the length of a request or a
/// reply of its function, at any length for a function that is not listed.
#[must_use]
pub fn front(burst: &[u8]) -> Burst {
    let whole = |length: usize| burst.get(..length).is_some_and(|frame| checked(frame).is_some());
    let Some(&function) = burst.get(1) else { return Burst::Partial };
    let Some(lengths) = lengths(burst, function) else {
        let longest = burst.len().min(FRAME_BYTES);
        return match (4..=longest).find(|&length| whole(length)) {
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
