//! Every variable and flag of MCode (MC 5): the value in a new drive, the legal values, and the errors of
//! other values.

use crate::rig::{CALIBRATION, KINDS, Kind, Rig};

struct Row {
    name: &'static str,
    /// Text that PR prints on a new drive; empty if another test checks it.
    fresh: &'static str,
    legal: &'static [i64],
    /// Values that the drive refuses, each with its error.
    refused: &'static [(i64, i64)],
    only: Option<Kind>,
}

const fn row(
    name: &'static str,
    fresh: &'static str,
    legal: &'static [i64],
    refused: &'static [(i64, i64)],
) -> Row {
    Row { name, fresh, legal, refused, only: None }
}

impl Row {
    const fn plus(self) -> Self {
        Self { only: Some(Kind::Plus), ..self }
    }

    const fn hybrid(self) -> Self {
        Self { only: Some(Kind::Hybrid), ..self }
    }
}

const BIT: &[i64] = &[0, 1];
const NOT_A_BIT: &[(i64, i64)] = &[(-1, 21), (2, 21)];
const BYTE: &[i64] = &[0, 1, 255];
const NOT_A_BYTE: &[(i64, i64)] = &[(-1, 21), (256, 21)];
const LONG: &[i64] = &[0, 1, -1, 2_147_483_647, -2_147_483_647];
const RATE: &[i64] = &[91, 92, 1_525_878_997];
const NOT_A_RATE: &[(i64, i64)] = &[(90, 21), (0, 21), (-1, 21), (1_525_878_998, 21)];
const TO_9: &[i64] = &[0, 1, 9];
const NOT_TO_9: &[(i64, i64)] = &[(-1, 21), (10, 21)];
/// Errors of a read-only variable (MC 9.2).
const NEVER: &[(i64, i64)] = &[(0, 25), (1, 25)];
/// HT + MT is at most 65535 (MC 5-32), and HT is 500.
const TO_65000: &[i64] = &[0, 1, 65_000];
const NOT_TO_65000: &[(i64, i64)] = &[(-1, 21), (65_001, 21)];

