//! Tests of the reasons why the drive does not do what a request says, although it accepts the request.

use super::*;
use crate::device::Effect::{self, Later, Nothing, Other};

impl Fixture<Md3> {
    /// Writes a register over the bus. Returns the reasons, which come before the note of the request.
    fn reasons_of(&mut self, address: u16, value: u16) -> Vec<(Effect, &'static str, &'static str)> {
        let before = self.out.notes.len();
        self.write(address, value);
        let mut notes = self.out.noted().split_off(before);
        assert_eq!(notes.pop(), Some(LogEvent::Request { port: Port(0), unit: 1, function: 6 }));
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
        let out = &self.out;
        let motor = out.plans.len() + out.steps.len() + out.currents.len() + out.duties.len();
        motor + out.levels.len() + out.waves.len() + out.stores.len() + out.lines.len()
    }

    fn presets(&mut self, presets: &[(Reg, i64)]) {
        for (reg, value) in presets {
            self.preset(*reg, *value);
        }
    }
}

/// A set-up, an address, a value, and the expected effect, text and section.
type Case = (fn(&mut Fixture<Md3>), u16, u16, Effect, &'static str, &'static str);

/// A case for each reason, in the order of the reasons, and further cases.
#[rustfmt::skip]
const CASES: &[Case] = &[
    (|dut| dut.fault("over_current", true), 0x11, 0x01, Nothing, "Fault is 1: the motor does not move; write 1 to bit 15 first", "7.15"),
    (|dut| dut.preset(Reg::MotionControl, DISABLE), 0x11, 0x21, Other, "Disable (bit 5) is 1 in this write: write Move, Jog or Home without it", "7.15"),
    (|dut| { dut.preset(Reg::PinFunctionAndPolarity, 2 << 8); dut.pin(3, false); }, 0x11, 0x01, Nothing, "INHIBIT_MODBUS_MOTION (J2 pin 3) is active: only Disable counts", "7.8"),
    (|dut| dut.pin(3, false), 0x11, 0x01, Nothing, "INHIBIT (J2 pin 3) is active: no current, the steps are lost", "7.8"),
    (|dut| dut.preset(Reg::MotorCurrentAndMicrostepping, 0x0300), 0x11, 0x01, Nothing, "the current is 0: set bits 7:0 of MotorCurrentAndMicrostepping (or of 0x02)", "7.2"),
    (|dut| dut.preset(Reg::MotionControl, MOVE), 0x11, 0x01, Nothing, "a motion runs: ignored, not queued; Stop, or wait until bits 4:0 are 0", "MD3-4"),
    (|dut| dut.preset(Reg::MoveSteps, 0), 0x11, 0x01, Nothing, "MoveSteps is 0: there is nothing to move", "7.16"),
    (|dut| dut.preset(Reg::Speed, 0), 0x11, 0x01, Nothing, "Speed is 0: nothing moves", "7.17"),
    (|dut| { dut.presets(&[(Reg::HomingConfiguration, 2 << 1), (Reg::PinFunctionAndPolarity, 1 << 10), (Reg::AlternateSpeed, 0)]); dut.pin(2, false); },
        0x11, 0x01, Nothing, "SPEEDSEL selects AlternateSpeed, which is 0: nothing moves", "7.18"),
    (|dut| dut.preset(Reg::AccelDecel, 0), 0x11, 0x01, Nothing, "AccelDecel is 0: nothing moves", "7.19"),
    (|dut| dut.preset(Reg::MotorCurrentAndMicrostepping, 0x250a), 0x11, 0x01, Nothing, "the motor mode is DC (0x01 bit 13): only Jog works", "7.2"),
    (|dut| dut.preset(Reg::HomingConfiguration, 4 << 1), 0x11, 0x04, Nothing, "this homing mode (0x04 bits 3:1) does not exist: Home does nothing", "7.5"),
    (|dut| dut.pin(2, false), 0x11, 0x04, Nothing, "the home flag is active already, HomeOffset is 0: Home does not move", "7.5"),
    (|_| {}, 0x11, 0x09, Other, "several bits: only the first of Stop, Decel-stop, Home, Jog, Move counts", "7.15"),
    (|dut| dut.fault("over_temperature", true), 0x11, 0x8000, Nothing, "still too hot: Fault stays 1; write bit 15 again when it has cooled", "7.15"),
    (|dut| dut.preset(Reg::MotionControl, MOVE), 0x15, 2_000, Later, "a move runs: the new value counts from the next move", "7.17"),
    (|dut| dut.preset(Reg::Speed, 50_000), 0x11, 0x01, Other, "a speed acts as 40,000 at most", "7.17"),
    (|_| {}, 0x01, 0x031f, Other, "this current code is not in the table: it acts as the last one", "7.2"),
    (|_| {}, 0x01, 0x090a, Other, "this microstepping or PWM code is not in the table: it acts as 8", "7.2"),
    (|_| {}, 0x03, 100, Later, "StartupDelay counts from the next power-on, if EEPROMControl saves it", "7.4"),
    (|_| {}, 0x1a, 3, Other, "bits 0 and 1 together: it saves, and does not read", "7.20"),
    (|dut| dut.preset(Reg::EEPROMControl, 1), 0x1a, 2, Nothing, "a save runs: ignored; wait until bit 0 reads 0", "7.20"),
    (|dut| { dut.preset(Reg::EEPROMControl, 1); dut.wait(20.millis()); dut.out.memory[0] ^= 1; },
        0x1a, 2, Nothing, "the EEPROM's CRC fails (0xF1): nothing is read; save first", "7.20"),

    (|dut| dut.fault("over_current", true), 0x11, 0x02, Nothing, "Fault is 1: the motor does not move; write 1 to bit 15 first", "7.15"),
    (|dut| dut.fault("over_current", true), 0x11, 0x04, Nothing, "Fault is 1: the motor does not move; write 1 to bit 15 first", "7.15"),
    (|dut| { dut.preset(Reg::PinFunctionAndPolarity, 2 << 8); dut.pin(3, false); }, 0x11, 0x08, Nothing, "INHIBIT_MODBUS_MOTION (J2 pin 3) is active: only Disable counts", "7.8"),
    (|dut| dut.preset(Reg::MotorCurrentAndMicrostepping, 0x0300), 0x11, 0x02, Nothing, "the current is 0: set bits 7:0 of MotorCurrentAndMicrostepping (or of 0x02)", "7.2"),
    (|dut| dut.preset(Reg::MotorCurrentAndMicrostepping, 0x0300), 0x11, 0x04, Nothing, "the current is 0: set bits 7:0 of MotorCurrentAndMicrostepping (or of 0x02)", "7.2"),
    (|dut| { dut.presets(&[(Reg::HomingConfiguration, 2 << 1)]); dut.pin(2, false); },
        0x11, 0x01, Nothing, "the current is 0: set bits 7:0 of MotorCurrentAndMicrostepping (or of 0x02)", "7.2"),
    (|dut| dut.preset(Reg::MotionControl, MOVE), 0x11, 0x02, Nothing, "a motion runs: ignored, not queued; Stop, or wait until bits 4:0 are 0", "MD3-4"),
    (|dut| dut.preset(Reg::MotionControl, JOG), 0x11, 0x04, Nothing, "a motion runs: ignored, not queued; Stop, or wait until bits 4:0 are 0", "MD3-4"),
    (|dut| dut.preset(Reg::Speed, 0), 0x11, 0x02, Nothing, "Speed is 0: nothing moves", "7.17"),
    (|dut| dut.preset(Reg::Speed, 0), 0x11, 0x04, Nothing, "Speed is 0: nothing moves", "7.17"),
    (|dut| dut.preset(Reg::AccelDecel, 0), 0x11, 0x02, Nothing, "AccelDecel is 0: nothing moves", "7.19"),
    (|dut| dut.preset(Reg::AccelDecel, 0), 0x11, 0x04, Nothing, "AccelDecel is 0: nothing moves", "7.19"),
    (|dut| dut.preset(Reg::MotorCurrentAndMicrostepping, 0x250a), 0x11, 0x04, Nothing, "the motor mode is DC (0x01 bit 13): only Jog works", "7.2"),
    (|dut| dut.preset(Reg::MotionControl, MOVE), 0x13, 2_000, Later, "a move runs: the new value counts from the next move", "7.17"),
    (|dut| dut.preset(Reg::MotionControl, MOVE), 0x17, 2_000, Later, "a move runs: the new value counts from the next move", "7.17"),
    (|_| {}, 0x02, 0x001f, Other, "this current code is not in the table: it acts as the last one", "7.2"),
    (|dut| dut.preset(Reg::EEPROMControl, 1), 0x1a, 1, Nothing, "a save runs: ignored; wait until bit 0 reads 0", "7.20"),
];

