//! Effects of inputs: limits, home, jog, stop, pause, run, reset (MC 5-30, 5-43, 5-63, 7.2).

use drivetwin_protocol::time::{Duration, Span};

use crate::rig::{KINDS, Kind, Rig, START};

/// A switch on a machine. It connects an input to ground while the motor is at positions `from` to `to`.
struct Switch {
    io: &'static str,
    from: i32,
    to: i32,
    closed: bool,
}

fn switch(io: &'static str, from: i32, to: i32) -> Switch {
    Switch { io, from, to, closed: false }
}

impl Rig {
    /// Advances the time until the motor is at rest, at most by `most`. A switch is closed while the motor is
    /// in its range.
    #[track_caller]
    fn machine(&mut self, switches: &mut [Switch], most: Duration) {
        let start = self.now();
        loop {
            let position = self.motion().position;
            for switch in switches.iter_mut() {
                let closed = (switch.from..=switch.to).contains(&position);
                if closed != switch.closed {
                    switch.closed = closed;
                    if closed { self.low(switch.io) } else { self.high(switch.io) }
                }
            }
            // In this time the motor makes half a step at VI, ten at VM.
            self.after(500.micros());
            if self.word(0x004A) == 0 {
                return;
            }
            assert!(self.now().since(start) < most, "it moves after {most:?}, at {position}");
        }
    }

    fn wired(kind: Kind, lines: &[&str]) -> Self {
        let mut rig = Self::new(kind);
        for io in ["IO1", "IO2", "IO3", "IO4"] {
            rig.high(io);
        }
        rig.set(lines);
        rig
    }
}

/// MC 5-33, 5-36, 5-63: active states and levels.
#[test]
fn inputs_are_active_low_or_high() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        // Open inputs: a sinking input floats high, a sourcing one low.
        rig.assert_values(&[("I1", 0), ("IL", 15), ("IN", 15)]);
        rig.set(&["S1=0,0,1"]);
        rig.assert_values(&[("I1", 1), ("IL", 14), ("IN", 14)]);
        rig.set(&["S1=0,1,1"]);
        rig.assert_values(&[("I1", 0), ("IL", 14)]);
        rig.high("IO1");
        rig.assert_values(&[("I1", 1), ("IL", 15)]);
        rig.set(&["S1=0,1,0"]);
        rig.assert_values(&[("I1", 1)]);
        rig.low("IO1");
        rig.assert_values(&[("I1", 0), ("IL", 14)]);
        rig.set(&["S1=0,0,0"]);
        rig.assert_values(&[("I1", 1), ("IL", 14)]);
        rig.open("IO1");
        rig.assert_values(&[("I1", 0), ("IL", 15)]);
    }
}

/// MC 5-16: an input must be stable for D1 ms. IN is not debounced (MC 5-37).
#[test]
fn inputs_are_debounced() {
    let mut rig = Rig::wired(Kind::Plus, &["D1=100"]);
    rig.low("IO1");
    rig.after(50.millis());
    rig.assert_now(&[("I1", 0), ("IL", 15), ("IN", 14)]);
    rig.high("IO1");
    rig.after(1.millis());
    rig.low("IO1");
    rig.after(99.millis());
    rig.assert_now(&[("I1", 0)]);
    rig.after(2.millis());
    rig.assert_now(&[("I1", 1), ("IL", 14)]);
    rig.high("IO1");
    rig.after(99.millis());
    rig.assert_now(&[("I1", 1)]);
    rig.after(2.millis());
    rig.assert_now(&[("I1", 0)]);
}

/// MC 5-34, 5-65: the analogue input reads 0 to 1,023 for 0 to full scale.
#[test]
fn the_analogue_input_is_10_bits_of_full_scale() {
    use drivetwin_sim::bench::PinStimulus::Millivolts;
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        for (mv, shown) in [(0, 0), (5_000, 1_023), (2_500, 512), (1_000, 205), (6_000, 1_023), (-100, 0)] {
            rig.drive("ANALOG", Millivolts(mv));
            rig.after(10.millis());
            let value = rig.value("I5");
            assert!((value - shown).abs() <= 1, "{value} at {mv} mV");
        }
        rig.set(&["S5=9,1"]);
        rig.drive("ANALOG", Millivolts(5_000));
        rig.after(10.millis());
        let value = rig.value("I5");
        assert!((value - 512).abs() <= 1, "{value} of 10 V at 5 V");
        assert_eq!(i64::from(rig.word(0x0031)), value);
    }
}

