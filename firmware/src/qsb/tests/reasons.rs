//! Tests of the reasons why the adapter does not do what a request says, although it accepts the request.

use super::*;
use crate::device::Effect::{self, Later, Nothing, Other};

impl Dut {
    /// Types a command that the adapter must accept. Returns the reasons, which come before the note of the
    /// request.
    fn reasons_of(&mut self, command: &str) -> Vec<(Effect, &'static str, &'static str)> {
        let before = self.out.notes.len();
        let letter = self.ask(command).remove(0);
        assert_eq!(letter, command.to_lowercase().remove(0), "{command}");
        let mut notes = self.out.noted().split_off(before);
        let request = LogEvent::Request { port: USB, unit: 0, function: command.as_bytes()[0] };
        assert_eq!(notes.pop(), Some(request));
        let reasons = notes.into_iter().map(|note| match note {
            LogEvent::Reason(reason) => {
                let reason = self.drive.spec().reasons[usize::from(reason.0)];
                (reason.effect, reason.text, reason.section)
            }
            other => panic!("{other:?}"),
        });
        reasons.collect()
    }

    /// Number of outputs, without replies and notes.
    fn outputs(&self) -> usize {
        self.out.plans.len() + self.out.levels.len() + self.out.stores.len() + self.out.lines.len()
    }
}

/// A new adapter that has executed these commands.
fn after(drive: Qsb, commands: &[&str]) -> Dut {
    let mut dut = Dut::ready(drive);
    dut.wait(10.millis());
    for command in commands {
        dut.ask(command);
    }
    dut
}

/// The adapter, commands before, a command, and the expected effect, text and section.
type Case = (fn() -> Qsb, &'static [&'static str], &'static str, Effect, &'static str, &'static str);

/// A case for each reason, in the order of the reasons, and further cases.
#[rustfmt::skip]
const CASES: &[Case] = &[
    (Qsb::m, &[], "S0E", Nothing, "INTERVAL RATE is FFFF: nothing streams; write W0C first", "INTERVAL RATE"),
    (Qsb::m, &["S05"], "W161", Nothing, "streams of 05 and 06 go on: end them by R05, R06", "QSB-12"),
    (Qsb::d, &[], "W01E", Nothing, "the pin is an input: set bits 11:8 of DIG I/O CONFIG first (W02)", "DIG I/O CONFIG"),
    (Qsb::m, &["W02F00", "W162"], "W01D", Nothing, "the motor drive has DIO1 and DIO2: no effect until W160", "QSB-26"),
    (Qsb::d, &["W02100"], "W01D", Nothing, "a QSB-D has DIO0 only: the other bits do nothing", "QSB-23"),
    (Qsb::m, &["W02F00", "W010"], "W02F00", Other, "all pins are high now: write their levels again by W01", "DIG I/O CONFIG"),
    (Qsb::s, &[], "W0A1", Nothing, "R07 shows the present count: a loaded OTR cannot be read", "QSB-9"),
    (Qsb::s, &[], "W0D0", Nothing, "only W0D1 clears the time stamp", "QSB-10"),
    (Qsb::m, &[], "W166", Nothing, "the motor drive is not active: write W162 first", "QSB-27"),
    (Qsb::m, &["W162"], "W166", Nothing, "nothing moves: there is nothing to stop, pause or resume", "QSB-27"),
    (Qsb::m, &["W162", "W169"], "W167", Nothing, "nothing is paused: there is nothing to resume", "QSB-28"),
    (Qsb::m, &["W162"], "W168", Nothing, "MD MOVE STEPS is 0: the move is over at once", "QSB-29"),
    (Qsb::m, &["W12F", "W162"], "W169", Nothing, "MD JOG RATE is below 16: no steps", "QSB-29"),
    (Qsb::m, &["W162", "W169"], "W1240", Later, "the motor moves: the new value counts from the next command", "QSB-27"),
    (Qsb::m, &[], "W0F2F", Other, "no multiple of 16: it is rounded towards 0 when it is used", "QSB-27"),

    (Qsb::m, &["S06"], "W160", Nothing, "streams of 05 and 06 go on: end them by R05, R06", "QSB-12"),
    (Qsb::m, &["W02100"], "W01D", Nothing, "the pin is an input: set bits 11:8 of DIG I/O CONFIG first (W02)", "DIG I/O CONFIG"),
    (Qsb::m, &["W162"], "W02200", Nothing, "the motor drive has DIO1 and DIO2: no effect until W160", "QSB-26"),
    (Qsb::d, &[], "W02E00", Nothing, "a QSB-D has DIO0 only: the other bits do nothing", "QSB-23"),
    (Qsb::m, &[], "W164", Nothing, "the motor drive is not active: write W162 first", "QSB-27"),
    (Qsb::m, &[], "W165", Nothing, "the motor drive is not active: write W162 first", "QSB-27"),
    (Qsb::m, &[], "W167", Nothing, "the motor drive is not active: write W162 first", "QSB-27"),
    (Qsb::m, &["W162"], "W164", Nothing, "nothing moves: there is nothing to stop, pause or resume", "QSB-27"),
    (Qsb::m, &["W162"], "W165", Nothing, "nothing moves: there is nothing to stop, pause or resume", "QSB-27"),
    (Qsb::m, &["W162"], "W167", Nothing, "nothing moves: there is nothing to stop, pause or resume", "QSB-27"),
    (Qsb::m, &["W12FFFFFFF1", "W162"], "W169", Nothing, "MD JOG RATE is below 16: no steps", "QSB-29"),
    (Qsb::m, &["W162", "W169"], "W0F40", Later, "the motor moves: the new value counts from the next command", "QSB-27"),
    (Qsb::m, &["W162", "W169"], "W1040", Later, "the motor moves: the new value counts from the next command", "QSB-27"),
    (Qsb::m, &["W162", "W169"], "W1140", Later, "the motor moves: the new value counts from the next command", "QSB-27"),
    (Qsb::m, &[], "W1041", Other, "no multiple of 16: it is rounded towards 0 when it is used", "QSB-27"),
    (Qsb::m, &[], "W1241", Other, "no multiple of 16: it is rounded towards 0 when it is used", "QSB-27"),
];

