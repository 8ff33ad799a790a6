//! Tests of the reasons why the drive does not do what a request says, although it accepts the request.

use super::*;
use crate::device::Effect;
use crate::rs434::reasons::REASONS;

type Dut = Fixture<DriveWithMotor<Rs434>>;

/// Function 6.
fn write(address: u16, value: u16) -> Vec<u8> {
    [&[6][..], &address.to_be_bytes(), &value.to_be_bytes()].concat()
}

/// Function 16 with a value of 32 bits, its low word first.
fn write_long(address: u16, value: i32) -> Vec<u8> {
    let [low, high] = [value as u16, (value >> 16) as u16].map(u16::to_be_bytes);
    [&[16][..], &address.to_be_bytes(), &[0, 2, 4], &low, &high].concat()
}

/// Function 5.
fn coil(address: u16, on: bool) -> Vec<u8> {
    [&[5][..], &address.to_be_bytes(), &[if on { 0xFF } else { 0 }, 0]].concat()
}

/// START_bit = 1.
fn start() -> Vec<u8> {
    coil(0x2000, true)
}

impl Dut {
    /// Sends a request, which the drive must accept, and returns the texts of its reasons. They must come
    /// before the note of the request.
    fn reasons_of(&mut self, pdu: &[u8]) -> Vec<&'static str> {
        let before = self.out.notes.len();
        assert_eq!(self.pdu(pdu)[0], pdu[0], "{pdu:02X?}");
        let notes = self.out.noted().split_off(before);
        let end = notes.iter().position(|note| matches!(note, LogEvent::Request { .. })).unwrap();
        let reasons = notes[..end].iter().map(|note| match note {
            LogEvent::Reason(reason) => self.drive.spec().reasons[usize::from(reason.0)].text,
            other => panic!("{other:?}"),
        });
        reasons.collect()
    }

    /// A move of 100,000 counts by OFFSET has been running for 0.5 s.
    fn moves(&mut self) {
        self.set(Reg::MODE_ROTATION, 2);
        self.set(Reg::OFFSET, 100_000);
        self.set(Reg::START_bit, 1);
        self.wait(500.millis());
    }

    /// Continuous rotation has been running for 0.5 s.
    fn rotates(&mut self) {
        self.set(Reg::START_bit, 1);
        self.wait(500.millis());
    }

    /// A program that only waits runs from the flash.
    fn runs_program(&mut self) {
        // CMD_DELAY of 60,000 ms.
        self.set(Reg::CMD_W, 0x04 | 60_000 << 16);
        self.set(Reg::WRITE_CMD, 0);
        self.set(Reg::FLAG_SAVE_USER_PROGRAM, 0x8426);
        self.wait(100.millis());
        self.set(Reg::MODE_USER_PROGRAM, 2);
        self.wait(1.millis());
    }

    /// The flash holds half a program.
    fn spoils_program(&mut self) {
        self.out.memory[SETTINGS] ^= 1;
        self.cycle();
    }
}

/// Brings a drive into a situation.
type Prepare = fn(&mut Dut);

/// A situation, a request in it, and the effect, the text and the section of its reason.
type Case = (Prepare, Vec<u8>, Effect, &'static str, &'static str);

