//! Facts that clients know about the drives: registers that are safe to write and how they are saved, typed
//! from the manuals; and the messages of clients that misbehave.

use drivetwin_firmware::device::Spec;
use drivetwin_protocol::modbus::tcp::{self, Header};
use drivetwin_protocol::modbus::{ascii, rtu};
use drivetwin_protocol::registers::{Legal, Row, Space};
use drivetwin_protocol::time::{Duration, Span};
use fastrand::Rng;

/// Drives of one manual.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Family {
    Md3,
    Qsb,
    Rs434,
    Mdrobot,
    Mdrive,
}

/// Registers that a master may write at any time. Their values have no effect without a further write, and
/// are read back as they were written.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Block {
    /// Address of the first register; for a QSB an index into [`QSB`].
    pub(crate) first: u16,
    pub(crate) count: u16,
}

impl Block {
    /// Returns true if a register is in the block.
    pub(crate) fn contains(self, address: u16) -> bool {
        (self.first..self.first + self.count).contains(&address)
    }

    /// Returns the CRC of the first six bytes of a write of this block, if the low byte of that CRC is equal
    /// to the next byte, the number of data bytes. If the first data byte is equal to the high byte, too, the
    /// first eight bytes of the request are a valid frame: the shorter reply of the same function.
    pub(crate) fn treacherous(self, address: u8) -> Option<[u8; 2]> {
        let ([a, b], [c, d]) = (self.first.to_be_bytes(), self.count.to_be_bytes());
        let sum = rtu::crc(&[address, 16, a, b, c, d]).to_le_bytes();
        (u16::from(sum[0]) == 2 * self.count).then_some(sum)
    }
}

/// Harmless registers of a QSB, DTR and THRESHOLD, with the largest value of each.
pub(crate) const QSB: [(u16, u32); 2] = [(0x08, u32::MAX), (0x0B, 0xFFFF)];

impl Family {
    pub(crate) fn of(kind: &str) -> Self {
        match kind {
            "md3" | "md3-low" => Self::Md3,
            "qsb-d" | "qsb-m" | "qsb-s" => Self::Qsb,
            "rs434544" | "rs434546" => Self::Rs434,
            "mdrobot" => Self::Mdrobot,
            "mdrive" | "mdrive-hybrid" => Self::Mdrive,
            other => panic!("swarm: dialect.rs has no kind {other}"),
        }
    }

    /// Blocks of harmless registers. The first block is saved, all of it at once.
    pub(crate) fn blocks(self) -> Vec<Block> {
        let block = |first, count| Block { first, count };
        match self {
            // PreHomeOffset and HomeOffset (7.6, 7.7), UserRegister (7.23).
            Self::Md3 => vec![block(0x05, 4), block(0x07, 2), block(0x1D, 1)],
            Self::Qsb => vec![block(0, 2)],
            // TARGET_POSITION1 to 3 (6.5), or a part of them.
            Self::Rs434 => {
                let parts = |count| (0x501B..=0x5021 - count).map(move |first| block(first, count));
                (1..=6).rev().flat_map(parts).collect()
            }
            // FUNC_POSI (p. 17), FUNC_SPEED (p. 16).
            Self::Mdrobot => vec![block(250, 2), block(239, 2)],
            // R1 to R4 (FB 5).
            Self::Mdrive => vec![block(0x5F, 8), block(0x61, 4), block(0x65, 2)],
        }
    }

    /// Most words that one request writes. An MDrive takes one variable (FB 4.2).
    pub(crate) fn words_at_once(self) -> usize {
        match self {
            Self::Md3 => 1,
            Self::Mdrive => 2,
            Self::Qsb | Self::Rs434 | Self::Mdrobot => usize::MAX,
        }
    }

