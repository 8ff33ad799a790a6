//! Port 503 as a terminal sees it: echo and prompt (MC 7.1.1), keys (MC 3.4.4), sign-on (MC 6-6).

use drivetwin_protocol::time::Span;
use drivetwin_sim::bench::Client;

use crate::rig::{CALIBRATION, KINDS, Kind, MCODE, Rig, SIGN_ON, START};

impl Rig {
    /// Sends a text one character at a time; returns the text that the drive sends.
    fn typed(&mut self, text: &str) -> String {
        text.bytes().map(|byte| self.key(&[byte])).collect()
    }
}

/// Table 7.1, EM = 0: each character is echoed as it is typed; after a line follow CR, LF and `>`.
#[test]
fn echo_mode_0_echoes_and_prompts() {
    for kind in KINDS {
        let mut rig = Rig::loud(kind);
        assert_eq!(rig.heard(), "", "nobody has spoken");
        for character in ["R", "1", "=", "5"] {
            assert_eq!(rig.key(character.as_bytes()), character);
        }
        assert_eq!(rig.key(b"\r"), "\r\n>");
        assert_eq!(rig.typed("PR R1\r"), "PR R1\r\n5\r\n>");
        // After an error the prompt is `?` until ER is read (MC 9).
        assert_eq!(rig.say("RC=101"), "RC=101\r\n?");
        assert_eq!(rig.say("R1=6"), "R1=6\r\n?");
        assert_eq!(rig.say("PR ER"), "PR ER\r\n21\r\n>");
        assert_eq!(rig.say("R1=7"), "R1=7\r\n>");
        assert_eq!(rig.say(""), "\r\n>");
    }
}

/// EM = 1: CR and LF follow after the line is executed.
#[test]
fn echo_mode_1_answers_cr_lf() {
    let mut rig = Rig::loud(crate::rig::Kind::Plus);
    rig.say("EM=1");
    assert_eq!(rig.typed("R1=5"), "");
    assert_eq!(rig.key(b"\r"), "\r\n");
    assert_eq!(rig.say("RC=101"), "\r\n", "no ? here");
    let printed = rig.say("PR R1");
    assert!(printed.contains('5') && printed.ends_with("\r\n"), "{printed:?}");
}

/// EM = 2: only PR and L send text.
#[test]
fn echo_mode_2_prints_output_only() {
    let mut rig = Rig::loud(crate::rig::Kind::Plus);
    rig.say("EM=2");
    assert_eq!(rig.typed("R1=5\r"), "");
    assert_eq!(rig.say("RC=101"), "");
    assert_eq!(rig.say("PR R1"), "5\r\n");
    assert_eq!(rig.say("PG 1"), "");
    assert_eq!(rig.say("R2=1"), "");
    assert_eq!(rig.say("PG"), "");
    assert_eq!(rig.say("L"), "R2=1\r\n");
}

/// EM = 3: the command is echoed after its execution, followed by CR and LF.
#[test]
fn echo_mode_3_echoes_afterwards() {
    let mut rig = Rig::loud(crate::rig::Kind::Plus);
    rig.say("EM=3");
    assert_eq!(rig.typed("R1=5"), "");
    assert_eq!(rig.key(b"\r"), "R1=5\r\n");
}

/// EM belongs to the drive, not to a connection.
#[test]
fn every_terminal_has_the_same_echo() {
    let mut rig = Rig::plus();
    let other = rig.bench.connect_to(rig.seat, MCODE).expect("room");
    rig.bench.send(other, b"R1=5\r");
    rig.bench.run_until_idle();
    let mut came = Vec::new();
    rig.bench.receive(other, &mut came);
    assert_eq!(came, b"");
    assert_eq!(rig.value("R1"), 5);
}

