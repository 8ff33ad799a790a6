//! Examples of MC 8, and other programs that move the motor.

use super::*;

/// Waits for the end of motion, for a minute at most.
fn stands(dut: &mut Dut) {
    for _ in 0..60_000 {
        if dut.value(Reg::MV) == 0 {
            return;
        }
        dut.wait(1.millis());
    }
    panic!("the motor turns on");
}

/// EX with an address and with a label (MC 5-24).
#[test]
fn there_and_back() {
    for start in ["EX 100", "EX M1"] {
        let mut dut = Dut::new(Mdrive::plus());
        dut.store(100, "LB M1; P=0; MR 20000; H; MR -5000; H; R1=P; E");
        dut.commands(start);
        dut.wait(20.millis());
        assert_eq!((dut.value(Reg::BY), dut.value(Reg::MV)), (1, 1));
        dut.run_to_end();
        assert_eq!((dut.value(Reg::P), dut.value(Reg::R1), dut.value(Reg::MV)), (15_000, 15_000, 0));
    }
}

/// Motion continues when a program ends (MC 5-20).
#[test]
fn motion_goes_on_behind_the_end() {
    let mut dut = Dut::with("MR 100000; E");
    dut.run();
    assert_eq!(dut.value(Reg::MV), 1);
    stands(&mut dut);
    assert_eq!(dut.value(Reg::P), 100_000);
}

/// H waits for MT, too (MC 5-49): 20,000 steps with A = D = 1,000,000 from VI = 1,000 take 0.280 s.
#[test]
fn a_hold_waits_until_the_motor_has_settled() {
    let mut dut = Dut::with("MR 20000; H; R1=1; E");
    dut.commands("MT=500; EX 1");
    dut.wait(700.millis());
    assert_eq!((dut.value(Reg::V), dut.value(Reg::MV), dut.r()), (0, 1, [0; 4]));
    dut.wait(200.millis());
    assert_eq!((dut.value(Reg::MV), dut.r()), (0, [1, 0, 0, 0]));
}

/// PS stops program and motion, RS resumes both (MC 5-57, 5-61).
#[test]
fn a_pause_and_a_move() {
    let mut dut = Dut::with("MR 500000; H; R1=P; E");
    dut.commands("EX 1");
    dut.wait(500.millis());
    dut.commands("PS");
    dut.wait(10.secs());
    assert_eq!((dut.value(Reg::V), dut.value(Reg::R1), dut.value(Reg::BY)), (0, 0, 1));
    assert!((1..500_000).contains(&dut.value(Reg::P)));
    dut.commands("RS");
    dut.run_to_end();
    assert_eq!((dut.value(Reg::R1), dut.value(Reg::P)), (500_000, 500_000));
}

/// A number without a command repeats the last motion command (MC 5-45, 5-51).
#[test]
fn a_number_repeats_the_last_motion() {
    let mut dut = Dut::new(Mdrive::plus());
    for (line, position) in [("MR 10000", 10_000), ("5000", 15_000), ("MA 100", 100), ("-5", -5)] {
        dut.commands(line);
        stands(&mut dut);
        assert_eq!(dut.value(Reg::P), position, "{line}");
    }
    dut.commands("NE=0");
    assert_eq!(dut.command("5"), Err(Error::IllegalData));
    dut.commands("NE=1; SL 1000; 2000");
    dut.wait(100.millis());
    assert_eq!(dut.value(Reg::V), 2_000);
    dut.commands("0");
    stands(&mut dut);
}

/// Example of MC 8.1.
#[test]
fn example_8_1_move_on_an_input() {
    let mut dut = Dut::with(
        "LB Ga; P=0; LB G1; CL Kb,I1=1; H 10; BR G1
         LB Kb; MA 51200; H; MA 0; H; RT; E",
    );
    dut.commands("S1=0,0; MS=256; VM=2500000; VI=200000; A=1000000; D=A; HC=2; RC=75; P=0; EX 1");
    dut.wait(100.millis());
    assert_eq!((dut.value(Reg::MV), dut.value(Reg::P), dut.value(Reg::EF)), (0, 0, 0));
    dut.level(IO1, false);
    dut.wait(15.millis());
    dut.level(IO1, true);
    let mut furthest = 0;
    for _ in 0..1_000 {
        dut.wait(1.millis());
        furthest = furthest.max(dut.value(Reg::P));
    }
    assert_eq!((furthest, dut.value(Reg::P), dut.value(Reg::MV)), (51_200, 0, 0));
    assert_eq!((dut.value(Reg::BY), dut.value(Reg::EF)), (1, 0));
}