    /// Functions that write a single word. An MD3 has only 6 (6.2), an MDrive only 16 (FB 4).
    pub(crate) fn writes_a_word(self) -> &'static [u8] {
        match self {
            Self::Md3 => &[6],
            Self::Mdrive => &[16],
            Self::Qsb | Self::Rs434 | Self::Mdrobot => &[6, 16],
        }
    }

    /// Factory values of the first block, if a power failure during a save may bring them back. An MDROBOT
    /// keeps two copies (MDROBOT-6), so it never loses the saved values.
    pub(crate) fn factory(self) -> Option<&'static [u32]> {
        match self {
            Self::Md3 => Some(&[0; 4]),
            Self::Qsb => Some(&[499, 0]),
            Self::Rs434 => Some(&[0; 6]),
            Self::Mdrobot => None,
            Self::Mdrive => Some(&[0; 8]),
        }
    }

    /// The register and the value that start a save. `None` if every write is saved at once, or if saving is
    /// a command.
    pub(crate) fn save(self) -> Option<(u16, u16)> {
        match self {
            // EEPROMControl: write to EEPROM (7.20).
            Self::Md3 => Some((0x1A, 1)),
            // FLAG_SAVE_INI (6.5).
            Self::Rs434 => Some((0x5024, 0x37FA)),
            // S (FB 5).
            Self::Mdrive => Some((0x76, 1)),
            Self::Qsb | Self::Mdrobot => None,
        }
    }

    /// Returns true if a drive saves each value that is written (MDROBOT-6).
    pub(crate) fn saves_each_write(self) -> bool {
        self == Self::Mdrobot
    }

    /// The register of the position that the drive counts: the function that reads it, its address, and its
    /// words. It is 0 after power-on: MD3 7.14, where no value is saved; RS434-9; MDROBOT-6; MC 5-13. A QSB has its
    /// own command.
    pub(crate) fn position(self) -> Option<(u8, Block)> {
        let at = |function, first, count| Some((function, Block { first, count }));
        match self {
            Self::Md3 => at(3, 0x10, 1),
            Self::Rs434 => at(4, 0x3003, 2),
            Self::Mdrobot => at(3, 197, 2),
            Self::Mdrive => at(3, 0x05, 2),
            Self::Qsb => None,
        }
    }

    /// Returns true if a register may keep a drive from saving: a Hybrid in torque mode (AS) does not save.
    pub(crate) fn keeps_from_saving(self, address: u16) -> bool {
        self == Self::Mdrive && address == 0x8E
    }

    /// Returns true if the register table alone does not say which values of a register a drive takes. An
    /// MDrive compares VI with VM, HT with MT, and JE with CM. It refuses some values of EE and MS while it
    /// moves or its loop is closed (MC 5). With EE the ranges of A and D are in counts. Of FUNC_CMD_TYPE an
    /// MDROBOT stores only the low byte (MDROBOT-3). Of MODE and MDR1 a QSB stores only some bits (QSB-9), and
    /// EOR changes the format of its answers.
    pub(crate) fn has_other_rules(self, address: u16) -> bool {
        match self {
            Self::Mdrive => {
                matches!(address, 0x00 | 0x0B | 0x18 | 0x1E | 0x2C | 0x3F | 0x48 | 0x49 | 0x89 | 0x8B)
            }
            Self::Mdrobot => address == 183,
            Self::Qsb => matches!(address, 0x00 | 0x04 | 0x15),
            Self::Md3 | Self::Rs434 => false,
        }
    }

    /// Returns true if a drive changes a saved register without a write. An MD3 changes `IOPortData` with its
    /// pins (7.9), and the sign of `MoveSteps` when it moves to and fro (7.8). DIG I/O of a QSB reads the
    /// levels of pins. Inputs set DIRECTION of an RS drive (6.5). A Hybrid sets MU to 0 while its bridge is off
    /// (MC 5-50).
    pub(crate) fn changes_by_itself(self, address: u16) -> bool {
        match self {
            Self::Md3 => matches!(address, 0x0A | 0x12),
            Self::Qsb => address == 0x01,
            Self::Rs434 => address == 0x500E,
            Self::Mdrive => address == 0xA0,
            Self::Mdrobot => false,
        }
    }

    /// Returns true if a drive changes a saved register when an input changes. IN1 of an RS drive starts its motor,
    /// which copies OFFSET_CONST to OFFSET (RS 5015h, 5017h) or the selected position to TARGET_POSITION (RS 5019h).
    pub(crate) fn changes_by_inputs(self, name: &str) -> bool {
        self == Self::Rs434 && matches!(name, "OFFSET" | "TARGET_POSITION")
    }

    /// Exception code of a drive that does not save because an input moves it: an MDrive in motion (MC error 73).
    pub(crate) fn refuses_to_save(self) -> Option<u8> {
        (self == Self::Mdrive).then_some(4)
    }

    /// A time longer than from power-on to the drive's first answer: MD3 4, RS434-9, MDROBOT-11, QSB-6. A
    /// Hybrid calibrates for 3.12 s (MC 5-9).
    pub(crate) fn boot(self) -> Duration {
        match self {
            // With a bad memory an MD3 takes 5 s longer (MD3 7.4, MD3-13).
            Self::Md3 => 7_600.millis(),
            Self::Qsb => 100.millis(),
            Self::Rs434 => 1.secs(),
            Self::Mdrobot => 400.millis(),
            Self::Mdrive => 4.secs(),
        }
    }
}

