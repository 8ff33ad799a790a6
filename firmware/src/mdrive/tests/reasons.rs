//! Tests of the reasons why the drive does not do what a request says, although it accepts the request.

use super::*;
use crate::device::{Effect, Port};

/// A request on port 502 (a PDU) or on port 503 (a line).
#[derive(Clone, Debug)]
enum Request {
    Bus(Vec<u8>),
    Line(&'static str),
}

use Request::Line;

/// Function 16 with a value of this number of registers.
fn write(address: u8, words: u8, value: i64) -> Request {
    let mut pdu = vec![16, 0, address, 0, words, 2 * words];
    pdu.extend_from_slice(&value.to_be_bytes()[8 - 2 * usize::from(words)..]);
    Request::Bus(pdu)
}

/// Function 66 with a command, whose characters are in reverse order.
fn command(mnemonic: [u8; 4]) -> Request {
    Request::Bus([&[66][..], &mnemonic].concat())
}

/// MR by this number of steps.
fn mr(steps: i64) -> Request {
    write(0x46, 2, steps)
}

impl Dut {
    fn send(&mut self, request: &Request) {
        match request {
            Request::Bus(pdu) => assert_eq!(self.ask(pdu)[0], pdu[0], "{request:02x?}"),
            Request::Line(line) => {
                self.connect(CLIENT);
                self.lines(line);
            }
        }
    }

    /// Types lines on the connection that is open. They must be accepted.
    fn lines(&mut self, lines: &str) {
        let said = self.type_in(CLIENT, lines);
        assert!(!said.contains('?'), "{lines}: {said}");
    }

    /// Sends a request, which the drive must accept, and returns the texts of its reasons. They must come
    /// before the note of the request.
    fn reasons_of(&mut self, request: &Request) -> Vec<&'static str> {
        let before = self.out.notes.len();
        self.send(request);
        self.reasons_since(before)
    }

    /// Texts of the reasons before the first note of a request.
    fn reasons_since(&self, before: usize) -> Vec<&'static str> {
        let notes = self.out.noted().split_off(before);
        let end = notes.iter().position(|note| matches!(note, LogEvent::Request { .. })).unwrap();
        let reasons = notes[..end].iter().map(|note| match note {
            LogEvent::Reason(reason) => self.drive.spec().reasons[usize::from(reason.0)].text,
            other => panic!("{other:?}"),
        });
        reasons.collect()
    }

    /// A move of 1,000,000 steps has been running for 0.1 s.
    fn moves(&mut self) {
        self.set(Reg::MR, 1_000_000);
        self.wait(100.millis());
    }

    /// SL has been turning the motor for 0.1 s.
    fn slews(&mut self) {
        self.set(Reg::SL, 10_000);
        self.wait(100.millis());
    }

    /// IO1 is the plus limit, and is active.
    fn at_limit(&mut self) {
        self.set(Reg::S1, 2 << 32);
        self.drive(1, false);
    }

    /// TT and TP have subroutines; TT is on.
    fn has_trips(&mut self) {
        self.connect(CLIENT);
        self.lines("PG 1\rLB K1\rRT\rPG\rTT=60000,K1\rTP=5000,K1\rTE=8\r");
    }

    /// Torque mode has been on for 1 s.
    fn has_torque(&mut self) {
        self.set(Reg::AS, 3);
        self.wait(1.secs());
    }

    /// The rotor was locked.
    fn is_locked(&mut self) {
        self.fault("locked_rotor", true);
        self.fault("locked_rotor", false);
        self.wait(100.millis());
    }

    /// PS has stopped a move, and MT is in progress.
    fn is_paused(&mut self) {
        self.set(Reg::MT, 10_000);
        self.moves();
        self.send(&PAUSE);
        self.wait(5.secs());
    }
}

const CASES_OF_PLUS: usize = 20;

static PAUSE: Request = Line("PS\r");

/// Brings a drive into a situation.
type Prepare = fn(&mut Dut);

/// A situation, a request in it, and the effect, the text and the section of its reason.
type Case = (Prepare, Request, Effect, &'static str, &'static str);

