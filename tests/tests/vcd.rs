//! Waveform files, read by a third-party reader and compared with the manual and with exact computation.
#![allow(missing_docs, reason = "a test")]

use std::collections::BTreeMap;

use drivetwin_firmware::device::Pin;
use drivetwin_firmware::md3::Md3;
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::{Duration, Span};
use drivetwin_sim::bench::{Bench, PinStimulus, PowerAction, Settings};
use drivetwin_sim::record::trace::Retention;
use drivetwin_tests::exact::step_instants;
use drivetwin_tests::md3::{at, bit, write, write_pair};
use vcd::{Command, IdCode, Parser, SimulationCommand, TimescaleUnit, Value};

/// Units of 100 ps in a tick of 62.5 ns.
const UNITS_PER_TICK: u64 = 625;

/// A change of a signal: its tick and the new value.
type Change = (u64, Value);

/// The signals of a file by scope and name, each with its changes, beginning with its first value.
struct File {
    wires: BTreeMap<(String, String), Vec<Change>>,
    end: u64,
}

impl File {
    fn of(bench: &Bench) -> Self {
        let mut text = Vec::new();
        drivetwin_sim::export::vcd::write(bench.trace(), &mut text).unwrap();
        let mut parser = Parser::new(&text[..]);
        let header = parser.parse_header().unwrap();
        assert_eq!(header.timescale, Some((100, TimescaleUnit::PS)));
        let mut names: BTreeMap<IdCode, (String, String)> = BTreeMap::new();
        for scope in header.items.iter().filter_map(|item| match item {
            vcd::ScopeItem::Scope(scope) => Some(scope),
            _ => None,
        }) {
            for item in &scope.items {
                let vcd::ScopeItem::Var(var) = item else { panic!("{item:?}") };
                assert_eq!((var.var_type, var.size), (vcd::VarType::Wire, 1));
                let name = (scope.identifier.clone(), var.reference.clone());
                assert_eq!(names.insert(var.code, name), None, "a code of two wires");
            }
        }
        let mut wires: BTreeMap<(String, String), Vec<Change>> = BTreeMap::new();
        let mut now = None;
        let mut dumped = false;
        for command in parser {
            match command.unwrap() {
                Command::Timestamp(units) => {
                    assert!(now.is_none_or(|now| units > now), "time goes on");
                    assert_eq!(units % UNITS_PER_TICK, 0, "a whole number of ticks");
                    now = Some(units);
                }
                Command::ChangeScalar(code, value) => {
                    let at = now.unwrap() / UNITS_PER_TICK;
                    let changes = wires.entry(names[&code].clone()).or_default();
                    assert!(changes.last().is_none_or(|last| last.0 < at && last.1 != value));
                    changes.push((at, value));
                }
                Command::Begin(SimulationCommand::Dumpvars) => assert_eq!(now, Some(0)),
                Command::End(SimulationCommand::Dumpvars) => {
                    dumped = wires.len() == names.len();
                }
                other => panic!("{other:?}"),
            }
        }
        assert!(dumped, "each wire has a value from the beginning");
        Self { wires, end: now.unwrap() / UNITS_PER_TICK }
    }

    fn wire(&self, scope: &str, name: &str) -> &[Change] {
        &self.wires[&(scope.to_owned(), name.to_owned())]
    }

    /// Ticks at which a signal changes to `value`, from `from` on.
    fn when(&self, scope: &str, name: &str, value: Value, from: u64) -> Vec<u64> {
        let changes = self.wire(scope, name).iter();
        changes.filter(|change| change.1 == value && change.0 >= from).map(|change| change.0).collect()
    }

    /// Value of a signal at a tick.
    fn at(&self, scope: &str, name: &str, at: u64) -> Value {
        self.wire(scope, name).iter().rev().find(|change| change.0 <= at).unwrap().1
    }

    /// Begin and end of each motion of a drive. Between them BUSY, J3 pin 7, is pulled to ground.
    fn busy(&self, scope: &str) -> Vec<(u64, u64)> {
        let ends = self.when(scope, "J3_7", Value::Z, 1);
        self.when(scope, "J3_7", Value::V0, 0).into_iter().zip(ends).collect()
    }

    /// Checks the pulses of a profile move that begins at `begins`.
    fn check_move(&self, scope: &str, begins: u64, steps: i32, speed: u32, acceleration: u32) {
        let due: Vec<u64> = step_instants(steps.unsigned_abs(), speed, acceleration)
            .map(|since| begins + since.ticks())
            .collect();
        let ends = *due.last().unwrap();
        let within = |at: &&u64| (begins..=ends + 1).contains(*at);
        let rises = self.when(scope, "STEP", Value::V1, 0);
        let rises: Vec<u64> = rises.iter().filter(within).copied().collect();
        assert_eq!(rises.len(), due.len(), "as many pulses as steps");
        for (n, (rise, due)) in (1..).zip(rises.iter().zip(&due)) {
            assert!(rise.abs_diff(*due) <= 1, "step {n} at {rise}, due at {due}");
            let direction = if steps > 0 { Value::V1 } else { Value::V0 };
            assert_eq!(self.at(scope, "DIR", *rise), direction, "step {n}");
        }
        let falls = self.when(scope, "STEP", Value::V0, begins + 1);
        let due: Vec<u64> = rises.iter().map(|rise| rise + ticks(2.micros())).collect();
        assert!(falls.starts_with(&due), "each pulse is high for 2 µs");
    }
}