/// MC 5-43: a limit stops with a ramp (LM 1 to 3) or without one (4 to 6). (20000² - 1000²)/(2 * 1000000) is
/// 200 steps.
#[test]
fn a_limit_stops_what_moves_towards_it() {
    for kind in KINDS {
        for mode in 1..=6 {
            for (sign, io, error) in [(1, "IO1", 83), (-1, "IO2", 84)] {
                let mut rig = Rig::wired(kind, &["S1=2,0,0", "S2=3,0,0", &format!("LM={mode}"), "A=100000"]);
                rig.program("PG 1\nLB G1\nIC R1\nH 10\nBR G1\nE\nPG");
                rig.set(&["EX 1", "D=1000000", &format!("SL {}", sign * 20_000)]);
                rig.after(2.secs());
                rig.low(io);
                let reached = rig.long(0x0057);
                rig.wait_still(1.secs());
                let ramp = (rig.long(0x0057) - reached) * sign;
                let expected = if mode <= 3 { 195..=220 } else { 0..=2 };
                assert!(expected.contains(&ramp), "{ramp} steps with LM={mode}");
                rig.assert_values(&[("ER", error), ("V", 0)]);
                // LM 3 and 6 stop the program, too.
                assert_eq!(rig.value("BY"), i64::from(!matches!(mode, 3 | 6)), "BY with LM={mode}");
                rig.say("E");
                // While the limit is active, only moves in the other direction are possible.
                let stopped = rig.value("P");
                rig.say(&format!("MR {}", sign * 1_000));
                rig.after(1.secs());
                rig.assert_values(&[("P", stopped), ("MV", 0), ("ER", error)]);
                rig.set(&[&format!("MR {}", -sign * 1_000)]);
                rig.wait_still(1.secs());
                rig.assert_values(&[("P", stopped - i64::from(sign) * 1_000)]);
            }
        }
    }
}

/// A limit does not stop a motion away from it.
#[test]
fn a_limit_is_of_one_direction() {
    let mut rig = Rig::wired(Kind::Plus, &["S1=2,0,0", "S2=3,0,0", "SL 20000"]);
    rig.after(100.millis());
    rig.low("IO2");
    rig.after(1.secs());
    rig.assert_values(&[("V", 20_000), ("ER", 0)]);
}

/// MC 5-30 and figure 5.1: homing slews at VM, ramps down, and creeps at VI to the edge of the switch. With a
/// small D the motor overshoots the switch, and homing ends at the same edge.
#[test]
fn homing_ends_at_an_edge_of_the_switch() {
    // Type, start position, and the edge of the switch (30,000 to 31,000) at which homing ends.
    let cases = [(1, 50_000, 31_000), (2, 50_000, 30_000), (3, 10_000, 30_000), (4, 10_000, 31_000)];
    for kind in KINDS {
        for (home, start, edge) in cases {
            for (d, overshoots) in [("D=1000000", false), ("D=50000", true)] {
                let mut rig = Rig::wired(kind, &["S3=1,0,0", "VM=20000", &format!("MA {start}")]);
                rig.wait_still(20.secs());
                rig.set(&[d, &format!("HM {home}")]);
                rig.assert_values(&[("MV", 1), ("MP", 0)]);
                let mut switches = [switch("IO3", 30_000, 31_000)];
                rig.machine(&mut switches, 60.secs());
                let position = rig.long(0x0057);
                let off = (position - edge).abs();
                assert!(off <= 2, "HM {home}, overshot {overshoots}: {position}, not {edge}");
                assert!(!switches[0].closed, "off the switch");
                rig.assert_values(&[("ER", 0), ("V", 0)]);
                assert_eq!(rig.word(0x002B), home, "HM reads the last type");
            }
        }
    }
}

