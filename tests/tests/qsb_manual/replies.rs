//! Formats of replies, line ends, bad input, and resets.

use drivetwin_protocol::time::{Duration, Span};
use drivetwin_sim::bench::Setup;
use drivetwin_sim::line::LineMode;

use crate::rig::{Rig, START_UP, TICK};

/// Register 15: bit 0 is LF, 1 CR, 2 time stamp, 3 spaces. CR is sent before LF. The reply to a write of
/// register 15 already has the new format (QSB-5).
#[test]
fn all_formats() {
    const FORMATS: [(&str, &str, &str); 16] = [
        ("W150", "w1500000000!", "r0800ABCDEF!"),
        ("W151", "w1500000001!\n", "r0800ABCDEF!\n"),
        ("W152", "w1500000002!\r", "r0800ABCDEF!\r"),
        ("W153", "w1500000003!\r\n", "r0800ABCDEF!\r\n"),
        ("W154", "w1500000004@!", "r0800ABCDEF@!"),
        ("W155", "w1500000005@!\n", "r0800ABCDEF@!\n"),
        ("W156", "w1500000006@!\r", "r0800ABCDEF@!\r"),
        ("W157", "w1500000007@!\r\n", "r0800ABCDEF@!\r\n"),
        ("W158", "w 15 00000008 !", "r 08 00ABCDEF !"),
        ("W159", "w 15 00000009 !\n", "r 08 00ABCDEF !\n"),
        ("W15A", "w 15 0000000A !\r", "r 08 00ABCDEF !\r"),
        ("W15B", "w 15 0000000B !\r\n", "r 08 00ABCDEF !\r\n"),
        ("W15C", "w 15 0000000C @ !", "r 08 00ABCDEF @ !"),
        ("W15D", "w 15 0000000D @ !\n", "r 08 00ABCDEF @ !\n"),
        ("W15E", "w 15 0000000E @ !\r", "r 08 00ABCDEF @ !\r"),
        ("W15F", "w 15 0000000F @ !\r\n", "r 08 00ABCDEF @ !\r\n"),
    ];
    let mut rig = Rig::ready("qsb-d");
    rig.write("W08ABCDEF");
    rig.raw(5.millis());
    for (format, written, read) in FORMATS {
        for (command, reply) in [(format, written), ("R08", read)] {
            rig.past_tick(50);
            let stamp = format!("{:08X}", rig.number());
            rig.send(&format!("{command}\r"));
            assert_eq!(rig.raw(TICK * 3), reply.replace('@', &stamp), "to {command} after {format}");
        }
    }
}

/// Error replies have the format of register 15, too (QSB-5).
#[test]
fn formats_apply_to_errors_too() {
    let mut rig = Rig::ready("qsb-d");
    rig.ask("W15F");
    rig.past_tick(50);
    let stamp = rig.number();
    assert_eq!(rig.ask("W1510"), format!("e 15 00000010 {stamp:08X} !"));
    rig.past_tick(50);
    let stamp = rig.number();
    assert_eq!(rig.ask("R09"), format!("x 09 00000000 {stamp:08X} !"));
    rig.ask("W154");
    rig.past_tick(50);
    let stamp = rig.number();
    assert_eq!(rig.ask("S01"), format!("s010000000F{stamp:08X}!"));
    rig.past_tick(50);
    let stamp = rig.number();
    assert_eq!(rig.ask("Q"), format!("x0000000000{stamp:08X}!"));
}

/// "The command termination is any single or dual combination of CR and LF"; an empty line is ignored
/// (QSB-1).
#[test]
fn line_ends() {
    for end in ["\r", "\n", "\r\n", "\n\r", "\r\r", "\n\n", "\r\n\r\n\n\r\r"] {
        let mut rig = Rig::ready("qsb-d");
        rig.send(&format!("R08{end}R0B{end}R15{end}"));
        let replies = ["r 08 000001F3 !", "r 0B 00000000 !", "r 15 0000000B !"];
        assert_eq!(rig.texts(20.millis()), replies, "{end:?}");
    }
    let mut rig = Rig::ready("qsb-d");
    rig.send("\r\n\n\r\r\r\n");
    assert_eq!(rig.texts(20.millis()), [""; 0]);
}

