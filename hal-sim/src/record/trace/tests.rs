use drivetwin_firmware::md3::Md3;
use drivetwin_firmware::mdrobot::Mdrobot;
use drivetwin_firmware::motion::Limits;
use drivetwin_protocol::line::Parity;
use fixed::types::{I24F8, U24F8};
use proptest::prelude::*;

use super::*;
use crate::replay::{self, Difference, Unplayable};
use crate::testing::test_device::TestDevice;

fn make(kind: &str) -> Option<Box<dyn Device>> {
    match kind {
        "md3" => Some(Box::new(Md3::new())),
        "toy" => Some(Box::new(TestDevice::default())),
        "mdrobot" => Some(Box::new(Mdrobot::md400())),
        _ => None,
    }
}

const TOY: &str = "drivetwin trace 1\ndrive t toy\n";

fn parse(lines: &str) -> Result<Trace, String> {
    Trace::parse(&format!("{TOY}{lines}"), &make).map_err(|error| error.to_string())
}

/// Every word that a trace may contain.
const WORDS: &str = "\
drivetwin trace 1
seed 5
drive a toy
memory a 0x0000 FF FF FF FF FF FF FF FF 00 FF
drive b md3 fast apart from 0.250000
drive c mdrobot
compare tx motion
1.000000 a > rx \"r#\\r\\n\\\"\\\\\"
1.000000 a > rx 80 FF
1.000063 a > opened:net 3
1.000063 a > message:net 3 \"x\"
1.000063 a > closed:net 3
1.000125 b > spoiled
1.000125 b > idle
1.000125 b > attached on
1.000188 b > pin J2.2 low
1.000188 c > pin DIR open
2.000000 a > millivolts LEVEL -2500
2.000000 b > count 0 -4 high low
2.000000 b > slipped motor 1
2.000000 b > draws motor -130
2.000000 b > motor motor 24000 3000 500 400 10000 -7 4 2 0
2.000000 b > rotation motor -5 1000 -3
2.000000 b > fault over_temperature off
2.000000 b > poke Speed -8000
2.000000 b > power cut
2.000000 b > power cut 1 20
2.000000 b > power off
2.000000 b > power on
3.000000 b < tx 01 83
3.000000 b < line 19200 7O2
3.000000 b < pin J3.7 float
3.000000 b < wave D6 500.000000 of 1500.000063
3.000000 b < plan motor 0 500.000000@5000 500.000000@0 2500
3.000000 b < plan motor -5 1.000000@-0.5 ever@-4999.125
3.000000 b < plan motor 7
3.000000 b < step motor -1
3.000000 b < current motor 1500
3.000000 b < duty motor -32768
3.000000 b < store 0x0010 01 02
3.000000 b < power off
4.000000 a < message:net 0 0A FE
4.000000 a < close:net 0
5.000000 end
";

#[test]
fn every_word_is_read_and_written() {
    let trace = Trace::parse(WORDS, &make).unwrap();
    assert_eq!(trace.to_text(), WORDS);
    assert_eq!(trace.events().len(), WORDS.lines().count() - 8);
    assert_eq!(trace.drives[0].memory[7..], [0xFF, 0, 0xFF]);
    let line = trace.events().find_map(|entry| match entry.event {
        Event::Output(OutputRecord::Line { line, .. }) => Some(line),
        _ => None,
    });
    assert_eq!(line, Some(Line::new(19_200, 7, Parity::Odd, 2)));
}

#[test]
fn what_people_write_by_hand_is_read() {
    let trace = parse("\n# Nothing yet.\n  1 >  rx \"r\" 0d   # a comment\n1.5 t < tx 61\n2. end\n");
    assert_eq!(trace.unwrap_err(), "line 7: \"2.\" is not a time in milliseconds with up to six decimals");
    let trace = parse("  1 >  rx \"r\" 0d   # a comment\n1.5 t < tx 61\n").unwrap();
    let entries: Vec<&Entry> = trace.events().collect();
    assert_eq!(
        entries[0].event,
        Event::Input(InputRecord::Bytes { port: Port(0), bytes: [b'r', 13].into() })
    );
    assert_eq!((entries[0].at, entries[0].line), (Instant::from(Duration::millis(1)), 3));
    assert_eq!(trace.end, Instant::from(Duration::micros(1_500)));
}

