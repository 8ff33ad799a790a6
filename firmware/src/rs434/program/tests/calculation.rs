//! Tests of moves, arithmetic, logic and shifts: every code in the tables of section 6.9 with every form of
//! operands.

use super::*;

/// An operation. `words` and `pairs` are its codes for 16 and 32 bits with `SYSREG_CONST`, `SYSREG_MODBUS`,
/// `MODBUS_CONST`, `MODBUS_SYSREG` and `SYSREG_SYSREG`. The other fields have S1, S2 and the result; `None`
/// is an error.
struct Operation {
    name: &'static str,
    words: [u32; 5],
    pairs: [u32; 5],
    of_words: &'static [(u16, u16, Option<u16>)],
    of_pairs: &'static [(u32, u32, Option<u32>)],
}

const OPERATIONS: [Operation; 7] = [
    Operation {
        name: "ADD",
        words: [0x19, 0x21, 0x28, 0x30, 0x37],
        pairs: [0x3E, 0x46, 0x4D, 0x55, 0x5C],
        of_words: &[(0x1234, 0x4321, Some(0x5555)), (0xFFFF, 2, Some(1))],
        of_pairs: &[(0xFFFF, 1, Some(0x1_0000)), (0xFFFF_FFFF, 0x1_0002, Some(0x1_0001))],
    },
    Operation {
        name: "SUB",
        words: [0x1A, 0x22, 0x29, 0x31, 0x38],
        pairs: [0x3F, 0x47, 0x4E, 0x56, 0x5D],
        of_words: &[(0x5555, 0x1234, Some(0x4321)), (1, 2, Some(0xFFFF))],
        of_pairs: &[(0x1_0000, 1, Some(0xFFFF)), (0, 0x1_0000, Some(0xFFFF_0000))],
    },
    Operation {
        name: "DIV",
        words: [0x1B, 0x23, 0x2A, 0x32, 0x39],
        pairs: [0x40, 0x48, 0x4F, 0x57, 0x5E],
        of_words: &[(1_000, 7, Some(142)), (0xFFFF, 0xFFFF, Some(1)), (3, 0, None)],
        of_pairs: &[(0xFFFF_FFFF, 0x1_0000, Some(0xFFFF)), (5, 0x8000_0000, Some(0)), (0, 0, None)],
    },
    Operation {
        name: "MUL",
        words: [0x1C, 0x24, 0x2B, 0x33, 0x3A],
        pairs: [0x41, 0x49, 0x50, 0x58, 0x5F],
        of_words: &[(300, 200, Some(60_000)), (0x1234, 0x1000, Some(0x4000))],
        of_pairs: &[(70_000, 50_000, Some(3_500_000_000)), (0x1_0001, 0x1_0001, Some(0x2_0001))],
    },
    Operation {
        name: "AND",
        words: [0x1D, 0x25, 0x2C, 0x34, 0x3B],
        pairs: [0x42, 0x4A, 0x51, 0x59, 0x60],
        of_words: &[(0xFF0F, 0x3C3C, Some(0x3C0C))],
        of_pairs: &[(0xFF0F_00FF, 0x3C3C_3C3C, Some(0x3C0C_003C))],
    },
    Operation {
        name: "OR",
        words: [0x1E, 0x26, 0x2D, 0x35, 0x3C],
        pairs: [0x43, 0x4B, 0x52, 0x5A, 0x61],
        of_words: &[(0xF000, 0x0C3C, Some(0xFC3C))],
        of_pairs: &[(0xF000_0001, 0x0C3C_8000, Some(0xFC3C_8001))],
    },
    Operation {
        name: "XOR",
        words: [0x1F, 0x27, 0x2E, 0x36, 0x3D],
        pairs: [0x44, 0x4C, 0x53, 0x5B, 0x62],
        of_words: &[(0xFF00, 0x0FF0, Some(0xF0F0))],
        of_pairs: &[(0xFF00_FF00, 0x0FF0_0FF0, Some(0xF0F0_F0F0))],
    },
];

fn low(value: u32) -> u16 {
    (value & 0xFFFF) as u16
}

fn high(value: u32) -> u16 {
    (value >> 16) as u16
}

