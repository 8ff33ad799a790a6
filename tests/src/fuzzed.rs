//! Bodies of the fuzz targets: each takes any bytes, and panics if an invariant is violated. `fuzz/`
//! generates the bytes, and `tests/fuzzed.rs` replays those that are saved in `fuzz/corpus`.

use drivetwin_firmware::device::{
    Boot, Device, Duration, Encoder, Fault, Framing, Input, Instant, Line, Link, Pin, Port, advance, feed,
};
use drivetwin_firmware::testing::Transcript;
use drivetwin_protocol::line::Parity;
use drivetwin_protocol::modbus::rtu::{self, crc, verify_crc};
use drivetwin_protocol::modbus::tcp::{self, Splitter};
use drivetwin_protocol::modbus::{self, DropReason, Expect, Scan, ascii};
use drivetwin_protocol::text::{Lines, next_line};
use drivetwin_sim::catalog;
use drivetwin_sim::config::bench_file;
use drivetwin_sim::record::trace::Trace;
use drivetwin_sim::rsasm;

/// A fuzz target: a function of the input bytes.
pub type Target = fn(&[u8]);

/// Targets other than drives, by name; each kind of drive is a target as well.
pub const PARSERS: [(&str, Target); 9] = [
    ("rtu", rtu_bursts),
    ("ascii", ascii_messages),
    ("mbap", mbap_segments),
    ("mcode", mcode_lines),
    ("qsb-lines", qsb_lines),
    ("bench-file", bench_file),
    ("trace", trace),
    ("rsasm", program),
    ("memory", memory),
];

/// Names of all targets.
pub fn names() -> impl Iterator<Item = &'static str> {
    PARSERS.iter().map(|(name, _)| *name).chain(catalog::specs().map(|spec| spec.kind))
}

/// Runs the target of that name.
///
/// # Panics
/// If an invariant is violated, or there is no such target.
pub fn run(name: &str, bytes: &[u8]) {
    match PARSERS.iter().find(|(parser, _)| *parser == name) {
        Some((_, target)) => target(bytes),
        None => drive(name, bytes),
    }
}

/// Takes the first byte.
fn take(bytes: &mut &[u8]) -> Option<u8> {
    let (first, rest) = bytes.split_first()?;
    *bytes = rest;
    Some(*first)
}

/// Takes a part of the input: its length is the first byte modulo `most`, at most all remaining bytes.
fn take_some<'a>(bytes: &mut &'a [u8], most: u8) -> Option<&'a [u8]> {
    let count = usize::from(take(bytes)? % most);
    let (some, rest) = bytes.split_at(count.min(bytes.len()));
    *bytes = rest;
    Some(some)
}

/// A stream in parts of `length` bytes.
fn parts(stream: &[u8], length: u8) -> impl Iterator<Item = &[u8]> {
    stream.chunks(usize::from(length).max(1))
}

const RTU: Line = Line::new(9_600, 8, Parity::Even, 1);
const ASCII: Line = Line::new(9_600, 7, Parity::Even, 1);

/// Messages into which the host splits a stream. The stream arrives in reads of `length` bytes; after it the
/// line is silent.
fn of_host(line: Line, stream: &[u8], length: u8, expect: Expect) -> Vec<Vec<u8>> {
    let (mut waiting, mut messages) = (Vec::new(), Vec::new());
    for part in parts(stream, length) {
        waiting.extend_from_slice(part);
        while let Scan::Complete(length) | Scan::Invalid(length) = modbus::scan(line, &waiting, expect) {
            assert!(length > 0 && length <= waiting.len(), "a part of what there is");
            messages.push(waiting.drain(..length).collect());
        }
    }
    while !waiting.is_empty() {
        let length = match modbus::scan(line, &waiting, expect) {
            Scan::Complete(length) | Scan::Invalid(length) => length,
            Scan::Incomplete | Scan::Ambiguous => modbus::ended(line, &waiting, expect),
        };
        assert!(length > 0 && length <= waiting.len(), "a part of what there is");
        messages.push(waiting.drain(..length).collect());
    }
    assert_eq!(messages.concat(), stream, "nothing is lost or made");
    messages
}

