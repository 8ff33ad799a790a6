//! Lines, jumps, calls, errors, keys.

use super::*;

/// A line takes effect at the end of its 210 µs. Labels and E take the same time.
#[test]
fn a_line_takes_210_us() {
    let mut dut = Dut::with("LB G1; R1=1; R1=2; E");
    dut.commands("EX G1");
    assert_eq!(dut.value(Reg::BY), 1);
    dut.wait(420.micros() - Duration::TICK);
    assert_eq!(dut.value(Reg::R1), 0);
    dut.wait(Duration::TICK);
    assert_eq!(dut.value(Reg::R1), 1);
    dut.wait(420.micros() - Duration::TICK);
    assert_eq!((dut.value(Reg::R1), dut.value(Reg::BY)), (2, 1));
    dut.wait(Duration::TICK);
    assert_eq!(dut.value(Reg::BY), 0);
}

#[test]
fn arithmetic_and_a_loop() {
    let mut dut =
        Dut::with("LB G1; R1=0; R2=10; LB G2; R1=R1+R2; DC R2; BR G2,R2>0; R3=R1*3; R4=R3/4; R3=R3-R4; E");
    dut.run();
    assert_eq!(dut.r(), [55, 0, 124, 41]);
}

#[test]
fn logic_and_calls_within_calls() {
    let mut dut = Dut::with(
        "LB G1; R1=6; R1=R1 & 3; R2=R1 | 8; R3=R2 ^ 3; R4=0; CL K1,R3=9; CL K2,R3<>9; R4=R4+1; E
         LB K1; CL K3; RT
         LB K2; R4=1000; RT
         LB K3; R4=R3*R2; RT",
    );
    dut.run();
    assert_eq!(dut.r(), [2, 10, 9, 91]);
}

/// MC 4.9: 32 bits that wrap, and quotients without their fraction.
#[test]
fn numbers_wrap_and_quotients_are_cut() {
    let mut dut = Dut::new(Mdrive::plus());
    let mut value = |line: &str| {
        dut.commands(line);
        dut.value(Reg::R1)
    };
    assert_eq!(value("R1=-7/2"), -3);
    assert_eq!(value("R2=2147483647; R1=R2+1"), i32::MIN);
    assert_eq!(value("R1=R1/-1"), i32::MIN);
    assert_eq!(value("R1=65536; R1=R1*R1"), 0);
    assert_eq!(value("R1=! 5"), -6);
    assert_eq!(value("R1=2147483647; IC R1"), i32::MIN);
    assert_eq!(dut.command("R1=5/0"), Err(Error::IllegalValue));
    assert_eq!(dut.value(Reg::R1), i32::MIN);
}

#[test]
fn conditions() {
    let mut dut = Dut::with("R1=0; BR 4,R2<>3; R1=1; E");
    for (condition, holds) in [
        ("R2=3", true),
        ("R2=4", false),
        ("R2<>3", false),
        ("R2<4", true),
        ("R2<3", false),
        ("R2<=3", true),
        ("R2>2", true),
        ("R2>3", false),
        ("R2>=3", true),
        ("R2>=4", false),
        ("R2", true),
        ("R4", false),
    ] {
        dut.store(2, &std::format!("BR 4,{condition}"));
        dut.commands("R2=3");
        dut.run();
        assert_eq!(dut.value(Reg::R1), i32::from(!holds), "{condition}");
    }
}

/// Operators apply from left to right, as in programs of real machines: `R2 = P - R1 / 2` is half of the
/// difference. Each step has 32 bits.
#[test]
fn chains_of_operators() {
    let mut dut = Dut::new(Mdrive::plus());
    dut.commands("P=100; R1=20; R2 = P - R1 / 2");
    assert_eq!(dut.value(Reg::R2), 40);
    dut.commands("R3=NE*2+NE*8+NE/2");
    assert_eq!(dut.value(Reg::R3), 12, "(2 + 1) * 8 + 1, its half");
    dut.commands("R3=-R1+5*2");
    assert_eq!(dut.value(Reg::R3), -30);
    dut.commands("R3=2147483647+1/2");
    assert_eq!(dut.value(Reg::R3), -1_073_741_824);
    dut.commands("R3=6 & !2 | 9");
    assert_eq!(dut.value(Reg::R3), 13);
    dut.commands("VA Q1=R1*R1-1; MA R1*100+1");
    assert_eq!((dut.user(b"Q1"), dut.value(Reg::MA)), (Some(399), 2_001));
    assert_eq!(dut.command("R3=5+1/0"), Err(Error::IllegalValue));
}

