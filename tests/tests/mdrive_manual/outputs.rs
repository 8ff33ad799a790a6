//! Outputs (MC 5-64), the clock outputs (MC 5-66) and the trip output (MC 5-67).

use drivetwin_firmware::device::Level;
use drivetwin_protocol::time::Span;

use crate::rig::{KINDS, Kind, Rig};

/// The four circuits of MC 5-64: active state and sinking (0) or sourcing (1), then the level of the pin when
/// on and off.
const CIRCUITS: [(&str, Level, Level); 4] = [
    ("1,0", Level::Float, Level::Low),
    ("0,0", Level::Low, Level::Float),
    ("1,1", Level::High, Level::Float),
    ("0,1", Level::Float, Level::High),
];

#[test]
fn the_four_circuits() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        for (n, io) in ["IO1", "IO2", "IO3", "IO4"].into_iter().enumerate() {
            for (circuit, on, off) in CIRCUITS {
                rig.set(&[&format!("S{}=16,{circuit}", n + 1), &format!("O{}=1", n + 1)]);
                assert_eq!(rig.level(io), on, "{io} 16,{circuit} on");
                rig.set(&[&format!("O{}=0", n + 1)]);
                assert_eq!(rig.level(io), off, "{io} 16,{circuit} off");
            }
        }
    }
}

/// MC 7.2.5: OL and OT write all points that are outputs.
#[test]
fn groups_are_binary() {
    let mut rig = Rig::plus();
    rig.set(&["S1=16,1,1", "S2=16,1,1", "S3=16,1,1", "S4=16,1,1"]);
    for name in ["OL", "OT"] {
        for value in 0..16 {
            rig.set(&[&format!("{name}={value}")]);
            for (bit, io) in ["IO1", "IO2", "IO3", "IO4"].into_iter().enumerate() {
                let level = if value >> bit & 1 == 1 { Level::High } else { Level::Float };
                assert_eq!(rig.level(io), level, "{io} after {name}={value}");
            }
        }
    }
    rig.refused("OL=16", 21);
    rig.refused("OT=256", 21);
}

/// Types of outputs: 17 moving, 20 velocity changing, 23 moving to position, 18 fault.
#[test]
fn outputs_show_what_the_drive_does() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        rig.set(&["S1=17,0,0", "S2=20,0,0", "S3=23,0,0", "S4=18,0,0", "MT=100"]);
        let shown = |rig: &Rig| ["IO1", "IO2", "IO3", "IO4"].map(|io| rig.level(io) == Level::Low);
        assert_eq!(shown(&rig), [false, false, false, false]);
        rig.set(&["MR 1000000"]);
        rig.after(100.millis());
        assert_eq!(shown(&rig), [true, true, true, false], "ramp");
        rig.after(800.millis());
        assert_eq!(shown(&rig), [true, false, true, false], "cruise");
        rig.after(900.millis());
        assert_eq!(shown(&rig), [true, true, true, false], "ramp down");
        rig.wait(2.secs(), 1.millis(), |rig| rig.long(0x0057) == 1_000_000);
        rig.after(10.millis());
        assert_eq!(shown(&rig), [true, false, true, false], "settling");
        rig.after(100.millis());
        assert_eq!(shown(&rig), [false, false, false, false]);
        rig.set(&["SL 20000"]);
        rig.after(500.millis());
        assert_eq!(shown(&rig), [true, false, false, false], "a slew is no move to a position");
        rig.say("RC=101");
        assert_eq!(shown(&rig), [true, false, false, true], "an error");
        assert_eq!(rig.value("ER"), 21);
        rig.after(1.millis());
        assert_eq!(shown(&rig), [true, false, false, false], "read");
    }
}

/// MC 5-67, 5-15: a trip makes a pulse of CW * 50 ns at the output; here with TR.
#[test]
fn a_trip_output_pulses() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        rig.set(&["S13=61,1", "CW=200", "TR=1000,0,3", "TE=16"]);
        assert_eq!(rig.level("CAPTURE"), Level::Low);
        rig.set(&["VM=20000", "MR 10000"]);
        let mut pulses = Vec::new();
        let mut was = Level::Low;
        for _ in 0..200_000 {
            rig.after(5.micros());
            let is = rig.level("CAPTURE");
            if is != was && is == Level::High {
                pulses.push(rig.motion().position);
            }
            was = is;
        }
        assert_eq!(pulses.len(), 3, "{pulses:?}");
        for (n, position) in (1..).zip(pulses) {
            assert!((position - 1_000 * n).abs() <= 1, "{position}");
        }
    }
}

/// MC 5-13, 5-66: clock outputs show the steps and the direction of the motor.
#[test]
fn clock_outputs_follow_the_motor() {
    let mut rig = Rig::new(Kind::Plus);
    rig.set(&["S7=49,1", "S8=49,1", "CM=1", "VM=2000", "VI=1000"]);
    let count = |rig: &mut Rig, line: &str| {
        rig.set(&[line]);
        let (mut edges, mut was) = (0, rig.level("IO7"));
        while rig.word(0x004A) == 1 {
            // The sampling interval is shorter than a pulse: CW is 10, 500 ns.
            rig.after(drivetwin_protocol::time::Duration::from_ticks(4));
            let is = rig.level("IO7");
            edges += i32::from(is == Level::High && was != Level::High);
            was = is;
        }
        edges
    };
    assert_eq!(count(&mut rig, "MR 5"), 5);
    let forward = rig.level("IO8");
    assert_eq!(count(&mut rig, "MR -5"), 5);
    assert_ne!(rig.level("IO8"), forward);
}

/// MC 5-14, 5-66: the motor follows a clock at the ratio CR.
#[test]
fn the_motor_follows_a_clock() {
    for (ratio, expected) in [("1.000", 2_000), ("0.500", 1_000), ("2.000", 4_000)] {
        let mut rig = Rig::new(Kind::Plus);
        rig.low("IO7");
        rig.high("IO8");
        rig.set(&["S7=33,1", "S8=33,1", &format!("CR={ratio}"), "CM=1"]);
        let pin = rig.pin("IO7");
        rig.bench.pulse(rig.seat, pin, 2_000, 1_000.0).expect("a free pin");
        rig.after(4.secs());
        let position = rig.long(0x0057).abs();
        assert!((position - expected).abs() <= 2, "{position} at {ratio}");
    }
}