/// Input: the length of reads; a byte that selects what is expected (requests, replies or both) and the form
/// of the rest; the rest. The rest is the stream itself, or PDUs, each after its length, that are sent as
/// frames.
fn rtu_bursts(mut bytes: &[u8]) {
    let (Some(length), Some(how)) = (take(&mut bytes), take(&mut bytes)) else { return };
    let expect = [Expect::Requests, Expect::Both, Expect::Replies][usize::from(how) / 2 % 3];
    let mut stream = bytes.to_vec();
    if how % 2 == 1 {
        stream.clear();
        while let Some((&unit, pdu)) = take_some(&mut bytes, 255).and_then(<[u8]>::split_first) {
            stream.extend(rtu::frame(unit, pdu));
        }
    }
    stream.truncate(1_000);
    let whole = of_host(RTU, &stream, u8::MAX, expect);
    assert_eq!(of_host(RTU, &stream, length, expect), whole);
    let mut receiver = rtu::RtuReceiver::new(RTU);
    let mut at = Instant::ZERO + Duration::secs(1);
    for message in &whole {
        receiver.bytes(at, message);
        at = receiver.deadline() + RTU.character();
        let heard = receiver.take().expect("silence ends a frame");
        match message.len() {
            0..=modbus::FRAME_BYTES => assert_eq!(heard, Ok(&message[..])),
            _ => assert_eq!(heard, Err(DropReason::Length)),
        }
        if let Some((_, pdu)) = verify_crc(message).and_then(<[u8]>::split_first) {
            let _ = modbus::pdu::Request::parse(pdu);
        }
    }
}

/// Input: the length of reads, and characters.
fn ascii_messages(mut bytes: &[u8]) {
    let Some(length) = take(&mut bytes) else { return };
    let whole = of_host(ASCII, bytes, u8::MAX, Expect::Requests);
    // Bytes without a colon are passed on at each read. So with another length only the messages are the
    // same.
    let messages =
        |bursts: &[Vec<u8>]| -> Vec<Vec<u8>> { bursts.iter().filter_map(|burst| heard(burst)).collect() };
    let cut = of_host(ASCII, bytes, length, Expect::Requests);
    if bytes.len() < ascii::MESSAGE_CHARACTERS {
        assert_eq!(messages(&cut), messages(&whole));
    }
    for body in messages(&whole) {
        assert_eq!(ascii::decode(&ascii::encode(&body)).as_deref(), Some(&body[..]));
    }
}

/// The body that an ASCII receiver returns.
fn heard(characters: &[u8]) -> Option<Vec<u8>> {
    let mut receiver = ascii::AsciiReceiver::new(ASCII);
    receiver.bytes(Instant::ZERO + Duration::secs(1), characters);
    receiver.take()?.ok().map(<[u8]>::to_vec)
}

/// Input: the length of segments, and their contents.
fn mbap_segments(mut bytes: &[u8]) {
    let Some(length) = take(&mut bytes) else { return };
    let split = |length| {
        let (mut splitter, mut adus) = (Splitter::new(), Vec::new());
        for mut segment in parts(bytes, length) {
            loop {
                match splitter.next(&mut segment) {
                    Ok(Some(adu)) => adus.push(adu.to_vec()),
                    Ok(None) => break,
                    Err(broken) => return (adus, Some(broken)),
                }
            }
        }
        (adus, None)
    };
    let whole = split(u8::MAX);
    assert_eq!(split(length), whole);
    let (adus, _) = whole;
    assert!(bytes.starts_with(&adus.concat()));
    assert!(adus.iter().all(|adu| tcp::parse(adu).is_some()));
}

/// Input: the length of reads, and typed characters. An MDrive gets the same lines from single characters as
/// from a stream that is split after each end of a line.
fn mcode_lines(mut bytes: &[u8]) {
    let Some(length) = take(&mut bytes) else { return };
    let bytes = &bytes[..bytes.len().min(400)];
    let mut cut: Vec<&[u8]> = Vec::new();
    for mut part in parts(bytes, length) {
        cut.extend(std::iter::from_fn(|| next_line(&mut part)));
    }
    assert_eq!(cut.concat(), bytes);
    assert_eq!(lines(&cut), lines(&[bytes]));
    let mut drive = catalog::make("mdrive").expect("a kind");
    let mut log = Transcript::new(drive.spec().memory.into()).without_notes();
    drive.power_on(Instant::ZERO, Boot { seed: 1, fast: true, ..Boot::default() }, &mut log);
    let mut at = Instant::ZERO + Duration::secs(2);
    let port = port(&*drive, Framing::Return).expect("a port of MCode");
    feed_at(&mut *drive, at, Input::Opened { port, link: Link(0) }, &mut log);
    for bytes in cut {
        at += Duration::millis(1);
        feed_at(&mut *drive, at, Input::Message { port, link: Link(0), bytes }, &mut log);
    }
    settle(&mut *drive, at + Duration::millis(100), &mut log);
}

