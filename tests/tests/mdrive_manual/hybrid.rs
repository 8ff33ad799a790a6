//! The Hybrid (MC 5-2 to 5-11, 5-41 to 5-50, 5-67, 5-71 to 5-76, 9.6, 9.7).

use drivetwin_protocol::time::Span;
use drivetwin_sim::bench::Setup;
use drivetwin_sim::config::bench_file;

use crate::rig::{CALIBRATION, Kind, Rig, START};

/// Bits of AF (MC 5-2).
const LOCKED: i64 = 8;
const CALIBRATED: i64 = 128;

/// At power-on a Hybrid calibrates for 3.12 s if CT is 250 (MC 5-9). If CT is 200, the time is shorter by
/// three times 50 ms.
#[test]
fn it_calibrates_at_power_on() {
    let mut rig = Rig::set_up(Kind::Hybrid, Setup::default());
    rig.say("EM=2");
    rig.heard();
    assert_eq!(rig.value("AF") & CALIBRATED, 0);
    rig.refused("MR 100", 88);
    rig.refused("AS=1", 87);
    assert_eq!(rig.try_write(0x0043, &[0, 100]), Err(4));
    assert_eq!(rig.ef_er(), (1, 88));
    rig.wait(CALIBRATION, 1.millis(), |rig| rig.word(0x008F) & CALIBRATED as u16 != 0);
    // At power-on the drive sends the sign-on message when the calibration is complete (MC 5-9).
    rig.after(1.millis());
    assert!(rig.heard().contains(crate::rig::SIGN_ON));
    rig.assert_values(&[("C1", 0), ("ER", 0)]);
    // A calibration moves three full steps forward: 3/200 of a turn of 4,000 counts (MC 5-9, 5-22).
    let counts = rig.value("C2");
    assert!((counts - 60).abs() <= 2, "{counts}");
    rig.set(&["MR 1000"]);
}

/// MC 5-8, 5-67: SC, CF, AS from 0, DE from 0 and MS start a calibration.
#[test]
fn commands_that_calibrate() {
    let mut rig = Rig::hybrid();
    rig.set(&["CT=250"]);
    for line in ["SC", "CF", "AS=1", "DE=1", "MS=128"] {
        rig.set(&["AS=0", "DE=0"]);
        rig.set(if line == "AS=1" {
            &["DE=1"][..]
        } else if line == "DE=1" {
            &["AS=2"]
        } else {
            &["DE=1", "AS=2"]
        });
        rig.after(CALIBRATION);
        rig.set(&[line]);
        assert_eq!(rig.value("AF") & CALIBRATED, 0, "{line}");
        let took = rig.wait(CALIBRATION, 1.millis(), |rig| rig.value("AF") & CALIBRATED != 0);
        let took = took.ticks() as f64 / 16e6;
        assert!((took - 3.12).abs() <= 0.01, "{line}: {took} s");
        rig.assert_values(&[("C1", 0), ("ER", 0)]);
    }
    for address in [0x00A1, 0x0093] {
        rig.write(address, 1);
        assert_eq!(rig.word(0x008F) & CALIBRATED as u16, 0, "{address:#06X}");
        rig.after(CALIBRATION);
    }
}

/// MC 9.6, errors 89 and 94.
#[test]
fn it_does_not_calibrate_while_it_moves() {
    let mut rig = Rig::hybrid();
    rig.set(&["SL 20000"]);
    rig.after(100.millis());
    rig.refused("SC", 89);
    rig.refused("CF", 94);
    assert_eq!(rig.try_write(0x00A1, &[1]), Err(4));
    assert_eq!(rig.ef_er(), (1, 89));
    assert_eq!(rig.try_write(0x0093, &[1]), Err(4));
    assert_eq!(rig.ef_er(), (1, 94));
    rig.assert_values(&[("V", 20_000)]);
}

