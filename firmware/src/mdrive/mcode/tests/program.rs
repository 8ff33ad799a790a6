//! Typing and storing programs.

use proptest::prelude::*;

use super::*;
use crate::mdrive::mcode::program::{ADDRESSES, LINE_BYTES, compact};

/// Lines that L lists.
fn listed(dut: &mut Dut, place: &str) -> Vec<String> {
    let text = dut.types(&std::format!("L {place}\r"));
    text.split_terminator("\r\n").map(String::from).collect()
}

#[test]
fn lines_are_stored_as_they_are_typed() {
    let mut dut = Dut::plus();
    assert_eq!(dut.types("PG 100\r"), "PG 100\r\n>");
    assert_eq!(dut.types(" LB k1  'Label\r"), " LB k1  'Label\r\n>");
    dut.types_lines("R1=5\n\n  ' only a comment\n PR  \"It's  x\" ,  p\nmr   -5000\nE\nPG");
    assert_eq!(dut.types("L\r"), "L\r\nLB K1\r\nR1=5\r\nPR \"It's  x\" , P\r\nMR -5000\r\nE\r\n>");
    assert_eq!(dut.get(Reg::R1), 0, "it is not carried out");
    assert_eq!(dut.types("L 102\r"), "L 102\r\nPR \"It's  x\" , P\r\nMR -5000\r\nE\r\n>");
    assert_eq!(dut.types("L K1\r"), dut.types("L\r").replacen("L\r", "L K1\r", 1));
    assert_eq!(dut.types("L 105\r"), "L 105\r\n>");
}

#[test]
fn what_is_typed_into_a_program_is_judged() {
    let mut dut = Dut::quiet();
    dut.types_lines("VA Q1\nPG 1\nLB K1");
    for (line, error) in [
        // The label K1 exists one line above.
        ("LB K1", 28),
        ("LB Q1", 28),
        ("LB MV", 29),
        ("LB", 24),
        ("HELLO", 20),
        ("BR K1 I1=1", 38),
        ("S1=1,1,1,1", 24),
        ("BD=19", 37),
    ] {
        assert_eq!(dut.error_of(line), error, "{line}");
    }
    dut.types_lines("BR K9,Q7>5\nH5=7\nPG");
    assert_eq!(listed(&mut dut, ""), ["LB K1", "BR K9,Q7>5", "H5=7"]);
    assert_eq!(dut.error_of("LB K2"), 46, "not in program mode");
}

#[test]
fn addresses_and_labels_that_are_not_there() {
    let mut dut = Dut::quiet();
    for line in ["PG 0", "PG 2048", "PG -1", "PG 100000", "L 0", "L 2048", "CP 0", "CP 2048"] {
        assert_eq!(dut.error_of(line), 42, "{line}");
    }
    for line in ["PG K1", "L K1", "CP K1", "L VM"] {
        assert_eq!(dut.error_of(line), 30, "{line}");
    }
    dut.types_lines("PG");
    assert_eq!(dut.types("PR P\r"), "0\r\n", "not in program mode");
    dut.types_lines("PG 2047\nE");
    assert_eq!(dut.error_of("E"), 45);
    dut.types_lines("PG");
    assert_eq!(listed(&mut dut, "2047"), ["E"]);
}

/// MC 4.4 ends with 767, but programs of real machines have `PG 1000`. Addresses up to 2047 work like any
/// other.
#[test]
fn addresses_go_on_behind_767() {
    let mut dut = Dut::quiet();
    dut.types_lines("PG 767\nR1=1\nR1=R1+10\nE\nPG\nPG 1000\nLB G1\nR2=1\nBR 1003\nR3=1\nE\nPG");
    let (low, high) = (["R1=1", "R1=R1+10", "E"], ["LB G1", "R2=1", "BR 1003", "R3=1", "E"]);
    assert_eq!(listed(&mut dut, ""), [&low[..], &high[..]].concat());
    assert_eq!(listed(&mut dut, "770"), high);
    assert_eq!(listed(&mut dut, "1000"), high);
    assert_eq!(dut.types("PR UV\r"), "G1 = 1000\r\n\r\n");
    dut.cycle();
    dut.types("EM=2\r");
    for (line, r) in [("EX 767", [11, 0, 0]), ("EX 1000", [11, 1, 1]), ("R3=0\nEX G1", [11, 1, 1])] {
        dut.types_lines(line);
        dut.wait(crate::device::Duration::millis(10));
        assert_eq!([Reg::R1, Reg::R2, Reg::R3].map(|reg| dut.get(reg)), r, "{line}");
    }
    for line in ["EX 999", "EX 1005", "EX 2048"] {
        assert_eq!(dut.error_of(line), 42, "{line}");
    }
    // Without E the program ends after its last line. It does not continue at the next stored line.
    dut.types_lines("R2=0\nPG 769\nR1=5\nPG\nEX 769");
    dut.wait(crate::device::Duration::millis(10));
    assert_eq!([Reg::R1, Reg::R2, Reg::ER, Reg::BY].map(|reg| dut.get(reg)), [5, 0, 0, 0]);
    dut.types_lines("CP 1000");
    assert_eq!(listed(&mut dut, ""), ["R1=1", "R1=R1+10", "R1=5"]);
}

