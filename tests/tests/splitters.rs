//! A host splits messages that arrive without gaps. On every drive such messages must have the same effect as
//! messages with a silence after each. The tests send RTU requests with a CRC that is valid too early,
//! pipelined ADUs, and lines of MCode and of a QSB. The host gets them in reads of any size.
#![allow(missing_docs, reason = "a test")]

use drivetwin_firmware::device::{Boot, Duration, Framing, Input, Instant, Port, advance, feed};
use drivetwin_firmware::testing::Recorder;
use drivetwin_protocol::modbus::rtu::{self, crc, verify_crc};
use drivetwin_protocol::modbus::tcp;
use drivetwin_sim::bench::{Bench, Client, Settings, Setup};
use drivetwin_sim::catalog;
use proptest::prelude::*;

/// Time longer than the start-up of any drive with `boot_fast`.
const START: Duration = Duration::secs(5);

/// Time longer than any drive takes to answer.
const ANSWER: Duration = Duration::millis(100);

const SERIAL: Port = Port(0);

/// Kinds of drive that have a port with this framing.
fn kinds_of(ends: Framing) -> Vec<&'static str> {
    let kinds: Vec<_> = catalog::specs()
        .filter(|spec| spec.ports.iter().any(|port| port.framing == ends))
        .map(|spec| spec.kind)
        .collect();
    assert!(!kinds.is_empty());
    kinds
}

/// Answers of a drive to each frame, with a second of silence after each frame and without a host.
fn with_silences(kind: &str, frames: &[Vec<u8>]) -> Vec<Vec<u8>> {
    let mut drive = catalog::make(kind).expect("a kind");
    let mut out = Recorder::new(drive.spec().memory.into());
    drive.power_on(Instant::ZERO, Boot { seed: 1, fast: true, ..Boot::default() }, &mut out);
    let mut at = Instant::ZERO + START;
    advance(&mut *drive, at, core::iter::empty(), &mut out);
    let answers = frames.iter().map(|frame| {
        let due = drive.deadline();
        feed(&mut *drive, due, at, Input::Bytes { port: SERIAL, bytes: frame }, &mut out);
        at += Duration::secs(1);
        advance(&mut *drive, at, core::iter::empty(), &mut out);
        let answer = out.sent(SERIAL).into_iter().flat_map(|(_, bytes)| bytes).collect();
        out.clear();
        answer
    });
    answers.collect()
}

/// A bench with a drive of this kind that has started.
fn bench(kind: &str) -> Bench {
    let mut bench = Bench::with(Settings::default());
    let drive = catalog::make(kind).expect("a kind");
    bench
        .add_with("x", drive, Setup { boot_fast: true, ..Setup::default() })
        .expect("a drive that can be seated");
    bench.run_until(Instant::ZERO + START);
    bench
}

/// A client of the only port with this framing.
fn client(bench: &mut Bench, ends: Framing) -> Client {
    let seat = bench.find_drive("x").expect("the drive");
    let place = bench.spec(seat).ports.iter().position(|port| port.framing == ends).expect("a port");
    let port = Port(u8::try_from(place).expect("few ports"));
    match bench.bus(seat, port) {
        Some(bus) => bench.connect(bus),
        None => bench.connect_to(seat, port).expect("a drive that accepts connections"),
    }
}

/// Sends the parts with pauses between them, then waits as long as the answers take. Returns the bytes that
/// the client receives.
fn said(bench: &mut Bench, client: Client, parts: &[&[u8]], pause: Duration, answers: usize) -> Vec<u8> {
    for part in parts {
        bench.send(client, part);
        bench.run_until(bench.now() + pause);
    }
    bench.run_until(bench.now() + ANSWER * (answers as u64 + 1));
    let mut heard = Vec::new();
    bench.receive(client, &mut heard);
    heard
}

/// Splits a stream into reads. Their lengths are those in `reads`, repeated.
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

fn reads() -> impl Strategy<Value = Vec<usize>> {
    prop::collection::vec(prop_oneof![1_usize..12, 1_usize..300], 1..8)
}

/// Addresses at which no drive has a register. A write is refused, and nothing changes.
const NOWHERE: std::ops::RangeInclusive<u16> = 0x9000..=0xFFFF;

