//! Ten typical rows of each manual, to show that the table fits all manuals. The rows of the MDrive are in
//! `mdrive.rs`.
//!
//! The expected values are typed from the manuals, not taken from the tables.
#![allow(missing_docs, clippy::unwrap_used, clippy::indexing_slicing, reason = "a test")]

use drivetwin_protocol::modbus::pdu::Exception;
use drivetwin_protocol::modbus::server::{RequestHandler, Rules, serve_rtu};
use drivetwin_protocol::modbus::{Frame, rtu};
use drivetwin_protocol::registers::{Bank, Register, Shape, Space};

/// US Digital MD3: one space, no gaps, pairs with the high word first.
mod md3 {
    drivetwin_protocol::registers! {
        /// MD3 User Guide V1.7, chapter 7.
        pub enum Reg: HighFirst {
            /// Address on the bus.
            DeviceAddress = rw(0x00, "7.1").reset(1).range(1, 247).saved(),
            /// Current and microstepping.
            MotorCurrentAndMicrostepping = rw(0x01, "7.2").reset(0x030a).saved(),
            /// Delay in 10 ms.
            StartupDelay = rw(0x03, "7.4").clamped(0, 65_435).saved(),
            /// Steps before homing.
            PreHomeOffset = rw(0x05, "7.6").i32().saved(),
            /// Do not use.
            Reserved = ro(0x0b, "7.10"),
            /// Index pulses.
            EncoderIndexCount = rw(0x0e, "7.13").i32().live(),
            /// Commands.
            MotionControl = rw(0x11, "7.15").saved_bits(0x0020),
            /// Steps per second.
            Speed = rw(0x14, "7.17").i32().clamped(-40_000, 40_000).reset(5_000).saved(),
            /// EEPROM.
            EEPROMControl = rw(0x1a, "7.20").reset(0x9a00),
            /// Serial number.
            SerialNumber = ro(0x1e, "7.24").u32().reset(1).saved(),
        }
    }
}

/// US Digital QSB: 8-bit register numbers, values of up to 32 bits, three variants, streamed registers.
mod qsb {
    pub(crate) const D: u8 = 1;
    pub(crate) const M: u8 = 2;

    drivetwin_protocol::registers! {
        /// QSB Command List.
        pub enum Reg: ObjectsHighFirst {
            /// Encoder mode.
            Mode = rw(0x00, "MODE").u8().range(0, 0x12).saved(),
            /// Digital port.
            DigIO = rw(0x01, "DIG I/O").u8().range(0, 0xF).reset(0xF).saved().streams().only(D | M),
            /// Counter mode register 0.
            Mdr0 = rw(0x03, "MDR0").u8().reset(0x4F).saved(),
            /// Counter mode register 1, nine bits.
            Mdr1 = rw(0x04, "MDR1").range(0, 0x1FF).saved(),
            /// Counter status.
            Str = ro(0x06, "STR").u8().reset(0x0A).live().streams(),
            /// Data for load and compare.
            Dtr = rw(0x08, "DTR").u32().reset(0x1F3).saved(),
            /// Selects the counter register to clear.
            ClearReg = wo(0x09, "CLEAR REG").u8().range(0, 3),
            /// Stream interval in 1/512 s.
            IntervalRate = rw(0x0C, "INTERVAL RATE").reset(0xFFFF).saved(),
            /// Steps of a move, signed.
            MdMoveSteps = rw(0x11, "MD MOVE STEPS").i32().range(-0x7FFF_FFFF, 0x7FFF_FFFF).saved().only(M),
            /// Software commands.
            Command = wo(0x16, "COMMAND").u32(),
        }
    }
}

