//! The CTRL connector (p. 8 to 11; MDROBOT-21, MDROBOT-22, MDROBOT-24): contacts, PID_DI, START/STOP,
//! RUN/BRAKE, DIR.

use drivetwin_firmware::device::Level;
use drivetwin_protocol::time::Span;
use drivetwin_sim::bench::{PinStimulus, PowerAction};

use crate::pid;
use crate::rig::{BOOT, Rig};

/// Bits of PID_DI by the name of the pin (p. 11).
const BITS: [(&str, u16); 7] = [
    ("INT_SPEED", 0),
    ("ALARM_RESET", 1),
    ("DIR", 2),
    ("RUN_BRAKE", 3),
    ("START_STOP", 4),
    ("ENC_B", 5),
    ("ENC_A", 6),
];

/// A rig with TAR_VEL 500 and three wired contacts: START/STOP and DIR open, RUN/BRAKE closed.
pub(crate) fn at_500(settings: &[(u16, u16)]) -> Rig {
    let mut rig = Rig::with(settings);
    rig.write(pid::TAR_VEL, 500);
    rig.open("START_STOP");
    rig.open("DIR");
    rig.close("RUN_BRAKE");
    rig
}

/// A bit of PID_DI is 1 if the contact is closed to ground; for ENC_A and ENC_B, if it is open. A contact
/// without a wire reads as open. PIDs 36 and 37 do not invert PID_DI (MDROBOT-22).
#[test]
fn page_11_di() {
    for inversions in [0, 1] {
        for ui_com in [0, 1] {
            let settings = [(36, inversions), (37, inversions), (pid::UI_COM, ui_com)];
            let mut rig = Rig::with(&settings);
            assert_eq!(rig.read(pid::DI), 0b110_0000, "nothing wired");
            for (name, bit) in BITS {
                let encoder = bit > 4;
                rig.open(name);
                let opened = if encoder { 1 } else { 0 };
                assert_eq!(rig.read(pid::DI) >> bit & 1, opened, "{name} open");
                rig.close(name);
                assert_eq!(rig.read(pid::DI) >> bit & 1, 1 - opened, "{name} closed");
                let others = rig.read(pid::DI) & !(1 << bit);
                assert_eq!(others, if encoder { 0b110_0000 & !(1 << bit) } else { 0b110_0000 });
                // The wire is removed.
                rig.drive(name, PinStimulus::Open);
                assert_eq!(rig.read(pid::DI), 0b110_0000, "{name} not wired");
            }
            for (name, _) in BITS {
                rig.close(name);
            }
            assert_eq!(rig.read(pid::DI), 0b001_1111);
            for (name, _) in BITS {
                rig.open(name);
            }
            assert_eq!(rig.read(pid::DI), 0b110_0000);
        }
    }
}

/// TAR_VEL is used with START/STOP, RUN/BRAKE and DIR (p. 13). A low level is ON, and DIR ON is CW.
#[test]
fn page_13_tar_vel() {
    let mut rig = at_500(&[]);
    rig.assert_stands();
    rig.close("START_STOP");
    rig.assert_turns(500.0);
    rig.close("DIR");
    rig.assert_turns(-500.0);
    rig.write(pid::TAR_VEL, 800);
    rig.assert_turns(-800.0);
    rig.open("DIR");
    rig.assert_turns(800.0);
    rig.open("START_STOP");
    rig.after(20.secs());
    rig.assert_stands();
    // TAR_VEL takes precedence over the speed input.
    rig.volts("SPEED_IN", 5.0);
    rig.close("START_STOP");
    rig.assert_turns(800.0);
    // After CMD 20 has erased TAR_VEL, the speed input counts again: 1 V of 5 V is 600 of 3,000 rpm.
    rig.volts("SPEED_IN", 1.0);
    rig.command(20);
    rig.assert_turns(600.0);
}

