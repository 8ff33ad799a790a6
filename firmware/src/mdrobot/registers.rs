//! The PIDs of an MD controller, with the names of the manual's header without `PID_`, in the order of their
//! numbers.

use drivetwin_protocol::line::{Line, Parity};
use drivetwin_protocol::modbus::pdu::Exception;
use drivetwin_protocol::registers::{Bank, Register};

use super::fields;

/// The storage of the PIDs.
pub(super) type Words = Bank<Pid, { Pid::WORDS }>;

/// Given instead of a page for what only public clients of later controllers show (MDROBOT-10).
pub(super) const LATER: &str = "not in V1.1";

/// Unit of MAX_LOAD and TQ_DATA, in mA.
pub(super) const MA_PER_UNIT: u32 = 100;
/// Nominal supply, in 0.1 V.
pub(super) const SUPPLY: u16 = 240;

const POSITION_RAMP: &str = "stored, without effect: no public client shows one";
const MOTOR_2: &str = "an MD400 has one motor: fields of motor 2 read 0";

drivetwin_protocol::registers! {
    /// The objects that a PID names. A value of two words has the low word first.
    #[allow(non_camel_case_types, reason = "the names are the manual's")]
    pub enum Pid: ObjectsLowFirst {
        /// Version of the firmware, in tenths: 81 is 8.1. A preset can change it.
        VERSION = ro(1, "p. 6").u8().reset(81),
        /// 0x55 restores the factory values of all saved PIDs; the id and the baud rate stay.
        DEFAULT_SET = wo(3, "p. 6"),
        /// Named only in the manual's header.
        REQ_PID_DATA = known(4, "2.4"),
        /// Any word releases the motor.
        TQ_OFF = wo(5, "p. 6"),
        /// Any word shorts the windings.
        BRAKE = wo(6, "p. 6"),
        /// Named only in the manual's header.
        ACK = known(7, "2.4"),
        /// Executes a command: see the table of commands.
        COMMAND = wo(10, "p. 6").u8(),
        /// Any word clears the alarms that have no cause any more.
        ALARM_RESET = wo(12, "p. 7"),
        /// Any word sets the position to 0.
        POSI_RESET = wo(13, "p. 7"),
        /// Named only in the manual's header.
        MAIN_BC_STATUS = known(14, "2.4"),
        /// Named only in the manual's header.
        MONITOR_BC_STATUS = known(15, "2.4"),
        /// 1 reverses the sign of every reference.
        INV_SIGN_CMD = rw(16, "p. 7").u8().range(0, 1).saved(),
        /// 1: DIR and START/STOP are limit switches while the bus is the source of commands.
        USE_LIMIT_SW = rw(17, "p. 7").u8().range(0, 1).reset(1).saved(),
        /// Named only in the manual's header, there as INV_ALARM.
        INV_ALARM_18 = known(18, "2.4"),
        /// 1: the ALARM pin is low while there is no alarm.
        INV_ALARM = rw(19, "p. 8").u8().range(0, 1).saved(),
        /// Poles of the motor; a code above 5 is half the number of poles.
        HALL_TYPE = rw(21, "p. 8").u8().saved().fields(fields::HALL_TYPE),
        /// State at reference zero.
        STOP_STATUS = rw(24, "p. 8").u8().range(0, 3).saved().fields(fields::STOP_STATUS),
        /// Type of the speed input.
        INPUT_TYPE = rw(25, "p. 8").u8().one_of(&[0, 1, 2, 3, 5]).saved().fields(fields::INPUT_TYPE),
        /// Named only in the manual's header.
        PRESET_SAVE = known(30, "2.4"),
        /// Named only in the manual's header.
        PRESET_RECALL = known(31, "2.4"),
        /// Alarms.
        CTRL_STATUS = ro(34, "p. 9").u8().live().fields(fields::CTRL_STATUS),
        /// 1: START/STOP is ON while it is high.
        START_INV_SIGN = rw(36, "p. 9").u8().range(0, 1).saved(),
        /// 1: RUN/BRAKE is ON while it is high.
        RUN_INV_SIGN = rw(37, "p. 9").u8().range(0, 1).saved(),
        /// Reaction to an open limit switch.
        LIMIT_STOP_COND = rw(40, "p. 9").u8().range(0, 1).saved().fields(fields::LIMIT_STOP),
        /// 1: the speed input is a torque reference.
        TQ_CTRL = rw(44, "p. 10").u8().range(0, 1).saved(),
        /// 1 enables Bluetooth.
        BLUETOOTH = rw(45, "p. 10").u8().range(0, 1).saved().not_modelled("there is no radio"),
        /// Inputs of the CTRL connector.
        DI = ro(48, "p. 11").u8().live().fields(fields::DI),
        /// 1 while the position error is within IN_POSITION.
        IN_POSITION_OK = ro(49, "p. 11").u8().range(0, 1).live(),
        /// A byte that reads back as written until power-off; clients store a flag of their own in it.
        TQ_RATIO = rw(66, LATER).u8().not_modelled("no public client shows what it scales"),
        /// Source of commands.
        UI_COM = rw(78, "p. 7").u8().range(0, 1).fields(fields::UI_COM),
        /// Motion at COM_TAR_SPEED if that is not 0. While START_STOP is not 0, the bus may move the motor.
        START_STOP = rw(100, "p. 12").u8().range(0, 2).fields(fields::START_STOP),
        /// Velocity reference in rpm, positive CCW.
        VEL_CMD = rw(130, "p. 12").i16(),
        /// Named only in the manual's header.
        VEL_CMD2 = known(131, "2.4"),
        /// Sets the id after the next power-on: 0xAA in DL, the id 1 to 253 in DH.
        ID = wo(133, "p. 12"),
        /// Output without speed control, in 1/1023 of the supply.
        OPEN_VEL_CMD = wo(134, "p. 12").i16().range(-1_023, 1_023),
        /// Sets the baud rate after the next power-on: 0xAA in DL; in DH 1 to 5 for 9,600, 19,200, 38,400,
        /// 57,600, 115,200 baud.
        BAUDRATE = wo(135, "p. 12"),
        /// Named only in the manual's header.
        ECAN_BITRATE = known(137, "2.4"),
        /// Speed of the motor, in rpm.
        RPM_DATA = ro(138, "p. 12").i16().range(-5_000, 5_000).live(),
        /// Current of the motor, in 0.1 A, with the sign of its torque.
        TQ_DATA = ro(139, "p. 12").i16().live(),
        /// Torque reference, in 1/1023 of MAX_LOAD.
        TQ_CMD = wo(140, "p. 12").i16().range(-1_023, 1_023),
        /// Supply, in 0.1 V.
        VOLT_IN = ro(143, "p. 13").reset(SUPPLY as i64).live(),
        /// Named only in the manual's header.
        CCW_PHASE_OFFSET = known(146, "2.4"),
        /// Named only in the manual's header.
        CW_PHASE_OFFSET = known(147, "2.4"),
        /// Named only in the manual's header.
        RETURN_TYPE = known(149, "2.4"),
        /// Named only in the manual's header.
        TQ_PO = known(150, "2.4"),
        /// Named only in the manual's header.
        OVER_MODULATION = known(152, "2.4"),
        /// Ramp up of a speed reference: 0 to 1,023 are 0 to 15 s from 0 to MAX_RPM.
        SLOW_START = rw(153, "p. 13").range(0, 1_023).saved(),
        /// Ramp down of a speed reference: 0 to 1,023 are 0 to 15 s from MAX_RPM to 0.
        SLOW_DOWN = rw(154, "p. 13").range(0, 1_023).saved(),
        /// If not 0, the speed for START/STOP, RUN/BRAKE and DIR in rpm, used instead of the speed input.
        TAR_VEL = rw(155, "p. 13").range(0, 5_000).saved(),
        /// If not 0, pulses of the encoder in a turn; the encoder is then the speed sensor.
        ENC_PPR = rw(156, "p. 14").saved(),
        /// The analogue input counts as zero below this limit, in 5/1023 V.
        LOW_SPEED_LIMIT = rw(157, "p. 14").range(0, 512).saved(),
        /// The analogue input counts as MAX_RPM from this limit on, in 5/1023 V; 0 is not set.
        HIGH_SPEED_LIMIT = rw(158, "p. 14").range(512, 1_023).unset().saved(),
        /// Named only in the manual's header.
        SLOW_START_DOWN = known(159, "2.4"),
        /// Named only in the manual's header.
        DEAD_ZONE = known(162, "2.4"),
        /// Named only in the manual's header.
        READ_ADDR = known(163, "2.4"),
        /// Named only in the manual's header.
        REQ_PID_DATA2 = known(164, "2.4"),
        /// Gain of position control: rpm for each count of error.
        PV_GAIN = rw(167, "p. 15").reset(20).saved(),
        /// Proportional gain of speed control.
        P_GAIN = rw(168, "p. 15").reset(6_000).saved(),
        /// Integral gain of speed control.
        I_GAIN = rw(169, "p. 15").reset(6_000).saved(),
        /// Greatest position error at which IN_POSITION_OK is 1, in counts.
        IN_POSITION = rw(171, "p. 11").saved(),
        /// Greatest speed of POSI_CMD and INC_POSI_CMD in rpm, limited by MAX_RPM; used from the next such
        /// command on.
        TAR_POSI_VEL = rw(176, LATER).reset(5_000).saved(),
        /// Ramp up of a position move: 0 to 1,023 are 0 to 15 s.
        POSI_SS = rw(178, LATER).range(0, 1_023).saved().not_modelled(POSITION_RAMP),
        /// Ramp down of a position move: 0 to 1,023 are 0 to 15 s.
        POSI_SD = rw(179, LATER).range(0, 1_023).saved().not_modelled(POSITION_RAMP),
        /// Speed for START_STOP, in rpm.
        COM_TAR_SPEED = rw(180, "p. 15"),
        /// Current limit of the motor, in 0.1 A; the same value as MAX_LOAD.
        MAX_LOAD_181 = rw(181, "p. 15").reset(200).live(),
        /// The function that START/STOP and FUNC_CMD start. DH is ignored; DL above 4 is refused.
        FUNC_CMD_TYPE = rw(183, "p. 15").saved().fields(fields::FUNCTION),
        /// If not 0, the start signal is ON, as by START/STOP.
        FUNC_CMD = wo(184, "p. 16"),
        /// Named only in the manual's header.
        MAIN_DATA = known(193, "2.4"),
        /// Named only in the manual's header.
        IO_MONITOR = known(194, "2.4"),
        /// Speed in rpm, current in 0.1 A, output in 1/1023, position (low, high word), status2 and
        /// CTRL_STATUS.
        MONITOR = ro(196, "2.4").words(6).live(),
        /// Position, in counts.
        POSI_DATA = ro(197, "2.4").i32().live(),
        /// Named only in the manual's header, there as RPM_DATA.
        RPM_DATA_198 = known(198, "2.4"),
        /// Named only in the manual's header.
        VEL_GAIN = known(202, "2.4"),
        /// Named only in the manual's header.
        VEL_GAIN2 = known(203, "2.4"),
        /// Named only in the manual's header.
        TYPE = known(205, "2.4"),
        /// Nine words. For motor 1, then for motor 2: speed in rpm, current in 0.1 A, and position (low word, high
        /// word). The last word is CTRL_STATUS: motor 1 in the low byte (DL), motor 2 in the high byte (DH).
        PNT_MAIN_DATA = ro(210, LATER).words(9).live().not_modelled(MOTOR_2),
        /// Current limit of the motor, in 0.1 A.
        MAX_LOAD = rw(211, "p. 16").clamped(0, 200).reset(200).saved(),
        /// Speed in rpm and position (low, high word) of motor 1, the same of motor 2, and CTRL_STATUS of
        /// both motors, with motor 2 in DH.
        PNT_MONITOR = ro(216, LATER).words(7).live().not_modelled(MOTOR_2),
        /// Named only in the manual's header.
        POSI_SET = known(217, "2.4"),
        /// Moves to a position (low, high word) at a speed in rpm.
        POSI_VEL_CMD = wo(219, "2.4").words(3),
        /// Moves by a number of counts (low, high word) at a speed in rpm.
        INC_POSI_VEL_CMD = wo(220, LATER).words(3),
        /// Greatest speed in rpm; full scale of inputs and ramps.
        MAX_RPM = rw(221, "p. 16").clamped(0, 5_000).reset(3_000).saved(),
        /// LOW_SPEED_LIMIT and HIGH_SPEED_LIMIT in one PID.
        SPEED_LIMIT = rw(222, "p. 16").words(2).each(&[(0, 512), (512, 1_023)]).unset().live(),
        /// Named only in the manual's header.
        STEP_INPUT = known(225, "2.4"),
        /// Named only in the manual's header.
        CURVE_PT = known(226, "2.4"),
        /// Named only in the manual's header.
        PRESET_DATA = known(227, "2.4"),
        /// Target of position control, in counts.
        TAR_POSI = ro(230, LATER).i32().live(),
        /// Named only in the manual's header.
        VEL_GAIN_W = known(231, "2.4"),
        /// Named only in the manual's header.
        TIME = known(234, "2.4"),
        /// Named only in the manual's header.
        CAN_RESEND = known(238, "2.4"),
        /// Parameters of the speed functions: rpm, run time in 0.1 s.
        FUNC_SPEED = rw(239, "p. 16").words(2).reset(10 << 16 | 1_000).saved(),
        /// Named only in the manual's header.
        PHASE_OFFSET = known(241, "2.4"),
        /// Moves to a position, in counts.
        POSI_CMD = wo(243, "p. 16").i32(),
        /// Moves by a number of counts.
        INC_POSI_CMD = wo(244, "p. 16").i32(),
        /// Parameters of the function POSITION: rpm, counts.
        FUNC_POSI = rw(250, "p. 17").words(2).reset(240 << 16 | 1_500).saved(),

        /// The id after the next power-on; set by ID.
        CONTROLLER_ID = setting(0, "p. 12").u8().range(1, 253).reset(1).saved(),
        /// The code of the baud rate after the next power-on; set by BAUDRATE.
        CONTROLLER_BAUD = setting(1, "p. 12").u8().range(1, 5).reset(2).saved(),
        /// Position of the volume on the board. While INT_SPEED is ON, the volume is the speed input for
        /// every INPUT_TYPE but 5, evaluated as an analogue input: 1,023 is MAX_RPM.
        INT_VOLUME = setting(2, "p. 11").range(0, 1_023).saved(),
    }
}