#[test]
fn a_line_replaces_the_one_at_its_address() {
    let mut dut = Dut::quiet();
    dut.types_lines("PG 10\nLB K1\nR1=1\nR1=2\nPG\nPG 10\nLB K2\nR2=1\nPG");
    assert_eq!(listed(&mut dut, ""), ["LB K2", "R2=1", "R1=2"]);
    assert_eq!(dut.types("PR UV\r"), "K2 = 10\r\n\r\n");
    dut.cycle();
    dut.types("EM=2\r");
    assert_eq!(listed(&mut dut, ""), ["LB K2", "R2=1", "R1=2"]);
    assert_eq!(dut.types("PR UV\r"), "K2 = 10\r\n\r\n");
}

/// "This can be caused when you download a program over a program already saved" (MC 9.2, 28).
#[test]
fn a_program_is_not_typed_over_itself() {
    let mut dut = Dut::quiet();
    dut.types_lines("PG 1\nLB K1\nR1=R1+1\nE\nPG\nPG 1");
    assert_eq!(dut.error_of("LB K1"), 28);
    // A refused line leaves its address to the next line.
    dut.types_lines("LB K2\nPG");
    assert_eq!(listed(&mut dut, ""), ["LB K2", "R1=R1+1", "E"]);
    // The label K1 was deleted with its line, and may be defined anywhere now.
    dut.types_lines("PG 1\nLB K1\nPG");
    assert_eq!(dut.types("PR UV\r"), "K1 = 1\r\n\r\n");
    dut.types_lines("CP\nPG 1\nLB K1\nPG");
}

/// "LB G1 ... PG 1 ... LB SU" (MC 5-40): with an address program mode continues there, without one it ends.
#[test]
fn program_mode_goes_on_at_an_address() {
    let mut dut = Dut::quiet();
    dut.types_lines("PG 100\nLB G1\nPG 1\nLB SU\nPG G1\nR1=5\nPG");
    assert_eq!((listed(&mut dut, ""), dut.get(Reg::R1)), (vec!["LB SU".into(), "R1=5".into()], 0));
    dut.types_lines("PG 1");
    assert_eq!(dut.error_of("PG 2048"), 42);
    dut.types_lines("E\nPG");
    assert_eq!(listed(&mut dut, ""), ["E", "R1=5"]);
}

/// Only lines of the connection in program mode are stored. When the connection is lost, program mode ends.
#[test]
fn program_mode_is_of_the_connection_that_began_it() {
    let mut dut = Dut::quiet();
    let there = Link(1);
    dut.feed(Input::Opened { port: MCODE, link: there });
    dut.types_on(there, "PG 10\rR1=1\r");
    assert_eq!(dut.types("PR R1\rL\r"), "0\r\nR1=1\r\n");
    dut.types("PG 20\rR2=2\r");
    dut.types_on(there, "R1=2\r");
    dut.feed(Input::Closed { port: MCODE, link: there });
    dut.feed(Input::Opened { port: MCODE, link: there });
    assert_eq!(dut.types_on(there, "PR R2\rL\r"), "0\r\nR1=1\r\nR1=2\r\nR2=2\r\n");
    dut.types_lines("R2=3\nPG");
    assert_eq!(dut.types("L 20\r"), "R2=2\r\nR2=3\r\n");
}