/// A drive after the first line. Before it CX and DX have `system`, and the holding registers 500h and 501h
/// have `bus`.
fn after(lines: &[u32], system: u32, bus: u32) -> (Step, Drive) {
    let mut drive = Drive::running(lines)
        .with_registers([0, 0, low(system), high(system), 0, 0, 0, 0, 0, 0])
        .with_bus(Space::Holding, 0x500, &[low(bus), high(bus)]);
    let step = drive.step();
    (step, drive)
}

/// Value of CX and DX.
fn system(drive: &Drive) -> u32 {
    let [_, _, cx, dx, ..] = drive.registers();
    u32::from(cx) | u32::from(dx) << 16
}

/// Value of the holding registers 500h and 501h.
fn bus(drive: &mut Drive) -> u32 {
    u32::from(drive.word(Space::Holding, 0x500)) | u32::from(drive.word(Space::Holding, 0x501)) << 16
}

/// Results of the five forms of an operation. The operands are where each form expects them. All unused
/// fields have arbitrary values. `None` is an error.
fn results(codes: [u32; 5], wide: bool, s1: u32, s2: u32) -> [Option<u32>; 5] {
    let [sysreg_const, sysreg_modbus, modbus_const, modbus_sysreg, sysreg_sysreg] = codes;
    let lines = [
        if wide {
            [line(sysreg_const, 1, CX, 0xF, 0xABCD), s2]
        } else {
            [line(sysreg_const, 1, CX, 0xF, s2), 0x7F]
        },
        [line(sysreg_modbus, 1, CX, HOLDING, 0x500), 0x7F],
        // A 16-bit command uses the low half of the line with the constant.
        [line(modbus_const, 1, 0xF, HOLDING, 0x500), if wide { s2 } else { 0xDEAD_0000 | s2 }],
        [line(modbus_sysreg, 1, CX, HOLDING, 0x500), 0x7F],
        [line(sysreg_sysreg, 1, CX, 0xF, IX), 0x7F],
    ];
    let [constant, from_bus, to_bus, system_to_bus, between] = lines;
    let done = |step| match step {
        Step::Next => Some(()),
        Step::Error => None,
        other => panic!("{other:?}"),
    };
    let kept = |value: u32| if wide { value } else { value & 0xFFFF };
    let mut results = [None; 5];
    for (n, (lines, held_by_system, held_by_bus)) in
        [(constant, s1, 0), (from_bus, s1, s2), (to_bus, 0, s1), (system_to_bus, s2, s1)].iter().enumerate()
    {
        let (step, mut drive) = after(lines, *held_by_system, *held_by_bus);
        let in_bus = n >= 2;
        results[n] = done(step).map(|()| kept(if in_bus { bus(&mut drive) } else { system(&drive) }));
        let (untouched, was) =
            if in_bus { (system(&drive), *held_by_system) } else { (bus(&mut drive), *held_by_bus) };
        assert_eq!(untouched, was, "the second operand stays");
    }
    let mut drive =
        Drive::running(&between).with_registers([0, 0, low(s1), high(s1), 0, 0, 0, 0, low(s2), high(s2)]);
    results[4] = done(drive.step()).map(|()| kept(system(&drive)));
    results
}

#[test]
fn every_code_of_the_table_of_mathematics() {
    for operation in &OPERATIONS {
        for &(s1, s2, d) in operation.of_words {
            let got = results(operation.words, false, s1.into(), s2.into());
            assert_eq!(got, [d.map(u32::from); 5], "{} {s1:#x}, {s2:#x}", operation.name);
        }
        for &(s1, s2, d) in operation.of_pairs {
            let got = results(operation.pairs, true, s1, s2);
            assert_eq!(got, [d; 5], "D{} {s1:#x}, {s2:#x}", operation.name);
        }
    }
}

#[test]
fn sixteen_bits_leave_the_other_half_alone() {
    for operation in &OPERATIONS {
        let (_, drive) = after(&[line(operation.words[0], 0, CX, 0, 1)], 0xABCD_FFFF, 0);
        assert_eq!(high(system(&drive)), 0xABCD, "{}", operation.name);
        let (_, mut drive) = after(&[line(operation.words[2], 0, 0, HOLDING, 0x500), 1], 0, 0xABCD_FFFF);
        assert_eq!(high(bus(&mut drive)), 0xABCD, "{}", operation.name);
        assert_eq!(drive.written.len(), 1);
        assert_eq!(drive.written[0].2.len(), 1, "{} writes one register", operation.name);
    }
}

