//! What holds for every drive, whatever happens to it: being called late changes nothing, splitting
//! a burst of characters changes nothing, and no input stops it.
#![allow(missing_docs, reason = "a test")]

use proptest::prelude::*;
use standin_firmware::device::{
    Boot, Device, Duration, Encoder, Ends, Fault, Input, Instant, Output, Pin, Port, Sink, advance,
};
use standin_protocol::modbus::rtu;
use standin_tests::md3::at;
use standin_tests::toy::Toy;

/// Everything a drive puts, as text.
struct Log {
    memory: Vec<u8>,
    lines: Vec<String>,
}

impl Sink for Log {
    fn put(&mut self, at: Instant, output: Output<'_>) {
        if let Output::Store { offset, bytes } = output {
            let place = usize::from(offset);
            self.memory[place..place + bytes.len()].copy_from_slice(bytes);
        }
        // Notes count what was ignored; how often a deaf drive is spoken to depends on the pieces.
        if !matches!(output, Output::Note(_)) {
            self.lines.push(format!("{} {output:?}", at.ticks()));
        }
    }

    fn memory(&self) -> &[u8] {
        &self.memory
    }
}

/// Something that happens to a drive.
#[derive(Clone, Debug)]
enum Event {
    Bytes(Vec<u8>),
    Spoiled,
    Idle,
    Attached(bool),
    Edge(u8, bool),
    Millivolts(u8, i32),
    Count(u8, i32, bool, bool),
    Fault(u8, bool),
}

/// Makes a drive without power.
type Make = fn() -> Box<dyn Device>;

macro_rules! boxed {
    ($($new:expr,)*) => { &[$(|| Box::new($new()),)* || Box::new(Toy::default())] };
}

static DRIVES: &[Make] = standin_firmware::devices!(boxed);

/// A command of a QSB: good, with any number of digits, half, taken back, or not meant for it.
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

/// Commands of a QSB that set something going, whatever half a line is there.
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

/// Requests, mostly good ones, and noise. The line of a drive that judges silence stays as it is (MD3
/// 0x1c): a script has to know how long its characters last.
fn bytes() -> impl Strategy<Value = Vec<u8>> {
    let address = (0_u16..0x22).prop_filter("changes the line", |address| *address != 0x1c);
    let request = (0_u8..3, address, any::<u16>());
    prop_oneof![
        4 => request.clone().prop_map(|(unit, address, value)| rtu::write(unit, address, value).to_vec()),
        4 => request.prop_map(|(unit, address, count)| rtu::read(unit, address, count % 40).to_vec()),
        4 => (0_u16..32).prop_map(|bits| rtu::write(1, at::MOTION, bits).to_vec()),
        2 => (0_u16..4).prop_map(|bits| rtu::write(1, at::EEPROM, bits).to_vec()),
        1 => proptest::collection::vec(any::<u8>(), 1..300),
        1 => proptest::collection::vec(prop_oneof![Just(b'0'), Just(b'1')], 1..4),
        3 => command(),
        9 => order(),
    ]
}

fn event() -> impl Strategy<Value = Event> {
    prop_oneof![
        24 => bytes().prop_map(Event::Bytes),
        2 => Just(Event::Spoiled),
        2 => Just(Event::Idle),
        1 => any::<bool>().prop_map(Event::Attached),
        12 => (0_u8..16, any::<bool>()).prop_map(|(pin, high)| Event::Edge(pin, high)),
        4 => (0_u8..16, prop_oneof![0..6_000, any::<i32>()]).prop_map(|(pin, mv)| Event::Millivolts(pin, mv)),
        2 => (0_u8..2, prop_oneof![-9..9, any::<i32>()], any::<bool>(), any::<bool>())
            .prop_map(|(encoder, steps, a, b)| Event::Count(encoder, steps, a, b)),
        4 => (0_u8..16, any::<bool>()).prop_map(|(fault, on)| Event::Fault(fault, on)),
    ]
}

/// Silences from inside a character to beyond every delay, in ticks.
fn gap() -> impl Strategy<Value = u64> {
    prop_oneof![0_u64..100_000, 0_u64..3_000_000, 0_u64..100_000_000]
}

/// What is preset, and events with the silences before them.
#[derive(Clone, Debug)]
struct Script {
    presets: Vec<(usize, i64)>,
    events: Vec<(u64, Event)>,
    fast: bool,
}

fn script() -> impl Strategy<Value = Script> {
    let events = proptest::collection::vec((gap(), event()), 0..40);
    (presets(), events, any::<bool>()).prop_map(|(presets, events, fast)| Script { presets, events, fast })
}

/// Values of registers, by their rows.
fn presets() -> impl Strategy<Value = Vec<(usize, i64)>> {
    proptest::collection::vec((0_usize..40, prop_oneof![0_i64..20, any::<i64>()]), 0..12)
}

/// The longest silence in a script of a drive that may stream without a pause, and behind it.
const NOT_LONG: Duration = Duration::millis(100);

