//! The registers of an RS 434544 or 434546, under the names of the manual's chapter 6.

use drivetwin_protocol::line::{Line, Parity};
use drivetwin_protocol::registers::{Bank, Entries, Entry, Register, Row, Space, Table, entries};

use super::{LINES, fields};

/// The storage of the registers.
pub(super) type Words = Bank<Reg, { Reg::WORDS }>;

/// The two models, which differ in a few registers and limits.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Model {
    /// Up to 20 A.
    Rs434544,
    /// Up to 40 A.
    Rs434546,
}

/// Supply voltage of a drive if none is configured, in 0.1 V: the rated 24 V (section 3).
pub(super) const SUPPLY: u16 = 240;

const LAST_LINE: i64 = LINES as i64 - 1;
/// Reason why the manual has no value for a version (RS434-7).
const NOT_KNOWN: &str = "the manual prints x";

drivetwin_protocol::registers! {
    /// All four address spaces of Modbus. 32-bit values have the low word first.
    #[allow(non_camel_case_types, reason = "the names are the manual's")]
    pub enum Reg: LowFirst {
        /// 1 while the contact IN1 is closed, not debounced.
        IN1_bit = discrete(0x1000, "6.1").live(),
        /// 1 while the contact IN2 is closed, not debounced.
        IN2_bit = discrete(0x1001, "6.1").live(),
        /// 1 while the contact HARD_STOP is closed, as required for operation.
        IN_HARD_STOP_bit = discrete(0x1002, "6.1").live(),

        /// 1 starts the motor with ACC; reads 0.
        START_bit = coil(0x2000, "6.2"),
        /// 1 stops the motor with DEC; reads 0.
        STOP_bit = coil(0x2001, "6.2"),
        /// 1 stops the motor without a ramp; reads 0.
        HARD_STOP_bit = coil(0x2002, "6.2"),
        /// 1 makes CURRENT_POSITION 0; reads 0.
        CLR_POSITION_bit = coil(0x2003, "6.2"),

        /// State of the motor.
        STATUS = input(0x3000, "6.3").range(0, 2).live().fields(fields::STATUS),
        /// Current from the supply to the motor, in mA; 0 while current flows back.
        CURRENT_VALID = input(0x3001, "6.3").live(),
        /// Speed of the motor, in rpm.
        SPEED_VALID = input(0x3002, "6.3").live(),
        /// Edges of the Hall sensors, forward minus backward.
        CURRENT_POSITION = input(0x3003, "6.3").i32().live(),
        /// Temperature of the processor, in 0.1 °C.
        TEMPERATURE_MCU = input(0x3005, "6.3").reset(250).live(),
        /// Temperature of the power circuit, in 0.1 °C.
        TEMPERATURE_MOSFET = input(0x3006, "6.3").reset(250).live(),
        /// Temperature of the brake circuit, in 0.1 °C.
        TEMPERATURE_BRAKE = input(0x3007, "6.3").reset(250).live(),
        /// A new random number at each read.
        TASK_COUNTER = input(0x3008, "6.3").live(),
        /// State of the user program.
        STATUS_USER_PROGRAM = input(0x3009, "6.3").range(1, 7).reset(1).live().fields(fields::PROGRAM),

        /// Address on the bus; with 0 the drive obeys broadcasts and answers nothing. Takes effect after a
        /// save and a restart.
        SLAVE_ADDRESS_MODBUS = rw(0x5000, "6.4").range(0, 247).reset(1).saved(),
        /// Protocol and parity. Takes effect after a save and a restart.
        TYPE_MODBUS = rw(0x5001, "6.4").range(1, 5).reset(3).saved().fields(fields::TYPE),
        /// Baud rate. Takes effect after a save and a restart.
        BITRATE_MODBUS = rw(0x5002, "6.4").range(0, 10).reset(9).saved().fields(fields::BITRATE),
        /// Delay of every reply, in ms. Takes effect after a save and a restart.
        TIMEOUT_BROADCAST_MODBUS = rw(0x5003, "6.4").saved(),

        /// Source of commands for the motor.
        MODE_DEVICE = rw(0x5004, "6.5").range(1, 2).reset(1).saved().fields(fields::MODE_DEVICE),
        /// Command for the user program.
        MODE_USER_PROGRAM = rw(0x5005, "6.5").range(1, 3).reset(1).saved().fields(fields::MODE_PROGRAM),
        /// Type of motion.
        MODE_ROTATION = rw(0x5006, "6.5").range(1, 3).reset(1).saved().fields(fields::MODE_ROTATION),
        /// Function of IN1 and IN2.
        MODE_EXT_IN = rw(0x5007, "6.5").range(1, 5).reset(1).saved().fields(fields::MODE_EXT_IN),
        /// Number of the position for a move to a position.
        POSITION_N = rw(0x5008, "6.5").range(1, 4).reset(1).saved(),
        /// Current limit of the motor, in mA.
        REF_CURRENT = rw(0x5009, "6.5").range(1_000, 20_000).reset(20_000).saved(),
        /// Speed of the motor at full voltage, in rpm.
        RATED_SPEED = rw(0x500A, "6.5").range(1_000, 15_000).reset(3_000).saved(),
        /// Speed setpoint, in rpm.
        SPEED = rw(0x500B, "6.5").range(30, 15_000).reset(1_000).saved(),
        /// Acceleration: 10 is 100 rps², 1,000 is 5,000 rps², linear between them.
        ACC = rw(0x500C, "6.5").range(10, 1_000).reset(100).saved(),
        /// Deceleration, in the unit of ACC.
        DEC = rw(0x500D, "6.5").range(10, 1_000).reset(100).saved(),
        /// Direction of rotation.
        DIRECTION = rw(0x500E, "6.5").range(1, 2).reset(1).saved().fields(fields::DIRECTION),
        /// Pulses of one Hall sensor per turn.
        PULSES_PER_REVOLUTION = rw(0x500F, "6.5").range(1, 12).reset(4).saved(),
        /// Number of Hall sensors used.
        USE_HALL = rw(0x5010, "6.5").range(0, 2).reset(2).saved(),
        /// State of the motor's terminals at standstill.
        MODE_COIL = rw(0x5011, "6.5").range(0, 1).saved().fields(fields::MODE_COIL),
        /// Counts by which the stopping point of a move is shifted in the direction of the motion.
        OFFSET_COMPENSATION = rw(0x5012, "6.5").i16().saved(),
        /// Time for which a contact must be closed for a pulse, in ms.
        PRESSED_INPUTS_EXTERN = rw(0x5013, "6.1").reset(10).saved(),
        /// Time for which a contact must be open after a pulse, in ms.
        WAITED_INPUTS_EXTERN = rw(0x5014, "6.1").reset(10).saved(),
        /// Remaining distance of a move, in counts; counts down to 0 during the move.
        OFFSET = rw(0x5015, "6.5").i32().saved().live(),
        /// If not 0, every start copies this value to OFFSET.
        OFFSET_CONST = rw(0x5017, "6.5").i32().saved(),
        /// Target of a move to a position; the start copies one of the four positions here.
        TARGET_POSITION = rw(0x5019, "6.5").i32().saved(),
        /// Position 1.
        TARGET_POSITION1 = rw(0x501B, "6.5").i32().saved(),
        /// Position 2.
        TARGET_POSITION2 = rw(0x501D, "6.5").i32().saved(),
        /// Position 3.
        TARGET_POSITION3 = rw(0x501F, "6.5").i32().saved(),
        /// Position 4; not saved.
        TARGET_POSITION4 = rw(0x5021, "6.5").i32(),
        /// Errors. Writing 0 clears bits 8 and 11 to 15; the others stay until a restart.
        ERROR = rw(0x5023, "6.5").live().fields(fields::ERROR),
        /// 0x37FA saves 5000h to 5020h; reads 0.
        FLAG_SAVE_INI = rw(0x5024, "6.5").one_of(&[0, key::SAVE]),
        /// 0x8426 saves the user program from the buffer, 0x9346 loads it into the buffer; reads 0.
        FLAG_SAVE_USER_PROGRAM = rw(0x5025, "6.5").one_of(&[0, key::SAVE_PROGRAM, key::LOAD_PROGRAM]),
        /// 0x95AF restarts the drive; reads 0.
        FLAG_RESTART = rw(0x5026, "6.5").one_of(&[0, key::RESTART]),

        /// Number of a line: copies CMD_W to this line of the buffer.
        WRITE_CMD = rw(0x6000, "6.6").range(0, LAST_LINE),
        /// Instruction for WRITE_CMD: the command, then its data.
        CMD_W = rw(0x6001, "6.6").u32(),
        /// Number of a line: copies this line of the buffer to CMD_R.
        READ_CMD = rw(0x6003, "6.6").range(0, LAST_LINE),
        /// Instruction read by READ_CMD: the command, then its data.
        CMD_R = rw(0x6004, "6.6").u32(),

        /// Register of the user program: its uAdrSysReg 0, the low word of a pair with BX_REG.
        AX_REG = rw(0x7000, "6.7").live(),
        /// Register of the user program: its uAdrSysReg 1, the low word of a pair with CX_REG.
        BX_REG = rw(0x7001, "6.7").live(),
        /// Register of the user program: its uAdrSysReg 2, the low word of a pair with DX_REG.
        CX_REG = rw(0x7002, "6.7").live(),
        /// Register of the user program: its uAdrSysReg 3, the low word of a pair with EX_REG.
        DX_REG = rw(0x7003, "6.7").live(),
        /// Register of the user program: its uAdrSysReg 4, the low word of a pair with FX_REG.
        EX_REG = rw(0x7004, "6.7").live(),
        /// Register of the user program: its uAdrSysReg 5, the low word of a pair with GX_REG.
        FX_REG = rw(0x7005, "6.7").live(),
        /// Line number at which the user program is.
        PC_REG = ro(0x7006, "6.7").live(),
        /// Register of the user program: its uAdrSysReg 6, the low word of a pair with HX_REG.
        GX_REG = rw(0x7007, "6.7").live(),
        /// Register of the user program: its uAdrSysReg 7, the low word of a pair with IX_REG.
        HX_REG = rw(0x7008, "6.7").live(),
        /// Register of the user program: its uAdrSysReg 8, the low word of a pair with JX_REG.
        IX_REG = rw(0x7009, "6.7").live(),
        /// Register of the user program: its uAdrSysReg 9, the high word of a pair with IX_REG only.
        JX_REG = rw(0x700A, "6.7").live(),

        /// Driver type: 1001 is the RS 434544, 1002 the RS 434546.
        HW_MAJOR = input(0x8001, "6.8").reset(1_001),
        /// Hardware version, set by a preset.
        HW_MINOR = input(0x8002, "6.8").reset(1).not_modelled(NOT_KNOWN),
        /// Software identifier, set by a preset.
        FW_MAJOR = input(0x8003, "6.8").reset(1).not_modelled(NOT_KNOWN),
        /// Software version, set by a preset.
        FW_MINOR = input(0x8004, "6.8").reset(1).not_modelled(NOT_KNOWN),

        /// Supply voltage that the drive measures, in 0.1 V: below 8 V and above 30 V it stops the motor.
        /// `supply_v` of a bench motor sets it at each power-on.
        SUPPLY = setting(0, "3").range(0, 1_000).reset(SUPPLY as i64).live(),
    }
}

