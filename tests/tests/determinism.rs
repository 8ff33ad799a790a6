//! The same seed and the same calls give the same trace and the same capture, byte for byte. The benches have
//! several drives, lines, motors and faults. Neither their order in the file nor the times of polling matter.
#![allow(missing_docs, reason = "a test")]

use std::sync::LazyLock;

use drivetwin_firmware::device::{Axis, Instant, Pin, Port};
use drivetwin_firmware::motor::stepper::StepperParameters;
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::{Duration, Span};
use drivetwin_sim::bench::{Bench, Closed, MotorModel, PinStimulus, PowerAction, Settings, Setup};
use drivetwin_sim::catalog;
use drivetwin_sim::config::bench_file;
use drivetwin_sim::export::pcapng;
use drivetwin_sim::record::trace::Retention;
use proptest::prelude::*;

/// The parts of a bench file.
const PARTS: [&str; 17] = [
    r#"[[bus]]
    name = "line1"
    drives = ["x", "y"]
    collisions = true"#,
    r#"[[drive]]
    name = "y"
    kind = "md3-low"
    address = 2
    fast_boot = true"#,
    r#"[[drive]]
    name = "x"
    kind = "md3"
    address = 1
    fast_boot = true"#,
    r#"[[drive]]
    name = "reader"
    kind = "qsb-m""#,
    r#"[[drive]]
    name = "servo"
    kind = "rs434544"
    fast_boot = true"#,
    r#"[[drive]]
    name = "a"
    kind = "md3"
    fast_boot = true"#,
    r#"[[motor]]
    name = "m"
    drive = "x"
    steps_per_rev = 200"#,
    r#"[[motor]]
    name = "b"
    drive = "servo"
    load_mnm = 20"#,
    r#"[[encoder]]
    motor = "m"
    cycles_per_rev = 1000
    to = { a = "reader.A", b = "reader.B", index = "reader.I" }"#,
    r#"[[encoder]]
    motor = "b"
    cycles_per_rev = 500
    to = { a = "a.J2.10", b = "a.J2.12", index = "a.J2.9" }"#,
    r#"[[switch]]
    motor = "m"
    closed = { above_rev = 0.25 }
    to = "y.J2.2""#,
    r#"[[switch]]
    motor = "b"
    closed = { below_rev = -0.1 }
    to = "servo.IN1""#,
    r#"[[wire]]
    from = "reader.DIO1"
    to = "a.J2.4""#,
    r#"[[wire]]
    from = "reader.DIO2"
    to = "a.J2.5""#,
    FAULTS[0],
    FAULTS[1],
    SCENARIO,
];

const FAULTS: [&str; 2] = [
    r#"[[fault]]
    bus = "line1"
    drop = 0.1
    corrupt = 0.1
    duplicate = 0.1
    truncate = 0.1
    noise = 0.1
    delay_ms = 1"#,
    r#"[[fault]]
    bus = "servo.rs485"
    corrupt = 0.2
    exception = 0.2"#,
];

const SCENARIO: &str = r#"[[scenario]]
    steps = [
        { at_s = 0.2, bus = "servo.rs485", faults = { corrupt = { rate = 0.3, direction = "reply" }, noise = { rate = 0.2, before = true } } },
        { when = { drive = "x", register = "MotionControl" }, after_ms = 7, drive = "x", fault = "over_temperature" },
        { after_ms = 20, drive = "x", clear = "over_temperature" },
        { pin = "y.J2.3", level = "low" },
        { at_s = 0.7, bus = "line1", faults = { drop = { count = 3, drive = "x", direction = "reply" }, delay_ms = { ms = 1, spread_ms = 3 } } },
        { drive = "a", power = "cycle" },
    ]"#;

/// Results of a bench.
#[derive(PartialEq, Eq, Debug)]
struct Left {
    trace: String,
    capture: Vec<u8>,
    heard: Vec<Vec<u8>>,
}