/// "Flags as well as logical functions that are to be evaluated" (MC 5-6).
#[test]
fn conditions_with_logic() {
    let mut dut = Dut::with("R1=0; BR 4,R2<>3; R1=1; E");
    for (condition, holds) in [
        ("R2 & 4", true),
        ("R2 & 2", false),
        ("R2 & 4 = 4", true),
        ("R2 | 8 = 13", true),
        ("R2=5&NE", true),
        ("R2=4&NE", false),
        ("R2<>5&NE", false),
        ("R2=5&EE", false),
        ("R2=4|NE", true),
        ("!R2 & 2", true),
        ("R2-5", false),
        ("R2*2-1>8", true),
    ] {
        dut.store(2, &std::format!("BR 4,{condition}"));
        dut.commands("R2=5");
        dut.run();
        assert_eq!(dut.value(Reg::R1), i32::from(!holds), "{condition}");
    }
}

/// Programs of real machines report their own errors to the host in ER. Such an error does not call the
/// handler.
#[test]
fn a_program_sets_an_error() {
    let mut dut = Dut::with("OE K9; ER=83; R1=EF; E; LB K9; R2=1; RT");
    dut.run();
    assert_eq!((dut.r(), dut.value(Reg::ER)), ([1, 0, 0, 0], 83));
    dut.commands("ER=0");
    assert_eq!((dut.value(Reg::EF), dut.value(Reg::ER)), (0, 0));
    assert_eq!(dut.command("ER=256"), Err(Error::IllegalValue));
}

/// The program continues with the instruction after the one that caused the error (MC 5-52).
#[test]
fn an_error_calls_its_handler_and_the_program_goes_on() {
    let mut dut = Dut::with("LB G1; OE K9; R1=0; VM=1; R2=7; E; LB K9; R1=ER; RT");
    dut.run();
    let [r1, r2, ..] = dut.r();
    assert_eq!((r1, r2, dut.value(Reg::EF), dut.value(Reg::VM)), (23, 7, 0, 768_000));
}

/// "A program need not be running for the subroutine specified by OE to run" (MC 5-52).
#[test]
fn an_immediate_error_calls_the_handler_too() {
    let mut dut = Dut::with("LB K9; R1=ER; RT");
    dut.commands("OE K9");
    assert_eq!(dut.command("RC=101"), Err(Error::IllegalValue));
    assert_eq!((dut.value(Reg::BY), dut.value(Reg::EF)), (1, 1));
    dut.lines(3);
    assert_eq!((dut.value(Reg::R1), dut.value(Reg::BY), dut.value(Reg::EF)), (21, 0, 0));

    dut.commands("R1=0; OE 0");
    assert_eq!(dut.command("RC=101"), Err(Error::IllegalValue));
    dut.lines(3);
    assert_eq!((dut.value(Reg::R1), dut.value(Reg::ER)), (0, 21));
}

/// An error in the handler does not call the handler again, because the handler would never return.
#[test]
fn a_handler_that_fails_goes_on() {
    let mut dut = Dut::with("OE K9; VM=1; R2=7; E; LB K9; RC=101; R1=ER; RT");
    dut.run();
    assert_eq!(dut.r(), [21, 7, 0, 0]);
}

