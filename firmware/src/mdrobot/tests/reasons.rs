//! Tests of the reasons why the drive does not do what a request says, although it accepts the request.

use super::super::reasons::REASONS;
use super::super::{DIR, RUN_BRAKE, START_STOP};
use super::*;
use crate::device::{Axis, Effect};

impl Dut {
    /// Writes the words of a PID, which the drive must accept, and returns the texts of the reasons. They must
    /// come before the note of the request.
    fn reasons_of(&mut self, pid: u8, words: &[u16]) -> Vec<&'static str> {
        let before = self.out.notes.len();
        match words {
            [word] => self.write(pid, *word),
            words => self.write_words(pid, words),
        }
        let mut notes = self.out.noted().split_off(before);
        assert!(matches!(notes.pop(), Some(LogEvent::Request { .. })), "PID {pid} = {words:?}");
        let reasons = notes.into_iter().map(|note| match note {
            LogEvent::Reason(reason) => self.drive.spec().reasons[usize::from(reason.0)].text,
            other => panic!("{other:?}"),
        });
        reasons.collect()
    }

    /// The motor turns at `VEL_CMD` 500.
    fn turns(&mut self) {
        self.write(130, 500);
        self.wait(1.secs());
    }

    /// `FUNC_CMD_TYPE` selects a function.
    fn has_function(&mut self, function: u16) {
        self.write(183, function);
    }

    /// The limit switch of CCW is open, that of CW is closed.
    fn opens_limit_switch(&mut self) {
        self.contact(DIR, true);
        self.contact(START_STOP, true);
        self.contact(START_STOP, false);
    }
}

/// Brings a drive into a situation.
type Prepare = fn(&mut Dut);