/// Results of all parts in the order above, with seed 1, polled only when the test acts.
static PLAYED: LazyLock<Left> = LazyLock::new(|| play(&PARTS, 1, &[]));

/// Runs a fixed sequence of actions on the bench of `parts`. Polls the bench after each of `chunks`, in a
/// cycle.
fn play(parts: &[&str], seed: u64, chunks: &[Duration]) -> Left {
    let layout = bench_file::parse(&parts.join("\n\n")).unwrap_or_else(|error| panic!("{error}"));
    let keep = Retention::All;
    let settings = Settings { seed, trace: keep, capture: keep, ..layout.settings() };
    let mut bench = layout.build(settings, Vec::new()).unwrap().bench;
    let seats = ["x", "y", "a", "reader", "servo"].map(|name| bench.find_drive(name).unwrap());
    let [x, y, a, reader, servo] = seats;
    let clients = [x, x, a, reader, servo].map(|seat| {
        let bus = bench.bus(seat, Port(0)).unwrap();
        bench.connect(bus)
    });
    let mut heard = vec![Vec::new(); clients.len()];
    let mut looks = chunks.iter().cycle();
    let mut run_until = |bench: &mut Bench, at: Instant| {
        let mut next = bench.now() + looks.next().copied().unwrap_or(Duration::secs(u64::MAX));
        while next < at {
            bench.run_until(next);
            next += looks.next().copied().unwrap_or(Duration::secs(u64::MAX));
        }
        bench.run_until(at);
    };
    let mut at = Instant::ZERO;
    for round in 0..40_u16 {
        at += 20.millis() + 137.micros() * u64::from(round);
        run_until(&mut bench, at);
        // Two clients of one line send at the same time, so the second request waits for its turn.
        bench.send(clients[0], &rtu::write(1, 0x1D, round));
        bench.send(clients[1], &rtu::read(2, 0x12, 4));
        bench.send(clients[2], &rtu::read(1, 0x10, 1));
        bench.send(clients[4], &rtu::read(1, 0x5000, 3));
        match round {
            1 => bench.send(clients[3], b"W162\rW110000640\rW168\rR0E\r"),
            2 => bench.send(clients[0], &rtu::write(1, 0x11, 1)),
            3 => bench.send(clients[4], &rtu::write(1, 0x5000 + 0x23, 0)),
            4 => bench.send(clients[4], &rtu::frame(1, &[5, 0x20, 0x00, 0xFF, 0x00])),
            10 => bench.set_pin(a, Pin(0), PinStimulus::Low),
            11 => bench.set_pin(y, Pin(1), PinStimulus::Low),
            15 => bench.send(clients[0], &rtu::write(1, 0x1A, 1)),
            16 => bench.power(x, PowerAction::Cut),
            17 => bench.send(clients[0], &rtu::write(1, 0x1A, 1)),
            20 => bench.power(x, PowerAction::On),
            24 => bench.power(reader, PowerAction::Cycle),
            _ => {}
        }
        for (client, heard) in clients.into_iter().zip(&mut heard) {
            bench.receive(client, heard);
        }
    }
    run_until(&mut bench, at + 200.millis());
    let mut capture = Vec::new();
    pcapng::write(&bench, &mut capture).unwrap();
    Left { trace: bench.trace().to_text(), capture, heard }
}

