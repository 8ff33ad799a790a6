//! Motion: the calculations of MC 7.3.5, slews, and the flags during motion (MC 5-45 to 5-50, 5-68, 5-77 to
//! 5-80).

use drivetwin_protocol::time::{Duration, Span};

use crate::rig::{CALIBRATION, KINDS, Kind, Rig};

/// Time from MA or MR to the first step: "the time required to calculate the move is 2.5 mSec" (MC 5-45).
const CALCULATION: f64 = 0.002_5;

/// Duration of a move in s, from the command. The move is a trapezoid or a triangle that begins and ends at
/// VI.
fn lasts(distance: f64, vi: f64, vm: f64, a: f64, d: f64) -> f64 {
    let ramps = (vm * vm - vi * vi) / 2.0 * (1.0 / a + 1.0 / d);
    if ramps <= distance {
        return CALCULATION + (vm - vi) * (1.0 / a + 1.0 / d) + (distance - ramps) / vm;
    }
    let peak = (vi * vi + 2.0 * distance / (1.0 / a + 1.0 / d)).sqrt();
    CALCULATION + (peak - vi) * (1.0 / a + 1.0 / d)
}

fn seconds(span: Duration) -> f64 {
    span.ticks() as f64 / 16e6
}

impl Rig {
    /// Asserts the duration and the end of a move from standstill.
    #[track_caller]
    fn assert_lasts(&mut self, command: &str, end: i32, expected: f64) {
        self.set(&[command]);
        self.assert_now(&[("MV", 1), ("MP", 1)]);
        let nearly = Duration::micros(((expected - 0.005).max(0.0) * 1e6) as u64);
        self.after(nearly);
        let took = seconds(nearly + self.wait(1.secs(), 100.micros(), |rig| rig.word(0x004A) == 0));
        // One step more or less at VI is 1 ms.
        assert!((took - expected).abs() <= 0.002, "{command} takes {took} s, not {expected}");
        assert_eq!((self.long(0x0057), self.long(0x0005)), (end, end), "P and C1 after {command}");
        assert_eq!((self.long(0x0085), self.word(0x0088), self.word(0x0045)), (0, 0, 0), "V, VC, MP");
    }
}

/// MC 7.3.5: 0.767 s + 4.232 s + 0.767 s; the manual rounds its ramps to 294,528 steps.
#[test]
fn the_printed_trapezoid() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        let expected = lasts(3_840_000.0, 1e3, 768e3, 1e6, 1e6);
        assert!((expected - CALCULATION - 5.767).abs() < 0.002, "{expected}");
        rig.assert_lasts("MR 3840000", 3_840_000, expected);
        rig.assert_lasts("MR -3840000", 0, expected);
        rig.assert_no_error();
    }
}

#[test]
fn moves_take_the_calculated_time() {
    let mut rig = Rig::plus();
    for (vi, vm, a, d, distance) in [
        (1_000, 768_000, 1_000_000, 1_000_000, 20_000),
        (1_000, 768_000, 1_000_000, 1_000_000, 1),
        (200_000, 2_500_000, 1_000_000, 1_000_000, 51_200),
        (1, 5_000_000, 100_000_000, 50_000_000, 10_000_000),
        (4_999_999, 5_000_000, 91, 91, 5_000_000),
        (1_000, 100_000, 2_000_000, 500_000, 300_000),
        (20_000, 50_000, 1_525_878_997, 1_525_878_997, 100_000),
    ] {
        rig.set(&["VI=1", "VM=5000000"]);
        rig.set(&[&format!("VM={vm}"), &format!("VI={vi}"), &format!("A={a}"), &format!("D={d}"), "P=0"]);
        let expected = lasts(distance.into(), vi.into(), vm.into(), a.into(), d.into());
        rig.assert_lasts(&format!("MR {distance}"), distance, expected);
        rig.assert_lasts("MA 0", 0, expected);
        rig.assert_lasts(&format!("MA -{distance}"), -distance, expected);
        rig.set(&["P=0"]);
    }
    rig.assert_no_error();
}

