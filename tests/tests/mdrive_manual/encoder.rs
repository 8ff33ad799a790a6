//! Closed loop (MC 5-18, 5-21, 5-56, 5-68, 5-69, 7.3.4, 7.3.7): values in counts, and stalls while the test
//! holds the shaft.

use drivetwin_firmware::device::Encoder;
use drivetwin_protocol::time::Span;
use drivetwin_sim::config::bench_file;

use crate::rig::{Kind, Rig};

fn closed_loop() -> Rig {
    let mut rig = Rig::new(Kind::Plus);
    rig.set(&["EE=1", "MT=50"]);
    rig
}

/// MC 7.3.7: 7,168 counts are three and a half turns of 51,200 steps.
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

/// A slew of 7,168 counts/s, with V in counts/s.
#[test]
fn slews_are_in_counts() {
    let mut rig = closed_loop();
    rig.set(&["SL 7168"]);
    rig.after(2.secs());
    rig.assert_values(&[("V", 7_168)]);
    let before = rig.peek("P");
    rig.after(1.secs());
    let counted = rig.peek("P") - before;
    assert!((counted - 7_168).abs() <= 4, "{counted}");
    let speed = rig.speed();
    assert!((speed - 7_168.0 * 25.0).abs() < 2.0, "{speed} steps/s");
}

/// SM = 0: a stall stops the motor. ST is 1 until 0 is written, ER is 86 (MC 5-68, 5-70).
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

/// SM = 1: the motion continues after a stall.
#[test]
fn a_stall_is_noted_only() {
    let mut rig = closed_loop();
    rig.set(&["SM=1", "SL 2048"]);
    rig.after(1.secs());
    rig.fault("stall", true);
    rig.after(500.millis());
    rig.assert_values(&[("ST", 1), ("ER", 86), ("V", 2_048), ("MV", 1)]);
    // "The motor will try to continue the move."
    rig.fault("stall", false);
    rig.after(10.millis());
    rig.set(&["ST=0"]);
    let position = rig.peek("C2");
    rig.after(1.secs());
    assert!((rig.peek("C2") - position - 2_048).abs() <= 1);
    rig.assert_values(&[("ST", 0), ("ER", 0), ("V", 2_048)]);
    // A second stall is noted, too.
    rig.fault("stall", true);
    rig.after(100.millis());
    rig.assert_values(&[("ST", 1), ("ER", 86), ("V", 2_048)]);
}

/// A move that stalls for half a second still ends at its target: the drive corrects the missing counts
/// (MC 5-18, 5-69).
#[test]
fn a_move_goes_on_after_a_stall() {
    for target in [8_192, -8_192] {
        let mut rig = closed_loop();
        rig.set(&["SM=1", "VM=2048", "VI=1000", &format!("MA {target}")]);
        rig.after(1.secs());
        rig.fault("stall", true);
        rig.after(500.millis());
        rig.fault("stall", false);
        rig.after(100.millis());
        let held = rig.value("P");
        rig.after(500.millis());
        assert!((rig.value("P") - held).abs() > 1_000, "it goes on before its end");
        rig.wait_still(20.secs());
        assert!((rig.value("P") - target).abs() <= 10, "{}", rig.value("P"));
        rig.assert_values(&[("ST", 1), ("ER", 86)]);
    }
}

/// The drive detects stalls only with EE = 1 (MC 5-70).
#[test]
fn open_loop_does_not_look() {
    let mut rig = Rig::plus();
    rig.set(&["SL 51200"]);
    rig.after(500.millis());
    rig.fault("stall", true);
    rig.after(1.secs());
    rig.assert_values(&[("ST", 0), ("ER", 0), ("V", 51_200)]);
    // The shaft with the encoder does not move.
    let before = rig.value("C2");
    rig.after(500.millis());
    assert!((rig.value("C2") - before).abs() <= 8);
}

/// A turn of the shaft has one index mark, and HI finds it (MC 5-29).
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
        // The mark is one count wide or a little more; a count is 25 steps.
        assert!(here <= 200 || here >= 51_000, "{here} steps from where the shaft began");
    }
}