#[test]
fn cp_clears_from_an_address_or_a_label_on() {
    let mut dut = Dut::quiet();
    dut.types_lines("VA Q1=5\nPG 100\nLB K1\nE\nPG\nPG 200\nLB K2\nE\nPG\nPG 1\nLB K3\nE\nPG");
    dut.types_lines("CP K2");
    assert_eq!(listed(&mut dut, ""), ["LB K3", "E", "LB K1", "E"]);
    dut.types_lines("CP 101");
    assert_eq!(listed(&mut dut, ""), ["LB K3", "E", "LB K1"]);
    dut.cycle();
    dut.types_lines("EM=2");
    assert_eq!(listed(&mut dut, ""), ["LB K3", "E", "LB K1"]);
    assert_eq!(dut.types("PR UV\r"), "K3 = 1\r\nK1 = 100\r\n\r\n");
    dut.types_lines("VA Q1=5\nCP");
    assert_eq!(listed(&mut dut, ""), [""; 0]);
    assert_eq!(dut.types("PR UV\r"), "Q1 = G 5\r\n\r\n", "globals stay");
    dut.cycle();
    dut.types_lines("EM=2");
    assert_eq!(listed(&mut dut, ""), [""; 0]);
}

#[test]
fn a_locked_program_is_neither_listed_nor_changed() {
    let mut dut = Dut::quiet();
    dut.types_lines("PG 1\nLB K1\nE\nPG\nLK=1");
    for line in ["L", "L K1", "PG 1", "PG K1", "CP 1", "CP K1"] {
        assert_eq!(dut.error_of(line), 44, "{line}");
    }
    // LK was not saved, so the power cycle clears it.
    dut.cycle();
    dut.types_lines("EM=2");
    assert_eq!(listed(&mut dut, ""), ["LB K1", "E"]);
    dut.types_lines("LK=1\nCP");
    assert_eq!((dut.get(Reg::LK), listed(&mut dut, "")), (0, Vec::new()));
}

#[test]
fn a_program_is_not_cleared_in_motion() {
    let mut dut = Dut::quiet();
    dut.types_lines("PG 1\nE\nPG\nSL 10000");
    assert_eq!(dut.error_of("CP"), 74);
    assert_eq!(listed(&mut dut, ""), ["E"]);
}

#[test]
fn there_are_192_labels_and_variables() {
    let mut dut = Dut::quiet();
    // No name of the language begins with the letters of the following names.
    let names: Vec<String> = (0..180)
        .map(|n| {
            std::format!(
                "{}{}",
                char::from(b"GKXYZ"[n / 36 % 5]),
                char::from_digit(n as u32 % 36, 36).unwrap()
            )
        })
        .chain("0123456789ABC".chars().map(|last| std::format!("N{last}")))
        .collect();
    dut.types_lines("PG 1");
    for name in &names[..191] {
        dut.types_lines(&std::format!("LB {name}"));
    }
    dut.types_lines("PG");
    dut.types_lines(&std::format!("VA {}", names[191]));
    assert_eq!(dut.error_of(&std::format!("VA {}", names[192])), 31);
    dut.types_lines("PG 300");
    assert_eq!(dut.error_of(&std::format!("LB {}", names[192])), 31);
    dut.types_lines("PG");
    assert_eq!(listed(&mut dut, "").len(), 191);
}

#[test]
fn the_log_fills_up_and_is_emptied() {
    let mut dut = Dut::quiet();
    let line = std::format!("PR \"{}\"", "x".repeat(59));
    assert_eq!(line.len(), LINE_BYTES);
    dut.types_lines("PG 1");
    let mut stored = 0;
    loop {
        dut.types(&line);
        dut.types("\r");
        match dut.get(Reg::ER) {
            0 => stored += 1,
            error => break assert_eq!(error, 45),
        }
    }
    // Each line takes 69 bytes, and one byte marks the end.
    assert_eq!(stored, 12 * 1024 / 69);
    dut.drive.drive.mcode.errors.clear();
    dut.types_lines("PG");
    assert_eq!(listed(&mut dut, "").len(), stored);
    dut.cycle();
    dut.types_lines("EM=2");
    assert_eq!(listed(&mut dut, "").len(), stored);
    // CP frees the room after the last line that stays.
    dut.types_lines("CP 2\nPG 2");
    dut.types_lines(&line);
    dut.types_lines("PG");
    assert_eq!(listed(&mut dut, ""), [&*line, &*line]);
    dut.types_lines("CP\nPG 1\nE\nPG");
    dut.cycle();
    dut.types_lines("EM=2");
    assert_eq!(listed(&mut dut, ""), ["E"]);
}