/// An error that ends the handler (30, 41, 42 or 43) does not call it, either.
#[test]
fn a_handler_that_fails_for_good_is_called_once() {
    for (line, error) in [("BR ZZ", 30), ("RT; RT", 41), ("BR 500", 42), ("CL K1", 43)] {
        let mut dut = Dut::with(&std::format!("LB K1; IC R2; {line}; RT"));
        dut.commands("OE K1");
        let _ = dut.command("XX");
        dut.wait(1.secs());
        // CL K1 nests 16 calls deeper than the handler, once.
        let (calls, error) = if line == "CL K1" {
            (17, error)
        } else if error == 41 {
            (1, 20)
        } else {
            (1, error)
        };
        assert_eq!((dut.value(Reg::R2), dut.value(Reg::ER), dut.value(Reg::BY)), (calls, error, 0), "{line}");
        // The next error calls the handler again.
        let _ = dut.command("XX");
        dut.wait(1.secs());
        assert_eq!(dut.value(Reg::R2), 2 * calls, "{line}");
    }
}

/// The handler has a stack entry of its own, so it can be called when the stack is full.
#[test]
fn a_full_stack_has_room_for_the_handler() {
    let mut dut = Dut::with(
        "LB G1; OE K2; R1=0; CL K1; R4=ER; E; LB K1; IC R1; CL K1,R1<16; RC=200; RT; LB K2; IC R2; R3=ER; RT",
    );
    dut.run();
    // RC = 200 fails on each of 16 levels.
    assert_eq!(dut.r(), [16, 16, 21, 0]);
}

/// "Program execution continues with the instruction after the one that caused the error" (MC 5-52). This
/// also applies after an overflow of calls: the seventeenth CL is skipped.
#[test]
fn after_an_overflow_the_handler_lets_the_program_go_on() {
    let mut dut = Dut::with("LB G1; OE K2; CL K1; R4=1; E; LB K1; IC R1; CL K1; RT; LB K2; IC R2; R3=ER; RT");
    dut.run();
    assert_eq!((dut.r(), dut.value(Reg::EF)), ([16, 1, 43, 1], 0));
}

/// A trip whose subroutine never returns overflows the stack. This is an error like any other.
#[test]
fn an_overflow_by_trips_calls_the_handler() {
    let mut dut = Dut::with("LB K1; TT=1,K1; TE=8; LB K2; IC R1; BR K2; LB K9; IC R2; R3=ER; RT");
    dut.commands("OE K9; CL K1");
    dut.wait(1.secs());
    assert_eq!((dut.value(Reg::R2), dut.value(Reg::R3), dut.value(Reg::BY)), (1, 43, 1));
}

/// Without a handler (OE), the errors 30, 41, 42 and 43 end a program. With a handler the program continues
/// (MC 5-52).
#[test]
fn what_cannot_go_on_ends_without_a_handler() {
    for (line, error) in
        [("BR Q9", 30), ("CL Q9", 30), ("R1=Q9", 30), ("RT", 41), ("BR 500", 42), ("CL 1", 43)]
    {
        let mut dut = Dut::with(line);
        dut.store(2, "R2=1; E; LB K9; R3=ER; RT");
        dut.run();
        assert_eq!((dut.value(Reg::ER), dut.value(Reg::R2)), (error, 0), "{line}");
        dut.commands("ER=0; OE K9");
        dut.run();
        assert_eq!((dut.value(Reg::ER), dut.r()), (0, [0, 1, error, 0]), "{line}");
    }
}

/// After errors other than these the program continues with its next line.
#[test]
fn other_errors_let_a_program_go_on() {
    for (line, error) in
        [("RC=101", 21), ("VI=768000", 22), ("VM=1", 23), ("BY=1", 25), ("IC MV", 26), ("TE=1", 27)]
    {
        let mut dut = Dut::with(line);
        dut.store(2, "R2=1; E");
        dut.run();
        assert_eq!((dut.value(Reg::ER), dut.value(Reg::R2)), (error, 1), "{line}");
    }
}

/// EF "is automatically cleared when a new program is executed" (MC 5-21).
#[test]
fn a_start_clears_the_error() {
    let mut dut = Dut::with("LB G1; E");
    assert_eq!(dut.command("EX G9"), Err(Error::UnknownLabel));
    assert_eq!(dut.command("EX 3"), Err(Error::IllegalAddress));
    assert_eq!((dut.value(Reg::EF), dut.value(Reg::BY)), (1, 0));
    dut.commands("EX G1");
    assert_eq!(dut.value(Reg::EF), 0);
}