#[test]
fn moves() {
    // MOV_SYSREG_CONST, with arbitrary values in bTypeJmp and uTypeModbusReg.
    assert_eq!(system(&after(&[line(0x01, 1, CX, 0xF, 0xBEEF)], 0x1111_1111, 0).1), 0x1111_BEEF);
    // MOV_MODBUS_SYSREG, from the system register to the bus.
    assert_eq!(
        bus(&mut after(&[line(0x02, 0, CX, HOLDING, 0x500)], 0x2222_3333, 0x4444_5555).1),
        0x4444_3333
    );
    // MOV_SYSREG_MODBUS.
    assert_eq!(system(&after(&[line(0x03, 0, CX, HOLDING, 0x500)], 0x2222_3333, 0x4444_5555).1), 0x2222_5555);
    // MOV_MODBUS_CONST uses the low half of the next line.
    let lines = [line(0x0E, 0, 0, HOLDING, 0x500), 0x6666_7777];
    assert_eq!(bus(&mut after(&lines, 0, 0x4444_5555).1), 0x4444_7777);
    // DMOV_SYSREG_CONST, DMOV_SYSREG_MODBUS, DMOV_MODBUS_CONST, DMOV_MODBUS_SYSREG.
    assert_eq!(system(&after(&[line(0x10, 0, CX, 0, 0xFFFF), 0x8765_4321], 0, 0).1), 0x8765_4321);
    assert_eq!(system(&after(&[line(0x11, 0, CX, HOLDING, 0x500)], 0, 0x4444_5555).1), 0x4444_5555);
    let lines = [line(0x12, 0, 0, HOLDING, 0x500), 0x6666_7777];
    assert_eq!(bus(&mut after(&lines, 0, 0).1), 0x6666_7777);
    assert_eq!(bus(&mut after(&[line(0x13, 0, CX, HOLDING, 0x500)], 0x2222_3333, 0).1), 0x2222_3333);
}

#[test]
fn a_move_between_system_registers_goes_from_the_first_to_the_second() {
    // "From the system register uAdrSysReg to another system register with the address uData."
    let registers = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10];
    let mut drive = Drive::running(&[line(0x0F, 0, BX, 0, JX)]).with_registers(registers);
    drive.step();
    assert_eq!(drive.registers(), [1, 2, 3, 4, 5, 6, 7, 8, 9, 2]);
    let mut drive = Drive::running(&[line(0x14, 0, GX, 0, AX)]).with_registers(registers);
    drive.step();
    assert_eq!(drive.registers(), [7, 8, 3, 4, 5, 6, 7, 8, 9, 10]);
    // The pair of FX is FX and GX.
    let mut drive = Drive::running(&[line(0x14, 0, 5, 0, IX)]).with_registers(registers);
    drive.step();
    assert_eq!(drive.registers(), [1, 2, 3, 4, 5, 6, 7, 8, 6, 7]);
}

#[test]
fn not() {
    assert_eq!(system(&after(&[line(0x15, 0, CX, 0, 0)], 0x1111_0F0F, 0).1), 0x1111_F0F0);
    assert_eq!(bus(&mut after(&[line(0x16, 0, 0, HOLDING, 0x500)], 0, 0x1111_0F0F).1), 0x1111_F0F0);
    assert_eq!(system(&after(&[line(0x17, 0, CX, 0, 0)], 0x1111_0F0F, 0).1), 0xEEEE_F0F0);
    assert_eq!(bus(&mut after(&[line(0x18, 0, 0, HOLDING, 0x500)], 0, 0x1111_0F0F).1), 0xEEEE_F0F0);
}

