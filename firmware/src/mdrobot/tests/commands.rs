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
        let mut dut = Dut::ready();
        dut.write(pid, value);
        dut.wait(10.millis());
        dut.write(10, code);
        assert_eq!(dut.read(pid), erased, "CMD {code}");
        dut.wait(10.millis());
        dut.cycle();
        assert_eq!(dut.read(pid), erased, "CMD {code}, saved");
    }
}

#[test]
fn ui_com_by_command() {
    let mut dut = Dut::ready();
    dut.write(10, 45);
    assert_eq!(dut.read(78), 1);
    dut.write(10, 44);
    assert_eq!(dut.read(78), 0);
}

#[test]
fn fan_and_clutch_are_pins() {
    let mut dut = Dut::ready();
    assert_eq!(dut.out.levels.iter().filter(|(_, pin, _)| [FAN, CLUTCH].contains(pin)).count(), 0);
    for (code, pin, level) in
        [(15, FAN, Level::High), (17, CLUTCH, Level::High), (16, FAN, Level::Low), (18, CLUTCH, Level::Low)]
    {
        dut.write(10, code);
        assert_eq!(dut.level(pin, Level::Float), level, "CMD {code}");
    }
}

#[test]
fn torque_off_and_brake_and_position_reset_by_command() {
    for (code, brakes) in [(2, false), (4, true)] {
        let mut dut = Dut::armed();
        dut.write(130, 1_000);
        dut.wait(2.secs());
        assert!((990..=1_010).contains(&dut.rpm()));
        dut.write(10, code);
        assert_eq!(dut.get(Pid::TQ_DATA) < 0, brakes, "a current only brakes");
        dut.wait(8.secs());
        assert_eq!(dut.rpm(), 0);
        assert!(dut.get(Pid::POSI_DATA) > 0);
        dut.write(10, 10);
        assert_eq!(dut.get(Pid::POSI_DATA), 0);
        dut.write(130, 1_000);
        dut.wait(2.secs());
        assert!((990..=1_010).contains(&dut.rpm()), "it is still armed");
    }
}

#[test]
fn others_are_echoed_and_do_nothing() {
    let mut dut = Dut::ready();
    let rows = Pid::TABLE.rows.len();
    let all = |dut: &Dut| {
        (0..rows)
            .filter(|row| *row != Pid::COMMAND.row())
            .map(|row| dut.drive.peek(dut.now, row))
            .collect::<Vec<_>>()
    };
    let before = all(&dut);
    let codes: Vec<u16> = dut.drive.spec().commands.iter().map(|command| command.code).collect();
    for code in (0..=255).filter(|code| !codes.contains(code)) {
        dut.write(10, code);
    }
    for command in dut.drive.spec().commands.iter().filter(|command| !command.missing.is_empty()) {
        dut.write(10, command.code);
    }
    dut.wait(1.secs());
    assert_eq!(all(&dut), before);
    assert_eq!((&dut.out.levels[..], &dut.out.stored()[..]), (&[][..], &[][..]));
    assert_eq!(dut.try_write(10, 0x102), [0x86, 3]);
}

/// The codes of pages 6 and 7, typed here again, and the two that V1.1 does not have (MDROBOT-10).
#[test]
fn the_table_has_every_row_of_the_manual() {
    let codes: Vec<u16> = Dut::new().drive.spec().commands.iter().map(|command| command.code).collect();
    let manual = [
        2, 4, 5, 6, 8, 10, 11, 12, 13, 14, 15, 16, 17, 18, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 31, 32,
        44, 45, 46, 47, 50, 51, 52, 53, 54, 55, 71, 72,
    ];
    assert_eq!(codes, manual);
}
