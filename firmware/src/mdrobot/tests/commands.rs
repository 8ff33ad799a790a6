//! The codes of COMMAND (p. 6, 7).

use super::*;

#[test]
fn what_erases_brings_the_factory_value() {
    for (code, pid, value, erased) in [
        (20, 155, 100, 0),
        (21, 153, 100, 0),
        (22, 154, 100, 0),
        (25, 211, 100, 200),
        (26, 156, 100, 0),
        (27, 157, 100, 0),
        (28, 158, 600, 0),
        (29, 157, 100, 0),
        (29, 158, 600, 0),
        (32, 25, 5, 0),
        (46, 221, 100, 3_000),
        (47, 21, 1, 0),
    ] {
        let mut bed = Bed::ready();
        bed.write(pid, value);
        bed.wait(10.millis());
        bed.write(10, code);
        assert_eq!(bed.read(pid), erased, "CMD {code}");
        bed.wait(10.millis());
        bed.cycle();
        assert_eq!(bed.read(pid), erased, "CMD {code}, saved");
    }
}

#[test]
fn ui_com_by_command() {
    let mut bed = Bed::ready();
    bed.write(10, 45);
    assert_eq!(bed.read(78), 1);
    bed.write(10, 44);
    assert_eq!(bed.read(78), 0);
}

#[test]
fn fan_and_clutch_are_pins() {
    let mut bed = Bed::ready();
    assert_eq!(bed.world.levels.iter().filter(|(_, pin, _)| [FAN, CLUTCH].contains(pin)).count(), 0);
    for (code, pin, level) in
        [(15, FAN, Level::High), (17, CLUTCH, Level::High), (16, FAN, Level::Low), (18, CLUTCH, Level::Low)]
    {
        bed.write(10, code);
        assert_eq!(bed.level(pin, Level::Float), level, "CMD {code}");
    }
}

#[test]
fn torque_off_and_brake_and_position_reset_by_command() {
    for (code, brakes) in [(2, false), (4, true)] {
        let mut bed = Bed::armed();
        bed.write(130, 1_000);
        bed.wait(2.secs());
        assert!((990..=1_010).contains(&bed.rpm()));
        bed.write(10, code);
        assert_eq!(bed.get(Pid::TQ_DATA) < 0, brakes, "a current only brakes");
        bed.wait(8.secs());
        assert_eq!(bed.rpm(), 0);
        assert!(bed.get(Pid::POSI_DATA) > 0);
        bed.write(10, 10);
        assert_eq!(bed.get(Pid::POSI_DATA), 0);
        bed.write(130, 1_000);
        bed.wait(2.secs());
        assert!((990..=1_010).contains(&bed.rpm()), "it is still armed");
    }
}

#[test]
fn others_are_echoed_and_do_nothing() {
    let mut bed = Bed::ready();
    let rows = Pid::TABLE.rows.len();
    let all = |bed: &Bed| {
        (0..rows)
            .filter(|row| *row != Pid::COMMAND.row())
            .map(|row| bed.drive.peek(bed.now, row))
            .collect::<Vec<_>>()
    };
    let before = all(&bed);
    let codes: Vec<u16> = bed.drive.spec().commands.iter().map(|command| command.code).collect();
    for code in (0..=255).filter(|code| !codes.contains(code)) {
        bed.write(10, code);
    }
    for command in bed.drive.spec().commands.iter().filter(|command| !command.missing.is_empty()) {
        bed.write(10, command.code);
    }
    bed.wait(1.secs());
    assert_eq!(all(&bed), before);
    assert_eq!((&bed.world.levels[..], &bed.world.stores[..]), (&[][..], &[][..]));
    assert_eq!(bed.try_write(10, 0x102), [0x86, 3]);
}

/// Pages 6 and 7, typed, and the two that V1.1 does not have (decisions, MDROBOT 10).
#[test]
fn the_table_has_every_row_of_the_manual() {
    let codes: Vec<u16> = Bed::new().drive.spec().commands.iter().map(|command| command.code).collect();
    let manual = [
        2, 4, 5, 6, 8, 10, 11, 12, 13, 14, 15, 16, 17, 18, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 31, 32,
        44, 45, 46, 47, 50, 51, 52, 53, 54, 55, 71, 72,
    ];
    assert_eq!(codes, manual);
}
