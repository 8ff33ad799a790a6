//! Streams: the times of their records, the contents, and how they end.

use drivetwin_protocol::time::{Duration, Span};
use drivetwin_sim::bench::PinStimulus;
use drivetwin_sim::line::LineMode;

use crate::rig::{KINDS, Line, Rig, TICK, number};
use crate::saved::stamp;

/// Duration of a character, 8N1 at the factory's 230,400 baud: 10 / 230,400 s = 694.4 / 16 µs.
const CHARACTER: Duration = Duration::from_ticks(694);

/// Records of one register.
fn of<'a>(lines: &'a [Line], register: &str) -> Vec<&'a Line> {
    lines.iter().filter(|(_, text)| text.starts_with(&format!("s {register} "))).collect()
}

/// The data of a record.
fn data(line: &Line) -> u32 {
    u32::from_str_radix(&line.1[5..13], 16).expect("a record with data")
}

#[track_caller]
fn assert_consecutive(stamps: &[u64]) {
    for pair in stamps.windows(2) {
        assert_eq!(pair[1], pair[0] + 1, "a gap in {stamps:?}");
    }
}

/// 512 records/s for 10 s: one per tick, with that tick as its time stamp (QSB-11).
#[test]
fn ten_seconds_without_a_gap() {
    for kind in KINDS {
        let mut rig = Rig::ready(kind);
        rig.ask("W15F");
        rig.ask("W0C1");
        rig.past_tick(10_000);
        let start = rig.number();
        rig.ask("S0E");
        let heard = rig.hear(10.secs());
        let stamps: Vec<u64> = heard.iter().map(stamp).collect();
        assert_eq!(stamps.len(), 5_120);
        assert_eq!((stamps[0], stamps[5_119]), (start + 1, start + 5_120));
        assert_consecutive(&stamps);
        for (line, stamp) in heard.iter().zip(stamps) {
            assert_eq!(line.0, rig.power + TICK * stamp, "a record leaves at its tick");
        }
    }
}

/// Streams for ten seconds, with valid and invalid commands in between. Replies are sent between records, and
/// no record is lost.
#[test]
fn ten_seconds_with_commands_in_the_middle() {
    let mut rig = Rig::ready("qsb-m");
    rig.ask("W15F");
    rig.ask("W0C1");
    rig.past_tick(10_000);
    let start = rig.number();
    rig.ask("S0E");
    let mut heard = Vec::new();
    for n in 0..500_u64 {
        // Sends the command at different moments within a tick.
        heard.extend(rig.hear(20.millis() - Duration::from_ticks(n * 211 % 31_250)));
        let (command, reply) = match n % 5 {
            0 => ("R08", "r 08 000001F3 "),
            1 => ("QQQQQQQQQQQQQQQQQQQQQQQQQ", "x 00 00000000 "),
            2 => ("W1510", "e 15 00000010 "),
            3 => ("W\u{8}R0B", "r 0B 00000000 "),
            _ => ("\u{0}\u{ff}", "x 00 00000000 "),
        };
        let answer = rig.ask(command);
        assert!(answer.starts_with(reply), "{command} is answered {answer}");
    }
    heard.extend(rig.hear(5.millis()));
    let stamps: Vec<u64> = heard.iter().map(stamp).collect();
    assert_eq!(stamps[0], start + 1);
    assert!(stamps.len() > 4_000, "{}", stamps.len());
    assert_consecutive(&stamps);
}

/// A partial command whose rest arrives many records later.
#[test]
fn a_half_command_in_a_stream() {
    let mut rig = Rig::ready("qsb-m");
    rig.write("W0C1");
    rig.ask("S0E");
    rig.send("R0");
    assert_eq!(rig.hear(1.secs()).len(), 512);
    rig.says(&[("8", "r 08 000001F3 !")]);
    assert_eq!(rig.hear(1.secs()).len(), 512);
}

/// INTERVAL RATE n: a record at every nth tick.
#[test]
fn intervals() {
    for interval in [2_u64, 5, 100, 0x200] {
        let mut rig = Rig::ready("qsb-s");
        rig.ask("W15F");
        rig.ask(&format!("W0C{interval:X}"));
        rig.past_tick(20_000);
        let start = rig.number();
        rig.ask("S0E");
        let stamps: Vec<u64> = rig.hear(TICK * (interval * 8)).iter().map(stamp).collect();
        let expected: Vec<u64> = (1..=8).map(|n| start + n * interval).collect();
        assert_eq!(stamps, expected);
    }
}

