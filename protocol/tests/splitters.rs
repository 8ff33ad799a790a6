//! Compares the splitters of a host with receivers that detect silence. Both must find the same requests,
//! wherever the reads split the bytes, even if by chance the CRC of a prefix matches.
//!
//! The requests are typed from the application specification (6.1 to 6.21). A CRC is linear. So the tests
//! find the bytes that make a CRC match at any given position by solving a system of equations.
#![allow(missing_docs, clippy::unwrap_used, clippy::indexing_slicing, reason = "a test")]

use drivetwin_protocol::line::{Line, Parity};
use drivetwin_protocol::modbus::rtu::{self, crc, verify_crc};
use drivetwin_protocol::modbus::tcp::{self, Splitter};
use drivetwin_protocol::modbus::{DropReason, Expect, Scan, ascii, ended, scan};
use drivetwin_protocol::text::{Lines, next_line};
use drivetwin_protocol::time::{Duration, Instant};
use proptest::prelude::*;

const RTU: Line = Line::new(9_600, 8, Parity::Even, 1);
const ASCII: Line = Line::new(9_600, 7, Parity::Even, 1);

/// The change of the CRC, and the bits of a frame (index and mask) whose inversion causes it.
type Change = (u16, Vec<(usize, u8)>);

/// A request of known length. Bytes that are `None` may have any value.
#[derive(Clone, Debug)]
struct Shape {
    pdu: Vec<Option<u8>>,
}

impl Shape {
    /// A request of `function`, followed by `data`.
    fn new(function: u8, data: impl IntoIterator<Item = Option<u8>>) -> Self {
        Self { pdu: std::iter::once(Some(function)).chain(data).collect() }
    }

    /// A request of `function` with the byte count `count`; `None` if there is no such request, or if it does
    /// not fit into a frame. Functions without a byte count have a request for `count` 0 only.
    fn of(function: u8, count: u8) -> Option<Self> {
        let any = |bytes: usize| std::iter::repeat_n(None, bytes);
        let bytes = usize::from(count);
        let words = [0, count / 2].map(Some);
        let bits = (u16::from(count) * 8).to_be_bytes().map(Some);
        let shape = match function {
            // Address, then a quantity or a value.
            1..=6 => Self::new(function, any(4)),
            7 | 11 | 12 | 17 => Self::new(function, []),
            // Address, quantity, byte count, values.
            15 => Self::new(function, any(2).chain(bits).chain([Some(count)]).chain(any(bytes))),
            16 => Self::new(function, any(2).chain(words).chain([Some(count)]).chain(any(bytes))),
            // Byte count, then groups that name files.
            20 | 21 => Self::new(function, [Some(count)].into_iter().chain(any(bytes))),
            // Address, then two masks.
            22 => Self::new(function, any(6)),
            // Address and quantity to read, address and quantity to write, byte count, values.
            23 => Self::new(function, any(6).chain(words).chain([Some(count)]).chain(any(bytes))),
            24 => Self::new(function, any(2)),
            43 => Self::new(function, [Some(14)].into_iter().chain(any(2))),
            _ => return None,
        };
        let fits = shape.pdu.len() <= tcp::ADU_BYTES - tcp::HEADER_BYTES;
        let counts = matches!(function, 15 | 16 | 20 | 21 | 23);
        (fits && (counts || count == 0)).then_some(shape)
    }

    /// A request of any function, with `bytes` bytes after the function code.
    fn any(function: u8, bytes: usize) -> Self {
        Self::new(function, std::iter::repeat_n(None, bytes))
    }

    /// The frame. Its unit and its free bytes are taken from `fill`.
    fn frame(&self, fill: &mut impl FnMut() -> u8) -> Vec<u8> {
        let unit = 1 + fill() % 247;
        let pdu: Vec<u8> = self.pdu.iter().map(|byte| byte.unwrap_or_else(&mut *fill)).collect();
        rtu::frame(unit, &pdu).to_vec()
    }

    /// Indices of the bytes of a frame that may have any value: those below `length` in descending order, and
    /// last the unit at index 0.
    fn free(&self, length: usize) -> impl Iterator<Item = usize> {
        let data = (1..=self.pdu.len()).rev().filter(|&place| self.pdu[place - 1].is_none());
        data.filter(move |&place| place < length).chain([0])
    }