#[test]
fn what_is_not_known_is_an_error_in_its_line() {
    for (lines, error) in [
        (
            "1 > tx 01",
            "line 3: \"tx\" is not an input; inputs are: rx, spoiled, idle, attached, opened, message, closed, pin, millivolts, count, slipped, draws, motor, rotation, fault, poke, power",
        ),
        (
            "1 < rx 01",
            "line 3: \"rx\" is not an output; outputs are: tx, message, close, line, pin, wave, plan, step, current, duty, store, power",
        ),
        ("1 > rx", "line 3: no bytes follow"),
        ("1 > rx 1", "line 3: \"1\" is not a byte of two hex digits"),
        ("1 > rx +1", "line 3: \"+1\" is not a byte of two hex digits"),
        ("1 > rx \"r", "line 3: the closing quote is missing"),
        ("1 > rx \"\\t\"", "line 3: after \\ comes r, n, \" or \\"),
        ("1 > rx:com 01", "line 3: there is no port \"com\"; there are: usb, net"),
        ("1 > pin OUTT low", "line 3: there is no pin \"OUTT\"; there are: IN, LEVEL, OUT, LED"),
        ("1 > pin IN float", "line 3: \"high\" or \"low\", not \"float\""),
        ("1 > pin IN open", "line 3: \"high\" or \"low\", not \"open\""),
        ("drive d mdrobot\n1 d > pin DIR float", "line 4: \"high\", \"low\" or \"open\", not \"float\""),
        ("1 > pin IN low low", "line 3: \"low\" is not expected at the end of the line"),
        ("1 > fault stal on", "line 3: there is no fault \"stal\"; there are: stall"),
        ("1 > poke Volum 1", "line 3: there is no register \"Volum\""),
        ("1 > power up", "line 3: power goes \"on\", \"off\" or \"cut\", not \"up\""),
        ("1 < line 9600 9E1", "line 3: \"9E1\" is not a character format like 8E1"),
        ("1 < store 10 01", "line 3: \"10\" is not a memory address like 0x0010"),
        ("1 < wave LED 1 2", "line 3: \"of\" and a period are missing before \"2\""),
        ("1 < plan motor 0 1@5", "line 3: a plan ends with a position, unless it goes on for ever"),
        ("1 < plan motor 0 ever@5 6", "line 3: a plan ends with a position, unless it goes on for ever"),
        ("1 < plan motor 0 1@0.0001 6", "line 3: \"0.0001\" is not a speed in steps/s"),
        ("1 < power on", "line 3: as an output, power is \"off\", not \"on\""),
        ("1 = rx 01", "line 3: after the stamp comes \">\", \"<\" or \"end\", not \"=\""),
        ("1.0000001 > idle", "line 3: \"1.0000001\" is not a time in milliseconds with up to six decimals"),
        (
            "2 > idle\n1 > idle",
            "line 4: inputs must be in the order of their stamps, and not before their drive is added",
        ),
        ("2 > idle\n1 end", "line 4: \"end\" is earlier than the line before it"),
        ("1 > idle\nseed 5", "line 4: \"seed\" is not a time stamp in milliseconds"),
        (
            "sed 5",
            "line 3: \"sed\" is not known here: seed, drive, memory, compare, lost, or a stamp in milliseconds",
        ),
        ("seed -1", "line 3: \"-1\" is not a seed"),
        ("compare tx leds", "line 3: \"leds\" cannot be compared: tx, line, pins, motion, stores"),
        ("drive u md4", "line 3: there is no kind \"md4\""),
        ("drive t toy", "line 3: two drives have the name t"),
        ("drive 1 toy", "line 3: \"1\" is not a valid name for a drive"),
        ("drive u toy slow", "line 3: \"slow\" is not known here: fast, apart, elsewhere, untimed, from"),
        ("drive u toy\n1 > idle", "line 4: \">\" is not a drive of this trace"),
        ("memory t 0x0009 01 02", "line 3: the memory of t has 10 bytes"),
        ("memory u 0x0000 01", "line 3: there is no drive \"u\" above this line"),
    ] {
        assert_eq!(parse(lines).unwrap_err(), error);
    }
    let error = |text| Trace::parse(text, &make).unwrap_err().to_string();
    assert_eq!(error(""), "line 1: a trace begins with \"drivetwin trace 1\"");
    assert_eq!(error("1 > idle"), "line 1: a trace begins with \"drivetwin trace 1\"");
    assert_eq!(error("drivetwin trace 2"), "line 1: version \"2\" of the format is not known, only 1");
    let nobody = "line 2: there is no drive above this line; begin with \"drive NAME KIND\"";
    assert_eq!(error("drivetwin trace 1\n1 > idle"), nobody);
}

