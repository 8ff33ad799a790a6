//! PID_COMMAND (p. 6, p. 7) and the PIDs that do the same.

use drivetwin_firmware::device::{Level, Port};
use drivetwin_protocol::time::Span;

use crate::pid;
use crate::rig::Rig;
use crate::table::{TABLE, Type};

/// Values of all PIDs that can be read and written.
fn image(rig: &mut Rig) -> Vec<Vec<u16>> {
    let rows = TABLE.iter().filter(|row| row.kind == Type::RW);
    rows.map(|row| rig.words(row.pid, row.words.len() as u16)).collect()
}

/// "Tq-off, motor free state": by CMD 2, or by PID 5 with any word. The motor coasts without current, and the
/// next command drives it (MDROBOT-14).
#[test]
fn page_6_tq_off() {
    for (pid, word) in [(pid::COMMAND, 2), (pid::TQ_OFF, 0), (pid::TQ_OFF, 1), (pid::TQ_OFF, 0xFFFF)] {
        let mut rig = Rig::armed(&[]);
        rig.velocity(1_000);
        rig.assert_turns(1_000.0);
        rig.write(pid, word);
        rig.after(2.millis());
        for _ in 0..100 {
            assert_eq!(rig.motion().current_ma, 0, "free");
            rig.after(1.millis());
        }
        assert!(rig.shaft() > 800.0, "it coasts: {}", rig.shaft());
        rig.after(20.secs());
        assert_eq!(rig.shaft(), 0.0);
        // The earlier command does not resume.
        rig.assert_stands();
        rig.velocity(-500);
        rig.assert_turns(-500.0);
    }
}

/// "Electric brake": by CMD 4, or by PID 6 with any word.
#[test]
fn page_6_brake() {
    for (pid, word) in [(pid::COMMAND, 4), (pid::BRAKE, 0), (pid::BRAKE, 0x1234)] {
        let mut rig = Rig::armed(&[]);
        rig.velocity(1_000);
        rig.assert_turns(1_000.0);
        rig.write(pid, word);
        rig.after(10.millis());
        assert!(rig.amperes() > 1.0, "shorted windings carry a current: {}", rig.amperes());
        rig.after(1.secs());
        assert_eq!(rig.shaft(), 0.0);
        rig.assert_stands();
        rig.velocity(500);
        rig.assert_turns(500.0);
    }
}

/// TQ_OFF and BRAKE work whether the bus or the pins command (MDROBOT-12).
#[test]
fn page_6_tq_off_and_brake_of_the_other_side() {
    for code in [2, 4] {
        let mut rig = Rig::with(&[(pid::TAR_VEL, 500)]);
        rig.open("START_STOP");
        rig.close("RUN_BRAKE");
        rig.close("START_STOP");
        rig.assert_turns(500.0);
        rig.command(code);
        rig.after(20.secs());
        // START/STOP is still ON. It must be off once before it drives the motor (MDROBOT-14).
        rig.assert_stands();
        rig.open("START_STOP");
        rig.after(100.millis());
        rig.close("START_STOP");
        rig.assert_turns(500.0);
    }
}

/// CMD 10 and PID 13 set the present position to 0. A position that is being held stays where it is
/// (MDROBOT-19).
#[test]
fn page_6_posi_reset() {
    for (pid, word) in [(pid::COMMAND, 10), (pid::POSI_RESET, 0), (pid::POSI_RESET, 0xABCD)] {
        let mut rig = Rig::with(&[(pid::UI_COM, 1)]);
        rig.write_long(pid::POSI_CMD, 240);
        rig.after(5.secs());
        assert!((239..=241).contains(&rig.position()), "{}", rig.position());
        let error = rig.long(pid::TAR_POSI) - rig.position();
        let shaft = rig.motion().position;
        rig.write(pid, word);
        assert_eq!(rig.position(), 0);
        assert_eq!(rig.long(pid::TAR_POSI), error);
        rig.after(2.secs());
        assert!(rig.motion().position.abs_diff(shaft) <= 1, "nothing jerks");
        rig.write_long(pid::POSI_CMD, 120);
        rig.after(5.secs());
        assert!((119..=121).contains(&rig.position()), "{}", rig.position());
        assert!(rig.motion().position.abs_diff(shaft + 120) <= 2);
    }
}

#[test]
fn page_6_posi_reset_while_it_turns() {
    let mut rig = Rig::armed(&[]);
    rig.velocity(1_000);
    rig.assert_turns(1_000.0);
    rig.command(10);
    assert_eq!(rig.position(), 0);
    rig.after(3.secs());
    // 50 turns with 12 counts each.
    assert!((587..=613).contains(&rig.position()), "{}", rig.position());
    assert!((rig.rpm() - 1_000.0).abs() <= 10.0);
}

/// CMD 15 and 16 switch the output FAN on and off, CMD 17 and 18 the output CLUTCH (MDROBOT-26).
#[test]
fn page_6_fan_and_clutch() {
    let mut rig = Rig::default();
    let look = |rig: &Rig| ["FAN", "CLUTCH"].map(|name| rig.level(name) == Level::High);
    assert_eq!(look(&rig), [false, false]);
    for (code, on) in [
        (15, [true, false]),
        (17, [true, true]),
        (16, [false, true]),
        (16, [false, true]),
        (18, [false, false]),
        (17, [false, true]),
    ] {
        rig.command(code);
        rig.after(1.millis());
        assert_eq!(look(&rig), on, "CMD {code}");
    }
    rig.power_cycle();
    assert_eq!(look(&rig), [false, false]);
}