/// RUN/BRAKE OFF brakes electrically (MDROBOT-21).
#[test]
fn page_9_run_brake() {
    let mut rig = at_500(&[]);
    rig.close("START_STOP");
    rig.assert_turns(500.0);
    rig.open("RUN_BRAKE");
    rig.after(10.millis());
    assert!(rig.amperes() > 0.5, "{} A", rig.amperes());
    rig.after(500.millis());
    assert_eq!(rig.shaft(), 0.0);
    rig.assert_stands();
    rig.close("RUN_BRAKE");
    rig.assert_turns(500.0);
}

/// "1: Inverse START/STOP signal (HIGH -> ON)", and the same for RUN/BRAKE.
#[test]
fn page_9_inversions() {
    for (start, run) in [(1, 0), (0, 1), (1, 1)] {
        let mut rig =
            Rig::with(&[(pid::START_INV_SIGN, start), (pid::RUN_INV_SIGN, run), (pid::TAR_VEL, 500)]);
        let set = |rig: &mut Rig, name: &str, on: bool, inverted: u16| {
            if on == (inverted == 0) { rig.close(name) } else { rig.open(name) }
        };
        set(&mut rig, "START_STOP", false, start);
        set(&mut rig, "RUN_BRAKE", true, run);
        rig.assert_stands();
        set(&mut rig, "START_STOP", true, start);
        rig.assert_turns(500.0);
        set(&mut rig, "RUN_BRAKE", false, run);
        rig.after(500.millis());
        assert_eq!(rig.shaft(), 0.0);
        set(&mut rig, "RUN_BRAKE", true, run);
        rig.assert_turns(500.0);
        set(&mut rig, "START_STOP", false, start);
        rig.after(20.secs());
        rig.assert_stands();
    }
}

/// Contacts without wires: START/STOP and DIR are OFF with any value of PID 36. RUN/BRAKE acts as an open
/// contact (MDROBOT-21).
#[test]
fn page_9_not_wired() {
    for inversion in [0, 1] {
        let mut rig = Rig::with(&[(pid::START_INV_SIGN, inversion), (pid::TAR_VEL, 500)]);
        rig.close("RUN_BRAKE");
        rig.assert_stands();
        assert_eq!(rig.position(), 0);
    }
    // RUN/BRAKE without a wire brakes, or runs if PID 37 is 1.
    for (inversion, rpm) in [(0, 0.0), (1, 500.0)] {
        let mut rig = Rig::with(&[(pid::RUN_INV_SIGN, inversion), (pid::TAR_VEL, 500)]);
        rig.open("START_STOP");
        rig.close("START_STOP");
        rig.assert_turns(rpm);
    }
    // DIR without a wire is CCW.
    let mut rig = Rig::with(&[(pid::TAR_VEL, 500)]);
    rig.close("RUN_BRAKE");
    rig.open("START_STOP");
    rig.close("START_STOP");
    rig.assert_turns(500.0);
}

/// With UI_COM 1 the contacts have no effect (MDROBOT-12), unless they are limit switches, which USE_LIMIT_SW
/// 0 excludes.
#[test]
fn page_7_contacts_while_the_bus_commands() {
    let mut rig = at_500(&[(pid::USE_LIMIT_SW, 0), (pid::UI_COM, 1), (pid::START_STOP, 1)]);
    rig.volts("SPEED_IN", 3.0);
    rig.close("START_STOP");
    rig.close("INT_SPEED");
    rig.assert_stands();
    rig.velocity(300);
    rig.assert_turns(300.0);
    for name in ["RUN_BRAKE", "START_STOP", "DIR", "INT_SPEED"] {
        rig.open(name);
        rig.assert_turns(300.0);
        rig.close(name);
        rig.assert_turns(300.0);
    }
}