/// W0D1 clears the time stamp but does not shift its ticks (QSB-10). Records continue at each tick.
#[test]
fn the_time_stamp_is_cleared_in_a_stream() {
    let mut rig = Rig::ready("qsb-s");
    rig.ask("W15F");
    rig.ask("W0C1");
    rig.past_tick(20_000);
    rig.ask("S0E");
    rig.hear(100.millis());
    rig.past_tick(28_000);
    rig.hear(Duration::ZERO);
    let cleared = rig.number();
    rig.ask("W0D1");
    let heard = rig.hear(1.secs());
    assert_eq!(heard.len(), 512);
    assert_eq!(stamp(&heard[0]), 1);
    for line in &heard {
        let tick = number(line.0, rig.power);
        assert_eq!(stamp(line), tick - cleared);
    }
    assert!(heard.iter().all(|line| line.0.since(rig.power).ticks() % TICK.ticks() == 0));
}

/// A second S command is answered at once, and the interval counts from then.
#[test]
fn a_stream_is_started_again() {
    let mut rig = Rig::ready("qsb-s");
    rig.ask("W15F");
    rig.ask("W0C8");
    rig.past_tick(100);
    let start = rig.number();
    rig.ask("S0E");
    let stamps: Vec<u64> = rig.hear(TICK * 12).iter().map(stamp).collect();
    assert_eq!(stamps, [start + 8]);
    rig.ask("S0E");
    let stamps: Vec<u64> = rig.hear(TICK * 17).iter().map(stamp).collect();
    assert_eq!(stamps, [start + 20, start + 28]);
}

/// INTERVAL RATE FFFF (the factory's) sends no records. Written during a stream, it pauses the stream. The
/// next interval counts from the last record (QSB-11).
#[test]
fn interval_ffff_pauses() {
    let mut rig = Rig::ready("qsb-s");
    rig.says(&[("S0E", "s 0E 00000000 !")]);
    assert_eq!(rig.texts(100.secs()), [""; 0]);

    let mut rig = Rig::ready("qsb-s");
    rig.ask("W15F");
    rig.ask("W0C4");
    rig.past_tick(100);
    let start = rig.number();
    rig.ask("S0E");
    let first = rig.hear(TICK * 9);
    assert_eq!(first.iter().map(stamp).collect::<Vec<_>>(), [start + 4, start + 8]);
    rig.ask("W0CFFFF");
    assert_eq!(rig.hear(TICK * 20).len(), 0);
    rig.ask("W0C40");
    let stamps: Vec<u64> = rig.hear(TICK * 110).iter().map(stamp).collect();
    assert_eq!(stamps, [start + 8 + 0x40, start + 8 + 0x80]);
}

/// THRESHOLD compares with the last value sent, in both directions. After a smaller change the drive compares
/// again an interval later.
#[test]
fn thresholds() {
    let mut rig = Rig::ready("qsb-s");
    for command in ["W0343", "W0C1", "W0B4"] {
        rig.write(command);
    }
    rig.says(&[("S0E", "s 0E 00000000 !")]);
    let mut after = |edges: i32| {
        rig.turn(edges);
        rig.texts(20.millis())
    };
    assert_eq!(after(3), [""; 0]);
    assert_eq!(after(1), ["s 0E 00000004 !"]);
    assert_eq!(after(-3), [""; 0]);
    assert_eq!(after(3), [""; 0]);
    // The reference is the last value sent, 4, not the first.
    assert_eq!(after(3), [""; 0]);
    assert_eq!(after(1), ["s 0E 00000008 !"]);
    assert_eq!(after(-12), ["s 0E FFFFFFFC !"]);
    assert_eq!(after(4), ["s 0E 00000000 !"]);
    assert_eq!(after(0), [""; 0]);
}

/// Across a wrap the difference is computed with 32 bits.
#[test]
fn threshold_ffff() {
    let mut rig = Rig::ready("qsb-s");
    for command in ["W0343", "W0C1", "W0BFFFF", "W08FFFFFF00", "W0A0"] {
        rig.write(command);
    }
    rig.says(&[("S0E", "s 0E FFFFFF00 !")]);
    rig.turn_at(0xFFFE, 4_000_000);
    assert_eq!(rig.texts(20.millis()), [""; 0]);
    rig.turn(1);
    assert_eq!(rig.texts(20.millis()), ["s 0E 0000FEFF !"]);
}

/// Threshold 0 sends every value at the interval.
#[test]
fn threshold_0_sends_what_has_not_changed() {
    let mut rig = Rig::ready("qsb-s");
    rig.write("W0C1");
    rig.ask("S0E");
    let heard = rig.hear(1.secs());
    assert_eq!(heard.len(), 512);
    assert!(heard.iter().all(|(_, text)| text == "s 0E 00000000 !"));
}

