//! The errors of MC 9 that no other test covers.

use drivetwin_protocol::time::{Duration, Span};

use crate::rig::{KINDS, Rig, START};

#[test]
fn what_is_wrong_with_a_line_has_a_number() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        rig.program("PG 1\nLB P9\nE\nPG");
        for (line, error) in [
            // Unknown variables, or typing errors.
            ("QQ=5", 20),
            ("XYZZY", 20),
            ("?", 20),
            // Unknown operands.
            ("R1=QQ", 30),
            ("PR QQ", 30),
            ("EX QQ", 30),
            // A label cannot be set; an instruction cannot be set; a variable alone does nothing.
            ("P9=1000", 32),
            ("RS=1", 33),
            ("VM", 34),
            ("PR FD", 35),
            ("PR H", 35),
            // Lines for program mode only, or for a running program only.
            ("LB X1", 46),
            ("H", 40),
            ("H 100", 40),
            // Only allowed in programs (MC 5-6, 5-62).
            ("BR 1", 46),
            ("RT", 46),
            // I/O points that do not exist.
            ("S6=0,0", 10),
            ("S0=0,0,0", 10),
            ("O5=1", 10),
            ("O13=1", 10),
            ("S14=1", 10),
            // Unknown names, with any value.
            ("XX=4,K1", 20),
            ("XX 1 2", 20),
            // Read-only variables and instructions take no number.
            ("IV V", 25),
            ("IV AL", 25),
            ("IV H", 33),
            // Invalid program addresses.
            ("EX 500", 42),
            ("EX 2048", 42),
            ("EX 0", 42),
            ("L 2048", 42),
            ("CP 2048", 42),
            ("PG 2048", 42),
            ("PG 0", 42),
            // Homing without a configured home switch, and types of homing that do not exist.
            ("HM 1", 80),
            ("HI 5", 81),
            ("HI 0", 81),
            // Commands of the serial products only, and I/O that Ethernet models do not have.
            ("BD=96", 37),
            ("CK=1", 37),
            ("DG=0", 37),
            ("DN=\"A\"", 37),
            ("PY=1", 37),
            ("QD=1", 37),
            ("PR I9", 37),
            ("O9=1", 37),
            ("S9=0,0,0", 37),
            ("D9=1", 37),
            ("PR IH", 37),
            ("OH=1", 37),
            ("UG 2956102", 37),
            // Types that do not fit the point.
            ("S1=9,0,0", 8),
            ("S5=8,0", 8),
            ("O1=1", 9),
            ("RC=101", 21),
        ] {
            rig.refused(line, error);
        }
        rig.assert_no_error();
    }
}

/// MC 9.5: "Linear Overtemperature Error (For units without Internal Over Temp)". An MDrivePlus 23 is such a
/// unit (MC 5-38). The bridge is off until the drive has cooled and DE is written.
#[test]
fn too_much_heat_is_75_without_a_sensor() {
    let mut rig = Rig::plus();
    rig.set(&["RC=50", "SL 20000"]);
    rig.after(100.millis());
    rig.fault("over_temperature", true);
    rig.after(Duration::TICK);
    assert_eq!(rig.value("ER"), 75);
    assert_eq!(rig.motion().current_ma, 0, "the bridge");
    rig.set(&["SL 0"]);
    rig.wait_still(1.secs());
    // The drive is still hot.
    rig.set(&["DE=1", "SL 20000"]);
    rig.after(100.millis());
    assert_eq!(rig.motion().current_ma, 0);
    rig.fault("over_temperature", false);
    rig.after(100.millis());
    assert_eq!(rig.motion().current_ma, 0);
    rig.set(&["DE=1"]);
    rig.after(Duration::TICK);
    assert_eq!(rig.motion().current_ma, 1_500, "RC of 3 A");
    rig.assert_values(&[("ER", 0)]);
}

/// If the drive is still hot after a restart, it reports the error again.
#[test]
fn over_temperature_is_reported_again_after_a_restart() {
    let mut rig = Rig::plus();
    rig.fault("over_temperature", true);
    rig.after(Duration::TICK);
    assert_eq!(rig.value("ER"), 75);
    rig.key(&[0x03]);
    rig.after(START);
    rig.say("EM=2");
    rig.heard();
    assert_eq!(rig.value("ER"), 75);
}

/// Any use of a reserved name is an error.
#[test]
fn reserved_names_are_of_no_use() {
    let mut rig = Rig::plus();
    for line in ["AT", "AT=1", "FT", "FT=1", "PR AT", "I7=1", "PR I13"] {
        rig.say(line);
        assert_ne!(rig.value("ER"), 0, "{line}");
    }
}

#[test]
fn illegal_data_is_error_24() {
    let mut rig = Rig::plus();
    for line in ["VM=12X4", "MA 1000X", "R1=1.5", "R1=99999999999"] {
        rig.say(line);
        let error = rig.value("ER");
        assert!([21, 24].contains(&error), "{line}: {error}");
        rig.assert_values(&[("VM", 768_000), ("R1", 0), ("MV", 0)]);
    }
}