/// MC 5-44, 9.7: if the rotor has not moved for LT ms, the bridge is off until CF.
#[test]
fn a_locked_rotor_disables_the_bridge() {
    let mut rig = Rig::hybrid();
    rig.set(&["SL 20000"]);
    rig.after(500.millis());
    rig.fault("locked_rotor", true);
    rig.after(3.secs());
    rig.assert_values(&[("LR", 1), ("EF", 1)]);
    assert_ne!(rig.value("AF") & LOCKED, 0);
    assert_eq!(rig.value("ER"), 104);
    assert_eq!(rig.word(0x009B), 1);
    rig.assert_values(&[("V", 0), ("MV", 0)]);
    rig.fault("locked_rotor", false);
    rig.set(&["CF"]);
    rig.after(CALIBRATION);
    rig.assert_values(&[("LR", 0)]);
}

/// MC 9.7, errors 106 and 107.
#[test]
fn limits_of_lead_and_lag_are_errors() {
    for (fault, error, bit) in [("lead_limit", 106, 1), ("lag_limit", 107, 2)] {
        let mut rig = Rig::hybrid();
        rig.set(&["SL 20000"]);
        rig.after(500.millis());
        rig.fault(fault, true);
        rig.after(100.millis());
        assert_ne!(rig.value("AF") & bit, 0, "{fault}");
        assert_eq!(rig.value("ER"), error, "{fault}");
    }
}

/// MC 5-38, 5-81, 9.5: error 71 above WT; with error 72 the drive is disabled.
#[test]
fn it_can_be_too_hot() {
    let mut rig = Rig::hybrid();
    let normal = rig.value("IT");
    assert!((-55..=125).contains(&normal));
    rig.refused("WT=85", 21);
    let printed = rig.say(&format!("WT={}", normal - 1));
    rig.after(2.secs());
    assert_eq!(printed + &rig.heard(), "Error 71\r\n");
    assert_eq!(rig.value("ER"), 71);
    rig.set(&["WT=80"]);
    // "10C to Shutdown", then "Disabling Drive".
    rig.fault("over_temperature", true);
    rig.wait(60.secs(), 100.millis(), |rig| rig.heard() == "Error 71\r\n");
    assert_eq!(rig.value("ER"), 71);
    rig.wait(60.secs(), 100.millis(), |rig| rig.value("ER") == 72);
    assert_eq!(rig.motion().current_ma, 0, "the bridge");
    // DE is 1 all the time. If DE is written after the drive has cooled, the bridge is on again, and the
    // drive calibrates (MC 5-9).
    rig.set(&["DE=1"]);
    rig.after(CALIBRATION);
    assert_eq!(rig.motion().current_ma, 0, "the bridge while it is hot");
    rig.fault("over_temperature", false);
    rig.after(120.secs());
    assert_eq!(rig.motion().current_ma, 0, "the bridge when it has cooled");
    rig.heard();
    rig.set(&["DE=1"]);
    rig.refused("MR 100", 88);
    rig.after(CALIBRATION);
    assert_eq!(rig.motion().current_ma, 150, "5 % of 3 A");
}

/// MC 9.4: "Startup Calibration failed (Hybrid only)". At power-on the error is not 109, which is for a later
/// calibration.
#[test]
fn a_calibration_at_power_on_fails_with_64() {
    let mut rig = Rig::set_up(Kind::Hybrid, Setup::default());
    rig.say("EM=2");
    rig.fault("calibration", true);
    rig.after(20.secs());
    rig.heard();
    assert_eq!(rig.value("ER"), 64);
    // AF: calibration complete, calibration fault, locked rotor (MC 5-2, 5-9).
    assert_eq!(rig.value("AF"), 256 + 128 + 8);
    // The register of AF has one byte (FB 5.1).
    assert_eq!(rig.word(0x008F), 128 + 8);
    rig.refused_after("SC", 109);
}