fn ticks(span: Duration) -> u64 {
    span.ticks()
}

/// A bench that keeps its whole trace.
fn bench() -> Bench {
    Bench::with(Settings { trace: Retention::All, ..Settings::default() })
}

#[test]
fn every_step_of_a_move_is_on_its_tick() {
    let mut bench = bench();
    let md3 = bench.add::<Md3>("x");
    bench.run_until(2_500.millis());
    write(&mut bench, md3, at::MOTION, bit::MOVE);
    bench.run_until(6.secs());
    // A triangle backward: 101 steps at 4,000,000 steps/s².
    write_pair(&mut bench, md3, at::MOVE_STEPS, (-101_i32).cast_unsigned());
    write_pair(&mut bench, md3, at::ACCEL_DECEL, 4_000_000);
    write_pair(&mut bench, md3, at::SPEED, 40_000);
    write(&mut bench, md3, at::MOTION, bit::MOVE);
    bench.run_until(7.secs());

    let file = File::of(&bench);
    assert_eq!(file.end, ticks(7.secs()));
    let busy = file.busy("x");
    let [(forward, stands), (back, stands_again)] = busy[..] else { panic!("{busy:?}") };
    assert!((ticks(2_500.millis())..ticks(2_600.millis())).contains(&forward));
    assert_eq!(stands - forward, ticks(2_500.millis()), "1250, 7500 and 1250 steps");
    file.check_move("x", forward, 10_000, 5_000, 10_000);
    // The move takes 2·sqrt(101/4,000,000) s.
    assert!((stands_again - back).abs_diff(160_798) <= 1, "{}", stands_again - back);
    file.check_move("x", back, -101, 40_000, 4_000_000);
    assert_eq!(file.when("x", "STEP", Value::V1, 0).len(), 10_101, "and no pulse beside them");

    // DIR changes 5 µs before the first step in a new direction.
    let rises = file.when("x", "STEP", Value::V1, 0);
    let dir = file.wire("x", "DIR");
    let setup = ticks(5.micros());
    assert_eq!(dir, [(0, Value::V0), (rises[0] - setup, Value::V1), (rises[10_000] - setup, Value::V0)]);
}

#[test]
fn a_reversal_changes_the_direction_between_two_pulses() {
    let mut bench = bench();
    let md3 = bench.add::<Md3>("x");
    bench.run_until(2_500.millis());
    write(&mut bench, md3, at::MOTION, bit::JOG);
    bench.run_until(4.secs());
    // From 5,000 to −5,000 steps/s. After only the high half is written, the speed is −60,536, which is
    // limited to −40,000.
    write_pair(&mut bench, md3, at::SPEED, (-5_000_i32).cast_unsigned());
    bench.run_until(6.secs());
    let file = File::of(&bench);
    let dir = file.wire("x", "DIR");
    let [(0, Value::V0), (up, Value::V1), (down, Value::V0)] = dir[..] else { panic!("{dir:?}") };
    let rises = file.when("x", "STEP", Value::V1, 0);
    for change in [up, down] {
        let first = rises.iter().find(|rise| **rise > change).unwrap();
        assert_eq!(first - change, ticks(5.micros()));
        assert_eq!(file.at("x", "STEP", change), Value::V0);
    }
    let forward = rises.iter().filter(|rise| **rise < down).count();
    let position = i64::from(bench.motion(md3, drivetwin_firmware::device::Axis(0)).position);
    assert_eq!(2 * i64::try_from(forward).unwrap() - i64::try_from(rises.len()).unwrap(), position);
}

#[test]
fn step_pulses_pass_through() {
    let mut bench = bench();
    let md3 = bench.add::<Md3>("x");
    bench.run_until(2_500.millis());
    // J2 pin 4 is step, at each falling edge. J2 pin 5 is direction, and low is backward (7.8).
    bench.set_pin(md3, Pin(3), PinStimulus::Low);
    bench.pulse(md3, Pin(2), 1_000, 100_000.0).unwrap();
    bench.run_until(3.secs());
    let file = File::of(&bench);
    let falls = file.when("x", "J2_4", Value::V0, 1);
    assert_eq!(falls.len(), 1_000);
    assert!(falls.windows(2).all(|pair| pair[1] - pair[0] == ticks(10.micros())));
    assert_eq!(file.when("x", "STEP", Value::V1, 0), falls);
    assert_eq!(file.wire("x", "DIR"), [(0, Value::V0)]);
    assert!(file.busy("x").is_empty(), "BUSY is for moves only");
}

