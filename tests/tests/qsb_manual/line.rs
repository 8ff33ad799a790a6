//! Baud rates, on a line with real character times.

use drivetwin_protocol::time::{Duration, Span};
use drivetwin_sim::line::LineMode;

use crate::rig::{KINDS, Rig, START_UP, TICK};

/// Each command A, its baud rate, and the reply to it.
const RATES: [(&str, u32, &str); 8] = [
    ("W1600A", 9_600, "w 16 0000000A !"),
    ("W1610A", 19_200, "w 16 0000010A !"),
    ("W1620A", 38_400, "w 16 0000020A !"),
    ("W1630A", 56_000, "w 16 0000030A !"),
    ("W1640A", 115_200, "w 16 0000040A !"),
    ("W1650A", 128_000, "w 16 0000050A !"),
    ("W1660A", 230_400, "w 16 0000060A !"),
    ("W1670A", 256_000, "w 16 0000070A !"),
];

/// Time longer than 17 characters at 9,600 baud.
const REPLY: Duration = Duration::millis(20);

/// Duration of a start bit, eight data bits and a stop bit, rounded to 1/16 µs.
fn character(baud: u32) -> Duration {
    Duration::from_ticks((160_000_000 + u64::from(baud) / 2) / u64::from(baud))
}

/// 230,400 baud, 8N1. The reply starts as soon as the CR is received.
#[test]
fn the_factory_rate() {
    let mut rig = Rig::ready_on("qsb-d", LineMode::Timed);
    assert_eq!(rig.bench.line(rig.bus).baud, 230_400);
    rig.after(10.millis());
    let start = rig.now();
    rig.send("R08\r");
    let heard = rig.hear(REPLY);
    assert_eq!(heard[0].1, "r 08 000001F3 !");
    assert_eq!(heard[0].0.since(start), character(230_400) * 5);
}

/// Each rate: the reply still has the old rate, later characters have the new one. A power cycle keeps the
/// new rate.
#[test]
fn every_rate() {
    for kind in KINDS {
        for (command, baud, reply) in RATES {
            let mut rig = Rig::ready_on(kind, LineMode::Timed);
            rig.after(10.millis());
            let start = rig.now();
            rig.send_at(230_400, &format!("{command}\r"));
            // The command, the reply, and a part of a character more.
            rig.bench.run_until(start + character(230_400) * (7 + 15));
            let heard = rig.hear(Duration::ZERO);
            assert_eq!(heard.last().map(|line| line.1.as_str()), Some(reply), "at the old rate");
            rig.after(REPLY);
            assert_eq!(rig.bench.line(rig.bus).baud, baud);
            for _ in 0..2 {
                let start = rig.now();
                rig.send_at(baud, "R08\r");
                let heard = rig.hear(REPLY * 2);
                assert_eq!(heard[0].1, "r 08 000001F3 !");
                assert_eq!(heard[0].0.since(start), character(baud) * 5);
                rig.power_cycle();
                let heard = rig.hear(START_UP + REPLY);
                assert_eq!(heard[0].1, format!("{}  0E!", kind.to_uppercase()));
                assert_eq!(rig.bench.line(rig.bus).baud, baud);
            }
        }
    }
}

/// QSB-7: a change of the rate saves only the rate. Values that were saved before stay saved.
#[test]
fn only_the_rate_is_saved() {
    let mut rig = Rig::ready("qsb-m");
    rig.write("W0B5");
    rig.save();
    for command in ["W0B7", "W0C9", "W02F00"] {
        rig.write(command);
    }
    rig.write("W1640A");
    // The present values do not change either.
    rig.says(&[("R0B", "r 0B 00000007 !")]);
    rig.after(100.millis());
    rig.restart("qsb-m");
    assert_eq!(rig.bench.line(rig.bus).baud, 115_200);
    rig.says(&[("R0B", "r 0B 00000005 !"), ("R0C", "r 0C 0000FFFF !"), ("R02", "r 02 00000000 !")]);
    // A save of the parameters does not change the rate.
    rig.write("W0B8");
    rig.save();
    rig.restart("qsb-m");
    assert_eq!(rig.bench.line(rig.bus).baud, 115_200);
    rig.says(&[("R0B", "r 0B 00000008 !")]);
}

/// A refused rate changes nothing.
#[test]
fn a_rate_that_does_not_exist() {
    let mut rig = Rig::ready("qsb-s");
    for (command, reply) in
        [("W1680A", "e 16 0000080A !"), ("W16F0A", "e 16 00000F0A !"), ("W1610A0A", "e 16 00010A0A !")]
    {
        rig.says(&[(command, reply)]);
        assert_eq!(rig.bench.line(rig.bus).baud, 230_400);
    }
}

/// The drive cannot read characters at another rate. When it has read the end of a line that contains such
/// characters, it answers `x`.
#[test]
fn characters_at_another_rate() {
    let mut rig = Rig::ready_on("qsb-d", LineMode::Timed);
    rig.after(10.millis());
    rig.send_at(9_600, "R08\r");
    assert_eq!(rig.texts(REPLY), [""; 0]);
    rig.send_at(230_400, "R08\r");
    assert_eq!(rig.texts(REPLY).len(), 1);
    rig.send_at(230_400, "R08\r");
    assert_eq!(rig.texts(REPLY), ["r 08 000001F3 !"]);
    // One character at another rate, in the middle of a command.
    rig.send_at(230_400, "R0");
    rig.after(1.millis());
    rig.send_at(9_600, "8");
    rig.after(2.millis());
    rig.send_at(230_400, "8\r");
    assert_eq!(rig.texts(REPLY).iter().map(|text| &text[..1]).collect::<String>(), "x");
    // A backspace removes the unreadable character.
    rig.send_at(9_600, "W");
    rig.after(2.millis());
    rig.send_at(230_400, "\u{8}R08\r");
    assert_eq!(rig.texts(REPLY), ["r 08 000001F3 !"]);
}

/// QSB-6: a reset by DTR does not cut off replies that the drive has begun to send.
#[test]
fn a_reset_cuts_no_answer() {
    let mut rig = Rig::ready_on("qsb-d", LineMode::Timed);
    rig.send("R08\rR0B\r");
    // The drive is sending the first answer.
    rig.after(character(230_400) * 11);
    rig.bench.attach(rig.bus, true);
    assert_eq!(rig.texts(START_UP * 2), ["r 08 000001F3 !", "r 0B 00000000 !", "QSB-D  0E!"]);
}

/// A stream with a record per tick for a second, on a line with character times. The line is full duplex, so
/// the drive receives commands in that time.
#[test]
fn both_ways_at_once() {
    let mut rig = Rig::ready_on("qsb-m", LineMode::Timed);
    rig.write("W0C1");
    rig.ask("S0E");
    rig.hear(TICK * 3);
    rig.send("R08\rR15\rR0B\rQ\r");
    let heard = rig.texts(1.secs());
    let replies: Vec<&str> = heard.iter().map(String::as_str).filter(|text| !text.starts_with('s')).collect();
    assert_eq!(replies, ["r 08 000001F3 !", "r 15 0000000B !", "r 0B 00000000 !", "x 00 00000000 !"]);
    assert!((511..=513).contains(&(heard.len() - 4)), "{}", heard.len() - 4);
}