/// Only valid lines take room in the log.
#[test]
fn lines_that_are_replaced_make_room() {
    let mut dut = Dut::quiet();
    let line = |n: usize, text: &str| std::format!("PR \"{n:05}{}\"", text.repeat(54));
    dut.types_lines("PG 1\nLB K1\nE\nPG");
    // As many lines as there is room for, and each is replaced many times.
    for n in 0..1_000 {
        dut.types_lines(&std::format!("PG {}\n{}\nPG", 3 + n % 177, line(n, "x")));
    }
    let lines = |from: usize| {
        let kept = (0..177).map(move |n| from + (n + 177 - from % 177) % 177);
        ["LB K1".into(), "E".into()].into_iter().chain(kept.map(|n| line(n, "x"))).collect::<Vec<String>>()
    };
    assert_eq!(listed(&mut dut, ""), lines(823));
    dut.types_lines("PG 700");
    assert_eq!(dut.error_of(&line(0, "y")), 45);
    dut.types_lines("PG");
    assert_eq!(listed(&mut dut, ""), lines(823));
    dut.cycle();
    dut.types_lines("EM=2");
    assert_eq!(listed(&mut dut, ""), lines(823));
    assert_eq!(dut.types("PR UV\r"), "K1 = 1\r\n\r\n");
    dut.types_lines("CP K1");
    assert_eq!(listed(&mut dut, ""), [""; 0]);
}

/// After a power failure while lines are moved, the program is complete, or empty with error 70. Lines stored
/// afterwards are kept.
#[test]
fn power_lost_while_lines_make_room() {
    let mut outcomes = Vec::new();
    for bytes in (0..).step_by(7) {
        let mut dut = Dut::quiet();
        let long = std::format!("PR \"{}\"", "x".repeat(50));
        dut.types_lines("PG 1\nR1=1\nR1=2\nR1=3\nE\nPG");
        // Stores lines until the log has no room for one more.
        for _ in 0..12 * 1024 / 60 {
            dut.types_lines(&std::format!("PG 2\n{long}\nPG"));
        }
        dut.out.bytes_left = bytes;
        dut.types_lines(&std::format!("PG 2\n{long}\nPG"));
        let done = dut.out.bytes_left != 0;
        dut.cycle();
        let error = dut.get(Reg::ER);
        dut.types("ER=0\rEM=2\r");
        let lines = listed(&mut dut, "");
        match error {
            0 => assert_eq!(lines, ["R1=1", &*long, "R1=3", "E"], "{bytes}"),
            error => assert_eq!((error, lines), (70, Vec::new()), "{bytes}"),
        }
        outcomes.push(error);
        dut.types_lines("CP\nPG 5\nE\nPG");
        dut.cycle();
        dut.types_lines("EM=2");
        assert_eq!(listed(&mut dut, ""), ["E"]);
        if done {
            break;
        }
    }
    assert!(outcomes.contains(&70) && outcomes.last() == Some(&0), "{outcomes:?}");
}

/// A drive with five lines. Its log has two more lines, which have been replaced.
fn some_program() -> Dut {
    let mut dut = Dut::quiet();
    dut.types_lines("PG 1\nLB K1\nR1=1\nR1=2\nPG\nPG 2\nR1=3\nPG\nPG 100\nLB K2\nE\nPG\nPG 2\nR1=4\nPG");
    dut
}

#[test]
fn power_lost_while_a_line_is_stored_leaves_it_there_or_not() {
    let before = ["LB K1", "R1=4", "R1=2", "LB K2", "E"];
    let after = ["LB K1", "R1=4", "R1=2", "LB K2", "R2=7"];
    let mut outcomes = Vec::new();
    for bytes in 0.. {
        let mut dut = some_program();
        dut.types_lines("PG 101");
        dut.out.bytes_left = bytes;
        dut.types_lines("R2=7");
        let done = dut.out.bytes_left != 0;
        dut.cycle();
        assert_eq!(dut.get(Reg::ER), 0);
        dut.types_lines("EM=2");
        let lines = listed(&mut dut, "");
        outcomes.push(lines == after);
        assert!(lines == before || lines == after, "{bytes}: {lines:?}");
        // The incomplete line does not damage a line that is stored afterwards.
        dut.types_lines("PG 102\nPG");
        dut.types_lines("PG 102\nE\nPG");
        assert_eq!(listed(&mut dut, "102"), ["E"]);
        dut.cycle();
        dut.types_lines("EM=2");
        assert_eq!(listed(&mut dut, "102"), ["E"]);
        if done {
            break;
        }
    }
    assert!(outcomes.is_sorted() && outcomes.contains(&false) && outcomes.contains(&true));
}

