//! Commands of drives with a serial port: party mode and checksums (MC 5-12, 5-59, 7.1).

use super::*;

impl Dut {
    /// A drive with the serial commands, in this echo mode.
    fn sister(echo: i64) -> Self {
        let mut dut = Self::ready(Mdrive::plus(), echo);
        dut.set(Reg::SerialCommands, 1);
        dut.out.rule = NO_TEXT;
        dut
    }

    /// Types bytes that are not text, and returns the output.
    fn types_bytes(&mut self, bytes: &[u8]) -> Vec<u8> {
        let before = self.bytes().len();
        self.send(HERE, bytes);
        self.bytes()[before..].to_vec()
    }
}

/// Line with its checksum: the 2's complement of the sum of its characters, or'ed with 80h (MC 7.1.2).
fn checked(line: &str) -> Vec<u8> {
    let sum: u32 = line.bytes().map(u32::from).sum();
    let mut bytes = line.as_bytes().to_vec();
    bytes.push((0x100 - sum % 0x100) as u8 | 0x80);
    bytes
}

fn joined(parts: &[&[u8]]) -> Vec<u8> {
    parts.concat()
}

#[test]
fn without_the_setting_there_is_none_of_it() {
    let mut dut = Dut::plus();
    for line in ["PY=1", "CK=1", "DN=\"A\"", "QD=1", "DG=0", "BD=19", "PR PY"] {
        assert_eq!(dut.error_of(line), 37, "{line}");
    }
    // Without `SerialCommands` a saved value of PY or CK has no effect.
    dut.set(Reg::PY, 1);
    dut.set(Reg::CK, 1);
    assert_eq!(dut.types("PR P\r"), "PR P\r\n0\r\n>");
}

#[test]
fn the_six_commands() {
    let mut dut = Dut::sister(2);
    // Values that MC 5-20 does not allow.
    for line in ["DN=\"*\"", "DN=\"42\"", "DN=\"^\"", "DN=\" \"", "DN=\"{\""] {
        assert_eq!(dut.error_of(line), 21, "{line}");
    }
    dut.types_lines("DN=\"!\"\nDN=\"z\"\nDN=\"0\"");
    assert_eq!(dut.error_of("DN=\"!\""), 21, "once it has been changed");
    dut.types_lines("DN=\"A\"\nQD=1\nDG=0\nBD=38");
    assert_eq!(dut.types("PR DN \" \" QD DG \" \" BD PY CK\r"), "\"A\" 10 3800\r\n");
    assert_eq!(dut.error_of("BD=57"), 61);
}

#[test]
fn a_party_is_called_by_name_and_ends_lines_with_ctrl_j() {
    let mut dut = Dut::sister(0);
    dut.types_lines("DN=\"a\"");
    assert_eq!(dut.types("PY=1\r"), "PY=1\r\n>");
    // Party mode begins with a Ctrl-J.
    assert_eq!(dut.types("aR1=5\n"), "");
    // The name is part of the echo (MDRIVE-40).
    assert_eq!(dut.types("aR1=7\n"), "aR1=7\r\n>");
    assert_eq!(dut.types("aPR R1\n"), "aPR R1\r\n7\r\n>");
    assert_eq!(dut.types("aPR R1\r\n"), "aPR R1\r\n7\r\n>", "CR is nothing");
    // Another drive's name, the name in capitals, and the name of queued drives, which this drive is not.
    assert_eq!(dut.types("bR1=8\nAR1=8\n^R1=8\n"), "");
    assert_eq!(dut.types("aPR R1\n"), "aPR R1\r\n7\r\n>");
    // The line is for all drives. They execute it, but do not answer (DG 1).
    assert_eq!(dut.types("*R1=9\n*PR R1\n"), "");
    assert_eq!(dut.types("aDG=0\n"), "aDG=0\r\n>");
    assert_eq!(dut.types("*PR R1\n"), "*PR R1\r\n9\r\n>");
    assert_eq!(dut.types("aQD=1\n^PR R1\n"), "aQD=1\r\n>^PR R1\r\n9\r\n>");
    assert_eq!(dut.types("aPY=0\n"), "aPY=0\r\n>");
    assert_eq!(dut.types("PR R1\r"), "PR R1\r\n9\r\n>");
}