/// Cases for all reasons, in their order. The first [`CASES_OF_PLUS`] are those of an MDrivePlus².
#[rustfmt::skip]
fn cases() -> Vec<Case> {
    use Effect::{Later, Nothing, Other, Stored};
    vec![
        (|dut| dut.set(Reg::DE, 0), mr(1_000), Nothing,
            "DE is 0: the shaft does not turn, C1 only counts; write DE = 1 first", "MC 5-19"),
        (|dut| dut.fault("over_temperature", true), write(0x1C, 1, 1), Nothing,
            "too hot: the bridge is off; write DE = 1 when it has cooled down", "MDRIVE-19"),
        (Dut::at_limit, mr(1_000), Nothing,
            "the limit in this direction is active: move the other way (ER 83, 84)", "MC 5-43"),
        (Dut::moves, mr(5), Later,
            "a motion is in progress: it begins after its end and MT", "MDRIVE-18"),
        (|dut| { dut.moves(); dut.set(Reg::MR, 5); }, mr(6), Other,
            "it takes the place of the command that waited, which is lost", "MDRIVE-18"),
        (Dut::slews, mr(5), Later,
            "the motor turns at a speed: it stops first, and then moves", "MDRIVE-18"),
        (|dut| { dut.set(Reg::MT, 1_000); dut.set(Reg::MR, 10); dut.wait(500.millis()); },
            write(0x78, 2, 1_000), Later,
            "MT is in progress: SL begins after it", "MC 5-49"),
        (Dut::is_paused, mr(5), Later,
            "PS holds the motion: write RS", "MC 5-57"),
        (Dut::moves, write(0x8B, 2, 100_000), Later,
            "a move keeps its speed and ramps: it counts from the next one", "MDRIVE-17"),
        (Dut::slews, write(0x00, 2, 100_000), Later,
            "SL turns the motor: it counts from the next change of speed", "MC 5-68"),
        (Dut::slews, write(0x8B, 2, 5_000), Later,
            "SL has its own speed: VM counts from the next move; write SL", "MC 5-68"),
        (|dut| { dut.set(Reg::HT, 0); dut.set(Reg::MR, 10); dut.wait(1.secs()); }, write(0x29, 1, 10), Nothing,
            "HT is 0: the current stays at RC and never goes down to HC", "MDRIVE-19"),
        (|_| {}, write(0x2C, 1, 0), Other,
            "0 means never: the current stays at RC; write 2 to go down to HC at once", "MDRIVE-19"),
        (Dut::has_trips, write(0x7D, 1, 2), Other,
            "TE switches trips on only: write 0 first to switch the others off", "MC 5-73"),
        (|_| {}, command(*b"  SP"), Nothing,
            "nothing runs or moves, or PS holds it already", "MC 5-57"),
        (|_| {}, command(*b"  SR"), Nothing,
            "PS holds nothing: there is nothing to resume", "MC 5-61"),
        (Dut::moves, command(*b"   E"), Other,
            "E ends the program only: stop the motor by SL 0 or Esc", "MC 5-20"),
        (|_| {}, Line("PG 1\rEX 1\r"), Later,
            "program mode: the line is stored, not executed; type PG first", "MC 5-55"),
        (|dut| dut.set(Reg::CE, 0), Line("\x03"), Nothing,
            "this key is off: CE turns on Ctrl-C, ES selects Esc or Ctrl-E", "MC 5-11, 5-23"),
        (|_| {}, Line("PG 1\rVM=5000\r"), Stored, "stored in the program", "MC 5-55"),
        (Dut::is_locked, mr(1_000), Nothing,
            "the rotor was locked and the bridge is off: write CF first", "MDRIVE-30"),
        (Dut::has_torque, mr(1_000), Nothing,
            "AS is 3: torque mode makes no moves; write AS = 0, 1 or 2 first", "MDRIVE-28"),
        (|dut| dut.set(Reg::AS, 0), write(0xA1, 1, 1), Nothing,
            "AS or DE is 0, or the bridge is off: there is nothing to calibrate", "MC 5-67"),
        (|dut| dut.set(Reg::DE, 0), write(0x1C, 1, 1), Later,
            "it calibrates first: motion commands are error 88 until that is over", "MDRIVE-26"),
        (Dut::moves, write(0x8E, 1, 3), Later,
            "the motor moves: torque mode begins when it stands", "MDRIVE-28"),
        (Dut::has_torque, write(0xA5, 1, 0), Later,
            "torque mode is on: TD counts when it begins again", "MC 5-72"),
        (Dut::has_torque, write(0x67, 1, 30), Nothing,
            "AS is 3: TQ is the current, and not RC and HC", "MC 5-3"),
    ]
}