#[test]
fn power_lost_while_lines_are_cleared_brings_no_older_ones_back() {
    for bytes in 0.. {
        let mut dut = some_program();
        dut.out.bytes_left = bytes;
        dut.types_lines("CP 2");
        let done = dut.out.bytes_left != 0;
        dut.cycle();
        assert_eq!(dut.get(Reg::ER), 0);
        dut.types_lines("EM=2");
        let lines = listed(&mut dut, "");
        let known = ["LB K1", "R1=4", "R1=2", "LB K2", "E"];
        assert_eq!(lines[0], "LB K1");
        assert!(lines.iter().all(|line| known.contains(&&**line)), "{bytes}: {lines:?}");
        if done {
            assert_eq!(lines, ["LB K1"]);
            break;
        }
    }
}

#[test]
fn check_sums_are_looked_at_when_power_comes_and_not_by_each_line() {
    let mut dut = Dut::quiet();
    dut.types_lines("PG 1\nE\nPG");
    // A record has two bytes of address, one of length, and the character; then the CRC.
    dut.out.memory[crate::mdrive::saved::PROGRAM + 4] ^= 1;
    assert_eq!(listed(&mut dut, ""), ["E"]);
    dut.cycle();
    assert_eq!(dut.get(Reg::ER), 70);
}

#[test]
fn cp_of_everything_is_one_store() {
    let mut dut = some_program();
    dut.out.bytes_left = 1;
    dut.types_lines("CP");
    dut.cycle();
    dut.types_lines("EM=2");
    assert_eq!((dut.get(Reg::ER), listed(&mut dut, "")), (0, Vec::new()));
}

#[test]
fn a_log_that_is_none_is_a_flash_error_and_empty() {
    let start = crate::mdrive::saved::PROGRAM;
    for place in 0..40 {
        let mut dut = some_program();
        dut.out.memory[start + place] ^= 0x11;
        dut.cycle();
        assert_eq!(dut.get(Reg::ER), 70, "{place}");
        dut.types("ER=0\r");
        dut.types_lines("EM=2");
        assert_eq!(listed(&mut dut, ""), [""; 0]);
        dut.types_lines("PG 5\nLB K1\nPG");
        dut.cycle();
        dut.types_lines("EM=2");
        assert_eq!(listed(&mut dut, ""), ["LB K1"]);
    }
}

#[test]
fn a_label_that_runs_at_power_on_is_found_again() {
    let mut dut = Dut::quiet();
    dut.types_lines("PG 50\nlb su\nR1=77\nE\nPG");
    dut.cycle();
    dut.wait(crate::device::Duration::millis(10));
    assert_eq!(dut.get(Reg::R1), 77);
}

proptest! {
    /// Typed lines of a program are listed as they are stored, before and after a power cycle.
    #[test]
    fn a_program_is_what_the_last_lines_of_its_addresses_say(
        steps in prop::collection::vec((1_u16..30, 1_u16..999, prop::bool::weighted(0.1)), 1..40)
    ) {
        let mut dut = Dut::quiet();
        let mut model = std::collections::BTreeMap::new();
        for (address, value, clears) in steps {
            if clears {
                dut.types_lines(&std::format!("CP {address}"));
                model.retain(|other, _| *other < address);
            } else {
                dut.types_lines(&std::format!("PG {address}\nR1={value}\nPG"));
                model.insert(address, std::format!("R1={value}"));
            }
        }
        let expected: Vec<String> = model.into_values().collect();
        prop_assert_eq!(&listed(&mut dut, ""), &expected);
        dut.cycle();
        dut.types_lines("EM=2");
        prop_assert_eq!(&listed(&mut dut, ""), &expected);
    }

    /// Bringing a stored line into stored form again changes nothing.
    #[test]
    fn a_line_that_is_kept_is_kept_as_it_is(line in prop::collection::vec(any::<u8>(), 0..=64)) {
        let kept = compact(&line);
        prop_assert!(kept.len() <= line.len());
        prop_assert_eq!(&compact(&kept), &kept);
    }

    #[test]
    fn any_memory_is_survived(bytes in prop::collection::vec(any::<u8>(), 1..300), place in 0_usize..MEMORY) {
        let mut dut = some_program();
        let end = (place + bytes.len()).min(MEMORY);
        dut.out.memory[place..end].copy_from_slice(&bytes[..end - place]);
        dut.cycle();
        dut.types("ER=0\rEM=2\rL\rPG 1\rLB K1\rPG\rCP\r");
        prop_assert_eq!(listed(&mut dut, ""), Vec::<String>::new());
        let _ = ADDRESSES;
    }
}