/// RS 434544: four address spaces with gaps, pairs with the low word first, key values.
mod rs434 {
    drivetwin_protocol::registers! {
        /// RS 434544 manual, chapter 6.
        pub enum Reg: LowFirst {
            /// Contact IN1 closed.
            In1 = discrete(0x1000, "6.1").live(),
            /// Start.
            Start = coil(0x2000, "6.2"),
            /// Stop.
            Stop = coil(0x2001, "6.2"),
            /// 0 stop, 1 forward, 2 backward.
            Status = input(0x3000, "6.3").range(0, 2).live(),
            /// Edges counted.
            CurrentPosition = input(0x3003, "6.3").i32().live(),
            /// Address; 0 listens to broadcasts only.
            SlaveAddressModbus = rw(0x5000, "6.4").range(0, 247).reset(1).saved(),
            /// Framing, parity, stop bits.
            TypeModbus = rw(0x5001, "6.4").one_of(&[1, 2, 3, 4, 5]).reset(3).saved(),
            /// Distance to go.
            Offset = rw(0x5015, "6.5").i32().saved(),
            /// Key that saves.
            FlagSaveIni = rw(0x5024, "6.5").one_of(&[0, 0x37FA]),
            /// Hardware.
            HwMajor = input(0x8001, "6.8").reset(1_001),
        }
    }
}

/// MDROBOT MD: a PID is the number of a whole value of one or more words. PID 243 has two words, and PID 244
/// exists.
mod mdrobot {
    drivetwin_protocol::registers! {
        /// Modbus Protocol on the MD Controller V1.1, 2.6.
        pub enum Pid: ObjectsLowFirst {
            /// Version.
            Version = ro(1, "2.6").u8().reset(81),
            /// Restores the defaults, with the key 0x55.
            DefaultSet = wo(3, "2.6").one_of(&[0x55]),
            /// A list of PIDs.
            ReqPidData = known(4, "PID.h").not_modelled("only named in the header file"),
            /// Inverts the sign of references.
            InvSignCmd = rw(16, "2.6").range(0, 1).saved(),
            /// Velocity reference in rpm.
            VelCmd = rw(130, "2.6").i16(),
            /// Current limit in 0.1 A.
            MaxLoad = rw(211, "2.6").reset(200).saved(),
            /// Speed, current, output, position, status.
            Monitor = ro(196, "2.6").words(6).live(),
            /// Limits of the speed input. An upper limit of 0 means "not set".
            SpeedLimit = rw(222, "2.6").words(2).each(&[(0, 512), (512, 1_023)]).unset().saved(),
            /// Position to go to.
            PosiCmd = wo(243, "2.6").i32(),
            /// Distance to go.
            IncPosiCmd = wo(244, "2.6").i32(),
        }
    }
}

/// A drive that only stores the written values.
struct Keeper<R: Register, const WORDS: usize> {
    bank: Bank<R, WORDS>,
    refreshed: Vec<R>,
    written: Vec<R>,
}

impl<R: Register, const WORDS: usize> Keeper<R, WORDS> {
    fn new() -> Self {
        Self { bank: Bank::factory(), refreshed: Vec::new(), written: Vec::new() }
    }

    /// The PDU of the reply; empty if there is no reply.
    fn ask(&mut self, rules: &Rules, pdu: &[u8]) -> Vec<u8> {
        let mut reply = Frame::new();
        serve_rtu(&rtu::frame(1, pdu), 1, rules, self, &mut reply);
        rtu::verify_crc(&reply).map(|body| body[1..].to_vec()).unwrap_or_default()
    }
}

impl<R: Register, const WORDS: usize> RequestHandler for Keeper<R, WORDS> {
    type Register = R;

    fn words(&self) -> &[u16] {
        self.bank.words()
    }

    fn words_mut(&mut self) -> &mut [u16] {
        self.bank.words_mut()
    }

    fn refresh(&mut self, register: R) {
        self.refreshed.push(register);
    }

    fn written(&mut self, register: R) {
        self.written.push(register);
    }
}

/// Rules with all functions and the exceptions of the specification.
const RULES: Rules = Rules {
    functions: &[1, 2, 3, 4, 5, 6, 15, 16],
    broadcast: Some(0),
    max_read: 125,
    max_written: 123,
    bits_per_word: 16,
    partial_writes: true,
    bad_quantity: Exception::IllegalDataValue,
    bad_value: Exception::IllegalDataValue,
    read_only: Exception::IllegalDataAddress,
};

