//! Typical rows of the MDrive, and the features of the bus that they need: Modbus/TCP, registers that are
//! also bits, rows of one variant or of a running program, values that are checked together, and functions of
//! the drive's own.
//!
//! The expected values are typed from the fieldbus manual ("FB"), not taken from the table.
#![allow(missing_docs, clippy::unwrap_used, clippy::indexing_slicing, reason = "a test")]

use drivetwin_protocol::modbus::pdu::Exception;
use drivetwin_protocol::modbus::server::{Outcome, RequestHandler, Rules, Values, refuse_tcp, serve_tcp};
use drivetwin_protocol::modbus::tcp::{self, Adu, Header};
use drivetwin_protocol::modbus::{DropReason, Reply, identification};
use drivetwin_protocol::registers::{Bank, Legal, Register, Space};
use proptest::prelude::*;

const PLUS: u8 = 1;
const HYBRID: u8 = 2;

drivetwin_protocol::registers! {
    /// FB chapter 5.
    pub enum Reg: HighFirst {
        /// Acceleration in steps/s².
        A = rw(0x0000, "5").u32().range(91, 1_525_878_997).reset(1_000_000).saved(),
        /// Counter 1.
        C1 = rw(0x0005, "5").i32().saved(),
        /// Counter 2.
        C2 = rw(0x0007, "5").i32().saved(),
        /// Software reset enable.
        CE = rw(0x0009, "5").u8().range(0, 1).reset(1).saved(),
        /// Clock mode enable.
        CM = rw(0x000B, "5").u8().range(0, 1).saved().only(PLUS),
        /// Error flag.
        EF = ro(0x001F, "5").u8().range(0, 1).live(),
        /// Number of the last error. A read clears it.
        ER = rw(0x0021, "5").range(0, 0).live(),
        /// Input 1.
        I1 = ro(0x002D, "5").u8().range(0, 1).live().also_discrete(),
        /// Input 2.
        I2 = ro(0x002E, "5").u8().range(0, 1).live().also_discrete(),
        /// Input 3.
        I3 = ro(0x002F, "5").u8().range(0, 1).live().also_discrete(),
        /// Input 4.
        I4 = ro(0x0030, "5").u8().range(0, 1).live().also_discrete(),
        /// Analog input in counts.
        I5 = ro(0x0031, "5").range(0, 1_023).live(),
        /// Move to an absolute position in steps.
        MA = rw(0x0043, "5").i32(),
        /// Microsteps per full step.
        MS = rw(0x0048, "5").one_of(&[1, 2, 4, 8, 16, 32, 64, 128, 256]).reset(256).saved(),
        /// Moving.
        MV = ro(0x004A, "5").u8().range(0, 1),
        /// Output 1.
        O1 = rw(0x004B, "5").u8().range(0, 1).also_coil(),
        /// Output 2.
        O2 = rw(0x004C, "5").u8().range(0, 1).also_coil(),
        /// Output 3.
        O3 = rw(0x004D, "5").u8().range(0, 1).also_coil(),
        /// Output 4.
        O4 = rw(0x004E, "5").u8().range(0, 1).also_coil(),
        /// Saves the registers, with any value.
        S = rw(0x0076, "5"),
        /// Initial velocity in steps/s.
        VI = rw(0x0089, "5").u32().range(1, 4_999_999).reset(1_000).saved(),
        /// Maximum velocity in steps/s.
        VM = rw(0x008B, "5").u32().range(2, 5_000_000).reset(768_000).saved(),
        /// Locked rotor timeout in ms: a word in the second of two registers.
        LT = rw(0x009C, "5.1").u32().range(2, 65_535).reset(2_000).saved().only(HYBRID),
        /// User variable 1.
        V1 = rw(0x00A8, "5.2").i32().optional(),
        /// User variable 2.
        V2 = rw(0x00AA, "5.2").i32().optional(),
    }
}