/// The commands "erase" and "cancel" (20 to 22, 25 to 29, 32, 46, 47) restore defaults of PIDs permanently
/// (MDROBOT-10).
#[test]
fn page_6_erase_and_cancel_commands_restore_defaults() {
    let filled: [(u16, u16); 10] = [
        (pid::TAR_VEL, 700),
        (pid::SLOW_START, 11),
        (pid::SLOW_DOWN, 12),
        (pid::MAX_LOAD, 50),
        (pid::ENC_PPR, 1_000),
        (pid::LOW_SPEED_LIMIT, 100),
        (pid::HIGH_SPEED_LIMIT, 900),
        (pid::INPUT_TYPE, 5),
        (pid::MAX_RPM, 1_234),
        (pid::HALL_TYPE, 3),
    ];
    let erased: [(u16, &[(u16, u16)]); 11] = [
        (20, &[(pid::TAR_VEL, 0)]),
        (21, &[(pid::SLOW_START, 0)]),
        (22, &[(pid::SLOW_DOWN, 0)]),
        (25, &[(pid::MAX_LOAD, 200)]),
        (26, &[(pid::ENC_PPR, 0)]),
        (27, &[(pid::LOW_SPEED_LIMIT, 0)]),
        (28, &[(pid::HIGH_SPEED_LIMIT, 0)]),
        (29, &[(pid::LOW_SPEED_LIMIT, 0), (pid::HIGH_SPEED_LIMIT, 0)]),
        (32, &[(pid::INPUT_TYPE, 0)]),
        (46, &[(pid::MAX_RPM, 3_000)]),
        (47, &[(pid::HALL_TYPE, 0)]),
    ];
    for (code, brings) in erased {
        let mut rig = Rig::with(&filled);
        rig.command(code);
        let check = |rig: &mut Rig| {
            for (pid, value) in filled {
                let back = brings.iter().find(|&&(other, _)| other == pid);
                let value = back.map_or(value, |&(_, value)| value);
                assert_eq!(rig.read(pid), value, "PID {pid} after CMD {code}");
            }
        };
        check(&mut rig);
        rig.power_cycle();
        check(&mut rig);
    }
}

/// CMD 44 sets UI_COM to 0 and CMD 45 to 1 (MDROBOT-10). After 45 a position command moves the motor, after
/// 44 it does not.
#[test]
fn page_7_uicom() {
    let mut rig = Rig::default();
    rig.command(45);
    assert_eq!(rig.read(pid::UI_COM), 1);
    rig.write_long(pid::POSI_CMD, 120);
    rig.after(5.secs());
    assert!(rig.position().abs_diff(120) <= 1, "{}", rig.position());
    rig.command(44);
    assert_eq!(rig.read(pid::UI_COM), 0);
    rig.write_long(pid::POSI_CMD, 0);
    rig.after(5.secs());
    assert!(rig.position().abs_diff(120) <= 1, "{}", rig.position());
    rig.command(45);
    rig.power_cycle();
    assert_eq!(rig.read(pid::UI_COM), 0);
}

/// Codes without effect: broadcasting (5, 6, 11 to 14), CAN (23, 24), curves (31), a second motor (50 to 55),
/// and codes that are not in the table. They are echoed, nothing changes, and the drive sends no unsolicited
/// message (MDROBOT-10).
#[test]
fn page_6_codes_without_effect() {
    let effective = [2, 4, 8, 10, 15, 16, 17, 18, 20, 21, 22, 25, 26, 27, 28, 29, 32, 44, 45, 46, 47];
    let mut rig = Rig::armed(&[(pid::TAR_VEL, 700), (pid::MAX_LOAD, 150), (pid::MAX_RPM, 2_000)]);
    rig.velocity(300);
    rig.assert_turns(300.0);
    let before = image(&mut rig);
    let outputs = |rig: &Rig| ["ALARM", "FAN", "CLUTCH"].map(|name| rig.level(name));
    let levels = outputs(&rig);
    let client = rig.bench.connect(rig.bench.bus(rig.seat, Port(0)).expect("a line"));
    for code in (0..=255).filter(|code| !effective.contains(code)) {
        rig.command(code);
        rig.after(20.millis());
        assert!((rig.rpm() - 300.0).abs() <= 3.0, "CMD {code}: {} rpm", rig.rpm());
    }
    assert_eq!((image(&mut rig), outputs(&rig)), (before, levels));
    let mut said = Vec::new();
    rig.bench.receive(client, &mut said);
    said.clear();
    rig.after(5.secs());
    rig.bench.receive(client, &mut said);
    assert!(said.is_empty(), "unasked: {said:02X?}");
    for code in [256, 0x0102, 0x0A00, 0xFFFF] {
        assert_eq!(rig.try_write(pid::COMMAND, code), Err(3), "CMD {code}");
    }
    assert!((rig.rpm() - 300.0).abs() <= 3.0);
}