impl Rig {
    /// Sends a line that causes an error within 20 s.
    fn refused_after(&mut self, line: &str, error: i64) {
        self.set(&[line]);
        self.after(20.secs());
        assert_eq!(self.value("ER"), error, "{line}");
    }
}

/// MC 5-81: "the device will print an error 71 to the terminal screen if the set temperature is exceeded". It
/// prints the error once.
#[test]
fn a_warning_of_its_temperature_is_printed() {
    let mut rig = Rig::hybrid();
    rig.set(&["WT=50"]);
    rig.fault("over_temperature", true);
    rig.after(2.secs());
    assert_eq!(rig.heard(), "Error 71\r\n");
    rig.after(10.secs());
    assert_eq!(rig.heard(), "");
    assert_eq!(rig.value("ER"), 72);
}

/// MC 9.7: "Maximum position count reached". The counter is C1, "position counter", and its maximum
/// +2147483647 (MC 5-7).
#[test]
fn the_end_of_the_position_counter_is_error_105() {
    for (start, way, end) in
        [(2_147_483_000_i64, 647_i64, 2_147_483_647), (-2_147_483_000, -648, -2_147_483_648)]
    {
        let mut rig = Rig::hybrid();
        rig.set(&[&format!("P={start}"), &format!("MR {}", way - way.signum())]);
        rig.after(1.secs());
        rig.assert_values(&[("C1", end - way.signum()), ("ER", 0)]);
        rig.set(&[&format!("MR {}", way.signum())]);
        rig.after(1.secs());
        rig.assert_values(&[("C1", end), ("ER", 105)]);
        // The drive reports the error once; the count continues at the other end.
        rig.set(&[&format!("MR {}", 2 * way.signum())]);
        rig.after(1.secs());
        rig.assert_values(&[("C1", -end - 1 + way.signum()), ("ER", 0)]);
    }
    let mut rig = Rig::plus();
    rig.set(&["P=2147483000", "MR 1000"]);
    rig.after(1.secs());
    rig.assert_values(&[("ER", 0)]);
}

/// MC 5-8: "CA=0,1 'set torque compensation". The second value is a parameter like the first one and is saved
/// with it.
#[test]
fn both_values_of_ca_read_back() {
    let mut rig = Rig::hybrid();
    assert_eq!(rig.show("CA"), "1, 0");
    rig.set(&["CA=0,1"]);
    assert_eq!(rig.show("CA"), "0, 1");
    assert_eq!(rig.word(0x0090), 0);
    rig.set(&["S"]);
    rig.after(100.millis());
    rig.set(&["CA=1"]);
    assert_eq!(rig.show("CA"), "1, 0");
    rig.set(&["IP"]);
    assert_eq!(rig.show("CA"), "0, 1");
    rig.refused("CA=0,2", 21);
    assert_eq!(rig.show("CA"), "0, 1");
}

/// MC 9.7, error 109.
#[test]
fn a_calibration_can_fail() {
    let mut rig = Rig::hybrid();
    rig.fault("calibration", true);
    rig.set(&["SC"]);
    rig.after(20.secs());
    let error = rig.value("ER");
    assert_eq!(error, 109);
    assert_ne!(rig.value("AF") & CALIBRATED, 0, "the flag will set (MC 5-9)");
}

/// MC 5-3, 5-72, 5-74: in torque mode the torque and its direction turn the shaft. V is 0 (FB 5, MC 5-77).
#[test]
fn torque_mode_turns_the_shaft() {
    for (direction, sign) in [(1, 1.0), (0, -1.0)] {
        let mut rig = Rig::hybrid();
        rig.set(&[&format!("TD={direction}"), "TQ=50", "TS=50000"]);
        rig.set(&["AS=3"]);
        rig.after(CALIBRATION + 2.secs());
        rig.assert_values(&[("V", 0), ("ER", 0)]);
        let before = rig.value("C2");
        rig.after(1.secs());
        let turned = (rig.value("C2") - before) as f64;
        assert!(turned * sign > 100.0, "{turned} counts in 1 s, TD={direction}");
        rig.set(&["AS=0"]);
        rig.after(2.secs());
        let before = rig.value("C2");
        rig.after(1.secs());
        assert!((rig.value("C2") - before).abs() <= 4, "it stands");
    }
}

