//! The command language.

use super::*;

#[test]
fn an_answer_leaves_when_its_command_has_ended() {
    let mut dut = Dut::ready(Qsb::m());
    dut.command_at(10.millis(), "R0E");
    assert_eq!(dut.texts(), [(Instant::from(10.millis()), "r 0E 00000000 !".into())]);
    assert_eq!(dut.sent().last().unwrap().1, "r 0E 00000000 !\r\n", "EOR is 0B: spaces, CR and LF");
}

#[test]
fn an_answer_waits_for_what_is_still_leaving() {
    let mut dut = Dut::ready(Qsb::m());
    dut.wait(10.millis());
    dut.hear(b"R00\rR08\rR03\r");
    let texts = dut.texts();
    // A command has 4 characters, a response 17; each response starts when the previous one has been sent.
    let first = Instant::from(10.millis()) + dut.character * 4;
    let answer = dut.character * 17;
    assert_eq!(
        texts,
        [
            (first, "r 00 00000000 !".into()),
            (first + answer, "r 08 000001F3 !".into()),
            (first + answer * 2, "r 03 0000004F !".into()),
        ]
    );
}

#[test]
fn cr_and_lf_end_a_command_once() {
    let mut dut = Dut::ready(Qsb::m());
    dut.hear(b"R00\r\nR00\n\rR00\rR00\n\n\r\r\n");
    dut.wait(10.millis());
    assert_eq!(dut.texts().len(), 4);
}

#[test]
fn a_backspace_erases_a_partial_command() {
    let mut dut = Dut::ready(Qsb::m());
    assert_eq!(dut.ask("W0C\x08R0C"), "r 0C 0000FFFF !");
    assert_eq!(dut.ask("nonsense that is far too long\x08R08"), "r 08 000001F3 !");
    dut.feed(Input::RxError { port: USB });
    assert_eq!(dut.ask("\x08R08"), "r 08 000001F3 !");
    dut.hear(b"R08\x08\r");
    assert_eq!(dut.texts(), [], "nothing is left of it");
}

#[test]
fn what_is_not_understood_is_unsupported() {
    let mut dut = Dut::ready(Qsb::m());
    for (command, answer) in [
        ("Q0E", "x 0E 00000000 !"),
        ("r0E", "x 0E 00000000 !"),
        ("R", "x 00 00000000 !"),
        ("R0", "x 00 00000000 !"),
        ("RG0", "x 00 00000000 !"),
        ("R0E1", "x 0E 00000000 !"),
        ("S0E1", "x 0E 00000000 !"),
        ("W0C", "x 0C 00000000 !"),
        ("W0C1G", "x 0C 00000000 !"),
        ("W0C000000001", "x 0C 00000000 !"),
        ("W0C00000000000000000000001", "x 0C 00000000 !"),
        ("R17", "x 17 00000000 !"),
        ("Rff", "x FF 00000000 !"),
        (" R0E", "x 00 00000000 !"),
        ("R09", "x 09 00000000 !"),
        ("R0A", "x 0A 00000000 !"),
        ("R16", "x 16 00000000 !"),
        ("W070", "x 07 00000000 !"),
        ("W0E0", "x 0E 00000000 !"),
        ("W050", "x 05 00000000 !"),
        ("W060", "x 06 00000000 !"),
        ("W130", "x 13 00000000 !"),
        ("W140", "x 14 00000000 !"),
        ("S00", "x 00 00000000 !"),
        ("S08", "x 08 00000000 !"),
        ("S07", "x 07 00000000 !"),
    ] {
        assert_eq!(dut.ask(command), answer, "{command}");
    }
    assert_eq!(dut.ask("R0C"), "r 0C 0000FFFF !", "nothing was written");
}

#[test]
fn a_spoiled_character_spoils_its_command() {
    let mut dut = Dut::ready(Qsb::m());
    dut.hear(b"R0");
    let at = dut.now + dut.character;
    dut.input(at, Input::RxError { port: USB });
    assert_eq!(dut.ask("8"), "x 00 00000000 !");
    assert_eq!(dut.ask("R08"), "r 08 000001F3 !");
}

