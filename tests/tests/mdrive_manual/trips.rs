//! Trips (MC 5-71 to 5-76): each with its subroutine, the position that it captures, and its bit of TE.

use drivetwin_protocol::time::Span;

use crate::rig::{KINDS, Rig};

const SUB: &str = "PG 1\nLB G1\nLB G2\nH 10\nBR G2,R4=0\nE\nLB K1\nR1=R1+1\nR2=P\nRT\nPG";

impl Rig {
    /// A drive with a program that waits, and a trip that calls K1.
    fn with_trip(kind: crate::rig::Kind, define: &str, enable: i64) -> Self {
        let mut rig = Self::new(kind);
        for io in ["IO1", "IO2", "IO3", "IO4", "CAPTURE"] {
            rig.high(io);
        }
        rig.program(SUB);
        rig.set(&[define, &format!("TE={enable}"), "EX 1"]);
        rig.assert_values(&[("TE", enable)]);
        rig
    }
}

#[test]
fn a_trip_must_be_defined() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        for bit in [1, 2, 4, 8, 16] {
            rig.refused(&format!("TE={bit}"), 27);
        }
        for bit in [1, 2, 8] {
            assert_eq!(rig.try_write(0x007D, &[bit]), Err(4), "{bit}");
            assert_eq!(rig.ef_er(), (1, 27), "{bit}");
        }
        assert_eq!(rig.try_write(0x007D, &[44]), Err(3));
        assert_eq!(rig.ef_er(), (1, 21));
        assert_eq!(rig.word(0x007D), 0);
    }
}

/// MC 5-74: a trip on position does not set PC.
#[test]
fn on_position() {
    for kind in KINDS {
        for (target, slew) in [(20_000, 10_000), (-20_000, -10_000)] {
            let mut rig = Rig::with_trip(kind, &format!("TP={target},K1"), 2);
            rig.set(&[&format!("SL {slew}")]);
            rig.after(5.secs());
            rig.assert_values(&[("R1", 1), ("TE", 0), ("PC", 0), ("ER", 0)]);
            let seen = rig.value("R2");
            assert!((seen - target).abs() <= 30, "{seen}: two or three lines of 210 µs");
            // MC 5-74: PR TP prints the position as it was set.
            assert_eq!(rig.show("TP").split(',').next().map(str::trim), Some(target.to_string().as_str()));
        }
    }
}

/// MC 5-73: a trip on an input sets PC.
#[test]
fn on_an_input() {
    for kind in KINDS {
        let mut rig = Rig::with_trip(kind, "TI=2,K1", 1);
        rig.set(&["SL 10000"]);
        rig.after(1.secs());
        rig.assert_values(&[("R1", 0)]);
        rig.low("IO2");
        let here = rig.peek("P");
        rig.after(100.millis());
        rig.assert_values(&[("R1", 1), ("TE", 0), ("ER", 0)]);
        let captured = rig.peek("PC");
        assert!((captured - here).abs() <= 1, "{captured}, not {here}");
        // The trip works once, until it is enabled again.
        rig.high("IO2");
        rig.after(10.millis());
        rig.low("IO2");
        rig.after(100.millis());
        rig.assert_values(&[("R1", 1)]);
        rig.high("IO2");
        rig.set(&["TE=1"]);
        rig.low("IO2");
        rig.after(100.millis());
        rig.assert_values(&[("R1", 2)]);
    }
}

/// MC 5-72, 5-67: a trip on the capture input sets PC.
#[test]
fn on_capture() {
    for kind in KINDS {
        let mut rig = Rig::with_trip(kind, "TC=K1", 4);
        rig.set(&["SL 10000"]);
        rig.after(1.secs());
        rig.low("CAPTURE");
        let here = rig.peek("P");
        rig.after(100.millis());
        rig.assert_values(&[("R1", 1), ("TE", 0), ("ER", 0)]);
        let captured = rig.long(0x0059);
        assert!((i64::from(captured) - here).abs() <= 1, "{captured}, not {here}");
    }
}

/// MC 5-76: a trip on time.
#[test]
fn on_time() {
    for kind in KINDS {
        let mut rig = Rig::with_trip(kind, "TT=2000,K1", 8);
        rig.after(1_990.millis());
        rig.assert_values(&[("R1", 0), ("TE", 8)]);
        rig.after(20.millis());
        rig.assert_values(&[("R1", 1), ("TE", 0), ("ER", 0)]);
    }
}

