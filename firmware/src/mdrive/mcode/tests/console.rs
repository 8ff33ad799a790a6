//! Output on a connection, byte by byte (MC 7.1.1).

use std::string::ToString;

use proptest::prelude::*;

use super::super::super::IO1;
use super::*;

#[test]
fn mode_0_echoes_each_character_and_prompts() {
    let mut dut = Dut::plus();
    assert_eq!(dut.types("P"), "P");
    assert_eq!(dut.types("R"), "R");
    assert_eq!(dut.types(" P"), " P");
    assert_eq!(dut.types("\r"), "\r\n0\r\n>");
    assert_eq!(dut.types("r1=5\r"), "r1=5\r\n>");
    assert_eq!(dut.types("\r"), "\r\n>");
    assert_eq!(dut.types("PR \"R1 = \",R1\r"), "PR \"R1 = \",R1\r\nR1 = 5\r\n>");
    assert_eq!(dut.types("PR R1;\r"), "PR R1;\r\n5>");
}

#[test]
fn mode_1_sends_cr_lf_and_no_prompt() {
    let mut dut = Dut::ready(Mdrive::plus(), 1);
    assert_eq!(dut.types("R1=5"), "");
    assert_eq!(dut.types("\r"), "\r\n");
    assert_eq!(dut.types("PR R1\r"), "\r\n5\r\n");
    assert_eq!(dut.types("HELLO\r"), "\r\n");
    assert_eq!(dut.get(Reg::ER), 20);
}

#[test]
fn mode_2_sends_nothing_but_what_is_printed() {
    let mut dut = Dut::quiet();
    assert_eq!(dut.types("R1=5\rHELLO\r\r"), "");
    assert_eq!(dut.types("PR R1\r"), "5\r\n");
    assert_eq!(dut.types("PG 1\rLB G1\rPG\rL\r"), "LB G1\r\n");
}

#[test]
fn mode_3_echoes_a_line_once_it_has_ended() {
    let mut dut = Dut::ready(Mdrive::plus(), 3);
    assert_eq!(dut.types("R1=5"), "");
    assert_eq!(dut.types("\r"), "R1=5\r\n");
    assert_eq!(dut.types("PR R1\r"), "PR R1\r\n5\r\n");
}

#[test]
fn a_mode_that_is_set_shows_in_the_prompt() {
    let mut dut = Dut::plus();
    assert_eq!(dut.types("EM=2\r"), "EM=2\r\n");
    assert_eq!(dut.types("em 0\r"), ">");
    assert_eq!(dut.types("EM 3\r"), "EM 3\r\n");
    assert_eq!(dut.types("EM=1\r"), "EM=1\r\n");
    assert_eq!(dut.types("EM=4\r"), "\r\n");
    assert_eq!((dut.get(Reg::EM), dut.get(Reg::ER)), (1, 21));
}

#[test]
fn a_question_mark_is_the_prompt_until_the_error_is_read() {
    let mut dut = Dut::plus();
    assert_eq!(dut.types("RC=110\r"), "RC=110\r\n?");
    assert_eq!(dut.types("RC=50\r"), "RC=50\r\n?");
    assert_eq!(dut.types("PR ER\r"), "PR ER\r\n21\r\n>");
    assert_eq!(dut.types("PR ER\r"), "PR ER\r\n0\r\n>");
    assert_eq!(dut.types("HELLO\r"), "HELLO\r\n?");
    assert_eq!(dut.types("ER=0\r"), "ER=0\r\n>");
}

#[test]
fn cr_and_lf_and_both_end_a_line_once() {
    let mut dut = Dut::plus();
    for end in ["\r", "\n", "\r\n"] {
        assert_eq!(dut.types(&std::format!("PR P{end}")), "PR P\r\n0\r\n>", "{end:?}");
    }
    assert_eq!(dut.types("\r\n\r\n"), "\r\n>\r\n>");
    assert_eq!(dut.types("\n\n"), "\r\n>\r\n>");
    // The LF comes in another packet.
    assert_eq!(
        (dut.types("\r"), dut.types("\n"), dut.types("\n")),
        ("\r\n>".into(), "".into(), "\r\n>".into())
    );
}