#[rustfmt::skip]
static TABLE: &[Row] = &[
    row("A", "1000000", RATE, NOT_A_RATE),
    row("BY", "0", &[], NEVER),
    row("C1", "0", LONG, &[]),
    row("C2", "0", LONG, &[]),
    row("CE", "1", &[0, 2, 1], &[(-1, 21), (3, 21)]),
    row("CM", "0", BIT, NOT_A_BIT).plus(),
    row("CW", "10", BYTE, NOT_A_BYTE),
    row("D", "1000000", RATE, NOT_A_RATE),
    row("D1", "0", BYTE, NOT_A_BYTE),
    row("D2", "0", BYTE, NOT_A_BYTE),
    row("D3", "0", BYTE, NOT_A_BYTE),
    row("D4", "0", BYTE, NOT_A_BYTE),
    row("D5", "0", BYTE, NOT_A_BYTE),
    // FB gives the default 10.
    row("DB", "10", TO_65000, NOT_TO_65000).plus(),
    row("DE", "1", BIT, NOT_A_BIT),
    row("EE", "0", BIT, NOT_A_BIT),
    row("EF", "0", &[], &[(1, 25)]),
    row("ER", "0", &[0], &[]),
    row("ES", "1", &[0, 2, 3, 1], &[(-1, 21), (4, 21)]),
    row("FC", "0", TO_9, NOT_TO_9),
    row("FM", "2", TO_9, NOT_TO_9).plus(),
    row("HC", "5", &[0, 1, 100], &[(-1, 21), (101, 21)]),
    row("HT", "500", &[0, 2, 65_535], &[(1, 21), (-1, 21), (65_536, 21)]),
    row("I1", "0", &[], NEVER),
    row("I2", "0", &[], NEVER),
    row("I3", "0", &[], NEVER),
    row("I4", "0", &[], NEVER),
    row("I5", "0", &[], NEVER),
    row("I6", "", &[], NEVER).plus(),
    row("IF", "0", &[0], NOT_A_BIT),
    row("IL", "15", &[], NEVER),
    row("IN", "15", &[], NEVER),
    row("JE", "0", BIT, NOT_A_BIT),
    row("LM", "1", &[1, 2, 3, 4, 5, 6], &[(0, 21), (7, 21), (-1, 21)]),
    row("MP", "0", &[], NEVER),
    row("MS", "256", &[1, 2, 4, 8, 16, 32, 64, 128, 5, 10, 25, 50, 100, 125, 200, 250, 108, 127, 180, 256],
        &[(0, 21), (3, 21), (255, 21), (257, 21), (-1, 21)]),
    row("MT", "0", TO_65000, NOT_TO_65000),
    row("MV", "0", &[], NEVER),
    row("NE", "1", BIT, NOT_A_BIT),
    row("P", "0", LONG, &[]),
    row("PC", "0", &[], NEVER),
    row("PM", "0", BIT, NOT_A_BIT).plus(),
    row("R1", "0", LONG, &[]),
    row("R2", "0", LONG, &[]),
    row("R3", "0", LONG, &[]),
    row("R4", "0", LONG, &[]),
    row("RC", "25", &[1, 2, 100], &[(0, 21), (101, 21), (-1, 21)]),
    row("SF", "15", TO_65000, NOT_TO_65000).plus(),
    row("SM", "0", BIT, NOT_A_BIT).plus(),
    row("ST", "0", BIT, NOT_A_BIT).plus(),
    row("TE", "0", &[0], &[(-1, 21), (64, 21), (1, 27), (2, 27), (4, 27), (8, 27), (16, 27)]),
    row("V", "0", &[], NEVER),
    row("VC", "0", &[], NEVER),
    row("VI", "1000", &[1, 2, 767_999], &[(0, 21), (768_000, 22), (-1, 21)]),
    row("VM", "768000", &[1_001, 5_000_000], &[(1_000, 23), (5_000_001, 21)]),

    row("AF", "", &[], NEVER).hybrid(),
    row("AS", "2", &[0, 1, 2, 3], &[(-1, 21), (4, 21)]).hybrid(),
    row("CB", "1", &[0, 1, 2, 3], &[(-1, 21), (4, 21)]).hybrid(),
    row("CC", "100", &[1, 2, 100], &[(0, 21), (101, 21)]).hybrid(),
    row("CT", "200", &[2, 3, 65_535], &[(1, 21), (0, 21), (65_536, 21)]).hybrid(),
    row("IT", "", &[], NEVER).hybrid(),
    row("LD", "102400", &[0, 1, 2_147_483_647], &[(-1, 21)]).hybrid(),
    row("LG", "102400", &[0, 1, 2_147_483_647], &[(-1, 21)]).hybrid(),
    row("LL", "0", &[], NEVER).hybrid(),
    row("LR", "0", &[], NEVER).hybrid(),
    row("LT", "2000", &[2, 3, 65_535], &[(1, 21), (0, 21), (65_536, 21)]).hybrid(),
    row("MF", "768000", &[306, 307, 5_000_000], &[(305, 21), (5_000_001, 21)]).hybrid(),
    // 10 MHz/(n + 2), rounded down, with n of one byte: 38910 to 5000000 (MC 5-70). The default of n is 0.
    row("SS", "5000000", &[38_910, 5_000_000], &[(38_909, 21), (5_000_001, 21)]).hybrid(),
    row("TD", "1", BIT, NOT_A_BIT).hybrid(),
    row("TQ", "25", &[1, 2, 100], &[(0, 21), (101, 21)]).hybrid(),
    row("TS", "5000000", &[38_910, 5_000_000], &[(38_909, 21), (5_000_001, 21)]).hybrid(),
    row("VF", "0", &[0, 1, 1_000], &[(-1, 21), (1_001, 21)]).hybrid(),
    // A value below IT would cause a warning at once.
    row("WT", "80", &[84, 83], &[(-1, 21), (85, 21)]).hybrid(),
];

fn rows(kind: Kind) -> impl Iterator<Item = &'static Row> {
    TABLE.iter().filter(move |row| row.only.is_none_or(|only| only == kind))
}

impl Rig {
    /// Waits after AS, DE, MS and EE, because they calibrate a Hybrid (MC 5-8).
    fn pause_after(&mut self, name: &str) {
        if self.kind == Kind::Hybrid && matches!(name, "AS" | "DE" | "MS" | "EE") {
            self.after(CALIBRATION);
        }
    }
}

#[test]
fn a_new_drive_prints_the_defaults() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        for row in rows(kind).filter(|row| !row.fresh.is_empty()) {
            assert_eq!(rig.show(row.name), row.fresh, "{} of {kind:?}", row.name);
        }
        let lines = if kind == Kind::Hybrid { "1000" } else { "512" };
        assert_eq!(rig.show("EL"), lines, "EL of {kind:?} (MC 5-22)");
    }
}