/// MC 5-75: the trip works n times, each time relative to the last one.
#[test]
fn on_relative_position() {
    for kind in KINDS {
        let mut rig = Rig::with_trip(kind, "TR=5000,K1,3", 16);
        rig.set(&["SL 10000"]);
        for n in 1..=3 {
            rig.after(500.millis());
            let count = rig.value("R1");
            assert!((n - 1..=n).contains(&count), "{count} after {n} half seconds");
        }
        rig.after(3.secs());
        rig.assert_values(&[("R1", 3), ("TE", 0), ("ER", 0)]);
        let captured = rig.peek("PC");
        assert!((captured - 15_000).abs() <= 2, "{captured}");
    }
}

/// With a count of 0 the trip has no end (MC 5-75).
#[test]
fn on_relative_position_for_ever() {
    let mut rig = Rig::with_trip(crate::rig::Kind::Plus, "TR=5000,K1,0", 16);
    rig.set(&["SL 10000"]);
    rig.after(5_100.millis());
    rig.assert_values(&[("R1", 10), ("TE", 16), ("ER", 0)]);
}

/// A master on port 502 defines TR and enables it by register 7D (FB 4.3.1).
#[test]
fn the_bus_trips_too() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        rig.program(SUB);
        assert_eq!(rig.try_write_specific(b"  RT", "=5000,K1,2"), Ok(()));
        assert_eq!(rig.try_write_specific(b"  XE", "1"), Ok(()));
        rig.write(0x007D, 16);
        rig.write_long(0x0078, 10_000);
        rig.after(2.secs());
        assert_eq!((rig.long(0x005F), rig.word(0x007D)), (2, 0), "R1 and TE");
    }
}

/// MC 9.2, error 39: TP and TR exclude each other.
#[test]
fn position_and_relative_position_exclude_each_other() {
    let mut rig = Rig::plus();
    rig.program(SUB);
    rig.set(&["TP=1000,K1", "TR=1000,K1,0"]);
    rig.refused("TE=18", 39);
    rig.set(&["TE=2"]);
    rig.refused("TE=18", 39);
}

/// Several trips are enabled at once. A trip disables only itself (MC 5-73).
#[test]
fn trips_are_independent() {
    let mut rig = Rig::with_trip(crate::rig::Kind::Plus, "TI=1,K1", 1);
    rig.set(&["TP=10000,K1", "TT=60000,K1", "TE=11", "SL 10000"]);
    rig.after(2.secs());
    rig.assert_values(&[("TE", 9), ("R1", 1)]);
    rig.low("IO1");
    rig.after(100.millis());
    rig.assert_values(&[("TE", 8), ("R1", 2), ("ER", 0)]);
}

#[test]
fn a_subroutine_of_a_trip_must_be_there() {
    let mut rig = Rig::plus();
    for line in ["TP=1000,ZZ", "TI=1,ZZ", "TT=100,ZZ", "TC=ZZ"] {
        rig.refused(line, 30);
    }
    rig.program(SUB);
    rig.refused("TI=5,K1", 12);
}

/// "Only the activated trip function needs to be re-enabled, the other trips will still be enabled"
/// (MC 5-73).
#[test]
fn a_trip_is_enabled_again_beside_others() {
    let mut rig = Rig::new(crate::rig::Kind::Plus);
    rig.high("IO1");
    rig.program("PG 1\nLB K3\nR1=R1+1\nTE=8\nRT\nLB K1\nR2=R2+1\nRT\nPG");
    rig.set(&["TI=1,K1", "TT=100,K3", "TE=9"]);
    rig.after(250.millis());
    rig.assert_values(&[("R1", 2), ("TE", 9)]);
    rig.low("IO1");
    rig.after(10.millis());
    rig.assert_values(&[("R2", 1), ("TE", 8)]);
    rig.set(&["TE=0"]);
    rig.assert_values(&[("TE", 0)]);
}

/// MC 9.1, error 12: a point that is an output can neither trip nor capture.
#[test]
fn outputs_are_illegal_trips() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        rig.program(SUB);
        rig.set(&["S13=61,0", "S2=16,0,0"]);
        rig.refused("TC=K1", 12);
        rig.refused("TI=2,K1", 12);
        rig.set(&["S13=60,0", "TC=K1", "S13=61,0"]);
        rig.refused("TE=4", 12);
        rig.set(&["S13=60,0", "TE=4"]);
    }
}