/// Each line takes effect before the next one, however many lines a message has.
#[test]
fn lines_of_one_message_come_one_after_the_other() {
    let mut dut = Dut::quiet();
    dut.types_lines("S1=2,0");
    dut.feed(Input::Edge { pin: IO1, high: false });
    for end in ["\n", "\r", "\r\n"] {
        assert_eq!(dut.types(&["MR 1", "PR EF,ER", "MR 1", ""].join(end)), "183\r\n", "{end:?}");
        dut.types("ER=0\n");
        assert_eq!(dut.types(&std::format!("{}PR ER\n", std::format!("MR 1{end}").repeat(1_000))), "83\r\n");
    }
    // Output type 17 is active in motion.
    dut.types("S2=17,1\n");
    assert_eq!(dut.types("PR O2\nMR -1000\nPR O2\n"), "0\r\n1\r\n");
}

/// "This varies from command to command and usually is in the 1-5 millisecond range" (MC 7.1). By table 7.1
/// the echo is sent at once and the rest after this time.
#[test]
fn a_command_takes_1_to_5_ms() {
    for (line, ms) in [
        ("", 1),
        ("'nothing", 1),
        ("HELLO", 1),
        ("R1=5", 2),
        ("MR 1000", 2),
        ("EX 1", 2),
        ("PR P", 2),
        ("PR EF,\"_\"ER", 4),
        ("PR P,\"_\"V,\"_\"MV,\"_\"VC", 5),
        ("PR AL", 5),
        ("L", 5),
        ("S", 5),
        ("CP", 5),
    ] {
        let mut dut = Dut::plus();
        let began = dut.now;
        dut.feed(Input::Message { port: MCODE, link: HERE, bytes: line.as_bytes() });
        dut.feed(Input::Message { port: MCODE, link: HERE, bytes: b"\r" });
        dut.run_until(began + crate::device::Duration::millis(ms) - crate::device::Duration::TICK);
        assert_eq!(dut.bytes(), line.as_bytes(), "{line}");
        assert_eq!((dut.get(Reg::R1), dut.get(Reg::ER), dut.get(Reg::MV)), (0, 0, 0), "{line}");
        dut.wait(crate::device::Duration::TICK);
        assert!(dut.bytes()[line.len()..].starts_with(b"\r\n"), "{line}");
        assert!(dut.bytes().ends_with(b">") || dut.bytes().ends_with(b"?"), "{line}");
    }
    let mut dut = Dut::plus();
    dut.types_lines("PG 1");
    let began = dut.now;
    dut.types("R1=5\r");
    assert_eq!(dut.now, began + crate::device::Duration::millis(4), "a line of a program is stored");
}

#[test]
fn what_is_typed_meanwhile_waits_in_its_order() {
    let mut dut = Dut::quiet();
    let (began, there) = (dut.now, Link(1));
    let ms = crate::device::Duration::millis;
    dut.feed(Input::Opened { port: MCODE, link: there });
    dut.feed(Input::Message { port: MCODE, link: HERE, bytes: b"R1=1\rPR R1\rR1=2" });
    dut.feed(Input::Message { port: MCODE, link: there, bytes: b"R1=3\rPR R1\r" });
    dut.feed(Input::Message { port: MCODE, link: HERE, bytes: b"4\rPR R1\r" });
    // Each line takes 2 ms.
    let said = |dut: &Dut| dut.said().iter().map(|(link, text)| (*link, text.clone())).collect::<Vec<_>>();
    let mut expected = Vec::new();
    for (number, (link, text)) in
        [(HERE, "1\r\n"), (there, "3\r\n"), (HERE, "24\r\n")].into_iter().enumerate()
    {
        dut.run_until(began + ms(4 + 4 * number as u64) - crate::device::Duration::TICK);
        assert_eq!(said(&dut), expected);
        assert!(!dut.drive.takes(MCODE) && dut.drive.takes(Port(0)));
        expected.push((link, text.to_string()));
        dut.run_until(began + ms(4 + 4 * number as u64));
        assert_eq!(said(&dut), expected);
    }
    assert!(dut.drive.takes(MCODE));
}

/// A key after a line takes effect after the line, also from another connection. So nothing begins to move
/// after an Esc that was typed after the line.
#[test]
fn an_escape_waits_for_the_line_before_it() {
    for link in [HERE, Link(1)] {
        let mut dut = Dut::quiet();
        dut.feed(Input::Opened { port: MCODE, link: Link(1) });
        dut.feed(Input::Message { port: MCODE, link: HERE, bytes: b"SL 100000\r" });
        dut.feed(Input::Message { port: MCODE, link, bytes: b"\x1b" });
        dut.wait(crate::device::Duration::millis(2));
        assert_eq!(dut.get(Reg::SL), 100_000);
        dut.wait(crate::device::Duration::secs(1));
        assert_eq!((dut.get(Reg::MV), dut.get(Reg::V)), (0, 0));
    }
}