/// Cases for all reasons, in their order.
#[rustfmt::skip]
fn cases() -> Vec<Case> {
    use Effect::{Later, Nothing, Other};
    vec![
        (|dut| dut.set(Reg::MODE_DEVICE, 2), start(), Nothing,
            "MODE_DEVICE is 2: only IN1 and IN2 start the motor; write 1 first", "6.5"),
        (|dut| dut.contact(HARD_STOP, false), start(), Nothing,
            "ERROR stops the motor: take the cause away, then restart by FLAG_RESTART", "6.5"),
        (Dut::moves, start(), Nothing,
            "a move runs: START_bit is ignored and not queued; STOP_bit first", "RS434-15"),
        (|dut| { dut.rotates(); dut.set(Reg::MODE_ROTATION, 2); }, start(), Nothing,
            "the motor rotates: STOP_bit first, then START_bit of a move", "RS434-15"),
        (|dut| { dut.set(Reg::MODE_ROTATION, 3); dut.set(Reg::USE_HALL, 1); }, start(), Nothing,
            "a move needs USE_HALL = 2: bit 15 of ERROR is set", "RS434-18"),
        (|dut| dut.set(Reg::MODE_ROTATION, 2), start(), Nothing,
            "OFFSET is 0 (a move counts it down): write it again, or OFFSET_CONST", "6.5"),
        (|dut| dut.set(Reg::MODE_ROTATION, 3), start(), Nothing,
            "CURRENT_POSITION is the selected TARGET_POSITION already", "6.5"),
        (|dut| {
            dut.set(Reg::MODE_ROTATION, 3);
            dut.set(Reg::TARGET_POSITION1, 10);
            dut.set(Reg::OFFSET_COMPENSATION, -10);
        }, start(), Nothing,
            "OFFSET_COMPENSATION takes the whole distance: no motion", "RS434-17"),
        (Dut::rotates, coil(0x2000, false), Nothing,
            "0 does nothing: to stop the motor write 1 to STOP_bit", "6.2"),
        (|_| {}, write(0x5000, 2), Later,
            "it counts after FLAG_SAVE_INI = 37FAh and FLAG_RESTART = 95AFh", "6.4"),
        (|_| {}, write(0x5005, 3), Later,
            "the program starts at power-on, if FLAG_SAVE_INI has saved this", "6.5"),
        (Dut::runs_program, write(0x5005, 2), Nothing,
            "the program runs already: write MODE_USER_PROGRAM = 1 first", "RS434-26"),
        (|_| {}, write(0x5005, 2), Nothing,
            "no program is saved: write 8426h to FLAG_SAVE_USER_PROGRAM first", "RS434-28"),
        (Dut::spoils_program, write(0x5025, 0x9346), Nothing,
            "the program in flash is bad: save it again by 8426h", "RS434-11"),
        (|_| {}, write_long(0x6004, 5), Nothing,
            "CMD_R only shows the line of READ_CMD: write CMD_W and WRITE_CMD", "6.6"),
        (|_| {}, write(0x5026, 0), Nothing,
            "0 is no key: write the key of this register (37FAh, 8426h, 9346h, 95AFh)", "RS434-2"),
        (|dut| dut.contact(HARD_STOP, false), write(0x5023, 0), Nothing,
            "bits 0 to 7, 9 and 10 stay until a restart: FLAG_RESTART = 95AFh", "RS434-23"),
        (|dut| dut.fault("current_limit", true), write(0x5023, 0), Nothing,
            "the cause remains and sets the bit again: take it away first", "RS434-23"),
        (|_| {}, write_long(0x5019, 100), Nothing,
            "START_bit overwrites it: write TARGET_POSITION1 to 4 and POSITION_N", "6.5"),
        (|dut| dut.set(Reg::OFFSET_CONST, 7), write_long(0x5015, 100), Nothing,
            "OFFSET_CONST is not 0: START_bit copies it to OFFSET; write OFFSET_CONST", "6.5"),
        (Dut::moves, write_long(0x5015, 100), Nothing,
            "a move runs and counts OFFSET down: write it when the motor stands", "RS434-16"),
        (|dut| { dut.set(Reg::MODE_DEVICE, 2); dut.set(Reg::MODE_EXT_IN, 5); }, write(0x500E, 2), Nothing,
            "MODE_EXT_IN is 5: IN1 and IN2 give the direction", "6.5"),
        (Dut::moves, write(0x500B, 1_500), Later,
            "a move keeps its speed and ramps: it counts from the next START_bit", "RS434-15"),
        (Dut::rotates, write(0x5006, 2), Later,
            "the motor turns: it counts from the next START_bit", "RS434-15"),
        (|_| {}, write(0x500B, 3_001), Other,
            "more than RATED_SPEED: as fast as the supply allows", "RS434-19"),
    ]
}

/// More requests for reasons of [`cases`].
#[rustfmt::skip]
fn more_cases() -> Vec<(Prepare, Vec<u8>, usize)> {
    vec![
        (|dut| dut.fault("mcu_overheat", true), start(), 1),
        (|dut| { dut.moves(); dut.set(Reg::MODE_ROTATION, 1); }, start(), 2),
        (|dut| { dut.set(Reg::MODE_ROTATION, 2); dut.set(Reg::USE_HALL, 0); }, start(), 4),
        // After a move OFFSET is 0 (RS434-16).
        (|dut| {
            dut.set(Reg::MODE_ROTATION, 2);
            dut.set(Reg::OFFSET, 40);
            dut.set(Reg::START_bit, 1);
            dut.wait(5.secs());
        }, start(), 5),
        (|_| {}, coil(0x2001, false), 8),
        (|_| {}, coil(0x2003, false), 8),
        (|_| {}, vec![15, 0x20, 0, 0, 4, 1, 0], 8),
        (|_| {}, write(0x5001, 4), 9),
        (|_| {}, write(0x5002, 4), 9),
        (|_| {}, write(0x5003, 4), 9),
        (Dut::spoils_program, write(0x5005, 2), 13),
        (|_| {}, write(0x5024, 0), 15),
        (|_| {}, write(0x5025, 0), 15),
        (Dut::moves, write(0x500C, 200), 22),
        (Dut::moves, write(0x500D, 200), 22),
        (Dut::rotates, write(0x5008, 2), 23),
        (Dut::rotates, write_long(0x5017, 2), 23),
        (Dut::rotates, write_long(0x501B, 2), 23),
        (Dut::rotates, write_long(0x5021, 2), 23),
    ]
}

#[test]
fn each_reason_has_its_request() {
    let cases = cases();
    assert_eq!(cases.len(), REASONS.len());
    for ((prepare, request, effect, text, section), reason) in cases.into_iter().zip(REASONS) {
        let mut dut = ready();
        prepare(&mut dut);
        assert_eq!(dut.reasons_of(&request), [text]);
        assert_eq!((reason.text, reason.effect, reason.section), (text, effect, section));
    }
}

