//! The register map of the MD3 in the order of chapter 7, with the manual's names.

use drivetwin_protocol::line::{Line, Parity};
use drivetwin_protocol::registers::{Register, Row, Table};

use super::fields;

/// The factory value of [`Reg::SerialPortConfiguration`]: 9600 8E1.
const FACTORY_SERIAL_PORT: u16 = 0x0021;
/// The serial line that [`FACTORY_SERIAL_PORT`] selects.
pub(super) const FACTORY_LINE: Line = line(FACTORY_SERIAL_PORT);

drivetwin_protocol::registers! {
    /// Registers of the MD3 User Guide V1.7, chapter 7. A High/Low pair of registers is one row.
    pub enum Reg: HighFirst {
        /// Address on the bus. Values out of range are refused.
        DeviceAddress = rw(0x00, "7.1").reset(1).range(1, 247).saved(),
        /// Motor mode, microstepping or PWM frequency, phase current.
        MotorCurrentAndMicrostepping = rw(0x01, "7.2").reset(0x030a).saved().fields(fields::MOTOR),
        /// Current at standstill.
        CurrentCutbackSettings = rw(0x02, "7.3").saved().fields(fields::CUTBACK),
        /// Delay after power-up in addition to 2.5 s, in 10 ms.
        StartupDelay = rw(0x03, "7.4").clamped(0, 65_435).saved(),
        /// Homing: speed, direction, mode, start.
        HomingConfiguration = rw(0x04, "7.5").saved().fields(fields::HOMING),
        /// Steps before the search for the home flag.
        PreHomeOffset = rw(0x05, "7.6").i32().saved(),
        /// Steps after the home flag has been found.
        HomeOffset = rw(0x07, "7.7").i32().saved(),
        /// Functions and polarities of the pins of J2.
        PinFunctionAndPolarity = rw(0x09, "7.8").saved().fields(fields::PINS),
        /// Levels of inputs and outputs.
        IOPortData = rw(0x0a, "7.9").reset(0x000f).saved().fields(fields::PORT),
        /// Do not use.
        Reserved = ro(0x0b, "7.10"),
        /// Decoding of the encoder.
        QuadratureEncoderConfiguration = rw(0x0c, "7.11").reset(0x0005).saved()
            .not_modelled("not modelled: edges closer than 62.5 ns, the tick of time; the filter's 75 and 150 ns are rounded up to ticks; the limit of 3.3 MHz").fields(fields::ENCODER),
        /// Maximum of the encoder counter: the counter wraps to 0 after it.
        QuadratureEncoderMaxCount = rw(0x0d, "7.12").reset(0x0f9f).saved(),
        /// Number of index pulses counted.
        EncoderIndexCount = rw(0x0e, "7.13").i32(),
        /// Number of encoder edges counted.
        QuadratureEncoderCount = rw(0x10, "7.14"),
        /// Commands of motion, and the fault.
        MotionControl = rw(0x11, "7.15").saved_bits(0x0020).fields(fields::MOTION),
        /// Microsteps of a profile move.
        MoveSteps = rw(0x12, "7.16").i32().reset(10_000).saved(),
        /// Microsteps per second; the sign is the direction of a jog.
        Speed = rw(0x14, "7.17").i32().clamped(-40_000, 40_000).reset(5_000).saved(),
        /// Microsteps per second while J2 pin 2 selects this speed.
        AlternateSpeed = rw(0x16, "7.18").u32().clamped(0, 40_000).reset(2_500).saved(),
        /// Microsteps per second²; values above 2³¹ − 1 act as 2³¹ − 1.
        AccelDecel = rw(0x18, "7.19").u32().clamped(0, 0x7FFF_FFFF).reset(10_000).saved(),
        /// Commands and status of the EEPROM.
        EEPROMControl = rw(0x1a, "7.20").reset(0x9a00).fields(fields::EEPROM),
        /// Product and version of the firmware. A preset can change the version.
        ProductInformation = ro(0x1b, "7.21").range(0xbd00, 0xbdff).reset(Version::HighCurrent.product()).fields(fields::PRODUCT),
        /// Settings of the serial line.
        SerialPortConfiguration = rw(0x1c, "7.22").reset(FACTORY_SERIAL_PORT as i64).saved().fields(fields::SERIAL),
        /// Free for the user.
        UserRegister = rw(0x1d, "7.23").saved(),
        /// Serial number. A preset can change it.
        SerialNumber = ro(0x1e, "7.24").u32().reset(1).saved(),
        /// 1: SPEEDSEL turns a running profile move into a jog, as 7.18 says; 0: a running profile move
        /// ignores SPEEDSEL, as 7.8 says.
        SpeedselJogsProfile = setting(0, "7.8").range(0, 1),
    }
}

/// Bits of [`Reg::MotionControl`] (7.15).
pub mod motion_control {
    /// The drive is in a fault; writing 1 clears the fault.
    pub const FAULT: u16 = 1 << 15;
    /// Switch the motor current off.
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

/// The serial line that a value of [`Reg::SerialPortConfiguration`] selects (7.22). Parity code 3 is not in
/// the table and acts as no parity; parity and stop bits are independent (MD3-9).
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

/// The version of the drive, by its maximum current (7.2, 7.21).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Version {
    /// Up to 7 A.
    HighCurrent,
    /// Up to 1.8 A.
    LowCurrent,
}

impl Version {
    /// The factory value of ProductInformation (MD3-16).
    pub(super) const fn product(self) -> i64 {
        match self {
            Self::HighCurrent => 0xbd01,
            Self::LowCurrent => 0x3d01,
        }
    }

    /// Returns true if `ProductInformation` may have this value: any firmware version in the low byte is
    /// allowed.
    pub(super) const fn is_product(self, value: i64) -> bool {
        value & !0xFF == self.product() & !0xFF
    }
}

/// The rows of the low current version. Only `ProductInformation` differs (7.21).
#[expect(clippy::indexing_slicing, reason = "only ever evaluated by the compiler")]
static LOW_ROWS: [Row; Reg::ROWS.len()] = {
    let mut rows = Reg::ROWS;
    let product = Reg::ProductInformation as usize;
    rows[product] = rows[product].range(0x3d00, 0x3dff).reset(Version::LowCurrent.product());
    rows
};
/// The register map of the low current version.
pub(super) static LOW_TABLE: Table = Reg::TABLE.with_rows(&LOW_ROWS);