#[test]
fn case_and_blanks_make_no_difference() {
    let mut rig = Rig::plus();
    for line in ["r1=5", "R1 5", "R1=5", " R1 = 5 ", "R15", "R1  5", "R1=+5", "R1=5 'five", "r1=5'"] {
        rig.say("R1=0");
        rig.say(line);
        assert_eq!(rig.value("R1"), 5, "{line:?}");
        assert_eq!(rig.value("ER"), 0, "{line:?}");
    }
    for line in ["", " ", "'", "' a comment; PR 1"] {
        assert_eq!(rig.say(line), "", "{line:?}");
        assert_eq!(rig.value("ER"), 0, "{line:?}");
    }
}

/// MC 5-57: PR prints items and text; with `;` the cursor remains in the line.
#[test]
fn pr_prints_text_and_values() {
    let mut rig = Rig::plus();
    rig.set(&["R1=-5", "R2=7"]);
    assert_eq!(rig.say("PR \"Position = \",R1"), "Position = -5\r\n");
    assert_eq!(rig.say("PR R1,R2"), "-57\r\n");
    assert_eq!(rig.say("PR R1 R2"), "-57\r\n");
    assert_eq!(rig.say("PR MV ST"), "00\r\n");
    assert_eq!(rig.say("PR R1;"), "-5");
    assert_eq!(rig.say("PR \"a\",R2,\"b\""), "a7b\r\n");
    assert_eq!(rig.say("pr r2"), "7\r\n");
    assert_eq!(rig.say("PR \" \""), " \r\n");
    assert_eq!(rig.say("PR \"it's, lower Case\""), "it's, lower Case\r\n");
}

/// MC 5-1: PR AL prints lines `NAME = value`.
#[test]
fn pr_al_prints_everything() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        let text = rig.say("PR AL");
        assert!(text.ends_with("\r\n"));
        let lines: Vec<&str> = text.trim_end().split("\r\n").collect();
        for (name, value) in [("A", "1000000"), ("VI", "1000"), ("VM", "768000"), ("RC", "25"), ("HT", "500")]
        {
            let line = format!("{name} = {value}");
            assert!(lines.contains(&line.as_str()), "{line} is not in {lines:?}");
        }
        assert!(lines.iter().all(|line| line.contains(" = ")), "{lines:?}");
    }
}

/// The format is known from existing programs: `V1 = G 512000`, labels with their address, then an empty
/// line.
#[test]
fn pr_uv_prints_what_the_user_has_named() {
    let mut rig = Rig::plus();
    rig.set(&["VA V1=512000"]);
    rig.program("PG 100\nLB SU\nE\nPG");
    let text = rig.say("PR UV");
    assert!(text.contains("V1 = G 512000\r\n") && text.contains("SU = 100\r\n"), "{text:?}");
    assert!(text.ends_with("\r\n\r\n"), "{text:?}");
}

/// MC 3.4.4: Esc stops the program, and the motion without a ramp.
#[test]
fn escape_stops_everything_at_once() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        rig.program("PG 1\nLB G1\nIC R1\nH 10\nBR G1\nE\nPG");
        rig.set(&["EX 1", "SL 200000"]);
        rig.after(1.secs());
        assert_eq!(rig.long(0x0085), 200_000, "V");
        rig.key(&[0x1B]);
        rig.after(1.millis());
        let (position, counted) = (rig.long(0x0057), rig.long(0x005F));
        assert_eq!((rig.long(0x0085), rig.value("BY")), (0, 0), "V and BY");
        rig.after(1.secs());
        assert_eq!((rig.long(0x0057), rig.long(0x005F)), (position, counted));
    }
}

/// MC 5-23: with ES = 0 Ctrl-E stops instead of Esc.
#[test]
fn the_key_that_stops_can_be_another() {
    let mut rig = Rig::plus();
    rig.set(&["ES=0", "SL 20000"]);
    rig.after(100.millis());
    rig.key(&[0x1B]);
    rig.after(100.millis());
    assert_eq!(rig.word(0x004A), 1, "Esc does nothing");
    rig.key(&[0x05]);
    rig.after(10.millis());
    assert_eq!(rig.word(0x004A), 0);
    rig.say("ER=0");
    rig.set(&["ES=1", "SL 20000"]);
    rig.after(100.millis());
    rig.key(&[0x05]);
    rig.after(100.millis());
    assert_eq!(rig.word(0x004A), 1, "Ctrl-E does nothing");
    rig.key(&[0x1B]);
    rig.after(10.millis());
    assert_eq!(rig.word(0x004A), 0);
}