/// A remote encoder at A and B counts from its first edge, in both directions, also after an odd number of
/// edges.
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

/// A drive with a motor that a bench file describes: 1 N·m at 100 % current.
fn loaded(load: &str, set: &str) -> Rig {
    let text = format!(
        "[[drive]]\nname = \"x\"\nkind = \"mdrive\"\nfast_boot = true\nlisten = []\nset = {{ {set} }}\n\
         [[motor]]\nname = \"m\"\ndrive = \"x\"\nholding_mnm = 1000\n{load}\n"
    );
    let layout = bench_file::parse(&text).unwrap_or_else(|error| panic!("{error}"));
    let built = layout.build(layout.settings(), Vec::new()).unwrap_or_else(|error| panic!("{error}"));
    let mut rig = Rig::of(Kind::Plus, built.bench, built.drives[0]);
    rig.say("EM=2");
    rig.set(&["EE=1"]);
    rig
}

/// RC = 25 gives 250 of the 1,000 mN·m: 240 for a load or friction, in addition to the 5 mN·m that accelerate
/// 400 g·cm². The speed reduces the torque only a little: 1,024 counts/s are 30 rpm of 3,000. The shaft on
/// the bench moves as the drive's own.
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
        // The holding torque at rest is more than any of these loads.
        let hold = if set.is_empty() { "HC = 40".to_owned() } else { format!("HC = 40, {set}") };
        let mut rig = loaded(load, &hold);
        rig.set(&["VM=1024"]);
        rig.say("MR 2048");
        rig.wait_still(10.secs());
        let behind = rig.peek("C1") / 25 - rig.peek("C2");
        assert_eq!(behind != 0, stalls, "{load}, {set}: {behind} counts behind");
        rig.assert_values(&[("ST", stalls.into()), ("ER", if stalls { 86 } else { 0 })]);
        let motor = rig.bench.motors().next().expect("a motor");
        let turned = (rig.bench.turn(motor).revolutions * 2_048.0).round() as i64;
        if set != "Friction = 100" {
            assert_eq!(turned, rig.peek("C2"), "{load}, {set}: what the shaft has turned");
        }
    }
}

/// A load is set while the motor moves, and later removed. A power cycle and FD leave it unchanged.
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
    // The holding current and friction stop the shaft, which the load has turned.
    put(&mut rig, "Load", 0);
    rig.after(1.secs());
    rig.set(&["ST=0", "SL 2048"]);
    rig.after(1.secs());
    rig.assert_values(&[("ST", 0), ("V", 2_048), ("ER", 0)]);
}

/// A holding torque of HC, 1 N·m at 100 %, and a friction of 10 mN·m hold the shaft. Without current (HC = 0
/// or DE = 0) only friction holds it. Each mN·m above that accelerates 400 g·cm² by 25 rad/s², 40.7 counts in
/// 0.1 s, up to 3,000 rpm. A motor of the bench behaves as the drive's own.
#[test]
fn a_load_turns_a_shaft_that_nothing_holds() {
    for (hold, enabled, holds) in [(5, 1, 60), (30, 1, 310), (0, 1, 10), (30, 0, 10)] {
        for (more, counts) in [(-1, 0.0), (1, 40.7), (10, 407.4)] {
            for way in [1, -1] {
                let mut rig = loaded("", &format!("HC = {hold}"));
                rig.set(&[&format!("DE={enabled}")]);
                let row = rig.bench.spec(rig.seat).find("Load").expect("a setting").row;
                assert_eq!(rig.bench.poke(rig.seat, row, way * (holds + more)), Ok(()));
                rig.after(100.millis());
                let counted = rig.peek("C2");
                let expected = -way as f64 * counts;
                let what = format!("HC {hold}, DE {enabled}, {}", way * (holds + more));
                assert!((counted as f64 - expected).abs() <= 1.5, "{what}: {counted}, not {expected}");
                rig.assert_values(&[("C1", 0), ("V", 0), ("MV", 0), ("ER", 0)]);
            }
        }
    }
    // A load from the bench file, for a minute: 50 turns/s.
    let mut rig = loaded("load_mnm = -200", "HC = 30");
    rig.set(&["DE=0"]);
    rig.after(60.secs());
    let (counts, motor) = (rig.value("C2"), rig.bench.motors().next().expect("a motor"));
    let turn = rig.bench.turn(motor);
    assert!((3_000.0 - turn.rpm).abs() < 0.01, "{turn:?}");
    assert!((counts as f64 / 2_048.0 - turn.revolutions).abs() < 0.01, "{counts}, {turn:?}");
    assert!((2_995.0..3_000.0).contains(&turn.revolutions), "{turn:?}");
}