/// A local variable is "erased and declared again each time a program is executed" (MC 3.2.2).
#[test]
fn local_variables_live_until_the_next_start() {
    let mut dut = Dut::with("LB G1; VA V1; VA V2=5; V1=V2*1000; E; LB G2; H 10; E");
    assert_eq!(dut.user(b"V1"), None);
    dut.commands("VA Q1=3; EX G1");
    dut.run_to_end();
    assert_eq!((dut.user(b"V1"), dut.user(b"V2"), dut.value(Reg::EF)), (Some(5_000), Some(5), 0));
    dut.commands("V1=6; EX G1");
    dut.run_to_end();
    assert_eq!((dut.user(b"V1"), dut.value(Reg::EF)), (Some(5_000), 0));
    dut.commands("EX G2");
    assert_eq!((dut.user(b"V1"), dut.user(b"Q1")), (None, Some(3)));
    assert_eq!(dut.command("VA Q1"), Err(Error::Redefined));
}

/// A program without E ends after its last line, as in MC 7.2.5.
#[test]
fn a_program_without_an_end_ends_behind_its_last_line() {
    let mut dut = Dut::with("R1=1; R2=1");
    dut.store(10, "R3=1; E");
    dut.run();
    assert_eq!((dut.r(), dut.value(Reg::EF)), ([1, 1, 0, 0], 0));
}

#[test]
fn a_branch_to_itself_takes_its_time() {
    let mut dut = Dut::with("LB G1; BR G1");
    dut.commands("EX G1");
    dut.wait(10.secs());
    assert_eq!(dut.value(Reg::BY), 1);
    dut.commands("E");
    assert_eq!(dut.value(Reg::BY), 0);
    // E while no program runs is not an error.
    dut.commands("E");
}

#[test]
fn a_hold_takes_its_time() {
    let mut dut = Dut::with("H 100; R1=1; E");
    dut.commands("EX 1");
    dut.wait(100.millis() + 420.micros() - Duration::TICK);
    assert_eq!(dut.value(Reg::R1), 0);
    dut.wait(Duration::TICK);
    assert_eq!(dut.value(Reg::R1), 1);
    dut.commands("E");
    // 40: "If HOLD (H) is entered in immediate mode and a program is not running" (MC 9.3).
    for (line, error) in [("H", 40), ("H 5", 40), ("BR 1", 46), ("RT", 46), ("LB K1", 46)] {
        assert_eq!(dut.command(line).map_err(|it| it as u8), Err(error), "{line}");
    }
    dut.store(1, "H 65001; R1=2; E");
    dut.commands("ER=0; EX 1");
    dut.run_to_end();
    assert_eq!((dut.value(Reg::ER), dut.value(Reg::R1)), (21, 2));
}

/// H may be typed, too (MC 5-27). Other statements that control a program may not (MC 5-6, 5-62).
#[test]
fn a_hold_is_typed() {
    let mut dut = Dut::with("LB G1; IC R1; BR G1");
    dut.commands("EX 1");
    dut.lines(5);
    for line in ["BR 1", "RT", "LB G1"] {
        assert_eq!(dut.command(line), Err(Error::NotInProgramMode), "{line}");
    }
    dut.commands("ER=0; H 100");
    let counted = dut.value(Reg::R1);
    dut.wait(100.millis());
    assert_eq!((dut.value(Reg::R1), dut.value(Reg::BY)), (counted, 1));
    dut.lines(3);
    assert_eq!(dut.value(Reg::R1), counted + 1);
    dut.commands("MR 100000; H");
    let counted = dut.value(Reg::R1);
    dut.wait(100.millis());
    assert_eq!((dut.value(Reg::R1), dut.value(Reg::MV)), (counted, 1));
    dut.wait(10.secs());
    assert!(dut.value(Reg::R1) > counted + 1_000);
}