/// "One CTRL + J must be issued after power up or entering the Party Mode" (MC 5-59). Any connection may send
/// it.
#[test]
fn the_first_ctrl_j_activates_the_party_of_the_drive() {
    let mut dut = Dut::sister(2);
    let there = Link(1);
    dut.feed(Input::Opened { port: MCODE, link: there });
    dut.types("PY=1\r");
    assert_eq!(dut.types_on(there, "!R1=5\n"), "");
    assert_eq!(dut.get(Reg::R1), 0, "its Ctrl-J was the first one");
    dut.types("!R1=6\n");
    assert_eq!(dut.get(Reg::R1), 6, "so nobody needs another one");
    dut.feed(Input::Closed { port: MCODE, link: there });
    dut.feed(Input::Opened { port: MCODE, link: there });
    assert_eq!(dut.types_on(there, "!PR R1\n"), "6\r\n");

    // Party mode begins again, this time not by a typed line.
    dut.set(Reg::PY, 0);
    assert_eq!(dut.types_on(there, "PR R1\r"), "6\r\n");
    assert_eq!(dut.types("PR R1\r"), "6\r\n");
    dut.set(Reg::PY, 1);
    assert_eq!(dut.types_on(there, "!PR R1\n!PR R1\n"), "6\r\n");

    // Party mode begins in the same way after power-up.
    dut.types("!S\n");
    dut.wait(crate::device::Duration::secs(1));
    dut.cycle();
    dut.feed(Input::Opened { port: MCODE, link: there });
    assert_eq!(dut.types("!PR R1\n!PR R1\n"), "6\r\n");
    assert_eq!(dut.types_on(there, "!PR R1\n"), "6\r\n");
    // Party mode begins in the same way after Ctrl-C: "CTRL+C will reboot the unit" (MC 3-10).
    dut.types("\x03");
    dut.wait(crate::device::Duration::secs(1));
    assert_eq!(dut.types("!PR R1\n!PR R1\n").matches("6\r\n").count(), 1);
}

/// The client dvg-devices waits for these bytes (MDRIVE-38).
#[test]
fn escape_in_a_party_is_answered() {
    for (mode, answer, with_error) in
        [(0, "#\r\n>", "#\r\n?"), (1, "\r\n", "\r\n"), (2, "", ""), (3, "\r\n", "\r\n")]
    {
        let mut dut = Dut::sister(mode);
        dut.types("PY=1\r");
        assert_eq!(dut.types("\x1b"), answer, "before the first Ctrl-J, too");
        assert_eq!(dut.types("\nbR1=5\x1b"), answer, "whomever the line is for");
        dut.types("\n!HELLO\n");
        assert_eq!(dut.types("\x1b"), with_error);
        // With ES 3 only the addressed drive answers.
        dut.types("\n!ER=0\n!ES=3\n");
        assert_eq!(dut.types("\n\x1bb\x1b\n"), "");
        dut.types("!");
        assert_eq!(dut.types("\x1b"), answer);
    }
}

/// The client dvg-devices waits for these bytes (MDRIVE-39).
#[test]
fn in_mode_1_a_value_stands_alone_while_a_program_runs() {
    let mut dut = Dut::sister(1);
    dut.types_lines("PG 1\nLB G1\nBR G1\nPG\nR1=7\nPY=1");
    dut.types("\n");
    assert_eq!(dut.types("!PR R1\n"), "\r\n7\r\n");
    assert_eq!(dut.types("!EX G1\n"), "\r\n");
    assert_eq!(dut.types("!PR R1,\"_\"R2\n"), "7_0\r\n");
    assert_eq!(dut.types("!L 2\n"), "BR G1\r\n");
    assert_eq!(dut.types("!R1=8\n"), "\r\n");
    assert_eq!(dut.types("!\n"), "\r\n");
    assert_eq!(dut.types("!PR HELLO\n"), "\r\n", "nothing is printed");
    // A line that is stored prints nothing.
    assert_eq!(dut.types("!PG 100\n!PR R1\n!PG\n"), "\r\n\r\n\r\n");
    assert_eq!(dut.types("!PR R1\n"), "8\r\n");
    assert_eq!(dut.types("!E\n"), "\r\n");
    assert_eq!(dut.types("!PR R1\n"), "\r\n8\r\n");
}

#[test]
fn a_party_without_echo() {
    for (mode, answer, printed) in
        [(1, "\r\n", "\r\n7\r\n"), (2, "", "7\r\n"), (3, "R1=7\r\n", "PR R1\r\n7\r\n")]
    {
        let mut dut = Dut::sister(mode);
        dut.types("PY=1\r\n");
        dut.types("\n");
        assert_eq!(dut.types("!R1=7\n"), answer);
        assert_eq!(dut.types("!PR R1\n"), printed);
    }
}

#[test]
fn keys_of_a_party_may_be_addressed() {
    let mut dut = Dut::sister(2);
    dut.types_lines("PG 1\nLB G1\nBR G1\nPG\nES=3\nCE=2\nPY=1");
    dut.types("\n");
    let runs = |dut: &mut Dut| {
        dut.wait(crate::device::Duration::millis(1));
        dut.get(Reg::BY)
    };
    dut.types("!EX 1\n");
    for keys in ["\x1b", "b\x1b\n", "\x05", "!\x05\n", "\x03", "b\x03\n"] {
        dut.types(keys);
        assert_eq!(runs(&mut dut), 1, "{keys:?}");
    }
    dut.types("\n!\x1b");
    assert_eq!(runs(&mut dut), 0);
    dut.types("\n!EX 1\n");
    dut.types("!ES=1\n\n");
    assert_eq!(runs(&mut dut), 1);
    dut.types("\x1b");
    assert_eq!(runs(&mut dut), 0);
    dut.types("\n!R1=5\n");
    assert_eq!(dut.get(Reg::R1), 5);
    dut.types("*\x03");
    dut.wait(crate::device::Duration::secs(1));
    assert_eq!(dut.get(Reg::R1), 0, "it has started again");
}