/// MC 3.4.4 and 6-6: Ctrl-C restarts the drive. Stored values are restored, SU runs, and the connections stay
/// open.
#[test]
fn control_c_restarts() {
    for kind in KINDS {
        let mut rig = Rig::loud(kind);
        rig.program_loud("PG 1\nLB SU\nR1=R1+1000\nE\nPG");
        rig.say("R1=5");
        rig.say("S");
        rig.after(100.millis());
        rig.say("R1=6");
        rig.say("RC=99");
        let mut text = rig.key(&[0x03]);
        rig.after(START + CALIBRATION);
        text += &rig.heard();
        assert!(text.contains(&format!("{SIGN_ON}\r\n")) && text.ends_with('>'), "{text:?}");
        assert_eq!(rig.word(0x0067), 25, "RC");
        assert_eq!(rig.long(0x005F), 1_005, "SU has run once");
        assert!(rig.ended(rig.mcode).is_none() && rig.ended(rig.modbus).is_none());
        assert_eq!(rig.long(0x0057), 0);
    }
}

/// MC 5-11: CE = 0 disables Ctrl-C.
#[test]
fn control_c_can_be_disabled() {
    let mut rig = Rig::plus();
    rig.set(&["CE=0", "RC=99"]);
    rig.key(&[0x03]);
    rig.after(START);
    assert_eq!(rig.word(0x0067), 99);
    rig.say("ER=0");
    rig.set(&["CE=1"]);
    rig.key(&[0x03]);
    rig.after(START);
    assert_eq!(rig.word(0x0067), 25);
}

/// MC 5-26: FD resets programs, variables and settings, and the drive replies with the sign-on message.
#[test]
fn factory_defaults_come_with_the_sign_on() {
    for kind in KINDS {
        let mut rig = Rig::loud(kind);
        rig.program_loud("PG 1\nLB G1\nE\nPG");
        for line in ["VA Q1=5", "RC=99", "S"] {
            rig.say(line);
        }
        rig.after(100.millis());
        let mut text = rig.say("FD");
        rig.after(START + CALIBRATION);
        text += &rig.heard();
        assert!(text.contains(SIGN_ON), "{text:?}");
        rig.say("EM=2");
        rig.heard();
        assert_eq!(rig.value("RC"), 25);
        assert_eq!(rig.say("L").trim(), "");
        rig.refused("PR Q1", 30);
        rig.refused("EX G1", 30);
        // FD changes the non-volatile memory at once.
        rig.power_cycle();
        rig.say("EM=2");
        assert_eq!(rig.word(0x0067), 25);
        rig.refused("PR Q1", 30);
    }
}

impl Rig {
    fn program_loud(&mut self, lines: &str) {
        for line in lines.lines() {
            self.say(line);
        }
        assert_eq!(self.ef_er(), (0, 0));
    }
}

/// Power-up sends the sign-on and runs SU; a client that connects later receives nothing.
#[test]
fn programs_and_variables_outlive_the_power() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        rig.program("PG 1\nLB SU\nR2=R2+7\nE\nPG");
        // The program is kept without a save (MC 5-42), R1 is not.
        rig.set(&["VA Q1=5", "S"]);
        rig.after(100.millis());
        rig.set(&["Q1=6", "R1=8"]);
        rig.power_cycle();
        rig.after(CALIBRATION);
        assert_eq!((rig.long(0x005F), rig.long(0x0061)), (0, 7), "R1 and R2");
        rig.say("EM=2");
        rig.heard();
        rig.assert_values(&[("Q1", 5)]);
        assert!(rig.say("L").starts_with("LB SU\r\nR2=R2+7\r\nE\r\n"));
    }
}