/// PS pauses lines and times. RS continues with the remaining time.
#[test]
fn a_pause_holds_everything() {
    let mut dut = Dut::with("H 100; R1=1; E");
    dut.commands("EX 1");
    dut.wait(50.millis());
    dut.commands("PS");
    assert_eq!((dut.value(Reg::BY), dut.drive().mcode.vm.is_paused()), (1, true));
    dut.wait(10.secs());
    dut.commands("R2=5");
    for (line, error) in [("CL 2", 40), ("H 5", 40), ("BR 2", 46), ("RT", 46)] {
        assert_eq!(dut.command(line).map_err(|it| it as u8), Err(error), "{line}");
    }
    dut.commands("RS");
    dut.wait(50.millis() + 420.micros() - Duration::TICK);
    assert_eq!(dut.r(), [0, 5, 0, 0]);
    dut.wait(Duration::TICK);
    assert_eq!(dut.r(), [1, 5, 0, 0]);
}

/// After a pause has ended in any way, later commands are executed in order, and RS resumes nothing from
/// before.
#[test]
fn what_ends_a_program_ends_its_pause() {
    for way in ["E", "EX G1", "CP", "FD", "PS; RS; SL 0"] {
        for runs in [true, false] {
            let mut dut = Dut::with("LB G1; E; LB G2; BR G2");
            dut.commands("MR 100000; MR 7");
            dut.wait(50.millis());
            if runs {
                dut.commands("EX G2");
            }
            dut.commands("PS");
            dut.wait(1.secs());
            dut.commands(way);
            dut.wait(1.secs());
            let start = dut.value(Reg::P);
            dut.commands("RS; MR 1000; MR 1000");
            dut.wait(1.secs());
            assert_eq!((dut.value(Reg::P), dut.value(Reg::MV)), (start + 2_000, 0), "{way}, {runs}");
        }
    }
}

/// H in a program waits for all motion that the program has ordered, also if an earlier pause was ended by
/// its start.
#[test]
fn a_program_moves_after_a_pause_that_another_one_had() {
    let mut dut = Dut::with("MR 1000; MR 1000; H; R1=P; E");
    dut.commands("MR 100000; PS");
    dut.wait(1.secs());
    dut.commands("P=0");
    dut.run();
    assert_eq!((dut.value(Reg::R1), dut.value(Reg::ER)), (2_000, 0));
}

#[test]
fn a_new_start_replaces_what_runs() {
    let mut dut = Dut::with("LB G1; BR G1; LB G2; R1=1; E");
    dut.commands("EX G1");
    dut.lines(7);
    assert_eq!(dut.command("EX G9"), Err(Error::UnknownLabel));
    assert_eq!(dut.value(Reg::BY), 1);
    dut.commands("EX G2");
    dut.lines(3);
    assert_eq!((dut.value(Reg::R1), dut.value(Reg::BY)), (1, 0));
}

/// CL may be typed, too (MC 5-13): the subroutine runs, then the program continues.
#[test]
fn a_call_that_is_typed() {
    let mut dut = Dut::with("LB K1; R1=R1+1; RT; LB G1; IC R2; BR G1");
    dut.commands("CL K1");
    dut.lines(3);
    assert_eq!((dut.value(Reg::R1), dut.value(Reg::BY)), (1, 0));
    dut.commands("EX G1");
    dut.lines(30);
    let before = dut.value(Reg::R2);
    dut.commands("CL K1");
    dut.lines(3);
    assert_eq!((dut.value(Reg::R1), dut.value(Reg::R2), dut.value(Reg::BY)), (2, before, 1));
    dut.lines(30);
    assert_eq!(dut.value(Reg::R2), before + 10);
}