/// INTERVAL RATE 0 is a record every 100 µs, which no baud rate can carry: even at 256,000 baud 12 characters
/// take 469 µs. So records follow each other without a gap.
#[test]
fn the_fastest_rate() {
    for (format, characters) in [("W150", 12), ("W15B", 17), ("W15F", 26)] {
        let mut rig = Rig::ready_on("qsb-s", LineMode::Timed);
        rig.ask("W0C0");
        rig.ask(format);
        rig.after(10.millis());
        rig.ask("S0E");
        let heard = rig.hear(1.secs());
        for pair in heard.windows(2) {
            assert_eq!(pair[1].0.since(pair[0].0), CHARACTER * characters);
        }
        // The records fill a second without gaps, except for the reply to S0E.
        let expected = 16_000_000 / (694 * characters);
        assert!((expected - 2..=expected).contains(&(heard.len() as u64)), "{} of {expected}", heard.len());
    }
}

/// With a threshold the drive compares every 100 µs, so it sends a change within that time.
#[test]
fn interval_0_with_a_threshold() {
    let mut rig = Rig::ready("qsb-s");
    for command in ["W0343", "W0C0", "W0B1"] {
        rig.write(command);
    }
    rig.ask("S0E");
    for n in 1..=20_u64 {
        rig.hear(5.millis() + Duration::from_ticks(n * 333));
        let start = rig.now();
        rig.turn(1);
        let heard = rig.hear(2.millis());
        assert_eq!(heard.len(), 1);
        assert_eq!(data(&heard[0]), n as u32);
        let late = heard[0].0.since(start);
        assert!(late <= 102.micros(), "{late:?} after the edge");
    }
}

/// In analogue mode a measurement takes 200 µs.
#[test]
fn interval_0_with_a_threshold_analogue() {
    let mut rig = Rig::ready("qsb-s");
    for command in ["W0002", "W0C0", "W0B1"] {
        rig.write(command);
    }
    rig.drive("A", PinStimulus::Millivolts(0));
    rig.ask("S0E");
    let mut latest = Duration::ZERO;
    for n in 1..=40 {
        rig.hear(5.millis() + Duration::from_ticks(n * 333));
        let start = rig.now();
        rig.drive("A", PinStimulus::Millivolts(100 * n as i32));
        let heard = rig.hear(2.millis());
        assert_eq!(heard.len(), 1);
        assert_eq!(u64::from(data(&heard[0]) & 0xFFF), n * 100 * 1_024 / 5_000);
        latest = latest.max(heard[0].0.since(start));
    }
    assert!(latest > 150.micros() && latest <= 201.micros(), "{latest:?} at the latest");
}

/// "Multiple registers can be streamed simultaneously". Streams of 01, 05, 06 and 13 send changes at once
/// (QSB-12), with any interval.
#[test]
fn several_at_once() {
    let mut rig = Rig::ready("qsb-m");
    for command in ["W0343", "W04010"] {
        rig.write(command);
    }
    rig.says(&[
        ("S01", "s 01 0000000F !"),
        ("S05", "s 05 00000000 !"),
        ("S06", "s 06 0000000A !"),
        ("S0E", "s 0E 00000000 !"),
        ("S13", "s 13 00000001 !"),
    ]);
    assert_eq!(rig.texts(5.secs()), [""; 0]);
    rig.low("DIO3");
    assert_eq!(rig.texts(5.millis()), ["s 01 00000007 !"]);
    rig.high("DIO3");
    assert_eq!(rig.texts(5.millis()), ["s 01 0000000F !"]);
    rig.turn(4);
    // CNTR has counted from 0 to 4, which sets no flag.
    assert_eq!(rig.texts(5.millis()), [""; 0]);
    // The index captures 4 and sets its flag. The lower register is sent first.
    rig.high("I");
    assert_eq!(rig.texts(5.millis()), ["s 05 00000004 !", "s 06 0000001A !"]);
    rig.low("I");
    assert_eq!(rig.texts(5.millis()), [""; 0]);
    rig.says(&[("W093", "w 09 00000003 !")]);
    assert_eq!(rig.texts(5.millis()), ["s 06 0000000A !"]);
    rig.says(&[("W162", "w 16 00000002 !")]);
    // DIO1 and DIO2 now belong to the motor drive and are low.
    assert_eq!(rig.texts(5.millis()), ["s 01 00000009 !", "s 13 00000011 !"]);
    rig.says(&[("W0C2", "w 0C 00000002 !")]);
    let heard = rig.hear(1.secs());
    assert!((255..=257).contains(&heard.len()) && of(&heard, "0E").len() == heard.len(), "{heard:?}");
}

