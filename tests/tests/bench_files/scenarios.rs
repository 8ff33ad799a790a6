//! Scenarios of bench files: when their steps happen, and what a trace of them replays.

use drivetwin_firmware::device::{Axis, Duration, Instant, Level, Port};
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::Span;
use drivetwin_sim::bench::{Bench, DriveId, Outlet};
use drivetwin_sim::config::bench_file::parse_scenarios;
use drivetwin_sim::line::faults::FaultRule;
use drivetwin_sim::record::trace::Trace;
use drivetwin_sim::{catalog, replay};

use crate::{built, seat};

/// An MD3, and an MDrive with both of its ports.
const DRIVES: &str = r#"
    [[drive]]
    name = "x"
    kind = "md3"
    fast_boot = true

    [[drive]]
    name = "m"
    kind = "mdrive"
    fast_boot = true

    [[drive]]
    name = "q"
    kind = "qsb-m"
    fast_boot = true
"#;

/// The bench with a scenario of these steps, and its MD3.
#[track_caller]
fn played(steps: &str) -> (Bench, DriveId) {
    let bench = built(&format!("{DRIVES}\n[[scenario]]\nsteps = [{steps}]")).bench;
    let x = seat(&bench, "x");
    (bench, x)
}

/// The level at a pin.
fn level(bench: &Bench, drive: DriveId, pin: &str) -> Level {
    bench.level(drive, bench.spec(drive).pin(pin).unwrap())
}

fn faulty(bench: &Bench, drive: DriveId, name: &str) -> bool {
    let fault = bench.spec(drive).faults.iter().position(|fault| *fault == name).unwrap();
    bench.faulty(drive, drivetwin_firmware::device::Fault(fault as u8))
}

/// The trace is replayed exactly, without the scenario.
#[track_caller]
fn replays(bench: &mut Bench) {
    bench.run_until(bench.now());
    let make = |kind: &str| catalog::make(kind).ok();
    let trace = Trace::parse(&bench.trace().to_text(), &make).unwrap();
    assert_eq!(replay::run(&trace, &make), Ok(None));
}

/// Runs to an instant, and one tick beyond it, where a pin has changed.
fn go(bench: &mut Bench, at: Instant) {
    bench.run_until(at + Duration::TICK);
}

#[test]
fn steps_are_at_their_times() {
    let (mut bench, x) = played(
        r#"{ at_s = 1, pin = "x.J2.3", level = "low" },
           { after_ms = 5.5, drive = "x", fault = "over_temperature" },
           { pin = "x.J2.3", level = "open" },
           { at_s = 2, drive = "x", clear = "over_temperature" },
           { after_ms = 1, drive = "x", power = "off" },
           { after_ms = 10, drive = "x", power = "on" },
           { at_s = 3, bus = "rs485", faults = { drop = 1 } },
           { at_s = 4, bus = "x.rs485", faults = {} }"#,
    );
    let at = |micros: u64| Instant::ZERO + Duration::micros(micros);
    let pin = "J2.3";
    go(&mut bench, at(999_999));
    assert_eq!(level(&bench, x, pin), Level::High);
    go(&mut bench, at(1_000_000));
    assert_eq!(level(&bench, x, pin), Level::Low);
    go(&mut bench, at(1_005_499));
    assert!(!faulty(&bench, x, "over_temperature") && level(&bench, x, pin) == Level::Low);
    go(&mut bench, at(1_005_500));
    assert!(faulty(&bench, x, "over_temperature") && level(&bench, x, pin) == Level::High);
    go(&mut bench, at(2_000_000));
    assert!(!faulty(&bench, x, "over_temperature") && bench.powered(x));
    go(&mut bench, at(2_001_000));
    assert!(!bench.powered(x));
    go(&mut bench, at(2_011_000));
    assert!(bench.powered(x));
    let line = bench.outlet(x, Port(0));
    go(&mut bench, at(2_999_999));
    assert_eq!(bench.faults(line).drop, FaultRule::NONE);
    go(&mut bench, at(3_000_000));
    assert_eq!(bench.faults(line).drop, FaultRule::ALL);
    go(&mut bench, at(4_000_000));
    assert_eq!(bench.faults(line).drop, FaultRule::NONE);
    replays(&mut bench);
}

/// Only an accepted write of the register, with the value, by a master counts. Speed of an MD3 is 0x14 and
/// 0x15, MotionControl 0x11 (7.1).
#[test]
fn a_step_waits_for_a_write() {
    let (mut bench, x) = played(
        r#"{ when = { drive = "x", register = "Speed", value = 9000 }, after_ms = 20, drive = "x", power = "off" }"#,
    );
    bench.run_until(1.secs());
    let speed = bench.spec(x).find("Speed").unwrap().row;
    bench.poke(x, speed, 9_000).unwrap();
    let no_writes = [
        rtu::read(1, 0x14, 2).to_vec(),
        rtu::write(1, 0x15, 8_000).to_vec(),
        // The low word alone is 9,000, but the whole value is not.
        rtu::frame(1, &[16, 0, 0x14, 0, 2, 4, 0, 1, 0x23, 0x28]).to_vec(),
        rtu::write(1, 0x15, 8_000).to_vec(),
        // Another register, another address, and a value that the MD3 refuses.
        rtu::write(1, 0x1D, 9_000).to_vec(),
        rtu::write(2, 0x15, 9_000).to_vec(),
        rtu::write(1, 0x0B, 9_000).to_vec(),
    ];
    for request in no_writes {
        bench.ask(x, &request);
        bench.run_until(bench.now() + 50.millis());
        assert!(bench.powered(x), "{request:02X?}");
    }
    assert_eq!(bench.ask(x, &rtu::write(1, 0x15, 9_000)), rtu::write(1, 0x15, 9_000)[..]);
    assert!(bench.powered(x));
    bench.run_until(bench.now() + 20.millis());
    assert!(!bench.powered(x));
    replays(&mut bench);
}