/// Values that the key registers accept (6.5).
pub(super) mod key {
    pub(in crate::rs434) const SAVE: i64 = 0x37FA;
    pub(in crate::rs434) const SAVE_PROGRAM: i64 = 0x8426;
    pub(in crate::rs434) const LOAD_PROGRAM: i64 = 0x9346;
    pub(in crate::rs434) const RESTART: i64 = 0x95AF;
}

/// The versions that a preset can set. A reset or a load of the settings does not change them (HOST-21).
pub(super) const VERSIONS: [Reg; 3] = [Reg::HW_MINOR, Reg::FW_MAJOR, Reg::FW_MINOR];

/// Rows of the RS 434546.
#[expect(clippy::indexing_slicing, reason = "only ever evaluated by the compiler")]
const ROWS_434546: [Row; Reg::ROWS.len()] = {
    let mut rows = Reg::ROWS;
    let current = Reg::REF_CURRENT as usize;
    rows[current] = rows[current].range(2_000, 40_000).reset(40_000);
    let model = Reg::HW_MAJOR as usize;
    rows[model] = rows[model].reset(1_002);
    rows
};

/// Register map of the RS 434546.
pub(super) static TABLE_434546: Table = {
    static ROWS: [Row; Reg::ROWS.len()] = ROWS_434546;
    static LIST: [Entry; Reg::ROWS.len()] = entries(&ROWS_434546);
    static ENTRIES: Entries = Reg::ENTRIES.with_list(&LIST);
    Table::new(&ROWS, &ENTRIES)
};