/// MC 8.2: "expected end position = 102400", after each of 100 moves.
#[test]
fn example_8_2_change_velocity_during_a_move() {
    let mut dut = Dut::with(
        "LB Ga; VI=20000; VM=500000; A=500000; D=800000000; R1=0; R2=0
         LB Gx; P=0; TP=51200,Kb; TE=2; SL 101200; H; H 250; R1=R1+1; R2=R2+P; BR Gx,R1<100; R2=R2/100
         PR \"Average end pos = \",R2; E
         LB Kb; SL 202400; TP=102290,Kc; TE=2; RT
         LB Kc; SL 0; H; RT",
    );
    dut.commands("MS=256; HC=20; RC=100");
    dut.out.messages.clear();
    dut.commands("EX Ga");
    for _ in 0..200 {
        dut.wait(1.secs());
    }
    assert_eq!(dut.value(Reg::BY), 0);
    assert_eq!((dut.value(Reg::R2), dut.value(Reg::R1), dut.value(Reg::EF)), (102_400, 100, 0));
    assert_eq!(dut.said(), "Average end pos = 102400\r\n");
}

/// MC 8.5: the user types values into registers, and X1 makes the program continue.
#[test]
fn example_8_5_user_input_into_variables() {
    let mut dut = Dut::new(Mdrive::plus());
    dut.commands("MS=256; VI=10000; VM=50000; A=10000; D=A; HC=5; RC=70; P=0; R1=0; R2=0; R3=0; VA X1=0");
    dut.store(
        1,
        "LB G1; P=0; X1=0; LB G2; H 20; BR G1,X1=0; LB G3; X1=0; A=R1; D=A; VM=R2; MR R3; H; H 500; BR G2",
    );
    dut.commands("EX 1");
    dut.wait(1.secs());
    assert_eq!((dut.value(Reg::MV), dut.value(Reg::BY)), (0, 1));
    dut.commands("R1=500000; R2=100000; R3=51200; X1=1");
    dut.wait(200.millis());
    assert_eq!((dut.value(Reg::MV), dut.user(b"X1")), (1, Some(0)));
    stands(&mut dut);
    assert_eq!((dut.value(Reg::P), dut.value(Reg::A), dut.value(Reg::VM)), (51_200, 500_000, 100_000));
    dut.commands("E");
}

/// MC 8.3, without the I/O points that models with Ethernet do not have.
#[test]
fn example_8_3_binary_mask() {
    let mut dut = Dut::with(
        "LB Ga; P=0; LB G1; R1=In; R1=R1 & 7; CL k0,R1 = 0; CL k1,R1 = 1; CL k2,R1 = 2; CL k3,R1 = 3; H 10; BR G1; E
         LB k0; PR \"Logic 000\"; MR 0*51200; H; H 200; RT
         LB k1; PR \"Logic 001\"; MR 1*51200; H; H 200; RT
         LB k2; PR \"Logic 010\"; MR 2*51200; H; H 200; RT
         LB k3; PR \"Logic 011\"; MR 3*51200; H; H 200; RT",
    );
    dut.commands("S1=0,1; S2=0,1; S3=0,1; S4=0,1; VM=1000000; VI=20000; A=500000; D=A");
    for (pin, high) in [(IO1, true), (Pin(1), true), (Pin(2), false), (IO4, true)] {
        dut.level(pin, high);
    }
    dut.out.messages.clear();
    dut.commands("EX Ga");
    dut.wait(100.millis());
    dut.level(IO1, false);
    dut.level(Pin(1), false);
    stands(&mut dut);
    dut.wait(50.millis());
    assert_eq!((&*dut.said(), dut.value(Reg::P)), ("Logic 011\r\n", 153_600));
    dut.wait(1.secs());
    dut.commands("E");
    assert!(dut.said().starts_with("Logic 011\r\nLogic 000\r\nLogic 000\r\n"), "{}", dut.said());
    assert_eq!((dut.value(Reg::P), dut.value(Reg::EF)), (153_600, 0));
}

