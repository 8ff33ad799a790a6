//! The register map of the MD3 (chapter 7), in its order and with its names.

use standin_protocol::line::{Line, Parity};

/// The factory value of [`Reg::SerialPortConfiguration`]: 9600 8E1.
const FACTORY_SERIAL_PORT: u16 = 0x0021;
/// The line it means.
pub(super) const FACTORY_LINE: Line = line(FACTORY_SERIAL_PORT);

standin_protocol::registers! {
    /// Registers of the MD3 User Guide V1.7, chapter 7. A pair High/Low is one row.
    pub enum Reg: HighFirst {
        /// Address on the bus; others are refused.
        DeviceAddress = rw(0x00, "7.1").reset(1).range(1, 247).saved(),
        /// Motor mode (bit 13), microstepping or PWM frequency (12:8), phase current code (7:0).
        MotorCurrentAndMicrostepping = rw(0x01, "7.2").reset(0x030a).saved()
            .not_modelled("not modelled yet: DC motor mode (bit 13)"),
        /// Cutback timeout in 0.1 s (15:8), cutback current code (7:0).
        CurrentCutbackSettings = rw(0x02, "7.3").saved()
            .not_modelled("not modelled yet: current cutback"),
        /// Delay after power-up beyond 2.5 s, in 10 ms.
        StartupDelay = rw(0x03, "7.4").clamped(0, 65_435).saved(),
        /// Speed divisor (7:5), direction (4), mode (3:1), home on startup (0).
        HomingConfiguration = rw(0x04, "7.5").saved()
            .not_modelled("not modelled yet: homing"),
        /// Steps before the search for the home flag.
        PreHomeOffset = rw(0x05, "7.6").i32().saved()
            .not_modelled("not modelled yet: homing"),
        /// Steps after the home flag was found.
        HomeOffset = rw(0x07, "7.7").i32().saved()
            .not_modelled("not modelled yet: homing"),
        /// Encoder enable (12), functions of J2 pin 2 (11:10), 3 (9:8), 4/5 (7:4), polarities (3:0).
        PinFunctionAndPolarity = rw(0x09, "7.8").saved()
            .not_modelled("not modelled yet: functions and polarity of J2 pins 2 to 5"),
        /// Outputs J3 pin 8 (7), J2 pins 9, 10, 12 (6:4); inputs J2 pins 2, 3, 4, 5 (3:0).
        IOPortData = rw(0x0a, "7.9").reset(0x000f).saved(),
        /// Do not use.
        Reserved = ro(0x0b, "7.10"),
        /// Noise filter (9, 8:6), index gating (5:4), swap (3), mode (2:1), index enable (0).
        QuadratureEncoderConfiguration = rw(0x0c, "7.11").reset(0x0005).saved()
            .not_modelled("not modelled yet: encoder input"),
        /// Count at which the encoder counter starts again.
        QuadratureEncoderMaxCount = rw(0x0d, "7.12").reset(0x0f9f).saved()
            .not_modelled("not modelled yet: encoder input"),
        /// Index pulses counted.
        EncoderIndexCount = rw(0x0e, "7.13").i32()
            .not_modelled("not modelled yet: encoder input"),
        /// Encoder edges counted.
        QuadratureEncoderCount = rw(0x10, "7.14")
            .not_modelled("not modelled yet: encoder input"),
        /// Fault (15), Disable (5), Decel-stop (4), Stop (3), Home (2), Jog (1), Move (0).
        MotionControl = rw(0x11, "7.15").saved_bits(0x0020)
            .not_modelled("not modelled yet: Home (bit 2) completes at once"),
        /// Microsteps of a profile move.
        MoveSteps = rw(0x12, "7.16").i32().reset(10_000).saved(),
        /// Microsteps per second; the sign is the direction of a jog.
        Speed = rw(0x14, "7.17").i32().clamped(-40_000, 40_000).reset(5_000).saved(),
        /// Microsteps per second while J2 pin 2 selects it.
        AlternateSpeed = rw(0x16, "7.18").u32().clamped(0, 40_000).reset(2_500).saved()
            .not_modelled("not modelled yet: SPEEDSEL"),
        /// Microsteps per second²; more than 2³¹ − 1 acts as that.
        AccelDecel = rw(0x18, "7.19").u32().clamped(0, 0x7FFF_FFFF).reset(10_000).saved(),
        /// CRC status (15:8), read from EEPROM (1), write to EEPROM (0).
        EEPROMControl = rw(0x1a, "7.20").reset(0x9a00),
        /// Current type (15), product (14:8), version (7:0).
        ProductInformation = ro(0x1b, "7.21").reset(0xbd01),
        /// Parity (5:4), stop bit (3), baud rate (2:0).
        SerialPortConfiguration = rw(0x1c, "7.22").reset(FACTORY_SERIAL_PORT as i64).saved(),
        /// For the user.
        UserRegister = rw(0x1d, "7.23").saved(),
        /// Serial number.
        SerialNumber = ro(0x1e, "7.24").u32().reset(1).saved(),
        /// 1: SPEEDSEL turns a running profile move into a jog, as 7.18 says; 0: it is ignored, as 7.8 says.
        SpeedselJogsProfile = setting(0, "7.8").range(0, 1)
            .not_modelled("not modelled yet: SPEEDSEL"),
    }
}

