//! Programs: six with their results, started over both ports, and those of MC 8 as they are printed.

use drivetwin_protocol::time::Span;

use crate::rig::{KINDS, Rig};

/// Way in which a program is started.
#[derive(Clone, Copy, Debug)]
enum By {
    Mcode,
    Function65,
    Function66,
}

const WAYS: [By; 3] = [By::Mcode, By::Function65, By::Function66];

impl Rig {
    #[track_caller]
    fn start(&mut self, by: By, label: &str) {
        match by {
            By::Mcode => self.set(&[&format!("EX {label}")]),
            By::Function65 => {
                let pdu = [&[65][..], b"  XE", &[label.len() as u8], label.as_bytes()].concat();
                assert_eq!(self.ask(&pdu), [65, 0]);
            }
            By::Function66 => assert_eq!(self.try_write_specific(b"  XE", label), Ok(())),
        }
    }
}

/// Runs a test for both products and all ways to start a program.
fn each(test: impl Fn(Rig, By)) {
    for kind in KINDS {
        for by in WAYS {
            test(Rig::new(kind), by);
        }
    }
}

#[test]
fn sum() {
    each(|mut rig, by| {
        rig.program(
            "PG 1\nLB G1\nR1=0\nR2=10\nLB G2\nR1=R1+R2\nDC R2\nBR G2,R2>0\nR3=R1*3\nR4=R3/4\nR3=R3-R4\nE\nPG",
        );
        rig.start(by, "G1");
        rig.wait_end(1.secs());
        // 10 + 9 + ... + 1 is 55; 165/4 truncates.
        rig.assert_values(&[("R1", 55), ("R2", 0), ("R3", 124), ("R4", 41), ("BY", 0), ("ER", 0)]);
        assert_eq!([0x005F, 0x0061, 0x0063, 0x0065].map(|address| rig.long(address)), [55, 0, 124, 41]);
    });
}

#[test]
fn logic() {
    each(|mut rig, by| {
        rig.program(
            "PG 1\nLB G1\nR1=6\nR1=R1 & 3\nR2=R1 | 8\nR3=R2 ^ 3\nR4=0\nCL K1,R3=9\nCL K2,R3<>9\nR4=R4+1\nE\n\
             LB K1\nCL K3\nRT\nLB K2\nR4=1000\nRT\nLB K3\nR4=R3*R2\nRT\nPG",
        );
        rig.start(by, "G1");
        rig.wait_end(1.secs());
        rig.assert_values(&[("R1", 2), ("R2", 10), ("R3", 9), ("R4", 91), ("ER", 0)]);
    });
}

#[test]
fn there_and_back() {
    for label in ["100", "M1"] {
        each(|mut rig, by| {
            rig.program("PG 100\nLB M1\nP=0\nMR 20000\nH\nMR -5000\nH\nR1=P\nE\nPG");
            rig.start(by, label);
            rig.after(20.millis());
            rig.assert_values(&[("BY", 1), ("MV", 1)]);
            rig.wait_end(5.secs());
            rig.assert_values(&[("P", 15_000), ("R1", 15_000), ("MV", 0), ("ER", 0)]);
        });
    }
}

#[test]
fn trip() {
    each(|mut rig, by| {
        rig.program(
            "PG 1\nLB G1\nP=0\nR1=0\nTP=20000,K1\nTE=2\nSL 10000\nH\nR2=P\nE\nLB K1\nR1=R1+1\nSL 0\nRT\nPG",
        );
        rig.start(by, "G1");
        rig.wait_end(10.secs());
        rig.assert_values(&[("R1", 1), ("TE", 0), ("PC", 0), ("ER", 0)]);
        // The ramp is (10000² - 1000²)/(2 * 1000000) = 49.5 steps. The motor makes more steps, at 10,000 a
        // second, while lines are executed.
        let stopped = rig.value("R2");
        assert!((20_040..=20_300).contains(&stopped), "{stopped}");
    });
}