/// Moves can also be commanded over port 502. MA, MR and SL read back the last command.
#[test]
fn moves_are_registers_too() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        rig.write_long(0x0043, 512_000);
        assert_eq!((rig.word(0x004A), rig.word(0x0045), rig.long(0x0043)), (1, 1, 512_000));
        rig.wait_still(5.secs());
        assert_eq!(rig.long(0x0057), 512_000);
        rig.write_long(0x0046, -12_000);
        rig.wait_still(5.secs());
        assert_eq!((rig.long(0x0057), rig.long(0x0046), rig.long(0x0043)), (500_000, -12_000, 512_000));
        rig.write_long(0x0078, -20_000);
        rig.after(100.millis());
        assert_eq!((rig.long(0x0085), rig.long(0x0078), rig.word(0x0045)), (-20_000, -20_000, 0));
        rig.write_long(0x0078, 0);
        rig.wait_still(1.secs());
        rig.assert_no_error();
    }
}

/// V and VC during a trapezoid: at t = 0.0025 + 0.1 s the speed is 1,000 + 0.1 * 1,000,000 steps/s.
#[test]
fn velocity_follows_the_ramps() {
    let mut rig = Rig::plus();
    rig.set(&["MR 1000000"]);
    assert_eq!((rig.long(0x0085), rig.word(0x0088)), (0, 0), "before the first step");
    rig.after(2_500.micros() + 100.millis());
    let v = rig.long(0x0085);
    assert!((v - 101_000).abs() <= 100, "{v}");
    // 1,000 * 0.1 + 1,000,000 * 0.1² / 2
    assert!((rig.long(0x0057) - 5_100).abs() <= 15, "{}", rig.long(0x0057));
    assert_eq!((rig.word(0x0088), rig.word(0x0045)), (1, 1), "VC and MP");
    rig.after(700.millis());
    assert_eq!((rig.long(0x0085), rig.word(0x0088)), (768_000, 0), "V and VC at VM");
    rig.wait_still(5.secs());
    rig.set(&["MR -1000000"]);
    rig.after(800.millis());
    assert_eq!(rig.long(0x0085), -768_000);
}

/// MC 5-68: VM does not limit a slew. The speed and the direction can change during a slew.
#[test]
fn a_slew_changes_on_the_fly() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        rig.set(&["VM=10000", "SL 200000"]);
        rig.after(100.millis());
        rig.assert_values(&[("VC", 1), ("MV", 1), ("MP", 0)]);
        rig.after(200.millis());
        rig.assert_values(&[("V", 200_000), ("VC", 0)]);
        rig.set(&["SL 20000"]);
        rig.after(100.millis());
        let v = rig.value("V");
        assert!((v - 100_000).abs() < 4_000, "{v}");
        rig.after(200.millis());
        rig.assert_values(&[("V", 20_000)]);
        // The speed goes through 0 to the other direction.
        rig.set(&["SL -50000"]);
        rig.after(300.millis());
        rig.assert_values(&[("V", -50_000)]);
        rig.set(&["SL 5000000"]);
        rig.after(6.secs());
        rig.assert_values(&[("V", 5_000_000)]);
        rig.set(&["SL 0"]);
        rig.wait_still(6.secs());
        rig.assert_values(&[("V", 0), ("MV", 0), ("ER", 0)]);
        rig.refused("SL 5000001", 21);
        rig.refused("SL -5000001", 21);
    }
}

/// A speed below VI is reached at once.
#[test]
fn a_slow_slew_has_no_ramp() {
    let mut rig = Rig::plus();
    rig.set(&["SL 500"]);
    rig.after(10.millis());
    rig.assert_now(&[("V", 500), ("VC", 0)]);
    rig.after(1.secs());
    let position = rig.peek("P");
    assert!((500..=506).contains(&position), "{position}");
    rig.set(&["SL 0"]);
    rig.after(10.millis());
    rig.assert_values(&[("V", 0), ("MV", 0)]);
}