/// Lines that a drive receives from the characters of `parts`, and for each line true if it has an error.
fn lines(parts: &[&[u8]]) -> Vec<(Vec<u8>, bool)> {
    let mut lines = Lines::<64>::new();
    let ended = parts.concat().into_iter().filter_map(|character| lines.push(character));
    ended.map(|line| (line.text.to_vec(), line.flaw.is_some())).collect()
}

/// Input: a kind of QSB, and the characters that are typed.
fn qsb_lines(mut bytes: &[u8]) {
    let Some(kind) = take(&mut bytes) else { return };
    let mut drive = catalog::make(["qsb-d", "qsb-m", "qsb-s"][usize::from(kind) % 3]).expect("a kind");
    let mut log = Transcript::new(drive.spec().memory.into()).without_notes();
    drive.power_on(Instant::ZERO, Boot { seed: 1, fast: true, ..Boot::default() }, &mut log);
    let mut at = Instant::ZERO + Duration::secs(1);
    for byte in bytes.iter().take(400) {
        at += Duration::millis(1);
        feed_at(&mut *drive, at, Input::Bytes { port: Port(0), bytes: &[*byte] }, &mut log);
    }
    settle(&mut *drive, at + Duration::millis(100), &mut log);
}

/// Input: a bench file. Parsing succeeds, or fails with an error message and a position inside the file.
fn bench_file(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    if let Err(error) = bench_file::parse(text) {
        assert!(error.line >= 1 && error.line <= text.lines().count() + 1 && error.column >= 1, "{error}");
        assert!(!error.what.is_empty());
    }
}

/// Input: a trace. A trace that parses is unchanged after it is written and parsed again.
fn trace(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let make = |kind: &str| catalog::make(kind).ok();
    if let Ok(trace) = Trace::parse(text, &make) {
        let text = trace.to_text();
        let again = Trace::parse(&text, &make).unwrap_or_else(|error| panic!("{error}:\n{text}"));
        assert_eq!(again.to_text(), text);
    }
}

/// Input: a user program of an RS 434544 as text. Its disassembly assembles to the same program.
fn program(bytes: &[u8]) {
    if let Ok(program) = rsasm::assemble_bytes(bytes) {
        let text = rsasm::disassemble(&program);
        assert_eq!(rsasm::assemble(&text), Ok(program), "{text}");
    }
}

/// Input: the kind, the boot mode, and a saved memory. The check sums of the memory are corrected, or used as
/// given. The drive stores nothing without a save.
fn memory(mut bytes: &[u8]) {
    let (Some(kind), Some(how)) = (take(&mut bytes), take(&mut bytes)) else { return };
    let specs: Vec<_> = catalog::specs().collect();
    let spec = specs[usize::from(kind) % specs.len()];
    let saved: u16 =
        spec.registers.rows.iter().filter(|row| row.saved != 0).map(|row| row.shape.words()).sum();
    let mut memory = bytes.to_vec();
    memory.resize(usize::from(spec.memory), 0xFF);
    if how & 2 != 0 {
        // The settings come first, then the other parts, each with its check sum (firmware/src/memory.rs).
        let (settings, rest) =
            memory.split_at_mut((2 * usize::from(saved) + 2).min(usize::from(spec.memory)));
        for part in [settings, rest] {
            if let Some((body, sum)) = part.split_last_chunk_mut::<2>() {
                *sum = crc(body).to_be_bytes();
            }
        }
    }
    let mut drive = catalog::make(spec.kind).expect("a kind");
    let mut log = Transcript::with_memory(memory.clone()).without_notes();
    drive.power_on(Instant::ZERO, Boot { seed: 1, fast: how & 1 != 0, ..Boot::default() }, &mut log);
    settle(&mut *drive, Instant::ZERO + Duration::secs(1), &mut log);
    // A user program that starts at power-on may save.
    assert!(spec.registers.rows.iter().any(|row| row.name == "MODE_USER_PROGRAM") || log.memory == memory);
}

