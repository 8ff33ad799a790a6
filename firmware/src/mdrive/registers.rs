//! The variables, flags and instructions with a value of an MDrive, under their mnemonics: those that the fieldbus
//! manual (FB) gives an address come first, in its order, then those that only MCode (MC) knows.

use crate::motor::stepper::StepperParameters;
use drivetwin_protocol::registers::{Entries, Entry, Register, Row, Table, entries, text};

/// Bits of [`Entry::variants`].
pub(super) const PLUS: u8 = 1 << 0;
pub(super) const HYBRID: u8 = 1 << 1;

/// Microsteps in a full step that there are (FB 5, MS).
const RESOLUTIONS: &[i64] =
    &[1, 2, 4, 5, 8, 10, 16, 25, 32, 50, 64, 100, 108, 125, 127, 128, 180, 200, 250, 256];

/// The most lines of an encoder: what EL holds.
const MOST_LINES: i64 = u16::MAX as i64;

/// Motor and load of a new drive.
const LOAD: StepperParameters = StepperParameters::NOMINAL;

// Where the defaults of the manuals differ, those of FB hold (MDRIVE-25).
drivetwin_protocol::registers! {
    /// Sections are those of FB, with the page of MC where that says more.
    #[allow(non_camel_case_types, reason = "the names are the manual's")]
    pub enum Reg: HighFirst {
        /// Acceleration, in steps/s²; counts/s² with EE.
        A = rw(0x0000, "5").i32().range(91, 1_525_878_997).reset(1_000_000).saved(),
        /// Motor steps made.
        C1 = rw(0x0005, "5").i32().live(),
        /// Edges of the encoder, forward less backward.
        C2 = rw(0x0007, "5").i32().live(),
        /// 1: Ctrl-C restarts; 2, in MCode only: if it is addressed, in party mode.
        CE = rw(0x0009, "5").u8().range(0, 1).reset(1).saved(),
        /// 1: clock inputs or outputs at I/O 7 and 8.
        CM = rw(0x000B, "5").u8().range(0, 1).saved().only(PLUS),
        /// Debounce time of input 1, in ms.
        D1 = rw(0x000F, "5").u8().saved(),
        /// Debounce time of input 2, in ms.
        D2 = rw(0x0010, "5").u8().saved(),
        /// Debounce time of input 3, in ms.
        D3 = rw(0x0011, "5").u8().saved(),
        /// Debounce time of input 4, in ms.
        D4 = rw(0x0012, "5").u8().saved(),
        /// Readings that I5 is averaged over.
        D5 = rw(0x0013, "5").u8().saved(),
        /// Deceleration, in steps/s²; counts/s² with EE.
        D = rw(0x0018, "5").i32().range(91, 1_525_878_997).reset(1_000_000).saved(),
        /// Within so many counts a move with EE is complete.
        DB = rw(0x001A, "5").range(0, 65_000).reset(10).saved().only(PLUS),
        /// Takes 1 from the variable at the address written.
        DC = rw(0x001B, "5").u8().live(),
        /// 1: the output bridge is on.
        DE = rw(0x001C, "5").u8().range(0, 1).reset(1).saved(),
        /// 1: everything is in counts of the encoder.
        EE = rw(0x001E, "5").u8().range(0, 1).saved(),
        /// 1: there was an error.
        EF = ro(0x001F, "5").u8().range(0, 1).live(),
        /// The number of the last error; reading it, or writing 0, clears it and EF. Others can be written in MCode
        /// only.
        ER = rw(0x0021, "5").range(0, 0).live(),
        /// Current that holds, in %.
        HC = rw(0x0029, "5").u8().range(0, 100).reset(5).saved(),
        /// Homes to the switch, 1 to 4; reads the last one.
        HM = rw(0x002B, "5").u8().range(1, 4).reset(1),
        /// From the end of motion, and MT, to HC, in ms: 0 for never, or 2 to 65535 - MT.
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
        /// Levels of inputs 1 to 4, debounced, input 1 the lowest bit.
        IL = ro(0x003A, "5").u8().range(0, 15).live(),
        /// Levels of inputs 1 to 4, input 1 the lowest bit.
        IN = ro(0x003B, "5").u8().range(0, 255).live(),
        /// 1: the jog inputs jog.
        JE = rw(0x003F, "5").u8().range(0, 1).saved(),
        /// Reaction to a limit, 1 to 6.
        LM = rw(0x0042, "5").u8().range(1, 6).reset(1).saved(),
        /// Moves to a position; reads the last one.
        MA = rw(0x0043, "5").i32(),
        /// 1: it moves to a position.
        MP = ro(0x0045, "5").u8().range(0, 1).live(),
        /// Moves a distance; reads the last one.
        MR = rw(0x0046, "5").i32(),
        /// Microsteps in a full step.
        MS = rw(0x0048, "5").one_of(RESOLUTIONS).reset(256).saved(),
        /// Settling time of the motor, in ms.
        MT = rw(0x0049, "5").range(0, 65_000).saved(),
        /// 1: it moves, or settles.
        MV = ro(0x004A, "5").u8().range(0, 1).live(),
        /// 1: output 1 is active.
        O1 = rw(0x004B, "5").u8().range(0, 1).live().also_coil(),
        /// 1: output 2 is active.
        O2 = rw(0x004C, "5").u8().range(0, 1).live().also_coil(),
        /// 1: output 3 is active.
        O3 = rw(0x004D, "5").u8().range(0, 1).live().also_coil(),
        /// 1: output 4 is active.
        O4 = rw(0x004E, "5").u8().range(0, 1).live().also_coil(),
        /// Writes outputs 1 to 4, output 1 the lowest bit.
        OL = rw(0x0055, "5").u8().range(0, 15).live(),
        /// Writes outputs 1 to 4, output 1 the lowest bit; above 15 in MCode only.
        OT = rw(0x0056, "5").u8().range(0, 15).live(),
        /// The position: C1, or C2 with EE.
        P = rw(0x0057, "5").i32().live(),
        /// The position at the last trip but one on position.
        PC = ro(0x0059, "5").i32().live(),
        /// 1: what stands is kept within DB.
        PM = rw(0x005C, "5").u8().range(0, 1).saved().only(PLUS),
        /// The user's.
        R1 = rw(0x005F, "5").i32().saved(),
        /// The user's.
        R2 = rw(0x0061, "5").i32().saved(),
        /// The user's.
        R3 = rw(0x0063, "5").i32().saved(),
        /// The user's.
        R4 = rw(0x0065, "5").i32().saved(),
        /// Current that turns the motor, in %.
        RC = rw(0x0067, "5").u8().range(1, 100).reset(25).saved(),
        /// Saves.
        S = rw(0x0076, "5").u8().live(),
        /// So many counts behind are a stall.
        SF = rw(0x0077, "5").range(0, 65_000).reset(15).saved().only(PLUS),
        /// Turns at that speed, in steps/s; reads the last one.
        SL = rw(0x0078, "5").i32().range(-5_000_000, 5_000_000),
        /// 1: a stall does not stop it.
        SM = rw(0x007A, "5").u8().range(0, 1).saved().only(PLUS),
        /// 1: it stalled.
        ST = rw(0x007B, "5").u8().range(0, 1).live().only(PLUS),
        /// Trips that are on, a bit each; above 43 in MCode only.
        TE = rw(0x007D, "5").u8().range(0, 43).live(),
        /// The velocity, in steps/s; counts/s with EE.
        V = ro(0x0085, "5").i32().live(),
        /// 1: the velocity changes.
        VC = ro(0x0088, "5").u8().range(0, 1).live(),
        /// Initial and final speed of a ramp, in steps/s; counts/s with EE. Below VM.
        VI = rw(0x0089, "5").i32().range(1, 4_999_999).reset(1_000).saved(),
        /// The most of a move, in steps/s; counts/s with EE. Above VI.
        VM = rw(0x008B, "5").i32().range(2, 5_000_000).reset(768_000).saved(),

        /// 0 off, 1 fixed current, 2 variable current, 3 torque.
        AS = rw(0x008E, "5.1").u8().range(0, 3).reset(2).saved().only(HYBRID),
        /// Status of the Hybrid, a bit each; above 255 in MCode only.
        AF = ro(0x008F, "5.1").u8().live().only(HYBRID),
        /// Calibration mode.
        CA = rw(0x0090, "5.1").u8().range(0, 1).reset(1).saved().only(HYBRID),
        /// Bounds of the rotor's lag: 1.1, 1.3, 1.5 or 1.7 full steps.
        CB = rw(0x0091, "5.1").u8().range(0, 3).reset(1).saved().only(HYBRID),
        /// Current of a calibration, in %.
        CC = rw(0x0092, "5.1").u8().range(1, 100).reset(100).saved().only(HYBRID),
        /// Clears a locked rotor, and calibrates.
        CF = rw(0x0093, "5.1").u8().live().only(HYBRID),
        /// Time of a calibration, in ms.
        CT = rw(0x0094, "5.1").range(2, 65_535).reset(200).saved().only(HYBRID),
        /// Limit of the rotor's lead, in steps.
        LD = rw(0x0095, "5.1").i32().range(0, 2_147_483_647).reset(102_400).saved().only(HYBRID),
        /// Limit of the rotor's lag, in steps.
        LG = rw(0x0097, "5.1").i32().range(0, 2_147_483_647).reset(102_400).saved().only(HYBRID),
        /// Steps that the rotor lags; negative where it leads.
        LL = ro(0x0099, "5.1").i32().live().only(HYBRID),
        /// 1: the rotor is locked.
        LR = ro(0x009B, "5.1").u8().range(0, 1).live().only(HYBRID),
        /// Time for which a rotor must not move to be locked, in ms. Two bytes in the second of its registers.
        LT = rw(0x009C, "5.1").u32().range(2, 65_535).reset(2_000).saved().only(HYBRID),
        /// Steps/s at which missed steps are made up for, if MU is 1.
        MF = rw(0x009E, "5.1").i32().range(306, 5_000_000).reset(768_000).saved().only(HYBRID),
        /// Missed steps: 0 lost, 1 made up for at MF, 2 at SS.
        MU = rw(0x00A0, "5.1").u8().range(0, 2).saved().only(HYBRID),
        /// Calibrates.
        SC = rw(0x00A1, "5.1").u8().live().only(HYBRID),
        /// The fastest response with AS 1 and 2: 10 MHz/(n + 2).
        SS = rw(0x00A2, "5.1").u8().saved().only(HYBRID),
        /// Torque: 1 forward, 0 backward.
        TD = rw(0x00A5, "5.1").u8().range(0, 1).reset(1).saved().only(HYBRID),
        /// Torque, in %.
        TQ = rw(0x00A6, "5.1").u8().range(1, 100).reset(25).saved().only(HYBRID),
        /// The fastest response with AS 3: 10 MHz/(n + 2).
        TS = rw(0x00A7, "5.1").u8().saved().only(HYBRID),

        /// A user variable, once declared.
        V1 = rw(0x00A8, "5.2").i32().live().optional(),
        /// A user variable, once declared.
        V2 = rw(0x00AA, "5.2").i32().live().optional(),
        /// A user variable, once declared.
        V3 = rw(0x00AC, "5.2").i32().live().optional(),
        /// A user variable, once declared.
        V4 = rw(0x00AE, "5.2").i32().live().optional(),
        /// A user variable, once declared.
        V5 = rw(0x00B0, "5.2").i32().live().optional(),
        /// A user variable, once declared.
        V6 = rw(0x00B2, "5.2").i32().live().optional(),
        /// A user variable, once declared.
        V7 = rw(0x00B4, "5.2").i32().live().optional(),
        /// A user variable, once declared.
        V8 = rw(0x00B6, "5.2").i32().live().optional(),

        /// 1: a program runs.
        BY = fact(1, "MC 5-6").range(0, 1).live(),
        /// Clock ratio, in thousandths.
        CR = variable(2, "MC 5-14").range(1, 2_000).reset(1_000).saved().only(PLUS),
        /// Width of clock and trip pulses, in 50 ns.
        CW = variable(3, "MC 5-15").u8().reset(10).saved(),
        /// Lines of the encoder.
        EL = variable(4, "MC 5-22").range(1, MOST_LINES).reset(512).saved(),
        /// Echo: 0 all and prompts, 1 CR LF, 2 nothing, 3 afterwards.
        EM = variable(5, "MC 5-22").range(0, 3).saved(),
        /// Key that stops all: 0 Ctrl-E, 1 Esc, 2 and 3 the same, addressed.
        ES = variable(6, "MC 5-23").range(0, 3).reset(1).saved(),
        /// Filter of the capture input.
        FC = variable(7, "MC 5-25").range(0, 9).saved(),
        /// Filter of the clock inputs and of a remote encoder.
        FM = variable(8, "MC 5-26").range(0, 9).reset(2).saved().only(PLUS),
        /// 1: a number is waited for.
        IF = variable(9, "MC 5-36").range(0, 1).live(),
        /// Temperature inside, in °C.
        IT = fact(10, "MC 5-38").i16().live().only(HYBRID),
        /// Warning temperature, in °C.
        WT = variable(11, "MC 5-81").range(0, 84).reset(80).saved().only(HYBRID),
        /// 1: the program can be neither listed nor changed.
        LK = variable(12, "MC 5-42").range(0, 1).saved(),
        /// 1: a bare number repeats the last motion command.
        NE = variable(13, "MC 5-51").range(0, 1).reset(1).saved(),
        /// Filter of the velocity in torque mode.
        VF = variable(14, "MC 5-79").range(0, 1_000).saved().only(HYBRID)
            .not_modelled("in torque mode V is 0: nothing shows what it filters"),
        /// I/O 1: type, active state, sinking or sourcing.
        S1 = variable(15, "MC 5-63").words(3).saved(),
        /// I/O 2: type, active state, sinking or sourcing.
        S2 = variable(18, "MC 5-63").words(3).saved(),
        /// I/O 3: type, active state, sinking or sourcing.
        S3 = variable(21, "MC 5-63").words(3).saved(),
        /// I/O 4: type, active state, sinking or sourcing.
        S4 = variable(24, "MC 5-63").words(3).saved(),
        /// Analogue input: 9 voltage, with 0 to 5 V, with 1 to 10 V; 10 current, with 0 from 0, with 1 from 4 to 20 mA.
        S5 = variable(27, "MC 5-65").words(2).reset(9 << 16).saved(),
        /// Clock I/O 7: type, active state.
        S7 = variable(29, "MC 5-66").words(2).reset(33 << 16).saved().only(PLUS),
        /// Clock I/O 8: type, active state.
        S8 = variable(31, "MC 5-66").words(2).reset(33 << 16).saved().only(PLUS),
        /// Capture input or trip output: type, active state.
        S13 = variable(33, "MC 5-67").words(2).reset(60 << 16).saved(),
        /// Baud rate of the serial sister.
        BD = variable(35, "MC 5-4").one_of(&[48, 96, 19, 38, 11]).reset(96).saved().not_modelled("TCP has none"),
        /// Check sums of the serial sister.
        CK = variable(36, "MC 5-12").range(0, 2).saved(),
        /// 1: no answer to all, of the serial sister.
        DG = variable(37, "MC 5-19").range(0, 1).reset(1).saved(),
        /// Name of the serial sister: a character.
        DN = variable(38, "MC 5-20").range(33, 122).reset(33).saved(),
        /// Party mode of the serial sister.
        PY = variable(39, "MC 5-59").range(0, 1).saved(),
        /// 1: queued, of the serial sister.
        QD = variable(40, "MC 5-60").range(0, 1).saved(),
        /// The second value of CA, and saved with it. 1: torque compensation.
        CalibrationMethod = variable(41, "MC 5-8").range(0, 1).only(HYBRID),

        /// 1: the serial sister's commands are there, too.
        SerialCommands = setting(1, "MC 1.2.2").range(0, 1).saved(),

        /// Torque that holds the motor at RC = 100, in mN·m; 0: with current it follows whatever its load is.
        HoldingTorque = setting(2, "MC 5-70").u32().range(0, 100_000),
        /// The speed at which it has no torque left, in rpm; it falls evenly with the speed.
        PullOutSpeed = setting(4, "MC 5-70").u32().range(1, 200_000).reset(LOAD.pull_out_rpm as i64),
        /// Inertia of rotor and load, in g·cm².
        Inertia = setting(6, "MC 5-70").u32().range(1, 10_000_000).reset(LOAD.inertia_gcm2 as i64),
        /// Torque against any motion, in mN·m: all that holds the shaft without current.
        Friction = setting(8, "MC 5-70").u32().range(0, 100_000).reset(LOAD.friction_unm as i64 / 1_000),
        /// Torque of the load, in mN·m, positive against forward motion.
        Load = setting(10, "MC 5-70").i32().range(-100_000, 100_000),
        /// Full steps of the motor in a turn.
        FullSteps = setting(12, "MC 7.3.1").range(4, 10_000).reset(LOAD.steps_per_rev as i64),

        /// PN, and object 1 of the device identification. `PartNumber` presets both halves.
        PartNumber1 = setting(13, "MC 5-56").text().reset(text(b"MDI3CRL2")),
        /// Second half.
        PartNumber2 = setting(17, "MC 5-56").text().reset(text(b"3A7-EQ")),
        /// SN, and object 5. `SerialNumber` presets both halves.
        SerialNumber1 = setting(21, "MC 5-69").text().reset(text(b"12345678")),
        /// Second half.
        SerialNumber2 = setting(25, "MC 5-69").text().reset(text(b"9")),
        /// VR, and the end of object 6. `FirmwareVersion` presets both halves.
        FirmwareVersion1 = setting(29, "MC 5-80").text().reset(text(b"3.0.0.9")),
        /// Second half.
        FirmwareVersion2 = setting(33, "MC 5-80").text(),
        /// The second value of VR; "1.8+" calibrates as MC 5-8 says.
        HardwareVersion = setting(37, "MC 5-80").text().reset(text(b"1.8")).only(HYBRID),
        /// Firmware of the Ethernet controller: object 2.
        EthernetVersion = setting(41, "4.1.1").text().reset(text(b"4.0.0.0")),
    }
}