#[test]
fn a_refused_value_comes_back_and_changes_nothing() {
    let mut dut = Dut::ready(Qsb::m());
    for (command, answer, read, kept) in [
        ("W0003", "e 00 00000003 !", "R00", "r 00 00000000 !"),
        ("W0013", "e 00 00000013 !", "R00", "r 00 00000000 !"),
        ("W0110", "e 01 00000010 !", "R01", "r 01 0000000F !"),
        ("W022000", "e 02 00002000 !", "R02", "r 02 00000000 !"),
        ("W03100", "e 03 00000100 !", "R03", "r 03 0000004F !"),
        ("W04200", "e 04 00000200 !", "R04", "r 04 00000000 !"),
        ("W0B10000", "e 0B 00010000 !", "R0B", "r 0B 00000000 !"),
        ("W0CFFFFFFFF", "e 0C FFFFFFFF !", "R0C", "r 0C 0000FFFF !"),
        ("W0F1F", "e 0F 0000001F !", "R0F", "r 0F 00000020 !"),
        ("W0F32C9", "e 0F 000032C9 !", "R0F", "r 0F 00000020 !"),
        ("W103F", "e 10 0000003F !", "R10", "r 10 000186A0 !"),
        ("W1057e41", "e 10 00057E41 !", "R10", "r 10 000186A0 !"),
        ("W1180000000", "e 11 80000000 !", "R11", "r 11 00000000 !"),
        ("W1232C9", "e 12 000032C9 !", "R12", "r 12 00000020 !"),
        // Fewer than eight digits are positive: 52,536.
        ("W12CD38", "e 12 0000CD38 !", "R12", "r 12 00000020 !"),
        ("W12FFFFCD37", "e 12 FFFFCD37 !", "R12", "r 12 00000020 !"),
        ("W1510", "e 15 00000010 !", "R15", "r 15 0000000B !"),
    ] {
        assert_eq!(dut.ask(command), answer);
        assert_eq!(dut.ask(read), kept, "{command}");
    }
    for command in ["W094", "W0A2", "W16B", "W1680A", "W1610A0A", "W1670B", "W16FFFFFFFF"] {
        assert!(dut.ask(command).starts_with("e "), "{command}");
    }
}

#[test]
fn eor_formats_its_own_answer() {
    let mut dut = Dut::ready(Qsb::m());
    for (command, answer) in [
        ("W150", "w1500000000!"),
        ("W151", "w1500000001!\n"),
        ("W152", "w1500000002!\r"),
        ("W153", "w1500000003!\r\n"),
        ("W158", "w 15 00000008 !"),
        ("W15F", "w 15 0000000F 00000008 !\r\n"),
        ("W154", "w150000000400000008!"),
    ] {
        if command.contains("15F") {
            dut.run_until(tick(8));
        }
        let seen = dut.out.bytes.len();
        dut.hear(command.as_bytes());
        dut.hear(b"\r");
        assert_eq!(dut.sent()[seen].1, answer);
        let end = dut.sent()[seen].0 + dut.character * answer.len() as u64;
        dut.run_until(end);
    }
}

#[test]
fn refusals_have_a_time_stamp_too() {
    let mut dut = Dut::ready(Qsb::m());
    dut.write("W15F");
    dut.run_until(tick(0x12));
    assert_eq!(dut.ask("R99"), "x 99 00000000 00000012 !");
    assert_eq!(dut.ask("W0003"), "e 00 00000003 00000012 !");
    assert_eq!(dut.ask("W0D1"), "w 0D 00000001 00000000 !");
}

#[test]
fn notes_tell_what_was_asked() {
    let mut dut = Dut::ready(Qsb::m());
    dut.ask("R00");
    dut.ask("W0003");
    dut.ask("Z00");
    assert_eq!(
        dut.out.noted(),
        [
            LogEvent::Request { port: USB, unit: 0, function: b'R' },
            LogEvent::Refused { port: USB, function: b'W', code: b'e' },
            LogEvent::Refused { port: USB, function: b'Z', code: b'x' },
        ]
    );
}