/// Port of a drive with the framing `ends`.
fn port(drive: &dyn Device, ends: Framing) -> Option<Port> {
    let place = drive.spec().ports.iter().position(|port| port.framing == ends)?;
    u8::try_from(place).ok().map(Port)
}

/// Lets a drive handle all its deadlines before `at`, then passes the input to it.
fn feed_at(drive: &mut dyn Device, at: Instant, input: Input<'_>, log: &mut Transcript) {
    let due = drive.deadline();
    feed(drive, due, at, input, log);
}

/// Runs a drive to `at` without input and checks that its next deadline is later.
fn settle(drive: &mut dyn Device, at: Instant, log: &mut Transcript) {
    let due = advance(drive, at, core::iter::empty(), log);
    assert!(due > at, "a deadline at {} that was due at {}", due.ticks(), at.ticks());
}

/// An event of a drive: its instant, its kind and its bytes.
type Event = (Instant, Happens, Vec<u8>);

#[derive(Clone, Copy)]
enum Happens {
    Bytes,
    RxError,
    Idle,
    HostPresence(bool),
    Edge(Pin, bool),
    Open(Pin),
    Millivolts(Pin, i32),
    Count(Encoder, i32, u8),
    Fault(Fault, bool),
    Opened(Port, Link),
    Message(Port, Link),
    Closed(Port, Link),
}

impl Happens {
    fn input(self, bytes: &[u8]) -> Input<'_> {
        let port = Port(0);
        match self {
            Self::Bytes => Input::Bytes { port, bytes },
            Self::RxError => Input::RxError { port },
            Self::Idle => Input::Idle { port },
            Self::HostPresence(here) => Input::HostPresence { port, here },
            Self::Edge(pin, high) => Input::Edge { pin, high },
            Self::Open(pin) => Input::Open { pin },
            Self::Millivolts(pin, mv) => Input::Millivolts { pin, mv },
            Self::Count(encoder, steps, ab) => {
                Input::Count { encoder, steps, a: ab & 1 != 0, b: ab & 2 != 0 }
            }
            Self::Fault(fault, on) => Input::Fault { fault, on },
            Self::Opened(port, link) => Input::Opened { port, link },
            Self::Message(port, link) => Input::Message { port, link, bytes },
            Self::Closed(port, link) => Input::Closed { port, link },
        }
    }
}

/// Time for which a drive gets events.
const LONGEST: Duration = Duration::secs(2);

/// Input: the boot mode of a drive of that kind, then its events: for each the event, its data, and two bytes
/// for the pause after it. A drive that is called only at the end has the same outputs, and no deadline is in
/// the past.
fn drive(kind: &str, mut bytes: &[u8]) {
    let Some(how) = take(&mut bytes) else { return };
    let boot = Boot { seed: 1, fast: how & 1 != 0, ..Boot::default() };
    let new = || {
        let mut drive = catalog::make(kind).unwrap_or_else(|error| panic!("{error}"));
        let mut log = Transcript::new(drive.spec().memory.into()).without_notes();
        drive.power_on(Instant::ZERO, boot, &mut log);
        (drive, log)
    };
    let (mut prompt, mut log) = new();
    let mut events: Vec<Event> = Vec::new();
    let mut at = Instant::ZERO + Duration::millis(if boot.fast { 100 } else { 600 });
    let end = at + LONGEST;
    while at < end {
        settle(&mut *prompt, at - Duration::TICK, &mut log);
        let Some(happens) = next(&*prompt, at, log.line, &mut bytes) else { break };
        for event in &happens {
            feed_at(&mut *prompt, event.0, event.1.input(&event.2), &mut log);
        }
        at = happens.last().map_or(at, |&(last, _, ref text)| last + SLOWEST * text.len() as u64);
        events.extend(happens);
        let Some(gap) = take(&mut bytes).zip(take(&mut bytes)) else { break };
        let gap = u64::from(u16::from_le_bytes([gap.0, gap.1]));
        at += Duration::from_ticks(1 + gap * gap / 512);
    }
    settle(&mut *prompt, end + LONGEST, &mut log);
    let (mut late, mut other) = new();
    let inputs = events.iter().map(|(at, happens, bytes)| (*at, happens.input(bytes)));
    advance(&mut *late, end + LONGEST, inputs, &mut other);
    let differs = log.outputs.iter().zip(&other.outputs).position(|(one, other)| one != other);
    assert_eq!(differs.map(|n| (&log.outputs[n], &other.outputs[n])), None, "called late");
    assert_eq!((log.outputs.len(), log.memory), (other.outputs.len(), other.memory), "called late");
}