#[test]
fn who_goes_while_his_line_is_executed_leaves_nothing_behind() {
    let mut dut = Dut::quiet();
    let there = Link(1);
    dut.feed(Input::Opened { port: MCODE, link: there });
    dut.feed(Input::Message { port: MCODE, link: there, bytes: b"R1=1\rR1=2\r" });
    dut.feed(Input::Message { port: MCODE, link: HERE, bytes: b"PR R1\r" });
    dut.feed(Input::Closed { port: MCODE, link: there });
    dut.wait(crate::device::Duration::millis(2));
    assert_eq!(dut.said(), [(HERE, "0\r\n".to_string())]);
    assert!(dut.drive.takes(MCODE));
}

#[test]
fn backspace_takes_back_what_is_there() {
    let mut dut = Dut::plus();
    assert_eq!(dut.types("PR X\x08P\r"), "PR X\x08 \x08P\r\n0\r\n>");
    assert_eq!(dut.types("\x08\x7f"), "");
    assert_eq!(dut.types("A\x7f\r"), "A\x08 \x08\r\n>");
}

#[test]
fn other_control_characters_are_nothing() {
    let mut dut = Dut::plus();
    assert_eq!(dut.types("\0P\x01R P\x05\x16\r"), "PR P\r\n0\r\n>");
}

#[test]
fn a_line_has_64_characters() {
    let mut dut = Dut::plus();
    let line = std::format!("R1=5 '{}", "x".repeat(58));
    assert_eq!(line.len(), 64);
    assert_eq!(dut.types(&std::format!("{line}\r")), std::format!("{line}\r\n>"));
    assert_eq!(dut.get(Reg::R1), 5);

    // "If the buffer length is exceeded a CR/LF will occur and set error 20" (MC 5-57).
    let line = std::format!("R1=7 '{}", "x".repeat(59));
    assert_eq!(dut.types(&line), std::format!("{}\r\n?", &line[..64]));
    assert_eq!(dut.types("R1=9"), "");
    assert_eq!(dut.types("\r"), "");
    assert_eq!((dut.get(Reg::R1), dut.get(Reg::ER)), (5, 20));
    assert_eq!(dut.types("PR ER\r"), "PR ER\r\n20\r\n>");
}

#[test]
fn a_line_that_is_too_long_is_answered_as_the_mode_says() {
    for (mode, answer) in
        [(1, "\r\n".to_string()), (2, String::new()), (3, std::format!("{}\r\n", "1".repeat(64)))]
    {
        let mut dut = Dut::ready(Mdrive::plus(), mode);
        assert_eq!(dut.types(&std::format!("{}\r", "1".repeat(70))), answer);
        assert_eq!(dut.get(Reg::ER), 20);
    }
}

#[test]
fn connections_have_lines_of_their_own() {
    let mut dut = Dut::plus();
    let there = Link(1);
    dut.feed(Input::Opened { port: MCODE, link: there });
    assert_eq!(dut.said(), [], "nobody is greeted");
    assert_eq!(dut.types("PR \"he"), "PR \"he");
    assert_eq!(dut.types_on(there, "R1=5\r"), "R1=5\r\n>");
    assert_eq!(dut.types("re\"\r"), "re\"\r\nhere\r\n>");
    // Echo mode belongs to the drive, not to the connection.
    dut.types_on(there, "EM=2\r");
    assert_eq!(dut.types("PR R1\r"), "5\r\n");
    // When a connection is closed, its unfinished line is dropped.
    dut.types_on(there, "R1=");
    dut.feed(Input::Closed { port: MCODE, link: there });
    dut.feed(Input::Opened { port: MCODE, link: there });
    assert_eq!(dut.types_on(there, "PR R1\r"), "5\r\n");
}

#[test]
fn a_fifth_connection_is_closed() {
    let mut dut = Dut::quiet();
    for link in 1..=3 {
        dut.feed(Input::Opened { port: MCODE, link: Link(link) });
    }
    assert_eq!(dut.out.closed, []);
    dut.feed(Input::Opened { port: MCODE, link: Link(4) });
    assert_eq!(dut.out.closed, [(dut.now, MCODE, Link(4))]);
    assert_eq!(dut.types_on(Link(4), "PR 1\r"), "");
    assert_eq!(dut.types_on(Link(3), "PR R1\r"), "0\r\n");
    dut.feed(Input::Closed { port: MCODE, link: Link(3) });
    dut.feed(Input::Opened { port: MCODE, link: Link(5) });
    assert_eq!(dut.types_on(Link(5), "PR R1\r"), "0\r\n");
}