/// IV and IF (MC 5-36, 5-39, 8.5).
#[test]
fn input_into_a_variable() {
    let mut dut = Dut::with("IV R1; LB K1; BR K1,IF=1; R2=R1*2; E");
    dut.commands("EX 1");
    dut.wait(1.secs());
    assert_eq!((dut.value(Reg::IF), dut.value(Reg::BY)), (1, 1));
    assert_eq!(dut.command("IV R2"), Err(Error::InputPending));
    dut.commands("R3=5; -21");
    assert_eq!((dut.value(Reg::IF), dut.value(Reg::R1)), (0, -21));
    dut.run_to_end();
    assert_eq!(dut.r(), [-21, -42, 5, 0]);

    for (line, error) in [("IV Q1", 30), ("IV V", 25), ("IV I1", 25), ("IV PC", 25)] {
        assert_eq!(dut.command(line).map_err(|it| it as u8), Err(error), "{line}");
        assert_eq!(dut.value(Reg::IF), 0);
    }
    dut.commands("VA Q1; IV Q1; 7");
    assert_eq!(dut.user(b"Q1"), Some(7));
    dut.commands("IV Q1; IF=0");
    assert_eq!(dut.value(Reg::IF), 0);
    dut.commands("IV Q1");
    dut.command("").unwrap();
    assert_eq!(dut.value(Reg::IF), 0);
    // "IF=<0/1>" (MC 5-36): IF = 1 waits for the last variable of IV again. "IF Flag already TRUE" (MC 9.4,
    // 62).
    dut.commands("IF=1; 9");
    assert_eq!((dut.value(Reg::IF), dut.user(b"Q1")), (0, Some(9)));
    dut.commands("IF=1");
    assert_eq!(dut.command("IF=1"), Err(Error::InputPending));
    assert_eq!(dut.command("IV R1"), Err(Error::InputPending));
    dut.commands("IF=0");
    // Only CR accepts a fraction.
    dut.commands("IV CR; 1.5");
    assert_eq!(dut.value(Reg::CR), 1_500);
    dut.commands("IV R1");
    assert_eq!(dut.command("1.5"), Err(Error::IllegalData));
    assert_eq!((dut.value(Reg::IF), dut.value(Reg::R1)), (0, -21));
    // There was no motion command that a number could repeat.
    assert_eq!(dut.command("7"), Err(Error::IllegalData));
}

/// Local variables disappear at the next start. If IV waits for one of them, the wait ends.
#[test]
fn input_for_a_variable_that_is_gone() {
    let mut dut = Dut::with("VA Q1; IV Q1; E; LB G1; E");
    dut.run();
    assert_eq!(dut.value(Reg::IF), 1);
    dut.commands("EX G1");
    dut.run_to_end();
    assert_eq!(dut.value(Reg::IF), 0);
    dut.commands("IV R1; EX G1");
    dut.run_to_end();
    dut.commands("5");
    assert_eq!(dut.value(Reg::R1), 5);
}

/// Trace mode prints the lines of the program, but no typed lines (MC 5-24).
#[test]
fn trace_shows_each_line_when_it_acts() {
    let mut dut = Dut::with("LB G1; R1=1; E");
    dut.out.messages.clear();
    dut.commands("EX G1,1");
    assert_eq!(dut.said(), "");
    dut.lines(2);
    assert_eq!(dut.said(), "LB G1\r\nR1=1\r\n");
    dut.lines(1);
    assert_eq!(dut.said(), "LB G1\r\nR1=1\r\nE\r\n");
    assert_eq!(dut.command("EX G1,3"), Err(Error::IllegalValue));
}

/// "Each line will be executed and listed in the terminal window and the program will stop" (MC 6.1.9).
#[test]
fn single_steps_wait_for_a_key() {
    let mut dut = Dut::with("LB G1; R1=1; R2=1; R3=1; E");
    dut.out.messages.clear();
    dut.commands("EX G1,2");
    dut.wait(1.secs());
    assert_eq!(dut.said(), "LB G1\r\n");
    let key = |dut: &mut Dut, one| {
        assert!(dut.drive().mcode.vm.is_stepping());
        let now = dut.now;
        dut.drive.drive.mcode.vm.step(now, one);
        dut.wait(1.secs());
    };
    key(&mut dut, true);
    assert_eq!((&*dut.said(), dut.r()), ("LB G1\r\nR1=1\r\n", [1, 0, 0, 0]));
    dut.commands("R4=R1+6");
    key(&mut dut, false);
    assert_eq!((&*dut.said(), dut.r()), ("LB G1\r\nR1=1\r\n", [1, 1, 1, 7]));
    assert_eq!(dut.value(Reg::BY), 0);
}

