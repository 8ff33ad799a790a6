//! Properties of every drive with any inputs: a late call changes nothing, splitting a burst of
//! characters changes nothing, and no input makes the drive hang or panic.
#![allow(missing_docs, reason = "a test")]

use std::process::Command;

use drivetwin_firmware::device::{
    Boot, Device, Duration, Encoder, Fault, Framing, Input, Instant, Link, Pin, Port, advance,
};
use drivetwin_firmware::testing::Transcript;
use drivetwin_protocol::line::{Line, Parity};
use drivetwin_protocol::modbus::{ascii, rtu, tcp};
use drivetwin_protocol::text::next_line;
use drivetwin_tests::md3::at;
use drivetwin_tests::toy::Toy;
use proptest::prelude::*;

/// An event at a drive.
#[derive(Clone, Debug)]
enum Event {
    Bytes(Vec<u8>),
    RxError,
    Idle,
    HostPresence(bool),
    Edge(u8, bool),
    Millivolts(u8, i32),
    Count(u8, i32, bool, bool),
    Fault(u8, bool),
    /// Events of a TCP connection: the framing that selects the port, the number of the connection, and data.
    Opened(Framing, u8),
    Message(Framing, u8, Vec<u8>),
    Closed(Framing, u8),
}

/// Makes a drive without power.
type Make = fn() -> Box<dyn Device>;

macro_rules! boxed {
    ($($new:expr,)*) => { &[$(|| Box::new($new()),)* || Box::new(Toy::default())] };
}

static DRIVES: &[Make] = drivetwin_firmware::devices!(boxed);