#[test]
fn on_error() {
    each(|mut rig, by| {
        rig.program("PG 1\nLB G1\nOE K9\nR1=0\nVM=1\nR2=7\nE\nLB K9\nR1=ER\nRT\nPG");
        rig.start(by, "G1");
        rig.wait_end(1.secs());
        rig.assert_values(&[("R1", 23), ("R2", 7), ("EF", 0), ("VM", 768_000)]);
        // OE works without a running program, too (MC 5-52).
        rig.say("R1=0");
        rig.say("RC=101");
        rig.after(100.millis());
        rig.assert_values(&[("R1", 21), ("EF", 0), ("BY", 0)]);
        // OE 0 switches the handler off.
        rig.say("OE 0");
        rig.say("R1=0");
        rig.say("RC=101");
        rig.after(100.millis());
        rig.assert_values(&[("R1", 0), ("EF", 1)]);
    });
}

#[test]
fn counter() {
    each(|mut rig, by| {
        rig.program("PG 200\nLB A3\nVA V1\nVA V2=5\nV1=V2*1000\nLB A4\nIC V1\nH 100\nBR A4,V1<5010\nE\nPG");
        assert_eq!(rig.try_words(0x00A8, 2), Err(2), "V1 before");
        rig.start(by, "A3");
        rig.after(600.millis());
        let counted = rig.long(0x00A8);
        assert!((5_003..=5_007).contains(&counted), "{counted}");
        rig.write_long(0x00AA, 77);
        rig.assert_values(&[("V2", 77)]);
        rig.wait_end(2.secs());
        assert_eq!(rig.long(0x00A8), 5_010);
        // E ends the program, so V1 stays as it is.
        rig.start(by, "A3");
        rig.after(300.millis());
        assert_eq!(rig.ask(&[65, b' ', b' ', b' ', b'E']), [65, 0]);
        let frozen = rig.long(0x00A8);
        assert!((5_001..=5_005).contains(&frozen), "{frozen}");
        rig.after(1.secs());
        assert_eq!(rig.long(0x00A8), frozen);
        rig.assert_values(&[("BY", 0), ("ER", 0)]);
    });
}

/// A line takes 210 µs: 1,000 turns of a loop of two lines take 0.42 s.
#[test]
fn lines_take_their_time() {
    let mut rig = Rig::plus();
    rig.program("PG 1\nLB G1\nIC R1\nBR G1\nE\nPG");
    rig.set(&["EX 1"]);
    rig.after(1.secs());
    // A turn has three lines: label, count and branch.
    let turns = rig.long(0x005F);
    assert!((1_580..=1_590).contains(&turns), "1 s / 630 µs is 1587, not {turns}");
}

/// MC 5-39, 8.5: a program waits for a number.
#[test]
fn a_program_waits_for_input() {
    let mut rig = Rig::plus();
    rig.program("PG 1\nIV R1\nLB K1\nBR K1,IF=1\nR2=R1*2\nE\nPG");
    rig.set(&["EX 1"]);
    rig.after(500.millis());
    rig.assert_values(&[("BY", 1), ("IF", 1), ("R2", 0)]);
    rig.say("21");
    rig.after(10.millis());
    rig.assert_values(&[("BY", 0), ("IF", 0), ("R1", 21), ("R2", 42)]);
}

/// MC 5-57, 5-61: immediate commands are allowed while a program is paused. After RS the motion continues to
/// its target.
#[test]
fn a_program_is_paused_with_its_motion() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        rig.program("PG 1\nMR 1000000\nH\nR1=P\nE\nPG");
        rig.set(&["EX 1"]);
        rig.after(800.millis());
        rig.set(&["PS"]);
        rig.after(2.secs());
        rig.assert_values(&[("V", 0)]);
        let paused = rig.value("P");
        assert!((200_000..1_000_000).contains(&paused), "{paused}");
        rig.set(&["R2=5"]);
        rig.after(5.secs());
        rig.assert_values(&[("P", paused), ("R1", 0)]);
        rig.set(&["RS"]);
        rig.wait_end(10.secs());
        rig.assert_values(&[("R1", 1_000_000), ("P", 1_000_000)]);
    }
}