/// A bench built by calls in these orders: two drives on a line and a counter, with motors and the parts on
/// their shafts.
fn by_hand(seats: &[&str], lots: &[usize]) -> Left {
    let keep = Retention::All;
    let mut bench = Bench::with(Settings { trace: keep, capture: keep, ..Settings::default() });
    for &name in seats {
        let kind = if name == "reader" { "qsb-m" } else { "md3" };
        let setup = Setup { boot_fast: true, ..Setup::default() };
        bench.add_with(name, catalog::make(kind).unwrap(), setup).unwrap();
    }
    let seat = |name: &str| bench.find_drive(name).unwrap();
    let [x, y, reader] = ["x", "y", "reader"].map(seat);
    let pin = |bench: &Bench, seat, name: &str| {
        let pin = bench.spec(seat).pins.iter().position(|pin| pin.name == name).unwrap();
        (seat, Pin(pin as u8))
    };
    let ports: Vec<_> =
        seats.iter().filter(|name| **name != "reader").map(|name| (seat(name), Port(0))).collect();
    let line = bench.share("line1", &ports);
    let motors = ["x", "y"].map(|name| {
        let seat = bench.find_drive(name).unwrap();
        (
            name,
            bench
                .attach_motor(
                    &format!("motor-{name}"),
                    seat,
                    Axis(0),
                    MotorModel::Stepper(StepperParameters::NOMINAL),
                )
                .unwrap(),
        )
    });
    let motor = |name: &str| motors.iter().find(|(of, _)| *of == name).unwrap().1;
    for lot in lots {
        let at = |seat, name| pin(&bench, seat, name);
        match lot {
            0 => {
                let to = ["A", "B", "I"].map(|name| Some(at(reader, name)));
                bench.encode(motor("x"), 1_000, to);
            }
            1 => {
                let to = ["J2.10", "J2.12", "J2.9"].map(|name| Some(at(x, name)));
                bench.encode(motor("y"), 500, to);
            }
            2 => {
                let closed = Closed { above_rev: Some(0.5), below_rev: None };
                bench.switch(motor("x"), closed, at(y, "J2.2"));
            }
            3 => {
                let closed = Closed { above_rev: None, below_rev: Some(0.25) };
                bench.switch(motor("y"), closed, at(y, "J2.2"));
            }
            _ => bench.wire(at(x, "J3.7"), at(y, "J2.3")),
        }
    }
    let client = bench.connect(line);
    for seat in [x, y] {
        bench.poke(seat, 0, if seat == x { 1 } else { 2 }).unwrap();
    }
    for round in 0..10 {
        let unit = 1 + round % 2;
        bench.send(client, &rtu::write(unit, 0x11, 1));
        bench.run_until(bench.now() + 300.millis());
    }
    let mut heard = Vec::new();
    bench.receive(client, &mut heard);
    let mut capture = Vec::new();
    pcapng::write(&bench, &mut capture).unwrap();
    Left { trace: bench.trace().to_text(), capture, heard: vec![heard] }
}

/// The events of a trace, without the header line with the seed.
fn events(trace: &str) -> String {
    trace.lines().filter(|line| !line.starts_with("seed ")).collect()
}

#[test]
fn a_bench_plays_the_same_again() {
    let left = &*PLAYED;
    assert_eq!(*left, play(&PARTS, 1, &[]));
    assert!(left.trace.lines().count() > 1_000 && left.capture.len() > 10_000);
    assert!(left.heard.iter().all(|heard| !heard.is_empty()));
}

#[test]
fn another_seed_is_other_chances() {
    let (left, other) = (&*PLAYED, play(&PARTS, 2, &[]));
    assert_ne!(events(&left.trace), events(&other.trace));
    assert_ne!(left.capture, other.capture);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4))]

    #[test]
    fn the_order_in_a_file_changes_nothing(parts in Just(PARTS).prop_shuffle()) {
        prop_assert_eq!(&play(&parts, 1, &[]), &*PLAYED);
    }

    #[test]
    fn the_order_in_which_a_bench_is_put_up_changes_nothing(
        seats in Just(["reader", "x", "y"]).prop_shuffle(), lots in Just([0, 1, 2, 3, 4]).prop_shuffle(),
    ) {
        prop_assert_eq!(by_hand(&seats, &lots), by_hand(&["reader", "x", "y"], &[0, 1, 2, 3, 4]));
    }

    #[test]
    fn polling_at_any_instants_changes_nothing(chunks in proptest::collection::vec(1_000_u64..1_000_000, 1..9)) {
        let chunks: Vec<Duration> = chunks.into_iter().map(Duration::from_ticks).collect();
        prop_assert_eq!(&play(&PARTS, 1, &chunks), &*PLAYED);
    }
}