/// Registers that set how a master reaches a drive, that take a drive off its line for long, or that start a
/// user program, which may write any register. The list has those of all families, because a broadcast
/// reaches every drive.
const IDENTITY: [u16; 12] = [
    // MD3: DeviceAddress, StartupDelay, SerialPortConfiguration.
    0x00, 0x03, 0x1C, //
    // MDROBOT: ID, BAUDRATE.
    133, 135, //
    // RS: address, type, bit rate, delay of replies, MODE_USER_PROGRAM, FLAG_SAVE_USER_PROGRAM.
    0x5000, 0x5001, 0x5002, 0x5003, 0x5005, 0x5025, //
    // MDrive: S. What is saved in torque mode can never be saved again.
    0x76,
];

/// Returns true if misbehaving clients and direct presets must not write a register.
pub(crate) fn is_identity(address: u16) -> bool {
    IDENTITY.contains(&address)
}

/// Rows that may be preset, and their indices in the table: registers on the bus that do not make a
/// drive unreachable.
pub(crate) fn settable(spec: &'static Spec) -> impl Iterator<Item = (usize, &'static Row)> {
    let on_bus = |row: &Row| !matches!(row.space, Space::Variable | Space::Setting);
    spec.rows().filter(move |(_, row)| on_bus(row) && !is_identity(row.address))
}

/// Words at the edges of bytes and of signed and unsigned numbers. The low byte of 0x00FF is equal to a byte
/// of an erased memory.
const EDGES: [u16; 7] = [0, 1, 0x00FF, 0xFF00, 0x7FFF, 0x8000, 0xFFFF];

/// A random word; one in four is an [edge](EDGES).
pub(crate) fn any_word(rng: &mut Rng) -> u16 {
    if rng.u8(..4) == 0 { one_of(rng, &EDGES) } else { rng.u16(..) }
}

/// A random value for a register. One in four is an edge: one of [`EDGES`], or the least or the greatest
/// value of the row. The others are often small. A drive may refuse the value.
pub(crate) fn any_value(row: &Row, rng: &mut Rng) -> i64 {
    if rng.u8(..4) == 0 {
        let (least, greatest) = match row.legal {
            Legal::Range(least, greatest) => (least, greatest),
            _ => row.shape.limits(),
        };
        return match rng.usize(..EDGES.len() + 2) {
            0 => least,
            1 => greatest,
            edge => EDGES[edge - 2].into(),
        };
    }
    if rng.bool() { rng.i64(0..4) } else { i64::from(rng.i32(..)) >> rng.u8(..32) }
}

/// Picks one of several.
pub(crate) fn one_of<T: Copy>(rng: &mut Rng, of: &[T]) -> T {
    of[rng.usize(..of.len())]
}

/// A PDU of a misbehaving client: valid, invalid or nearly valid.
fn pdu(family: Family, rng: &mut Rng) -> Vec<u8> {
    let (from, to) = match family {
        Family::Md3 | Family::Qsb => (0, 0x22),
        Family::Rs434 => {
            one_of(rng, &[(0x1000, 0x1004), (0x2000, 0x2005), (0x5003, 0x5028), (0x6000, 0x6007)])
        }
        Family::Mdrobot => (1, 251),
        Family::Mdrive => (0, 0xB8),
    };
    let first = if rng.u8(..10) == 0 { rng.u16(0xFFF0..) } else { rng.u16(from..to) };
    let count =
        if rng.u8(..6) == 0 { one_of(rng, &[0x7F, 0x800, 0x7FFF, 0x8000, 0xFFFF]) } else { rng.u16(0..12) };
    let value = if rng.bool() { rng.u16(..4) } else { any_word(rng) };
    let words = |function: u8, words: &[u16]| {
        std::iter::once(function).chain(words.iter().flat_map(|word| word.to_be_bytes())).collect::<Vec<u8>>()
    };
    let touched = |count: u16| (first..first.saturating_add(count)).any(is_identity);
    match rng.u8(..10) {
        0..3 => words(rng.u8(1..5), &[first, count]),
        3..6 if !touched(1) => words(6, &[first, value]),
        6..8 => {
            let count = rng.u16(0..9);
            if touched(count.max(1)) {
                return words(3, &[first, count]);
            }
            let mut pdu = words(16, &[first, count]);
            let bytes = if rng.u8(..8) == 0 { rng.u8(..20) } else { 2 * count as u8 };
            pdu.push(bytes);
            pdu.extend((0..bytes).map(|_| if rng.bool() { 0 } else { rng.u8(..) }));
            pdu
        }
        8 => words(5, &[0x2000 + rng.u16(..5), if rng.bool() { 0xFF00 } else { 0 }]),
        _ => {
            let function = one_of(rng, &[7_u8, 8, 11, 15, 17, 20, 22, 23, 24, 43, 65, 66, 100, 0x83, 0]);
            (0..rng.u8(1..9)).fold(vec![function], |mut pdu, _| {
                pdu.push(rng.u8(..));
                pdu
            })
        }
    }
}

