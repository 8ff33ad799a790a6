//! Variables, flags and instructions with a value of an MDrive, under their mnemonics. Those that have an
//! address in the fieldbus manual (FB) come first, in its order; those that only MCode (MC) has follow.

use core::ops::RangeInclusive;

use crate::motor::stepper::StepperParameters;
use drivetwin_protocol::registers::{Entries, Entry, Register, Row, Table, entries, text};

use super::fields;

/// Bits of [`Entry::variants`].
pub(super) const PLUS: u8 = 1 << 0;
pub(super) const HYBRID: u8 = 1 << 1;

/// The two products.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Model {
    /// MDrivePlus².
    Plus,
    /// MDrive Hybrid.
    Hybrid,
}

impl Model {
    /// Bit of this product in the `variants` of a row.
    pub(super) const fn variant(self) -> u8 {
        match self {
            Self::Plus => PLUS,
            Self::Hybrid => HYBRID,
        }
    }

    pub(super) fn entries(self) -> &'static Entries {
        match self {
            Self::Plus => Reg::ENTRIES,
            Self::Hybrid => TABLE_HYBRID.entries,
        }
    }
}

/// Allowed values of MS: microsteps in a full step (FB 5).
const RESOLUTIONS: &[i64] =
    &[1, 2, 4, 5, 8, 10, 16, 25, 32, 50, 64, 100, 108, 125, 127, 128, 180, 200, 250, 256];

/// Maximum number of encoder lines, which is the largest value of EL.
const MOST_LINES: i64 = u16::MAX as i64;

/// Motor and load of a new drive.
const LOAD: StepperParameters = StepperParameters::NOMINAL;