#[test]
fn a_reason_may_have_several_requests() {
    for (prepare, request, place) in more_cases() {
        let mut dut = ready();
        prepare(&mut dut);
        assert_eq!(dut.reasons_of(&request), [REASONS[place].text], "{request:02X?}");
    }
}

#[test]
fn a_request_without_effect_changes_nothing() {
    for (prepare, request, effect, text, _) in cases() {
        if effect != Effect::Nothing {
            continue;
        }
        let mut dut = ready();
        prepare(&mut dut);
        dut.out.clear();
        let mut other = dut.clone();
        dut.reasons_of(&request);
        other.run_until(dut.now);
        for _ in 0..2 {
            let seen = |dut: &Dut| {
                let mut out = dut.out.clone();
                // A bit of ERROR changes the lights, so the lights are not compared.
                out.levels.retain(|(_, pin, _)| ![RED, GREEN].contains(pin));
                let (shaft, status) = (dut.drive.shaft(dut.now, Axis(0)), dut.get(Reg::STATUS));
                (shaft, status, dut.get(Reg::CURRENT_POSITION), out.levels, out.stores, out.lines)
            };
            assert_eq!(seen(&dut), seen(&other), "{text}");
            dut.wait(500.millis());
            other.wait(500.millis());
        }
        assert_eq!(dut.out.bytes.len(), 1, "{text}");
    }
}

#[test]
fn normal_requests_have_no_reason() {
    let mut dut = ready();
    let mut send = |requests: &[Vec<u8>], wait: Duration| {
        for request in requests {
            assert_eq!(dut.reasons_of(request), [""; 0], "{request:02X?}");
        }
        dut.wait(wait);
    };
    // Set-up in the order of the addresses; values for other modes come first.
    send(
        &[
            write(0x5004, 1),
            write(0x5006, 1),
            write(0x5007, 2),
            write(0x5008, 2),
            write(0x5009, 10_000),
            write(0x500A, 3_000),
            write(0x500B, 1_500),
            write(0x500C, 200),
            write(0x500D, 200),
            write(0x500E, 2),
            write(0x5010, 2),
            write(0x5011, 1),
            write(0x5012, 0),
            write(0x5013, 20),
            write_long(0x5015, 400),
            write_long(0x501B, 300),
            write(0x5023, 0),
            write(0x5024, 0x37FA),
        ],
        100.millis(),
    );
    // Continuous rotation, which follows SPEED and DIRECTION.
    send(&[start()], 500.millis());
    send(&[start(), write(0x500B, 2_000), write(0x500E, 1)], 500.millis());
    send(&[coil(0x2001, true)], 3.secs());
    // STOP of a motor that stands.
    send(&[coil(0x2001, true), coil(0x2002, true), coil(0x2003, true)], 100.millis());
    // A move by OFFSET, and another one after a stop.
    send(&[write(0x5006, 2), write_long(0x5015, 4_000), start()], 300.millis());
    send(&[vec![15, 0x20, 0, 0, 4, 1, 0b0010]], 3.secs());
    send(&[start()], 9.secs());
    send(&[write_long(0x5015, -400), start()], 3.secs());
    // A move to a position.
    send(&[write(0x5006, 3), write_long(0x501B, 300), write(0x5008, 1), start()], 3.secs());
    // A program.
    let [line, end] = [[0x04, 100], [0, 0]];
    let stored = |n: u8, [code, data]: [u8; 2]| vec![16, 0x60, 0, 0, 3, 6, 0, n, 0, code, 0, data];
    send(&[stored(0, line), stored(1, end), write(0x6003, 1), write(0x5025, 0x8426)], 100.millis());
    send(&[write(0x5025, 0x9346), write(0x5005, 2)], 10.millis());
    send(&[write(0x5005, 1), write(0x5005, 2)], 1.secs());
    send(&[write(0x7000, 5), write(0x5026, 0x95AF)], 1.secs());
    send(&[start()], 100.millis());
    send(&[coil(0x2002, true)], 1.secs());
}

/// A contact that starts nothing gives its reason to no request.
#[test]
fn a_contact_has_no_reason() {
    let mut dut = saved(&[(Reg::MODE_DEVICE, 2), (Reg::MODE_EXT_IN, 3), (Reg::MODE_ROTATION, 2)]);
    dut.contact(IN1, true);
    dut.wait(1.secs());
    dut.write(0x5007, 3);
    assert!(dut.out.notes.iter().all(|(_, note)| !matches!(note, LogEvent::Reason(_))));
}

#[test]
fn texts_are_short() {
    let of_models = [Rs434::rs434544(), Rs434::rs434546()].map(|drive| drive.spec().reasons.len());
    assert_eq!(of_models, [REASONS.len(); 2]);
    for reason in REASONS {
        assert!(reason.text.len() <= 80 && !reason.text.ends_with('.'), "{}", reason.text);
    }
}