/// A drive without power, with factory settings or with one register saved before its first power-on.
#[derive(Clone, Copy)]
struct Subject {
    make: Make,
    saved: Option<(&'static str, i64)>,
}

/// Every drive with factory settings, and one drive that uses ASCII.
fn subjects() -> impl Iterator<Item = Subject> {
    let ascii = Subject {
        make: || Box::new(drivetwin_firmware::rs434::Rs434::rs434544()),
        // 7 data bits, even parity (6.4).
        saved: Some(("TYPE_MODBUS", 1)),
    };
    DRIVES.iter().map(|&make| Subject { make, saved: None }).chain([ascii])
}

/// A command for a QSB: valid, with any number of digits, incomplete, erased by a backspace, or not for a
/// QSB.
fn command() -> impl Strategy<Value = Vec<u8>> {
    let letter = proptest::sample::select(b"RWSRWSQr ".to_vec());
    let digits = proptest::collection::vec(proptest::sample::select(b"00123489AFa\x08".to_vec()), 0..12);
    let end = proptest::sample::select(vec!["\r", "\n", "\r\n", "\n\r", "\r\r", "\x08", ""]);
    (letter, 0_u8..0x18, digits, end).prop_map(|(letter, register, digits, end)| {
        let mut command = vec![letter];
        command.extend(format!("{register:02X}").bytes().chain(digits).chain(end.bytes()));
        command
    })
}

/// Commands of a QSB that start something. A CR before each ends any incomplete command.
fn order() -> impl Strategy<Value = Vec<u8>> {
    let order = proptest::sample::select(vec![
        "W0C0\r",
        "W0C1\r",
        "W0CFFFF\r",
        "W0B3\r",
        "S0E\r",
        "S01\r",
        "S05\r",
        "S06\r",
        "S13\r",
        "W15F\r",
        "W161\r",
        "W162\r",
        "W160\r",
        "W163\r",
        "W168\r",
        "W169\r",
        "W0F3E8\r",
        "W1140\r",
        "W12FFFFFF00\r",
        "W0001\r",
        "W0002\r",
        "W02F0\r",
        "W02100F\r",
        "W021100\r",
        "W040F0\r",
        "W1600A\r",
        "W1670A\r",
    ]);
    order.prop_map(|order| format!("\r{order}").into_bytes())
}

/// Requests for an RS 434544, valid or nearly valid: a unit and a PDU. Requests that would change the line
/// are left out.
fn request() -> impl Strategy<Value = (u8, Vec<u8>)> {
    let address = prop_oneof![
        4 => 0x5003_u16..0x5028,
        1 => 0x6000_u16..0x6007,
        1 => 0x7000_u16..0x700C,
    ];
    let value = || prop_oneof![3 => 0_u16..5, 1 => 5_u16..2_000, 1 => any::<u16>()];
    let block = proptest::sample::select(vec![0x1000_u16, 0x2000, 0x3000, 0x5000, 0x6000, 0x7000, 0x8000]);
    let read = (1_u8..5, block, 0_u16..12, 0_u16..45)
        .prop_map(|(function, block, first, count)| pdu(function, &[block + first, count]));
    let on = proptest::sample::select(vec![0xFF00_u16, 0xFF00, 0x0000, 0x0001]);
    let coil = (0x2000_u16..0x2005, on).prop_map(|(address, on)| pdu(5, &[address, on]));
    let coils = (0x2000_u16..0x2004, 0_u16..6, any::<u8>())
        .prop_map(|(first, count, bits)| [pdu(15, &[first, count]), vec![1, bits]].concat());
    let word = (address.clone(), value()).prop_map(|(address, value)| pdu(6, &[address, value]));
    let words = (address, proptest::collection::vec(value(), 0..6))
        .prop_map(|(first, values)| write_words(first, &values));
    let order = proptest::sample::select(vec![
        // The address; a save, a program to flash and back, a restart; starting and stopping a program.
        pdu(6, &[0x5000, 2]),
        pdu(6, &[0x5024, 0x37FA]),
        pdu(6, &[0x5025, 0x8426]),
        pdu(6, &[0x5025, 0x9346]),
        pdu(6, &[0x5026, 0x95AF]),
        pdu(6, &[0x5005, 2]),
        pdu(6, &[0x5005, 1]),
        // Settings for moves, and a START.
        write_words(0x5015, &[40, 0]),
        pdu(6, &[0x5006, 2]),
        pdu(5, &[0x2000, 0xFF00]),
    ]);
    let pdu = prop_oneof![2 => read, 2 => coil, 1 => coils, 3 => word, 2 => words, 4 => order];
    (prop_oneof![1 => 0_u8..3, 4 => Just(1)], pdu)
}

/// A PDU: a function code and the words after it.
fn pdu(function: u8, words: &[u16]) -> Vec<u8> {
    let words = words.iter().flat_map(|word| word.to_be_bytes());
    core::iter::once(function).chain(words).collect()
}

/// A request with function 16.
fn write_words(first: u16, values: &[u16]) -> Vec<u8> {
    let count = values.len() as u16;
    let bytes = values.iter().flat_map(|value| value.to_be_bytes());
    pdu(16, &[first, count]).into_iter().chain([2 * count as u8]).chain(bytes).collect()
}

/// A line of a user program: a command with any fields, and data, which may be an address.
fn instruction() -> impl Strategy<Value = [u16; 2]> {
    let data = prop_oneof![
        4 => 0_u16..24,
        2 => 0x5003_u16..0x5028,
        1 => 0x7000_u16..0x700C,
        1 => 0x2000_u16..0x2004,
        1 => any::<u16>().prop_filter("changes the line", |data| !(0x5000..0x5003).contains(data)),
    ];
    (0_u16..0x69, 0_u16..2, 0_u16..11, 0_u16..5, data).prop_map(|(command, jump, system, kind, data)| {
        [command | jump << 7 | system << 8 | kind << 12, data]
    })
}

/// Requests that load a user program through the buffer to the flash (6.6), and start it.
fn program() -> impl Strategy<Value = Vec<Vec<u8>>> {
    proptest::collection::vec(instruction(), 1..24).prop_map(|lines| {
        let lines = (0..).zip(lines).map(|(n, [command, data])| write_words(0x6000, &[n, command, data]));
        let stop = pdu(6, &[0x5005, 1]);
        let start = [pdu(6, &[0x5025, 0x8426]), pdu(6, &[0x5005, 2])];
        core::iter::once(stop).chain(lines).chain(start).collect()
    })
}

/// A frame in ASCII or in RTU.
fn framed(ascii: bool, unit: u8, pdu: &[u8]) -> Vec<u8> {
    if ascii { ascii::frame(unit, pdu).to_vec() } else { rtu::frame(unit, pdu).to_vec() }
}

/// Mostly valid requests, and noise. If a drive judges silence, its line settings must not change (MD3
/// 0x1c), because a script must know the duration of its characters.
fn bytes() -> impl Strategy<Value = Vec<u8>> {
    let address = (0_u16..0x22).prop_filter("changes the line", |address| *address != 0x1c);
    let of_md3 = (0_u8..3, address, any::<u16>());
    let digits = proptest::sample::select(b":0123456789ABCDEFabcdef\r\n".to_vec());
    prop_oneof![
        4 => of_md3.clone().prop_map(|(unit, address, value)| rtu::write(unit, address, value).to_vec()),
        4 => of_md3.prop_map(|(unit, address, count)| rtu::read(unit, address, count % 40).to_vec()),
        4 => (0_u16..32).prop_map(|bits| rtu::write(1, at::MOTION, bits).to_vec()),
        2 => (0_u16..4).prop_map(|bits| rtu::write(1, at::EEPROM, bits).to_vec()),
        12 => (any::<bool>(), request()).prop_map(|(ascii, (unit, pdu))| framed(ascii, unit, &pdu)),
        1 => proptest::collection::vec(any::<u8>(), 1..300),
        1 => proptest::collection::vec(digits, 1..40),
        1 => proptest::collection::vec(prop_oneof![Just(b'0'), Just(b'1')], 1..4),
        3 => command(),
        9 => order(),
    ]
}

/// Requests for an MDrive, valid or nearly valid: registers, programs and set-up.
fn adu() -> impl Strategy<Value = Vec<u8>> {
    let address = 0_u16..0xB8;
    let value = prop_oneof![0_u32..30, 1_000_u32..2_000_000, any::<u32>()];
    let name = proptest::sample::select(vec![*b"S1", *b"S2", *b"EX", *b"PS", *b"RS", *b"E ", *b"TR", *b"CR"]);
    let string = proptest::sample::select(vec!["=0,0,0", "=16,1,0", "=7,0,0", "G1", "1", "=500", "", "="]);
    let pdu = prop_oneof![
        (proptest::sample::select(vec![1_u8, 2, 3, 5]), address.clone(), 0_u16..5)
            .prop_map(|(function, first, count)| pdu(function, &[first, count])),
        (address.clone(), any::<u16>()).prop_map(|(first, value)| write_words(first, &[value])),
        (address, value)
            .prop_map(|(first, value)| write_words(first, &[(value >> 16) as u16, (value & 0xFFFF) as u16])),
        (any::<bool>(), name, string).prop_map(|(writes, name, string)| {
            let mut pdu =
                vec![if writes { 66 } else { 65 }, b' ', b' ', name[1], name[0], string.len() as u8];
            pdu.extend(string.bytes());
            pdu
        }),
        proptest::collection::vec(any::<u8>(), 1..40),
    ];
    (0_u8..3, pdu).prop_map(|(unit, pdu)| tcp::frame(tcp::Header { transaction: 7, unit }, &pdu).to_vec())
}

/// Lines of MCode, valid or nearly valid.
fn typed() -> impl Strategy<Value = Vec<u8>> {
    let line = proptest::sample::select(vec![
        "MR 20000",
        "MA -5000,0,1",
        "SL 400000",
        "SL -3000",
        "SL 0",
        "HM 1",
        "HI 3",
        "H 20",
        "H",
        "PR P,V,MV",
        "PR AL",
        "PR ER",
        "P=0",
        "S1=2,0,0",
        "S2=3,0,0",
        "S3=1,0,0",
        "S4=17,1,0",
        "EE=1",
        "EE=0",
        "PM=1",
        "MS=16",
        "VA Q1=3",
        "IC Q1",
        "R1=R1+7",
        "R2=R1*R1",
        "PG 1",
        "PG 50",
        "PG",
        "LB G1",
        "LB K1",
        "LB SU",
        "BR G1",
        "BR G1,R1<50",
        "CL K1",
        "RT",
        "E",
        "EX 1",
        "EX G1,1",
        "EX G1,2",
        "PS",
        "RS",
        "OE K1",
        "OE 0",
        "TP=3000,K1",
        "TT=15,K1",
        "TI=1,K1",
        "TR=500,K1,3",
        "TE=11",
        "TE=16",
        "IV R3",
        "250",
        "EM=2",
        "EM=0",
        "S",
        "IP",
        "CP",
        "L",
        "FD",
        "AS=3",
        "MU=1",
        "CM=1",
        "S7=50,0",
        "S8=50,0",
        "S13=61,0",
        "JE=1",
        "DE=0",
        "DE=1",
        "LM=3",
        "\x03",
        "\x1b",
        " ",
        "\x08\x08X",
    ]);
    let end = proptest::sample::select(vec!["\r", "\r\n", "\n", ""]);
    prop_oneof![
        20 => (line, end).prop_map(|(line, end)| format!("{line}{end}").into_bytes()),
        1 => proptest::collection::vec(any::<u8>(), 1..80),
    ]
}

/// Events at a serial port.
fn on_line() -> impl Strategy<Value = Event> {
    prop_oneof![
        24 => bytes().prop_map(Event::Bytes),
        2 => Just(Event::RxError),
        2 => Just(Event::Idle),
        1 => any::<bool>().prop_map(Event::HostPresence),
    ]
}

/// Events at TCP ports.
fn on_network() -> impl Strategy<Value = Event> {
    let ends = || proptest::sample::select(vec![Framing::Mbap, Framing::Return]);
    prop_oneof![
        1 => (ends(), 0_u8..6).prop_map(|(ends, link)| Event::Opened(ends, link)),
        8 => (0_u8..6, adu()).prop_map(|(link, adu)| Event::Message(Framing::Mbap, link, adu)),
        12 => (0_u8..6, typed()).prop_map(|(link, line)| Event::Message(Framing::Return, link, line)),
        1 => (ends(), 0_u8..6).prop_map(|(ends, link)| Event::Closed(ends, link)),
    ]
}

/// Events at pins, and faults.
fn elsewhere() -> impl Strategy<Value = Event> {
    prop_oneof![
        12 => (0_u8..16, any::<bool>()).prop_map(|(pin, high)| Event::Edge(pin, high)),
        4 => (0_u8..16, prop_oneof![0..6_000, any::<i32>()]).prop_map(|(pin, mv)| Event::Millivolts(pin, mv)),
        2 => (0_u8..2, prop_oneof![-9..9, any::<i32>()], any::<bool>(), any::<bool>())
            .prop_map(|(encoder, steps, a, b)| Event::Count(encoder, steps, a, b)),
        4 => (0_u8..16, any::<bool>()).prop_map(|(fault, on)| Event::Fault(fault, on)),
    ]
}

/// Silences, in ticks, from less than a character to longer than every delay.
fn gap() -> impl Strategy<Value = u64> {
    prop_oneof![0_u64..100_000, 0_u64..3_000_000, 0_u64..100_000_000]
}

/// Presets, and events with the silences before them.
#[derive(Clone, Debug)]
struct Script {
    presets: Vec<(usize, i64)>,
    /// Events of a drive with a serial port.
    on_line: Vec<(u64, Event)>,
    /// Events of a drive on a network.
    on_network: Vec<(u64, Event)>,
    fast: bool,
}

fn script() -> impl Strategy<Value = Script> {
    (presets(), events_on_line(), events_on_network(), any::<bool>())
        .prop_map(|(presets, on_line, on_network, fast)| Script { presets, on_line, on_network, fast })
}

fn events_on_line() -> impl Strategy<Value = Vec<(u64, Event)>> {
    // Silence in ticks between the requests that load a program, long enough for each drive.
    const SILENCE: u64 = 40_000;
    let loads = (any::<bool>(), program()).prop_map(|(ascii, requests)| {
        requests.iter().map(|pdu| (SILENCE, Event::Bytes(framed(ascii, 1, pdu)))).collect()
    });
    let event = prop_oneof![3 => on_line(), 2 => elsewhere()];
    let happens = prop_oneof![12 => (gap(), event).prop_map(|event| vec![event]), 1 => loads];
    proptest::collection::vec(happens, 0..40).prop_map(|events| events.concat())
}

fn events_on_network() -> impl Strategy<Value = Vec<(u64, Event)>> {
    let event = prop_oneof![1 => on_network(), 1 => elsewhere()];
    proptest::collection::vec((gap(), event), 0..40)
}

/// More rows than the register table of any drive has.
const ROWS: usize = 160;

/// Values to preset, with the rows of their registers.
fn presets() -> impl Strategy<Value = Vec<(usize, i64)>> {
    proptest::collection::vec((0_usize..ROWS, prop_oneof![0_i64..20, any::<i64>()]), 0..12)
}

/// The longest silence within a script and after it.
fn longest(drive: &dyn Device) -> Duration {
    match drive.spec().kind {
        "md3" | "md3-low" => Duration::secs(10),
        // A program may run without end. In less than 5 s no drive is reset to the factory settings, which
        // would make it use RTU again (section 7).
        "rs434544" | "rs434546" => Duration::millis(50),
        // The drive may stream without a pause.
        _ => Duration::millis(100),
    }
}

/// Runs a script on a new drive and returns its outputs. The drive is advanced before each event for which
/// `eager` is true. Bursts are split into pieces of `piece` characters.
fn run(
    subject: Subject,
    Script { presets, on_line, on_network, fast }: &Script,
    eager: &[bool],
    piece: usize,
) -> Vec<String> {
    let mut drive = (subject.make)();
    let spec = drive.spec();
    let mut log = Transcript::new(spec.memory.into()).without_notes();
    let port = spec.ports.first().expect("every drive here has a port");
    let silence = port.framing == Framing::Silence;
    let longest = longest(&*drive);
    let events = if spec.is_on_network() { on_network } else { on_line };
    // A drive without such a port gets the number of a port that it does not have.
    let tcp = |ends| {
        Port(spec.ports.iter().position(|port| port.framing == ends).unwrap_or(spec.ports.len()) as u8)
    };
    // If a drive judges silence, presets could change its line settings, so there are none.
    let (piece, presets) = if silence { (piece, [].as_slice()) } else { (1, presets.as_slice()) };
    if let Some((name, value)) = subject.saved {
        let named = spec.find(name).expect("a register");
        drive.poke(Instant::ZERO, named.row, value, &mut log).expect("taken");
    }
    for powered in [false, true] {
        for &(row, value) in presets {
            let _ = drive.poke(Instant::ZERO, row, value, &mut log);
        }
        if !powered {
            drive.power_on(Instant::ZERO, Boot { seed: 1, fast: *fast, ..Boot::default() }, &mut log);
        }
    }
    if silence {
        // The drive may read its pins before it sets its line.
        advance(&mut *drive, Instant::ZERO, core::iter::empty(), &mut log);
    }
    let said = log.line.filter(|_| silence);
    let line = said.or(port.line).unwrap_or(Line::new(115_200, 8, Parity::None, 1));
    assert_eq!(ascii::is_on(line), subject.saved.is_some());
    let mut at = Instant::ZERO;
    let mut inputs: Vec<(Instant, Event)> = Vec::new();
    for (gap, event) in events {
        at += Duration::from_ticks(*gap % longest.ticks()) + line.character();
        match event {
            Event::Bytes(bytes) => {
                // In ASCII a burst ends with a line feed.
                let bursts = bytes.split_inclusive(|&byte| ascii::is_on(line) && byte == b'\n');
                for bytes in bursts.flat_map(|burst| burst.chunks(piece)) {
                    inputs.push((at, Event::Bytes(bytes.to_vec())));
                    at += line.character() * bytes.len() as u64;
                }
            }
            Event::Message(Framing::Return, link, bytes) => {
                let mut rest = bytes.as_slice();
                while let Some(line) = next_line(&mut rest) {
                    inputs.push((at, Event::Message(Framing::Return, *link, line.to_vec())));
                }
            }
            event => inputs.push((at, event.clone())),
        }
    }
    for (index, (at, _)) in inputs.iter().enumerate() {
        if eager.get(index % eager.len().max(1)).copied().unwrap_or(false) {
            advance(&mut *drive, *at - Duration::TICK, core::iter::empty(), &mut log);
        }
        let (at, event) = &inputs[index];
        let input = match event {
            Event::Bytes(bytes) => Input::Bytes { port: Port(0), bytes },
            Event::RxError => Input::RxError { port: Port(0) },
            Event::Idle => Input::Idle { port: Port(0) },
            Event::HostPresence(here) => Input::HostPresence { port: Port(0), here: *here },
            Event::Edge(pin, high) => Input::Edge { pin: Pin(*pin), high: *high },
            Event::Millivolts(pin, mv) => Input::Millivolts { pin: Pin(*pin), mv: *mv },
            Event::Count(encoder, steps, a, b) => {
                Input::Count { encoder: Encoder(*encoder), steps: *steps, a: *a, b: *b }
            }
            Event::Fault(fault, on) => Input::Fault { fault: Fault(*fault), on: *on },
            Event::Opened(ends, link) => Input::Opened { port: tcp(*ends), link: Link(*link) },
            Event::Message(ends, link, bytes) => {
                Input::Message { port: tcp(*ends), link: Link(*link), bytes }
            }
            Event::Closed(ends, link) => Input::Closed { port: tcp(*ends), link: Link(*link) },
        };
        let due = drive.deadline();
        drivetwin_firmware::device::feed(&mut *drive, due, *at, input, &mut log);
    }
    advance(&mut *drive, at + longest, core::iter::empty(), &mut log);
    log.outputs
}

/// More bytes than the memory of any drive has.
const MEMORY: usize = 20_000;

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, ..ProptestConfig::default() })]

    #[test]
    fn late_polling_and_split_bursts_change_nothing(
        script in script(),
        eager in proptest::collection::vec(any::<bool>(), 1..20), piece in 1_usize..20,
    ) {
        for subject in subjects() {
            let whole = run(subject, &script, &[false], usize::MAX);
            prop_assert_eq!(&whole, &run(subject, &script, &eager, usize::MAX));
            prop_assert_eq!(&whole, &run(subject, &script, &[true], piece));
            prop_assert_eq!(&whole, &run(subject, &script, &[false], 1));
        }
    }

    #[test]
    fn any_preset_is_taken_or_refused(row in 0_usize..ROWS, value in any::<i64>(), fast in any::<bool>()) {
        for make in DRIVES {
            let mut drive = make();
            let rows = drive.spec().registers.rows;
            let mut log = Transcript::new(drive.spec().memory.into()).without_notes();
            for powered in [false, true] {
                let taken = drive.poke(Instant::ZERO, row, value, &mut log).is_ok();
                if let Some(row) = rows.get(row) {
                    prop_assert!(!taken || row.accepts(value) || drive.spec().kind == "toy");
                }
                if !powered {
                    drive.power_on(Instant::ZERO, Boot { seed: 1, fast, ..Boot::default() }, &mut log);
                }
            }
            advance(&mut *drive, Instant::ZERO + Duration::secs(30), core::iter::empty(), &mut log);
        }
    }

    #[test]
    fn any_memory_boots(memory in proptest::collection::vec(any::<u8>(), 0..MEMORY)) {
        for make in DRIVES {
            let mut drive = make();
            let mut kept = memory.clone();
            kept.resize(usize::from(drive.spec().memory), 0xFF);
            let mut log = Transcript::with_memory(kept.clone()).without_notes();
            drive.power_on(Instant::ZERO, Boot { seed: 1, fast: false, ..Boot::default() }, &mut log);
            advance(&mut *drive, Instant::ZERO + Duration::secs(30), core::iter::empty(), &mut log);
            prop_assert_eq!(&log.memory, &kept, "nothing is stored without a save");
        }
    }

    #[test]
    fn any_saved_values_and_any_program_boot(
        words in proptest::collection::vec(prop_oneof![0_u16..12, any::<u16>()], ROWS),
        lines in proptest::collection::vec(instruction(), 0..40), fast in any::<bool>(),
    ) {
        for make in DRIVES {
            let mut drive = make();
            let spec = drive.spec();
            let saved: u16 = spec.registers.rows.iter().map(|row| if row.saved == 0 { 0 } else { row.shape.words() }).sum();
            let (settings, rest) = usize::from(spec.memory).checked_sub(2 * usize::from(saved) + 2)
                .map_or((0, usize::from(spec.memory)), |rest| (2 * usize::from(saved), rest));
            let mut memory: Vec<u8> = words.iter().cycle().flat_map(|word| word.to_be_bytes()).take(settings).collect();
            memory.extend(rtu::crc(&memory).to_be_bytes());
            if rest > 2 {
                let lines = lines.iter().flatten().flat_map(|half| half.to_le_bytes());
                let program: Vec<u8> = lines.chain(core::iter::repeat(0)).take(rest - 2).collect();
                memory.extend(&program);
                memory.extend(rtu::crc(&program).to_be_bytes());
            }
            memory.truncate(usize::from(spec.memory));
            let mut log = Transcript::with_memory(memory).without_notes();
            drive.power_on(Instant::ZERO, Boot { seed: 1, fast, ..Boot::default() }, &mut log);
            advance(&mut *drive, Instant::ZERO + Duration::secs(2), core::iter::empty(), &mut log);
        }
    }
}

