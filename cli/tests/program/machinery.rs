//! Ten minutes of a motor with an encoder and two switches, in manual time.

use crate::running::{Running, Scratch, ask};

/// A turn has 1,600 steps (of 1/8 of a full step) and 100 counts. The rates are chosen so that all times are
/// exact.
const BENCH: &str = r#"
time = "manual"

[[drive]]
name = "reader"
kind = "qsb-m"
fast_boot = true
set = { Mdr0 = 0x43 }

[[drive]]
name = "stepper"
kind = "md3"
fast_boot = true
listen = []
set = { MoveSteps = 9_580_000, Speed = 16_000, AccelDecel = 100_000 }

[[motor]]
name = "m"
drive = "stepper"

[[encoder]]
motor = "m"
cycles_per_rev = 25
to = { a = "reader.A", b = "reader.B" }

[[switch]]
motor = "m"
closed = { above_rev = 1000, below_rev = 1000.5 }
to = "reader.DIO0"

[[switch]]
motor = "m"
closed = { above_rev = 5000 }
to = "reader.DIO1"
"#;

/// Time at which the shaft has made `turns` turns, in seconds since its start. It accelerates to 16,000
/// steps/s in 0.16 s, which are 1,280 steps.
fn comes_to(turns: f64) -> f64 {
    0.16 + (turns * 1_600.0 - 1_280.0) / 16_000.0
}

#[test]
fn ten_minutes_of_a_motor_with_encoder_and_switches() {
    let scratch = Scratch::new("machinery");
    let file = scratch.file("bench.toml");
    std::fs::write(&file, BENCH).unwrap();
    let bench = Running::bench(&file, &[]);
    bench.advance(0.5);
    let moves = "/api/drives/stepper/registers/MotionControl";
    assert_eq!(bench.call("PUT", moves, "{\"value\":1}").status, 204);
    let turn = bench.call("GET", "/api/drives/stepper", "").ok()["motion"].clone();
    assert_eq!(turn["moving"], true);
    bench.advance(600.0);
    let turn = bench.call("GET", "/api/drives/stepper", "").ok()["motion"].clone();
    assert_eq!((&turn["position"], &turn["moving"]), (&9_580_000.into(), &false.into()));

    // 5,987.5 turns are 598,750 counts. The shaft stops exactly half a count before the next edge.
    let mut line = bench.connect();
    let reply = ask(&mut line, b"R0E\r", "r 0E 00000000 !\r\n".len());
    assert_eq!(String::from_utf8(reply).unwrap(), format!("r 0E {:08X} !\r\n", 598_750));

    let trace = bench.call("GET", "/api/trace?format=trace", "");
    assert_eq!(trace.status, 200);
    let fed = |what: &'static str| trace.body.lines().filter(move |line| line.contains(what));
    let edges = |pin: &'static str| {
        let edges = fed(pin).map(|line| {
            let (ms, level) = (line.split(' ').next().unwrap(), line.split(' ').next_back().unwrap());
            (ms.parse::<f64>().unwrap() / 1_000.0, level == "high")
        });
        edges.collect::<Vec<_>>()
    };
    let poke = fed("> poke MotionControl").next().unwrap();
    let start = poke.split(' ').next().unwrap().parse::<f64>().unwrap() / 1_000.0;
    for (pin, expected) in [
        (" reader > pin DIO0 ", &[(comes_to(1_000.0), false), (comes_to(1_000.5), true)][..]),
        (" reader > pin DIO1 ", &[(comes_to(5_000.0), false)]),
    ] {
        let edges = edges(pin);
        assert_eq!(edges.len(), expected.len(), "{pin}: {edges:?}");
        for (edge, expected) in edges.iter().zip(expected) {
            assert_eq!(edge.1, expected.1, "{pin}");
            // The motor gets the plan a tick late, the reader gets the edge a tick late, and up to a tick
            // passes until the shaft is past the position.
            let late = edge.0 - start - expected.0;
            assert!((0.0..0.5e-6).contains(&late), "{pin} is {late} s late");
        }
    }
    // Edges alternate between the two channels.
    assert_eq!([" reader > pin A ", " reader > pin B "].map(|pin| fed(pin).count()), [299_375, 299_375]);
}