/// "A read of the register ends its stream". Other streams continue.
#[test]
fn a_read_ends_a_stream() {
    let mut rig = Rig::ready("qsb-m");
    for command in ["W0343", "W04010", "W0C1"] {
        rig.write(command);
    }
    for register in ["01", "05", "06", "0E", "13"] {
        rig.ask(&format!("S{register}"));
    }
    let script = [
        ("01", "r 01 0000000F !"),
        ("05", "r 05 00000000 !"),
        ("06", "r 06 0000000A !"),
        ("0E", "r 0E 00000000 !"),
        ("13", "r 13 00000001 !"),
    ];
    for (register, reply) in script {
        assert_eq!(rig.ask(&format!("R{register}")), reply);
        let left = rig.hear(10.millis());
        assert_eq!(left.is_empty(), register >= "0E", "after R{register}: {left:?}");
    }
    rig.low("DIO3");
    rig.turn(4);
    rig.high("I");
    rig.says(&[("W162", "w 16 00000002 !")]);
    assert_eq!(rig.texts(1.secs()), [""; 0]);
    // Reading 07 does not end the stream of 0E, though both show CNTR.
    rig.ask("S0E");
    rig.ask("R07");
    assert!(rig.hear(1.secs()).len() > 500);
}

/// Commands 0 and 1 end the streams of 0E, 01 and 13. Those of 05 and 06 continue (QSB-12).
#[test]
fn commands_0_and_1_end_three_streams() {
    for command in ["W161", "W160"] {
        let mut rig = Rig::ready("qsb-m");
        for setting in ["W0343", "W04010", "W0C1"] {
            rig.write(setting);
        }
        for register in ["01", "05", "06", "0E", "13"] {
            rig.ask(&format!("S{register}"));
        }
        rig.write(command);
        rig.hear(3.millis());
        rig.low("DIO3");
        rig.turn(4);
        rig.high("I");
        let heard = rig.texts(1.secs());
        assert_eq!(heard, ["s 05 00000004 !", "s 06 0000001A !"], "{command}");
    }
}

/// Command 1 exists on -D and -S, too.
#[test]
fn command_1_on_all() {
    for kind in KINDS {
        let mut rig = Rig::ready(kind);
        rig.write("W0C1");
        rig.ask("S0E");
        assert_eq!(rig.hear(1.secs()).len(), 512);
        rig.write("W161");
        rig.hear(2.millis());
        assert_eq!(rig.texts(1.secs()), [""; 0]);
    }
}

/// At 9,600 baud a record in format F takes 26 × 16,667 / 16 µs, nearly 14 ticks. The drive measures each
/// record when the previous one has been sent, and stamps it with the last tick before then (QSB-11).
#[test]
fn a_line_slower_than_the_stream() {
    let mut rig = Rig::ready_on("qsb-s", LineMode::Timed);
    rig.ask("W0343");
    rig.ask("W15F");
    rig.ask("W0C1");
    rig.ask("W1600A");
    rig.after(50.millis());
    rig.ask("S0E");
    let character = Duration::from_ticks(16_667);
    rig.hear(1.secs());
    rig.turn_at(100_000, 100_000);
    rig.hear(Duration::ZERO);
    let heard = rig.hear(10.secs());
    assert!(heard.len() > 350);
    let power = rig.power;
    // The first record started before the terminal read again.
    for pair in heard[1..].windows(2) {
        assert_eq!(pair[1].0.since(pair[0].0), character * 26);
        assert_eq!(stamp(&pair[1]), number(pair[1].0 - character, power));
        // The record has the current value, not an old one.
        assert_eq!(data(&pair[1]), 100_000);
    }
}

/// On a line that is slower than the stream, a reply replaces one record, because both have the same length.
/// The reply follows the record that is being sent.
#[test]
fn a_reply_on_a_line_slower_than_the_stream() {
    let mut rig = Rig::ready_on("qsb-s", LineMode::Timed);
    for command in ["W15F", "W0C1", "W1600A"] {
        rig.ask(command);
    }
    rig.after(50.millis());
    rig.ask("S0E");
    let record = Duration::from_ticks(26 * 16_667);
    rig.hear(record * 10);
    rig.send("R08\r");
    let heard = rig.texts(record * 10);
    let letters: String = heard.iter().map(|text| &text[..1]).collect();
    assert_eq!(letters, "srssssssss");
    assert!(heard[1].starts_with("r 08 000001F3 "));
}

/// A change that is undone while the line is busy is not sent. A value that still differs when the line is
/// free is sent.
#[test]
fn changes_while_the_line_is_busy() {
    let mut rig = Rig::ready_on("qsb-m", LineMode::Timed);
    rig.ask("W1600A");
    rig.after(50.millis());
    rig.send("S01\r");
    // 4 characters take 4.2 ms, the reply of 17 characters takes 17.7 ms.
    rig.after(6.millis());
    rig.low("DIO0");
    rig.after(2.millis());
    rig.high("DIO0");
    assert_eq!(rig.texts(50.millis()), ["s 01 0000000F !"]);
    rig.low("DIO1");
    rig.after(1.millis());
    rig.low("DIO2");
    rig.low("DIO3");
    assert_eq!(rig.texts(50.millis()), ["s 01 0000000D !", "s 01 00000001 !"]);
}