/// "The program will then run normally the number of times specified by the count, then go into single-step
/// mode" (MC 5-5).
#[test]
fn a_break_point_stops_a_trace() {
    let program = "LB X1; R1=R1+1; BR X1,R1<9; E";
    for mode in [1, 2] {
        let mut dut = Dut::with(program);
        dut.commands("BP X1,3");
        dut.command(&std::format!("EX 1,{mode}")).unwrap();
        dut.wait(1.secs());
        assert_eq!(dut.value(Reg::R1), 3);
        assert!(dut.drive().mcode.vm.is_stepping());
    }
    let mut dut = Dut::with(program);
    dut.commands("BP X1; EX 1,1");
    dut.wait(1.secs());
    assert_eq!((dut.value(Reg::R1), dut.drive().mcode.vm.is_stepping()), (0, true));
    let mut dut = Dut::with(program);
    dut.commands("BP X1,3");
    dut.run();
    assert_eq!(dut.value(Reg::R1), 9);
    dut.commands("R1=0; BP 0; EX 1,1");
    dut.run_to_end();
    assert_eq!(dut.value(Reg::R1), 9);
}

/// A ratio of 1 is the number 1 for other variables. Its fraction is kept among ratios only.
#[test]
fn a_ratio_is_a_number_like_others() {
    let mut dut = Dut::with("LB G1; E");
    dut.commands("VA Q1=2; R1=1");
    for (line, ratio) in [
        ("CR=R1", 1_000),
        ("CR=Q1", 2_000),
        ("CR=CR/4", 500),
        ("CR=CR*3", 1_500),
        ("CR=CR-R1", 500),
        ("CR=R1+.25", 1_250),
        ("IC CR", 0),
        ("CR=.5; IC CR", 1_500),
        ("DC CR", 500),
        ("DC CR", 0),
        ("CR=1/2", 500),
        ("CR=R1*R1", 1_000),
        ("CR=2147483647*2147483647", 0),
        ("CR=3-R1", 2_000),
        ("CR=1.002", 1_002),
        ("R1=CR", 1_002),
        ("R2=CR*500", 1_002),
        ("CR=1.5; R3=CR", 1_500),
        ("R4=-CR", 1_500),
        ("MR CR", 1_500),
    ] {
        let done = line.split(';').map(|line| dut.command(line)).find(Result::is_err);
        // A value outside of the range changes nothing.
        let expected = (ratio == 0).then_some(Err(Error::IllegalValue));
        assert_eq!(done, expected, "{line}");
        if ratio != 0 {
            assert_eq!(dut.value(Reg::CR), ratio, "{line}");
        }
    }
    assert_eq!(dut.r(), [1, 501, 1, -1]);
    assert_eq!(dut.value(Reg::MR), 1);
    dut.wait(1.secs());
    for (condition, holds) in [
        ("CR=1.5", true),
        ("CR=1", false),
        ("CR>R1", true),
        ("R1=CR", false),
        ("1<CR", true),
        ("Q1>CR", true),
        ("CR<=Q1", true),
    ] {
        dut.commands("CP");
        dut.store(1, &std::format!("LB G1; R2=0; BR 5,{condition}; E; R2=1; E"));
        dut.run();
        assert_eq!(dut.value(Reg::R2) == 1, holds, "{condition}");
    }
}

/// MC 9 has no error for commands that MC 5 calls immediate. So a program may use them, and L prints to all
/// connections.
#[test]
fn a_program_may_list_itself() {
    let mut dut = Dut::with("LB G1; L 2; R1=1; E");
    dut.out.messages.clear();
    dut.run();
    assert_eq!((&*dut.said(), dut.r()), ("L 2\r\nR1=1\r\nE\r\n", [1, 0, 0, 0]));
    dut.store(10, "EX 20");
    dut.store(20, "R2=7; PS; R3=9; E");
    dut.commands("EX 10");
    dut.wait(1.secs());
    assert_eq!((dut.r(), dut.value(Reg::BY)), ([1, 7, 0, 0], 1));
    dut.commands("RS");
    dut.run_to_end();
    assert_eq!(dut.r(), [1, 7, 9, 0]);
}
