//! Waveform files, read by a third-party reader and compared with the manual and with exact computation.
#![allow(missing_docs, reason = "a test")]

use std::collections::BTreeMap;

use drivetwin_firmware::device::{Axis, Instant, Pin, Port};
use drivetwin_firmware::md3::Md3;
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::{Duration, Span};
use drivetwin_sim::bench::{Bench, DriveId, Motion, MotorModel, PinStimulus, PowerAction, Settings, Setup};
use drivetwin_sim::catalog;
use drivetwin_sim::record::trace::{Entry, Event, OutputRecord, Retention, Trace};
use drivetwin_sim::replay;
use drivetwin_tests::exact::step_instants;
use drivetwin_tests::md3::{at, bit, write, write_pair};
use vcd::{Command, IdCode, Parser, SimulationCommand, TimescaleUnit, Value};

/// A change of a signal: its tick and the new value.
type Change = (u64, Value);

/// Changes of the signals of one type by scope and name, beginning with the first value.
type Signals<T> = BTreeMap<(String, String), Vec<(u64, T)>>;

/// The signals of a file.
struct File {
    wires: Signals<Value>,
    reals: Signals<f64>,
    texts: Signals<String>,
    end: u64,
}

/// The tick of a time in ns, which is rounded down from ticks of 62.5 ns.
fn tick(ns: u64) -> u64 {
    let tick = (ns * 2).div_ceil(125);
    assert_eq!(tick * 125 / 2, ns, "a whole number of ticks, rounded down");
    tick
}

impl File {
    fn of(bench: &Bench) -> Self {
        let mut text = Vec::new();
        drivetwin_sim::export::vcd::write(bench.trace(), &mut text).unwrap();
        let mut parser = Parser::new(&text[..]);
        let header = parser.parse_header().unwrap();
        assert_eq!(header.timescale, Some((1, TimescaleUnit::NS)));
        let mut names: BTreeMap<IdCode, (String, String)> = BTreeMap::new();
        for scope in header.items.iter().filter_map(|item| match item {
            vcd::ScopeItem::Scope(scope) => Some(scope),
            _ => None,
        }) {
            for item in &scope.items {
                let vcd::ScopeItem::Var(var) = item else { panic!("{item:?}") };
                let size = if var.var_type == vcd::VarType::Real { 64 } else { 1 };
                assert_eq!(var.size, size);
                let name = (scope.identifier.clone(), var.reference.clone());
                assert_eq!(names.insert(var.code, name), None, "a code of two wires");
            }
        }
        let (mut wires, mut reals, mut texts) = (Signals::new(), Signals::new(), Signals::new());
        let mut now = None;
        let mut dumped = false;
        for command in parser {
            match command.unwrap() {
                Command::Timestamp(units) => {
                    assert!(now.is_none_or(|now| units > now), "time goes on");
                    now = Some(units);
                }
                Command::ChangeScalar(code, value) => add(&mut wires, &names[&code], now, value),
                Command::ChangeReal(code, value) => add(&mut reals, &names[&code], now, value),
                Command::ChangeString(code, value) => add(&mut texts, &names[&code], now, value),
                Command::Begin(SimulationCommand::Dumpvars) => assert_eq!(now, Some(0)),
                Command::End(SimulationCommand::Dumpvars) => {
                    dumped = wires.len() + reals.len() + texts.len() == names.len();
                }
                other => panic!("{other:?}"),
            }
        }
        assert!(dumped, "each signal has a value from the beginning");
        Self { wires, reals, texts, end: tick(now.unwrap()) }
    }

    /// The samples of a track.
    fn track(&self, scope: &str, name: &str) -> &[(u64, f64)] {
        &self.reals[&(scope.to_owned(), name.to_owned())]
    }

    /// The number of a track at a tick.
    fn number(&self, scope: &str, name: &str, at: u64) -> f64 {
        self.track(scope, name).iter().rev().find(|sample| sample.0 <= at).unwrap().1
    }