/// More requests for the reasons of [`cases`], each with the index of its case.
#[rustfmt::skip]
fn more_cases() -> Vec<(Prepare, Request, usize)> {
    vec![
        (|dut| dut.set(Reg::DE, 0), write(0x43, 2, 1_000), 0),
        (|dut| dut.set(Reg::DE, 0), write(0x78, 2, 1_000), 0),
        (|dut| dut.set(Reg::DE, 0), Line("MA 1000\r"), 0),
        (|dut| dut.set(Reg::DE, 0), Line("HI 1\r"), 0),
        (|dut| { dut.set(Reg::DE, 0); dut.set(Reg::S1, 1 << 32); }, write(0x2B, 1, 1), 0),
        (|dut| dut.fault("over_temperature", true), mr(1_000), 1),
        (Dut::at_limit, write(0x78, 2, 1_000), 2),
        (Dut::at_limit, Line("MA 1000\r"), 2),
        (Dut::moves, Line("MA 5\r"), 3),
        (|dut| { dut.moves(); dut.set(Reg::MA, 5); }, Line("MA 6\r"), 4),
        (Dut::moves, write(0x00, 2, 100_000), 8),
        (Dut::moves, write(0x18, 2, 100_000), 8),
        (Dut::moves, write(0x89, 2, 900), 8),
        (Dut::slews, Line("VM=5000\r"), 10),
        (Dut::moves, Line("E\r"), 16),
        (|_| {}, Line("PS\r"), 14),
        (Dut::is_paused, Line("PS\r"), 14),
        (|_| {}, Line("RS\r"), 15),
        (|_| {}, Line("PG 1\rL\r"), 17),
        (|_| {}, Line("PG 1\rCP\r"), 17),
    ]
}

/// The drive that a case is for.
fn drive(place: usize) -> Dut {
    if place < CASES_OF_PLUS { Dut::plus() } else { Dut::hybrid() }
}

/// Reasons of the last line of a case. The lines before it are its preparation.
fn last_reasons(dut: &mut Dut, request: &Request) -> Vec<&'static str> {
    match request {
        Line(lines) => {
            let at = lines.trim_end().rfind('\r').map_or(0, |at| at + 1);
            let (before, last) = lines.split_at(at);
            dut.connect(CLIENT);
            dut.lines(before);
            let seen = dut.out.notes.len();
            dut.lines(last);
            dut.reasons_since(seen)
        }
        Request::Bus(_) => dut.reasons_of(request),
    }
}

#[test]
fn each_reason_has_its_request() {
    let cases = cases();
    let (plus, hybrid) = (Mdrive::plus().spec().reasons, Mdrive::hybrid().spec().reasons);
    assert_eq!((plus.len(), hybrid.len()), (CASES_OF_PLUS, cases.len()));
    for (place, (prepare, request, effect, text, section)) in cases.into_iter().enumerate() {
        let mut dut = drive(place);
        prepare(&mut dut);
        assert_eq!(last_reasons(&mut dut, &request), [text]);
        let reason = hybrid[place];
        assert_eq!((reason.text, reason.effect, reason.section), (text, effect, section));
        if let Some(reason) = plus.get(place) {
            assert_eq!(reason.text, text);
        }
    }
}

#[test]
fn a_reason_may_have_several_requests() {
    for (prepare, request, place) in more_cases() {
        let mut dut = drive(place);
        prepare(&mut dut);
        assert_eq!(
            last_reasons(&mut dut, &request),
            [dut.drive.spec().reasons[place].text],
            "{request:02x?}"
        );
    }
}

#[test]
fn a_request_without_effect_changes_nothing() {
    for (place, (prepare, request, effect, text, _)) in cases().into_iter().enumerate() {
        if effect != Effect::Nothing {
            continue;
        }
        let mut dut = drive(place);
        prepare(&mut dut);
        dut.out.clear();
        dut.out.rule = |_| Treatment::Keep;
        let mut other = Dut { fixture: dut.fixture.clone() };
        last_reasons(&mut dut, &request);
        assert!(dut.out.messages.iter().all(|(_, port, ..)| *port == MODBUS), "{text}");
        other.run_until(dut.now);
        // Without a bridge the plan runs and C1 counts, but the shaft stands.
        let has_bridge = !matches!(place, 0 | 20);
        for _ in 0..2 {
            let seen = |dut: &Dut| {
                let out = dut.out.clone();
                let counted = has_bridge.then(|| (dut.get(Reg::C1), dut.get(Reg::MV), out.plans));
                let put = (out.levels, out.waves, out.steps, out.currents, out.duties, out.stores);
                (dut.get(Reg::C2), counted, put, out.closed, out.bytes)
            };
            assert_eq!(seen(&dut), seen(&other), "{text}");
            dut.wait(500.millis());
            other.wait(500.millis());
        }
    }
}