/// Bits of [`Reg::MotionControl`] (7.15).
pub mod motion_control {
    /// The drive is in a fault; written as 1 clears it.
    pub const FAULT: u16 = 1 << 15;
    /// No motor current.
    pub const DISABLE: u16 = 1 << 5;
    /// Slow down to a stop.
    pub const DECEL_STOP: u16 = 1 << 4;
    /// Stop at once.
    pub const STOP: u16 = 1 << 3;
    /// Execute a home cycle.
    pub const HOME: u16 = 1 << 2;
    /// Jog.
    pub const JOG: u16 = 1 << 1;
    /// Execute a profile move.
    pub const MOVE: u16 = 1 << 0;
}

/// Bits of [`Reg::EEPROMControl`] (7.20).
pub(super) mod eeprom_control {
    /// Load all registers.
    pub(in super::super) const READ: u16 = 1 << 1;
    /// Save all registers.
    pub(in super::super) const WRITE: u16 = 1 << 0;
    /// CRC status: the image passed.
    pub(in super::super) const PASS: u16 = 0x9a00;
    /// CRC status: it did not.
    pub(in super::super) const FAIL: u16 = 0xf100;
}

/// The line that a value of [`Reg::SerialPortConfiguration`] means (7.22). Parity 3 is not in the
/// table and acts as none; parity and stop bits are independent.
#[must_use]
pub const fn line(configuration: u16) -> Line {
    let baud = match configuration & 7 {
        0 => 4_800,
        1 => 9_600,
        2 => 19_200,
        3 => 38_400,
        4 => 57_600,
        5 => 115_200,
        6 => 230_400,
        _ => 460_800,
    };
    let parity = match configuration >> 4 & 3 {
        1 => Parity::Odd,
        2 => Parity::Even,
        _ => Parity::None,
    };
    let stop = if configuration & 1 << 3 == 0 { 1 } else { 2 };
    Line::new(baud, 8, parity, stop)
}

/// Peak phase current in mA of a value of [`Reg::MotorCurrentAndMicrostepping`] (7.2): the column of
/// the high current version, whose steps change at 2 A. Codes beyond the table act as its last row;
/// full step gives 71 %.
#[must_use]
pub(super) fn current_ma(setting: u16) -> u32 {
    let peak = match u32::from(setting & 0xFF) {
        code @ 0..=0x14 => 100 * code,
        code @ 0x15..=0x1e => 2_000 + 500 * (code - 0x14),
        _ => 7_000,
    };
    let full_step = setting >> 8 & 0x1F == 0;
    if full_step { peak * 71 / 100 } else { peak }
}