#[test]
fn every_drive_names_what_its_spec_points_to() {
    assert!(DRIVES.len() > 1, "the list of drives is empty");
    for make in DRIVES {
        let drive = make();
        let spec = drive.spec();
        let pins = spec.pins.len();
        let exists = |pin: Pin| usize::from(pin.0) < pins;
        assert!(
            spec.axes.iter().filter_map(|axis| axis.step_dir).all(|(step, dir)| exists(step) && exists(dir))
        );
        assert!(spec.encoders.iter().all(|e| exists(e.a) && exists(e.b) && e.index.is_none_or(exists)));
        assert!(spec.address.is_none_or(|row| row < spec.registers.rows.len()));
        // A board finds pins and faults only by their names, so names must be unique.
        let ends = spec.pins.iter().map(|pin| pin.name).chain(spec.faults.iter().copied());
        assert_eq!(twice(ends), None, "{}", spec.kind);
        assert_eq!(twice(spec.registers.rows.iter().map(|row| row.name)), None, "{}", spec.kind);
        // The tests above cover at most this many rows and bytes.
        assert!(spec.registers.rows.len() < ROWS, "{}", spec.kind);
        assert!(usize::from(spec.memory) < MEMORY, "{}", spec.kind);
    }
}

/// The first name that occurs twice.
fn twice(names: impl Iterator<Item = &'static str>) -> Option<&'static str> {
    let mut seen = std::collections::BTreeSet::new();
    names.into_iter().find(|name| !seen.insert(*name))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 3, ..ProptestConfig::default() })]

    #[test]
    fn a_property_says_each_of_its_cases(_ in any::<bool>()) {
        println!("a case");
    }
}

/// `cargo xtask soak` sets PROPTEST_CASES, which must replace the number of cases that a test gives.
#[test]
fn proptest_cases_replaces_the_number_of_a_test() {
    let run = |cases: &str| {
        let mut test = Command::new(std::env::current_exe().expect("this program"));
        test.args(["--exact", "a_property_says_each_of_its_cases", "--nocapture"]);
        let output = test.env("PROPTEST_CASES", cases).output().expect("this program runs");
        String::from_utf8_lossy(&output.stdout).matches("a case").count()
    };
    assert_eq!([run("1"), run("7")], [1, 7]);
}