// Where FB and MC give different defaults, FB applies (MDRIVE-25).
drivetwin_protocol::registers! {
    /// Sections are those of FB, or pages of MC where MC says more.
    #[allow(non_camel_case_types, reason = "the names are the manual's")]
    pub enum Reg: HighFirst {
        /// Acceleration, in steps/s²; counts/s² with EE.
        A = rw(0x0000, "5").i32().range(91, 1_525_878_997).reset(1_000_000).saved(),
        /// Motor steps made.
        C1 = rw(0x0005, "5").i32().live(),
        /// Edges of the encoder: forward edges minus backward edges.
        C2 = rw(0x0007, "5").i32().live(),
        /// Reaction to Ctrl-C; 2 in MCode only.
        CE = rw(0x0009, "5").u8().range(0, 1).reset(1).saved().fields(fields::CTRL_C),
        /// 1: I/O 7 and 8 are clock inputs or outputs.
        CM = rw(0x000B, "5").u8().range(0, 1).saved().only(PLUS),
        /// Debounce time of input 1, in ms.
        D1 = rw(0x000F, "5").u8().saved(),
        /// Debounce time of input 2, in ms.
        D2 = rw(0x0010, "5").u8().saved(),
        /// Debounce time of input 3, in ms.
        D3 = rw(0x0011, "5").u8().saved(),
        /// Debounce time of input 4, in ms.
        D4 = rw(0x0012, "5").u8().saved(),
        /// Number of readings over which I5 is averaged.
        D5 = rw(0x0013, "5").u8().saved(),
        /// Deceleration, in steps/s²; counts/s² with EE.
        D = rw(0x0018, "5").i32().range(91, 1_525_878_997).reset(1_000_000).saved(),
        /// With EE, a move is complete if its final position is within this number of counts.
        DB = rw(0x001A, "5").range(0, 65_000).reset(10).saved().only(PLUS),
        /// Subtracts 1 from the variable at the address written.
        DC = rw(0x001B, "5").u8().live(),
        /// 1: the output bridge is on.
        DE = rw(0x001C, "5").u8().range(0, 1).reset(1).saved(),
        /// 1: positions and speeds are in counts of the encoder.
        EE = rw(0x001E, "5").u8().range(0, 1).saved(),
        /// 1: there is an error.
        EF = ro(0x001F, "5").u8().range(0, 1).live(),
        /// Number of the last error. Reading ER, or writing 0, clears ER and EF. Only MCode can write other
        /// numbers.
        ER = rw(0x0021, "5").range(0, 0).live(),
        /// Holding current, in %.
        HC = rw(0x0029, "5").u8().range(0, 100).reset(5).saved(),
        /// Homes to the switch; reads the last type.
        HM = rw(0x002B, "5").u8().range(1, 4).reset(1).fields(fields::HOMING),
        /// Delay from the end of motion and MT to the holding current HC, in ms: 0 for never, or 2 to 65535 -
        /// MT.
        HT = rw(0x002C, "5").reset(500).saved(),
        /// 1: input 1 is active.
        I1 = ro(0x002D, "5").u8().range(0, 1).live().also_discrete(),
        /// 1: input 2 is active.
        I2 = ro(0x002E, "5").u8().range(0, 1).live().also_discrete(),
        /// 1: input 3 is active.
        I3 = ro(0x002F, "5").u8().range(0, 1).live().also_discrete(),
        /// 1: input 4 is active.
        I4 = ro(0x0030, "5").u8().range(0, 1).live().also_discrete(),
        /// The analogue input, 0 to 1023.
        I5 = ro(0x0031, "5").range(0, 1_023).live(),
        /// 1: the encoder is on its index.
        I6 = ro(0x0032, "5").u8().range(0, 1).live().only(PLUS),
        /// Adds 1 to the variable at the address written.
        IC = rw(0x0037, "5").u8().live(),
        /// Levels of inputs 1 to 4, debounced.
        IL = ro(0x003A, "5").u8().range(0, 15).live().fields(fields::INPUTS),
        /// Levels of inputs 1 to 4, not debounced.
        IN = ro(0x003B, "5").u8().range(0, 255).live().fields(fields::INPUTS),
        /// 1: the jog inputs turn the motor.
        JE = rw(0x003F, "5").u8().range(0, 1).saved(),
        /// Reaction to a limit.
        LM = rw(0x0042, "5").u8().range(1, 6).reset(1).saved().fields(fields::LIMIT),
        /// Moves to a position; reads the last target.
        MA = rw(0x0043, "5").i32(),
        /// 1: a move to a position is in progress.
        MP = ro(0x0045, "5").u8().range(0, 1).live(),
        /// Moves by a distance; reads the last distance.
        MR = rw(0x0046, "5").i32(),
        /// Microsteps in a full step.
        MS = rw(0x0048, "5").one_of(RESOLUTIONS).reset(256).saved(),
        /// Settling time of the motor, in ms.
        MT = rw(0x0049, "5").range(0, 65_000).saved(),
        /// 1: the motor moves or settles.
        MV = ro(0x004A, "5").u8().range(0, 1).live(),
        /// 1: output 1 is active.
        O1 = rw(0x004B, "5").u8().range(0, 1).live().also_coil(),
        /// 1: output 2 is active.
        O2 = rw(0x004C, "5").u8().range(0, 1).live().also_coil(),
        /// 1: output 3 is active.
        O3 = rw(0x004D, "5").u8().range(0, 1).live().also_coil(),
        /// 1: output 4 is active.
        O4 = rw(0x004E, "5").u8().range(0, 1).live().also_coil(),
        /// Sets outputs 1 to 4.
        OL = rw(0x0055, "5").u8().range(0, 15).live().fields(fields::OUTPUTS),
        /// Sets outputs 1 to 4, output 1 the lowest bit; values above 15 in MCode only.
        OT = rw(0x0056, "5").u8().range(0, 15).live(),
        /// The position: C1, or C2 with EE.
        P = rw(0x0057, "5").i32().live(),
        /// Position at the last trip, except trips on position (TP).
        PC = ro(0x0059, "5").i32().live(),
        /// 1: at standstill the position is kept within DB.
        PM = rw(0x005C, "5").u8().range(0, 1).saved().only(PLUS),
        /// User register.
        R1 = rw(0x005F, "5").i32().saved(),
        /// User register.
        R2 = rw(0x0061, "5").i32().saved(),
        /// User register.
        R3 = rw(0x0063, "5").i32().saved(),
        /// User register.
        R4 = rw(0x0065, "5").i32().saved(),
        /// Run current, in %.
        RC = rw(0x0067, "5").u8().range(1, 100).reset(25).saved(),
        /// Saves the variables.
        S = rw(0x0076, "5").u8().live(),
        /// Stall factor: a position error of this many counts is a stall.
        SF = rw(0x0077, "5").range(0, 65_000).reset(15).saved().only(PLUS),
        /// Turns the motor at this speed, in steps/s; reads the last speed.
        SL = rw(0x0078, "5").i32().range(-5_000_000, 5_000_000),
        /// 1: a stall does not stop the motion.
        SM = rw(0x007A, "5").u8().range(0, 1).saved().only(PLUS),
        /// 1: the motor has stalled.
        ST = rw(0x007B, "5").u8().range(0, 1).live().only(PLUS),
        /// Trips that are enabled, one bit each; values above 43 in MCode only.
        TE = rw(0x007D, "5").u8().range(0, 43).live(),
        /// The velocity, in steps/s; counts/s with EE.
        V = ro(0x0085, "5").i32().live(),
        /// 1: the velocity changes.
        VC = ro(0x0088, "5").u8().range(0, 1).live(),
        /// Initial and final speed of a ramp, in steps/s; counts/s with EE. Below VM.
        VI = rw(0x0089, "5").i32().range(1, 4_999_999).reset(1_000).saved(),
        /// Maximum speed of a move, in steps/s; counts/s with EE. Above VI.
        VM = rw(0x008B, "5").i32().range(2, 5_000_000).reset(768_000).saved(),

        /// Mode of the Hybrid: 0 off, 1 fixed current, 2 variable current, 3 torque.
        AS = rw(0x008E, "5.1").u8().range(0, 3).reset(2).saved().only(HYBRID),
        /// Status of the Hybrid, one bit per condition; values above 255 in MCode only.
        AF = ro(0x008F, "5.1").u8().live().only(HYBRID),
        /// Calibration mode.
        CA = rw(0x0090, "5.1").u8().range(0, 1).reset(1).saved().only(HYBRID),
        /// Bounds of the rotor's lag: 1.1, 1.3, 1.5 or 1.7 full steps.
        CB = rw(0x0091, "5.1").u8().range(0, 3).reset(1).saved().only(HYBRID),
        /// Current during a calibration, in %.
        CC = rw(0x0092, "5.1").u8().range(1, 100).reset(100).saved().only(HYBRID),
        /// Clears a locked rotor and calibrates.
        CF = rw(0x0093, "5.1").u8().live().only(HYBRID),
        /// Calibration time, in ms: the duration of each of the three waits of a calibration.
        CT = rw(0x0094, "5.1").range(2, 65_535).reset(200).saved().only(HYBRID),
        /// Limit of the rotor's lead, in steps.
        LD = rw(0x0095, "5.1").i32().range(0, 2_147_483_647).reset(102_400).saved().only(HYBRID),
        /// Limit of the rotor's lag, in steps.
        LG = rw(0x0097, "5.1").i32().range(0, 2_147_483_647).reset(102_400).saved().only(HYBRID),
        /// Steps by which the rotor lags; negative if it leads.
        LL = ro(0x0099, "5.1").i32().live().only(HYBRID),
        /// 1: the rotor is locked.
        LR = ro(0x009B, "5.1").u8().range(0, 1).live().only(HYBRID),
        /// Time without movement after which the rotor counts as locked, in ms. The value is in the second of
        /// the two registers.
        LT = rw(0x009C, "5.1").u32().range(2, 65_535).reset(2_000).saved().only(HYBRID),
        /// Speed at which missed steps are made up for, in steps/s, if MU is 1.
        MF = rw(0x009E, "5.1").i32().range(306, 5_000_000).reset(768_000).saved().only(HYBRID),
        /// Treatment of missed steps: 0 they are lost, 1 they are made up for at MF, 2 at SS.
        MU = rw(0x00A0, "5.1").u8().range(0, 2).saved().only(HYBRID),
        /// Starts a calibration.
        SC = rw(0x00A1, "5.1").u8().live().only(HYBRID),
        /// Maximum speed of the rotor with AS 1 and 2, in steps/s: 10 MHz/(n + 2).
        SS = rw(0x00A2, "5.1").u8().saved().only(HYBRID),
        /// Direction in torque mode: 1 forward, 0 backward.
        TD = rw(0x00A5, "5.1").u8().range(0, 1).reset(1).saved().only(HYBRID),
        /// Torque in torque mode, in %.
        TQ = rw(0x00A6, "5.1").u8().range(1, 100).reset(25).saved().only(HYBRID),
        /// Maximum speed of the rotor with AS 3, in steps/s: 10 MHz/(n + 2).
        TS = rw(0x00A7, "5.1").u8().saved().only(HYBRID),

        /// User variable; the register exists once the variable is declared.
        V1 = rw(0x00A8, "5.2").i32().live().optional(),
        /// User variable; the register exists once the variable is declared.
        V2 = rw(0x00AA, "5.2").i32().live().optional(),
        /// User variable; the register exists once the variable is declared.
        V3 = rw(0x00AC, "5.2").i32().live().optional(),
        /// User variable; the register exists once the variable is declared.
        V4 = rw(0x00AE, "5.2").i32().live().optional(),
        /// User variable; the register exists once the variable is declared.
        V5 = rw(0x00B0, "5.2").i32().live().optional(),
        /// User variable; the register exists once the variable is declared.
        V6 = rw(0x00B2, "5.2").i32().live().optional(),
        /// User variable; the register exists once the variable is declared.
        V7 = rw(0x00B4, "5.2").i32().live().optional(),
        /// User variable; the register exists once the variable is declared.
        V8 = rw(0x00B6, "5.2").i32().live().optional(),

        /// 1: a program runs.
        BY = fact(1, "MC 5-6").range(0, 1).live(),
        /// Clock ratio, in thousandths.
        CR = variable(2, "MC 5-14").range(1, 2_000).reset(1_000).saved().only(PLUS),
        /// Width of clock and trip pulses, in units of 50 ns.
        CW = variable(3, "MC 5-15").u8().reset(10).saved(),
        /// Lines of the encoder.
        EL = variable(4, "MC 5-22").range(1, MOST_LINES).reset(512).saved(),
        /// Echo mode.
        EM = variable(5, "MC 5-22").range(0, 3).saved().fields(fields::ECHO),
        /// Key that stops motion and program.
        ES = variable(6, "MC 5-23").range(0, 3).reset(1).saved().fields(fields::ESCAPE),
        /// Filter of the capture input, by number.
        FC = variable(7, "MC 5-25").range(0, 9).saved(),
        /// Filter of the clock inputs and of a remote encoder, by number.
        FM = variable(8, "MC 5-26").range(0, 9).reset(2).saved().only(PLUS),
        /// 1: the drive waits for a number (IV).
        IF = variable(9, "MC 5-36").range(0, 1).live(),
        /// Internal temperature, in °C.
        IT = fact(10, "MC 5-38").i16().live().only(HYBRID),
        /// Warning temperature, in °C.
        WT = variable(11, "MC 5-81").range(0, 84).reset(80).saved().only(HYBRID),
        /// 1: the program can be neither listed nor changed.
        LK = variable(12, "MC 5-42").range(0, 1).saved(),
        /// 1: a number without a command repeats the last motion command.
        NE = variable(13, "MC 5-51").range(0, 1).reset(1).saved(),
        /// Filter of the velocity in torque mode.
        VF = variable(14, "MC 5-79").range(0, 1_000).saved().only(HYBRID)
            .not_modelled("V is 0 in torque mode, so it filters nothing"),
        /// I/O 1: type, active state, sinking or sourcing.
        S1 = variable(15, "MC 5-63").words(3).saved(),
        /// I/O 2: type, active state, sinking or sourcing.
        S2 = variable(18, "MC 5-63").words(3).saved(),
        /// I/O 3: type, active state, sinking or sourcing.
        S3 = variable(21, "MC 5-63").words(3).saved(),
        /// I/O 4: type, active state, sinking or sourcing.
        S4 = variable(24, "MC 5-63").words(3).saved(),
        /// Analogue input: type and range. Type 9, voltage: range 0 is 0 to 5 V, 1 is 0 to 10 V. Type 10,
        /// current: range 0 is 0 to 20 mA, 1 is 4 to 20 mA.
        S5 = variable(27, "MC 5-65").words(2).reset(9 << 16).saved(),
        /// Clock I/O 7: type, active state.
        S7 = variable(29, "MC 5-66").words(2).reset(33 << 16).saved().only(PLUS),
        /// Clock I/O 8: type, active state.
        S8 = variable(31, "MC 5-66").words(2).reset(33 << 16).saved().only(PLUS),
        /// Capture input or trip output: type, active state.
        S13 = variable(33, "MC 5-67").words(2).reset(60 << 16).saved(),
        /// Baud rate of drives with a serial port.
        BD = variable(35, "MC 5-4").one_of(&[48, 96, 19, 38, 11]).reset(96).saved().not_modelled("TCP has none"),
        /// Checksums of drives with a serial port.
        CK = variable(36, "MC 5-12").range(0, 2).saved().fields(fields::CHECKSUM),
        /// Drives with a serial port: 1: no answer to lines that are for all drives.
        DG = variable(37, "MC 5-19").range(0, 1).reset(1).saved(),
        /// Drives with a serial port: name of the drive, one character.
        DN = variable(38, "MC 5-20").range(33, 122).reset(33).saved(),
        /// Drives with a serial port: 1: party mode.
        PY = variable(39, "MC 5-59").range(0, 1).saved(),
        /// Drives with a serial port: 1: the drive also receives lines for queued drives.
        QD = variable(40, "MC 5-60").range(0, 1).saved(),
        /// Second value of CA, saved together with CA. 1: torque compensation.
        CalibrationMethod = variable(41, "MC 5-8").range(0, 1).only(HYBRID),

        /// 1: the commands of drives with a serial port are available, too.
        SerialCommands = setting(1, "MC 1.2.2").range(0, 1).saved(),

        /// Torque that holds the motor at RC = 100, in mN·m; 0: with current the motor follows, whatever its
        /// load is.
        HoldingTorque = setting(2, "MC 5-70").u32().range(0, 100_000),
        /// Speed at which the motor has no torque left, in rpm; the torque falls evenly with the speed.
        PullOutSpeed = setting(4, "MC 5-70").u32().range(1, 200_000).reset(LOAD.pull_out_rpm as i64),
        /// Inertia of rotor and load, in g·cm².
        Inertia = setting(6, "MC 5-70").u32().range(1, 10_000_000).reset(LOAD.inertia_gcm2 as i64),
        /// Friction torque against any motion, in mN·m. Without current only friction holds the shaft.
        Friction = setting(8, "MC 5-70").u32().range(0, 100_000).reset(LOAD.friction_unm as i64 / 1_000),
        /// Torque of the load, in mN·m, positive against forward motion.
        Load = setting(10, "MC 5-70").i32().range(-100_000, 100_000),
        /// Full steps of the motor in a revolution.
        FullSteps = setting(12, "MC 7.3.1").range(4, 10_000).reset(LOAD.steps_per_rev as i64),

        /// PN, and object 1 of the device identification. `PartNumber` presets both halves.
        PartNumber1 = setting(13, "MC 5-56").text().reset(text(b"MDI3CRL2")),
        /// Second half of PN.
        PartNumber2 = setting(17, "MC 5-56").text().reset(text(b"3A7-EQ")),
        /// SN, and object 5 of the device identification. `SerialNumber` presets both halves.
        SerialNumber1 = setting(21, "MC 5-69").text().reset(text(b"12345678")),
        /// Second half of SN.
        SerialNumber2 = setting(25, "MC 5-69").text().reset(text(b"9")),
        /// VR, and the end of object 6 of the device identification. `FirmwareVersion` presets both halves.
        FirmwareVersion1 = setting(29, "MC 5-80").text().reset(text(b"3.0.0.9")),
        /// Second half of the first value of VR.
        FirmwareVersion2 = setting(33, "MC 5-80").text(),
        /// Second value of VR; "1.8+" calibrates as MC 5-8 says.
        HardwareVersion = setting(37, "MC 5-80").text().reset(text(b"1.8")).only(HYBRID),
        /// Firmware version of the Ethernet controller: object 2 of the device identification.
        EthernetVersion = setting(41, "4.1.1").text().reset(text(b"4.0.0.0")),
    }
}