    /// A frame whose first `length` bytes also end with a matching CRC; `None` if no values of the free bytes
    /// give one.
    fn by_chance(&self, length: usize, fill: &mut impl FnMut() -> u8) -> Option<Vec<u8>> {
        let mut frame = self.frame(fill);
        let whole = frame.len();
        if length + 2 <= whole && self.pdu[length - 3..length - 1] == [None; 2] {
            // The CRC of the prefix can be written into free bytes.
            reseal(&mut frame[..length]);
            reseal(&mut frame);
            return Some(frame);
        }
        // Difference between the CRC of the prefix and the bytes in its place. It is linear: each bit of the
        // frame changes it independently of the other bits.
        let wrong = |frame: &mut Vec<u8>| {
            if length > whole - 2 {
                let sum = crc(&frame[..whole - 2]);
                frame[whole - 2..].copy_from_slice(&sum.to_le_bytes());
            }
            let (body, sum) = frame[..length].split_last_chunk::<2>().unwrap();
            crc(body) ^ u16::from_le_bytes(*sum)
        };
        let mut rest = wrong(&mut frame);
        let zero = rest;
        // For each bit of the difference, a set of inversions that changes this bit and perhaps lower ones,
        // but no higher one.
        let mut moves: [Option<Change>; 16] = [const { None }; 16];
        for (place, bit) in self.free(length).flat_map(|place| (0..8).map(move |bit| (place, 1 << bit))) {
            if moves.iter().all(Option::is_some) {
                break;
            }
            frame[place] ^= bit;
            let mut moved = wrong(&mut frame) ^ zero;
            frame[place] ^= bit;
            let mut changes = vec![(place, bit)];
            while moved != 0 {
                let highest = &mut moves[moved.ilog2() as usize];
                let Some((other, more)) = highest else {
                    *highest = Some((moved, changes));
                    break;
                };
                moved ^= *other;
                changes.extend(&*more);
            }
        }
        while rest != 0 {
            let (moved, changes) = moves[rest.ilog2() as usize].as_ref()?;
            rest ^= moved;
            for &(place, bit) in changes {
                frame[place] ^= bit;
            }
        }
        reseal(&mut frame);
        assert!(verify_crc(&frame).is_some() && verify_crc(&frame[..length]).is_some());
        Some(frame)
    }
}

/// Writes the right CRC into the last two bytes of a frame.
fn reseal(frame: &mut [u8]) {
    let (body, sum) = frame.split_last_chunk_mut::<2>().unwrap();
    *sum = crc(body).to_le_bytes();
}

/// Pseudo-random bytes, the same in every run.
fn noise(seed: u64) -> impl FnMut() -> u8 {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 32 & 0xFF) as u8
    }
}

/// Length of the first message in `burst` if the line is silent after the burst.
fn silent(burst: &[u8], expect: Expect) -> usize {
    match scan(RTU, burst, expect) {
        Scan::Complete(length) | Scan::Invalid(length) => length,
        Scan::Incomplete | Scan::Ambiguous => ended(RTU, burst, expect),
    }
}

/// Asserts that `scan` never ends `frame` early, though its first `chance` bytes end with a matching CRC.
/// Every tested prefix must be incomplete or ambiguous. In a frame of more than 40 bytes only every 61st
/// prefix is tested, and those where a wrong end is likely.
fn assert_never_cut(frame: &[u8], chance: usize, expect: Expect) {
    let step = if frame.len() > 40 { 61 } else { 1 };
    let here = chance..frame.len().min(chance + 2);
    for length in (0..frame.len()).step_by(step).chain(here).chain([frame.len() - 1]) {
        let begin = scan(RTU, &frame[..length], expect);
        assert!(
            matches!(begin, Scan::Incomplete | Scan::Ambiguous),
            "{begin:?} of {:02x?}",
            &frame[..length]
        );
    }
    assert_eq!(silent(frame, expect), frame.len(), "{frame:02x?}");
}

/// All requests of known length: with every byte count for functions 15 and 16, otherwise with every 17th.
fn shapes() -> impl Iterator<Item = Shape> {
    (0..=u8::MAX).flat_map(|function| {
        let step = if matches!(function, 15 | 16) { 1 } else { 17 };
        (0..=u8::MAX).step_by(step).filter_map(move |count| Shape::of(function, count))
    })
}