#[test]
fn md3_pairs_read_high_word_first() {
    let mut md3 = Keeper::<md3::Reg, { md3::Reg::WORDS }>::new();
    assert_eq!(md3.ask(&RULES, &[3, 0, 0x14, 0, 2]), [3, 4, 0x00, 0x00, 0x13, 0x88]);
    assert_eq!(md3.ask(&RULES, &[3, 0, 0x15, 0, 1]), [3, 2, 0x13, 0x88]);
    assert_eq!(md3.ask(&RULES, &[6, 0, 0x14, 0xFF, 0xFF]), [6, 0, 0x14, 0xFF, 0xFF]);
    assert_eq!(md3.bank.get(md3::Reg::Speed), -60_536);
    assert_eq!(md3.bank.clamped_value(md3::Reg::Speed), -40_000);
    assert_eq!(md3.written, [md3::Reg::Speed]);
    assert_eq!(md3.ask(&RULES, &[3, 0, 0x0e, 0, 2]).len(), 6);
    assert_eq!(md3.refreshed, [md3::Reg::EncoderIndexCount]);
}

#[test]
fn a_drive_carries_out_writes_to_its_own_address_and_broadcasts_only() {
    for address in 0..=u8::MAX {
        let mut md3 = Keeper::<md3::Reg, { md3::Reg::WORDS }>::new();
        let mut reply = Frame::new();
        serve_rtu(&rtu::frame(address, &[6, 0, 0x15, 0, 7]), 1, &RULES, &mut md3, &mut reply);
        assert_eq!(md3.bank.get(md3::Reg::Speed), if address <= 1 { 7 } else { 5_000 }, "{address}");
        assert_eq!((md3.written.len(), reply.is_empty()), (usize::from(address <= 1), address != 1));
    }
}

#[test]
fn md3_names_of_halves() {
    let table = md3::Reg::TABLE;
    let named = |name| table.find(name).map(|named| (table.rows[named.row].name, named.word));
    assert_eq!(named("Speed"), Some(("Speed", None)));
    assert_eq!(named("SpeedHigh"), Some(("Speed", Some(0))));
    assert_eq!(named("SpeedLow"), Some(("Speed", Some(1))));
    assert_eq!(named("StartupDelayHigh"), None);
}

#[test]
fn md3_gaps_and_read_only_rows_refuse() {
    let mut md3 = Keeper::<md3::Reg, { md3::Reg::WORDS }>::new();
    assert_eq!(md3.ask(&RULES, &[3, 0, 0x00, 0, 3]), [0x83, 2]); // 0x02 is not among the ten
    assert_eq!(md3.ask(&RULES, &[6, 0, 0x0b, 0, 0]), [0x86, 2]);
    assert_eq!(md3.ask(&RULES, &[6, 0, 0x00, 0, 248]), [0x86, 3]);
    assert_eq!(md3.ask(&RULES, &[16, 0, 0x0a, 0, 1, 2, 0, 0]), [0x90, 2]);
    assert!(md3.written.is_empty());
}

#[test]
fn qsb_values_are_whole_and_variants_share_numbers() {
    let table = qsb::Reg::TABLE;
    let row = |reg: qsb::Reg| &table.rows[reg.row()];
    assert_eq!(row(qsb::Reg::Dtr).shape, Shape::U32);
    assert_eq!(table.at(Space::Holding, 0x08), Some((qsb::Reg::Dtr.row(), 0)));
    assert_eq!(table.at(Space::Holding, 0x09), Some((qsb::Reg::ClearReg.row(), 0)));
    assert!(!row(qsb::Reg::Mdr1).accepts(0x200) && row(qsb::Reg::Mdr1).accepts(0x1FF));
    assert!(row(qsb::Reg::Str).streams && !row(qsb::Reg::Mode).streams);
    assert_eq!(row(qsb::Reg::MdMoveSteps).variants, qsb::M);
    let mut bank = Bank::<qsb::Reg, { qsb::Reg::WORDS }>::factory();
    assert_eq!(bank.get(qsb::Reg::Dtr), 499);
    bank.set(qsb::Reg::MdMoveSteps, -5);
    assert_eq!(bank.get(qsb::Reg::MdMoveSteps), -5);
}

