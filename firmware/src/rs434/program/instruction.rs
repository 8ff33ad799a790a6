//! Lines of a program: their fields, and the table of commands (6.9).

/// A line of a program (fig. 9). Fields that its command does not use may have any value.
#[derive(Clone, Copy, PartialEq, Eq, Default, Debug)]
pub struct Instruction(pub u32);

impl Instruction {
    /// Bits of uCmd.
    pub const COMMAND: u32 = 0x0000_007F;
    /// The bit of bTypeJmp.
    pub const TYPE_JMP: u32 = 0x0000_0080;
    /// Bits of uAdrSysReg.
    pub const REGISTER: u32 = 0x0000_0F00;
    /// Bits of uTypeModbusReg.
    pub const SPACE: u32 = 0x0000_F000;
    /// Bits of uData.
    pub const DATA: u32 = 0xFFFF_0000;

    /// uCmd, 0 to 127.
    #[must_use]
    pub const fn code(self) -> u8 {
        (self.0 & Self::COMMAND) as u8
    }

    /// bTypeJmp: for a jump, relative to its own line; for a shift, to the right.
    #[must_use]
    pub const fn type_jmp(self) -> bool {
        self.0 & Self::TYPE_JMP != 0
    }

    /// uAdrSysReg, 0 to 15. Valid are 0 to 9: AX, BX, CX, DX, EX, FX, GX, HX, IX, JX.
    #[must_use]
    pub const fn register(self) -> u8 {
        ((self.0 & Self::REGISTER) >> 8) as u8
    }

    /// uTypeModbusReg, 0 to 15. Valid are 0 discrete inputs, 1 coils, 2 input registers, 3 holding registers.
    #[must_use]
    pub const fn space(self) -> u8 {
        ((self.0 & Self::SPACE) >> 12) as u8
    }

    /// uData.
    #[must_use]
    pub const fn data(self) -> u16 {
        (self.0 >> 16) as u16
    }

    /// Command for the value of uCmd; `None` if there is no such command.
    #[must_use]
    pub fn command(self) -> Option<Opcode> {
        COMMANDS.get(usize::from(self.code())).copied()
    }
}

/// Operation of a command.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Operation {
    /// END: ends the program. The motor continues, and all registers keep their values.
    Stop,
    /// ENDF: ends the program, stops the motor, and restores the registers from before the start.
    FullStop,
    /// Waits for a number of ms before the next line.
    Delay,
    /// Continues at another line.
    Jump,
    /// PARI: jumps if two values are equal: AX and BX, or with 32 bits the pairs of GX and IX.
    JumpEqual,
    /// NOPARI: jumps if the values are not equal.
    JumpUnequal,
    /// MORE: jumps if the first value is greater, unsigned.
    JumpGreater,
    /// LESS: jumps if the first value is less, unsigned.
    JumpLess,
    /// Continues at another line until [`Return`](Self::Return).
    Call,
    /// Continues after the last [`Call`](Self::Call).
    Return,
    /// Executes the next lines several times.
    For,
    /// D = S2.
    Move,
    /// D = S1 + S2.
    Add,
    /// D = S1 − S2.
    Subtract,
    /// D = S1 / S2, without the remainder.
    Divide,
    /// D = S1 · S2.
    Multiply,
    /// D = S1 & S2.
    And,
    /// D = S1 | S2.
    Or,
    /// D = S1 ^ S2.
    Xor,
    /// D = S1 << S2, or D = S1 >> S2.
    Shift,
    /// D = !D.
    Not,
}