#[test]
fn the_check_sum_of_the_manual() {
    assert_eq!(checked("MR 1"), joined(&[b"MR 1", &[144]]));
    let mut dut = Dut::sister(1);
    dut.types_lines("CK=1");
    assert_eq!(dut.types_bytes(&joined(&[b"MR 1", &[144], b"\r"])), [0x06]);
    assert_eq!(dut.get(Reg::MR), 1);
    // In lower case the sum is another one.
    assert_eq!(dut.types_bytes(&joined(&[b"mr 1", &[144], b"\r"])), [0x15]);
    assert_eq!(dut.get(Reg::ER), 0, "it is ignored");
    assert_eq!(dut.types_bytes(b"MR 1\r"), [0x15]);
    assert_eq!(dut.types_bytes(b"\r"), [0x06]);
}

#[test]
fn check_sums_acknowledge_and_mark_what_is_printed() {
    let line = |text: &str| joined(&[&checked(text), b"\r"]);
    let printed = joined(&[&checked("5"), b"\r\n"]);
    let mut dut = Dut::sister(0);
    dut.types_lines("R1=5\nCK=1");
    assert_eq!(dut.types_bytes(&line("PR R1")), joined(&[&checked("PR R1"), &printed, b"\x06>"]));
    assert_eq!(dut.types_bytes(&line("RC=110")), joined(&[&checked("RC=110"), b"\x15?"]));
    dut.types_bytes(&line("ER=0"));
    dut.types_bytes(&line("EM=1"));
    assert_eq!(dut.types_bytes(&line("PR R1")), joined(&[&printed, b"\x06"]));
    assert_eq!(dut.types_bytes(&line("RC=110")), b"\x15");
    dut.types_bytes(&line("EM=2"));
    assert_eq!(dut.types_bytes(&line("PR R1")), printed);
    assert_eq!(dut.types_bytes(b"PR R1\r"), b"");
    dut.types_bytes(&line("EM=3"));
    assert_eq!(dut.types_bytes(&line("PR R1")), joined(&[&checked("PR R1"), &printed, b"\x06"]));
    assert_eq!(
        dut.types_bytes(&line("PR \"a\" R1;")),
        joined(&[&checked("PR \"a\" R1;"), &checked("a5"), b"\x06"])
    );
    assert_eq!(dut.types_bytes(&line("CK=0")), joined(&[&checked("CK=0"), b"\x06"]));
    assert_eq!(dut.types("PR R1\r"), "PR R1\r\n5\r\n");
}

/// "The response will be the sign on message" (MC 5-26), and nothing else.
#[test]
fn fd_ends_check_sums_without_an_acknowledgement() {
    let mut dut = Dut::sister(0);
    dut.types_lines("CK=1");
    let said = dut.types_bytes(&joined(&[&checked("FD"), b"\r"]));
    assert_eq!(said, joined(&[&checked("FD"), crate::mdrive::startup::SIGN_ON, b">"]));
}

#[test]
fn with_ck_2_a_program_that_runs_is_not_acknowledged() {
    let line = |text: &str| joined(&[&checked(text), b"\r"]);
    let mut dut = Dut::sister(1);
    dut.types_lines("PG 1\nLB G1\nBR G1\nPG\nCK=2");
    assert_eq!(dut.types_bytes(&line("R1=5")), b"\x06");
    dut.types_bytes(&line("EX 1"));
    dut.wait(crate::device::Duration::millis(10));
    assert_eq!(dut.types_bytes(&line("R1=6")), b"");
    assert_eq!(dut.types_bytes(&line("RC=110")), b"\x15");
    assert_eq!(dut.types_bytes(b"R1=7\r"), b"\x15");
    dut.types_bytes(&line("E"));
    assert_eq!(dut.types_bytes(&line("R1=8")), b"\x06");
}

#[test]
fn a_name_is_part_of_its_check_sum() {
    let mut dut = Dut::sister(1);
    dut.types_lines("CK=1");
    dut.types_bytes(&joined(&[&checked("PY=1"), b"\r\n"]));
    assert_eq!(dut.types_bytes(&joined(&[&checked("!R1=5"), b"\n"])), b"\x06");
    let nameless = joined(&[b"!", &checked("R1=6"), b"\n"]);
    assert_eq!(dut.types_bytes(&nameless), b"\x15");
    assert_eq!(dut.types_bytes(&joined(&[&checked("*R1=7"), b"\n"])), b"");
    assert_eq!(dut.get(Reg::R1), 7);
}