/// MC 5-38, 5-62, 9.5: these commands are refused while the motor moves.
#[test]
fn motion_forbids_saving_restoring_and_clearing() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        rig.set(&["MR 1000000"]);
        rig.after(500.millis());
        for (line, error) in [("S", 73), ("FD", 73), ("IP", 74), ("CP", 74)] {
            rig.refused(line, error);
        }
        assert_eq!(rig.try_write(0x0076, &[1]), Err(4));
        assert_eq!(rig.ef_er(), (1, 73));
        rig.wait_still(10.secs());
        assert_eq!(rig.long(0x0057), 1_000_000);
        rig.set(&["S"]);
        rig.after(100.millis());
        rig.set(&["IP", "CP"]);
    }
}

/// MC 5-38: IP restores the stored values.
#[test]
fn stored_values_come_back() {
    let mut rig = Rig::plus();
    rig.set(&["RC=50", "S1=16,1,0", "R1=3", "S"]);
    rig.after(100.millis());
    rig.set(&["RC=60", "S1=0,0,0", "R1=7", "HC=9", "IP"]);
    rig.assert_values(&[("RC", 50), ("R1", 3), ("HC", 5)]);
    assert_eq!(rig.show("S1"), "16, 1, 0");
}

#[test]
fn programs_end_where_they_go_wrong() {
    let mut rig = Rig::plus();
    for (lines, error) in [
        // The label or the address does not exist.
        ("LB G1\nBR ZZ\nR2=1\nE", 30),
        ("LB G1\nBR 700\nR2=1\nE", 42),
        // A subroutine that calls itself and never returns.
        ("LB G1\nR1=R1+1\nCL G1\nR2=1\nE", 43),
    ] {
        rig.set(&["CP", "R2=0"]);
        for line in ["PG 1"].into_iter().chain(lines.lines()).chain(["PG"]) {
            rig.say(line);
        }
        rig.say("ER=0");
        rig.say("EX 1");
        rig.after(1.secs());
        rig.assert_values(&[("BY", 0), ("ER", error), ("R2", 0)]);
    }
    // RT without a call.
    rig.set(&["CP"]);
    rig.program("PG 1\nRT\nR2=1\nE\nPG");
    rig.say("EX 1");
    rig.after(1.secs());
    let error = rig.value("ER");
    assert!([41, 43].contains(&error), "{error}");
    rig.assert_values(&[("BY", 0), ("R2", 0)]);
}

/// A program continues after errors that do not concern its flow.
#[test]
fn programs_go_on_after_a_refused_value() {
    let mut rig = Rig::plus();
    rig.program("PG 1\nRC=101\nO1=1\nTE=1\nR2=1\nE\nPG");
    rig.set(&["EX 1"]);
    rig.after(100.millis());
    rig.assert_values(&[("BY", 0), ("R2", 1), ("EF", 1), ("ER", 27)]);
}

/// MC 5-21: EF is cleared when a program starts.
#[test]
fn a_new_program_clears_the_error() {
    let mut rig = Rig::plus();
    rig.program("PG 1\nR1=EF\nE\nPG");
    rig.say("RC=101");
    rig.say("EX 1");
    rig.after(10.millis());
    rig.assert_values(&[("R1", 0), ("EF", 0)]);
}

/// Clock mode does not allow jogging (MC 9.6).
#[test]
fn clock_mode_has_no_jogging() {
    let mut rig = Rig::plus();
    rig.set(&["CM=1"]);
    rig.refused("JE=1", 87);
    assert_eq!(rig.try_write(0x003F, &[1]), Err(4));
    assert_eq!(rig.ef_er(), (1, 87));
}

/// Names of labels (MC 5-40).
#[test]
fn labels_are_new_names_of_two_characters() {
    let mut rig = Rig::plus();
    rig.set(&["VA Q1"]);
    for (place, line, error) in [
        ("PG 1", "LB VM", 29),
        ("PG 1", "LB Q1", 28),
        ("PG 50", "LB G1", 0),
        // "When you download a program over a program already saved" (MC 9.2, 28).
        ("PG 50", "LB G1", 28),
        ("PG 60", "LB G1", 28),
    ] {
        rig.say(place);
        rig.say(line);
        rig.say("PG");
        assert_eq!(rig.value("ER"), error, "{place}, {line}");
    }
}

/// FD, CP and OE 0 end OE (MC 5-52). An error in the handler itself does not end OE, and does not call the
/// handler again.
#[test]
fn a_handler_that_goes_wrong_is_called_once_for_each_error() {
    let mut rig = Rig::plus();
    rig.program("PG 1\nLB K1\nIC R2\nBR ZZ\nRT\nPG");
    rig.set(&["OE K1"]);
    for calls in 1..=3 {
        rig.say("XX");
        rig.after(1.secs());
        rig.assert_values(&[("R2", calls), ("ER", 30), ("BY", 0)]);
    }
    rig.set(&["OE 0"]);
    rig.refused("XX", 20);
    rig.assert_values(&[("R2", 3)]);
}

/// The free room depends only on the stored lines, not on how often they were typed (MC 9.3, 45).
#[test]
fn a_program_is_downloaded_again_and_again() {
    let mut rig = Rig::plus();
    for _ in 0..500 {
        for line in ["PG 2", "P=0", "MR 51200", "H", "PR \"Position = \",P", "H 2000", "MA 0", "H", "E", "PG"]
        {
            rig.say(line);
        }
    }
    rig.assert_values(&[("ER", 0)]);
    assert_eq!(rig.say("L 5"), "PR \"Position = \",P\r\nH 2000\r\nMA 0\r\nH\r\nE\r\n");
}