/// MC 8.4: a blocked shaft stays behind. The subroutine prints by how many counts, and the error.
#[test]
fn example_8_4_closed_loop() {
    let mut dut = Dut::new(Mdrive::plus());
    dut.commands(
        "MS=256; HC=5; RC=80; EE=1; A=60000; D=A; VI=2048; VM=30000; S1=0,0; SF=15; SM=0; MT=50; VA Q1",
    );
    dut.store(
        1,
        "LB Ga; OE k1; P=0; LB Gb; MR 51200; H; H 500; MR -51200; H; H 500; IC Q1; BR Gb,Q1<100; E
         LB k1; R3=C1/25; R1=R3 - C2; PR \"Counts error = \",R1; PR \"Error = \",Er; Er=0; H 20; RT; E",
    );
    dut.out.messages.clear();
    dut.commands("C1=0; C2=0; EX 1");
    dut.wait(1.secs());
    assert_eq!((dut.value(Reg::EF), dut.value(Reg::MV)), (0, 1));
    dut.feed(Input::Fault { fault: STALL, on: true });
    dut.wait(100.millis());
    dut.feed(Input::Fault { fault: STALL, on: false });
    // The stall is detected at 15 counts behind, and the motor stops there.
    let said = dut.said();
    let (counts, error) = said.split_once("\r\n").unwrap();
    let counts: i32 = counts.strip_prefix("Counts error = ").unwrap().parse().unwrap();
    assert!((15..=16).contains(&counts), "{said}");
    assert_eq!((error, dut.value(Reg::EF)), ("Error = 86\r\n", 0));
    dut.wait(10.secs());
    assert_eq!((dut.value(Reg::BY), dut.user(b"Q1").is_some_and(|rounds| rounds > 0)), (1, true));
}

/// MC 8.6: the home switch is active below a position. Then each activation of the second input makes a move.
#[test]
fn example_8_6_closed_loop_with_homing() {
    let mut dut = Dut::new(Mdrive::plus());
    dut.commands(
        "EE=1; VM=4096; VI=VM/50; A=20480; D=A; HC=50; RC=50; MT=50; SF=20; SM=0; DB=5
         S1=1,0; S2=0,0; S3=17,0; S4=19,0; D1=100",
    );
    assert_eq!(dut.value(Reg::VI), 81);
    dut.store(
        1,
        "LB G1; H 1000; PR \"C1 \",C1; PR \"C2 \",C2; PM=1; PR \"C1 \",C1; PR \"C2 \",C2; H 5000; HM 1; H; P=0
         LB G2; BR G2,I2=0; MR 7186; H; PR \"p=\",P; BR G2; E",
    );
    dut.out.messages.clear();
    dut.commands("EX 1");
    // The switch is placed by C1's steps, because P becomes 0 there.
    let mut closed = false;
    for _ in 0..30_000 {
        dut.wait(1.millis());
        let low = dut.drive().motion.shaft().steps(dut.now) < -100_000;
        if low != closed {
            dut.level(IO1, !low);
            closed = low;
        }
    }
    assert_eq!(dut.said(), "C1 0\r\nC2 0\r\nC1 0\r\nC2 0\r\n");
    assert_eq!((dut.value(Reg::P), dut.value(Reg::MV), dut.value(Reg::EF)), (0, 0, 0));
    dut.level(Pin(1), false);
    dut.wait(1.secs());
    dut.level(Pin(1), true);
    dut.wait(5.secs());
    assert_eq!(dut.said(), "C1 0\r\nC2 0\r\nC1 0\r\nC2 0\r\np=7186\r\n");
    assert_eq!(dut.value(Reg::BY), 1);
}

/// MC 8.7: the edges of the input are half a second apart, at 50,000 steps/s.
#[test]
fn example_8_7_input_trip() {
    let mut dut = Dut::new(Mdrive::plus());
    dut.commands(
        "MS=256; HC=0; RC=100; D=800000000; VI=10000; VM=50000
         S1=0,0; S2=16,0; S3=16,0; S4=16,0; O2=1; O3=1; O4=1",
    );
    dut.store(
        1,
        "LB Ga; CL K1; SL 50000; LB Gb; H 10; BR Gb,Mv>0; R3=R2-R1; PR \"Distance between inputs = \",R3; H 1000; PR \" \"
         BR Ga; E
         LB K1; S1=0,0; Ti=1,K2; Te=1; RT
         LB K2; R1=Pc; S1=0,1; Ti=1,K3; Te=1; RT
         LB K3; R2=Pc; SL 0; LB K4; BR K4,Vc=1; RT; E",
    );
    dut.level(IO1, true);
    dut.out.messages.clear();
    dut.commands("EX Ga");
    dut.wait(1.secs());
    dut.level(IO1, false);
    assert_eq!((dut.value(Reg::TE), dut.value(Reg::PC)), (0, dut.value(Reg::P)));
    dut.wait(500.millis());
    dut.level(IO1, true);
    dut.wait(100.millis());
    assert_eq!(dut.said(), "Distance between inputs = 25000\r\n");
    assert_eq!((dut.value(Reg::MV), dut.value(Reg::EF)), (0, 0));
    dut.wait(1.secs());
    assert_eq!(dut.said(), "Distance between inputs = 25000\r\n \r\n");
    assert_eq!((dut.value(Reg::MV), dut.value(Reg::TE)), (1, 1));
}