/// Settings of the motor, its load and the identification. They keep their values when the variables are
/// reset.
pub(super) const LASTING: [Reg; 14] = [
    Reg::HoldingTorque,
    Reg::PullOutSpeed,
    Reg::Inertia,
    Reg::Friction,
    Reg::Load,
    Reg::FullSteps,
    Reg::PartNumber1,
    Reg::PartNumber2,
    Reg::SerialNumber1,
    Reg::SerialNumber2,
    Reg::FirmwareVersion1,
    Reg::FirmwareVersion2,
    Reg::HardwareVersion,
    Reg::EthernetVersion,
];

/// Identification texts, each as the list of the registers that hold its parts.
pub(super) const PART_NUMBER: &[Reg] = &[Reg::PartNumber1, Reg::PartNumber2];
pub(super) const SERIAL_NUMBER: &[Reg] = &[Reg::SerialNumber1, Reg::SerialNumber2];
pub(super) const FIRMWARE: &[Reg] = &[Reg::FirmwareVersion1, Reg::FirmwareVersion2];
pub(super) const HARDWARE: &[Reg] = &[Reg::HardwareVersion];
pub(super) const ETHERNET: &[Reg] = &[Reg::EthernetVersion];

/// The values that a row takes in MCode, if they are not those of the bus.
pub(super) fn mcode_range(reg: Reg) -> Option<RangeInclusive<i64>> {
    match reg {
        // MCode also has CE = 2 (MC 5-11).
        Reg::CE => Some(0..=2),
        // Programs of real machines set errors of their own.
        Reg::ER => Some(0..=255),
        // Values above 15 are for outputs 9 to 12, which drives with Ethernet do not have (MC 5-54).
        Reg::OT => Some(0..=255),
        // Values above 43 are for TR and TA (MC 5-73).
        Reg::TE => Some(0..=63),
        // In steps/s (MC 5-70, 5-76).
        Reg::SS | Reg::TS => Some(38_910..=5_000_000),
        _ => None,
    }
}

