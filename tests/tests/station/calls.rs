//! Every call, and its refusals.

use drivetwin_control::{
    Answer, Call, Hello, Level, Power, Refused, State, Statistics, Stimulus, VERSION, fingerprint,
};
use drivetwin_firmware::device::{Duration, Instant, Spec};
use drivetwin_firmware::shell::BoardEvent;
use drivetwin_tests::at_cable::Rig;

/// A kind of each family of drives with a serial port.
pub(crate) const FAMILIES: [&str; 4] = ["md3", "qsb-m", "rs434544", "mdrobot"];

pub(crate) fn state(rig: &mut Rig) -> State {
    match rig.call(Call::State) {
        Ok(Answer::State(state)) => state,
        other => panic!("{other:?}"),
    }
}

pub(crate) fn row(spec: &Spec, name: &str) -> u16 {
    spec.find(name).unwrap_or_else(|| panic!("no {name}")).row as u16
}

pub(crate) fn pin(spec: &Spec, name: &str) -> u8 {
    spec.pin(name).unwrap_or_else(|| panic!("no {name}")).0
}

pub(crate) fn read(rig: &mut Rig, name: &str) -> i64 {
    let row = row(rig.spec(), name);
    match rig.call(Call::Read { row }) {
        Ok(Answer::Value(value)) => value,
        other => panic!("{name}: {other:?}"),
    }
}

