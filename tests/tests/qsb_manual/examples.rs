//! Every example command of both manuals, with its reply in the factory's format (15 = 0B: spaces, CR and
//! LF).

use drivetwin_protocol::time::Span;

use crate::rig::{KINDS, Rig};

/// The examples of the command list that every variant has, in its order. Three are corrected: two are
/// printed with the letter O for a zero (ROB, SOE), and one with another register than its own text names
/// (W0A1).
const LIST: [(&str, &str); 15] = [
    ("W0001", "w 00 00000001 !"),
    ("W0363", "w 03 00000063 !"),
    ("W04000", "w 04 00000000 !"),
    ("R05", "r 05 00000000 !"),
    ("R06", "r 06 0000000A !"),
    ("R07", "r 07 00000000 !"),
    ("W081F3", "w 08 000001F3 !"),
    ("W092", "w 09 00000002 !"),
    ("W0A1", "w 0A 00000001 !"),
    ("R0B", "r 0B 00000000 !"),
    ("W0C5", "w 0C 00000005 !"),
    ("W0D1", "w 0D 00000001 !"),
    ("S0E", "s 0E 00000000 !"),
    ("W163", "w 16 00000003 !"),
    ("W1660A", "w 16 0000060A !"),
];

/// Examples of registers 01 and 02, for the -D and the -M.
const PORT: [(&str, &str); 2] = [("S01", "s 01 0000000F !"), ("W02F00", "w 02 00000F00 !")];

/// Examples of registers 0F to 13, for the -M.
const MOTOR: [(&str, &str); 5] = [
    ("W0F3E8", "w 0F 000003E8 !"),
    ("W10186A0", "w 10 000186A0 !"),
    ("W117D0", "w 11 000007D0 !"),
    ("W123E8", "w 12 000003E8 !"),
    ("R13", "r 13 00000001 !"),
];

/// The application examples that every variant has, with their numbers.
const APPLICATION: [(&str, &str); 21] = [
    ("W0000", "w 00 00000000 !"),   // 1.1
    ("W04000", "w 04 00000000 !"),  // 1.2
    ("W04100", "w 04 00000100 !"),  // 1.2
    ("W0363", "w 03 00000063 !"),   // 1.3
    ("W034F", "w 03 0000004F !"),   // 1.4
    ("W081F3", "w 08 000001F3 !"),  // 1.5
    ("R0E", "r 0E 00000000 !"),     // 1.6
    ("W0002", "w 00 00000002 !"),   // 2.1
    ("W0001", "w 00 00000001 !"),   // 3.1
    ("R0E", "r 0E 00000000 !"),     // 3.2, here without a PWM encoder
    ("R00", "r 00 00000001 !"),     // 3.3
    ("W0000", "w 00 00000000 !"),   // back to 1.1
    ("S0E", "s 0E 00000000 !"),     // 4.1
    ("W0B0001", "w 0B 00000001 !"), // 4.2
    ("W0C0005", "w 0C 00000005 !"), // 4.3
    ("W04010", "w 04 00000010 !"),  // 5.2
    ("R05", "r 05 00000000 !"),     // 5.3
    ("W163", "w 16 00000003 !"),    // 9
    ("W1660A", "w 16 0000060A !"),  // 10.1
    ("W1640A", "w 16 0000040A !"),  // 10.2
    ("W1600A", "w 16 0000000A !"),  // 10.3
];

#[test]
fn the_examples_of_the_command_list() {
    for kind in KINDS {
        let mut rig = Rig::ready(kind);
        rig.says(&LIST);
        for (script, has) in [(&PORT[..], kind != "qsb-s"), (&MOTOR[..], kind == "qsb-m")] {
            for (command, reply) in script {
                let unsupported = format!("x {} 00000000 !", &command[1..3]);
                assert_eq!(rig.ask(command), if has { *reply } else { &unsupported }, "{kind}: {command}");
            }
        }
    }
}

/// Register 14: five digits of the serial number, one of the product, and two of the firmware, which is 0E
/// (QSB-6).
#[test]
fn the_example_of_version() {
    Rig::ready("qsb-d").says(&[("R14", "r 14 0000100E !")]);
    Rig::ready("qsb-m").says(&[("R14", "r 14 0000110E !")]);
    Rig::ready("qsb-s").says(&[("R14", "r 14 0000120E !")]);
}

#[test]
fn the_application_examples_that_all_have() {
    for kind in KINDS {
        Rig::ready(kind).says(&APPLICATION);
    }
}