/// MC 5-24, 6.1.9: trace mode lists lines as they are executed; in single-step mode a line waits for the
/// space bar.
#[test]
fn a_program_is_traced_and_stepped() {
    let mut rig = Rig::plus();
    rig.program("PG 1\nLB G2\nR1=1\nR2=2\nR3=3\nE\nPG");
    rig.set(&["EX G2,1"]);
    rig.after(100.millis());
    let text = rig.heard();
    for line in ["R1=1", "R2=2", "R3=3"] {
        assert!(text.contains(line), "{text:?}");
    }
    rig.set(&["R1=0", "R2=0", "R3=0"]);
    rig.say("EX G2,2");
    rig.after(100.millis());
    rig.heard();
    assert_eq!([0x005F, 0x0061, 0x0063].map(|address| rig.long(address)), [0, 0, 0]);
    // Each key executes one line. The label needed no key.
    let mut text = String::new();
    for stepped in [[1, 0, 0], [1, 2, 0]] {
        text += &rig.key(b" ");
        rig.after(100.millis());
        text += &rig.heard();
        assert_eq!([0x005F, 0x0061, 0x0063].map(|address| rig.long(address)), stepped);
    }
    assert_eq!(text, "R1=1\r\nR2=2\r\n", "each line is listed");
    assert_eq!(rig.value("BY"), 1);
    // Enter runs the rest without stopping.
    rig.key(b"\r");
    rig.after(100.millis());
    rig.heard();
    rig.assert_values(&[("R1", 1), ("R2", 2), ("R3", 3), ("BY", 0)]);
}

/// Types a program as the manual prints it: settings, then the lines from PG on.
fn printed(rig: &mut Rig, text: &str) {
    for line in text.lines() {
        assert_eq!(rig.say(line.trim()), "", "{line}");
    }
    assert_eq!(rig.value("ER"), 0, "the error");
}

/// Example program of MC 8.1.
#[test]
fn move_on_an_input() {
    let mut rig = Rig::plus();
    printed(
        &mut rig,
        "'Last modified: 01/26/2006
        S1=0,0 'set IO1 to gen. purpose input
        Ms=256
        Vm=2500000
        Vi=200000
        A=1000000
        D=A
        Hc=2
        Rc=75
        P=0
        PG 1
        LB Ga
          P=0
        LB G1
          CL Kb,I1=1
          H 10
          BR G1
        LB Kb
          MA 51200
          H
          MA 0
          H
          RT
        E
        PG",
    );
    rig.set(&["EX Ga"]);
    rig.after(1.secs());
    rig.assert_values(&[("P", 0), ("BY", 1)]);
    rig.low("IO1");
    rig.after(20.millis());
    rig.open("IO1");
    let mut most = 0;
    rig.wait(5.secs(), 1.millis(), |rig| {
        let position = rig.long(0x0057);
        most = most.max(position);
        most > 1_000 && position == 0 && rig.word(0x004A) == 0
    });
    assert_eq!(most, 51_200);
    rig.after(1.secs());
    rig.assert_values(&[("P", 0), ("BY", 1), ("ER", 0)]);
}

/// MC 8.2: "expected end position = 102400".
#[test]
fn change_velocity_during_a_move() {
    let mut rig = Rig::plus();
    printed(
        &mut rig,
        "Ms=256
        Hc=20
        Rc=100
        PG 1
        LB Ga
          Vm=500000
          Vi=20000
          A=500000
          D=800000000
          R1=0
          R2=0
        LB Gx
          P=0
          Tp=51200,Kb
          Te=2
          SL 101200
          H
          H 250
          R1=R1+1
          R2=R2+P
          BR Gx,R1<100
          R2=R2/100
          PR \"Average end pos = \",R2
          E
        LB Kb
          SL 202400
          Tp=102290,Kc
          Te=2
          RT
        LB Kc
          SL 0
          H
          RT
        PG",
    );
    rig.set(&["EX Ga"]);
    rig.wait_end(300.secs());
    assert_eq!(rig.heard(), "Average end pos = 102400\r\n");
    rig.assert_values(&[("R1", 100), ("ER", 0)]);
}