/// Fields that a command uses. If there are two operands, the first one is S1 and D, the second one is S2.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum OperandForm {
    /// No field.
    NoOperand,
    /// bTypeJmp and uData: a line number, or a distance in lines.
    Target,
    /// uData: a time in ms.
    Time,
    /// uData: a line number.
    Subroutine,
    /// uData: number of lines in the high byte, number of rounds in the low byte.
    Loop,
    /// uAdrSysReg: a system register.
    Register,
    /// uTypeModbusReg and uData: a register of the bus.
    Modbus,
    /// System register in uAdrSysReg, constant in uData, or with 32 bits in the next line.
    RegisterConstant,
    /// System register in uAdrSysReg, register of the bus in uTypeModbusReg and uData.
    RegisterModbus,
    /// Register of the bus in uTypeModbusReg and uData, constant in the next line.
    ModbusConstant,
    /// Register of the bus in uTypeModbusReg and uData, system register in uAdrSysReg.
    ModbusRegister,
    /// System registers in uAdrSysReg and in uData. A [`Move`](Operation::Move) has the opposite direction,
    /// from the first to the second.
    RegisterRegister,
    /// System register in uAdrSysReg, number of bits in uData, direction in bTypeJmp (1 is right).
    RegisterShift,
    /// Register of the bus in uTypeModbusReg and uData, number of bits in the next line, direction in
    /// bTypeJmp (1 is right).
    ModbusShift,
}

/// A command.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Opcode {
    /// Operation.
    pub operation: Operation,
    /// True for 32 bits, which are in two registers, the low half in the first one.
    pub wide: bool,
    /// Form of its operands.
    pub form: OperandForm,
}

impl Opcode {
    /// Number of lines, including the constant: 1 or 2 (RS434-31).
    #[must_use]
    pub const fn lines(self) -> u16 {
        match self.form {
            OperandForm::ModbusConstant | OperandForm::ModbusShift => 2,
            OperandForm::RegisterConstant if self.wide => 2,
            _ => 1,
        }
    }

    /// Bits of the first line that have a meaning. The others may have any value.
    #[must_use]
    pub const fn used(self) -> u32 {
        use Instruction as I;
        I::COMMAND
            | match self.form {
                OperandForm::NoOperand => 0,
                OperandForm::Target => I::TYPE_JMP | I::DATA,
                OperandForm::Time | OperandForm::Subroutine | OperandForm::Loop => I::DATA,
                OperandForm::Register => I::REGISTER,
                OperandForm::RegisterConstant if self.wide => I::REGISTER,
                OperandForm::RegisterConstant | OperandForm::RegisterRegister => I::REGISTER | I::DATA,
                OperandForm::Modbus | OperandForm::ModbusConstant => I::SPACE | I::DATA,
                OperandForm::RegisterModbus | OperandForm::ModbusRegister => I::REGISTER | I::SPACE | I::DATA,
                OperandForm::RegisterShift => I::REGISTER | I::DATA | I::TYPE_JMP,
                OperandForm::ModbusShift => I::SPACE | I::DATA | I::TYPE_JMP,
            }
    }
}

/// A 16-bit command, or one without data, under its name in the manual without CMD_.
const fn word(name: &'static str, operation: Operation, form: OperandForm) -> (&'static str, Opcode) {
    (name, Opcode { operation, wide: false, form })
}

/// A 32-bit command, under its name in the manual without CMD_.
const fn pair(name: &'static str, operation: Operation, form: OperandForm) -> (&'static str, Opcode) {
    (name, Opcode { operation, wide: true, form })
}

/// Number of commands. The code of a command is its index.
const COUNT: usize = 0x67;