/// Rules of FB 4. A part of a value cannot be written.
const RULES: Rules = Rules {
    functions: &[1, 2, 3, 5, 16, 43, 65, 66],
    broadcast: None,
    max_read: 4,
    max_written: 4,
    bits_per_word: 1,
    partial_writes: false,
    bad_quantity: Exception::IllegalDataValue,
    bad_value: Exception::IllegalDataValue,
    read_only: Exception::IllegalDataAddress,
};

const HEADER: Header = Header { transaction: 0xBEEF, unit: 1 };

const OBJECTS: &[identification::Object<'_>] = &[(0, b"SEM USA"), (1, b"MDI"), (2, b"4.0.0.0")];

/// The part of a drive that its bus needs.
struct Mdrive {
    bank: Bank<Reg, { Reg::WORDS }>,
    variant: u8,
    /// Number of user variables (0 to 2: V1, V2) that a program has declared.
    declared: u16,
    inputs: [i64; 4],
    error: i64,
    moving: bool,
    written: Vec<Reg>,
}

impl Mdrive {
    fn new(variant: u8) -> Self {
        let bank = Bank::factory();
        Self { bank, variant, declared: 0, inputs: [0; 4], error: 0, moving: false, written: Vec::new() }
    }

    /// The PDU of the reply to a request.
    fn ask(&mut self, pdu: &[u8]) -> Vec<u8> {
        let mut reply = Adu::new();
        serve_tcp(&tcp::frame(HEADER, pdu), &RULES, self, &mut reply);
        let (header, pdu) = tcp::parse(&reply).unwrap();
        assert_eq!(header, HEADER);
        pdu.to_vec()
    }

    /// The exception in the reply to a request; 0 for none.
    fn refusal(&mut self, pdu: &[u8]) -> u8 {
        let reply = self.ask(pdu);
        if reply[0] & 0x80 == 0 {
            return 0;
        }
        assert_eq!((reply[0], reply.len()), (pdu[0] | 0x80, 2));
        reply[1]
    }
}

impl RequestHandler for Mdrive {
    type Register = Reg;

    fn words(&self) -> &[u16] {
        self.bank.words()
    }

    fn words_mut(&mut self) -> &mut [u16] {
        self.bank.words_mut()
    }

    fn refresh(&mut self, register: Reg) {
        match register {
            Reg::EF => self.bank.set(Reg::EF, i64::from(self.error != 0)),
            Reg::ER => self.bank.set(Reg::ER, core::mem::take(&mut self.error)),
            input => self.bank.set(input, self.inputs.get(input.row() - Reg::I1.row()).map_or(512, |&n| n)),
        }
    }

    fn written(&mut self, register: Reg) {
        self.written.push(register);
    }

    fn write_multiple(&mut self, values: &Values<'_, Reg>) -> Option<Result<(), Exception>> {
        let outcome = |register| values.get(register).unwrap_or_else(|| self.bank.get(register));
        if outcome(Reg::VI) >= outcome(Reg::VM) {
            self.error = if values.get(Reg::VI).is_some() { 22 } else { 23 };
            return Some(Err(Exception::IllegalDataValue));
        }
        if values.get(Reg::MA).is_some() && self.moving {
            self.error = 85;
            return Some(Err(Exception::ServerDeviceFailure));
        }
        // The drive sets the position itself; the server stores nothing.
        let position = values.get(Reg::C2)?;
        self.bank.set(Reg::C2, position - 1);
        Some(Ok(()))
    }

    fn on_out_of_range(&mut self, _register: Reg, _value: i64) {
        self.error = 21;
    }

    fn is_present(&self, register: Reg) -> bool {
        match register {
            Reg::V1 => self.declared >= 1,
            Reg::V2 => self.declared >= 2,
            other => Reg::ENTRIES.list[other.row()].variants & self.variant != 0,
        }
    }

    fn custom_function(&mut self, pdu: &[u8], reply: &mut Reply) -> Result<(), Exception> {
        match pdu[0] {
            43 => identification::answer(pdu, 0x82, OBJECTS, reply),
            65 => reply.extend_from_slice(&[65, 0]).map_err(|_| Exception::ServerDeviceFailure),
            _ => {
                reply.extend_from_slice(&[66, 4, 0x20]).unwrap();
                Err(Exception::IllegalDataAddress)
            }
        }
    }
}

#[test]
fn the_examples_of_the_manual() {
    let mut mdrive = Mdrive::new(PLUS);
    // FB 4.2.4 and 4.2.5 print address 0x8A for VM, but its table has 0x8B. 768,000 is 0x000B_B800, 600,000
    // is 0x0009_27C0.
    assert_eq!(mdrive.ask(&[3, 0, 0x8B, 0, 2]), [3, 4, 0x00, 0x0B, 0xB8, 0x00]);
    assert_eq!(mdrive.ask(&[16, 0, 0x8B, 0, 2, 4, 0x00, 0x09, 0x27, 0xC0]), [16, 0, 0x8B, 0, 2]);
    assert_eq!(mdrive.bank.get(Reg::VM), 600_000);
    // FB 4.2.1: I1, I2 and I4 are on.
    mdrive.inputs = [1, 1, 0, 1];
    assert_eq!(mdrive.ask(&[2, 0x00, 0x2D, 0x00, 0x04]), [2, 1, 0x0B]);
    // FB 4.2.2: O1 and O3 are on. FB 4.2.3 switches O3 on.
    mdrive.bank.set(Reg::O1, 1);
    assert_eq!(mdrive.ask(&[5, 0x00, 0x4D, 0xFF, 0x00]), [5, 0x00, 0x4D, 0xFF, 0x00]);
    assert_eq!(mdrive.ask(&[1, 0x00, 0x4B, 0x00, 0x04]), [1, 1, 0x05]);
    assert_eq!(mdrive.written, [Reg::VM, Reg::O3]);
}

#[test]
fn registers_that_the_drive_sets_itself_are_not_stored() {
    let mut mdrive = Mdrive::new(PLUS);
    // A write of C1 and C2. The drive sets C2 itself.
    assert_eq!(mdrive.ask(&[16, 0, 0x07, 0, 2, 4, 0, 0, 0, 50]), [16, 0, 0x07, 0, 2]);
    assert_eq!(mdrive.bank.get(Reg::C2), 49);
    assert!(mdrive.written.is_empty());
}

#[test]
fn an_adu_keeps_its_transaction_and_any_unit() {
    let mut mdrive = Mdrive::new(PLUS);
    for unit in 0..=255 {
        let mut reply = Adu::new();
        let request = [0x12, unit, 0, 0, 0, 6, unit, 3, 0, 9, 0, 1];
        let outcome = serve_tcp(&request, &RULES, &mut mdrive, &mut reply);
        assert_eq!(outcome, Outcome::Served { unit, function: 3, refused: None });
        assert_eq!(reply[..], [0x12, unit, 0, 0, 0, 5, unit, 3, 2, 0, 1]);
    }
    let mut reply = Adu::new();
    let outcome = serve_tcp(&[0, 1, 0, 0, 0, 2, 9, 7], &RULES, &mut mdrive, &mut reply);
    let refused = Some(Exception::IllegalFunction);
    assert_eq!(outcome, Outcome::Served { unit: 9, function: 7, refused });
    assert_eq!(reply[..], [0, 1, 0, 0, 0, 3, 9, 0x87, 1]);
    for adu in [&[][..], &[0, 1, 0, 0, 0, 1, 9], &[0, 1, 0, 1, 0, 2, 9, 7], &[0, 1, 0, 0, 0, 3, 9, 7]] {
        assert_eq!(serve_tcp(adu, &RULES, &mut mdrive, &mut reply), Outcome::Dropped(DropReason::Length));
        assert!(reply.is_empty());
    }
}

#[test]
fn a_drive_that_is_not_ready_refuses_every_request() {
    let busy = Exception::ServerDeviceFailure;
    let mut reply = Adu::new();
    for function in [3, 7, 65] {
        let outcome = refuse_tcp(&[0, 1, 0, 0, 0, 3, 9, function, 0], busy, &mut reply);
        assert_eq!(outcome, Outcome::Served { unit: 9, function, refused: Some(busy) });
        assert_eq!(reply[..], [0, 1, 0, 0, 0, 3, 9, function | 0x80, 4]);
    }
    assert_eq!(refuse_tcp(&[0, 1, 0, 0, 0, 3, 9, 7], busy, &mut reply), Outcome::Dropped(DropReason::Length));
    assert!(reply.is_empty());
}

#[test]
fn a_request_of_the_wrong_length_is_refused() {
    let mut mdrive = Mdrive::new(PLUS);
    for pdu in [
        &[3][..],
        &[3, 0, 0x8B, 0],
        &[3, 0, 0x8B, 0, 2, 0],
        &[1, 0, 0x4B, 4],
        &[5, 0, 0x4B, 0xFF],
        &[16, 0, 0x8B, 0, 2],
        &[16, 0, 0x8B, 0, 2, 4, 0, 9, 0x27],
        &[16, 0, 0x8B, 0, 2, 2, 0, 9],
        &[43],
    ] {
        assert_eq!(mdrive.refusal(pdu), 3, "{pdu:?}");
    }
    for function in [4, 6, 15, 8, 0, 0x83] {
        assert_eq!(mdrive.ask(&[function]), [function | 0x80, 1], "before its length");
    }
    assert!(mdrive.written.is_empty());
}

#[test]
fn inputs_and_outputs_are_registers_and_bits() {
    let mut mdrive = Mdrive::new(PLUS);
    mdrive.inputs = [0, 1, 0, 1];
    assert_eq!(mdrive.ask(&[3, 0, 0x2D, 0, 4]), [3, 8, 0, 0, 0, 1, 0, 0, 0, 1]);
    assert_eq!(mdrive.ask(&[3, 0, 0x30, 0, 2]), [3, 4, 0, 1, 0x02, 0x00], "I5 stands behind");
    for (first, count, bits) in [(0x2D, 1, 0), (0x2E, 1, 1), (0x2E, 3, 0b101), (0x30, 1, 1)] {
        assert_eq!(mdrive.ask(&[2, 0, first, 0, count]), [2, 1, bits], "{count} from {first:#04x}");
    }
    assert_eq!(mdrive.refusal(&[16, 0, 0x4B, 0, 4, 8, 0, 1, 0, 0, 0, 1, 0, 1]), 0);
    assert_eq!(mdrive.ask(&[1, 0, 0x4B, 0, 4]), [1, 1, 0b1101]);
    assert_eq!(mdrive.refusal(&[5, 0, 0x4B, 0, 0]), 0);
    assert_eq!(mdrive.ask(&[3, 0, 0x4B, 0, 1]), [3, 2, 0, 0]);
    assert_eq!(mdrive.written, [Reg::O1, Reg::O2, Reg::O3, Reg::O4, Reg::O1]);
    mdrive.written.clear();
    for (why, pdu, exception) in [
        ("I5 is no bit", &[2, 0, 0x2E, 0, 4][..], 2),
        ("nor is what stands before", &[2, 0, 0x2C, 0, 2], 2),
        ("nothing behind the outputs", &[1, 0, 0x4E, 0, 2], 2),
        ("inputs are no coils", &[1, 0, 0x2D, 0, 1], 2),
        ("outputs are no inputs", &[2, 0, 0x4B, 0, 1], 2),
        ("a register is no coil", &[1, 0, 0x09, 0, 1], 2),
        ("inputs are not written", &[5, 0, 0x2D, 0xFF, 0], 2),
        ("at most 4 inputs", &[2, 0, 0x2D, 0, 5], 3),
        ("at least one", &[1, 0, 0x4B, 0, 0], 3),
        ("at most 4 outputs, before the address", &[1, 0, 0xFF, 0, 5], 3),
        ("neither on nor off", &[5, 0, 0x4B, 0, 1], 3),
        ("neither on nor off", &[16, 0, 0x4B, 0, 1, 2, 0, 2], 3),
    ] {
        assert_eq!(mdrive.refusal(pdu), exception, "{why}");
    }
    assert!(mdrive.written.is_empty());
}

#[test]
fn a_part_of_a_value_can_be_read_and_not_written() {
    let mut mdrive = Mdrive::new(PLUS);
    assert_eq!(mdrive.ask(&[3, 0, 0x8C, 0, 1]), [3, 2, 0xB8, 0x00]);
    assert_eq!(mdrive.ask(&[3, 0, 0x8A, 0, 2]), [3, 4, 0x03, 0xE8, 0x00, 0x0B]);
    for (why, pdu, exception) in [
        ("the low half", &[16, 0, 0x8C, 0, 1, 2, 0, 9][..], 3),
        ("the high half", &[16, 0, 0x8B, 0, 1, 2, 0, 9], 3),
        ("half of VI, half of VM", &[16, 0, 0x8A, 0, 2, 4, 0, 1, 0, 9], 3),
        ("VI and half of VM", &[16, 0, 0x89, 0, 3, 6, 0, 0, 0, 5, 0, 9], 3),
        ("half of VI, and VM out of range", &[16, 0, 0x8A, 0, 3, 6, 0, 1, 0, 0, 0, 0], 3),
        ("half of C2, and what is reserved", &[16, 0, 0x08, 0, 3, 6, 0, 0, 0, 1, 0, 0], 2),
        ("half of V1, which is not there", &[16, 0, 0xA8, 0, 1, 2, 0, 0], 2),
    ] {
        assert_eq!(mdrive.refusal(pdu), exception, "{why}");
    }
    assert_eq!((mdrive.bank.get(Reg::VI), mdrive.bank.get(Reg::VM)), (1_000, 768_000));
    assert_eq!((mdrive.error, mdrive.written.len()), (0, 0), "structure does not reach the drive");
}

#[test]
fn reserved_gaps_quantities_and_ranges() {
    let mut mdrive = Mdrive::new(PLUS);
    assert_eq!(mdrive.ask(&[3, 0, 0x06, 0, 4]), [3, 8, 0, 0, 0, 0, 0, 0, 0, 1]);
    for (why, pdu, exception) in [
        ("0x0A is reserved", &[3, 0, 0x08, 0, 3][..], 2),
        ("five registers", &[3, 0, 0x05, 0, 5], 3),
        ("none", &[3, 0, 0x05, 0, 0], 3),
        ("five registers", &[16, 0, 0x4B, 0, 5, 10, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0], 3),
        ("0x4A can only be read", &[16, 0, 0x4A, 0, 2, 4, 0, 0, 0, 0], 2),
        ("EF can only be read", &[16, 0, 0x1F, 0, 1, 2, 0, 0], 2),
        ("CE is 0 or 1 of all 16 bits", &[16, 0, 0x09, 0, 1, 2, 1, 0], 3),
        ("MS has no 3", &[16, 0, 0x48, 0, 1, 2, 0, 3], 3),
    ] {
        assert_eq!(mdrive.refusal(pdu), exception, "{why}");
    }
    let ms = &Reg::TABLE.rows[Reg::MS.row()];
    assert!(matches!(ms.legal, Legal::OneOf(codes) if codes.contains(&256)));
    assert_eq!(mdrive.refusal(&[16, 0, 0x76, 0, 1, 2, 0x12, 0x34]), 0, "any value saves");
    assert_eq!(mdrive.written, [Reg::S]);
}

#[test]
fn reading_the_error_clears_it() {
    let mut mdrive = Mdrive::new(PLUS);
    assert_eq!(mdrive.refusal(&[16, 0, 0x09, 0, 1, 2, 0, 2]), 3);
    assert_eq!(mdrive.ask(&[3, 0, 0x1F, 0, 1]), [3, 2, 0, 1]);
    assert_eq!(mdrive.refusal(&[3, 0, 0x20, 0, 2]), 2, "what is refused reads nothing");
    assert_eq!(mdrive.ask(&[3, 0, 0x21, 0, 1]), [3, 2, 0, 21]);
    assert_eq!(mdrive.ask(&[3, 0, 0x21, 0, 1]), [3, 2, 0, 0]);
    assert_eq!(mdrive.ask(&[3, 0, 0x1F, 0, 1]), [3, 2, 0, 0]);
}

#[test]
fn a_word_in_two_registers_sits_in_the_second() {
    let mut hybrid = Mdrive::new(HYBRID);
    assert_eq!(hybrid.ask(&[3, 0, 0x9C, 0, 2]), [3, 4, 0, 0, 0x07, 0xD0]);
    assert_eq!(hybrid.refusal(&[16, 0, 0x9C, 0, 2, 4, 0, 0, 0xFF, 0xFF]), 0);
    assert_eq!(hybrid.bank.get(Reg::LT), 65_535);
    assert_eq!(hybrid.refusal(&[16, 0, 0x9C, 0, 2, 4, 0, 1, 0, 0]), 3);
    assert_eq!(hybrid.refusal(&[16, 0, 0x9C, 0, 2, 4, 0, 0, 0, 1]), 3);
}

#[test]
fn a_variant_has_its_own_registers() {
    const CM: [&[u8]; 2] = [&[3, 0, 0x0B, 0, 1], &[16, 0, 0x0B, 0, 1, 2, 0, 1]];
    const LT: [&[u8]; 2] = [&[3, 0, 0x9C, 0, 2], &[16, 0, 0x9C, 0, 2, 4, 0, 0, 0x07, 0xD0]];
    for (variant, has, lacks, written) in [(PLUS, CM, LT, Reg::CM), (HYBRID, LT, CM, Reg::LT)] {
        let mut mdrive = Mdrive::new(variant);
        assert_eq!(has.map(|pdu| mdrive.refusal(pdu)), [0, 0]);
        assert_eq!(lacks.map(|pdu| mdrive.refusal(pdu)), [2, 2]);
        assert_eq!(mdrive.written, [written]);
    }
}

#[test]
fn a_variable_is_there_once_a_program_has_declared_it() {
    let mut mdrive = Mdrive::new(PLUS);
    const ONE: [&[u8]; 3] =
        [&[3, 0, 0xA8, 0, 2], &[3, 0, 0xA9, 0, 1], &[16, 0, 0xA8, 0, 2, 4, 0, 0, 0x13, 0x8A]];
    const BOTH: [&[u8]; 2] = [&[3, 0, 0xA8, 0, 4], &[16, 0, 0xA8, 0, 4, 8, 0, 0, 0, 1, 0, 0, 0, 2]];
    assert_eq!(ONE.map(|pdu| mdrive.refusal(pdu)), [2, 2, 2]);
    mdrive.declared = 1;
    assert_eq!(ONE.map(|pdu| mdrive.refusal(pdu)), [0, 0, 0]);
    assert_eq!(BOTH.map(|pdu| mdrive.refusal(pdu)), [2, 2], "V2 is not");
    assert_eq!(mdrive.ask(&[3, 0, 0xA8, 0, 2]), [3, 4, 0, 0, 0x13, 0x8A]);
    mdrive.declared = 2;
    assert_eq!(BOTH.map(|pdu| mdrive.refusal(pdu)), [0, 0]);
    assert_eq!(mdrive.written, [Reg::V1, Reg::V1, Reg::V2]);
    mdrive.declared = 0;
    assert_eq!(mdrive.refusal(&[3, 0, 0xA8, 0, 2]), 2);
}

#[test]
fn values_are_judged_on_their_outcome() {
    let mut mdrive = Mdrive::new(PLUS);
    let both =
        |vi: u32, vm: u32| [&[16, 0, 0x89, 0, 4, 8][..], &vi.to_be_bytes(), &vm.to_be_bytes()].concat();
    let one = |address, value: u32| [&[16, 0, address, 0, 2, 4][..], &value.to_be_bytes()].concat();
    // Alone each value would be refused because of the stored other one. Together they are valid, upwards and
    // downwards.
    for (vi, vm) in [(800_000, 900_000), (10, 20)] {
        assert_eq!(mdrive.refusal(&both(vi, vm)), 0);
        assert_eq!((mdrive.bank.get(Reg::VI), mdrive.bank.get(Reg::VM)), (vi.into(), vm.into()));
    }
    assert_eq!(mdrive.written, [Reg::VI, Reg::VM, Reg::VI, Reg::VM]);
    for (pdu, error) in [(both(30, 30), 22), (one(0x89, 20), 22), (one(0x8B, 10), 23), (both(0, 30), 21)] {
        assert_eq!((mdrive.refusal(&pdu), mdrive.error), (3, error), "{pdu:?}");
    }
    assert_eq!((mdrive.bank.get(Reg::VI), mdrive.bank.get(Reg::VM)), (10, 20), "nothing is stored");
    assert_eq!(mdrive.written.len(), 4);
    mdrive.moving = true;
    assert_eq!((mdrive.refusal(&one(0x43, 5)), mdrive.error), (4, 85), "what its state forbids");
}

#[test]
fn functions_of_the_drive() {
    let mut mdrive = Mdrive::new(PLUS);
    let mut reply = vec![43, 14, 4, 0x82, 0, 0, 1, 2, 7];
    reply.extend(b"4.0.0.0");
    assert_eq!(mdrive.ask(&[43, 14, 4, 2]), reply);
    assert_eq!(mdrive.ask(&[43, 14, 4, 5]), [0xAB, 2]);
    assert_eq!(mdrive.ask(&[65, 0x20, 0x20, 0x20, 0x45]), [65, 0]);
    assert_eq!(
        mdrive.ask(&[66, 0x20, 0x20, 0x20, 0x45]),
        [0xC2, 2],
        "what it put into the reply does not count"
    );
}

#[test]
fn a_row_is_found_in_every_space_that_it_is_in() {
    let at = |space, address| Reg::TABLE.at(space, address).map(|(row, _)| Reg::from_row(row).unwrap());
    assert_eq!((at(Space::Holding, 0x2E), at(Space::Discrete, 0x2E)), (Some(Reg::I2), Some(Reg::I2)));
    assert_eq!((at(Space::Coil, 0x2E), at(Space::Coil, 0x4E)), (None, Some(Reg::O4)));
}

proptest! {
    #[test]
    fn every_adu_is_answered(
        variant in 1_u8..=2,
        pdu in prop::collection::vec(prop_oneof![3 => 0_u8..20, 2 => 0x20_u8..0xB8, 1 => any::<u8>()], 1..30),
    ) {
        let mut mdrive = Mdrive::new(variant);
        let reply = mdrive.ask(&pdu);
        let answers = reply[0] == pdu[0] || reply[0] == pdu[0] | 0x80 && matches!(reply[..], [_, 1..=4]);
        prop_assert!(answers, "{:?} to {:?}", reply, pdu);
    }
}

#[test]
fn of_any_words_those_rows_are_live_or_optional_that_a_search_of_all_finds() {
    let entries = Reg::ENTRIES;
    for start in 0..=Reg::WORDS {
        for end in start..=Reg::WORDS {
            let touched = |row: &usize| {
                let (place, words) = (entries.offset(*row), usize::from(entries.list[*row].shape.words()));
                place < end && start < place + words
            };
            let all = || (0..entries.list.len()).filter(touched);
            let live = all().filter(|&row| entries.list[row].live);
            assert!(entries.live_rows_at(&(start..end)).eq(live), "{start}..{end}");
            let conditional = all().filter(|&row| entries.list[row].is_conditional());
            assert!(entries.conditional_rows_at(&(start..end)).eq(conditional), "{start}..{end}");
        }
    }
}
