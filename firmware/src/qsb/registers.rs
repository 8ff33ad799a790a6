//! The registers of a QSB (*QSB Command List* 1.28), under the names of its list.

use standin_protocol::line::{Line, Parity};

/// The variants of the product, a bit each.
pub(super) mod variant {
    pub(in crate::qsb) const D: u8 = 1 << 0;
    pub(in crate::qsb) const M: u8 = 1 << 1;
    pub(in crate::qsb) const S: u8 = 1 << 2;
}
use variant::{D, M};

standin_protocol::registers! {
    /// What the letters R, W and S name; the settings behind them a command or the maker sets.
    pub enum Reg: ObjectsHighFirst {
        /// Bits 1:0 what encoder is read: 0 quadrature or step/direction, 1 PWM, 2 analogue. Bit 4
        /// reads 1 while a 12-bit PWM encoder is seen.
        Mode = rw(0x00, "MODE").u8().one_of(&[0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, 16, 17, 18]).saved(),
        /// Reads the levels of DIO3 to DIO0, writes their open-drain outputs.
        DigIO = rw(0x01, "DIG I/O").u8().range(0, 0xF).reset(0xF).saved().streams().only(D | M),
        /// Bits 3:0 which edge captures, 1 the falling one; 7:4 that it does; 11:8 which pins are
        /// outputs; 12 that a trigger makes a pulse on DIO0. A write lets all pins go high.
        DigIOConfig = rw(0x02, "DIG I/O CONFIG").range(0, 0x1FFF).saved().only(D | M),
        /// The counter's mode register 0.
        Mdr0 = rw(0x03, "MDR0").u8().reset(0x4F).saved(),
        /// Bit 2 stops counting, 3 inverts the index, 7:4 trigger on overflow, underflow, match and
        /// index, 8 counts down. Bits 1:0 read 0: the counter has 32 bits.
        Mdr1 = rw(0x04, "MDR1").range(0, 0x1FF).saved(),
        /// The count at the last index or input edge that captured it.
        Capture = ro(0x05, "CAPTURE").u32().streams(),
        /// The counter's status register.
        Str = ro(0x06, "STR").u8().reset(0x0A).streams(),
        /// The count now.
        Otr = ro(0x07, "OTR").u32(),
        /// What the counter loads and compares with.
        Dtr = rw(0x08, "DTR").u32().reset(0x1F3).saved(),
        /// Clears 0 MDR0, 1 MDR1, 2 CNTR, 3 STR.
        ClearReg = wo(0x09, "CLEAR REG").u8().range(0, 3),
        /// 0 DTR to CNTR, 1 CNTR to OTR.
        LoadReg = wo(0x0A, "LOAD REG").u8().range(0, 1),
        /// How far the encoder's value must have gone to be streamed again; 0 streams each.
        Threshold = rw(0x0B, "THRESHOLD").saved(),
        /// Time between two streamed values of the encoder, in 1/512 s: 0 as fast as it can, 0xFFFF
        /// never. Also how long a trigger's pulse lasts.
        IntervalRate = rw(0x0C, "INTERVAL RATE").reset(0xFFFF).saved(),
        /// Counts 1/512 s; writing 1 clears it.
        TimeStamp = rw(0x0D, "TIME STAMP").u32(),
        /// The encoder's value: a count, a PWM value, or the packet of the analogue input.
        ReadEncoder = ro(0x0E, "READ ENCODER").u32().streams(),
        /// Steps/s of a move, used in steps of 16.
        MdStepRate = rw(0x0F, "MD STEP RATE").range(0x20, 0x32C8).reset(0x20).saved().only(M),
        /// Steps/s², used in steps of 16.
        MdAccel = rw(0x10, "MD ACCEL").u32().range(0x40, 0x5_7E40).reset(100_000).saved().only(M),
        /// Steps of a move.
        MdMoveSteps = rw(0x11, "MD MOVE STEPS").i32().range(-0x7FFF_FFFF, 0x7FFF_FFFF).saved().only(M),
        /// Steps/s of a jog, used in steps of 16.
        MdJogRate = rw(0x12, "MD JOG RATE").i32().range(-13_000, 13_000).reset(0x20).saved().only(M),
        /// Bit 0 ready, 1 moving, 2 paused, 3 jogging, 4 the motor drive is active.
        MdStatus = ro(0x13, "MD STATUS").u8().reset(1).streams().only(M),
        /// Five digits of the serial number, one of the variant (0 D, 1 M, 2 S), two of the firmware.
        Version = ro(0x14, "VERSION").u32(),
        /// What a response ends with: bit 0 LF, 1 CR, 2 time stamp; 3 spaces between its fields.
        Eor = rw(0x15, "EOR").u8().range(0, 0xF).reset(0xB).saved(),
        /// Executes a function; 0 and 2 to 9, but for 3, are of the QSB-M.
        Command = wo(0x16, "COMMAND").u32().one_of(&[
            0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 0x00A, 0x10A, 0x20A, 0x30A, 0x40A, 0x50A, 0x60A, 0x70A,
        ]),
        /// Printed on the device: what VERSION begins with.
        SerialNumber = setting(0, "VERSION").u32().range(0, 99_999).reset(1).saved(),
        /// Which of the eight rates of command A is set.
        BaudRate = setting(1, "COMMAND A").u8().range(0, 7).reset(6).saved(),
        /// The motor drive is active after a reset, as command 3 saved it.
        MotorDrive = setting(2, "COMMAND 3").u8().range(0, 1).saved().only(M),
        /// What streams after a reset, as command 3 saved it: bits 0 DIG I/O, 1 CAPTURE, 2 STR,
        /// 3 READ ENCODER, 4 MD STATUS.
        Streams = setting(3, "COMMAND 3").u8().range(0, 0x1F).saved(),
    }
}

/// Places in DIG I/O CONFIG of the bits of DIO0, and a bit.
pub(super) mod config {
    pub(in crate::qsb) const FALLING: u16 = 0;
    pub(in crate::qsb) const CAPTURES: u16 = 4;
    pub(in crate::qsb) const OUTPUTS: u16 = 8;
    pub(in crate::qsb) const PULSE: u16 = 1 << 12;
}

/// Bits of MDR1 that the counter does not have, or that are not for it.
pub(super) mod mdr1 {
    /// The counter has 32 bits, whatever is written.
    pub(in crate::qsb) const WIDTH: u16 = 0b11;
    pub(in crate::qsb) const INVERT_INDEX: u16 = 1 << 3;
    /// Overflow, underflow, match and index, in the places of the counter's flags.
    pub(in crate::qsb) const TRIGGERS: u16 = 0xF0;
    pub(in crate::qsb) const COUNT_DOWN: u16 = 1 << 8;
}

/// The line of a new QSB.
pub(super) const FACTORY_LINE: Line = line(6);

/// Bits per second of the rates of command A.
const BAUD: [u32; 8] = [9_600, 19_200, 38_400, 56_000, 115_200, 128_000, 230_400, 256_000];

/// The line at a rate of command A; those beyond the table are the last one.
pub(super) const fn line(rate: u8) -> Line {
    let [.., last] = BAUD;
    let mut baud = last;
    let mut rest: &[u32] = &BAUD;
    let mut n = 0;
    while let [first, behind @ ..] = rest {
        if n == rate {
            baud = *first;
        }
        rest = behind;
        n += 1;
    }
    Line::new(baud, 8, Parity::None, 1)
}