/// Key that ID and BAUDRATE need in DL (2.4, `ID_WRITE_CHK`).
const WRITE_CHECK: i64 = 0xAA;
/// Key that `DEFAULT_SET` needs (2.4, `ID_DEFAULT_CHK`).
pub(super) const DEFAULT_CHECK: u16 = 0x55;

/// Values of `FUNC_CMD_TYPE` (p. 15).
pub(super) mod function {
    pub(in crate::mdrobot) const NONE: u16 = 0;
    pub(in crate::mdrobot) const SPEED: u16 = 1;
    pub(in crate::mdrobot) const POSITION: u16 = 2;
    pub(in crate::mdrobot) const SPEED_MOMENTARY: u16 = 3;
    pub(in crate::mdrobot) const SPEED_ADD: u16 = 4;
}

/// Returns true if a PID of one bit is 1.
pub(super) fn flag(bank: &Words, pid: Pid) -> bool {
    bank.word(pid) == 1
}

/// The value of `MAX_RPM`, limited to its range.
pub(super) fn max_rpm(bank: &Words) -> u16 {
    bank.clamped_value(Pid::MAX_RPM) as u16
}

/// Checks a value that the row accepts already. For ID and BAUDRATE with the key, DH must be legal. For
/// `FUNC_CMD_TYPE` only DL is checked.
pub(super) fn validate(pid: Pid, value: i64) -> Result<(), Exception> {
    let accepts = |pid: Pid, value| Pid::ENTRIES.list.get(pid.row()).is_some_and(|row| row.accepts(value));
    let legal = match pid {
        Pid::ID => unlocked(value).is_none_or(|id| accepts(Pid::CONTROLLER_ID, id)),
        Pid::BAUDRATE => unlocked(value).is_none_or(|code| accepts(Pid::CONTROLLER_BAUD, code)),
        Pid::FUNC_CMD_TYPE => value & 0xFF <= i64::from(function::SPEED_ADD),
        _ => true,
    };
    if legal { Ok(()) } else { Err(Exception::IllegalDataValue) }
}