/// A stop by START/STOP follows STOP_STATUS (MDROBOT-17) and SLOW_DOWN.
#[test]
fn page_8_stop_by_a_contact() {
    for (stop_status, free) in [(0, true), (1, false), (2, false), (3, true)] {
        let mut rig = at_500(&[(pid::STOP_STATUS, stop_status)]);
        rig.close("START_STOP");
        rig.assert_turns(500.0);
        rig.open("START_STOP");
        rig.after(400.millis());
        assert_eq!(rig.shaft() > 100.0, free, "STOP_STATUS {stop_status}: {} rpm", rig.shaft());
    }
    // 682 of 1,023 is 10 s for 3,000 rpm, and so 1.67 s for 500 rpm.
    let mut rig = at_500(&[(pid::STOP_STATUS, 2), (pid::SLOW_DOWN, 682), (pid::SLOW_START, 682)]);
    rig.close("START_STOP");
    rig.after(833.millis());
    assert!((rig.rpm() - 250.0).abs() <= 40.0, "{}", rig.rpm());
    rig.assert_turns(500.0);
    rig.open("START_STOP");
    rig.after(833.millis());
    assert!((rig.rpm() - 250.0).abs() <= 40.0, "{}", rig.rpm());
}

/// SLOW_START and SLOW_DOWN apply to the contacts, too. A reversal by DIR goes through zero (MDROBOT-16).
#[test]
fn page_13_a_reversal_by_dir() {
    // 5 s for 3,000 rpm are 0.83 s for 500 rpm.
    let mut rig = at_500(&[(pid::SLOW_START, 341), (pid::SLOW_DOWN, 341)]);
    rig.close("START_STOP");
    rig.assert_turns(500.0);
    rig.close("DIR");
    rig.after(417.millis());
    assert!((rig.rpm() - 250.0).abs() <= 80.0, "{}", rig.rpm());
    rig.after(417.millis());
    assert!(rig.rpm().abs() <= 80.0, "{}", rig.rpm());
    rig.after(417.millis());
    assert!((rig.rpm() + 250.0).abs() <= 80.0, "{}", rig.rpm());
    rig.assert_turns(-500.0);
}

/// INV_SIGN_CMD inverts commands of the pins, too (MDROBOT-15).
#[test]
fn page_7_inv_sign_of_contacts() {
    let mut rig = at_500(&[(pid::INV_SIGN_CMD, 1)]);
    rig.close("START_STOP");
    rig.assert_turns(-500.0);
    rig.close("DIR");
    rig.assert_turns(500.0);
}

/// ALARM is low during an alarm. With INV_ALARM it is low while there is none (MDROBOT-26).
#[test]
fn page_8_inv_alarm() {
    for (inverted, normal, alarm) in [(0, Level::High, Level::Low), (1, Level::Low, Level::High)] {
        let mut rig = Rig::with(&[(pid::INV_ALARM, inverted)]);
        rig.after(1.millis());
        assert_eq!(rig.level("ALARM"), normal);
        rig.fault("over_temperature", true);
        assert_eq!(rig.level("ALARM"), alarm);
        rig.write(pid::INV_ALARM, 1 - inverted);
        rig.after(1.millis());
        assert_eq!(rig.level("ALARM"), normal, "turned round while it lasts");
        rig.write(pid::INV_ALARM, inverted);
        rig.fault("over_temperature", false);
        rig.write(pid::ALARM_RESET, 0);
        rig.after(1.millis());
        assert_eq!(rig.level("ALARM"), normal);
        rig.power_cycle();
        assert_eq!(rig.level("ALARM"), normal, "from power-on on");
    }
}

/// The motor does not move in the 300 ms after power-on (MDROBOT-11). A contact that closes in that time
/// takes effect after it.
#[test]
fn page_11_contacts_at_power_on() {
    let mut rig = at_500(&[]);
    rig.bench.power(rig.seat, PowerAction::Off);
    rig.after(1.secs());
    rig.bench.power(rig.seat, PowerAction::On);
    rig.after(100.millis());
    rig.close("START_STOP");
    rig.after(BOOT - 110.millis());
    assert_eq!(rig.motion().position, 0);
    rig.after(20.millis());
    assert_eq!(rig.read(pid::DI) & 0b1_1100, 0b1_1000, "RUN/BRAKE and START/STOP");
}