/// MC 8.2: a move keeps the speed with which it began.
#[test]
fn speeds_written_during_a_move_are_for_the_next() {
    let mut rig = Rig::plus();
    let expected = lasts(1e6, 1e3, 768e3, 1e6, 1e6);
    rig.set(&["MR 1000000"]);
    let start = rig.now();
    rig.after(100.millis());
    rig.set(&["VM=100000", "A=200000", "D=200000"]);
    rig.after(700.millis());
    rig.assert_values(&[("V", 768_000)]);
    rig.wait(5.secs(), 100.micros(), |rig| rig.word(0x004A) == 0);
    let took = seconds(rig.now().since(start));
    assert!((took - expected).abs() < 0.002, "{took}");
    rig.assert_lasts("MR 100000", 1_100_000, lasts(1e5, 1e3, 1e5, 2e5, 2e5));
}

/// MC 5-32, 5-46, 5-49: MV and MP stay 1 until the time MT is over.
#[test]
fn a_motor_settles() {
    let mut rig = Rig::plus();
    rig.set(&["MT=500"]);
    let moves = lasts(20_000.0, 1e3, 768e3, 1e6, 1e6);
    rig.set(&["MR 20000"]);
    let stops = seconds(rig.wait(1.secs(), 100.micros(), |rig| rig.long(0x0057) == 20_000));
    assert!((stops - moves).abs() < 0.002, "{stops}");
    rig.after(2.millis());
    rig.assert_now(&[("V", 0), ("VC", 0), ("MV", 1), ("MP", 1)]);
    let settles = seconds(rig.wait(1.secs(), 100.micros(), |rig| rig.word(0x004A) == 0));
    assert!((stops + 0.002 + settles - moves - 0.5).abs() < 0.002, "{settles}");
    rig.assert_values(&[("MV", 0), ("MP", 0)]);
}

/// A move that is commanded during another one begins after that one has ended and settled. A later command
/// replaces it.
#[test]
fn moves_wait_for_each_other() {
    let mut rig = Rig::plus();
    rig.set(&["MT=100", "MR 20000"]);
    rig.after(50.millis());
    rig.set(&["MR 5000", "MA 30000"]);
    rig.wait(2.secs(), 1.millis(), |rig| rig.long(0x0057) == 20_000);
    rig.after(50.millis());
    rig.assert_values(&[("P", 20_000), ("MV", 1)]);
    rig.after(2.secs());
    rig.assert_values(&[("P", 30_000), ("MV", 0), ("ER", 0)]);
}

/// "If SL 0 is issued after a MA/MR, motion has to come to a stop before issuing another motion command"
/// (MC 5-68).
#[test]
fn a_stop_comes_first() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        rig.set(&["MR 1000000"]);
        rig.after(800.millis());
        rig.set(&["SL 0"]);
        rig.after(10.millis());
        rig.assert_values(&[("MP", 0), ("MV", 1)]);
        rig.refused("MR 1000", 85);
        rig.refused("MA 1000", 85);
        assert_eq!(rig.try_write(0x0043, &[0, 100]), Err(4));
        assert_eq!(rig.ef_er(), (1, 85));
        rig.wait_still(2.secs());
        let stopped = rig.value("P");
        assert!(stopped < 1_000_000);
        rig.set(&["MR 1000"]);
        rig.wait_still(2.secs());
        rig.assert_values(&[("P", stopped + 1_000)]);
    }
}

/// MC 5-45, 5-51: a number repeats the last motion command.
#[test]
fn a_number_moves_again() {
    let mut rig = Rig::plus();
    rig.set(&["MR 10000"]);
    rig.wait_still(1.secs());
    assert_eq!(rig.show("MD"), "MR");
    rig.set(&["5000"]);
    rig.wait_still(1.secs());
    rig.assert_values(&[("P", 15_000)]);
    rig.set(&["-20000"]);
    rig.wait_still(1.secs());
    rig.assert_values(&[("P", -5_000)]);
    rig.set(&["MA 100"]);
    rig.wait_still(1.secs());
    rig.set(&["2000"]);
    rig.wait_still(1.secs());
    rig.assert_values(&[("P", 2_000)]);
    assert_eq!(rig.show("MD"), "MA");
    rig.set(&["SL 1000"]);
    assert_eq!(rig.show("MD"), "SL");
    rig.set(&["0"]);
    rig.wait_still(1.secs());
    rig.set(&["NE=0"]);
    rig.say("5000");
    assert_ne!(rig.value("ER"), 0, "a number is nothing now");
    rig.assert_values(&[("MV", 0)]);
}