/// A PDU that the drives refuse and that changes nothing.
fn pdu() -> impl Strategy<Value = Vec<u8>> {
    let [a, b] = NOWHERE.start().to_be_bytes();
    prop_oneof![
        (1_u8..=6, 0_u8..4, 1_u8..9).prop_map(move |(function, first, n)| vec![function, a, b + first, 0, n]),
        any::<[u8; 4]>().prop_map(move |values| [&[16, a, b, 0, 2, 4][..], &values].concat()),
        prop::sample::select(&[7_u8, 11, 12, 17][..]).prop_map(|function| vec![function]),
        any::<[u8; 6]>().prop_map(|data| [&[22][..], &data].concat()),
        (prop::sample::select(&[8_u8, 65, 66, 99, 127][..]), prop::collection::vec(any::<u8>(), 0..60))
            .prop_map(|(function, data)| [&[function][..], &data].concat()),
    ]
}

/// A frame of function 15 or 16 with that many bytes of values, whose first eight bytes are a valid frame,
/// too.
fn by_chance(unit: u8, function: u8, bytes: u8, seed: u16) -> Vec<u8> {
    let number = if function == 16 { bytes / 2 } else { bytes.saturating_mul(8) };
    let all = NOWHERE.cycle().skip(usize::from(seed)).take(NOWHERE.len());
    let begins = all.map(|address| {
        let [a, b] = address.to_be_bytes();
        [unit, function, a, b, 0, number]
    });
    let begin = begins.into_iter().find(|begin| crc(begin).to_le_bytes()[0] == bytes).expect("one of 256");
    let value = crc(&begin).to_le_bytes()[1];
    let values: Vec<u8> = (0..bytes).map(|n| if n == 0 { value } else { n ^ (seed & 0xFF) as u8 }).collect();
    let frame = rtu::frame(unit, &[&begin[1..], &[bytes], &values].concat()).to_vec();
    assert!(verify_crc(&frame[..8]).is_some() && verify_crc(&frame).is_some());
    frame
}

/// A request to the drive, or sometimes to another drive.
#[derive(Clone, Debug)]
enum Request {
    Any(u8, Vec<u8>),
    ByChance(u8, u8, u16),
}

fn request() -> impl Strategy<Value = Request> {
    prop_oneof![
        (0_u8..8, pdu()).prop_map(|(other, pdu)| Request::Any(u8::from(other == 0), pdu)),
        (15_u8..=16, 1_u8..=15, any::<u16>()).prop_map(|(function, words, seed)| Request::ByChance(
            function,
            2 * words,
            seed
        )),
    ]
}

impl Request {
    fn to(&self, unit: u8) -> Vec<u8> {
        match self {
            Self::Any(other, pdu) => rtu::frame(unit + other, pdu).to_vec(),
            &Self::ByChance(function, bytes, seed) => by_chance(unit, function, bytes, seed),
        }
    }
}