#[test]
fn shifts() {
    const LEFT: u32 = 0;
    const RIGHT: u32 = 1;
    let words = [
        (LEFT, 4, 0x8421, 0x4210),
        (RIGHT, 4, 0x8421, 0x0842),
        (LEFT, 15, 0x0003, 0x8000),
        (RIGHT, 15, 0x8000, 1),
        (LEFT, 16, 0xFFFF, 0),
        (RIGHT, 16, 0xFFFF, 0),
        (RIGHT, 0, 0xFFFF, 0xFFFF),
        (LEFT, 0xFFFF, 0xFFFF, 0),
    ];
    for (way, by, before, then) in words {
        let [system, bus] = shifted(0x20, 0x2F, way, by, before, 0xCAFE_0000);
        assert_eq!([system & 0xFFFF, bus & 0xFFFF], [then; 2], "{before:#x} by {by}, {way}");
    }
    let pairs = [
        (LEFT, 16, 0x8765_4321, 0x4321_0000),
        (RIGHT, 16, 0x8765_4321, 0x8765),
        (LEFT, 31, 3, 0x8000_0000),
        (RIGHT, 31, 0x8000_0000, 1),
        (LEFT, 32, 0xFFFF_FFFF, 0),
        (RIGHT, 32, 0xFFFF_FFFF, 0),
    ];
    for (way, by, before, then) in pairs {
        assert_eq!(shifted(0x45, 0x54, way, by, before, 0), [then; 2], "{before:#x} by {by}, {way}");
    }
    // All 32 bits of the constant are used.
    assert_eq!(bus(&mut after(&[line(0x54, LEFT, 0, HOLDING, 0x500), 0x1_0000], 0, 1).1), 0);
}

/// A value shifted in a system register (number of bits in uData) and on the bus (number of bits in the next
/// line).
fn shifted(of_system: u32, of_bus: u32, way: u32, by: u32, value: u32, noise: u32) -> [u32; 2] {
    let (_, drive) = after(&[line(of_system, way, CX, 0xF, by)], value, 0);
    let (_, mut other) = after(&[line(of_bus, way, 0xF, HOLDING, 0x500), noise | by], 0, value);
    [system(&drive), bus(&mut other)]
}

#[test]
fn bits_are_words_of_0_and_1() {
    let run = |lines: &[u32], cx_dx: u32| {
        let mut drive = Drive::running(lines)
            .with_registers([0, 0, low(cx_dx), high(cx_dx), 0, 0, 0, 0, 0, 0])
            .with_bus(Space::Coil, 0x2000, &[0, 1])
            .with_bus(Space::Discrete, 0x1000, &[1, 1]);
        assert_eq!(drive.step(), Step::Next);
        drive
    };
    // MOV and DMOV_SYSREG_MODBUS from discrete inputs and coils. With 32 bits each half holds one bit.
    assert_eq!(system(&run(&[line(0x03, 0, CX, DISCRETE, 0x1001)], 0xAAAA_AAAA)), 0xAAAA_0001);
    assert_eq!(system(&run(&[line(0x11, 0, CX, DISCRETE, 0x1000)], 0)), 0x0001_0001);
    assert_eq!(system(&run(&[line(0x11, 0, CX, COIL, 0x2000)], 0)), 0x0001_0000);
    // ADD_SYSREG_MODBUS.
    assert_eq!(system(&run(&[line(0x21, 0, CX, DISCRETE, 0x1000)], 0xFFFF)), 0);
    // MOV_MODBUS_CONST, DMOV_MODBUS_CONST, MOV_MODBUS_SYSREG: any value other than 0 gives 1.
    let coils = |lines: &[u32], cx_dx| run(lines, cx_dx).written;
    assert_eq!(coils(&[line(0x0E, 0, 0, COIL, 0x2000), 0x0080], 0), [(Space::Coil, 0x2000, vec![1])]);
    assert_eq!(coils(&[line(0x0E, 0, 0, COIL, 0x2000), 0x8_0000], 0), [(Space::Coil, 0x2000, vec![0])]);
    assert_eq!(coils(&[line(0x12, 0, 0, COIL, 0x2000), 0x8_0000], 0), [(Space::Coil, 0x2000, vec![0, 1])]);
    assert_eq!(coils(&[line(0x02, 0, CX, COIL, 0x2001)], 0x300), [(Space::Coil, 0x2001, vec![1])]);
    // NOT_MODBUS and DNOT_MODBUS invert the bit, not the word.
    assert_eq!(coils(&[line(0x16, 0, 0, COIL, 0x2001)], 0), [(Space::Coil, 0x2001, vec![0])]);
    assert_eq!(coils(&[line(0x16, 0, 0, COIL, 0x2000)], 0), [(Space::Coil, 0x2000, vec![1])]);
    assert_eq!(coils(&[line(0x18, 0, 0, COIL, 0x2000)], 0), [(Space::Coil, 0x2000, vec![1, 0])]);
    // XOR_MODBUS_CONST with 1, and a shift. The shifted bit is still a value other than 0, so the coil stays
    // set.
    assert_eq!(coils(&[line(0x2E, 0, 0, COIL, 0x2001), 1], 0), [(Space::Coil, 0x2001, vec![0])]);
    assert_eq!(coils(&[line(0x2F, 0, 0, COIL, 0x2001), 3], 0), [(Space::Coil, 0x2001, vec![1])]);
}