#[test]
fn rs_has_four_spaces_and_the_low_word_first() {
    use rs434::Reg;
    let mut rs = Keeper::<Reg, { Reg::WORDS }>::new();
    rs.bank.set(Reg::In1, 1);
    rs.bank.set(Reg::CurrentPosition, -2);
    assert_eq!(rs.ask(&RULES, &[2, 0x10, 0x00, 0, 1]), [2, 1, 1]);
    assert_eq!(rs.ask(&RULES, &[4, 0x30, 0x03, 0, 2]), [4, 4, 0xFF, 0xFE, 0xFF, 0xFF]);
    assert_eq!(rs.refreshed, [Reg::In1, Reg::CurrentPosition]);
    assert_eq!(rs.ask(&RULES, &[4, 0x10, 0x00, 0, 1]), [0x84, 2]);
    assert_eq!(rs.ask(&RULES, &[5, 0x20, 0x01, 0xFF, 0x00]), [5, 0x20, 0x01, 0xFF, 0x00]);
    assert_eq!(rs.ask(&RULES, &[5, 0x20, 0x01, 0x00, 0x01]), [0x85, 3]);
    assert_eq!(rs.ask(&RULES, &[15, 0x20, 0x00, 0, 2, 1, 0b01]), [15, 0x20, 0x00, 0, 2]);
    assert_eq!(rs.ask(&RULES, &[1, 0x20, 0x00, 0, 2]), [1, 1, 0b01]);
    assert_eq!(rs.ask(&RULES, &[6, 0x50, 0x24, 0x12, 0x34]), [0x86, 3]);
    assert_eq!(rs.ask(&RULES, &[6, 0x50, 0x00, 0, 0]), [6, 0x50, 0x00, 0, 0]);
}

#[test]
fn a_write_of_several_is_all_or_nothing() {
    use rs434::Reg;
    let mut rs = Keeper::<Reg, { Reg::WORDS }>::new();
    // First the second value is out of range, then one address is past the last row, then the byte count is
    // wrong.
    assert_eq!(rs.ask(&RULES, &[16, 0x50, 0x00, 0, 2, 4, 0, 5, 0, 9]), [0x90, 3]);
    assert_eq!(rs.ask(&RULES, &[16, 0x50, 0x00, 0, 3, 6, 0, 5, 0, 1, 0, 0]), [0x90, 2]);
    assert_eq!(rs.ask(&RULES, &[16, 0x50, 0x00, 0, 2, 2, 0, 5]), [0x90, 3]);
    assert_eq!((rs.bank.get(Reg::SlaveAddressModbus), rs.written.len()), (1, 0));
    assert_eq!(rs.ask(&RULES, &[16, 0x50, 0x00, 0, 2, 4, 0, 5, 0, 4]), [16, 0x50, 0x00, 0, 2]);
    assert_eq!(rs.written, [Reg::SlaveAddressModbus, Reg::TypeModbus]);
    assert_eq!(rs.bank.get(Reg::SlaveAddressModbus), 5);
}

#[test]
fn every_address_is_judged_before_any_value() {
    use rs434::Reg;
    let mut rs = Keeper::<Reg, { Reg::WORDS }>::new();
    // 300 is out of range at 5000h, and 5002h is not among the ten rows.
    assert_eq!(rs.ask(&RULES, &[16, 0x50, 0x00, 0, 3, 6, 0x01, 0x2C, 0, 3, 0, 0]), [0x90, 2]);
    let mut md3 = Keeper::<md3::Reg, { md3::Reg::WORDS }>::new();
    // 0 is out of range at 0x00, and 0x02 is not among the ten rows.
    assert_eq!(md3.ask(&RULES, &[16, 0, 0x00, 0, 3, 6, 0, 0, 0, 0, 0, 0]), [0x90, 2]);
    assert!(rs.written.is_empty() && md3.written.is_empty());
}