#[test]
fn what_is_legal_is_set_and_printed() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        for row in rows(kind) {
            let fresh = rig.show(row.name);
            for &value in row.legal {
                // Between name and value MCode takes an equals sign or a blank, or nothing if the name has no
                // digit.
                rig.say(&format!("{}={value}", row.name));
                rig.pause_after(row.name);
                assert_eq!(rig.show("ER"), "0", "{}={value} of {kind:?}", row.name);
                assert_eq!(rig.value(row.name), value, "{} of {kind:?}", row.name);
                rig.say(&format!("{} {value}", row.name));
                rig.pause_after(row.name);
                assert_eq!(rig.show("ER"), "0", "{} {value} of {kind:?}", row.name);
            }
            if !row.legal.is_empty() {
                rig.say(&format!("{}={fresh}", row.name));
                rig.pause_after(row.name);
            }
        }
    }
}

#[test]
fn what_is_not_legal_is_an_error_and_changes_nothing() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        for row in rows(kind) {
            let before = rig.show(row.name);
            for &(value, error) in row.refused {
                rig.say(&format!("{}={value}", row.name));
                assert_eq!(rig.value("ER"), error, "{}={value} of {kind:?}", row.name);
                assert_eq!(rig.show(row.name), before, "{} of {kind:?}", row.name);
            }
        }
    }
}

/// On an MDrivePlus the names of Hybrid variables are free for the user. A Hybrid has no variable of a Plus
/// (error 20).
#[test]
fn names_of_the_hybrid_are_the_users_on_a_plus() {
    let mut rig = Rig::plus();
    for row in TABLE.iter().filter(|row| row.only == Some(Kind::Hybrid)) {
        rig.refused(&format!("{}=5", row.name), 20);
        rig.set(&[&format!("VA {}=5", row.name)]);
        rig.assert_values(&[(row.name, 5)]);
    }
    let mut rig = Rig::hybrid();
    // On a Hybrid I6 has no register, but is a variable (MC 5-34).
    for row in TABLE.iter().filter(|row| row.only == Some(Kind::Plus) && row.name != "I6") {
        rig.say(&format!("{}=0", row.name));
        let error = rig.value("ER");
        assert!(error == 20 || error == 37, "{}: {error}", row.name);
    }
}

/// A register and its variable show one value in two units.
#[test]
fn system_speeds_are_10_mhz_over_n_and_2() {
    let mut rig = Rig::hybrid();
    for (name, address) in [("SS", 0x00A2), ("TS", 0x00A7)] {
        for (n, shown) in [(0, 5_000_000), (1, 3_333_333), (8, 1_000_000), (98, 100_000), (255, 38_910)] {
            rig.write(address, n);
            assert_eq!(rig.value(name), shown, "{name}, {n}");
        }
        rig.set(&[&format!("{name}=1000000")]);
        assert_eq!(rig.word(address), 8);
    }
}

/// MC 4.9: arithmetic has 32 bits and wraps; a division truncates.
#[test]
fn two_operands_and_an_operator() {
    let mut rig = Rig::plus();
    rig.set(&["VA Q1=7", "R1=100", "R2=-7"]);
    for (expression, value) in [
        ("R1+R2", 93),
        ("R1-R2", 107),
        ("R1*R2", -700),
        ("R1/R2", -14),
        ("R1 / 3", 33),
        ("R2/2", -3),
        ("6&3", 2),
        ("2|8", 10),
        ("10^3", 9),
        ("Q1+1", 8),
        ("Q1", 7),
        ("2147483647+1", -2_147_483_648),
        ("65536*65536", 0),
        ("1000000*1000000", -727_379_968),
        ("!0", -1),
        ("!5", -6),
    ] {
        rig.say("R3=12345");
        rig.say(&format!("R3={expression}"));
        assert_eq!((rig.value("ER"), rig.value("R3")), (0, value), "{expression}");
    }
    rig.set(&["A=Q1*1000", "D=A", "VM=R1*100"]);
    rig.assert_values(&[("A", 7_000), ("D", 7_000), ("VM", 10_000)]);
    // A division by 0 is an error.
    rig.say("R3=R1/0");
    assert_ne!(rig.value("ER"), 0);
    assert_eq!(rig.value("R3"), -6);
}

/// MC 5-35: IC and DC work on variables and registers.
#[test]
fn variables_count() {
    let mut rig = Rig::plus();
    rig.set(&["VA K5=9", "IC R1", "IC R1", "DC R2", "IC K5", "DC K5", "DC K5", "IC P"]);
    rig.assert_values(&[("R1", 2), ("R2", -1), ("K5", 8), ("P", 1)]);
    rig.refused("IC V", 26);
    rig.refused("DC MV", 26);
    rig.refused("IC Z9", 30);
}

