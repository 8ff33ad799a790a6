//! What holds for every drive, whatever happens to it: being called late changes nothing, splitting
//! a burst of characters changes nothing, and no input stops it.
#![allow(missing_docs, reason = "a test")]

use proptest::prelude::*;
use standin_firmware::device::{
    Boot, Device, Duration, Ends, Fault, Input, Instant, Output, Pin, Port, Sink, advance,
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
    Edge(u8, bool),
    Fault(u8, bool),
}

/// Makes a drive without power.
type Make = fn() -> Box<dyn Device>;

macro_rules! boxed {
    ($($new:expr,)*) => { &[$(|| Box::new($new()),)* || Box::new(Toy::default())] };
}

static DRIVES: &[Make] = standin_firmware::devices!(boxed);

/// Requests, mostly good ones, and noise. The line stays as it is (MD3 0x1c): a script has to know how
/// long its characters last.
fn bytes() -> impl Strategy<Value = Vec<u8>> {
    let address = (0_u16..0x22).prop_filter("changes the line", |address| *address != 0x1c);
    let request = (0_u8..3, address, any::<u16>());
    prop_oneof![
        request.clone().prop_map(|(unit, address, value)| rtu::write(unit, address, value).to_vec()),
        request.prop_map(|(unit, address, count)| rtu::read(unit, address, count % 40).to_vec()),
        (0_u16..32).prop_map(|bits| rtu::write(1, at::MOTION, bits).to_vec()),
        (0_u16..4).prop_map(|bits| rtu::write(1, at::EEPROM, bits).to_vec()),
        proptest::collection::vec(any::<u8>(), 1..300),
        proptest::collection::vec(prop_oneof![Just(b'0'), Just(b'1')], 1..4),
    ]
}

fn event() -> impl Strategy<Value = Event> {
    prop_oneof![
        6 => bytes().prop_map(Event::Bytes),
        1 => Just(Event::Spoiled),
        1 => Just(Event::Idle),
        1 => (any::<u8>(), any::<bool>()).prop_map(|(pin, high)| Event::Edge(pin, high)),
        1 => (any::<u8>(), any::<bool>()).prop_map(|(fault, on)| Event::Fault(fault, on)),
    ]
}

/// Silences from inside a character to beyond every delay, in ticks.
fn gap() -> impl Strategy<Value = u64> {
    prop_oneof![0_u64..100_000, 0_u64..3_000_000, 0_u64..100_000_000]
}

/// Events with the silences before them.
fn script() -> impl Strategy<Value = Vec<(u64, Event)>> {
    proptest::collection::vec((gap(), event()), 0..40)
}

/// Runs a script on a new drive and returns what it did. A drive is brought up to date before each
/// event if `eager` says so for it; bursts are cut into pieces of `piece` characters.
fn run(make: Make, script: &[(u64, Event)], fast: bool, eager: &[bool], piece: usize) -> Vec<String> {
    let mut drive = make();
    let spec = drive.spec();
    let mut log = Log { memory: vec![0xFF; usize::from(spec.memory)], lines: Vec::new() };
    let port = spec.ports.first().expect("every drive here has a port");
    let line = port.line.expect("and it is a serial one");
    let piece = if port.ends == Ends::Silence { piece } else { 1 };
    drive.power_on(Instant::ZERO, Boot { seed: 1, fast }, &mut log);
    let mut at = Instant::ZERO;
    let mut inputs: Vec<(Instant, Event)> = Vec::new();
    for (gap, event) in script {
        at += Duration::from_ticks(*gap) + line.character();
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
            Event::Edge(pin, high) => Input::Edge { pin: Pin(*pin), high: *high },
            Event::Fault(fault, on) => Input::Fault { fault: Fault(*fault), on: *on },
        };
        let due = drive.deadline();
        standin_firmware::device::feed(&mut *drive, due, *at, input, &mut log);
    }
    advance(&mut *drive, at + Duration::secs(10), core::iter::empty(), &mut log);
    log.lines
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 128, ..ProptestConfig::default() })]

    #[test]
    fn late_polling_and_split_bursts_change_nothing(
        script in script(), fast in any::<bool>(),
        eager in proptest::collection::vec(any::<bool>(), 1..20), piece in 1_usize..20,
    ) {
        for make in DRIVES {
            let whole = run(*make, &script, fast, &[false], usize::MAX);
            prop_assert_eq!(&whole, &run(*make, &script, fast, &eager, usize::MAX));
            prop_assert_eq!(&whole, &run(*make, &script, fast, &[true], piece));
            prop_assert_eq!(&whole, &run(*make, &script, fast, &[false], 1));
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