#[test]
fn a_trace_from_before_the_project_was_renamed_loads() {
    let former = WORDS.replacen("drivetwin trace 1", "standin trace 1", 1);
    assert_ne!(former, WORDS);
    assert_eq!(
        Trace::parse(&former, &make).unwrap().to_text(),
        Trace::parse(WORDS, &make).unwrap().to_text()
    );
    let error = Trace::parse("standin trace 2", &make).unwrap_err().to_string();
    assert_eq!(error, "line 1: version \"2\" of the format is not known, only 1");
}

/// The line in which a test device sends its letter. The letter depends on the seed only, which is 1.
fn letter() -> String {
    let text = format!("{TOY}1 > rx \"r\"\n10 end\n");
    let text = replay::rewrite(&text, &make).unwrap();
    text.lines().find(|line| line.contains("< tx")).unwrap().to_owned()
}

#[test]
fn a_rewrite_brings_what_is_compared_up_to_date_and_nothing_else() {
    let old = format!(
        "{TOY}compare tx pins\n\n# It asks.\n  1 > rx \"0r\" # Now.\n1 < tx \"wrong\"\n# Later.\n9 < pin OUT low\n10 end\n# Done.\n"
    );
    let letter = letter();
    let letter = letter.replace("1.000000", "1.086813");
    let new = format!(
        "{TOY}compare tx pins\n0.000000 < wave LED 1.000000 of 4.000000\n0.000000 < pin OUT high\n\n# It asks.\n  1 > rx \"0r\" # Now.\n\
         1.000000 < pin OUT low\n{letter}\n# Later.\n10 end\n# Done.\n"
    );
    assert_eq!(replay::rewrite(&old, &make).unwrap(), new);
    assert_eq!(replay::rewrite(&new, &make).unwrap(), new);
    let trace = Trace::parse(&new, &make).unwrap();
    assert_eq!(replay::run(&trace, &make), Ok(None));
}

#[test]
fn a_replay_returns_the_first_difference() {
    let letter = letter();
    let right = format!("{TOY}compare tx\n1 > rx \"r\"\n{letter}\n20 end\n");
    let run = |text: &str| replay::run(&Trace::parse(text, &make).unwrap(), &make).unwrap();
    assert_eq!(run(&right), None);
    // The bytes differ.
    let difference = run(&right.replace(&letter, "1 < tx 21")).unwrap();
    let expected = Some("1.000000 < tx \"!\"".to_owned());
    assert_eq!(difference, Difference { line: Some(5), expected, got: Some(letter.clone()) });
    // The output is one tick late.
    let late = letter.replace("1.000000", "1.000063");
    let difference = run(&right.replace(&letter, &late)).unwrap();
    assert_eq!(difference, Difference { line: Some(5), expected: Some(late), got: Some(letter.clone()) });
    // The replay has one output less.
    let missing = "15.000000 < tx \"x\"";
    let difference = run(&right.replace("20 end", &format!("{missing}\n20 end"))).unwrap();
    assert_eq!(difference, Difference { line: Some(6), expected: Some(missing.to_owned()), got: None });
    // The replay has one output more.
    let difference = run(&right.replace(&letter, "")).unwrap();
    assert_eq!(difference, Difference { line: None, expected: None, got: Some(letter) });
}

