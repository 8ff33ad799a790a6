//! A QSB: edges counted by interrupts, a full-duplex line, and a motor on pins of the digital port.

use crate::image_of;
use crate::play::{Drive, MS, Nanos, OutputRecord, Run, Script};

/// Pins A, B, I and DTR; DIO1 and DIO2, which are STEP and DIR of the motor drive.
const A: u8 = 5;
const B: u8 = 6;
const I: u8 = 7;
const DTR: u8 = 8;
const DIO1: u8 = 3;
const DIO2: u8 = 4;

/// Time of the first command. Before, the board copies itself to RAM and sends its banner.
const START: Nanos = 40 * MS;
/// Time longer than a command and its reply.
const TURN: Nanos = 3 * MS;
/// Duration of a character at 230,400 8N1.
const CHARACTER: Nanos = 10_000_000_000 / 230_400;

/// Sends lines one after the other, starting at `at`; returns the instant at which all are answered.
fn say(script: &mut Script, mut at: Nanos, lines: &[&str]) -> Nanos {
    for line in lines {
        script.hear(at, format!("{line}\r").as_bytes());
        at += TURN;
    }
    at
}

/// Drives pins to `levels`, repeatedly in this order: `edges` levels in all, at `rate` per second. Returns
/// the instant of the end.
fn edges(script: &mut Script, mut at: Nanos, levels: &[(u8, &str)], edges: usize, rate: u64) -> Nanos {
    for (pin, level) in levels.iter().cycle().take(edges) {
        script.at(at, format_args!("pin {pin} {level}"));
        at += 1_000 * MS / rate;
    }
    at
}

/// Lines that the drive sends between `from` and `to`.
fn said(run: &Run, from: Nanos, to: Nanos) -> Vec<String> {
    let text = String::from_utf8(run.sent(from, to).1).expect("it says ASCII");
    assert!(text.is_empty() || text.ends_with("\r\n"), "{text:?}");
    text.lines().map(str::to_owned).collect()
}

/// Plays a script to the image of a QSB-M until `end`.
fn play(script: &Script, end: Nanos) -> Run {
    script.play(&image_of("qsb-m"), end)
}

/// A cycle in which A changes before B, starting from both high: counts up.
const UP: [(u8, &str); 4] = [(A, "low"), (B, "low"), (A, "high"), (B, "high")];
/// A cycle in which B changes before A: counts down.
const DOWN: [(u8, &str); 4] = [(B, "low"), (A, "low"), (B, "high"), (A, "high")];