#[test]
fn homing_needs_a_switch_and_a_type() {
    for kind in KINDS {
        let mut rig = Rig::wired(kind, &[]);
        rig.refused("HM 1", 80);
        assert_eq!(rig.try_write(0x002B, &[1]), Err(4));
        assert_eq!(rig.ef_er(), (1, 80));
        rig.set(&["S3=1,0,0"]);
        for line in ["HM 0", "HM 5", "HM"] {
            rig.refused(line, 81);
        }
        assert_eq!(rig.try_write(0x002B, &[5]), Err(3));
        assert_eq!(rig.ef_er(), (1, 81));
        // Homing is refused while the motor moves, and a move is refused during homing (MC 9.6).
        rig.set(&["SL 20000"]);
        rig.refused("HM 1", 85);
        rig.set(&["SL 0"]);
        rig.wait_still(1.secs());
        rig.write(0x002B, 2);
        rig.after(10.millis());
        rig.refused("MA 100", 85);
        rig.refused("MR 100", 85);
        rig.key(&[0x1B]);
        rig.wait_still(1.secs());
    }
}

/// MC 5-43: with LM 1 or 4 the first limit reverses homing, and the second limit ends it with error 82. With
/// LM 2, 3, 5 and 6 the first limit ends it.
#[test]
fn limits_turn_homing_back() {
    for mode in 1..=6 {
        let mut rig = Rig::wired(
            Kind::Plus,
            &["S1=2,0,0", "S2=3,0,0", "S3=1,0,0", "VM=20000", "D=1000000", &format!("LM={mode}")],
        );
        // Homing starts away from the home switch, towards the minus limit.
        let mut switches =
            [switch("IO1", 90_000, 99_999), switch("IO2", -99_999, -20_000), switch("IO3", 30_000, 31_000)];
        rig.set(&["HM 1"]);
        rig.machine(&mut switches, 60.secs());
        let position = rig.long(0x0057);
        if matches!(mode, 1 | 4) {
            assert!(
                (30_990..=31_010).contains(&position) || (29_990..=30_010).contains(&position),
                "{position}"
            );
        } else {
            assert!((-20_300..=-20_000).contains(&position), "{position} with LM={mode}");
            rig.assert_values(&[("ER", 84)]);
        }
        // There is no home switch between the limits.
        let mut rig =
            Rig::wired(Kind::Plus, &["S1=2,0,0", "S2=3,0,0", "S3=1,0,0", "VM=20000", &format!("LM={mode}")]);
        let mut switches = [switch("IO1", 20_000, 99_999), switch("IO2", -99_999, -20_000)];
        rig.set(&["HM 3"]);
        rig.machine(&mut switches, 60.secs());
        let position = rig.long(0x0057);
        if matches!(mode, 1 | 4) {
            assert!((-20_300..=-20_000).contains(&position), "{position}");
            rig.assert_values(&[("ER", 82)]);
        } else {
            assert!((20_000..=20_300).contains(&position), "{position} with LM={mode}");
            rig.assert_values(&[("ER", 83)]);
        }
    }
}

/// MC 5-39, 5-63: a jog input jogs at VM while JE is 1.
#[test]
fn jog_inputs_jog() {
    for kind in KINDS {
        let mut rig = Rig::wired(kind, &["S1=7,0,0", "S2=8,0,0", "VM=20000"]);
        rig.low("IO1");
        rig.after(100.millis());
        rig.assert_values(&[("MV", 0)]);
        rig.high("IO1");
        rig.set(&["JE=1"]);
        for (io, v) in [("IO1", 20_000), ("IO2", -20_000)] {
            rig.low(io);
            rig.after(500.millis());
            rig.assert_values(&[("V", v), ("MV", 1), ("MP", 0)]);
            rig.high(io);
            rig.wait_still(1.secs());
            rig.assert_values(&[("V", 0), ("ER", 0)]);
        }
    }
}