#[test]
fn each_reason_comes_with_its_request() {
    for (n, (set_up, address, value, effect, text, section)) in CASES.iter().enumerate() {
        let mut dut = ready();
        set_up(&mut dut);
        let before = dut.outputs();
        assert_eq!(dut.reasons_of(*address, *value), [(*effect, *text, *section)], "{n}");
        // A plan runs without current, and a save that runs ends; all other requests do nothing.
        let runs = ["current", "a save runs"].iter().any(|part| text.contains(part));
        if *effect == Nothing && !runs {
            assert_eq!(dut.outputs(), before, "{text}");
        }
    }
}

#[test]
fn each_reason_has_a_case_and_a_short_text() {
    let reasons = Md3::new().spec().reasons;
    let texts: Vec<_> = reasons.iter().map(|reason| reason.text).collect();
    let tested: Vec<_> = CASES.iter().take(reasons.len()).map(|case| case.4).collect();
    assert_eq!(tested, texts);
    for text in texts {
        assert!(text.len() <= 80, "{text}: {}", text.len());
    }
}

#[test]
fn the_low_current_version_has_another_last_code() {
    for (code, exists) in [(0x24, true), (0x25, false)] {
        let mut dut = Fixture::new(Md3::low()).ready();
        assert_eq!(dut.reasons_of(0x01, 0x0300 | code).is_empty(), exists, "{code:#x}");
    }
    assert_eq!(ready().reasons_of(0x01, 0x031e), []);
}