#[test]
fn each_reason_comes_with_its_request() {
    for (drive, before, command, effect, text, section) in CASES {
        let mut dut = after(drive(), before);
        let outputs = dut.outputs();
        assert_eq!(dut.reasons_of(command), [(*effect, *text, *section)], "{before:?} {command}");
        // A move of 0 steps and a jog at rate 0 have a plan, of a motor at rest.
        if *effect == Nothing && !matches!(*command, "W168" | "W169") {
            assert_eq!(dut.outputs(), outputs, "{before:?} {command}");
        }
    }
}

#[test]
fn each_reason_has_a_case_and_a_short_text() {
    let reasons = Qsb::m().spec().reasons;
    let texts: Vec<_> = reasons.iter().map(|reason| reason.text).collect();
    let tested: Vec<_> = CASES.iter().take(reasons.len()).map(|case| case.4).collect();
    assert_eq!(tested, texts);
    for text in texts {
        assert!(text.len() <= 80, "{text}: {}", text.len());
    }
}

#[test]
fn the_usual_life_of_an_adapter_has_no_reason() {
    let mut dut = after(Qsb::m(), &[]);
    for command in [
        // Sets up the counter and the port, and saves the set-up.
        "W000",
        "W0343",
        "W0402",
        "W08FFF",
        "W091",
        "W0402",
        "W092",
        "W093",
        "W0A0",
        "W0B0",
        "W0C33",
        "W0D1",
        "W15B",
        "W020910",
        "W01E",
        "W01F",
        "W01F",
        "W163",
        "R01",
        "R06",
        "R0E",
        // Streams begin and end.
        "S0E",
        "R0E",
        "S01",
        "W161",
        "S05",
        "R05",
        "W161",
        // The motor is set up, moves, pauses, resumes, jogs both ways and stops.
        "W0F7D0",
        "W102710",
        "W11186A0",
        "W127D0",
        "W162",
        "W168",
        "W166",
        "W167",
        "W165",
        "W169",
        "W164",
        "W12FFFFF830",
    ] {
        if command == "W12FFFFF830" {
            dut.wait(2.secs());
        }
        assert_eq!(dut.reasons_of(command), [], "{command}");
    }
    assert_eq!(dut.reasons_of("W169"), []);
    // A jog at rate 0 slows the running jog down.
    dut.wait(1.secs());
    dut.ask("W120");
    assert_eq!(dut.reasons_of("W169"), []);
    assert_eq!(dut.reasons_of("W165"), []);
    assert_eq!(dut.reasons_of("W160"), []);
}