#[test]
fn a_request_that_tells_its_length_is_never_cut_wherever_a_crc_can_hold() {
    let behind = rtu::read(2, 0, 1);
    let (mut fill, mut forced) = (noise(1), [0_i32; 256]);
    for shape in shapes() {
        let whole = shape.pdu.len() + 3;
        for length in 4..whole {
            let Some(frame) = shape.by_chance(length, &mut fill) else { continue };
            assert_eq!(frame.len(), whole);
            forced[usize::from(frame[1])] += 1;
            assert_never_cut(&frame, length, Expect::Requests);
            // The frame is found as soon as it is complete, whatever bytes follow.
            assert_eq!(scan(RTU, &frame, Expect::Requests), Scan::Complete(whole), "{frame:02x?}");
            let burst = [&frame[..], &behind].concat();
            assert_eq!(scan(RTU, &burst, Expect::Requests), Scan::Complete(whole), "{burst:02x?}");
        }
    }
    // A request of 8 bytes has 4 prefixes, of 4 to 7 bytes. Functions 15 and 16 have 248 byte counts, with 5
    // to 252 prefixes.
    assert_eq!(forced[1..=6], [4; 6]);
    assert_eq!(forced[15..=16], [(5..=252).sum(); 2]);
}

#[test]
fn among_replies_of_slaves_no_request_is_cut_wherever_a_crc_can_hold() {
    let mut fill = noise(2);
    let single = (1..=6).map(|function| (function, 0));
    let counted = (0..=u8::MAX).step_by(5).flat_map(|count| [(15, count), (16, count)]);
    for shape in single.chain(counted).filter_map(|(function, count)| Shape::of(function, count)) {
        for length in 4..shape.pdu.len() + 3 {
            let Some(frame) = shape.by_chance(length, &mut fill) else { continue };
            assert_never_cut(&frame, length, Expect::Both);
        }
    }
}

#[test]
fn a_request_of_any_other_function_is_never_cut_wherever_a_crc_can_hold() {
    let mut fill = noise(3);
    let others = (0..=u8::MAX).filter(|&function| Shape::of(function, 0).is_none());
    let short = others.map(|function| (Shape::any(function, 16), 1));
    // Diagnostics of the greatest length, a function of the MDrive, and an interface of function 43 other
    // than identification.
    let diagnostics = Shape::any(8, 252);
    let own = Shape::any(65, 40);
    let interface = Shape::new(43, [Some(13)].into_iter().chain(std::iter::repeat_n(None, 100)));
    for (shape, step) in short.chain([(diagnostics, 27), (own, 1), (interface, 7)]) {
        for length in (4..shape.pdu.len() + 3).step_by(step) {
            let frame = shape.by_chance(length, &mut fill).unwrap();
            assert_never_cut(&frame, length, Expect::Requests);
            let burst = [&frame[..], &rtu::read(2, 0, 1)].concat();
            assert_eq!(scan(RTU, &burst, Expect::Requests), Scan::Complete(frame.len()), "{frame:02x?}");
        }
    }
}

/// Requests. About half of them have a prefix with a matching CRC.
fn request() -> impl Strategy<Value = Vec<u8>> {
    let listed = (
        prop::sample::select(&[1_u8, 2, 3, 4, 5, 6, 7, 11, 12, 15, 16, 17, 20, 21, 22, 23, 24, 43][..]),
        any::<u8>(),
    )
        .prop_map(|(function, count)| Shape::of(function, count).or_else(|| Shape::of(function, 0)).unwrap());
    let other = (prop::sample::select(&[0_u8, 8, 13, 25, 65, 66, 99, 127, 131, 255][..]), 0_usize..=252)
        .prop_map(|(function, bytes)| Shape::any(function, bytes));
    (prop_oneof![3 => listed, 1 => other], any::<prop::sample::Index>(), any::<bool>(), any::<u64>())
        .prop_map(|(shape, length, chance, seed)| {
            let mut fill = noise(seed);
            let longer = shape.pdu.len() + 3 - 4;
            let forced = (chance && longer > 0)
                .then(|| shape.by_chance(4 + length.index(longer), &mut fill))
                .flatten();
            forced.unwrap_or_else(|| shape.frame(&mut fill))
        })
}

