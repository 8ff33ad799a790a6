//! Closed loop (MC 5-18, 5-21, 5-56, 5-68, 5-69, 7.3.4, 7.3.7): everything in counts, stalls by a shaft that is held.

use standin_firmware::device::Encoder;
use standin_protocol::time::Span;
use standin_sim::file;

use crate::rig::{Kind, Rig};

fn closed_loop() -> Rig {
    let mut rig = Rig::new(Kind::Plus);
    rig.set(&["EE=1", "MT=50"]);
    rig
}

/// MC 7.3.7: 7,168 counts are three and a half turns, of 51,200 steps.
#[test]
fn moves_are_in_counts() {
    let mut rig = closed_loop();
    rig.set(&["MR 7168"]);
    rig.wait_still(10.secs());
    let position = rig.value("P");
    assert!((position - 7_168).abs() <= 10, "within the deadband: {position}");
    rig.assert_values(&[("C2", position), ("ER", 0), ("ST", 0)]);
    let steps = rig.value("C1");
    assert!((steps - 179_200).abs() <= 250, "{steps}");
    rig.set(&["P=0", "MA 2048"]);
    rig.wait_still(10.secs());
    assert!((rig.value("P") - 2_048).abs() <= 10);
}

/// A slew of 7,168 counts/s, and V in counts.
#[test]
fn slews_are_in_counts() {
    let mut rig = closed_loop();
    rig.set(&["SL 7168"]);
    rig.after(2.secs());
    rig.assert_values(&[("V", 7_168)]);
    let before = rig.value("P");
    rig.after(1.secs());
    let counted = rig.value("P") - before;
    assert!((counted - 7_168).abs() <= 4, "{counted}");
    let speed = rig.speed();
    assert!((speed - 7_168.0 * 25.0).abs() < 2.0, "{speed} steps/s");
}

/// SM = 0: it stops; ST is 1 until it is set to 0, ER 86 (MC 5-68, 5-70).
#[test]
fn a_stall_stops() {
    let mut rig = closed_loop();
    rig.set(&["S4=19,0,0", "SL 2048"]);
    rig.after(1.secs());
    assert_eq!(rig.value("ST"), 0);
    rig.fault("stall", true);
    rig.after(1.secs());
    rig.assert_values(&[("ST", 1), ("V", 0), ("MV", 0), ("EF", 1)]);
    assert_eq!(rig.word(0x007B), 1);
    assert_eq!(rig.value("ER"), 86);
    rig.fault("stall", false);
    rig.set(&["ST=0"]);
    rig.assert_values(&[("ST", 0)]);
}

/// SM = 1: it goes on.
#[test]
fn a_stall_is_noted_only() {
    let mut rig = closed_loop();
    rig.set(&["SM=1", "SL 2048"]);
    rig.after(1.secs());
    rig.fault("stall", true);
    rig.after(500.millis());
    rig.assert_values(&[("ST", 1), ("ER", 86), ("V", 2_048), ("MV", 1)]);
}

/// Only with EE = 1 (MC 5-70).
#[test]
fn open_loop_does_not_look() {
    let mut rig = Rig::plus();
    rig.set(&["SL 51200"]);
    rig.after(500.millis());
    rig.fault("stall", true);
    rig.after(1.secs());
    rig.assert_values(&[("ST", 0), ("ER", 0), ("V", 51_200)]);
    // What the encoder sees stands still.
    let before = rig.value("C2");
    rig.after(500.millis());
    assert!((rig.value("C2") - before).abs() <= 8);
}

/// A turn of the shaft has one index, and HI finds it (MC 5-29).
#[test]
fn the_index_is_a_home() {
    for home in 1..=4 {
        let mut rig = Rig::plus();
        rig.set(&["VM=51200", "MR 10000"]);
        rig.wait_still(2.secs());
        rig.set(&[&format!("HI {home}")]);
        rig.assert_values(&[("MV", 1)]);
        rig.wait_still(10.secs());
        rig.assert_values(&[("ER", 0), ("V", 0), ("I6", 0)]);
        let here = i64::from(rig.motion().position).rem_euclid(51_200);
        // A mark is a count wide or a little more: 25 steps each.
        assert!(here <= 200 || here >= 51_000, "{here} steps from where the shaft began");
    }
}