/// MC 8.3, with inputs that the test drives: 3 prints "Logic 011" and makes three turns.
#[test]
fn binary_mask() {
    let mut rig = Rig::plus();
    for name in ["IO1", "IO2"] {
        rig.high(name);
    }
    for name in ["IO3", "IO4"] {
        rig.low(name);
    }
    let mut text =
        "S1=0,1\nS2=0,1\nS3=0,1\nS4=0,1\nVm=1000000\nVi=20000\nA=500000\nD=A\nPG 1\nLB Ga\nP=0\nLB G1\n\
                    R1=In\nR1=R1 & 7\n"
            .to_owned();
    for n in 0..8 {
        text += &format!("CL k{n},R1 = {n}\n");
    }
    text += "H 10\nBR G1\nE\n";
    for n in 0..8 {
        text += &format!("LB k{n}\nPR \"Logic {n:03b}\"\nMR {n}*51200\nH\nH 200\nRT\n");
    }
    printed(&mut rig, &(text + "E\nPG"));
    rig.set(&["EX Ga"]);
    rig.wait(5.secs(), 1.millis(), |rig| rig.long(0x0057) == 3 * 51_200);
    for name in ["IO1", "IO2"] {
        rig.low(name);
    }
    rig.after(1.secs());
    let heard = rig.heard();
    assert!(heard.starts_with("Logic 011\r\n") && heard.ends_with("Logic 000\r\n"), "{heard:?}");
    assert_eq!(rig.long(0x0057) % 51_200, 0);
}

/// MC 8.4, with three repetitions instead of a hundred. Nothing holds the shaft, so there is no error.
#[test]
fn closed_loop() {
    let mut rig = Rig::plus();
    printed(
        &mut rig,
        "Ms=256
        Hc=5
        Rc=80
        Ee=1
        A=60000
        D=A
        Vi=2048
        Vm=30000
        S1=0,0
        Sf=15
        Sm=0
        Mt=50
        VA Q1
        PG 1
        LB Ga
          OE k1
          P=0
        LB Gb
          MR 51200
          H
          H 500
          MR -51200
          H
          H 500
          IC Q1
          BR Gb,Q1<3
        E
        LB k1
          R3=C1/25
          R1=R3 - C2
          PR \"Counts error = \",R1
          PR \"Error = \",Er
          Er=0
          H 20
          RT
        E
        PG",
    );
    rig.set(&["EX Ga"]);
    rig.wait_end(60.secs());
    assert_eq!(rig.heard(), "");
    rig.assert_values(&[("Q1", 3), ("ER", 0), ("ST", 0)]);
    let position = rig.value("P");
    assert!(position.abs() <= 10, "within the deadband of 10: {position}");
}

/// Example program of MC 8.5.
#[test]
fn user_input_into_variables() {
    let mut rig = Rig::plus();
    printed(
        &mut rig,
        "Ms=256
        Vi=10000
        Vm=50000
        A=10000
        D=A
        P=0
        R1=0
        R2=0
        R3=0
        VA X1=0
        PG 1
        LB G1
          P=0
          X1=0
        LB G2
          H 20
          BR G2,X1=0
        LB G3
          X1=0
          A=R1
          D=A
          Vm=R2
          MR R3
          H
          H 500
          BR G2
        PG",
    );
    rig.set(&["EX G1"]);
    rig.after(1.secs());
    rig.set(&["R1=500000", "R2=40000", "R3=51200", "X1=1"]);
    rig.after(5.secs());
    rig.assert_values(&[("P", 51_200), ("A", 500_000), ("D", 500_000), ("VM", 40_000), ("BY", 1), ("X1", 0)]);
}