#[test]
fn registers_that_are_not_there_are_an_error() {
    let lines = [
        // MOV_SYSREG_CONST to the eleventh register and to the last one that fits into the field.
        [line(0x01, 0, 10, 0, 1), 0],
        [line(0x01, 0, 15, 0, 1), 0],
        // DMOV_SYSREG_CONST to JX, which has no register after it.
        [line(0x10, 0, JX, 0, 0), 1],
        // ADD_SYSREG_SYSREG with a register number of 10 or more in uData, and DADD with the pair of JX.
        [line(0x37, 0, AX, 0, 10), 0],
        [line(0x37, 0, AX, 0, 0xFFFF), 0],
        [line(0x5C, 0, AX, 0, JX), 0],
        [line(0x0F, 0, AX, 0, 10), 0],
        [line(0x14, 0, JX, 0, AX), 0],
        [line(0x14, 0, AX, 0, JX), 0],
        // MOV_SYSREG_MODBUS of an address without a register, and of types that do not exist.
        [line(0x03, 0, AX, HOLDING, 0x502), 0],
        [line(0x03, 0, AX, 4, 0x500), 0],
        [line(0x03, 0, AX, 15, 0x500), 0],
        // DMOV_SYSREG_MODBUS past the last register, and past the last address.
        [line(0x11, 0, AX, HOLDING, 0x501), 0],
        [line(0x11, 0, AX, HOLDING, 0xFFFF), 0],
        [line(0x12, 0, AX, HOLDING, 0xFFFF), 0],
        // MOV_MODBUS_SYSREG and similar commands to types that can only be read. The line itself is legal,
        // but its execution is an error.
        [line(0x02, 0, AX, DISCRETE, 0x1000), 0],
        [line(0x02, 0, AX, INPUT, 0x3000), 0],
        [line(0x13, 0, AX, INPUT, 0x3000), 0],
        [line(0x30, 0, AX, INPUT, 0x3000), 0],
        [line(0x55, 0, AX, INPUT, 0x3000), 0],
        // NOT_MODBUS and MODBUS_CONST of types that can only be read.
        [line(0x16, 0, 0, DISCRETE, 0x1000), 0],
        [line(0x0E, 0, 0, INPUT, 0x3000), 1],
    ];
    for lines in lines {
        let mut drive = Drive::running(&lines)
            .with_bus(Space::Holding, 0x500, &[7, 7])
            .with_bus(Space::Holding, 0xFFFF, &[7])
            .with_bus(Space::Holding, 0x0000, &[7])
            .with_bus(Space::Input, 0x3000, &[7, 7])
            .with_bus(Space::Discrete, 0x1000, &[1]);
        assert_eq!(drive.step(), Step::Error, "{:08X}", lines[0]);
        assert_eq!(
            (drive.program.status(), drive.registers()),
            (Status::Failed, [0; 10]),
            "{:08X}",
            lines[0]
        );
        assert!(drive.written.is_empty(), "{:08X}", lines[0]);
    }
}

#[test]
fn a_constant_behind_the_last_line_is_an_error() {
    for command in [0x0E, 0x10, 0x12, 0x28, 0x2F, 0x3E, 0x4D, 0x54] {
        let mut lines = vec![jump(LAST)];
        lines.resize(LAST as usize, 0);
        lines.push(line(command, 0, AX, HOLDING, 0x500));
        let mut drive = Drive::running(&lines).with_bus(Space::Holding, 0x500, &[0, 0]);
        assert_eq!(drive.step(), Step::Next);
        assert_eq!(drive.step(), Step::Error, "{command:#x}");
        assert_eq!(drive.program.vm.line, 1_023);
    }
}

#[test]
fn there_is_no_command_behind_0x66() {
    for command in 0x67..0x80 {
        assert_eq!(Drive::running(&[line(command, 0, 0, 0, 0)]).step(), Step::Error, "{command:#x}");
    }
}