/// Index of the row of each word of the bank.
#[expect(clippy::indexing_slicing, reason = "only ever evaluated by the compiler")]
static ROW_AT: [u8; Reg::WORDS] = {
    let mut rows = [0; Reg::WORDS];
    let (mut offset, mut row) = (0, 0);
    while row < Reg::ROWS.len() {
        let end = offset + Reg::ROWS[row].entry.shape.words() as usize;
        while offset < end {
            rows[offset] = row as u8;
            offset += 1;
        }
        row += 1;
    }
    rows
};

/// A word of the register map.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Word {
    /// The register with this word.
    pub(super) reg: Reg,
    /// Index in the bank.
    pub(super) offset: usize,
}

impl Word {
    /// The word at an address; `None` if there is no readable word.
    pub(super) fn at(space: Space, address: u16) -> Option<Self> {
        let offset = Reg::ENTRIES.readable(space, address, 1)?.start;
        let row = ROW_AT.get(offset).copied().map(usize::from)?;
        Some(Self { reg: Reg::from_row(row)?, offset })
    }

    /// The part of `value`, a value of the register, that this word holds.
    pub(super) fn of(self, value: i64) -> u16 {
        let is_first = self.offset == Reg::ENTRIES.offset(self.reg.row());
        if is_first { value as u16 } else { (value >> 16) as u16 }
    }

