//! Tests that recordings of a bench replay.

use drivetwin_firmware::md3::Md3;
use drivetwin_firmware::qsb::Qsb;

use super::*;
use crate::record::trace::Recording;

fn make(kind: &str) -> Option<Box<dyn Device>> {
    match kind {
        "md3" => Some(Box::new(Md3::new())),
        "qsb-d" => Some(Box::new(Qsb::d())),
        _ => None,
    }
}

fn fast() -> Setup {
    Setup { boot_fast: true, ..Setup::default() }
}

fn bench(line: LineMode) -> (Bench, DriveId, Bus) {
    let mut bench = Bench::with(Settings { line, trace: Retention::All, ..Settings::default() });
    let qsb = bench.add_with("q", Box::new(Qsb::d()), fast()).unwrap();
    let bus = bench.bus(qsb, Port(0)).unwrap();
    (bench, qsb, bus)
}

/// Writes the recording of `bench`, reads it back and checks that it replays. Returns its text.
fn replays(bench: &Bench) -> String {
    let recording = Recording::new(bench.trace(), Vec::new()).unwrap();
    let text = String::from_utf8(recording.finish(bench.trace()).unwrap()).unwrap();
    let trace = Trace::parse(&text, &make).unwrap();
    assert_eq!(replay::run(&trace, &make), Ok(None), "{text}");
    // Writing the trace all at once gives a text that replays, too.
    let whole = Trace::parse(&bench.trace().to_text(), &make).unwrap();
    assert_eq!(whole.to_text(), bench.trace().to_text());
    assert_eq!(replay::run(&whole, &make), Ok(None), "{text}");
    text
}

#[test]
fn answers_that_are_under_way_at_the_end_move_no_other_drive() {
    let (mut bench, _, bus) = bench(LineMode::Timed);
    let md3 = bench.add_with("x", Box::new(Md3::new()), fast()).unwrap();
    let client = bench.connect(bus);
    let row = |name| bench.spec(md3).find(name).unwrap().row;
    let (steps, control) = (row("MoveSteps"), row("QuadratureEncoderCount"));
    bench.poke(md3, steps, 100).unwrap();
    bench.poke(md3, control, 1).unwrap();
    // Each answer takes the time of 17 characters, so the last one comes after the end of the move.
    bench.send(client, &b"R0E\r".repeat(1_000));
    bench.run_until(bench.now() + 200.millis());
    let text = replays(&bench);
    let stamp = |line: &str| line.split(' ').next().unwrap().parse::<f64>().unwrap();
    let end = text.lines().find_map(|line| line.strip_suffix(" end")).unwrap().parse::<f64>().unwrap();
    let last = text.lines().filter(|line| line.contains(" < tx ")).map(stamp).fold(0.0, f64::max);
    assert!(last > end + 200.0, "{last} {end}");
}

#[test]
fn what_comes_at_one_instant_comes_in_its_order() {
    let (mut bench, qsb, bus) = bench(LineMode::Fast);
    bench.run_until(1.secs());
    let noise = LineFaults { noise: crate::line::faults::FaultRule::rate(1.0), ..LineFaults::default() };
    bench.set_line_faults(bus, noise);
    let client = bench.connect(bus);
    for _ in 0..20 {
        bench.send(client, b"W0B5\rR0B\rR0E\r");
        bench.run_until_idle();
    }
    let text = replays(&bench);
    assert!(text.contains("> spoiled"), "{text}");

    let (mut bench, qsb_again, bus) = self::bench(LineMode::Fast);
    assert_eq!(qsb, qsb_again);
    bench.run_until(1.secs());
    let client = bench.connect(bus);
    for action in [PowerAction::Cycle, PowerAction::Off, PowerAction::On, PowerAction::Cycle] {
        bench.send(client, b"W0B5\r");
        bench.attach(bus, true);
        bench.send(client, b"R0B\r");
        bench.power(qsb, action);
        bench.attach(bus, false);
        bench.run_until(bench.now() + Duration::TICK);
        bench.attach(bus, true);
        bench.send(client, b"R0E\r");
        bench.run_until_idle();
        bench.run_until(bench.now() + 100.millis());
    }
    replays(&bench);
}

#[test]
fn a_preset_at_the_beginning_leaves_other_drives_alone() {
    let mut bench = Bench::with(Settings { trace: Retention::All, ..Settings::default() });
    let spec = Md3::new().spec();
    let unsaved = spec.find("QuadratureEncoderCount").unwrap().row;
    assert_eq!(spec.registers.rows[unsaved].saved, 0);
    let setup = Setup { presets: vec![(unsaved, 1)], ..fast() };
    bench.add_with("a", Box::new(Md3::new()), setup).unwrap();
    let other = bench.add_with("b", Box::new(Md3::new()), fast()).unwrap();
    for fault in 0..bench.spec(other).faults.len() {
        bench.fault(other, Fault(fault as u8), true);
    }
    bench.run_until(2.secs());
    let text = replays(&bench);
    assert!(text.contains("0.000000 a > poke QuadratureEncoderCount 1"), "{text}");
    assert!(text.contains("0.000000 b > fault "), "{text}");
}

#[test]
fn only_what_is_written_is_dropped() {
    let mut bench = Bench::with(Settings { trace: Retention::Written(0), ..Settings::default() });
    let drive = bench.add_with("x", Box::new(Md3::new()), fast()).unwrap();
    let mut recording = Recording::new(bench.trace(), Vec::new()).unwrap();
    for n in 1..=100 {
        bench.ask(drive, &rtu::read(1, 0, 1));
        if n % 10 == 0 {
            recording.follow(bench.trace()).unwrap();
            bench.mark_written();
            assert!(bench.trace().events().len() < 60, "{}", bench.trace().events().len());
        }
    }
    let text = String::from_utf8(recording.finish(bench.trace()).unwrap()).unwrap();
    assert_eq!(text.matches("> rx 01 03 00 00 00 01 84 0A").count(), 100);
    let trace = Trace::parse(&text, &make).unwrap();
    assert_eq!(replay::run(&trace, &make), Ok(None));
}