    /// The texts of a port in one direction, each with its first and last tick.
    fn texts(&self, scope: &str, name: &str) -> Vec<(u64, u64, String)> {
        let changes = &self.texts[&(scope.to_owned(), name.to_owned())];
        let ends = changes.iter().skip(1).map(|(at, _)| *at).chain([self.end]);
        let words = changes.iter().zip(ends).filter(|((_, text), _)| text != "\\x20");
        words.map(|((at, text), end)| (*at, end, text.replace("\\x20", " "))).collect()
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

/// Adds a change, which must be later than the last one of its signal, and another value.
fn add<T: PartialEq>(signals: &mut Signals<T>, name: &(String, String), now: Option<u64>, value: T) {
    let at = tick(now.unwrap());
    let changes = signals.entry(name.clone()).or_default();
    assert!(changes.last().is_none_or(|last| last.0 < at && last.1 != value));
    changes.push((at, value));
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
    // Both lights flash twice, then alternately. The red light ends when the green light begins its regular
    // flashes (sections 2 and 4).
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

/// A bench that keeps its whole trace and the motion of motors, with a drive of that kind named like it.
fn moving_bench(kind: &str) -> (Bench, DriveId) {
    let settings = Settings { trace: Retention::All, shafts: true, outcomes: true, ..Settings::default() };
    let mut bench = Bench::with(settings);
    let setup = Setup { boot_fast: true, ..Setup::default() };
    let drive = bench.add_with(kind, catalog::make(kind).unwrap(), setup).unwrap();
    (bench, drive)
}

/// Runs a bench from millisecond to millisecond. Returns the tick and the motion of the first axis at each.
fn watch(bench: &mut Bench, drive: DriveId, millis: u64) -> Vec<(u64, Motion)> {
    let from = bench.now().ticks() / ticks(1.millis()) + 1;
    let watched = (from..from + millis).map(|ms| {
        bench.run_until(Instant::ZERO + ms.millis());
        (bench.now().ticks(), bench.motion(drive, Axis(0)))
    });
    watched.collect()
}

/// Checks that the tracks of a stepper drive show exactly what the bench showed.
fn check_tracks(file: &File, scope: &str, watched: &[(u64, Motion)]) {
    for (at, motion) in watched {
        let shown = |name| file.number(scope, name, *at);
        assert_eq!(shown("position"), f64::from(motion.position), "tick {at}");
        assert!((shown("speed") - motion.speed.to_num::<f64>()).abs() <= 0.001, "tick {at}");
        assert_eq!(shown("current"), f64::from(motion.current_ma) / 1_000.0, "tick {at}");
        assert_eq!(shown("duty"), 0.0);
    }
}

#[test]
fn the_position_is_that_of_the_plan_at_every_sample() {
    let (mut bench, md3) = moving_bench("md3");
    bench.run_until(100.millis());
    write(&mut bench, md3, at::MOTION, bit::MOVE);
    let mut watched = watch(&mut bench, md3, 1_000);
    // A jog that replaces the move in its middle, and reverses.
    write_pair(&mut bench, md3, at::SPEED, (-3_000_i32).cast_unsigned());
    write(&mut bench, md3, at::MOTION, bit::JOG);
    watched.extend(watch(&mut bench, md3, 1_500));
    let file = File::of(&bench);
    check_tracks(&file, "md3", &watched);

    let plans: Vec<_> = bench
        .trace()
        .events()
        .filter_map(|entry| match &entry.event {
            Event::Output(OutputRecord::Plan { plan, .. }) => Some((entry.at, plan)),
            _ => None,
        })
        .collect();
    let samples = file.track("md3", "position");
    assert!(samples.len() > 2_000);
    for (at, position) in samples {
        let at = Instant::from_ticks(*at);
        let (_, plan) = plans.iter().rev().find(|(from, _)| *from <= at).unwrap();
        assert_eq!(*position, f64::from(plan.position_at(at)));
    }
    // A ramp begins and ends on a sample: 5,000 steps/s is reached on its tick.
    let (begin, plan) = plans.iter().find(|(_, plan)| plan.segments().len() == 3).unwrap();
    let cruise = *begin + Duration::from_ticks(plan.segments()[0].ticks);
    assert!(file.track("md3", "speed").contains(&(cruise.ticks(), 5_000.0)));
}

#[test]
fn a_drive_at_rest_writes_nothing() {
    let (mut bench, _) = moving_bench("md3");
    bench.run_until(3.secs());
    let before = File::of(&bench);
    bench.run_until(3_600.secs());
    let after = File::of(&bench);
    for name in ["position", "speed", "current", "duty"] {
        assert_eq!(before.track("md3", name), after.track("md3", name), "{name}");
    }
}

#[test]
fn a_move_of_an_mdrive_is_a_track() {
    let (mut bench, mdrive) = moving_bench("mdrive");
    bench.run_until(1.secs());
    let mcode = bench.spec(mdrive).ports.iter().position(|port| port.name == "mcode").unwrap();
    let mcode = Port(u8::try_from(mcode).unwrap());
    let client = bench.connect_to(mdrive, mcode).unwrap();
    bench.run_until_idle();
    bench.send(client, b"MR 51200\r\n");
    let watched = watch(&mut bench, mdrive, 3_000);
    let file = File::of(&bench);
    check_tracks(&file, "mdrive", &watched);
    assert_eq!(file.number("mdrive", "position", file.end), 51_200.0);
    assert!(file.track("mdrive", "speed").len() > 100);
    let texts = file.texts("mdrive", "mcode_rx");
    // A line takes no time, and its outcome is known when it has been executed.
    let [(begin, end, words), (known, _, outcome)] = &texts[..] else { panic!("{texts:?}") };
    assert_eq!((end - begin, words.as_str()), (ticks(1.millis()), "MR 51200"));
    assert!(known >= end && outcome == "MR 51200 -> done", "{texts:?}");
}

#[test]
fn the_tracks_of_a_motor_are_those_of_the_bench() {
    let rs = [("SPEED", 600), ("MODE_ROTATION", 2), ("OFFSET", 2_000), ("START_bit", 1)];
    let mdrobot = [("SLOW_START", 0), ("UI_COM", 1), ("START_STOP", 1), ("VEL_CMD", 600)];
    for (kind, orders) in [("rs434544", rs), ("mdrobot", mdrobot)] {
        let (mut bench, drive) = moving_bench(kind);
        bench.run_until(1.secs());
        for (name, value) in orders {
            let row = bench.spec(drive).find(name).unwrap_or_else(|| panic!("{name}")).row;
            bench.poke(drive, row, value).unwrap();
        }
        let watched = watch(&mut bench, drive, 800);
        let file = File::of(&bench);
        let fastest = watched.iter().map(|(_, motion)| motion.speed.to_num::<f64>()).fold(0.0, f64::max);
        assert!(fastest > 50.0, "{kind} turns: {fastest}");
        for (at, motion) in &watched {
            // At a steady speed a sample may be up to 10 ms old, and the next one up to 4 ms away.
            let slack = fastest * 0.014 + 1.0;
            let shown = file.number(kind, "position", *at);
            assert!((shown - f64::from(motion.position)).abs() <= slack, "{kind} at {at}: {shown}");
        }
        let (at, motion) = watched.last().unwrap();
        assert!((file.number(kind, "speed", *at) - motion.speed.to_num::<f64>()).abs() < fastest * 0.05);
        assert!(file.track(kind, "duty").iter().any(|(_, duty)| *duty > 0.0));
        let counts = ["position", "speed"].map(|name| file.track(kind, name).len());
        assert!(counts.iter().all(|count| *count > 10), "{kind}: {counts:?}");
    }
}

#[test]
fn recording_the_motion_of_a_motor_changes_nothing_else() {
    let text = |shafts| {
        let settings = Settings { trace: Retention::All, shafts, ..Settings::default() };
        let mut bench = Bench::with(settings);
        for kind in ["rs434544", "mdrobot"] {
            bench.add_with(kind, catalog::make(kind).unwrap(), Setup::default()).unwrap();
        }
        let orders = [("MODE_ROTATION", 2), ("OFFSET", 2_000), ("START_bit", 1)];
        let drive = bench.find_drive("rs434544").unwrap();
        bench.run_until(1.secs());
        for (name, value) in orders {
            let row = bench.spec(drive).find(name).unwrap().row;
            bench.poke(drive, row, value).unwrap();
        }
        bench.run_until(3.secs());
        let shaft = |entry: &&Entry| matches!(entry.event, Event::Shaft { .. });
        (bench.trace().to_text(), bench.trace().events().filter(shaft).count())
    };
    let ((with, some), (without, none)) = (text(true), text(false));
    assert!(some > 50 && none == 0, "{some} {none}");
    assert_eq!(with, without);
}

#[test]
fn a_motor_of_the_bench_is_a_track_and_also_in_a_replay() {
    let settings = Settings { trace: Retention::All, shafts: true, outcomes: true, ..Settings::default() };
    let mut bench = Bench::with(settings);
    let setup = Setup { external_motor: true, ..Setup::default() };
    let drive = bench.add_with("x", catalog::make("rs434544").unwrap(), setup).unwrap();
    let parameters = bench.detached_motor(drive).unwrap();
    bench.attach_motor("m", drive, Axis(0), MotorModel::Brush(parameters)).unwrap();
    bench.run_until(1.secs());
    for (name, value) in [("MODE_ROTATION", 2), ("OFFSET", 200), ("START_bit", 1)] {
        let row = bench.spec(drive).find(name).unwrap().row;
        bench.poke(drive, row, value).unwrap();
    }
    bench.run_until(4.secs());
    let file = File::of(&bench);
    let reached = f64::from(bench.motion(drive, Axis(0)).position);
    assert!((reached - file.track("x", "position")[1].1).abs() >= 190.0, "{reached}");
    assert_eq!(file.number("x", "position", file.end), reached);

    let make = |kind: &str| catalog::make(kind).ok();
    let trace = Trace::parse(&bench.trace().to_text(), &make).unwrap();
    let replayed = File::of(&replay::benches(&trace, &make).unwrap()[0]);
    assert_eq!(replayed.number("x", "position", replayed.end), reached);
    assert!(replayed.track("x", "position").len() > 20);
}

#[test]
fn without_recorded_shafts_the_motion_of_a_motor_is_unknown() {
    let mut bench = bench();
    bench.add_with("rs", catalog::make("rs434544").unwrap(), Setup::default()).unwrap();
    bench.run_until(1.secs());
    let file = File::of(&bench);
    assert!(file.reals[&("rs".to_owned(), "position".to_owned())].iter().all(|(_, value)| value.is_nan()));
}

#[test]
fn frames_are_words_from_their_begin_to_their_end() {
    let (mut bench, md3) = moving_bench("md3");
    bench.run_until(100.millis());
    bench.ask(md3, &rtu::write(1, 0x15, 9_000));
    bench.ask(md3, &rtu::write(1, 0x0b, 5));
    let mut broken = rtu::write(1, 0x15, 9_000);
    broken[7] ^= 1;
    bench.ask(md3, &broken);
    bench.run_until(1.secs());
    let file = File::of(&bench);
    let (received, sent) = (file.texts("md3", "rs485_rx"), file.texts("md3", "rs485_tx"));
    let words = |texts: &[(u64, u64, String)]| texts.iter().map(|text| text.2.clone()).collect::<Vec<_>>();
    assert_eq!(
        words(&received),
        [
            "write SpeedLow = 9000",
            "write SpeedLow = 9000 -> done",
            "write Reserved = 5",
            "write Reserved = 5 -> refused: 0x000B Reserved is read only (02)",
            "8 bytes 01 06 00 15 23 28 81 21",
            "8 bytes 01 06 00 15 23 28 81 21 -> CRC wrong: 81 21 instead of 81 20",
        ]
    );
    assert_eq!(words(&sent), ["done", "refused: 0x000B Reserved is read only (02)"]);
    // 8 characters of 11 bits at 9600 baud, 1.146 ms each; the first is heard at its end. The reply follows
    // after 3.5 characters of silence and one more.
    let character = 18_333;
    let [(begin, end, _), ..] = &received[..] else { panic!("{received:?}") };
    assert_eq!(end - begin, 7 * character);
    let [(replies, replied, _), ..] = &sent[..] else { panic!("{sent:?}") };
    // The outcome is known when the drive answers, and is shown for 1 ms.
    assert_eq!((received[1].0, received[1].1 - received[1].0), (*replies, ticks(1.millis())));
    assert_eq!((replies - end, replied - replies), (64_166 + character, 8 * character));
}