    fn entry(self) -> Option<&'static Entry> {
        Reg::ENTRIES.list.get(self.reg.row())
    }

    /// Returns true if the register must be updated before it is read.
    pub(super) fn is_live(self) -> bool {
        self.entry().is_some_and(|entry| entry.live)
    }

    pub(super) fn is_writable(self) -> bool {
        self.entry().is_some_and(|entry| entry.access.writes())
    }
}

impl Reg {
    /// Returns true for the coils, which control the motor.
    pub(super) fn is_control(self) -> bool {
        matches!(self, Self::START_bit | Self::STOP_bit | Self::HARD_STOP_bit | Self::CLR_POSITION_bit)
    }

    /// Index of a register from AX to JX. PC_REG, which is between them, is not one of them.
    pub(super) fn system(self) -> Option<usize> {
        let n = (self as usize).checked_sub(Self::AX_REG as usize)?;
        match self {
            Self::PC_REG => None,
            _ if self < Self::PC_REG => Some(n),
            _ if self <= Self::JX_REG => Some(n - 1),
            _ => None,
        }
    }
}

impl Model {
    /// Rated current of the motor, in mA (section 3): the factory value of REF_CURRENT.
    pub(super) fn rated_ma(self) -> u16 {
        self.entries().list.get(Reg::REF_CURRENT.row()).map_or(0, |entry| entry.reset as u16)
    }

    /// Least current that counts as a short circuit, in mA (section 3).
    pub(super) fn short_ma(self) -> u32 {
        match self {
            Self::Rs434544 => 30_000,
            Self::Rs434546 => 100_000,
        }
    }

    /// Register map for the bus.
    pub(super) fn entries(self) -> &'static Entries {
        match self {
            Self::Rs434544 => Reg::ENTRIES,
            Self::Rs434546 => TABLE_434546.entries,
        }
    }
}

/// Factory settings of the serial line (section 6).
pub(super) const FACTORY_LINE: Line = line(factory(Reg::TYPE_MODBUS), factory(Reg::BITRATE_MODBUS));

/// The factory value of a register.
#[expect(clippy::indexing_slicing, reason = "only ever evaluated by the compiler")]
const fn factory(reg: Reg) -> u16 {
    Reg::ROWS[reg as usize].entry.reset as u16
}

/// Settings of the serial line for values of TYPE_MODBUS and BITRATE_MODBUS (6.4).
pub(super) const fn line(kind: u16, bitrate: u16) -> Line {
    let baud = match bitrate {
        0 => 600,
        1 => 1_200,
        2 => 2_400,
        3 => 4_800,
        4 => 9_600,
        5 => 14_400,
        6 => 19_200,
        7 => 38_400,
        8 => 57_600,
        9 => 115_200,
        _ => 128_000,
    };
    match kind {
        1 => Line::new(baud, 7, Parity::Even, 1),
        2 => Line::new(baud, 7, Parity::Odd, 1),
        3 => Line::new(baud, 8, Parity::Even, 1),
        4 => Line::new(baud, 8, Parity::Odd, 1),
        _ => Line::new(baud, 8, Parity::None, 2),
    }
}