#[test]
fn what_a_program_prints_goes_to_all() {
    let mut dut = Dut::quiet();
    dut.feed(Input::Opened { port: MCODE, link: Link(1) });
    dut.types_lines("PG 1\nPR \"all\"\nE\nPG\nEX 1");
    dut.wait(crate::device::Duration::millis(10));
    for link in [HERE, Link(1)] {
        assert!(dut.said().contains(&(link, "all\r\n".into())), "{link:?}");
    }
}

const SIGN_ON: &str = "Copyright 2001-2010 by Schneider Electric Motion USA.\r\n";

#[test]
fn the_answer_to_fd_is_the_sign_on() {
    let mut dut = Dut::plus();
    dut.types_lines("R1=5\nEM=1");
    assert_eq!(dut.types("FD\r"), std::format!("\r\n{SIGN_ON}>"));
    assert_eq!(dut.types("PR R1 EM\r"), "PR R1 EM\r\n00\r\n>");
}

#[test]
fn ctrl_c_starts_the_drive_again_and_connections_stay() {
    let mut dut = Dut::plus();
    dut.types_lines("R1=5\nS");
    dut.wait(crate::device::Duration::millis(100));
    dut.types_lines("R1=6\nPG 100");
    dut.types("PR \"lost");
    dut.types("\x03");
    dut.wait(crate::device::Duration::secs(1));
    assert_eq!(dut.said().last(), Some(&(HERE, ">".to_string())));
    assert!(dut.said().iter().any(|(_, text)| text == SIGN_ON));
    assert_eq!(dut.types("PR R1\r"), "PR R1\r\n5\r\n>");
}

/// The sign-on begins on a new line.
#[test]
fn ctrl_c_ends_the_line_that_is_typed() {
    let mut dut = Dut::plus();
    let sign_on = "Copyright 2001-2010 by Schneider Electric Motion USA.\r\n";
    assert_eq!(dut.types("PR P\x03"), std::format!("PR P\r\n{sign_on}>"));
    assert_eq!(dut.types("PR R1\r"), "PR R1\r\n0\r\n>");
    assert_eq!(dut.types("EM=1\rS\r"), "EM=1\r\n\r\n");
    dut.wait(crate::device::Duration::secs(1));
    assert_eq!(dut.types("PR P\x03"), sign_on);
}

/// Input that IV waits for, but that is not a number, ends the wait with its carriage return (MC 5-36).
#[test]
fn a_bad_number_ends_an_input() {
    let mut dut = Dut::quiet();
    for (line, error) in [("12a", 24), ("99999999999", 21), ("5,", 24)] {
        dut.types_lines("IV R1");
        assert_eq!(dut.error_of(line), error, "{line}");
        assert_eq!(dut.get(Reg::IF), 0, "{line}");
    }
    // Lines typed in program mode, and commands, do not end the wait of IV.
    dut.types_lines("IV R1\nPG 1");
    assert_eq!(dut.error_of("12a"), 24);
    dut.types_lines("PG\nPR R1");
    assert_eq!(dut.get(Reg::IF), 1);
    dut.types_lines("7");
    assert_eq!((dut.get(Reg::R1), dut.get(Reg::IF)), (7, 0));
}

#[test]
fn ctrl_c_is_nothing_with_ce_0() {
    let mut dut = Dut::plus();
    assert_eq!(dut.types("CE=0\rR1=6\r\x03PR R1\r"), "CE=0\r\n>R1=6\r\n>PR R1\r\n6\r\n>");
}

#[test]
fn the_drive_hears_nothing_while_it_starts() {
    let mut dut = Dut::plus();
    dut.fixture.power_on(Boot::default());
    dut.feed(Input::Opened { port: MCODE, link: HERE });
    assert_eq!(dut.types("R1=5\r"), "");
    dut.wait(crate::device::Duration::secs(1));
    assert_eq!(dut.said().pop(), Some((HERE, ">".to_string())));
    assert_eq!(dut.types("R1=6\r\x03R1=7\rPR R1\r"), "R1=6\r\n>");
    dut.wait(crate::device::Duration::secs(1));
    assert_eq!(dut.types("PR R1\r"), "PR R1\r\n0\r\n>");
}