/// QSB-2: a line that is not understood gets one `x`, with the register as typed if that is two hex digits.
#[test]
fn lines_that_are_not_understood() {
    let mut rig = Rig::ready("qsb-m");
    rig.says(&[
        ("r0E", "x 0E 00000000 !"),
        ("w080", "x 08 00000000 !"),
        ("X0e", "x 0E 00000000 !"),
        ("?", "x 00 00000000 !"),
        ("R", "x 00 00000000 !"),
        ("R0", "x 00 00000000 !"),
        ("R0G", "x 00 00000000 !"),
        ("RG0", "x 00 00000000 !"),
        ("R 0E", "x 00 00000000 !"),
        (" R0E", "x 00 00000000 !"),
        ("R0E ", "x 0E 00000000 !"),
        ("R0E1", "x 0E 00000000 !"),
        ("S0E1", "x 0E 00000000 !"),
        ("W08", "x 08 00000000 !"),
        ("W08 1", "x 08 00000000 !"),
        ("W08G", "x 08 00000000 !"),
        ("W08-1", "x 08 00000000 !"),
        ("W080x1", "x 08 00000000 !"),
        ("W08123456789", "x 08 00000000 !"),
        ("W08000000001", "x 08 00000000 !"),
        ("Rff", "x FF 00000000 !"),
        ("Wab1", "x AB 00000000 !"),
        // Nothing was written, and no stream was started.
        ("R08", "r 08 000001F3 !"),
    ]);
    assert_eq!(rig.texts(20.millis()), [""; 0]);
}

/// A line of more than 16 characters gets one `x`, however long it is.
#[test]
fn lines_that_are_too_long() {
    let mut rig = Rig::ready("qsb-m");
    let long = "Q".repeat(10_000);
    rig.says(&[
        ("QQQQQQQQQQQQQQQQ", "x 00 00000000 !"),
        ("QQQQQQQQQQQQQQQQQ", "x 00 00000000 !"),
        ("W0800000000000005", "x 08 00000000 !"),
        ("W08000000000000005", "x 08 00000000 !"),
        (&long, "x 00 00000000 !"),
        ("R08", "r 08 000001F3 !"),
    ]);
    assert_eq!(rig.texts(20.millis()), [""; 0]);
}

/// "A backspace character will erase a partially entered command", all of it (QSB-1).
#[test]
fn backspace() {
    let mut rig = Rig::ready("qsb-m");
    let long = "W08".repeat(10) + "\u{8}R0B";
    rig.says(&[
        ("W0\u{8}R08", "r 08 000001F3 !"),
        ("W085\u{8}\u{8}R08", "r 08 000001F3 !"),
        ("\u{8}R08", "r 08 000001F3 !"),
        (&long, "r 0B 00000000 !"),
        // DEL is not a backspace.
        ("W0\u{7f}R08", "x 00 00000000 !"),
    ]);
    // After a backspace the line is empty.
    rig.send("W085\u{8}\r");
    assert_eq!(rig.texts(20.millis()), [""; 0]);
}

/// Each line of noise gets one `x`. Lines of only CR, LF and backspaces get none.
#[test]
fn noise() {
    let mut rig = Rig::ready("qsb-m");
    let mut state = 1_u32;
    let (mut lines, mut open) = (0, false);
    for _ in 0..20_000 {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let byte = (state >> 24) as u8;
        // A line without these letters is never understood.
        if matches!(byte, b'R' | b'W' | b'S') {
            continue;
        }
        rig.send_bytes(&[byte]);
        match byte {
            b'\r' | b'\n' => {
                lines += usize::from(open);
                open = false;
            }
            8 => open = false,
            _ => open = true,
        }
    }
    rig.send("\u{8}\r");
    let heard = rig.texts(10.secs());
    assert_eq!(heard.len(), lines);
    assert!(lines > 50 && heard.iter().all(|text| text.starts_with("x ") && text.ends_with(" 00000000 !")));
    rig.says(&[("R08", "r 08 000001F3 !")]);
}