/// FB 5.1, MC 5-70: the fastest response is 10 MHz/(SS + 2), 38,910 steps/s with SS 255. At a higher speed
/// the rotor lags behind.
#[test]
fn system_speed_limits_the_rotor() {
    for mode in [1, 2] {
        let mut rig = Rig::hybrid();
        rig.set(&[&format!("AS={mode}"), "VM=100000"]);
        rig.write(0x00A2, 255);
        assert_eq!(rig.value("SS"), 38_910);
        rig.set(&["SL 100000"]);
        rig.after(500.millis());
        let (counts, lag) = (rig.peek("C2"), rig.peek("LL"));
        rig.after(1.secs());
        rig.assert_now(&[("V", 100_000)]);
        // A turn has 4,000 counts and 51,200 steps.
        let turned = (rig.peek("C2") - counts) as f64 * 12.8;
        assert!((turned - 38_910.0).abs() < 20.0, "{turned} steps");
        let lags = (rig.peek("LL") - lag) as f64;
        assert!((lags - 61_090.0).abs() < 20.0, "{lags} steps");
    }
}

/// MC 5-3, 9.5, 9.6: in torque mode the drive is in motion until the rotor is at rest, and the axis shows the
/// rotor's speed.
#[test]
fn a_rotor_that_turns_is_in_motion() {
    let mut rig = Rig::hybrid();
    rig.set(&["TQ=25", "AS=3"]);
    rig.after(2.secs());
    rig.refused("SC", 89);
    rig.refused("CF", 94);
    rig.refused("S", 73);
    rig.refused("MS=128", 89);
    let full = rig.speed();
    assert!((full - 2_560_000.0).abs() < 1.0, "3,000 rpm: {full} steps/s");
    // If the shaft is held, the rotor stops. After LT it counts as locked, but its bridge stays on (MC 5-44).
    rig.fault("stall", true);
    let counts = rig.value("C2");
    rig.after(3.secs());
    assert_eq!((rig.speed() as i64, rig.value("C2") - counts), (0, 0));
    rig.assert_values(&[("LR", 1), ("ER", 0)]);
    rig.fault("stall", false);
    rig.after(100.millis());
    let speed = rig.speed();
    assert!(speed > 0.0 && speed < full / 5.0, "it has to accelerate: {speed} steps/s");
    rig.after(2.secs());
    // Without the bridge only friction slows the rotor.
    rig.set(&["DE=0"]);
    rig.after(100.millis());
    assert_eq!(rig.motion().current_ma, 0);
    let speed = rig.speed();
    assert!(speed > full / 2.0 && speed < full, "{speed} steps/s");
    rig.refused("DE=1", 89);
    rig.after(2.secs());
    assert_eq!(rig.speed() as i64, 0);
    rig.set(&["DE=1"]);
}