/// Runs a script on a new drive and returns what it did. A drive is brought up to date before each
/// event if `eager` says so for it; bursts are cut into pieces of `piece` characters.
fn run(make: Make, Script { presets, events, fast }: &Script, eager: &[bool], piece: usize) -> Vec<String> {
    let mut drive = make();
    let spec = drive.spec();
    let mut log = Log { memory: vec![0xFF; usize::from(spec.memory)], lines: Vec::new() };
    let port = spec.ports.first().expect("every drive here has a port");
    let line = port.line.expect("and it is a serial one");
    let silence = port.ends == Ends::Silence;
    let (piece, presets, longest) = if silence {
        // The line is one of those that could be preset.
        (piece, [].as_slice(), Duration::secs(10))
    } else {
        (1, presets.as_slice(), NOT_LONG)
    };
    for powered in [false, true] {
        for &(row, value) in presets {
            let _ = drive.poke(Instant::ZERO, row, value, &mut log);
        }
        if !powered {
            drive.power_on(Instant::ZERO, Boot { seed: 1, fast: *fast }, &mut log);
        }
    }
    let mut at = Instant::ZERO;
    let mut inputs: Vec<(Instant, Event)> = Vec::new();
    for (gap, event) in events {
        at += Duration::from_ticks(*gap % longest.ticks()) + line.character();
        match event {
            Event::Bytes(bytes) => {
                for bytes in bytes.chunks(piece) {
                    inputs.push((at, Event::Bytes(bytes.to_vec())));
                    at += line.character() * bytes.len() as u64;
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
            Event::Spoiled => Input::Spoiled { port: Port(0) },
            Event::Idle => Input::Idle { port: Port(0) },
            Event::Attached(here) => Input::Attached { port: Port(0), here: *here },
            Event::Edge(pin, high) => Input::Edge { pin: Pin(*pin), high: *high },
            Event::Millivolts(pin, mv) => Input::Millivolts { pin: Pin(*pin), mv: *mv },
            Event::Count(encoder, steps, a, b) => {
                Input::Count { encoder: Encoder(*encoder), steps: *steps, a: *a, b: *b }
            }
            Event::Fault(fault, on) => Input::Fault { fault: Fault(*fault), on: *on },
        };
        let due = drive.deadline();
        standin_firmware::device::feed(&mut *drive, due, *at, input, &mut log);
    }
    advance(&mut *drive, at + longest, core::iter::empty(), &mut log);
    log.lines
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, ..ProptestConfig::default() })]

    #[test]
    fn late_polling_and_split_bursts_change_nothing(
        script in script(),
        eager in proptest::collection::vec(any::<bool>(), 1..20), piece in 1_usize..20,
    ) {
        for make in DRIVES {
            let whole = run(*make, &script, &[false], usize::MAX);
            prop_assert_eq!(&whole, &run(*make, &script, &eager, usize::MAX));
            prop_assert_eq!(&whole, &run(*make, &script, &[true], piece));
            prop_assert_eq!(&whole, &run(*make, &script, &[false], 1));
        }
    }

    #[test]
    fn any_preset_is_taken_or_refused(row in 0_usize..40, value in any::<i64>(), fast in any::<bool>()) {
        for make in DRIVES {
            let mut drive = make();
            let rows = drive.spec().registers.rows;
            let mut log = Log { memory: vec![0xFF; usize::from(drive.spec().memory)], lines: Vec::new() };
            for powered in [false, true] {
                let taken = drive.poke(Instant::ZERO, row, value, &mut log).is_ok();
                if let Some(row) = rows.get(row) {
                    prop_assert!(!taken || row.accepts(value) || drive.spec().kind == "toy");
                }
                if !powered {
                    drive.power_on(Instant::ZERO, Boot { seed: 1, fast }, &mut log);
                }
            }
            advance(&mut *drive, Instant::ZERO + Duration::secs(30), core::iter::empty(), &mut log);
        }
    }

    #[test]
    fn any_memory_boots(memory in proptest::collection::vec(any::<u8>(), 0..100)) {
        for make in DRIVES {
            let mut drive = make();
            let mut kept = memory.clone();
            kept.resize(usize::from(drive.spec().memory), 0xFF);
            let mut log = Log { memory: kept.clone(), lines: Vec::new() };
            drive.power_on(Instant::ZERO, Boot { seed: 1, fast: false }, &mut log);
            advance(&mut *drive, Instant::ZERO + Duration::secs(30), core::iter::empty(), &mut log);
            prop_assert_eq!(&log.memory, &kept, "nothing is stored without a save");
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
        assert!(spec.encoders.iter().all(|e| exists(e.a) && exists(e.b) && exists(e.index)));
        assert!(spec.address.is_none_or(|row| row < spec.registers.rows.len()));
        let mut names: Vec<_> = spec.pins.iter().map(|pin| pin.name).collect();
        names.extend(spec.registers.rows.iter().map(|row| row.name));
        let count = names.len();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), count, "{}: two things have one name", spec.kind);
    }
}