/// A command may arrive in pieces, with any time between them.
#[test]
fn half_commands_wait() {
    let mut rig = Rig::ready("qsb-m");
    for piece in ["W", "0", "85", "5"] {
        rig.send(piece);
        assert_eq!(rig.texts(10.secs()), [""; 0]);
    }
    rig.says(&[("", "w 08 00000055 !")]);
}

/// QSB-6: the banner is the type, two spaces, firmware 0E, CR and LF, 50 ms after power-on.
#[test]
fn banner() {
    for (kind, banner) in
        [("qsb-d", "QSB-D  0E!\r\n"), ("qsb-m", "QSB-M  0E!\r\n"), ("qsb-s", "QSB-S  0E!\r\n")]
    {
        let mut rig = Rig::new(kind, LineMode::Fast, Setup::default());
        assert_eq!(rig.raw(START_UP - Duration::TICK), "");
        assert_eq!(rig.raw(Duration::TICK), banner);
        let setup = Setup { boot_fast: true, ..Setup::default() };
        let mut rig = Rig::new(kind, LineMode::Fast, setup);
        assert_eq!(rig.raw(Duration::TICK), banner);
    }
}

/// QSB-5: the banner does not depend on register 15.
#[test]
fn banner_in_any_format() {
    let mut rig = Rig::ready("qsb-d");
    rig.write("W15C");
    rig.save_in_any_format();
    rig.power_cycle();
    assert_eq!(rig.raw(START_UP + TICK), "QSB-D  0E!\r\n");
}

/// Characters before the banner are lost.
#[test]
fn characters_during_the_start_are_lost() {
    let mut rig = Rig::new("qsb-d", LineMode::Fast, Setup::default());
    rig.after(10.millis());
    rig.send("R08\rR0");
    rig.until_banner("qsb-d");
    assert_eq!(rig.texts(20.millis()), [""; 0]);
    rig.says(&[("8", "x 00 00000000 !"), ("R08", "r 08 000001F3 !")]);
}

/// A rising DTR resets the drive like power-on and drops a partial line (QSB-6). A falling DTR has no effect.
#[test]
fn reset_by_dtr() {
    let mut rig = Rig::ready("qsb-m");
    rig.write("W0B5");
    rig.write("W02F00");
    rig.write("W010");
    rig.write("W0343");
    rig.turn(40);
    rig.after(1.secs());
    rig.bench.attach(rig.bus, false);
    rig.says(&[("R0B", "r 0B 00000005 !")]);
    rig.send("W08");
    rig.after(5.millis());
    let pressed = rig.now();
    rig.bench.attach(rig.bus, true);
    let heard = rig.hear(60.millis());
    rig.take_banner(heard, "qsb-m");
    assert!(rig.power.since(pressed) <= Duration::TICK, "50 ms after the rise");
    assert!(rig.is_high("DIO0"));
    rig.says(&[
        ("R0B", "r 0B 00000000 !"),
        ("R02", "r 02 00000000 !"),
        ("R0E", "r 0E 00000000 !"),
        ("R03", "r 03 0000004F !"),
        ("R06", "r 06 0000000A !"),
        ("5", "x 00 00000000 !"),
    ]);
    rig.assert_time_stamp(0);
}

/// Several commands at once: each gets its reply, in order.
#[test]
fn many_commands_in_one_write() {
    let mut rig = Rig::ready("qsb-m");
    let commands: String = (0..500).map(|n| format!("W08{n:X}\rR08\n")).collect();
    rig.send(&commands);
    let expected: Vec<String> =
        (0..500).flat_map(|n| [format!("w 08 {n:08X} !"), format!("r 08 {n:08X} !")]).collect();
    assert_eq!(rig.texts(5.secs()), expected);
}