/// MC 5-45: after a move with the second parameter 1 the drive sends its name, `!`. With the third parameter
/// 1 the motion continues at the target.
#[test]
fn a_move_can_report_or_go_on() {
    let mut rig = Rig::plus();
    rig.set(&["MR 20000,1"]);
    rig.wait_still(1.secs());
    rig.after(1.millis());
    assert!(rig.heard().contains('!'));
    rig.set(&["VM=50000", "MA 50000,0,1"]);
    rig.after(3.secs());
    rig.assert_values(&[("MV", 1), ("V", 50_000)]);
    assert!(rig.value("P") > 60_000);
    rig.set(&["SL 0"]);
    rig.wait_still(2.secs());
    rig.assert_values(&[("ER", 0)]);
}

/// A write of P changes the frame of reference (MC 5-54).
#[test]
fn a_write_of_the_position_changes_the_frame_of_reference() {
    let mut rig = Rig::plus();
    rig.set(&["MR 1000"]);
    rig.wait_still(1.secs());
    rig.set(&["P=-500", "MA 500"]);
    rig.wait_still(1.secs());
    rig.assert_values(&[("P", 500), ("C1", 500)]);
    rig.write_long(0x0057, 7);
    rig.assert_values(&[("P", 7), ("C1", 7)]);
    rig.write_long(0x0005, 9);
    rig.assert_values(&[("P", 9)]);
    assert_eq!(rig.motion().position, 2_000, "the motor");
}

/// A turn is 200 full steps of MS microsteps, and 2,048 counts (MC 5-48, 7.3.7). The encoder is on the shaft.
#[test]
fn a_turn_is_200_steps_of_ms_microsteps() {
    let mut rig = Rig::plus();
    for ms in [1, 2, 4, 5, 8, 10, 16, 25, 32, 50, 64, 100, 108, 125, 127, 128, 180, 200, 250, 256] {
        rig.set(&[&format!("MS={ms}"), "VI=100", "VM=2000", "A=100000", "D=100000", "P=0", "C2=0"]);
        rig.set(&[&format!("VM={}", 400 * ms), &format!("MR {}", 200 * ms)]);
        rig.wait_still(5.secs());
        rig.after(200.millis());
        let counts = rig.value("C2");
        assert!((counts - 2_048).abs() <= 8, "{counts} counts with MS={ms}");
    }
}

/// While the bridge is off, the step counter counts but the motor does not turn (MC 5-19).
#[test]
fn a_disabled_drive_counts_and_does_not_turn() {
    let mut rig = Rig::plus();
    rig.set(&["DE=0", "MR 51200"]);
    rig.wait_still(5.secs());
    rig.assert_values(&[("C1", 51_200), ("ER", 0)]);
    let counts = rig.value("C2");
    assert!(counts.abs() <= 8, "{counts}");
}

/// The current is RC while the motor moves, and HC after MT and HT are over (MC 5-28, 5-32). With HT = 0 it
/// is never reduced.
#[test]
fn current_is_reduced_at_rest() {
    let mut rig = Rig::plus();
    rig.set(&["RC=80", "HC=20", "HT=500"]);
    rig.after(2.secs());
    let holds = rig.motion().current_ma;
    rig.set(&["SL 20000"]);
    rig.after(100.millis());
    let runs = rig.motion().current_ma;
    assert!((runs as f64 / holds as f64 - 4.0).abs() < 0.1, "{holds} mA and {runs} mA");
    rig.set(&["SL 0"]);
    rig.wait_still(1.secs());
    rig.after(400.millis());
    assert_eq!(rig.motion().current_ma, runs);
    rig.after(200.millis());
    assert_eq!(rig.motion().current_ma, holds);
    rig.set(&["HT=0", "MR 1000"]);
    rig.wait_still(1.secs());
    rig.after(100.secs());
    assert_eq!(rig.motion().current_ma, runs);
}

/// On a Hybrid, but not on a Plus, MS starts a calibration, and a move is refused until its end.
#[test]
fn microsteps_change_at_rest() {
    let mut rig = Rig::new(Kind::Hybrid);
    rig.set(&["MS=128"]);
    rig.refused("MR 100", 88);
    rig.after(CALIBRATION);
    rig.set(&["MR 100"]);
}