/// Duration longer than a character on any line.
const SLOWEST: Duration = Duration::millis(10);

/// The next event of a drive at `at`; `line` is the line setting that the drive has reported, if any.
fn next(drive: &dyn Device, at: Instant, line: Option<Line>, bytes: &mut &[u8]) -> Option<Vec<Event>> {
    let spec = drive.spec();
    let (what, which) = (take(bytes)?, take(bytes)?);
    let on = which & 0x80 != 0;
    let among = |count: usize| if count == 0 { 0 } else { which & 0x7F } % count.max(1) as u8;
    let pin = Pin(among(spec.pins.len()));
    let (mbap, mcode) =
        (port(drive, Framing::Mbap), port(drive, Framing::Return).filter(|_| spec.is_on_network()));
    let (link, tcp) = (Link(which & 3), if which & 4 == 0 { mbap } else { mcode });
    let one = |happens| Some(vec![(at, happens, Vec::new())]);
    match what % 12 {
        0..=3 => {
            let text = take_some(bytes, 80)?;
            let text = match what % 4 {
                0 => text.to_vec(),
                1 => [text, b"\r"].concat(),
                _ if mbap.is_some() => {
                    tcp::frame(tcp::Header { transaction: 7, unit: which & 3 }, text).to_vec()
                }
                2 => rtu::frame(which & 3, text).to_vec(),
                _ => ascii::frame(which & 3, text).to_vec(),
            };
            match (tcp, spec.is_on_network()) {
                (Some(port), true) => Some(messages(at, port, Some(port) == mbap, link, &text)),
                (None, true) => Some(Vec::new()),
                _ => Some(characters(drive, at, line, &text)),
            }
        }
        4 if spec.is_on_network() => one(Happens::Opened(tcp?, link)),
        4 => one(Happens::HostPresence(on)),
        5 if spec.is_on_network() => one(Happens::Closed(tcp?, link)),
        5 if on => one(Happens::Idle),
        5 => one(Happens::RxError),
        6 if !spec.faults.is_empty() => one(Happens::Fault(Fault(among(spec.faults.len())), on)),
        7 => one(Happens::Millivolts(pin, i32::from(take(bytes)?) * 100 - 1_000)),
        8 if !spec.encoders.is_empty() => one(Happens::Count(
            Encoder(among(spec.encoders.len())),
            i32::from(take(bytes)?) - 128,
            which >> 5,
        )),
        9 if spec.pins.get(usize::from(pin.0)).is_some_and(|pin| pin.reports_open()) => {
            one(Happens::Open(pin))
        }
        _ => one(Happens::Edge(pin, on)),
    }
}

/// Characters on a drive's serial line. If silence ends a frame, they arrive in bursts that end at each line
/// feed; else singly.
fn characters(drive: &dyn Device, mut at: Instant, line: Option<Line>, text: &[u8]) -> Vec<Event> {
    let port = drive.spec().ports[0];
    let line = line.or(port.line).unwrap_or(Line::new(115_200, 8, Parity::None, 1));
    let most = if port.framing == Framing::Silence { text.len().max(1) } else { 1 };
    let bursts = text.split_inclusive(|&byte| byte == b'\n').flat_map(|burst| burst.chunks(most));
    let events = bursts.map(|burst| {
        let begins = at;
        at += line.character() * burst.len() as u64;
        (begins, Happens::Bytes, burst.to_vec())
    });
    events.collect()
}

/// Messages on a connection: one whole ADU, or text that is split after each end of a line.
fn messages(at: Instant, port: Port, adus: bool, link: Link, text: &[u8]) -> Vec<Event> {
    let mut rest = text;
    let lines = std::iter::from_fn(|| if adus { None } else { next_line(&mut rest).map(<[u8]>::to_vec) });
    let lines: Vec<_> = lines.collect();
    let whole = adus && tcp::parse(text).is_some();
    let messages = if whole { vec![text.to_vec()] } else { lines };
    messages.into_iter().map(|message| (at, Happens::Message(port, link), message)).collect()
}