#[rustfmt::skip]
const TABLE: [(&str, Opcode); COUNT] = {
    use OperandForm::*;
    use Operation::*;
    [
        // 0x00
        word("stop_program",         Stop,          NoOperand),
        word("mov_sysreg_const",     Move,          RegisterConstant),
        word("mov_modbus_sysreg",    Move,          ModbusRegister),
        word("mov_sysreg_modbus",    Move,          RegisterModbus),
        word("delay",                Delay,         Time),
        word("jmp",                  Jump,          Target),
        word("jmp_ax_pari_bx",       JumpEqual,     Target),
        word("jmp_ax_nopari_bx",     JumpUnequal,   Target),
        word("jmp_ax_more_bx",       JumpGreater,   Target),
        word("jmp_ax_less_bx",       JumpLess,      Target),
        word("call",                 Call,          Subroutine),
        word("return",               Return,        NoOperand),
        word("for",                  For,           Loop),
        word("full_stop_program",    FullStop,      NoOperand),
        word("mov_modbus_const",     Move,          ModbusConstant),
        word("mov_sysreg_sysreg",    Move,          RegisterRegister),
        // 0x10
        pair("dmov_sysreg_const",    Move,          RegisterConstant),
        pair("dmov_sysreg_modbus",   Move,          RegisterModbus),
        pair("dmov_modbus_const",    Move,          ModbusConstant),
        pair("dmov_modbus_sysreg",   Move,          ModbusRegister),
        pair("dmov_sysreg_sysreg",   Move,          RegisterRegister),
        word("not_sysreg",           Not,           Register),
        word("not_modbus",           Not,           Modbus),
        pair("dnot_sysreg",          Not,           Register),
        pair("dnot_modbus",          Not,           Modbus),
        word("add_sysreg_const",     Add,           RegisterConstant),
        word("sub_sysreg_const",     Subtract,      RegisterConstant),
        word("div_sysreg_const",     Divide,        RegisterConstant),
        word("mul_sysreg_const",     Multiply,      RegisterConstant),
        word("and_sysreg_const",     And,           RegisterConstant),
        word("or_sysreg_const",      Or,            RegisterConstant),
        word("xor_sysreg_const",     Xor,           RegisterConstant),
        // 0x20
        word("sh_sysreg_const",      Shift,         RegisterShift),
        word("add_sysreg_modbus",    Add,           RegisterModbus),
        word("sub_sysreg_modbus",    Subtract,      RegisterModbus),
        word("div_sysreg_modbus",    Divide,        RegisterModbus),
        word("mul_sysreg_modbus",    Multiply,      RegisterModbus),
        word("and_sysreg_modbus",    And,           RegisterModbus),
        word("or_sysreg_modbus",     Or,            RegisterModbus),
        word("xor_sysreg_modbus",    Xor,           RegisterModbus),
        word("add_modbus_const",     Add,           ModbusConstant),
        word("sub_modbus_const",     Subtract,      ModbusConstant),
        word("div_modbus_const",     Divide,        ModbusConstant),
        word("mul_modbus_const",     Multiply,      ModbusConstant),
        word("and_modbus_const",     And,           ModbusConstant),
        word("or_modbus_const",      Or,            ModbusConstant),
        word("xor_modbus_const",     Xor,           ModbusConstant),
        word("sh_modbus_const",      Shift,         ModbusShift),
        // 0x30
        word("add_modbus_sysreg",    Add,           ModbusRegister),
        word("sub_modbus_sysreg",    Subtract,      ModbusRegister),
        word("div_modbus_sysreg",    Divide,        ModbusRegister),
        word("mul_modbus_sysreg",    Multiply,      ModbusRegister),
        word("and_modbus_sysreg",    And,           ModbusRegister),
        word("or_modbus_sysreg",     Or,            ModbusRegister),
        word("xor_modbus_sysreg",    Xor,           ModbusRegister),
        word("add_sysreg_sysreg",    Add,           RegisterRegister),
        word("sub_sysreg_sysreg",    Subtract,      RegisterRegister),
        word("div_sysreg_sysreg",    Divide,        RegisterRegister),
        word("mul_sysreg_sysreg",    Multiply,      RegisterRegister),
        word("and_sysreg_sysreg",    And,           RegisterRegister),
        word("or_sysreg_sysreg",     Or,            RegisterRegister),
        word("xor_sysreg_sysreg",    Xor,           RegisterRegister),
        pair("dadd_sysreg_const",    Add,           RegisterConstant),
        pair("dsub_sysreg_const",    Subtract,      RegisterConstant),
        // 0x40
        pair("ddiv_sysreg_const",    Divide,        RegisterConstant),
        pair("dmul_sysreg_const",    Multiply,      RegisterConstant),
        pair("dand_sysreg_const",    And,           RegisterConstant),
        pair("dor_sysreg_const",     Or,            RegisterConstant),
        pair("dxor_sysreg_const",    Xor,           RegisterConstant),
        pair("dsh_sysreg_const",     Shift,         RegisterShift),
        pair("dadd_sysreg_modbus",   Add,           RegisterModbus),
        pair("dsub_sysreg_modbus",   Subtract,      RegisterModbus),
        pair("ddiv_sysreg_modbus",   Divide,        RegisterModbus),
        pair("dmul_sysreg_modbus",   Multiply,      RegisterModbus),
        pair("dand_sysreg_modbus",   And,           RegisterModbus),
        pair("dor_sysreg_modbus",    Or,            RegisterModbus),
        pair("dxor_sysreg_modbus",   Xor,           RegisterModbus),
        pair("dadd_modbus_const",    Add,           ModbusConstant),
        pair("dsub_modbus_const",    Subtract,      ModbusConstant),
        pair("ddiv_modbus_const",    Divide,        ModbusConstant),
        // 0x50
        pair("dmul_modbus_const",    Multiply,      ModbusConstant),
        pair("dand_modbus_const",    And,           ModbusConstant),
        pair("dor_modbus_const",     Or,            ModbusConstant),
        pair("dxor_modbus_const",    Xor,           ModbusConstant),
        pair("dsh_modbus_const",     Shift,         ModbusShift),
        pair("dadd_modbus_sysreg",   Add,           ModbusRegister),
        pair("dsub_modbus_sysreg",   Subtract,      ModbusRegister),
        pair("ddiv_modbus_sysreg",   Divide,        ModbusRegister),
        pair("dmul_modbus_sysreg",   Multiply,      ModbusRegister),
        pair("dand_modbus_sysreg",   And,           ModbusRegister),
        pair("dor_modbus_sysreg",    Or,            ModbusRegister),
        pair("dxor_modbus_sysreg",   Xor,           ModbusRegister),
        pair("dadd_sysreg_sysreg",   Add,           RegisterRegister),
        pair("dsub_sysreg_sysreg",   Subtract,      RegisterRegister),
        pair("ddiv_sysreg_sysreg",   Divide,        RegisterRegister),
        pair("dmul_sysreg_sysreg",   Multiply,      RegisterRegister),
        // 0x60
        pair("dand_sysreg_sysreg",   And,           RegisterRegister),
        pair("dor_sysreg_sysreg",    Or,            RegisterRegister),
        pair("dxor_sysreg_sysreg",   Xor,           RegisterRegister),
        pair("djmp_gx_pari_ix",      JumpEqual,     Target),
        pair("djmp_gx_nopari_ix",    JumpUnequal,   Target),
        pair("djmp_gx_more_ix",      JumpGreater,   Target),
        pair("djmp_gx_less_ix",      JumpLess,      Target),
    ]
};

/// Commands by their codes: the part of the table that boards need.
#[expect(clippy::indexing_slicing, reason = "only ever evaluated by the compiler")]
pub static COMMANDS: [Opcode; COUNT] = {
    let mut commands = [TABLE[0].1; COUNT];
    let mut code = 0;
    while code < COUNT {
        commands[code] = TABLE[code].1;
        code += 1;
    }
    commands
};

/// Name of each code in the manual, without CMD_, in lower case.
#[expect(clippy::indexing_slicing, reason = "only ever evaluated by the compiler")]
pub static MNEMONICS: [&str; COUNT] = {
    let mut mnemonics = [""; COUNT];
    let mut code = 0;
    while code < COUNT {
        mnemonics[code] = TABLE[code].0;
        code += 1;
    }
    mnemonics
};

/// The code of a mnemonic; `None` if there is no such mnemonic.
#[must_use]
pub fn code(mnemonic: &str) -> Option<u8> {
    MNEMONICS.iter().position(|known| *known == mnemonic).map(|code| code as u8)
}