/// Reply to R0E after `count` edges of `cycle` at `rate` per second, in x4, free-running. The lines of
/// `before` are sent first.
fn counted(before: &[&str], cycle: &[(u8, &str)], count: usize, rate: u64) -> String {
    let mut script = Script::fast();
    let begin = say(&mut script, START, &["W0303"]);
    let begin = say(&mut script, begin, before);
    let over = edges(&mut script, begin, cycle, count, rate) + 5 * MS;
    // A read ends a stream, but a record may already be on its way.
    let asked = say(&mut script, over, &["R0E"]);
    let end = say(&mut script, asked, &["R0E"]);
    let run = play(&script, end);
    said(&run, asked, end).concat()
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn edges_at_the_promised_rate_are_all_counted() {
    // The rates are those of firmware/boards/rp2040/README.md. A board that is 3 % too slow loses some of so
    // many edges, because its queue has room for only 256.
    const EDGES: usize = 10_000;
    assert_eq!(counted(&[], &UP, EDGES, 70_000), "r 0E 00002710 !");
    assert_eq!(counted(&[], &DOWN, EDGES, 70_000), "r 0E FFFFD8F0 !");
    // The drive counts all edges also while it streams 512 values a second.
    assert_eq!(counted(&["W0C1", "S0E"], &UP, EDGES, 60_000), "r 0E 00002710 !");
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn the_index_clears_the_count() {
    let mut script = Script::fast();
    // x4, free-running; an asynchronous index clears CNTR (MDR0 B5:4 = 10).
    let begin = say(&mut script, START, &["W0323"]);
    let over = edges(&mut script, begin, &UP, 10, 10_000);
    let over = edges(&mut script, over, &[(I, "high"), (I, "low")], 2, 10_000);
    let over = edges(&mut script, over, &[(A, "high"), (B, "high"), (A, "low")], 3, 10_000);
    let end = say(&mut script, over, &["R0E"]);
    let run = play(&script, end);
    assert_eq!(said(&run, over, end), ["r 0E 00000003 !"]);
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn it_receives_while_it_sends_and_answers_a_burst_back_to_back() {
    const COMMANDS: usize = 60;
    let mut script = Script::fast();
    script.hear(START, "R14\r".repeat(COMMANDS).as_bytes());
    let end = START + 60 * MS;
    let run = play(&script, end);
    assert_eq!(said(&run, START, end), ["r 14 0000110E !"; COMMANDS]);
    let all = COMMANDS * "r 14 0000110E !\r\n".len();
    let times: Vec<Nanos> = run.times_sent(START, end);
    let span = times[all - 1] - times[0];
    let least = (all - 1) as Nanos * CHARACTER;
    // The rounded divisor of the UART makes the line faster by about one part in a thousand. All pauses
    // together are shorter than a character.
    assert!(span > least - least / 500 && span < least + CHARACTER, "{span} ns, not {least}");
    assert!(run.edges(2, Drive::High).is_empty(), "there is no transceiver to turn around");
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn a_stream_that_never_pauses_never_falls_behind() {
    let mut script = Script::fast();
    // The stream is as fast as possible, for 3 s.
    say(&mut script, START, &["W0C0", "S0E"]);
    let asked = START + 3_000 * MS;
    script.hear(asked, b"R0E\r");
    let end = asked + 10 * MS;
    let run = play(&script, end);
    let answers = said(&run, START, end);
    let records = answers.iter().filter(|line| line.starts_with("s 0E ")).count();
    println!("{records} records in 3 s");
    // A record of 17 characters takes 0.738 ms.
    assert!(records > 4_000, "{records} records");
    assert_eq!(answers.last().map(String::as_str), Some("r 0E 00000000 !"));
    // The rest of the command, of a record, and the reply. Suppose the UART had the exact character times of
    // 230,400 baud instead of those that the drive computes in ticks. Then the reply would be 2 ms late by
    // now.
    let patience = (3 + 17 + 17) * CHARACTER + MS / 10;
    assert!(run.sent(asked + patience, end).1.is_empty(), "the answer is late");
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn the_motor_takes_two_lines_of_the_port_and_gives_them_back() {
    let mut script = Script::fast();
    // 100 steps forward, after which DIR is high. The pins are returned to the port and released. Then they
    // are STEP and DIR again, with DIR low: 50 steps forward and 50 backward.
    let active = say(&mut script, START, &["W0F3E8", "W1164", "W162", "W168"]);
    let inactive = say(&mut script, active + 400 * MS, &["W160"]);
    let again = say(&mut script, inactive, &["W162", "W1132", "W168"]);
    let backward = say(&mut script, again + 400 * MS, &["W11FFFFFFCE", "W168"]);
    let end = backward + 400 * MS;
    let run = play(&script, end);

    let (mut position, mut is_forward, mut most) = (0, false, 0);
    for (_, did) in &run.did {
        match did {
            OutputRecord::Pin(DIO2, drive) => is_forward = *drive == Drive::High,
            OutputRecord::Pin(DIO1, Drive::High) => {
                position += if is_forward { 1 } else { -1 };
                most = position.max(most);
            }
            _ => {}
        }
    }
    assert_eq!((position, most), (100, 150), "100 and 50 forward, 50 back");
    let drives = |pin| run.edges(pin, Drive::Float).len();
    assert_eq!((drives(DIO1), drives(DIO2)), (1, 1), "released when the motor drive ended");
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn dtr_resets_it() {
    let mut script = Script::fast();
    let begin = say(&mut script, START, &["W0B5"]);
    script.at(begin, format_args!("pin {DTR} low"));
    let asked = begin + 100 * MS;
    let end = say(&mut script, asked, &["R0B"]);
    let run = play(&script, end);
    assert_eq!(said(&run, START, end), ["w 0B 00000005 !", "QSB-M  0E!", "r 0B 00000000 !"]);
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn a_host_that_is_there_before_it_has_power_resets_nothing() {
    let mut script = Script::fast();
    script.at(0, format_args!("pin {DTR} low"));
    let run = play(&script, START);
    assert_eq!(said(&run, 0, START), ["QSB-M  0E!"]);
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn after_a_flood_it_answers_as_soon_as_what_was_kept_has_left() {
    let mut script = Script::fast();
    // 1,000 commands in 174 ms, whose replies would take 737 ms.
    script.hear(START, "R14\r".repeat(1_000).as_bytes());
    let asked = START + 250 * MS;
    script.hear(asked, b"R0B\r");
    let dtr = asked + 10 * MS;
    script.at(dtr, format_args!("pin {DTR} low"));
    let end = dtr + 60 * MS;
    let run = play(&script, end);
    assert_eq!(said(&run, asked, dtr), ["r 0B 00000000 !"]);
    assert_eq!(said(&run, dtr, end), ["QSB-M  0E!"]);
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn values_saved_by_command_3_survive_a_power_cycle_and_commands_are_received_50_ms_later() {
    const COMMANDS: usize = 20;
    let mut script = Script::fast();
    let mut at = START;
    // Saves repeatedly until sectors must be erased, which takes longest.
    for _ in 0..70 {
        at = say(&mut script, at, &["W163"]) + 20 * MS;
    }
    let begin = at;
    let mut expected = Vec::new();
    for n in 0..30 {
        at = say(&mut script, at, &[&format!("W0B{n:X}"), "W163"]) + 50 * MS;
        script.hear(at, "R0B\r".repeat(COMMANDS).as_bytes());
        at += 30 * MS;
        expected.extend([format!("w 0B {n:08X} !"), "w 16 00000003 !".to_owned()]);
        expected.extend(vec![format!("r 0B {n:08X} !"); COMMANDS]);
    }
    // This value is not saved.
    let off = say(&mut script, at, &["W0BFF"]);
    script.at(off, "power off");
    script.at(off + MS, "power on");
    let asked = off + MS + START;
    let end = say(&mut script, asked, &["R0B"]);
    let run = play(&script, end);
    let erased =
        run.did.iter().filter(|(at, did)| *at > begin && matches!(did, OutputRecord::Erased(_))).count();
    assert!(erased > 0, "no sector was erased while commands came");
    assert_eq!(said(&run, begin, at), expected);
    assert_eq!(said(&run, asked, end), ["r 0B 0000001D !"]);
}