#[test]
fn a_pid_is_read_and_written_whole() {
    use mdrobot::Pid;
    let mut md = Keeper::<Pid, { Pid::WORDS }>::new();
    assert_eq!(md.ask(&RULES, &[3, 0, 1, 0, 1]), [3, 2, 0, 81]);
    assert_eq!(md.ask(&RULES, &[3, 0, 196, 0, 6]).len(), 14);
    assert_eq!(md.refreshed, [Pid::Monitor]);
    for (pid, quantity) in [(1, 2), (196, 1), (196, 5), (196, 7), (211, 2), (222, 1), (222, 3), (222, 125)] {
        assert_eq!(md.ask(&RULES, &[3, 0, pid, 0, quantity]), [0x83, 3], "{quantity} of PID {pid}");
    }
    for quantity in [1, 2, 125] {
        assert_eq!(md.ask(&RULES, &[3, 0, 3, 0, quantity]), [0x83, 2], "write only");
        assert_eq!(md.ask(&RULES, &[3, 0, 4, 0, quantity]), [0x83, 2], "only named");
        assert_eq!(md.ask(&RULES, &[3, 0, 2, 0, quantity]), [0x83, 2], "not there");
        assert_eq!(md.ask(&RULES, &[3, 1, 1, 0, quantity]), [0x83, 2], "PID_H counts");
    }
    // The quantity is checked before the PID.
    for quantity in [0, 126, 255] {
        assert_eq!(md.ask(&RULES, &[3, 0, 2, 0, quantity]), [0x83, 3]);
    }
    assert_eq!(md.ask(&RULES, &[6, 0, 1, 0, 9]), [0x86, 2], "read only");
    assert_eq!(md.ask(&RULES, &[6, 0, 196, 0, 9]), [0x86, 2], "read only, whatever the quantity");
    assert_eq!(md.ask(&RULES, &[6, 0, 4, 0, 9]), [0x86, 2], "only named");
    assert!(md.written.is_empty());
    // Position 100,000 is 0x0001_86A0, sent with the low word first. Both words belong to PID 243: PID 244 is a
    // separate value, not the high word, and stays 0.
    assert_eq!(md.ask(&RULES, &[16, 0, 243, 0, 2, 4, 0x86, 0xA0, 0, 1]), [16, 0, 243, 0, 2]);
    assert_eq!((md.bank.get(Pid::PosiCmd), md.bank.get(Pid::IncPosiCmd)), (100_000, 0));
    assert_eq!(md.ask(&RULES, &[16, 0, 243, 0, 1, 2, 0, 1]), [0x90, 3]);
    assert_eq!(md.ask(&RULES, &[6, 0, 243, 0, 1]), [0x86, 3]);
    assert_eq!(md.ask(&RULES, &[6, 0, 130, 0xFF, 0x9C]), [6, 0, 130, 0xFF, 0x9C]);
    assert_eq!(md.bank.get(Pid::VelCmd), -100);
}

#[test]
fn each_word_of_a_value_has_its_range() {
    use mdrobot::Pid;
    let mut md = Keeper::<Pid, { Pid::WORDS }>::new();
    let write =
        |low: u16, high: u16| [&[16, 0, 222, 0, 2, 4][..], &low.to_be_bytes(), &high.to_be_bytes()].concat();
    for (low, high) in [(513, 600), (0, 511), (0, 1_024), (0, 0), (0xFFFF, 600)] {
        assert_eq!(md.ask(&RULES, &write(low, high)), [0x90, 3], "{low}, {high}");
        assert_eq!(md.ask(&RULES, &[3, 0, 222, 0, 2]), [3, 4, 0, 0, 0, 0], "nothing has changed");
    }
    for (low, high) in [(0, 512), (512, 1_023), (512, 512)] {
        assert_eq!(md.ask(&RULES, &write(low, high)), [16, 0, 222, 0, 2]);
        assert_eq!(md.bank.get(Pid::SpeedLimit), i64::from(high) << 16 | i64::from(low));
    }
}