/// The faults of the line begin after the reply to the write, and the write starts the rest of the scenario
/// only once.
#[test]
fn a_write_is_answered_before_the_step() {
    let (mut bench, x) = played(
        r#"{ when = { drive = "x", register = "Speed" }, bus = "x.rs485", faults = { mute = { count = 2 } } },
           { when = { drive = "x", register = "Speed" }, after_ms = 100, pin = "x.J2.3", level = "low" }"#,
    );
    bench.run_until(1.secs());
    let write = |bench: &mut Bench| {
        let reply = bench.ask(x, &rtu::write(1, 0x15, 9_000));
        bench.run_until(bench.now() + 10.millis());
        reply.len()
    };
    assert_eq!(write(&mut bench), 8);
    // The second step waits for a write that is executed, also if its reply is lost.
    let asked = bench.now();
    assert_eq!(write(&mut bench), 0);
    bench.run_until(asked + Duration::millis(100));
    assert_eq!(level(&bench, x, "J2.3"), Level::High);
    // The request takes 9 ms.
    bench.run_until(asked + Duration::millis(115));
    assert_eq!(level(&bench, x, "J2.3"), Level::Low);
    assert_eq!((write(&mut bench), write(&mut bench)), (0, 8));
    replays(&mut bench);
}

/// Modbus/TCP (VM is 0x008B), MCode, and the commands of a QSB (register 03 is MDR0, Mdr0 here).
#[test]
fn writes_come_from_every_transport() {
    for (drive, port, register, request) in [
        ("m", 0, "VM", &[0, 1, 0, 0, 0, 11, 1, 16, 0, 0x8B, 0, 2, 4, 0, 1, 0x30, 0][..]),
        ("m", 1, "VM", b"VM=77777\r"),
        ("q", 0, "Mdr0", b"W0343\r"),
    ] {
        let (mut bench, x) = played(&format!(
            r#"{{ when = {{ drive = "{drive}", register = "{register}" }}, pin = "x.J2.3", level = "low" }}"#
        ));
        bench.run_until(4.secs());
        let master = bench.connect_to(seat(&bench, drive), Port(port)).unwrap();
        assert_eq!(level(&bench, x, "J2.3"), Level::High);
        bench.send(master, request);
        bench.run_until(bench.now() + 100.millis());
        assert_eq!(level(&bench, x, "J2.3"), Level::Low, "{drive}:{port}");
        replays(&mut bench);
    }
}

#[test]
fn pulses_and_voltages_and_tcp_ports() {
    let (mut bench, x) = played(
        r#"{ at_s = 4, bus = "m.modbus", faults = { close = { count = 1, drive = "m" } } },
           { pin = "q.I", pulses = 3, hz = 1000 },
           { pin = "m.ANALOG", volts = 2.5 }"#,
    );
    let (m, q) = (seat(&bench, "m"), seat(&bench, "q"));
    bench.run_until(5.secs());
    let close = bench.faults(Outlet::Tcp(m, Port(0))).close;
    assert_eq!(close, FaultRule::next(1).drive(m));
    let text = bench.trace().to_text();
    assert!(text.lines().any(|line| line.contains(" m ") && line.contains("2500")), "{text}");
    let index = bench.spec(q).pin("I").unwrap();
    let edges = text.lines().filter(|line| line.contains(" q > ") && line.contains(" I ")).count();
    assert!(edges == 6, "{edges} edges at pin {index:?}");
    assert_eq!(bench.motion(x, Axis(0)).position, 0);
    replays(&mut bench);
}

#[test]
fn ended_scenarios_make_room_for_others() {
    let mut bench = built(DRIVES).bench;
    let off = parse_scenarios("[[scenario]]\nsteps = [{ after_ms = 1, drive = 'x', power = 'off' }]", &bench)
        .unwrap();
    for _ in 0..1_000 {
        bench.play(off[0].clone()).unwrap();
    }
    let full = "a bench plays 1000 scenarios at once; wait until one has ended";
    assert_eq!(bench.play(off[0].clone()), Err(full.to_owned()));
    bench.run_until(bench.now() + Duration::millis(1));
    for _ in 0..1_000 {
        bench.play(off[0].clone()).unwrap();
    }
    assert_eq!(bench.play(off[0].clone()), Err(full.to_owned()));
}

#[test]
fn numbered_scenarios_are_all_played_or_none() {
    let mut bench = built("[[drive]]\nname = 'x{1..600}'\nkind = 'qsb-d'\nlisten = []").bench;
    let text = "[[scenario]]\nsteps = [{ after_ms = 1, drive = 'x{1..600}', power = 'off' }]";
    let all = parse_scenarios(text, &bench).unwrap();
    assert_eq!(all.len(), 600);
    bench.play_all(all.clone()).unwrap();
    assert!(bench.play_all(all.clone()).is_err());
    bench.play_all(all[..400].to_vec()).unwrap();
    assert!(bench.play(all[0].clone()).is_err());
    bench.run_until(bench.now() + Duration::millis(1));
    let on = bench.drives().filter(|&drive| bench.powered(drive)).count();
    assert_eq!(on, 0);
    bench.play_all(all).unwrap();
}

#[test]
fn a_text_of_scenarios_has_no_other_tables() {
    let bench = built(DRIVES).bench;
    let wrong = parse_scenarios("[[drive]]\nname = 'y'\nkind = 'md3'", &bench).unwrap_err();
    assert_eq!(
        wrong.to_string(),
        "line 1, column 3: there is no key of a bench file 'drive'; available: scenario"
    );
}