/// "The motor will be driven back to its final position if it was forced out of position" (MC 7-23). This
/// begins when DE is 1 again. The speed is VI, and the shaft stops within DB. The shaft stays away if PM is
/// 0, or if SM is 0 and it is SF counts away.
#[test]
fn position_maintenance_brings_the_shaft_back() {
    for (set, comes_back) in [
        (["PM=1", "SM=1", "SF=15"], true),
        (["PM=1", "SM=0", "SF=65000"], true),
        (["PM=1", "SM=0", "SF=15"], false),
        (["PM=0", "SM=1", "SF=15"], false),
    ] {
        for load in [50, -50] {
            let mut rig = loaded(&format!("load_mnm = {load}"), "HC = 20");
            rig.set(&["MT=50", "VI=1000"]);
            rig.set(&set);
            rig.after(1.secs());
            rig.assert_values(&[("C2", 0)]);
            rig.set(&["DE=0"]);
            rig.after(50.millis());
            let away = rig.value("C2");
            assert!(away.abs() > 300 && away.signum() == -i64::from(load).signum(), "{away}");
            rig.say("DE=1");
            rig.wait_still(20.secs());
            rig.after(2.secs());
            let away = rig.value("C2").abs();
            assert!(if comes_back { away <= 10 } else { away > 300 }, "{set:?}: {away} counts away");
            if set[1] == "SM=0" {
                rig.assert_values(&[("ST", (!comes_back).into()), ("ER", if comes_back { 0 } else { 86 })]);
            }
        }
    }
}

/// With `steps_per_rev` of a bench file, MS times that number is a turn of C1, and 4 × EL a turn of C2. MS
/// must be at least EL × 8 divided by that number (MC 5-21, 7.3.1).
#[test]
fn a_motor_of_other_full_steps_has_other_steps_in_a_turn() {
    for (full_steps, least) in [(400, 11), (100, 41), (48, 86), (2_000, 3)] {
        for resolution in [256, 8, 10, 50] {
            let mut rig = loaded(&format!("steps_per_rev = {full_steps}"), "");
            // One turn a second.
            let steps = full_steps * resolution;
            rig.set(&["EE=0", &format!("MS={resolution}"), &format!("VI={}", steps / 10)]);
            rig.set(&[&format!("VM={steps}"), &format!("A={}", 5 * steps), &format!("D={}", 5 * steps)]);
            rig.set(&[&format!("MR {steps}")]);
            rig.wait_still(100.secs());
            rig.after(10.millis());
            rig.assert_values(&[("C2", 2_048), ("C1", steps)]);
            let motor = rig.bench.motors().next().expect("a motor");
            assert!((rig.bench.turn(motor).revolutions - 1.0).abs() < 1e-6);
            rig.say("EE=1");
            rig.assert_values(&[("ER", if resolution < least { 36 } else { 0 })]);
            if resolution < least {
                continue;
            }
            rig.set(&["MT=50", "MR 2048"]);
            rig.wait_still(100.secs());
            assert!((rig.value("C2") - 4_096).abs() <= 1);
            assert!((rig.bench.turn(motor).revolutions - 2.0).abs() < 0.001);
            rig.assert_values(&[("ST", 0), ("ER", 0)]);
        }
    }
}
