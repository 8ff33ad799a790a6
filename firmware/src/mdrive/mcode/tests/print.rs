//! Output of PR (MC 5-57).

use super::*;

#[test]
fn texts_and_values_stand_side_by_side() {
    let mut dut = Dut::quiet();
    dut.types_lines("R1=-2147483648\nR2=7\nVA Q1=9");
    for (line, printed) in [
        ("PR \"Position =\", P", "Position =0\r\n"),
        ("PR MV ST", "00\r\n"),
        ("PR R1", "-2147483648\r\n"),
        ("PR R2,R2 q1", "779\r\n"),
        ("PR\"a,b 'c;\"", "a,b 'c;\r\n"),
        ("PR \"A\" R2 \"b\"", "A7b\r\n"),
        ("PR \"\"", "\r\n"),
        ("PR", "\r\n"),
        ("PR R2;", "7"),
        ("PR R2 ; 'no more", "7"),
        ("PR vm", "768000\r\n"),
    ] {
        assert_eq!(dut.types(&std::format!("{line}\r")), printed, "{line}");
    }
    assert_eq!(dut.get(Reg::ER), 0);
}

#[test]
fn what_has_several_values_or_another_form() {
    let mut dut = Dut::quiet();
    for (line, printed) in [
        ("PR S1", "0, 0, 0\r\n"),
        ("PR S5", "9, 0\r\n"),
        ("PR S7", "33, 0\r\n"),
        ("PR S13", "60, 0\r\n"),
        ("PR CR", "1.000\r\n"),
        ("PR TR", "0, 0, 0\r\n"),
        ("PR TP", "0, 0\r\n"),
        ("PR TC", "0\r\n"),
        ("PR SN", "123456789\r\n"),
    ] {
        assert_eq!(dut.types(&std::format!("{line}\r")), printed, "{line}");
    }
    dut.types_lines("S2=16,1,1\nCR=0.05\nPG 1\nLB K9\nPG\nTP=-5,K9\nTR=650000,1,3");
    assert_eq!(dut.types("PR S2 \"/\" CR\r"), "16, 1, 1/0.050\r\n");
    assert_eq!(dut.types("PR TP\rPR TR\r"), "-5, K9\r\n650000, 1, 3\r\n");
}

#[test]
fn identity() {
    let mut dut = Dut::quiet();
    let version = dut.types("PR VR\r");
    assert!(version.starts_with("3.") && version.matches('.').count() == 3, "{version}");
    assert!(dut.types("PR PN\r").starts_with("MDI"));
    // "Hybrid products will return a second value for the hardware version" (MC 5-80).
    let mut dut = Dut::ready(Mdrive::hybrid(), 2);
    let version = dut.types("PR VR\r");
    assert!(version.starts_with("4.") && version.contains(", "), "{version}");
    // 10 MHz/(0 + 2) for SS = TS = 0.
    assert_eq!(dut.types("PR SS \" \" TS\r"), "5000000 5000000\r\n");
    assert_eq!(dut.types("PR MU\r"), "0, 0\r\n");
}

#[test]
fn the_last_motion_command() {
    let mut dut = Dut::quiet();
    dut.types_lines("SL 0\nMR 1");
    assert_eq!(dut.types("PR MD\r"), "MR\r\n");
}

#[test]
fn nothing_is_printed_of_a_line_with_an_error() {
    let mut dut = Dut::quiet();
    dut.types_lines("PG 1\nLB K1\nPG");
    for (line, error) in [
        ("PR P QQ", 30),
        ("PR \"x\",MA", 35),
        ("PR HM", 35),
        ("PR K1", 35),
        ("PR I10", 37),
        ("PR DN", 37),
        ("PR P \"open", 24),
        ("PR P;P", 24),
        ("PR 5", 24),
        ("PR R1+R2", 24),
        ("PR $", 24),
    ] {
        dut.out.messages.clear();
        assert_eq!(dut.error_of(line), error, "{line}");
        assert_eq!(dut.said(), [], "{line}");
    }
    // A refused line does not read ER, although ER is its first item.
    dut.types("HELLO\rPR ER QQ\r");
    assert_eq!(dut.get(Reg::ER), 30);
}

#[test]
fn user_variables_and_labels() {
    let mut dut = Dut::quiet();
    dut.types_lines("VA V1=512000\nVA X\nPG 100\nLB SU\nVA Q2=5\nE\nPG");
    assert_eq!(dut.types("PR UV\r"), "V1 = G 512000\r\nX = G 0\r\nSU = 100\r\n\r\n");
    dut.types_lines("EX 100");
    dut.wait(crate::device::Duration::millis(10));
    assert_eq!(dut.types("PR UV\r"), "V1 = G 512000\r\nX = G 0\r\nSU = 100\r\nQ2 = L 5\r\n\r\n");
}

#[test]
fn all_variables() {
    let mut dut = Dut::quiet();
    dut.types("HELLO\r");
    let all = dut.types("PR AL\r");
    let lines: Vec<&str> = all.strip_suffix("\r\n\r\n").unwrap().split("\r\n").collect();
    for line in [
        "A = 1000000",
        "D = 1000000",
        "VM = 768000",
        "S1 = 0, 0, 0",
        "CR = 1.000",
        "ER = 20",
        "TE = 0",
        "EL = 512",
    ] {
        assert!(lines.contains(&line), "{line}");
    }
    for name in ["AS", "DN", "MA", "S", "V1", "SerialCommands"] {
        assert!(!lines.iter().any(|line| line.starts_with(&std::format!("{name} ="))), "{name}");
    }
    assert!(lines.is_sorted());
    // AL includes trips. Each printed line is accepted as a command.
    for line in ["TI = 0, 0", "TP = 0, 0", "TC = 0", "TT = 0, 0", "TR = 0, 0, 0"] {
        assert!(lines.contains(&line), "{line}");
        dut.types("ER=0\r");
        dut.types_lines(line);
    }
    dut.types("HELLO\r");
    assert_eq!(dut.get(Reg::ER), 20, "only PR ER reads it");
    let mut dut = Dut::ready(Mdrive::hybrid(), 2);
    let all = dut.types("PR AL\r");
    assert!(all.contains("\r\nAS = 2\r\n") && all.contains("\r\nEL = 1000\r\n") && !all.contains("\r\nST ="));
}