/// The motor, its load and what identifies the drive: they stay as they are whatever becomes of the variables.
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

/// Identification of a drive, in halves.
pub(super) const PART_NUMBER: &[Reg] = &[Reg::PartNumber1, Reg::PartNumber2];
pub(super) const SERIAL_NUMBER: &[Reg] = &[Reg::SerialNumber1, Reg::SerialNumber2];
pub(super) const FIRMWARE: &[Reg] = &[Reg::FirmwareVersion1, Reg::FirmwareVersion2];
pub(super) const HARDWARE: &[Reg] = &[Reg::HardwareVersion];
pub(super) const ETHERNET: &[Reg] = &[Reg::EthernetVersion];

/// Returns whether MCode takes a value: one that the row accepts, whose range is that of FB 5, and of four rows more.
pub(super) fn mcode_accepts(reg: Reg, value: i64) -> bool {
    let most = match reg {
        // (MC 5-11)
        Reg::CE => 2,
        // Programs of real machines set errors of their own.
        Reg::ER => 255,
        // Outputs 9 to 12, which drives with Ethernet do not have (MC 5-54).
        Reg::OT => 255,
        // TR and TA (MC 5-73).
        Reg::TE => 63,
        _ => return Reg::ENTRIES.list.get(reg.row()).is_some_and(|entry| entry.accepts(value)),
    };
    (0..=most).contains(&value)
}

/// All rows, for what is made of them while the program is compiled.
pub(super) const ROWS: &[Row] = &Reg::ROWS;

/// The rows of the Hybrid.
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

/// The map of the Hybrid.
pub(super) static TABLE_HYBRID: Table = {
    static LIST: [Entry; Reg::ROWS.len()] = entries(&ROWS_HYBRID);
    static ENTRIES: Entries = Reg::ENTRIES.with_list(&LIST);
    Table { rows: &ROWS_HYBRID, entries: &ENTRIES }
};