/// Example program of MC 8.7.
#[test]
fn input_trip() {
    let mut rig = Rig::plus();
    printed(
        &mut rig,
        "Ms=256
        Hc=0
        Rc=100
        D=800000000
        Vm=50000
        Vi=10000
        S1=0,0
        S2=16,0
        S3=16,0
        S4=16,0
        O2=1
        O3=1
        O4=1
        PG 1
        LB Ga
          CL K1
          SL 50000
        LB Gb
          H 10
          BR Gb,Mv>0
          R3=R2-R1
          PR \"Distance between inputs = \",R3
          H 1000
          PR \" \"
          BR Ga
          E
        LB K1
          S1=0,0
          Ti=1,K2
          Te=1
          RT
        LB K2
          R1=Pc
          S1=0,1
          Ti=1,K3
          Te=1
          RT
        LB K3
          R2=Pc
          SL 0
        LB K4
          BR K4,Vc=1
          RT
        E
        PG",
    );
    rig.high("IO1");
    rig.set(&["EX Ga"]);
    rig.after(500.millis());
    rig.low("IO1");
    let first = rig.long(0x0057);
    rig.after(200.millis());
    rig.high("IO1");
    let second = rig.long(0x0057);
    rig.after(500.millis());
    // 0.2 s at 50,000 steps/s.
    assert!((second - first - 10_000).abs() <= 1);
    let heard = rig.heard();
    let distance = heard.strip_prefix("Distance between inputs = ").and_then(|text| text.lines().next());
    let distance: i32 = distance.unwrap_or_else(|| panic!("{heard:?}")).parse().expect("a number");
    assert!((distance - (second - first)).abs() <= 2, "{distance}");
    rig.assert_values(&[("ER", 0)]);
}

/// MC 5-40: "PG 100, LB G1, PG 1, LB SU". PG with an address in program mode continues at that address.
#[test]
fn labels_of_the_manual_are_typed_in_one_go() {
    let mut rig = Rig::plus();
    rig.program("PG 100\nLB G1\nPG 1\nLB SU\nPG");
    assert_eq!(rig.say("L"), "LB SU\r\nLB G1\r\n");
}

/// MC 5-27: "Suspend program execution for 2 seconds", Program/Immediate: H can be typed while a program
/// runs.
#[test]
fn a_program_is_held_by_hand() {
    let mut rig = Rig::plus();
    rig.program("PG 1\nLB G1\nIC R1\nBR G1\nPG");
    rig.set(&["EX 1"]);
    rig.after(100.millis());
    rig.set(&["H 2000"]);
    let held = rig.value("R1");
    assert!(held > 0);
    rig.after(1_990.millis());
    rig.assert_values(&[("R1", held), ("BY", 1)]);
    rig.after(20.millis());
    assert!(rig.value("R1") > held);
}

/// L is an immediate command (MC 5-40), but MC 9 has no error for L in a program. So L prints there, too.
#[test]
fn a_program_lists_itself() {
    let mut rig = Rig::plus();
    rig.program("PG 1\nLB G1\nL 2\nE\nPG");
    rig.say("EX 1");
    rig.after(10.millis());
    assert_eq!(rig.heard(), "L 2\r\nE\r\n");
    rig.assert_values(&[("ER", 0)]);
}

/// Programs of real machines (firmware 3) have features that the manual does not show: chains of operators,
/// logic in conditions, addresses above 767, error numbers of their own. Comments of their authors say that
/// chains and logic are evaluated from left to right. This program watches a move and reports its end with a
/// word of flags.
#[test]
fn a_program_as_real_machines_hold_it() {
    let mut rig = Rig::plus();
    rig.program(
        "VA Wd     ' word of flags
        VA Sa     ' state: 0 stands, 1 moves, 2 has moved
        VA Lt     ' type of input 1
        Sa 0
        Lt 3
        S1 = Lt, 1, 0
        Ne 0      ' no motion by a number alone
        P=-0
        PG 1000
          LB Wa             ' waits for a move
            CL Ya, Sa<>1&Mv ' begins to move
            CL Yb, Sa=1&!Mv ' has moved
            BR Wz, Sa=2
            H  1
            BR Wa

          LB Ya
            Sa 1
            RT
          LB Yb
            Sa 2
            Wd NE*2+EE*2+ST*8+Sa/2    ' bits 5, 4, 3 and 0
            R2 = P - R1 / 2
            RT
          LB Wz
            PR \"W\",Wd,\",H\",R2
            ER = 83
          E
        PG",
    );
    rig.set(&["R1=51200", "EX 1000", "MR 153600"]);
    rig.wait_end(10.secs());
    // (((0 * 2 + 0) * 2 + 0) * 8 + 2) / 2, and (153600 - 51200) / 2.
    assert_eq!(rig.heard(), "W1,H51200\r\n");
    rig.assert_values(&[("EF", 1), ("ER", 83), ("EF", 0)]);
    assert!(rig.say("L 1000").starts_with("LB WA\r\nCL YA, SA<>1&MV\r\n"));
}