/// A motor in a bench file is the motor of the drive. At RC = 25 its 1,000 mN·m are 250, and the encoder, LL
/// and LR refer to the shaft that the bench shows.
#[test]
fn a_motor_of_the_bench_is_the_rotor() {
    for (load, set, is_locked) in [
        ("load_mnm = 200", "HC = 40", false),
        ("load_mnm = 300", "HC = 40", true),
        ("load_mnm = 300", "HC = 40, RC = 50", false),
        ("load_mnm = 0", "SS = 255", false),
    ] {
        let text = format!(
            "[[drive]]\nname = \"x\"\nkind = \"mdrive-hybrid\"\nfast_boot = true\nlisten = []\nset = {{ {set} }}\n\
             [[motor]]\nname = \"m\"\ndrive = \"x\"\nholding_mnm = 1000\n{load}\n"
        );
        let layout = bench_file::parse(&text).unwrap_or_else(|error| panic!("{error}"));
        let built = layout.build(layout.settings(), Vec::new()).unwrap_or_else(|error| panic!("{error}"));
        let mut rig = Rig::of(Kind::Hybrid, built.bench, built.drives[0]);
        rig.say("EM=2");
        rig.set(&["VM=51200", "MR 204800"]);
        rig.wait_still(10.secs());
        rig.assert_values(&[("LR", is_locked.into()), ("ER", if is_locked { 104 } else { 0 })]);
        let (counts, lag) = (rig.peek("C2"), rig.peek("LL"));
        if set == "SS = 255" {
            assert!(lag > 12_000, "{lag}");
        } else {
            assert_eq!(lag, 0, "{load}, {set}");
        }
        if !is_locked {
            // A turn has 51,200 steps and 4,000 counts.
            assert!(((204_800 - lag) * 10 / 128 - counts).abs() <= 1, "{counts} counts, {lag} behind");
        }
        let motor = rig.bench.motors().next().expect("a motor");
        let turned = (rig.bench.turn(motor).revolutions * 4_000.0).round() as i64;
        assert!(
            (turned - counts).abs() <= 1,
            "{load}, {set}: the shaft has turned {turned} counts of {counts}"
        );
    }
}

/// MC 5-71: trips on the status of a Hybrid.
#[test]
fn it_trips_on_its_status() {
    let mut rig = Rig::hybrid();
    rig.program("PG 1\nLB G1\nLB G2\nH 10\nBR G2\nE\nLB K1\nR1=R1+1\nRT\nPG");
    rig.set(&["TA=1,K1", "TE=32", "EX 1", "SC"]);
    rig.after(CALIBRATION);
    rig.assert_values(&[("R1", 1), ("TE", 0), ("ER", 0)]);
    rig.set(&["TA=4,K1", "TE=32", "SL 20000"]);
    rig.after(500.millis());
    rig.fault("locked_rotor", true);
    rig.after(3.secs());
    rig.assert_values(&[("R1", 2), ("TE", 0)]);
    // "There is no error generation when enabling trip on locked rotor" (MC 5-71).
    rig.assert_values(&[("ER", 0)]);
}

/// A Plus needs no calibration and starts quickly.
#[test]
fn a_plus_is_ready_at_once() {
    let mut rig = Rig::set_up(Kind::Plus, Setup::default());
    rig.say("EM=2");
    rig.heard();
    rig.set(&["MR 100"]);
    rig.after(START);
    rig.assert_values(&[("P", 100), ("ER", 0)]);
    let mut hybrid = Rig::hybrid();
    // The lag is zero, and the drive is calibrated (MC 5-2).
    assert_eq!(hybrid.value("AF"), 64 + CALIBRATED);
}

/// MC 5-34: I6 reads the index mark, which HI 1 uses.
#[test]
fn the_index_mark_is_read() {
    let mut rig = Rig::hybrid();
    assert!([0, 1].contains(&rig.value("I6")));
    rig.refused("I6=1", 25);
    assert_eq!(rig.try_words(0x0032, 1), Err(2), "the register is of the MDrivePlus");
}

/// MC 4-8: SC = 0 calibrates; the drive does not have the configuration test.
#[test]
fn a_calibration_has_a_mode() {
    let mut rig = Rig::hybrid();
    for line in ["SC 0", "SC=0"] {
        rig.set(&[line]);
        assert_eq!(rig.word(0x008F) & 128, 0, "{line}: not calibrated yet");
        rig.after(CALIBRATION);
        assert_eq!(rig.word(0x008F) & 128, 128, "{line}");
    }
    rig.refused("SC=1", 37);
    rig.refused("SC=2", 21);
}