/// MC 5-63: a jog lasts as long as its contact is closed, even if the contact closes before the axis is at
/// rest.
#[test]
fn a_jog_input_that_is_held_jogs() {
    for kind in KINDS {
        let mut rig = Rig::wired(kind, &["S1=7,0,0", "S2=8,0,0", "VM=50000", "JE=1"]);
        rig.low("IO1");
        rig.after(100.millis());
        rig.high("IO1");
        rig.after(10.millis());
        rig.low("IO1");
        rig.after(300.millis());
        rig.assert_values(&[("V", 50_000), ("MV", 1)]);
        // A change from one direction to the other.
        rig.high("IO1");
        rig.low("IO2");
        rig.after(300.millis());
        rig.assert_values(&[("V", -50_000), ("ER", 0)]);
        // JE = 0 ends the jog, and JE = 1 starts it again: "the JE Flag must be set for this to function".
        rig.set(&["JE=0"]);
        rig.wait_still(1.secs());
        rig.assert_values(&[("V", 0)]);
        rig.set(&["JE=1"]);
        rig.after(300.millis());
        rig.assert_values(&[("V", -50_000), ("MV", 1)]);
    }
}

/// MC 5-63: a soft stop ends the motion with a ramp, and ends the program. Errors 48, 91 (MC 9.3, 9.6).
#[test]
fn a_soft_stop_stops_motion_and_program() {
    for kind in KINDS {
        let mut rig = Rig::wired(kind, &["S1=5,0,0"]);
        rig.program("PG 1\nLB G1\nIC R1\nH 10\nBR G1\nE\nPG");
        rig.set(&["EX 1", "SL 20000"]);
        rig.after(500.millis());
        rig.low("IO1");
        let reached = rig.long(0x0057);
        rig.wait_still(1.secs());
        let ramp = rig.long(0x0057) - reached;
        assert!((195..=220).contains(&ramp), "{ramp} steps");
        rig.assert_values(&[("BY", 0), ("V", 0)]);
        let error = rig.value("ER");
        assert!([48, 91].contains(&error), "{error}");
    }
}

/// MC 5-63, 7.2.5: a G0 input runs the program at address 1.
#[test]
fn an_input_runs_a_program() {
    let mut rig = Rig::wired(Kind::Plus, &["S1=4,0,0"]);
    rig.program("PG 1\nMR 20000\nH\nMR -20000\nH\nIC R1\nE\nPG");
    rig.low("IO1");
    rig.after(50.millis());
    rig.high("IO1");
    rig.assert_values(&[("BY", 1), ("MV", 1)]);
    rig.wait_end(5.secs());
    rig.assert_values(&[("P", 0), ("R1", 1), ("ER", 0)]);
}

/// MC 5-63: a pause input acts as PS and RS.
#[test]
fn an_input_pauses_a_program() {
    let mut rig = Rig::wired(Kind::Plus, &["S1=6,0,0"]);
    rig.program("PG 1\nMR 1000000\nH\nIC R1\nE\nPG");
    rig.set(&["EX 1"]);
    rig.after(800.millis());
    rig.low("IO1");
    rig.after(2.secs());
    rig.assert_values(&[("V", 0), ("R1", 0)]);
    let paused = rig.value("P");
    assert!(paused < 1_000_000);
    rig.high("IO1");
    rig.after(1.millis());
    rig.low("IO1");
    rig.high("IO1");
    rig.after(5.secs());
    rig.assert_values(&[("P", 1_000_000), ("R1", 1), ("BY", 0)]);
}

/// MC 5-63: a reset input acts as Ctrl-C.
#[test]
fn an_input_resets() {
    for kind in KINDS {
        let mut rig = Rig::wired(kind, &["RC=99", "S1=11,0,0", "SL 20000"]);
        rig.after(500.millis());
        rig.low("IO1");
        rig.after(START);
        rig.high("IO1");
        rig.after(START + 4.secs());
        assert_eq!((rig.word(0x0067), rig.word(0x004A), rig.long(0x0057)), (25, 0, 0), "RC, MV and P");
        assert!(rig.bench.ended(rig.modbus).is_none());
    }
}

/// MC 5-63, type 11: "If setting the input to sourcing, active true, ground the input first or a reset will
/// occur."
#[test]
fn an_open_input_that_is_set_up_as_a_reset_resets() {
    for grounds in [false, true] {
        let mut rig = Rig::plus();
        if grounds {
            rig.low("IO1");
        }
        rig.set(&["RC=99"]);
        rig.say("S1=11,1,1");
        rig.after(START);
        assert_eq!(rig.word(0x0067), if grounds { 99 } else { 25 }, "RC");
    }
}