#[test]
fn escape_ends_the_program_and_the_line() {
    let mut dut = Dut::plus();
    dut.types_lines("PG 1\nLB G1\nBR G1\nPG\nEX 1");
    dut.wait(crate::device::Duration::millis(10));
    assert_eq!(dut.get(Reg::BY), 1);
    assert_eq!(dut.types("R1=5\x05"), "R1=5");
    assert_eq!(dut.types("\x1b"), "\r\n>");
    assert_eq!(dut.get(Reg::BY), 0);
    assert_eq!(dut.types("\r"), "\r\n>");
    assert_eq!(dut.get(Reg::R1), 0);
    // With ES 0 the key is Ctrl-E (MC 5-23).
    dut.types_lines("ES=0\nEX 1");
    assert_eq!(dut.types("\x1b"), "");
    dut.wait(crate::device::Duration::millis(10));
    assert_eq!(dut.get(Reg::BY), 1);
    assert_eq!(dut.types("\x05"), "\r\n>");
    assert_eq!(dut.get(Reg::BY), 0);
}

#[test]
fn escape_stops_the_motor_on_the_spot() {
    let mut dut = Dut::quiet();
    dut.types_lines("SL 100000");
    dut.wait(crate::device::Duration::millis(50));
    assert_eq!(dut.get(Reg::MV), 1);
    dut.types("\x1b");
    dut.wait(crate::device::Duration::micros(1));
    assert_eq!((dut.get(Reg::V), dut.get(Reg::MV)), (0, 0));
}

#[test]
fn keys_step_through_a_program() {
    let mut dut = Dut::quiet();
    let values = |dut: &mut Dut| {
        dut.wait(crate::device::Duration::millis(10));
        [Reg::R1, Reg::R2, Reg::R3, Reg::R4].map(|reg| dut.get(reg))
    };
    dut.types_lines("PG 1\nR1=1\nR2=2\nR3=3\nR4=4\nE\nPG\nEX 1,2");
    let first = values(&mut dut);
    dut.types(" ");
    let second = values(&mut dut);
    assert_eq!(
        second.iter().filter(|value| **value != 0).count(),
        1 + first.iter().filter(|value| **value != 0).count()
    );
    // "You may enter immediate commands" (MC 6.1.9).
    assert_eq!(dut.types("PR \"here \" R1\r"), "here 1\r\n");
    assert_eq!(values(&mut dut), second);
    // The second of two keys arrives while a line is executed, and has no effect.
    dut.types("  ");
    assert_eq!(values(&mut dut)[3], 0);
    dut.types("\r");
    assert_eq!(values(&mut dut), [1, 2, 3, 4]);
    assert_eq!(dut.get(Reg::BY), 0);
}

#[test]
fn a_line_is_noted_with_its_error() {
    let mut dut = Dut::quiet();
    dut.types("PR P\rHELLO\r");
    let notes = dut.out.noted();
    assert_eq!(
        notes[notes.len() - 2..],
        [
            LogEvent::Request { port: MCODE, unit: 0, function: b'P' },
            LogEvent::Refused { port: MCODE, function: b'H', code: 20 }
        ]
    );
}

proptest! {
    /// Pieces of input are not lines: wherever the input is split, the output is the same.
    #[test]
    fn pieces_may_be_cut_anywhere(
        bytes in prop::collection::vec(
            prop_oneof![
                4 => prop::sample::select(b"PR \"'=,;1ALUVGXEM\r\n\x08\x1b\x03 ".to_vec()),
                1 => any::<u8>(),
            ],
            0..200,
        ),
        cut in 0_usize..200,
        mode in 0_i64..4,
    ) {
        let mut outcomes = Vec::new();
        for cut in [cut.min(bytes.len()), bytes.len()] {
            let mut dut = Dut::ready(Mdrive::plus(), mode);
            dut.out.rule = NO_TEXT;
            let pieces = [&bytes[..cut], &bytes[cut..]];
            let inputs = pieces.map(|bytes| (dut.now, Input::Message { port: MCODE, link: HERE, bytes }));
            let Fixture { drive, out, now } = &mut dut.fixture;
            advance(drive, *now, inputs.into_iter(), out);
            dut.wait(crate::device::Duration::secs(1));
            outcomes.push((dut.out.messages.clone(), dut.out.noted(), dut.out.memory.clone()));
        }
        prop_assert!(outcomes[0] == outcomes[1], "{:?} {:?}", outcomes[0].0, outcomes[1].0);
    }
}