/// The drive, a situation, a write in it, and the effect, the text and the section of its reason.
type Case = (fn() -> Dut, Prepare, u8, &'static [u16], Effect, &'static str, &'static str);

/// Cases for all reasons, in their order.
#[rustfmt::skip]
fn cases() -> Vec<Case> {
    use Effect::{Later, Nothing, Other};
    /// The bus is the source of commands.
    fn on_bus() -> Dut {
        let mut dut = Dut::ready();
        dut.write(78, 1);
        dut
    }
    vec![
        (Dut::ready, |_| {}, 130, &[100], Nothing,
            "UI_COM is 0: the inputs command; write UI_COM = 1 first", "p. 7"),
        (Dut::ready, |_| {}, 100, &[1], Later,
            "UI_COM is 0: it arms when UI_COM is 1; write START_STOP again then", "MDROBOT-12"),
        (Dut::ready, |dut| { dut.write(155, 500); dut.contact(RUN_BRAKE, true); dut.contact(START_STOP, true); }, 100, &[0], Nothing,
            "the bus does not command: START_STOP = 0 stops nothing; write TQ_OFF", "p. 12"),
        (on_bus, |_| {}, 130, &[100], Nothing,
            "START_STOP is 0: write 1 or 2 first, then the command again", "p. 12"),
        (on_bus, |_| {}, 100, &[1], Other,
            "COM_TAR_SPEED is 0: START_STOP only arms; VEL_CMD or COM_TAR_SPEED drives", "p. 12"),
        (Dut::armed, Dut::turns, 180, &[0], Nothing,
            "another command drives: COM_TAR_SPEED = 0 does not end it", "MDROBOT-13"),
        (Dut::armed, |dut| dut.has_function(1), 130, &[100], Nothing,
            "FUNC_CMD_TYPE is not 0: only FUNC_CMD drives; write 0 there first", "p. 15"),
        (Dut::armed, |dut| dut.fault("overload", true), 130, &[100], Nothing,
            "an alarm is on (CTRL_STATUS): write ALARM_RESET, then the command again", "p. 9"),
        (Dut::armed, |dut| { dut.has_function(1); dut.fault("overload", true); }, 184, &[1], Nothing,
            "an alarm is on (CTRL_STATUS): write ALARM_RESET, then FUNC_CMD 0 and 1", "p. 9"),
        (Dut::armed, |_| {}, 184, &[1], Nothing,
            "FUNC_CMD_TYPE is 0: there is no function to start", "p. 16"),
        (Dut::armed, |dut| { dut.has_function(3); dut.write(184, 1); }, 184, &[1], Nothing,
            "the start signal is ON already: write FUNC_CMD 0, then 1", "p. 17"),
        (Dut::armed, |dut| { dut.has_function(1); dut.write(184, 1); dut.write(184, 0); }, 184, &[1], Nothing,
            "a function runs: the signal is ignored until it ends", "MDROBOT-20"),
        (Dut::armed, |dut| { dut.has_function(1); dut.write_words(239, &[1_000, 0]); }, 184, &[1], Nothing,
            "the run time in FUNC_SPEED is 0: nothing runs", "p. 16"),
        (Dut::armed, Dut::opens_limit_switch, 130, &[100], Nothing,
            "the limit switch ahead (DIR: CW, START/STOP: CCW) is open; or USE_LIMIT_SW = 0", "p. 7"),
        (Dut::armed, |dut| dut.write(211, 0), 130, &[100], Nothing,
            "MAX_LOAD is 0: the motor gets no current", "p. 16"),
        (Dut::armed, |dut| dut.write(176, 0), 243, &[100, 0], Nothing,
            "the speed of the position (or TAR_POSI_VEL) is 0: the motor does not move", "MDROBOT-19"),
        (Dut::armed, |dut| dut.write(167, 0), 243, &[100, 0], Nothing,
            "PV_GAIN is 0: a position error gives no speed", "p. 15"),
        (Dut::armed, |dut| dut.write(221, 0), 130, &[100], Nothing,
            "MAX_RPM is 0: the motor does not turn", "p. 16"),
        (Dut::armed, |_| {}, 130, &[3_001], Other,
            "more than MAX_RPM: it acts as MAX_RPM", "MDROBOT-18"),
        (Dut::armed, |_| {}, 180, &[0xFF00], Other,
            "this speed has no sign: a negative number acts as MAX_RPM", "p. 15"),
        (Dut::armed, |dut| dut.fault("over_temperature", true), 12, &[0], Nothing,
            "the cause is still there: the alarm stays (see CTRL_STATUS)", "MDROBOT-31"),
        (Dut::ready, |_| {}, 133, &[0x0200], Nothing,
            "the key is missing: DL must be 0xAA, DH the value", "p. 12"),
        (Dut::ready, |_| {}, 133, &[0x02AA], Later,
            "saved: it counts from the next power-on", "p. 12"),
        (Dut::ready, |_| {}, 3, &[0], Nothing,
            "the key is missing: write 0x55", "p. 6"),
        (Dut::ready, |_| {}, 10, &[5], Nothing,
            "this command is not modelled: it is echoed and does nothing", "MDROBOT-10"),
        (Dut::ready, |_| {}, 10, &[1], Nothing,
            "there is no such command: it is echoed and does nothing", "MDROBOT-10"),
        (Dut::ready, |_| {}, 211, &[201], Other,
            "more than the limit: MAX_LOAD acts as 200 and MAX_RPM as 5,000 at most", "MDROBOT-8"),
    ]
}

/// A drive, a situation, a write in this situation, and the index of its reason in [`cases`].
type OtherCase = (fn() -> Dut, Prepare, u8, &'static [u16], usize);

/// More writes for reasons of [`cases`].
#[rustfmt::skip]
fn more_cases() -> Vec<OtherCase> {
    vec![
        (Dut::ready, |_| {}, 134, &[100], 0),
        (Dut::ready, |_| {}, 140, &[100], 0),
        (Dut::ready, |_| {}, 243, &[100, 0], 0),
        (Dut::ready, |_| {}, 244, &[100, 0], 0),
        (Dut::ready, |_| {}, 219, &[100, 0, 500], 0),
        (Dut::armed, |dut| dut.write(100, 0), 134, &[100], 3),
        (Dut::armed, |dut| dut.write(100, 0), 140, &[100], 3),
        (Dut::armed, |dut| dut.has_function(1), 100, &[1], 6),
        (Dut::armed, |dut| dut.has_function(2), 243, &[100, 0], 6),
        (Dut::armed, |dut| dut.fault("overload", true), 6, &[0], 7),
        (Dut::armed, |dut| dut.fault("overload", true), 220, &[100, 0, 500], 7),
        (Dut::armed, |dut| { dut.has_function(2); dut.write(184, 1); }, 184, &[1], 10),
        (Dut::armed, |dut| { dut.has_function(4); dut.write(184, 1); dut.write(184, 0); }, 184, &[1], 11),
        (Dut::armed, Dut::opens_limit_switch, 134, &[100], 13),
        (Dut::armed, Dut::opens_limit_switch, 244, &[100, 0], 13),
        (Dut::armed, |dut| dut.write(181, 0), 140, &[100], 14),
        (Dut::armed, |dut| { dut.write(211, 0); dut.has_function(2); }, 184, &[1], 14),
        (Dut::armed, |_| {}, 220, &[100, 0, 0], 15),
        (Dut::armed, |dut| dut.write(221, 0), 243, &[100, 0], 17),
        (Dut::armed, |_| {}, 180, &[3_001], 18),
        (Dut::armed, |_| {}, 219, &[100, 0, 3_001], 18),
        (Dut::ready, |_| {}, 176, &[0xFF00], 19),
        (Dut::armed, |dut| dut.fault("over_temperature", true), 10, &[8], 20),
        (Dut::ready, |_| {}, 135, &[0x0100], 21),
        (Dut::ready, |_| {}, 135, &[0x01AA], 22),
        (Dut::ready, |_| {}, 221, &[5_001], 26),
    ]
}

#[test]
fn each_reason_has_its_request() {
    let cases = cases();
    assert_eq!(cases.len(), REASONS.len());
    for ((drive, prepare, pid, words, effect, text, section), reason) in cases.into_iter().zip(REASONS) {
        let mut dut = drive();
        prepare(&mut dut);
        assert_eq!(dut.reasons_of(pid, words), [text]);
        assert_eq!((reason.text, reason.effect, reason.section), (text, effect, section));
    }
}

#[test]
fn a_reason_may_have_several_requests() {
    for (drive, prepare, pid, words, place) in more_cases() {
        let mut dut = drive();
        prepare(&mut dut);
        assert_eq!(dut.reasons_of(pid, words), [REASONS[place].text], "PID {pid} = {words:?}");
    }
}

#[test]
fn a_request_without_effect_changes_nothing() {
    for (drive, prepare, pid, words, effect, text, _) in cases() {
        if effect != Effect::Nothing {
            continue;
        }
        let mut dut = drive();
        prepare(&mut dut);
        dut.out.clear();
        let mut other = Dut { fixture: dut.fixture.clone(), id: dut.id };
        dut.reasons_of(pid, words);
        other.run_until(dut.now);
        for _ in 0..2 {
            let seen = |dut: &Dut| {
                let out = dut.out.clone();
                let shaft = dut.drive.shaft(dut.now, Axis(0)).map(|shaft| (shaft.position, shaft.speed));
                (shaft, dut.get(Pid::CTRL_STATUS), out.levels, out.stores, out.lines)
            };
            assert_eq!(seen(&dut), seen(&other), "{text}");
            dut.wait(500.millis());
            other.wait(500.millis());
        }
    }
}

#[test]
fn the_usual_life_of_a_drive_has_no_reason() {
    let mut dut = Dut::ready();
    let mut send = |writes: &[(u8, &[u16])], wait: Duration| {
        for (pid, words) in writes {
            assert_eq!(dut.reasons_of(*pid, words), [""; 0], "PID {pid} = {words:?}");
        }
        dut.wait(wait);
    };
    // Set-up in the order of the PIDs.
    send(
        &[
            (3, &[0x55]),
            (10, &[17]),
            (12, &[0]),
            (13, &[0]),
            (16, &[0]),
            (17, &[1]),
            (21, &[0]),
            (24, &[1]),
            (36, &[0]),
            (40, &[1]),
            (153, &[100]),
            (154, &[100]),
            (155, &[0]),
            (167, &[20]),
            (168, &[6_000]),
            (176, &[2_000]),
            (211, &[150]),
            (221, &[2_500]),
        ],
        100.millis(),
    );
    // START_STOP and COM_TAR_SPEED.
    send(&[(78, &[1]), (180, &[500]), (100, &[1])], 2.secs());
    send(&[(180, &[800]), (100, &[2])], 2.secs());
    send(&[(180, &[0]), (100, &[0]), (100, &[0])], 3.secs());
    // Gives the other commands. A motor without a command accepts a speed of 0.
    send(&[(180, &[500]), (100, &[1]), (130, &[1_000])], 2.secs());
    send(&[(130, &[0xFC18]), (134, &[300]), (140, &[200]), (5, &[0])], 1.secs());
    send(&[(130, &[0]), (6, &[0]), (130, &[500])], 1.secs());
    send(&[(243, &[240, 0])], 2.secs());
    send(&[(244, &[0xFF00, 0xFFFF])], 2.secs());
    send(&[(219, &[480, 0, 1_000]), (13, &[0])], 2.secs());
    // Functions.
    for function in [1, 2, 3, 4] {
        send(&[(183, &[function]), (184, &[1])], 3.secs());
        send(&[(184, &[0]), (184, &[0])], 1.secs());
    }
    send(&[(183, &[0]), (130, &[500])], 1.secs());
    // An alarm has freed the motor already, and its reset clears it.
    dut.fault("overload", true);
    dut.fault("overload", false);
    for (pid, word) in [(5, 0), (12, 0), (130, 500), (78, 0)] {
        assert_eq!(dut.reasons_of(pid, &[word]), [""; 0], "PID {pid} = {word}");
    }
}

/// A contact and a preset that start nothing give their reason to no request.
#[test]
fn a_contact_has_no_reason() {
    let mut dut = Dut::ready();
    dut.has_function(1);
    dut.write_words(239, &[1_000, 0]);
    dut.contact(START_STOP, true);
    dut.contact(START_STOP, false);
    assert!(dut.out.notes.iter().all(|(_, note)| !matches!(note, LogEvent::Reason(_))));
    dut.set(Pid::VEL_CMD, 100);
    assert_eq!(dut.reasons_of(21, &[0]), [""; 0]);
}

#[test]
fn texts_are_short() {
    for reason in REASONS {
        assert!(reason.text.len() <= 80 && !reason.text.ends_with('.'), "{}", reason.text);
    }
}
