//! The tables of sections 6.1 to 6.8: every register with its address, size, access, range, default and
//! persistence.

use drivetwin_protocol::registers::Space;
use drivetwin_protocol::time::Span;
use drivetwin_tests::rs434::{KINDS, Rig, at};

/// A register: address, name, bits, range, default, and whether a save keeps it. Section 6 prints the
/// defaults of the serial line. The other defaults are ours. `RO` is read-only.
type Row = (u16, &'static str, u32, Range, i64, bool);

#[derive(Clone, Copy, PartialEq)]
enum Range {
    ReadOnly,
    Any,
    From(i64, i64),
    /// Any of these keys, or 0.
    Keys(&'static [u16]),
}
use Range::{Any, From, Keys, ReadOnly as RO};

#[rustfmt::skip]
const REGISTERS: [Row; 69] = [
    (0x1000, "IN1_bit",                  1, RO,                  0,      false),
    (0x1001, "IN2_bit",                  1, RO,                  0,      false),
    (0x1002, "IN_HARD_STOP_bit",         1, RO,                  1,      false),
    (0x2000, "START_bit",                1, Any,                 0,      false),
    (0x2001, "STOP_bit",                 1, Any,                 0,      false),
    (0x2002, "HARD_STOP_bit",            1, Any,                 0,      false),
    (0x2003, "CLR_POSITION_bit",         1, Any,                 0,      false),
    (0x3000, "STATUS",                  16, RO,                  0,      false),
    (0x3001, "CURRENT_VALID",           16, RO,                  0,      false),
    (0x3002, "SPEED_VALID",             16, RO,                  0,      false),
    (0x3003, "CURRENT_POSITION",        32, RO,                  0,      false),
    (0x3005, "TEMPERATURE_MCU",         16, RO,                  250,    false),
    (0x3006, "TEMPERATURE_MOSFET",      16, RO,                  250,    false),
    (0x3007, "TEMPERATURE_BRAKE",       16, RO,                  250,    false),
    (0x3009, "STATUS_USER_PROGRAM",     16, RO,                  1,      false),
    (0x5000, "SLAVE_ADDRESS_MODBUS",    16, From(0, 247),        1,      true),
    (0x5001, "TYPE_MODBUS",             16, From(1, 5),          3,      true),
    (0x5002, "BITRATE_MODBUS",          16, From(0, 10),         9,      true),
    (0x5003, "TIMEOUT_BROADCAST_MODBUS", 16, Any,                0,      true),
    (0x5004, "MODE_DEVICE",             16, From(1, 2),          1,      true),
    (0x5005, "MODE_USER_PROGRAM",       16, From(1, 3),          1,      true),
    (0x5006, "MODE_ROTATION",           16, From(1, 3),          1,      true),
    (0x5007, "MODE_EXT_IN",             16, From(1, 5),          1,      true),
    (0x5008, "POSITION_N",              16, From(1, 4),          1,      true),
    (0x5009, "REF_CURRENT",             16, From(1_000, 20_000), 20_000, true),
    (0x500A, "RATED_SPEED",             16, From(1_000, 15_000), 3_000,  true),
    (0x500B, "SPEED",                   16, From(30, 15_000),    1_000,  true),
    (0x500C, "ACC",                     16, From(10, 1_000),     100,    true),
    (0x500D, "DEC",                     16, From(10, 1_000),     100,    true),
    (0x500E, "DIRECTION",               16, From(1, 2),          1,      true),
    (0x500F, "PULSES_PER_REVOLUTION",   16, From(1, 12),         4,      true),
    (0x5010, "USE_HALL",                16, From(0, 2),          2,      true),
    (0x5011, "MODE_COIL",               16, From(0, 1),          0,      true),
    (0x5012, "OFFSET_COMPENSATION",     16, Any,                 0,      true),
    (0x5013, "PRESSED_INPUTS_EXTERN",   16, Any,                 10,     true),
    (0x5014, "WAITED_INPUTS_EXTERN",    16, Any,                 10,     true),
    (0x5015, "OFFSET",                  32, Any,                 0,      true),
    (0x5017, "OFFSET_CONST",            32, Any,                 0,      true),
    (0x5019, "TARGET_POSITION",         32, Any,                 0,      true),
    (0x501B, "TARGET_POSITION1",        32, Any,                 0,      true),
    (0x501D, "TARGET_POSITION2",        32, Any,                 0,      true),
    (0x501F, "TARGET_POSITION3",        32, Any,                 0,      true),
    (0x5021, "TARGET_POSITION4",        32, Any,                 0,      false),
    (0x5023, "ERROR",                   16, Any,                 0,      false),
    (0x5024, "FLAG_SAVE_INI",           16, Keys(&[0x37FA]),     0,      false),
    (0x5025, "FLAG_SAVE_USER_PROGRAM",  16, Keys(&[0x8426, 0x9346]), 0,  false),
    (0x5026, "FLAG_RESTART",            16, Keys(&[0x95AF]),     0,      false),
    (0x6000, "WRITE_CMD",               16, From(0, 1_023),      0,      false),
    (0x6001, "CMD_W",                   32, Any,                 0,      false),
    (0x6003, "READ_CMD",                16, From(0, 1_023),      0,      false),
    (0x6004, "CMD_R",                   32, Any,                 0,      false),
    (0x7000, "AX_REG",                  16, Any,                 0,      false),
    (0x7001, "BX_REG",                  16, Any,                 0,      false),
    (0x7002, "CX_REG",                  16, Any,                 0,      false),
    (0x7003, "DX_REG",                  16, Any,                 0,      false),
    (0x7004, "EX_REG",                  16, Any,                 0,      false),
    (0x7005, "FX_REG",                  16, Any,                 0,      false),
    (0x7006, "PC_REG",                  16, RO,                  0,      false),
    (0x7007, "GX_REG",                  16, Any,                 0,      false),
    (0x7008, "HX_REG",                  16, Any,                 0,      false),
    (0x7009, "IX_REG",                  16, Any,                 0,      false),
    (0x700A, "JX_REG",                  16, Any,                 0,      false),
    (0x8001, "HW_MAJOR",                16, RO,                  1_001,  false),
    // Not in the table of defaults: the manual calls them random, or prints "x".
    (0x3008, "TASK_COUNTER",            16, RO,                  -1,     false),
    (0x8002, "HW_MINOR",                16, RO,                  -1,     false),
    (0x8003, "FW_MAJOR",                16, RO,                  -1,     false),
    (0x8004, "FW_MINOR",                16, RO,                  -1,     false),
    // These rows fill the table to 69 rows, so that a missing row is a compile error.
    (0xFFFF, "", 0, RO, -1, false),
    (0xFFFF, "", 0, RO, -1, false),
];

/// Registers of a model. Sections 6.5 and 6.8 print two values for REF_CURRENT and HW_MAJOR.
fn registers(kind: &str) -> impl Iterator<Item = Row> {
    let big = kind == "rs434546";
    REGISTERS.into_iter().filter(|row| row.2 > 0).map(move |row| match row.1 {
        "REF_CURRENT" if big => (row.0, row.1, 16, From(2_000, 40_000), 40_000, true),
        "HW_MAJOR" if big => (row.0, row.1, 16, RO, 1_002, false),
        _ => row,
    })
}

/// Reads a register of 16 or 32 bits.
#[track_caller]
fn read(rig: &mut Rig, (address, _, bits, ..): Row) -> i64 {
    if bits == 32 { i64::from(rig.read_long(address)) } else { i64::from(rig.read(address)) }
}

#[test]
fn section_6_names_and_addresses() {
    for kind in KINDS {
        let rig = Rig::ready(kind);
        let spec = rig.bench.spec(rig.seat);
        for (address, name, bits, ..) in registers(kind) {
            let found = spec.find(name).unwrap_or_else(|| panic!("{kind} has no {name}"));
            let row = &spec.registers.rows[found.row];
            assert_eq!(row.address, address, "{name}");
            assert_eq!(u32::from(row.shape.words()), bits.div_ceil(16), "{name}");
        }
        let on_the_bus = spec.rows().filter(|(_, row)| row.space != Space::Setting);
        assert_eq!(on_the_bus.count(), registers(kind).count(), "{kind} has others, too");
    }
}

#[test]
fn section_6_defaults() {
    for kind in KINDS {
        let mut rig = Rig::ready(kind);
        for row in registers(kind).filter(|row| row.4 >= 0) {
            assert_eq!(read(&mut rig, row), row.4, "{}", row.1);
        }
    }
}

/// Each address space is read by one of the functions 01 to 04. The other three do not find the register.
#[test]
fn section_6_which_function_reads() {
    let mut rig = Rig::default();
    for (address, name, bits, ..) in registers("rs434544") {
        let own = match address >> 12 {
            1 => 2,
            2 => 1,
            3 | 8 => 4,
            _ => 3,
        };
        for word in 0..bits.div_ceil(16) as u16 {
            for function in 1..=4 {
                let read = match function {
                    1 | 2 => rig.try_bits(function, address + word, 1).map(drop),
                    _ => rig.try_words(function, address + word, 1).map(drop),
                };
                assert_eq!(
                    read,
                    if function == own { Ok(()) } else { Err(2) },
                    "{name}, function {function}"
                );
            }
        }
    }
}

/// A drive has no registers that the manual does not have, in any space.
#[test]
fn section_6_no_others() {
    let mut rig = Rig::default();
    let rows: Vec<Row> = registers("rs434544").collect();
    for address in [0x0000, 0x0FFF, 0x1003, 0x1FFF, 0x2004, 0x2FFF, 0x300A, 0x4FFF, 0x5027, 0x5FFF]
        .into_iter()
        .chain([0x6006, 0x6FFF, 0x700B, 0x7FFF, 0x8000, 0x8005, 0xFFFF])
    {
        assert!(rows.iter().all(|row| row.0 != address));
        for function in [1, 2] {
            assert_eq!(rig.try_bits(function, address, 1), Err(2), "{address:04X}h");
        }
        for function in [3, 4] {
            assert_eq!(rig.try_words(function, address, 1), Err(2), "{address:04X}h");
        }
        assert_eq!(rig.try_write_all(address, &[0]), Err(2), "{address:04X}h");
        assert_eq!(rig.try_write_coils(address, &[false]), Err(2), "{address:04X}h");
    }
    assert_eq!(rig.read(at::ERROR), 0, "bit 13 is for values");
}

/// "This group of registers is read-only" (6.1, 6.3, 6.8), and so is PC (RS434-2): functions 05, 06, 15 and
/// 16 do not find them.
#[test]
fn section_6_what_cannot_be_written() {
    let mut rig = Rig::default();
    for row in registers("rs434544").filter(|row| row.3 == RO) {
        let before = if row.1 == "TASK_COUNTER" { 0 } else { read(&mut rig, row) };
        let address = row.0;
        assert_eq!(rig.try_write(address, 0), Err(2), "{}", row.1);
        assert_eq!(rig.try_write_all(address, &[0]), Err(2), "{}", row.1);
        assert_eq!(rig.try_write_coils(address, &[false]), Err(2), "{}", row.1);
        assert!(row.1 == "TASK_COUNTER" || read(&mut rig, row) == before, "{}", row.1);
    }
    assert_eq!(rig.read(at::ERROR), 0);
}

/// Both limits of each range are accepted. The values next to them get exception 03, set ERROR bit 13 and
/// change nothing (RS434-1), with functions 06 and 16.
#[test]
fn section_6_ranges() {
    for kind in KINDS {
        for row in registers(kind).filter(|row| row.0 >= 0x5000 && row.2 == 16) {
            let (address, name, _, range, ..) = row;
            // ERROR accepts any value, but does not read back as written.
            if address == at::ERROR {
                continue;
            }
            let (good, bad): (Vec<i64>, Vec<i64>) = match range {
                RO => continue,
                Any => (vec![0, 1, 0x7FFF, 0x8000, 0xFFFF], vec![]),
                From(least, greatest) => (vec![least, greatest], vec![least - 1, greatest + 1, 0xFFFF]),
                Keys(keys) => (
                    vec![0],
                    keys.iter().flat_map(|key| [i64::from(*key) - 1, i64::from(*key) + 1]).collect(),
                ),
            };
            let mut rig = Rig::ready(kind);
            for value in good {
                rig.write(address, value as u16);
                assert_eq!(i64::from(rig.read(address)), value, "{name}");
                assert_eq!(rig.try_write_all(address, &[value as u16]), Ok(()), "{name}");
            }
            assert_eq!(rig.read(at::ERROR), 0, "{name}");
            let before = rig.read(address);
            for value in bad.into_iter().filter(|value| (0..=0xFFFF).contains(value)) {
                assert_eq!(rig.try_write(address, value as u16), Err(3), "{value} to {name}");
                assert_eq!((rig.read(at::ERROR), rig.read(address)), (0x2000, before), "{value} to {name}");
                rig.write(at::ERROR, 0);
                assert_eq!(rig.try_write_all(address, &[value as u16]), Err(3), "{value} to {name}");
                assert_eq!((rig.read(at::ERROR), rig.read(address)), (0x2000, before), "{value} to {name}");
                rig.write(at::ERROR, 0);
            }
        }
    }
}

/// 32-bit registers have the low word first. They can be written by one request or by two.
#[test]
fn section_6_pairs() {
    for row in registers("rs434544").filter(|row| row.2 == 32 && row.3 == Any) {
        let mut rig = Rig::default();
        for value in [0x1234_5678, -1, i32::MIN, i32::MAX, -2_147_483_647, 0] {
            rig.write_long(row.0, value);
            assert_eq!(rig.read_long(row.0), value, "{}", row.1);
        }
        rig.write(row.0, 0x5678);
        rig.write(row.0 + 1, 0x1234);
        assert_eq!((rig.read_long(row.0), rig.read(row.0)), (0x1234_5678, 0x5678), "{}", row.1);
    }
}

/// A save keeps 5000h to 5020h and nothing else (RS434-9).
#[test]
fn section_6_5_what_a_save_keeps() {
    for kind in KINDS {
        let mut rig = Rig::ready(kind);
        let rows = registers(kind).filter(|row| row.0 >= 0x5000 && row.3 != RO && !matches!(row.3, Keys(_)));
        // Leaves out the address and the line settings, which change after the restart. MODE_USER_PROGRAM
        // gets 2, as 3 would start a program.
        let rows: Vec<Row> = rows.filter(|row| !(0x5000..=0x5002).contains(&row.0)).collect();
        let other = |row: &Row| match (row.1, row.3) {
            ("MODE_USER_PROGRAM", _) => 2,
            ("ERROR", _) => 0,
            ("MODE_DEVICE", _) => 2,
            (_, From(least, greatest)) => {
                if row.4 == greatest {
                    least
                } else {
                    greatest
                }
            }
            _ => 0x1234 + i64::from(row.0),
        };
        for row in &rows {
            match row.2 {
                32 => rig.write_long(row.0, other(row) as i32),
                _ => rig.write(row.0, other(row) as u16),
            }
        }
        rig.save();
        rig.restart();
        // Replies are delayed now by register 5003h.
        for row in &rows {
            rig.after(100.secs());
            let kept = if row.5 { other(row) } else { row.4 };
            assert_eq!(read(&mut rig, *row), kept, "{}", row.1);
        }
    }
}

/// Unsaved values are lost by a restart and at power-off.
#[test]
fn section_6_5_what_was_not_saved_is_forgotten() {
    for power in [false, true] {
        let mut rig = Rig::default();
        rig.write(at::SPEED, 500);
        rig.save();
        rig.write(at::SPEED, 600);
        rig.write_long(at::OFFSET, 7);
        if power {
            rig.power_cycle();
        } else {
            rig.restart();
        }
        assert_eq!((rig.read(at::SPEED), rig.read_long(at::OFFSET)), (500, 0));
    }
}

/// A key register reads 0 and accepts 0 (RS434-2).
#[test]
fn section_6_5_keys() {
    let mut rig = Rig::default();
    rig.write(at::SPEED, 500);
    for key in [at::SAVE_INI, at::SAVE_PROGRAM, at::RESTART] {
        rig.write(key, 0);
        assert_eq!(rig.read(key), 0);
    }
    rig.after(1.secs());
    assert_eq!((rig.read(at::SPEED), rig.read(at::ERROR)), (500, 0));
}

/// "Returns a random number in the range 0x0000 to 0xFFFF": each read returns a new number.
#[test]
fn section_6_3_task_counter() {
    let mut rig = Rig::default();
    let mut numbers: Vec<u16> = (0..200).map(|_| rig.read(at::TASK_COUNTER)).collect();
    assert!(numbers.iter().any(|number| *number > 0xC000) && numbers.iter().any(|number| *number < 0x4000));
    numbers.sort_unstable();
    numbers.dedup();
    // Among 200 random numbers of 65,536 hardly any two are equal.
    assert!(numbers.len() > 190, "{} different ones", numbers.len());
}