/// Address of a drive with factory settings.
fn unit(kind: &str) -> u8 {
    let drive = catalog::make(kind).expect("a kind");
    let spec = drive.spec();
    let row = &spec.registers.rows[spec.address.expect("a bus address")];
    u8::try_from(row.reset).expect("a bus address")
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    #[test]
    fn rtu_without_gaps_is_answered_as_rtu_with_silences(
        requests in prop::collection::vec(request(), 1..6), reads in reads(), pause in 0_u64..80_000,
    ) {
        for kind in kinds_of(Framing::Silence) {
            let frames: Vec<Vec<u8>> = requests.iter().map(|request| request.to(unit(kind))).collect();
            let answers = with_silences(kind, &frames);
            let here = answers.iter().filter(|answer| !answer.is_empty()).count();
            let to_it = frames.iter().filter(|frame| frame[0] == unit(kind)).count();
            prop_assert_eq!(here, to_it, "{} answers {:02x?} of {:02x?}", kind, answers, frames);
            let mut bench = bench(kind);
            let client = client(&mut bench, Framing::Silence);
            let (stream, pause) = (frames.concat(), Duration::from_ticks(pause));
            let heard = said(&mut bench, client, &split(&stream, &reads), pause, frames.len());
            prop_assert_eq!(&heard, &answers.concat(), "{} hears {:02x?}", kind, frames);
            // With other devices on the line a master waits for each answer, and a silence ends a message.
            bench.set_self_paced(client);
            for (frame, answer) in frames.iter().zip(&answers) {
                let heard = said(&mut bench, client, &split(frame, &reads), pause, 2);
                prop_assert_eq!(&heard, answer, "{} hears {:02x?}", kind, frame);
            }
        }
    }

    #[test]
    fn adus_at_once_are_answered_as_one_by_one(
        pdus in prop::collection::vec(prop_oneof![pdu(), adu()], 1..6), reads in reads(),
    ) {
        for kind in kinds_of(Framing::Mbap) {
            let adus: Vec<Vec<u8>> = (1..)
                .zip(&pdus)
                .map(|(transaction, pdu)| tcp::frame(tcp::Header { transaction, unit: 1 }, pdu).to_vec())
                .collect();
            let mut singly = bench(kind);
            let one = client(&mut singly, Framing::Mbap);
            let answers: Vec<Vec<u8>> =
                adus.iter().map(|adu| said(&mut singly, one, &[adu], Duration::ZERO, 1)).collect();
            prop_assert!(answers.iter().all(|answer| tcp::parse(answer).is_some()), "{:02x?}", answers);
            let mut bench = bench(kind);
            let client = client(&mut bench, Framing::Mbap);
            let heard = said(&mut bench, client, &split(&adus.concat(), &reads), Duration::ZERO, adus.len());
            prop_assert_eq!(heard, answers.concat());
        }
    }

    #[test]
    fn lines_at_once_are_answered_as_one_by_one(
        lines in prop::collection::vec(line(), 1..8), reads in reads(), pause in 0_u64..20_000,
    ) {
        // A QSB handles each character at once and does not wait for the end of a line.
        let ends = [Framing::Return, Framing::Character].into_iter();
        for (kind, ends) in ends.flat_map(|ends| kinds_of(ends).into_iter().map(move |kind| (kind, ends))) {
            // The first line always has an answer, whatever the others are.
            let first = ("R0E\r".to_owned(), "PR R1\r".to_owned());
            let lines: Vec<String> = core::iter::once(&first).chain(&lines)
                .map(|(qsb, mdrive)| if kind.starts_with("qsb") { qsb } else { mdrive }.clone())
                .collect();
            let mut singly = bench(kind);
            let one = client(&mut singly, ends);
            let answers: Vec<Vec<u8>> =
                lines.iter().map(|line| said(&mut singly, one, &[line.as_bytes()], Duration::ZERO, 1)).collect();
            prop_assert!(!answers[0].is_empty());
            let mut bench = bench(kind);
            let client = client(&mut bench, ends);
            let (stream, pause) = (lines.concat(), Duration::from_ticks(pause));
            let heard = said(&mut bench, client, &split(stream.as_bytes(), &reads), pause, lines.len());
            let (heard, wanted) = (String::from_utf8_lossy(&heard), answers.concat());
            prop_assert_eq!(heard, String::from_utf8_lossy(&wanted), "{} hears {:?}", kind, lines);
        }
    }
}

/// A PDU with one of the MDrive's own functions: a mnemonic of two characters, in reverse order, and text (FB
/// 4.3.1).
fn adu() -> impl Strategy<Value = Vec<u8>> {
    (65_u8..=66, prop::sample::select(vec![*b"R1", *b"S1", *b"VM", *b"ZZ"]), "[=0-9,]{0,6}").prop_map(
        |(function, name, text)| {
            [&[function, b' ', b' ', name[1], name[0], text.len() as u8], text.as_bytes()].concat()
        },
    )
}

/// A line for a QSB, and one for an MDrive. Their answers do not depend on time, and they start nothing that
/// would.
fn line() -> impl Strategy<Value = (String, String)> {
    let qsb = prop::sample::select(&["R0E", "R00", "W0812", "W0A1F", "R03", "R", "X1", "W0", "r0e", ""][..]);
    let mdrive = prop::sample::select(
        &["PR VM", "R1=5", "PR R1", "PR \"a\",R1,R2", "R2=R1+7", "PR ZZ", "S1=0,1,0", "PR S1", "", "X"][..],
    );
    let end = prop::sample::select(&["\r", "\n", "\r\n"][..]);
    (qsb, mdrive, end).prop_map(|(qsb, mdrive, end)| (format!("{qsb}{end}"), format!("{mdrive}{end}")))
}