#[test]
fn lights_blink_as_the_manual_says() {
    let mut bench = bench();
    bench.add::<Md3>("md3");
    bench.run_until(10.secs());
    let file = File::of(&bench);
    let millis = |name| -> Vec<(u64, bool)> {
        let changes = file.wire("md3", name).iter();
        changes.map(|(at, value)| (at / ticks(1.millis()), *value == Value::V1)).collect()
    };
    // Both flash twice, then alternately. Red ends when green begins its regular flashes (sections 2 and 4).
    let flashes = [(0, true), (250, false), (500, true), (750, false)];
    assert_eq!(millis("D5"), [&flashes[..], &[(1_500, true), (2_000, false)]].concat());
    let beats = [(2_750, false), (4_000, true), (4_250, false), (5_500, true), (5_750, false)];
    let more = [(7_000, true), (7_250, false), (8_500, true), (8_750, false), (10_000, true)];
    let turns = [(1_000, true), (1_500, false), (2_000, true)];
    assert_eq!(millis("D6"), [&flashes[..], &turns, &beats, &more].concat());
}

#[test]
fn two_drives_have_scopes_of_their_own() {
    let mut bench = bench();
    let (x, y) = (bench.add::<Md3>("x"), bench.add::<Md3>("y"));
    bench.run_until(2_500.millis());
    for (seat, steps) in [(x, 300), (y, 200)] {
        write(&mut bench, seat, at::MOVE_STEPS + 1, steps);
        write(&mut bench, seat, at::MOTION, bit::MOVE);
    }
    bench.set_pin(y, Pin(0), PinStimulus::Low);
    bench.run_until(4.secs());
    let file = File::of(&bench);
    for (scope, steps) in [("x", 300), ("y", 200)] {
        let busy = file.busy(scope);
        let [(begins, _)] = busy[..] else { panic!("{scope}: {busy:?}") };
        file.check_move(scope, begins, steps, 5_000, 10_000);
        assert_eq!(i32::try_from(file.when(scope, "STEP", Value::V1, 0).len()), Ok(steps));
    }
    assert_eq!(file.wire("x", "J2_2"), [(0, Value::V1)]);
    let pulled = file.wire("y", "J2_2");
    assert!(matches!(pulled, [(0, Value::V1), (1.., Value::V0)]), "{pulled:?}");
}

#[test]
fn power_that_fails_in_a_save_is_power_lost() {
    let mut bench = bench();
    let md3 = bench.add::<Md3>("x");
    bench.run_until(2_500.millis());
    bench.power(md3, PowerAction::Cut);
    bench.ask(md3, &rtu::write(1, at::EEPROM, 1));
    bench.run_until(3.secs());
    assert!(!bench.powered(md3));
    let file = File::of(&bench);
    let green = file.wire("x", "D6").last().unwrap();
    assert!(matches!(green, (40_000_001.., Value::X)), "{green:?}");
    for (scope, name) in file.wires.keys() {
        assert_eq!(file.wire(scope, name).last(), Some(&(green.0, Value::X)), "{name}");
    }
}

#[test]
fn without_power_all_wires_are_unknown() {
    let mut bench = bench();
    let md3 = bench.add::<Md3>("x");
    bench.run_until(2_500.millis());
    bench.set_pin(md3, Pin(0), PinStimulus::Low);
    write(&mut bench, md3, at::MOTION, bit::MOVE);
    bench.run_until(4.secs());
    bench.power(md3, PowerAction::Off);
    bench.run_until(5.secs());
    bench.power(md3, PowerAction::On);
    bench.run_until(6.secs());
    let file = File::of(&bench);
    let (off, on) = (ticks(4.secs()), ticks(5.secs()));
    for (scope, name) in file.wires.keys() {
        assert_ne!(file.at(scope, name, off - 1), Value::X, "{name}");
        assert_eq!(file.at(scope, name, off), Value::X, "{name}");
        assert_eq!(file.at(scope, name, on - 1), Value::X, "{name}");
        assert_ne!(file.at(scope, name, on), Value::X, "{name}");
    }
    assert!(file.when("x", "STEP", Value::V1, 0).len() > 1_000);
    assert!(file.when("x", "STEP", Value::V1, off).is_empty());
    assert_eq!((file.at("x", "STEP", on), file.at("x", "DIR", on)), (Value::V0, Value::V0));
    assert_eq!(file.at("x", "J3_7", on), Value::Z);
    assert_eq!(file.at("x", "J2_2", on), Value::V0, "it is held low all the time");
}