/// A message that is damaged in one of several ways, or unchanged.
fn spoiled(mut bytes: Vec<u8>, rng: &mut Rng) -> Vec<u8> {
    match rng.u8(..12) {
        0 => {
            let place = rng.usize(..bytes.len().max(1));
            if let Some(byte) = bytes.get_mut(place) {
                *byte ^= 1 << rng.u8(..8);
            }
        }
        1 => bytes.truncate(rng.usize(..=bytes.len())),
        2 => bytes.extend((0..rng.u8(1..10)).map(|_| rng.u8(..))),
        3 => bytes = bytes.repeat(rng.usize(2..5)),
        4 => bytes = (0..rng.usize(1..300)).map(|_| rng.u8(..)).collect(),
        _ => {}
    }
    bytes
}

/// A message of a misbehaving client on a Modbus line.
pub(crate) fn modbus_mischief(family: Family, address: u8, ascii: bool, rng: &mut Rng) -> Vec<u8> {
    let unit = match rng.u8(..10) {
        0 => 0,
        1 => 0xFE,
        2 => rng.u8(..),
        _ => address,
    };
    let pdu = pdu(family, rng);
    let message = if ascii { ascii::frame(unit, &pdu).to_vec() } else { rtu::frame(unit, &pdu).to_vec() };
    spoiled(message, rng)
}

/// A message of a misbehaving client on a Modbus/TCP connection.
pub(crate) fn tcp_mischief(rng: &mut Rng) -> Vec<u8> {
    let header = Header { transaction: rng.u16(..), unit: rng.u8(..) };
    let message = tcp::frame(header, &pdu(Family::Mdrive, rng)).to_vec();
    spoiled(message, rng)
}

/// Lines of MCode that do not change how the port talks: no EM, ES, PY, S.
const MCODE: [&str; 40] = [
    "PR P\r",
    "PR R2,\" \",V\r",
    "MR 1000\r",
    "MA -500\r",
    "SL 2000\r",
    "SL 0\r",
    "P=0\r",
    "VM=50000\r",
    "A=91\r",
    "A=5\r",
    "R1=R1+1\r",
    "R2=7\r",
    "MS=8\r",
    "PR AL\r",
    "PR ER\r",
    "ER=0\r",
    "HM 1\r",
    "HI 2\r",
    "S1=1,0,0\r",
    "S2=16,1,1\r",
    "VA Q5=12\r",
    "PG 100\r",
    "LB AA\r",
    "R3=R3+1\r",
    "PR R3\r",
    "H 10\r",
    "BR AA,R3<5\r",
    "E\r",
    "PG\r",
    "EX 100\r",
    "CP\r",
    "L\r",
    "\x1b",
    "\x03",
    "\x08\x08PR P",
    "\r\r",
    "X\r",
    "TI 1,AA\r",
    "O1=1\r",
    "TE=1\r",
];

/// Text of a misbehaving client on an MCode port.
pub(crate) fn mcode_mischief(rng: &mut Rng) -> Vec<u8> {
    let lines = (0..rng.u8(1..6)).map(|_| one_of(rng, &MCODE));
    let text = lines.collect::<String>().into_bytes();
    // Noise has no letters, because letters might set EM.
    match rng.u8(..8) {
        0 => text[..rng.usize(..=text.len())].to_vec(),
        1 => (0..rng.usize(1..300)).map(|_| one_of(rng, b"0123456789 =,.\"'*/\r\n\x08")).collect(),
        _ => text,
    }
}

/// Commands of a QSB that do not change its baud rate.
const ORDERS: [&str; 30] = [
    "W0C0\r",
    "W0C1\r",
    "W0CFFFF\r",
    "W0B3\r",
    "S0E\r",
    "S01\r",
    "S05\r",
    "S06\r",
    "S13\r",
    "W15F\r",
    "W154\r",
    "W161\r",
    "W162\r",
    "W160\r",
    "W168\r",
    "W169\r",
    "W164\r",
    "W165\r",
    "W0F3E8\r",
    "W1140\r",
    "W12FFFFFF00\r",
    "W0001\r",
    "W0002\r",
    "W02F0\r",
    "W02100F\r",
    "W021100\r",
    "W040F0\r",
    "R0E\r",
    "R14\r",
    "W167\r",
];

/// Commands of a misbehaving client to a QSB.
pub(crate) fn qsb_mischief(rng: &mut Rng) -> Vec<u8> {
    let text = (0..rng.u8(1..5)).map(|_| match rng.u8(..4) {
        0 => format!("{}{:02X}{:X}\r", one_of(rng, b"RSQr") as char, rng.u8(..0x18), rng.u32(..)),
        1 => format!("W{:02X}{:X}\r\n", rng.u8(..0x16), rng.u16(..)),
        _ => one_of(rng, &ORDERS).to_owned(),
    });
    spoiled(text.collect::<String>().into_bytes(), rng)
}