/// MC 5-78: names of user variables have one or two characters.
#[test]
fn user_variables_are_one_or_two_characters() {
    let mut rig = Rig::plus();
    rig.set(&["VA Q", "VA Q1", "VA QZ=20000", "VA q2=-3", "VA W = 8"]);
    rig.assert_values(&[("Q", 0), ("Q1", 0), ("QZ", 20_000), ("Q2", -3), ("q2", -3), ("W", 8)]);
    rig.refused("VA Q1", 28);
    for name in ["VM", "MA", "SU", "AL", "UV", "PR", "S", "R1", "I7", "AT", "FT"] {
        rig.refused(&format!("VA {name}"), 29);
    }
    for name in ["1Q", "QQQ", "Q_", "#"] {
        rig.say(&format!("VA {name}"));
        assert_ne!(rig.value("ER"), 0, "VA {name}");
    }
    // PW is a variable of the MForce; on an MDrive the name is free (MC 5-58).
    rig.set(&["VA PW=1"]);
}

/// The table has room for 192 labels and variables (MC 3.2.2).
#[test]
fn the_table_of_names_is_full_at_192() {
    let mut rig = Rig::plus();
    let letters = ["K", "W", "X", "Y", "Z", "G"];
    let names =
        letters.iter().flat_map(|first| ('A'..='Z').chain('0'..='9').map(move |c| format!("{first}{c}")));
    for name in names.take(192) {
        rig.set(&[&format!("VA {name}")]);
    }
    rig.refused("VA Q9", 31);
    rig.say("FD");
    rig.after(crate::rig::START);
    rig.say("EM=2");
    rig.heard();
    rig.set(&["VA Q9"]);
}

/// MC 5-36, 5-39, 8.5: IV stores the next typed number in a variable.
#[test]
fn a_number_is_put_into_a_variable() {
    let mut rig = Rig::plus();
    rig.set(&["IV R1"]);
    rig.assert_values(&[("IF", 1)]);
    rig.refused("IV R2", 62);
    rig.set(&["-1234"]);
    rig.assert_values(&[("R1", -1_234), ("IF", 0), ("R2", 0)]);
    assert_eq!(rig.word(0x004A), 0, "nothing moves");
}

/// "IF=<0/1>", "cleared to zero (0) with a carriage return" (MC 5-36).
#[test]
fn the_flag_of_an_input() {
    let mut rig = Rig::plus();
    for (line, error) in [("12a", 24), ("99999999999", 21), ("", 0), ("IF=0", 0)] {
        rig.set(&["IV R1"]);
        rig.say(line);
        rig.assert_values(&[("IF", 0), ("ER", error), ("R1", 0)]);
    }
    rig.set(&["IF=1"]);
    rig.assert_values(&[("IF", 1)]);
    rig.refused("IF=1", 62);
    rig.set(&["5"]);
    rig.assert_values(&[("IF", 0), ("R1", 5)]);
}

/// MC 5-14: CR is 0.001 to 2.000. An integer 1 from another variable is 1.000.
#[test]
fn a_clock_ratio_is_a_number() {
    let mut rig = Rig::plus();
    rig.set(&["R1=1"]);
    for (line, shown) in [
        ("CR=1.500", "1.500"),
        ("CR=R1", "1.000"),
        ("CR=.5", "0.500"),
        ("IC CR", "1.500"),
        ("DC CR", "0.500"),
        ("CR=CR*3", "1.500"),
        ("CR=2.", "2.000"),
        ("CR=CR-R1", "1.000"),
        ("CR=0.50", "0.500"),
        ("CR=1.5000", "1.500"),
    ] {
        rig.set(&[line]);
        assert_eq!(rig.show("CR"), shown, "{line}");
    }
    for line in ["CR=1.5001", "CR=0", "CR=2.001", "CR=3", "IC CR"] {
        rig.refused(line, 21);
    }
    rig.set(&["R2=CR", "R3=CR*2"]);
    rig.assert_values(&[("R2", 1), ("R3", 3)]);
}

/// A line that PR AL prints for a trip can be typed to set the trip.
#[test]
fn trips_are_set_as_they_are_printed() {
    let mut rig = Rig::hybrid();
    let all = rig.say("PR AL");
    for name in ["TA", "TC", "TI", "TP", "TR", "TT"] {
        let line = all.lines().find(|line| line.starts_with(&format!("{name} = ")));
        rig.set(&[line.unwrap_or_else(|| panic!("there is no {name}"))]);
    }
}