/// A remote encoder at A and B counts from its first edge on, either way, also with an odd number of edges.
#[test]
fn a_remote_encoder_loses_no_count() {
    let mut rig = Rig::new(Kind::Plus);
    let mut count = 0;
    for counts in [4, 7, -12, 100, -1] {
        count += counts;
        rig.turn(Encoder(0), counts);
        rig.assert_values(&[("C2", count.into())]);
    }
}

/// A drive whose motor, of 1 N·m at 100 %, a bench file describes.
fn loaded(load: &str, set: &str) -> Rig {
    let text = format!(
        "[[drive]]\nname = \"x\"\nkind = \"mdrive\"\nfast_boot = true\nlisten = []\nset = {{ {set} }}\n\
         [[motor]]\nname = \"m\"\ndrive = \"x\"\nholding_mnm = 1000\n{load}\n"
    );
    let layout = file::parse(&text).unwrap_or_else(|error| panic!("{error}"));
    let built = layout.build(layout.settings(), Vec::new()).unwrap_or_else(|error| panic!("{error}"));
    let mut rig = Rig::of(Kind::Plus, built.bench, built.seats[0]);
    rig.say("EM=2");
    rig.set(&["EE=1"]);
    rig
}

/// Of the 1,000 mN·m RC = 25 gives 250: 240 for a load or friction, and what accelerates 400 g·cm², 5 mN·m, besides.
/// The speed takes little of it: 1,024 counts/s are 30 rpm of 3,000. The shaft of the bench does as the drive's own.
#[test]
fn a_load_that_is_too_heavy_is_a_stall() {
    for (load, set, stalls) in [
        ("load_mnm = 200", "", false),
        ("load_mnm = 300", "", true),
        ("friction_mnm = 300", "", true),
        ("friction_mnm = 300", "RC = 50", false),
        ("friction_mnm = 300", "Friction = 100", false),
        ("load_mnm = 50\ninertia_gcm2 = 40000", "", true),
        ("load_mnm = 50\ninertia_gcm2 = 40000", "A = 200000, D = 200000", false),
    ] {
        let mut rig = loaded(load, set);
        rig.set(&["VM=1024"]);
        rig.say("MR 2048");
        rig.wait_still(10.secs());
        let behind = rig.value("C1") / 25 - rig.value("C2");
        assert_eq!(behind != 0, stalls, "{load}, {set}: {behind} counts behind");
        rig.assert_values(&[("ST", stalls.into()), ("ER", if stalls { 86 } else { 0 })]);
        let motor = rig.bench.motors().next().expect("a motor");
        let turned = (rig.bench.turn(motor).revolutions * 2_048.0).round() as i64;
        if set != "Friction = 100" {
            assert_eq!(turned, rig.value("C2"), "{load}, {set}: what the shaft has turned");
        }
    }
}

/// Said while it moves, and gone again; power and FD do not lighten a load.
#[test]
fn a_load_comes_and_goes() {
    let mut rig = closed_loop();
    let row = |rig: &Rig, name: &str| rig.bench.spec(rig.seat).find(name).expect("a setting").row;
    let put = |rig: &mut Rig, name: &str, value: i64| {
        let row = row(rig, name);
        assert_eq!(rig.bench.poke(rig.seat, row, value), Ok(()), "{name} = {value}");
    };
    put(&mut rig, "HoldingTorque", 1_000);
    rig.set(&["SL 2048"]);
    rig.after(1.secs());
    put(&mut rig, "Load", -260);
    rig.after(1.secs());
    rig.assert_values(&[("ST", 1), ("V", 0), ("ER", 86)]);
    rig.power_cycle();
    rig.say("FD");
    rig.after(1.secs());
    rig.say("EM=2");
    rig.heard();
    rig.set(&["EE=1"]);
    rig.say("SL 2048");
    rig.after(1.secs());
    rig.assert_values(&[("ST", 1), ("ER", 86)]);
    put(&mut rig, "Load", 0);
    rig.set(&["ST=0", "SL 2048"]);
    rig.after(1.secs());
    rig.assert_values(&[("ST", 0), ("V", 2_048), ("ER", 0)]);
}