/// Returns true if MCode gives this variable in steps/s, and the drive stores a divider.
pub(super) fn is_frequency(reg: Reg) -> bool {
    matches!(reg, Reg::SS | Reg::TS)
}

/// Returns true if MCode accepts a value, as the drive stores it. A row without a range of MCode has that of the bus
/// (FB 5).
pub(super) fn mcode_accepts(reg: Reg, value: i64) -> bool {
    match mcode_range(reg) {
        Some(range) if !is_frequency(reg) => range.contains(&value),
        _ => Reg::ENTRIES.list.get(reg.row()).is_some_and(|entry| entry.accepts(value)),
    }
}

/// All rows, for other tables that are computed at compile time.
pub(super) const ROWS: &[Row] = &Reg::ROWS;

/// Rows of the Hybrid: those of the MDrivePlus² with other defaults.
#[expect(clippy::indexing_slicing, reason = "only ever evaluated by the compiler")]
static ROWS_HYBRID: [Row; Reg::ROWS.len()] = {
    let mut rows = Reg::ROWS;
    let lines = Reg::EL as usize;
    rows[lines] = rows[lines].reset(1_000);
    let (part, version) = (Reg::PartNumber1 as usize, Reg::FirmwareVersion1 as usize);
    rows[part] = rows[part].reset(text(b"MAI3CRL2"));
    rows[version] = rows[version].reset(text(b"4.0.0.8"));
    rows
};

/// Register map of the Hybrid.
pub(super) static TABLE_HYBRID: Table = {
    static LIST: [Entry; Reg::ROWS.len()] = entries(&ROWS_HYBRID);
    static ENTRIES: Entries = Reg::ENTRIES.with_list(&LIST);
    Table::new(&ROWS_HYBRID, &ENTRIES)
};