fn statistics(rig: &mut Rig) -> Statistics {
    match rig.call(Call::Statistics) {
        Ok(Answer::Statistics(statistics)) => statistics,
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_board_says_what_it_is() {
    for kind in FAMILIES {
        let mut rig = Rig::new(kind, true);
        let hello = Hello {
            version: VERSION,
            kind,
            image: env!("CARGO_PKG_VERSION"),
            tables: fingerprint(rig.spec()),
            fast_boot: true,
            board: "memory",
        };
        assert_eq!(rig.call(Call::Hello), Ok(Answer::Hello(hello)));
        assert_eq!(rig.call(Call::Kind(0)), Ok(Answer::Kind(None)));
        for call in [Call::Become("md3"), Call::Bootloader] {
            assert_eq!(rig.call(call), Err(Refused::NotHere), "{call:?}");
        }
    }
}

#[test]
fn all_registers_are_read_one_by_one_and_many_at_once() {
    for kind in FAMILIES {
        let mut rig = Rig::new(kind, true);
        rig.run_for(Duration::secs(3));
        let rows = rig.spec().registers.rows.len() as u16;
        let (mut row, mut many) = (0, Vec::new());
        loop {
            let Ok(Answer::Values { row: first, count, mut bytes }) = rig.call(Call::ReadMany { row }) else {
                panic!("{kind}: no values")
            };
            assert_eq!(first, row);
            for _ in 0..count {
                let (value, rest) = postcard::take_from_bytes::<i64>(bytes).expect("a number");
                (bytes, many) = (rest, [many, vec![value]].concat());
            }
            assert_eq!(bytes, [0; 0]);
            if count == 0 {
                break;
            }
            row += u16::from(count);
        }
        assert_eq!(many.len(), usize::from(rows), "{kind}");
        let own: Vec<usize> = rig.spec().rows().map(|(row, _)| row).collect();
        let mut equal = 0;
        for row in 0..rows {
            match rig.call(Call::Read { row }) {
                Ok(Answer::Value(value)) => {
                    assert!(own.contains(&row.into()));
                    equal += usize::from(value == many[usize::from(row)]);
                }
                other => assert!(!own.contains(&row.into()) && other == Err(Refused::Unknown), "{other:?}"),
            }
        }
        // A counter of time, or a random number, may have changed meanwhile.
        assert!(equal + 4 >= own.len(), "{kind}: {equal} of {}", own.len());
        assert_eq!(rig.call(Call::Read { row: rows }), Err(Refused::Unknown));
    }
}

#[test]
fn a_long_register_is_read_in_pieces() {
    let mut rig = Rig::new("mdrobot", true);
    let spec = rig.spec();
    let long = spec.rows().find(|(row, _)| spec.registers.list[*row].shape.words() > 4);
    let (row, _) = long.expect("a register of many words");
    let words = spec.registers.list[row].shape.words();
    let row = row as u16;
    let Ok(Answer::Words(bytes)) = rig.call(Call::ReadWords { row, word: 0 }) else { panic!("no words") };
    assert_eq!(bytes.len(), usize::from(words.min(96)) * 2);
    let Ok(Answer::Words(rest)) = rig.call(Call::ReadWords { row, word: 1 }) else { panic!("no words") };
    assert_eq!(rest, &bytes[2..]);
    assert_eq!(rig.call(Call::ReadWords { row, word: words }), Ok(Answer::Words(&[])));
    assert_eq!(rig.call(Call::ReadWords { row: u16::MAX, word: 0 }), Err(Refused::Unknown));
    let mut rig = Rig::new("md3", true);
    assert_eq!(rig.call(Call::ReadWords { row: 0, word: 0 }), Err(Refused::OutOfRange));
}

#[test]
fn a_register_is_preset_like_a_write_by_the_bus() {
    // A row that takes a value, another value, one that it refuses, and a row that cannot be preset.
    let rows = [
        ("md3", "AccelDecel", 5_000, 1 << 40, None),
        ("qsb-m", "Mdr0", 2, 1 << 40, Some("MotorDrive")),
        ("rs434544", "SPEED", 1_000, 1 << 40, None),
        ("mdrobot", "PID_MAX_RPM", 700, 1 << 40, None),
    ];
    for (kind, name, value, wrong, fixed) in rows {
        let mut rig = Rig::new(kind, true);
        rig.run_for(Duration::secs(1));
        let spec = rig.spec();
        let name = spec.rows().map(|(_, row)| row.name).find(|own| own.ends_with(name)).unwrap_or(name);
        let row = row(spec, name);
        assert_eq!(rig.call(Call::Preset { row, value }), Ok(Answer::Done), "{kind}");
        assert_eq!(read(&mut rig, name), value, "{kind}");
        assert_eq!(rig.call(Call::Preset { row, value: wrong }), Err(Refused::OutOfRange), "{kind}");
        assert_eq!(rig.call(Call::Preset { row: u16::MAX, value: 0 }), Err(Refused::Unknown));
        if let Some(fixed) = fixed {
            let row = self::row(spec, fixed);
            assert_eq!(rig.call(Call::Preset { row, value: 0 }), Err(Refused::ReadOnly), "{kind}");
        }
    }
}

#[test]
fn a_stimulus_hides_the_wire_until_it_ends() {
    let mut rig = Rig::new("md3", true);
    rig.run_for(Duration::millis(10));
    let input = pin(rig.spec(), "J2.2");
    let edge = |high| BoardEvent::Edge(drivetwin_firmware::device::Pin(input), high);
    assert_eq!(state(&mut rig).level(input), Level::High);
    assert_eq!(rig.call(Call::Trace(true)), Ok(Answer::Done));
    rig.call(Call::Drive { pin: input, stimulus: Stimulus::Low }).expect("done");
    let driven = state(&mut rig);
    assert_eq!((driven.level(input), driven.driven), (Level::Low, 1 << input));
    // The wire changes to low, to high, and to low again; the drive sees none of it.
    for high in [false, true, false] {
        rig.catch(edge(high));
    }
    rig.run_for(Duration::millis(1));
    rig.call(Call::Drive { pin: input, stimulus: Stimulus::High }).expect("done");
    rig.call(Call::Drive { pin: input, stimulus: Stimulus::Wire }).expect("done");
    let wired = state(&mut rig);
    assert_eq!((wired.level(input), wired.driven), (Level::Low, 0));
    rig.catch(edge(true));
    rig.run_for(Duration::millis(1));
    let events = rig.events();
    let edges = events.iter().flat_map(|events| events.decode()).filter_map(|(_, event)| match event {
        drivetwin_control::Event::Edge(pin, high) if pin == input => Some(high),
        _ => None,
    });
    assert_eq!(edges.collect::<Vec<_>>(), [false, true, false, true]);
}

#[test]
fn an_input_that_knows_open_contacts_is_open_again_without_a_wire() {
    let mut rig = Rig::new("mdrobot", true);
    let input = pin(rig.spec(), "RUN_BRAKE");
    let drive = |rig: &mut Rig, stimulus| {
        rig.call(Call::Drive { pin: input, stimulus }).expect("done");
        state(rig).level(input)
    };
    assert_eq!(state(&mut rig).level(input), Level::Open);
    assert_eq!(drive(&mut rig, Stimulus::Low), Level::Low);
    assert_eq!(drive(&mut rig, Stimulus::Open), Level::Open);
    assert_eq!(drive(&mut rig, Stimulus::Wire), Level::Open);
    // A wire that has been low is there. Its open contact is high.
    for high in [false, true] {
        rig.catch(BoardEvent::Edge(drivetwin_firmware::device::Pin(input), high));
    }
    rig.run_for(Duration::millis(1));
    assert_eq!(state(&mut rig).level(input), Level::High);
    assert_eq!(drive(&mut rig, Stimulus::Low), Level::Low);
    assert_eq!(drive(&mut rig, Stimulus::Wire), Level::High);
}

#[test]
fn pins_take_what_they_can() {
    let mut rig = Rig::new("md3", true);
    let (output, light, input) = (pin(rig.spec(), "J3.7"), pin(rig.spec(), "D5"), pin(rig.spec(), "J2.2"));
    for pin in [output, light] {
        assert_eq!(rig.call(Call::Drive { pin, stimulus: Stimulus::Low }), Err(Refused::OutOfRange));
        assert_eq!(
            rig.call(Call::Pulse { pin, count: 1, period: 16_000, high: 1 }),
            Err(Refused::OutOfRange)
        );
    }
    let volts = Stimulus::Millivolts(5_000);
    assert_eq!(rig.call(Call::Drive { pin: input, stimulus: volts }), Err(Refused::OutOfRange));
    assert_eq!(rig.call(Call::Drive { pin: 63, stimulus: Stimulus::Low }), Err(Refused::Unknown));
    assert_eq!(rig.call(Call::Fault { fault: 31, on: true }), Err(Refused::Unknown));
    assert_eq!(rig.call(Call::Turn { encoder: 7, counts: 1, period: 16_000 }), Err(Refused::Unknown));
    let mut rig = Rig::new("mdrobot", true);
    let analogue = pin(rig.spec(), "SPEED_IN");
    assert_eq!(rig.call(Call::Drive { pin: analogue, stimulus: volts }), Ok(Answer::Done));
    assert_eq!(rig.call(Call::Drive { pin: analogue, stimulus: Stimulus::Low }), Ok(Answer::Done));
}

#[test]
fn faults_are_those_of_the_calls_and_of_the_wires() {
    for kind in ["md3", "rs434544", "mdrobot"] {
        let mut rig = Rig::new(kind, true);
        rig.run_for(Duration::millis(10));
        assert_eq!(rig.call(Call::Fault { fault: 1, on: true }), Ok(Answer::Done), "{kind}");
        rig.catch(BoardEvent::Fault(drivetwin_firmware::device::Fault(0), true));
        rig.run_for(Duration::millis(10));
        assert_eq!(state(&mut rig).faults, 0b11, "{kind}");
        assert_eq!(rig.call(Call::Fault { fault: 1, on: false }), Ok(Answer::Done), "{kind}");
        assert_eq!(state(&mut rig).faults, 0b01, "{kind}");
    }
}

#[test]
fn pulses_have_exact_times() {
    let mut rig = Rig::new("qsb-m", true);
    rig.run_until(Instant::from_ticks(16_000_000));
    rig.call(Call::Trace(true)).expect("done");
    let input = pin(rig.spec(), "A");
    let at = rig.now().ticks();
    // Three pulses away from the high level, of 10 µs each 100 µs.
    rig.call(Call::Pulse { pin: input, count: 3, period: 1_600, high: 160 }).expect("done");
    assert_eq!(
        rig.call(Call::Pulse { pin: input, count: 1, period: 1_600, high: 160 }),
        Err(Refused::Driven)
    );
    assert_eq!(rig.call(Call::Turn { encoder: 0, counts: 4, period: 1_600 }), Err(Refused::Driven));
    rig.run_for(Duration::millis(1));
    let events = rig.events();
    let edges: Vec<(u64, bool)> = events
        .iter()
        .flat_map(|events| events.decode())
        .filter_map(|(at, event)| match event {
            drivetwin_control::Event::Edge(pin, high) if pin == input => Some((at, high)),
            _ => None,
        })
        .collect();
    let first = edges[0].0;
    assert!((at + 1..at + 64).contains(&first), "{first} after {at}");
    let expected = [(0, false), (160, true), (1_600, false), (1_760, true), (3_200, false), (3_360, true)];
    assert_eq!(edges, expected.map(|(after, high)| (first + after, high)));
    assert_eq!(state(&mut rig).driven, 0);
    assert_eq!(
        rig.call(Call::Pulse { pin: input, count: 0, period: 1_600, high: 160 }),
        Err(Refused::OutOfRange)
    );
    assert_eq!(
        rig.call(Call::Pulse { pin: input, count: 1, period: 160, high: 160 }),
        Err(Refused::OutOfRange)
    );
}

#[test]
fn an_encoder_turns_there_and_back() {
    // The counter of a QSB counts all edges in x4.
    let mut rig = Rig::new("qsb-m", true);
    rig.run_for(Duration::millis(100));
    rig.call(Call::Preset { row: row(rig.spec(), "Mdr0"), value: 3 }).expect("done");
    let counter = "ReadEncoder";
    let start = read(&mut rig, counter);
    for (counts, expected) in [(1_000, start + 1_000), (-400, start + 600)] {
        assert_eq!(rig.call(Call::Turn { encoder: 0, counts, period: 1_600 }), Ok(Answer::Done));
        assert_eq!(rig.call(Call::Turn { encoder: 0, counts, period: 1_600 }), Err(Refused::Driven));
        rig.run_for(Duration::millis(101));
        assert_eq!(read(&mut rig, counter), expected);
    }
    let driven = state(&mut rig).driven;
    assert_eq!(driven, 1 << pin(rig.spec(), "A") | 1 << pin(rig.spec(), "B"));
}

#[test]
fn faster_pulses_than_the_loop_makes_are_refused() {
    let mut rig = Rig::new("qsb-m", true);
    // 20,000 edges in a second (BOARD-15).
    assert_eq!(rig.call(Call::Turn { encoder: 0, counts: 10, period: 799 }), Err(Refused::TooFast));
    assert_eq!(rig.call(Call::Turn { encoder: 0, counts: 10_000, period: 800 }), Ok(Answer::Done));
    let input = pin(rig.spec(), "DIO0");
    let slow = Call::Pulse { pin: input, count: 1, period: 16_000_000, high: 8_000_000 };
    assert_eq!(rig.call(slow), Err(Refused::TooFast));
    rig.run_for(Duration::secs(1));
    assert_eq!(rig.call(slow), Ok(Answer::Done));
    // A stimulus ends the train.
    assert_eq!(rig.call(Call::Drive { pin: input, stimulus: Stimulus::High }), Ok(Answer::Done));
    assert_eq!(rig.call(slow), Ok(Answer::Done));
}

#[test]
fn motion_and_pulses_are_those_of_the_axis() {
    let mut rig = Rig::new("md3", true);
    rig.run_for(Duration::millis(10));
    // The factory move: 10,000 steps.
    rig.call(Call::Preset { row: row(rig.spec(), "MotionControl"), value: 1 }).expect("done");
    rig.run_for(Duration::millis(1_250));
    let moving = state(&mut rig).motion.expect("an axis");
    assert!(moving.moving && moving.speed == 5_000 << 16 && moving.ma > 0, "{moving:?}");
    rig.run_for(Duration::millis(1_250));
    let motion = state(&mut rig).motion.expect("an axis");
    assert_eq!((motion.position, motion.pulses, motion.moving), (10_000, 10_000, false));
    assert_eq!(rig.steps().len(), 10_000);
    // A motor inside a drive has counts and no pulses.
    let mut rig = Rig::new("rs434544", true);
    rig.run_for(Duration::millis(10));
    let motion = state(&mut rig).motion.expect("an axis");
    assert_eq!((motion.speed, motion.moving, motion.pulses), (0, false, 0));
    assert_eq!(state(&mut Rig::new("qsb-d", true)).motion, None);
}

#[test]
fn the_saved_memory_goes_up_and_down() {
    for kind in FAMILIES {
        let mut rig = Rig::new(kind, true);
        let size = rig.spec().memory;
        let dump = |rig: &mut Rig| {
            let mut memory = Vec::new();
            while let Ok(Answer::Memory(piece)) = rig.call(Call::ReadMemory { offset: memory.len() as u16 })
                && !piece.is_empty()
            {
                memory.extend_from_slice(piece);
            }
            memory
        };
        let old = dump(&mut rig);
        assert_eq!(old.len(), usize::from(size), "{kind}");
        assert_eq!(rig.call(Call::ReadMemory { offset: u16::MAX }), Ok(Answer::Memory(&[])));
        let write = Call::WriteMemory { offset: size - 3, bytes: &[1, 2, 3] };
        assert_eq!(rig.call(write), Err(Refused::HasPower), "{kind}");
        rig.call(Call::Power(Power::Off)).expect("done");
        assert_eq!(rig.call(write), Ok(Answer::Done), "{kind}");
        let over = Call::WriteMemory { offset: size - 2, bytes: &[1, 2, 3] };
        assert_eq!(rig.call(over), Err(Refused::Unknown), "{kind}");
        let new = dump(&mut rig);
        assert_eq!(new[..new.len() - 3], old[..old.len() - 3]);
        assert_eq!(new[new.len() - 3..], [1, 2, 3]);
    }
}

#[test]
fn statistics_count_as_on_the_bench() {
    use drivetwin_board::CablePort;
    use drivetwin_protocol::modbus::rtu;
    let mut rig = Rig::new("md3", true);
    let good = rtu::read(1, 0x00, 1);
    let mut bad = good.to_vec();
    bad[6] ^= 1;
    for frame in [&good[..], &bad, &rtu::read(9, 0x00, 1), &rtu::read(1, 0x7000, 1), &good[..3]] {
        rig.write(CablePort::Bus, frame);
        rig.run_for(Duration::millis(60));
    }
    let counted = statistics(&mut rig);
    let expected = Statistics {
        line: drivetwin_control::Line { baud: 9_600, data: 8, parity: 2, stop: 1 },
        requests: 1,
        refused: 1,
        crc: 2,
        foreign: 1,
        ..Statistics::default()
    };
    assert_eq!(counted, expected);
}