/// The DH byte of a value written to ID or BAUDRATE, if the DL byte is the key (MDROBOT-5).
pub(super) fn unlocked(value: i64) -> Option<i64> {
    (value & 0xFF == WRITE_CHECK).then_some(value >> 8 & 0xFF)
}

/// The value that a PID stores of a written one: `FUNC_CMD_TYPE` stores only DL (p. 15) (MDROBOT-3).
pub(super) fn stored_value(pid: Pid, value: i64) -> i64 {
    if pid == Pid::FUNC_CMD_TYPE { value & 0xFF } else { value }
}

/// Settings of the serial line for a code of BAUDRATE (p. 12; MDROBOT-1).
pub(super) const fn line(code: u16) -> Line {
    let baud = match code {
        1 => 9_600,
        3 => 38_400,
        4 => 57_600,
        5 => 115_200,
        _ => 19_200,
    };
    Line::new(baud, 8, Parity::None, 1)
}

/// Settings of the serial line of a new controller.
pub(super) const FACTORY_LINE: Line = line(2);

/// Poles of the motor that `HALL_TYPE` selects (p. 8).
pub(super) fn poles(bank: &Words) -> u16 {
    match bank.word(Pid::HALL_TYPE) {
        0 => 4,
        1 => 8,
        2 => 10,
        3 => 12,
        4 => 2,
        5 => 6,
        n => 2 * n,
    }
}