/// Sends requests, each of which must have no reason, with a wait after each.
fn without_reason(dut: &mut Dut, requests: &[Request]) {
    for request in requests {
        assert_eq!(dut.reasons_of(request), [""; 0], "{request:02x?}");
        dut.wait(5.secs());
    }
}

#[test]
fn normal_requests_have_no_reason() {
    for mut dut in [Dut::plus(), Dut::hybrid()] {
        dut.drive(1, true);
        without_reason(
            &mut dut,
            &[
                // Set-up in the order of the addresses.
                write(0x00, 2, 100_000),
                write(0x18, 2, 100_000),
                write(0x1C, 1, 1),
                write(0x29, 1, 20),
                write(0x2C, 1, 200),
                write(0x42, 1, 2),
                write(0x67, 1, 80),
                write(0x89, 2, 500),
                write(0x8B, 2, 20_000),
                Request::Bus([&[66, b' ', b' ', b'1', b'S', 6][..], b"=1,0,0"].concat()),
                write(0x57, 2, 0),
                // Save.
                write(0x76, 1, 1),
                // Moves, slews and stops.
                write(0x43, 2, 10_000),
                mr(-5_000),
                write(0x78, 2, 5_000),
                write(0x78, 2, 8_000),
                write(0x78, 2, 0),
                write(0x78, 2, 0),
                command(*b"   E"),
                write(0x7D, 1, 0),
                write(0x2B, 1, 1),
                Line("\x1B\r"),
            ],
        );
        // A program is typed and run. PS and RS hold it.
        dut.connect(CLIENT);
        for line in
            ["PG 100", "LB A3", "MR 1000", "H", "IC R1", "PR P", "BR A3", "E", "PG", "L", "TT=60000,A3"]
                .into_iter()
                .chain(["TE=8", "EX 100", "PS", "RS", "E"])
        {
            let before = dut.out.notes.len();
            dut.lines(&std::format!("{line}\r"));
            // E while a move of the program runs is another case.
            dut.wait(if line == "RS" { 1.millis() } else { 50.millis() });
            let is_stored = ["LB A3", "MR 1000", "H", "IC R1", "PR P", "BR A3"].contains(&line);
            let expected: &[&str] = if is_stored { &["stored in the program"] } else { &[] };
            if line != "E" {
                assert_eq!(dut.reasons_since(before), expected, "{line}");
            }
        }
    }
    // A Hybrid's own settings.
    without_reason(
        &mut Dut::hybrid(),
        &[
            write(0x8E, 1, 1),
            write(0xA2, 1, 20),
            write(0xA0, 1, 1),
            write(0xA1, 1, 1),
            write(0x93, 1, 1),
            write(0xA5, 1, 0),
            write(0xA6, 1, 40),
            write(0x8E, 1, 3),
            write(0xA6, 1, 50),
            write(0x8E, 1, 2),
            mr(1_000),
        ],
    );
}

/// An input that pauses or resumes nothing gives its reason to no request, and neither does a program.
#[test]
fn an_input_and_a_program_have_no_reason() {
    let mut dut = Dut::plus();
    dut.set(Reg::DE, 0);
    // Type 5 is pause.
    dut.set(Reg::S2, 5 << 32);
    dut.drive(2, true);
    dut.drive(2, false);
    assert!(dut.out.notes.is_empty());
    dut.connect(CLIENT);
    dut.lines("PG 1\rMR 1000\rH\rBR 1\rE\rPG\rEX 1\r");
    dut.wait(1.secs());
    let reasons =
        |dut: &Dut| dut.out.notes.iter().filter(|(_, note)| matches!(note, LogEvent::Reason(_))).count();
    assert!(reasons(&dut) > 1, "its lines have reasons, without a request");
    let mut before = dut.out.notes.len();
    for _ in 0..100 {
        dut.wait(1_234.micros());
        let text = dut.type_in(CLIENT, "PR R1\r");
        assert!(text.contains('0'));
        let notes = dut.out.noted().split_off(before);
        let place =
            notes.iter().position(|note| matches!(note, LogEvent::Request { port: Port(1), .. })).unwrap();
        let at = dut.out.notes[before + place].0;
        let earlier = dut.out.notes[before..before + place].iter().filter(|(time, _)| *time == at).count();
        assert_eq!(earlier, 0, "at the same time");
        before = dut.out.notes.len();
    }
}

#[test]
fn texts_are_short() {
    for reason in Mdrive::hybrid().spec().reasons {
        assert!(reason.text.len() <= 80 && !reason.text.ends_with('.'), "{}", reason.text);
    }
}
