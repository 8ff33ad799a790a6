//! The registers of a QSB (*QSB Command List* 1.28), under the names of its list.

use drivetwin_protocol::line::{Line, Parity};

use super::fields;

/// Factory value of the firmware's version.
const FIRMWARE: i64 = 0x0E;

/// Properties of a variant of the product, besides its registers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Variant {
    /// Bit of the variant in the rows of the registers.
    pub(super) bit: u8,
    /// Last letter of the variant's name.
    pub(super) letter: u8,
    /// Digit of the variant in VERSION.
    pub(super) digit: u8,
    /// Bits of the lines of its digital port.
    pub(super) lines: u8,
    /// True if two of the lines may step a motor.
    pub(super) motor: bool,
}

pub(super) const D: Variant = Variant { bit: 1 << 0, letter: b'D', digit: 0, lines: 0b0001, motor: false };
pub(super) const M: Variant = Variant { bit: 1 << 1, letter: b'M', digit: 1, lines: 0b1111, motor: true };
pub(super) const S: Variant = Variant { bit: 1 << 2, letter: b'S', digit: 2, lines: 0, motor: false };

drivetwin_protocol::registers! {
    /// Registers for the letters R, W and S, and after them settings that a command or the maker sets.
    pub enum Reg: ObjectsHighFirst {
        /// Type of encoder.
        Mode = rw(0x00, "MODE").u8().one_of(&[0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, 16, 17, 18]).saved().fields(fields::MODE),
        /// Reads the levels of DIO3 to DIO0; writes their open-drain outputs.
        DigIO = rw(0x01, "DIG I/O").u8().range(0, 0xF).reset(0xF).saved().streams().only(D.bit | M.bit).fields(fields::DIO),
        /// Use of DIO3 to DIO0. A write releases all pins.
        DigIOConfig = rw(0x02, "DIG I/O CONFIG").range(0, 0x1FFF).saved().only(D.bit | M.bit)
            .not_modelled("not modelled: captures by the motor's own steps").fields(fields::DIO_CONFIG),
        /// Mode of the counter.
        Mdr0 = rw(0x03, "MDR0").u8().reset(0x4F).saved().fields(fields::MDR0),
        /// Further modes of the counter. Bits 1:0 read 0: the counter has 32 bits.
        Mdr1 = rw(0x04, "MDR1").range(0, 0x1FF).saved().fields(fields::MDR1),
        /// The count at the last index or input edge that captured.
        Capture = ro(0x05, "CAPTURE").u32().streams(),
        /// Status of the counter.
        Str = ro(0x06, "STR").u8().reset(0x0A).streams().fields(fields::STR),
        /// The present count.
        Otr = ro(0x07, "OTR").u32(),
        /// Value that is loaded into the counter and compared with it.
        Dtr = rw(0x08, "DTR").u32().reset(0x1F3).saved(),
        /// Clears a register.
        ClearReg = wo(0x09, "CLEAR REG").u8().range(0, 3).fields(fields::CLEAR),
        /// Copies a register.
        LoadReg = wo(0x0A, "LOAD REG").u8().range(0, 1).fields(fields::LOAD),
        /// Least change of the encoder's value for the next streamed value; 0 streams every value.
        Threshold = rw(0x0B, "THRESHOLD").saved(),
        /// Time between two streamed values of the encoder, in 1/512 s: 0 as fast as possible, 0xFFFF never.
        /// Also the length of a trigger's pulse.
        IntervalRate = rw(0x0C, "INTERVAL RATE").reset(0xFFFF).saved(),
        /// Time in 1/512 s; writing 1 sets it to 0.
        TimeStamp = rw(0x0D, "TIME STAMP").u32(),
        /// The encoder's value: a count, a PWM value, or the packet of the analogue input.
        ReadEncoder = ro(0x0E, "READ ENCODER").u32().streams(),
        /// Speed of a move in steps/s, used in multiples of 16.
        MdStepRate = rw(0x0F, "MD STEP RATE").range(0x20, 0x32C8).reset(0x20).saved().only(M.bit),
        /// Acceleration in steps/s², used in multiples of 16.
        MdAccel = rw(0x10, "MD ACCEL").u32().range(0x40, 0x5_7E40).reset(100_000).saved().only(M.bit),
        /// Number of steps of a move.
        MdMoveSteps = rw(0x11, "MD MOVE STEPS").i32().range(-0x7FFF_FFFF, 0x7FFF_FFFF).saved().only(M.bit),
        /// Speed of a jog in steps/s, used in multiples of 16.
        MdJogRate = rw(0x12, "MD JOG RATE").i32().range(-13_000, 13_000).reset(0x20).saved().only(M.bit),
        /// Status of the motor drive.
        MdStatus = ro(0x13, "MD STATUS").u8().reset(1).streams().only(M.bit).fields(fields::MD_STATUS),
        /// Five digits of the serial number, one digit of the variant (0 D, 1 M, 2 S), two digits of the
        /// firmware.
        Version = ro(0x14, "VERSION").u32(),
        /// Format of responses.
        Eor = rw(0x15, "EOR").u8().range(0, 0xF).reset(0xB).saved().fields(fields::EOR),
        /// 1 ends streams, 3 saves, x0A sets the baud rate. QSB-M only: 0 ends the motor drive, 2 starts it,
        /// 4 stops, 5 quits, 6 pauses, 7 resumes, 8 moves, 9 jogs.
        Command = wo(0x16, "COMMAND").u32().one_of(&[
            0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 0x00A, 0x10A, 0x20A, 0x30A, 0x40A, 0x50A, 0x60A, 0x70A,
        ]),
        /// Serial number printed on the device; the first digits of VERSION.
        SerialNumber = setting(0, "VERSION").u32().range(0, 99_999).reset(1).saved(),
        /// Number of the baud rate that command A has set, one of eight.
        BaudRate = setting(1, "COMMAND A").u8().range(0, 7).reset(FACTORY_RATE as i64).saved(),
        /// 1 if command 3 has saved an active motor drive, which is active again after a reset.
        MotorDrive = setting(2, "COMMAND 3").u8().range(0, 1).saved().only(M.bit),
        /// Streams that command 3 has saved and that run again after a reset.
        Streams = setting(3, "COMMAND 3").u8().range(0, 0x1F).saved().fields(fields::STREAMS),
        /// Version of the firmware: the last two digits of VERSION in hexadecimal, and of the banner.
        Firmware = setting(4, "VERSION").u8().reset(FIRMWARE).saved(),
    }
}

/// Code of the baud rate of a new QSB.
const FACTORY_RATE: u8 = 6;

/// Settings of the serial line of a new QSB.
pub(super) const FACTORY_LINE: Line = line(FACTORY_RATE);

/// Settings of the serial line for a code of command A, 0 to 7.
pub(super) const fn line(rate: u8) -> Line {
    let baud = match rate {
        0 => 9_600,
        1 => 19_200,
        2 => 38_400,
        3 => 56_000,
        4 => 115_200,
        5 => 128_000,
        6 => 230_400,
        _ => 256_000,
    };
    Line::new(baud, 8, Parity::None, 1)
}