/// Lengths of reads, to be repeated.
fn reads() -> impl Strategy<Value = Vec<usize>> {
    prop::collection::vec(prop_oneof![1_usize..12, 1_usize..300], 1..8)
}

/// The parts of a stream if the lengths of the reads repeat `reads`.
fn split<'a>(mut stream: &'a [u8], reads: &[usize]) -> Vec<&'a [u8]> {
    let mut parts = Vec::new();
    for &length in reads.iter().cycle() {
        if stream.is_empty() {
            break;
        }
        let (part, rest) = stream.split_at(length.min(stream.len()));
        parts.push(part);
        stream = rest;
    }
    parts
}

/// Messages that a host finds in `parts`, which it receives without a gap. The line is silent after the last
/// part.
fn of_host(line: Line, parts: &[&[u8]], expect: Expect) -> Vec<Vec<u8>> {
    let (mut waiting, mut messages) = (Vec::new(), Vec::new());
    for part in parts {
        waiting.extend_from_slice(part);
        while let Scan::Complete(length) | Scan::Invalid(length) = scan(line, &waiting, expect) {
            messages.push(waiting.drain(..length).collect());
        }
    }
    while !waiting.is_empty() {
        let length = match scan(line, &waiting, expect) {
            Scan::Complete(length) | Scan::Invalid(length) => length,
            Scan::Incomplete | Scan::Ambiguous => ended(line, &waiting, expect),
        };
        messages.push(waiting.drain(..length).collect());
    }
    messages
}

/// Frames that a drive's receiver finds if a silence follows each message.
fn with_silences(messages: &[Vec<u8>]) -> Vec<Result<Vec<u8>, DropReason>> {
    let mut receiver = rtu::RtuReceiver::new(RTU);
    let mut at = Instant::from(Duration::secs(1));
    let heard = messages.iter().map(|message| {
        receiver.bytes(at, message);
        at = receiver.deadline() + RTU.character();
        receiver.take().expect("a message").map(<[u8]>::to_vec)
    });
    heard.collect()
}

/// Returns true if by chance a CRC also holds from the beginning of a request to a byte within a later one. Without silences
/// nothing tells then where a request of an unlisted function ends.
fn is_ambiguous(requests: &[Vec<u8>]) -> bool {
    (0..requests.len()).any(|first| {
        let (request, later) = (&requests[first], requests[first + 1..].concat());
        let stream = [request.as_slice(), &later].concat();
        let ends: Vec<usize> =
            (first..=requests.len()).map(|end| requests[first..end].concat().len()).collect();
        (request.len()..stream.len()).any(|end| !ends.contains(&end) && verify_crc(&stream[..end]).is_some())
    })
}

proptest! {
    #[test]
    fn requests_are_cut_at_the_silences_of_a_drive(
        requests in prop::collection::vec(request(), 1..5), reads in reads(),
    ) {
        let stream = requests.concat();
        prop_assume!(!is_ambiguous(&requests));
        let silences = with_silences(&requests);
        let host = of_host(RTU, &split(&stream, &reads), Expect::Requests);
        prop_assert_eq!(with_silences(&host), silences, "{:02x?}", requests);
    }

    #[test]
    fn among_replies_of_slaves_a_single_request_is_cut_at_the_silence_of_a_drive(
        request in request(), reads in reads(),
    ) {
        let known = matches!(request[1], 1..=6 | 15 | 16);
        let host = of_host(RTU, &split(&request, &reads), Expect::Both);
        prop_assert!(!known || with_silences(&host) == with_silences(&[request]));
    }
}

/// Bodies that an ASCII receiver finds if a silence of `gap` precedes each message.
fn ascii_with_silences(messages: &[Vec<u8>], gap: Duration) -> Vec<Result<Vec<u8>, DropReason>> {
    let mut receiver = ascii::AsciiReceiver::new(ASCII);
    let mut at = Instant::from(Duration::secs(1));
    let heard = messages.iter().filter_map(|message| {
        at += gap;
        receiver.bytes(at, message);
        at += ASCII.character() * message.len() as u64;
        receiver.take().map(|body| body.map(<[u8]>::to_vec))
    });
    heard.collect()
}