#[test]
fn the_usual_life_of_a_drive_has_no_reason() {
    let mut dut = ready();
    let write = |dut: &mut Fixture<Md3>, address, value| {
        assert_eq!(dut.reasons_of(address, value), [], "{address:#x} = {value:#x}");
    };
    for (address, value) in [
        // Set-up, with the home flag on J2 pin 2 and homing backward with a ramp; saved.
        (0x01, 0x0414),
        (0x02, 0x0a05),
        (0x04, 0x0012),
        (0x06, 0),
        (0x08, 100),
        (0x09, 0x0000),
        (0x0a, 0x0080),
        (0x0c, 0x0005),
        (0x0d, 3_999),
        (0x12, 0),
        (0x13, 2_000),
        (0x14, 0),
        (0x15, 4_000),
        (0x17, 1_000),
        (0x18, 0),
        (0x19, 40_000),
        (0x1a, 1),
    ] {
        write(&mut dut, address, value);
    }
    dut.wait(20.millis());
    write(&mut dut, 0x1a, 2);
    // Commands a home cycle.
    write(&mut dut, 0x11, 0x04);
    dut.wait(1.secs());
    dut.pin(2, false);
    dut.wait(1.secs());
    dut.pin(2, true);
    assert_eq!(dut.control(), 0);
    // Commands a move, a jog with two speeds, and all stops, also stops of a motor that stands.
    write(&mut dut, 0x11, 0x01);
    dut.wait(2.secs());
    assert_eq!(dut.control(), 0);
    write(&mut dut, 0x11, 0x02);
    write(&mut dut, 0x15, 3_000);
    write(&mut dut, 0x11, 0x02);
    write(&mut dut, 0x11, 0x10);
    dut.wait(1.secs());
    for stop in [0x08, 0x10, 0x20, 0x08, 0x00] {
        write(&mut dut, 0x11, stop);
    }
    write(&mut dut, 0x11, 0x01);
    write(&mut dut, 0x11, 0x08);
    // A fault, which a write of both bits clears before it moves; a move while disabled enables.
    dut.fault("over_current", true);
    dut.fault("over_current", false);
    write(&mut dut, 0x11, 0x8001);
    write(&mut dut, 0x11, 0x20);
    write(&mut dut, 0x11, 0x01);
    assert_eq!(dut.control(), MOVE);
}

#[test]
fn what_a_loaded_register_does_is_no_reason_of_the_request() {
    let mut dut = ready();
    dut.presets(&[(Reg::MotorCurrentAndMicrostepping, 0x030a), (Reg::StartupDelay, 100)]);
    dut.preset(Reg::CurrentCutbackSettings, 0x00FF);
    dut.preset(Reg::EEPROMControl, 1);
    dut.wait(20.millis());
    dut.preset(Reg::MotionControl, HOME);
    assert_eq!(dut.reasons_of(0x1a, 2), []);
}