#[test]
fn a_trace_without_its_beginning_cannot_be_replayed() {
    let trace = parse("lost 3\n1 > idle").unwrap();
    assert_eq!(replay::run(&trace, &make), Err(Unplayable::Lost(3)));
}

#[test]
fn a_full_ring_drops_the_oldest() {
    let size = Entry {
        at: Instant::ZERO,
        drive: 0,
        event: Event::Input(InputRecord::Idle { port: Port(0) }),
        line: 0,
    }
    .size();
    let mut trace = Trace::new(1, Retention::Ring(10 * size));
    for n in 0..25 {
        trace.record_input(Instant::from_ticks(n), 0, &InputRecord::Idle { port: Port(0) });
    }
    assert_eq!((trace.lost, trace.events().len()), (15, 10));
    assert_eq!(trace.events().next().unwrap().at, Instant::from_ticks(15));
    trace.rewind(trace.mark() - 2);
    assert_eq!((trace.events().len(), trace.mark()), (8, 23));
    let mut off = Trace::new(1, Retention::Off);
    off.record_input(Instant::ZERO, 0, &InputRecord::Idle { port: Port(0) });
    assert_eq!(off.events().len(), 0);
}

#[test]
fn a_plan_is_written_as_its_stretches() {
    let start = Instant::from_ticks(5);
    let plan = Plan::profile(start, 100, -10_000, Limits::even(U24F8::from_num(5_000), 10_000));
    let leg = |ms, speed| Leg { time: Duration::millis(ms), speed };
    let legs = vec![leg(500, -5_000_000), leg(1_500, -5_000_000), leg(500, 0)];
    assert_eq!(Course::of(&plan, start), Course { from: 100, legs, to: Some(-9_900) });
    let jog = Plan::at_rest(start, 3).ramp_to(start, I24F8::from_num(5_000), 10_000);
    let legs = vec![leg(500, 5_000_000), Leg { time: Duration::FOREVER, speed: 5_000_000 }];
    assert_eq!(Course::of(&jog, start), Course { from: 3, legs, to: None });
    assert_eq!(Course::of(&Plan::at_rest(start, -7), start), Course { from: -7, legs: vec![], to: Some(-7) });
    // A course may begin in the middle of a ramp, or before its plan.
    let later = start + Duration::millis(250);
    let legs = vec![leg(250, -5_000_000), leg(1_500, -5_000_000), leg(500, 0)];
    // a·t²/2 = 10,000 · 0.25² / 2 = 312.5 steps; the last half step is not made.
    assert_eq!(Course::of(&plan, later), Course { from: 100 - 312, legs, to: Some(-9_900) });
    let jog = Plan::at_rest(later, 3).ramp_to(later, I24F8::from_num(5_000), 10_000);
    let legs = vec![leg(250, 0), leg(500, 5_000_000), Leg { time: Duration::FOREVER, speed: 5_000_000 }];
    assert_eq!(Course::of(&jog, start), Course { from: 3, legs, to: None });
}

proptest! {
    #[test]
    fn no_text_is_too_strange(lines in proptest::collection::vec(
        "([0-9.]{0,3}|t|[<>#]|end|drive|memory|compare|rx|tx|pin|plan|store|line|wave|power|cut|toy|0x0[0-9]{3}|[0-9a-f]{2}|\"[a-z\\\\]{0,3}\"?|[0-9]@[0-9.-]{0,4}| ){0,8}", 0..6,
    )) {
        let lines: Vec<String> = lines.iter().map(|line| line.replace('t', "t ")).collect();
        if let Ok(trace) = parse(&lines.join("\n")) {
            let text = trace.to_text();
            prop_assert_eq!(Trace::parse(&text, &make).unwrap().to_text(), text);
        }
    }
}