/// ASCII messages: valid, with a wrong LRC, with a wrong character instead of a digit, or with noise before
/// the colon.
fn message() -> impl Strategy<Value = Vec<u8>> {
    let body = prop::collection::vec(any::<u8>(), 1..=254);
    let wrong = (any::<prop::sample::Index>(), prop::sample::select(&b"0F:\r Gg\x80"[..]));
    (body, prop::option::weighted(0.3, wrong), prop::collection::vec(0x20_u8..0x30, 0..4)).prop_map(
        |(body, wrong, before)| {
            let mut message = ascii::encode(&body).to_vec();
            if let Some((place, character)) = wrong {
                let place = place.index(message.len() - 1);
                message[place] = character;
            }
            [before, message].concat()
        },
    )
}

/// ADUs with any PDU.
fn adu() -> impl Strategy<Value = Vec<u8>> {
    (any::<u16>(), any::<u8>(), prop::collection::vec(any::<u8>(), 1..=253))
        .prop_map(|(transaction, unit, pdu)| tcp::frame(tcp::Header { transaction, unit }, &pdu).to_vec())
}

/// Text lines that a drive receives from the characters in `parts`, and true for each line with an error.
fn lines(parts: &[&[u8]]) -> Vec<(Vec<u8>, bool)> {
    let mut lines = Lines::<16>::new();
    let ended = parts.concat().into_iter().filter_map(|character| lines.push(character));
    ended.map(|line| (line.text.to_vec(), line.flaw.is_some())).collect()
}

/// Typed text: characters of commands of QSB and MCode, of any length, with any line end.
fn typed() -> impl Strategy<Value = Vec<u8>> {
    let character = prop::sample::select(&b"PRWS 0123456789=,ABEX\x08\x03"[..]);
    let end = prop::sample::select(&["\r", "\n", "\r\n", "\n\r", "\r\r", "\n\n"][..]);
    (prop::collection::vec(character, 0..24), end)
        .prop_map(|(text, end)| [&text[..], end.as_bytes()].concat())
}

proptest! {
    #[test]
    fn messages_of_ascii_are_cut_where_a_drive_finds_their_end(
        messages in prop::collection::vec(message(), 1..5), reads in reads(), gap in 0_u64..100_000_000,
    ) {
        let stream = messages.concat();
        let host = of_host(ASCII, &split(&stream, &reads), Expect::Requests);
        prop_assert_eq!(&host.concat(), &stream);
        // The result does not depend on the silence between the messages, also if the host leaves none.
        let silences = ascii_with_silences(&messages, Duration::from_ticks(gap));
        prop_assert_eq!(ascii_with_silences(&host, Duration::ZERO), silences);
    }

    #[test]
    fn requests_on_a_connection_are_cut_as_if_they_had_come_singly(
        adus in prop::collection::vec(adu(), 1..6), reads in reads(),
    ) {
        let stream = adus.concat();
        let mut splitter = Splitter::new();
        let mut host = Vec::new();
        for mut segment in split(&stream, &reads) {
            while let Some(adu) = splitter.next(&mut segment).unwrap() {
                host.push(adu.to_vec());
            }
        }
        prop_assert_eq!(host, adus);
    }

    #[test]
    fn lines_are_cut_as_if_each_had_come_after_a_silence(
        typed in prop::collection::vec(typed(), 1..6), reads in reads(),
    ) {
        let stream = typed.concat();
        let mut host: Vec<&[u8]> = Vec::new();
        for mut part in split(&stream, &reads) {
            host.extend(std::iter::from_fn(|| next_line(&mut part)));
        }
        // No byte is lost, no message continues after the end of its line, and the drive receives the same
        // lines.
        prop_assert_eq!(&host.concat(), &stream);
        for message in &host {
            let begin = &message[..message.len() - 1];
            prop_assert!(!begin.contains(&b'\r') && !begin.iter().skip(1).any(|&character| character == b'\n'));
        }
        let singly: Vec<&[u8]> = typed.iter().map(Vec::as_slice).collect();
        prop_assert_eq!(lines(&host), lines(&singly));
    }
}