/// MC 5-40: L lists from the beginning, from an address or from a label.
#[test]
fn a_program_is_listed() {
    let mut rig = Rig::plus();
    rig.program("PG 1\nLB G1\nP=0\nE\nPG\nPG 100\nLB G2\nMR 51200\nH\nE\nPG");
    let first = "LB G1\r\nP=0\r\nE\r\n";
    let second = "LB G2\r\nMR 51200\r\nH\r\nE\r\n";
    assert_eq!(rig.say("L"), format!("{first}{second}"));
    assert_eq!(rig.say("L 100"), second);
    assert_eq!(rig.say("L G2"), second);
    assert_eq!(rig.say("L 102"), "H\r\nE\r\n");
}

/// MC 5-42: LK = 1 locks the programs.
#[test]
fn a_locked_program_is_neither_listed_nor_changed() {
    let mut rig = Rig::plus();
    rig.program("PG 1\nLB G1\nR1=5\nE\nPG");
    rig.set(&["LK=1"]);
    for line in ["L", "L G1", "PG 1", "CP 1", "CP G1"] {
        rig.refused(line, 44);
    }
    rig.set(&["EX G1"]);
    rig.after(10.millis());
    rig.assert_values(&[("R1", 5)]);
    // LK is not saved, so Ctrl-C unlocks the programs.
    rig.key(&[0x03]);
    rig.after(START);
    rig.say("EM=2");
    rig.heard();
    rig.assert_values(&[("LK", 0)]);
    assert!(rig.say("L").starts_with("LB G1\r\n"));
    // Clearing the whole program space unlocks, too.
    rig.set(&["LK=1", "CP"]);
    rig.assert_values(&[("LK", 0)]);
    assert_eq!(rig.say("L").trim(), "");
}

/// MC 5-42: "It can only be reset by clearing the entire program space". LK then stays 0 after a power cycle,
/// and clearing saves nothing else.
#[test]
fn clearing_everything_unlocks_for_good() {
    let mut rig = Rig::plus();
    rig.set(&["LK=1", "RC=50", "S"]);
    rig.after(100.millis());
    rig.power_cycle();
    rig.say("EM=2");
    rig.heard();
    rig.assert_values(&[("LK", 1), ("RC", 50)]);
    rig.set(&["RC=60", "CP"]);
    rig.assert_values(&[("LK", 0), ("RC", 60)]);
    rig.power_cycle();
    rig.say("EM=2");
    rig.heard();
    rig.assert_values(&[("LK", 0), ("RC", 50), ("ER", 0)]);
}

/// MC 5-1: PR AL prints "the value/state of all variables and flags", including MD and VR.
#[test]
fn all_prints_the_last_motion_and_the_version() {
    for (kind, version) in [(Kind::Plus, "VR = 3.0.0.9"), (Kind::Hybrid, "VR = 4.0.0.8, 1.8")] {
        let mut rig = Rig::new(kind);
        let lines = |text: String| text.lines().map(str::to_owned).collect::<Vec<_>>();
        let all = lines(rig.say("PR AL"));
        assert!(all.contains(&version.to_owned()), "{all:?}");
        assert!(all.contains(&"MD = ".to_owned()), "{all:?}");
        rig.set(&["MR 100"]);
        assert!(lines(rig.say("PR AL")).contains(&"MD = MR".to_owned()));
    }
}

/// Text printed without a connected client is not kept for the next one.
#[test]
fn output_without_a_client_is_dropped() {
    let mut rig = Rig::plus();
    rig.program("PG 1\nLB G1\nPR \"HERE\"\nH 100\nIC R1\nBR G1,R1<5\nE\nPG");
    rig.set(&["EX 1"]);
    let client: Client = rig.mcode;
    rig.bench.disconnect(client);
    rig.after(1.secs());
    rig.connect();
    assert_eq!(rig.heard(), "");
    assert_eq!(rig.long(0x005F), 5);
}