/// Examples 5.1 and 6.1 to 6.5 on the four pins of a -M.
#[test]
fn the_application_examples_of_the_digital_port() {
    Rig::ready("qsb-m").says(&[
        ("W02011", "w 02 00000011 !"), // 5.1
        ("W02000", "w 02 00000000 !"), // 6.1
        ("R01", "r 01 0000000F !"),    // 6.3
        ("W02F00", "w 02 00000F00 !"), // 6.2
        ("W01A", "w 01 0000000A !"),   // 6.4
        ("R01", "r 01 0000000A !"),
        ("S01", "s 01 0000000A !"), // 6.5
    ]);
    // A -D has one pin. The other bits read 1 (QSB-23).
    Rig::ready("qsb-d").says(&[
        ("W02011", "w 02 00000011 !"),
        ("W02F00", "w 02 00000F00 !"),
        ("W01A", "w 01 0000000A !"),
        ("R01", "r 01 0000000E !"),
        ("S01", "s 01 0000000E !"),
    ]);
    Rig::ready("qsb-s").says(&[
        ("W02011", "x 02 00000000 !"),
        ("W02F00", "x 02 00000000 !"),
        ("R01", "x 01 00000000 !"),
        ("W01A", "x 01 00000000 !"),
        ("S01", "x 01 00000000 !"),
    ]);
}

/// Examples 8.1 to 8.4 and 7.1 to 7.4 on a -M: first a jog, then a move.
#[test]
fn the_application_examples_of_the_motor() {
    let mut rig = Rig::ready("qsb-m");
    rig.says(&[
        ("W0F3E8", "w 0F 000003E8 !"),   // 8.1
        ("W10186A0", "w 10 000186A0 !"), // 8.2
        ("W117D0", "w 11 000007D0 !"),   // 8.3
        ("W123E8", "w 12 000003E8 !"),   // 8.4
        ("W162", "w 16 00000002 !"),     // 7.1
        ("W169", "w 16 00000009 !"),     // 7.2
    ]);
    rig.after(500.millis());
    assert!(rig.position() > 400, "1,000 steps/s for half a second: {}", rig.position());
    rig.says(&[("W164", "w 16 00000004 !")]);
    rig.after(100.millis());
    let stands = rig.position();
    rig.says(&[("W168", "w 16 00000008 !")]); // 7.3
    rig.after(3.secs());
    assert_eq!(rig.position() - stands, 2_000);
    rig.says(&[("W160", "w 16 00000000 !"), ("R13", "r 13 00000001 !")]); // 7.4
}

/// Motor commands on variants without a motor: their registers are unsupported, and COMMAND refuses their
/// numbers (QSB-2).
#[test]
fn the_application_examples_of_the_motor_where_there_is_none() {
    for kind in ["qsb-d", "qsb-s"] {
        Rig::ready(kind).says(&[
            ("W0F3E8", "x 0F 00000000 !"),
            ("W10186A0", "x 10 00000000 !"),
            ("W117D0", "x 11 00000000 !"),
            ("W123E8", "x 12 00000000 !"),
            ("R13", "x 13 00000000 !"),
            ("S13", "x 13 00000000 !"),
            ("W162", "e 16 00000002 !"),
            ("W169", "e 16 00000009 !"),
            ("W168", "e 16 00000008 !"),
            ("W160", "e 16 00000000 !"),
        ]);
    }
}

/// Example 9.1, and the same example at register 15.
#[test]
fn the_example_of_formatting() {
    for kind in KINDS {
        let mut rig = Rig::ready(kind);
        rig.past_tick(100);
        let stamp = rig.number();
        assert_eq!(rig.ask("W15F"), format!("w 15 0000000F {stamp:08X} !"));
    }
}

/// Example 11.1 works on our firmware, 0E: a preset while counting down reads back as it was written.
#[test]
fn the_example_of_a_preset_under_count_down() {
    let mut rig = Rig::ready("qsb-s");
    rig.says(&[
        ("W0343", "w 03 00000043 !"),
        ("W04100", "w 04 00000100 !"),
        ("W0812345678", "w 08 12345678 !"),
        ("W0A0", "w 0A 00000000 !"),
        ("R0E", "r 0E 12345678 !"),
        // The procedure of the example.
        ("W04000", "w 04 00000000 !"),
        ("W08000003E8", "w 08 000003E8 !"),
        ("W0A0", "w 0A 00000000 !"),
        ("W08000001F3", "w 08 000001F3 !"),
        ("W04100", "w 04 00000100 !"),
        ("R0E", "r 0E 000003E8 !"),
    ]);
    rig.turn(8);
    rig.says(&[("R0E", "r 0E 000003E0 !")]);
}
