//! User programs of an RS 434544 for measurements on the host and on boards. All lines except the first one
//! are executed repeatedly; AX counts the rounds.

/// A user program.
pub(crate) struct Program {
    pub(crate) lines: &'static [u32],
    /// Number of lines executed in a round.
    pub(crate) per_round: u32,
}

const AX: u32 = 0;
const BX: u32 = 1;
const CX: u32 = 2;
const DX: u32 = 3;
const EX: u32 = 4;
const GX: u32 = 6;

const INPUT: u32 = 2;
const HOLDING: u32 = 3;

const STATUS: u32 = 0x3000;
const CURRENT_POSITION: u32 = 0x3003;
const SPEED: u32 = 0x500B;
const DX_REG: u32 = 0x7003;

/// A line with these fields, from its low end: uCmd, bTypeJmp, uAdrSysReg, uTypeModbusReg, uData.
const fn line(command: u32, type_jmp: u32, register: u32, space: u32, data: u32) -> u32 {
    command | type_jmp << 7 | register << 8 | space << 12 | data << 16
}

/// First line of the programs, before the rounds.
pub(crate) const MOV_AX_0: u32 = line(0x01, 0, AX, 0, 0);
/// The last line of a round.
pub(crate) const JMP_1: u32 = line(0x05, 0, 0, 0, 1);
const ADD_AX_1: u32 = line(0x19, 0, AX, 0, 1);

/// A mix of all kinds of instructions.
pub(crate) const MIXED: Program = Program {
    lines: &[
        MOV_AX_0,
        ADD_AX_1,
        // 2: MOV_SYSREG_SYSREG from AX to BX, MUL_SYSREG_CONST.
        line(0x0F, 0, AX, 0, BX),
        line(0x1C, 0, BX, 0, 3),
        // 4: MOV_SYSREG_MODBUS.
        line(0x03, 0, CX, INPUT, STATUS),
        // 5: JMP_AX_NOPARI_BX to the next line.
        line(0x07, 1, 0, 0, 1),
        // 6: FOR three lines, twice: DADD_SYSREG_CONST, XOR_SYSREG_SYSREG.
        line(0x0C, 0, 0, 0, 0x0302),
        line(0x3E, 0, GX, 0, 0),
        5,
        line(0x3D, 0, DX, 0, AX),
        // From line 10: CALL, DMOV_SYSREG_MODBUS, MOV_MODBUS_CONST.
        line(0x0A, 0, 0, 0, 15),
        line(0x11, 0, EX, INPUT, CURRENT_POSITION),
        line(0x0E, 0, 0, HOLDING, SPEED),
        1_000,
        JMP_1,
        // From line 15: SH_SYSREG_CONST, RETURN.
        line(0x20, 0, BX, 0, 1),
        0x0B,
    ],
    per_round: 16,
};

/// Arithmetic and jumps.
pub(crate) const SYSTEM: Program = Program {
    lines: &[
        MOV_AX_0,
        ADD_AX_1,
        // XOR_SYSREG_SYSREG, DADD_SYSREG_SYSREG, OR_SYSREG_CONST, DSH_SYSREG_CONST.
        line(0x3D, 0, DX, 0, AX),
        line(0x5C, 0, GX, 0, CX),
        line(0x1E, 0, BX, 0, 0x55),
        line(0x45, 1, GX, 0, 1),
        // JMP_AX_LESS_BX to the next line.
        line(0x09, 1, 0, 0, 1),
        JMP_1,
    ],
    per_round: 7,
};

/// Reads and writes of registers of the bus.
pub(crate) const BUS: Program = Program {
    lines: &[
        MOV_AX_0,
        ADD_AX_1,
        // MOV_SYSREG_MODBUS, DMOV_SYSREG_MODBUS, MOV_MODBUS_CONST, MOV_MODBUS_SYSREG.
        line(0x03, 0, CX, HOLDING, SPEED),
        line(0x11, 0, EX, INPUT, CURRENT_POSITION),
        line(0x0E, 0, 0, HOLDING, SPEED),
        1_000,
        line(0x02, 0, AX, HOLDING, DX_REG),
        JMP_1,
    ],
    per_round: 6,
};
