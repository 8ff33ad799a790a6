//! The register map (FB 5, 5.1, 5.2), typed by hand.

use crate::rig::{KINDS, Kind};

/// Access to a register.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Access {
    /// Readable and writable. A save keeps the value over a power failure (MC 5-62).
    Kept,
    /// Readable and writable, but not saved.
    Passing,
    /// A status, read-only.
    ReadOnly,
    /// A command: a write starts an action.
    Command,
    /// A user variable, which exists after a program has declared it (FB 5.2).
    User,
}

/// The values that are legal.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Legal {
    /// First and last legal value.
    Range(i64, i64),
    Of(&'static [i64]),
}

pub(crate) struct Row {
    pub(crate) name: &'static str,
    pub(crate) address: u16,
    pub(crate) bytes: u8,
    /// Number of registers, one or two. LT has two registers for its two bytes.
    pub(crate) count: u16,
    pub(crate) legal: Legal,
    /// Value in a new drive at rest; `None` if another test checks it.
    pub(crate) default: Option<i64>,
    pub(crate) access: Access,
    /// The product that has the register, or `None` for both.
    pub(crate) only: Option<Kind>,
}

use Access::{Command, Kept, Passing, ReadOnly, User};
use Legal::{Of, Range};

const BIT: Legal = Range(0, 1);
const BYTE: Legal = Range(0, 255);
const LONG: Legal = Range(i32::MIN as i64, i32::MAX as i64);
const RATE: Legal = Range(91, 1_525_878_997);
const STEPS: Legal = Range(0, 2_147_483_647);
const MICROSTEPS: &[i64] =
    &[1, 2, 4, 5, 8, 10, 16, 25, 32, 50, 64, 100, 125, 128, 200, 250, 256, 180, 108, 127];

const fn row(name: &'static str, address: u16, bytes: u8, legal: Legal, default: i64, access: Access) -> Row {
    let count = if bytes == 4 { 2 } else { 1 };
    Row { name, address, bytes, count, legal, default: Some(default), access, only: None }
}

impl Row {
    const fn plus(self) -> Self {
        Self { only: Some(Kind::Plus), ..self }
    }

    const fn hybrid(self) -> Self {
        Self { only: Some(Kind::Hybrid), ..self }
    }

    const fn two(self) -> Self {
        Self { count: 2, ..self }
    }

    const fn unknown(self) -> Self {
        Self { default: None, ..self }
    }

    pub(crate) fn is_on(&self, kind: Kind) -> bool {
        self.only.is_none_or(|only| only == kind)
    }

    /// Register contents of a value. One byte is the low byte of its word, two bytes are the last of its
    /// words, four bytes start with the high word.
    pub(crate) fn words(&self, value: i64) -> Vec<u16> {
        if self.count == 2 { vec![(value >> 16) as u16, value as u16] } else { vec![value as u16] }
    }

    /// Values at the limits of the legal range.
    pub(crate) fn samples(&self) -> Vec<i64> {
        match self.legal {
            Range(least, most) if least == most => vec![least],
            Range(least, most) => vec![least, least + 1, most - 1, most],
            Of(values) => values.to_vec(),
        }
    }

    /// Illegal values that fit into the registers.
    pub(crate) fn others(&self) -> Vec<i64> {
        let (least, most) = match self.legal {
            Range(least, most) => (least, most),
            Of(_) => return vec![0, 3, 6, 257, 0xFFFF],
        };
        let holds = if self.bytes == 4 { (i32::MIN.into(), i32::MAX.into()) } else { (0, 0xFFFF) };
        let outside = [holds.0, least - 1, most + 1, 0x100 | most, holds.1];
        outside
            .into_iter()
            .filter(|&value| (holds.0..=holds.1).contains(&value) && !(least..=most).contains(&value))
            .collect()
    }
}

#[rustfmt::skip]
pub(crate) static TABLE: &[Row] = &[
    row("A",  0x0000, 4, RATE, 1_000_000, Kept),
    row("C1", 0x0005, 4, LONG, 0, Passing),
    row("C2", 0x0007, 4, LONG, 0, Passing),
    row("CE", 0x0009, 1, BIT, 1, Kept),
    row("CM", 0x000B, 1, BIT, 0, Kept).plus(),
    row("D1", 0x000F, 1, BYTE, 0, Kept),
    row("D2", 0x0010, 1, BYTE, 0, Kept),
    row("D3", 0x0011, 1, BYTE, 0, Kept),
    row("D4", 0x0012, 1, BYTE, 0, Kept),
    row("D5", 0x0013, 1, BYTE, 0, Kept),
    row("D",  0x0018, 4, RATE, 1_000_000, Kept),
    row("DB", 0x001A, 2, Range(0, 65_000), 10, Kept).plus(),
    row("DC", 0x001B, 1, BYTE, 0, Command),
    row("DE", 0x001C, 1, BIT, 1, Kept),
    // EE converts A, D, VI and VM, so another test writes it.
    row("EE", 0x001E, 1, BIT, 0, Kept),
    row("EF", 0x001F, 1, BIT, 0, ReadOnly),
    row("ER", 0x0021, 2, Range(0, 0), 0, Passing),
    row("HC", 0x0029, 1, Range(0, 100), 5, Kept),
    row("HM", 0x002B, 1, Range(1, 4), 1, Command),
    // The value 1 is also illegal.
    row("HT", 0x002C, 2, Range(0, 65_535), 500, Kept),
    row("I1", 0x002D, 1, BIT, 0, ReadOnly),
    row("I2", 0x002E, 1, BIT, 0, ReadOnly),
    row("I3", 0x002F, 1, BIT, 0, ReadOnly),
    row("I4", 0x0030, 1, BIT, 0, ReadOnly),
    row("I5", 0x0031, 2, Range(0, 1_023), 0, ReadOnly),
    row("I6", 0x0032, 1, BIT, 0, ReadOnly).unknown().plus(),
    row("IC", 0x0037, 1, BYTE, 0, Command),
    // The inputs are open and sink, so they float high.
    row("IL", 0x003A, 1, Range(0, 15), 15, ReadOnly),
    row("IN", 0x003B, 1, Range(0, 15), 15, ReadOnly),
    row("JE", 0x003F, 1, BIT, 0, Kept),
    row("LM", 0x0042, 1, Range(1, 6), 1, Kept),
    row("MA", 0x0043, 4, LONG, 0, Command),
    row("MP", 0x0045, 1, BIT, 0, ReadOnly),
    row("MR", 0x0046, 4, LONG, 0, Command),
    row("MS", 0x0048, 2, Of(MICROSTEPS), 256, Kept),
    // The upper limit holds with HT 500.
    row("MT", 0x0049, 2, Range(0, 65_000), 0, Kept),
    row("MV", 0x004A, 1, BIT, 0, ReadOnly),
    // These points are not outputs until S1 to S4 configure them.
    row("O1", 0x004B, 1, BIT, 0, Command).unknown(),
    row("O2", 0x004C, 1, BIT, 0, Command).unknown(),
    row("O3", 0x004D, 1, BIT, 0, Command).unknown(),
    row("O4", 0x004E, 1, BIT, 0, Command).unknown(),
    row("OL", 0x0055, 1, Range(0, 15), 0, Command),
    row("OT", 0x0056, 1, Range(0, 15), 0, Command),
    row("P",  0x0057, 4, LONG, 0, Passing),
    row("PC", 0x0059, 4, LONG, 0, ReadOnly),
    row("PM", 0x005C, 1, BIT, 0, Kept).plus(),
    row("R1", 0x005F, 4, LONG, 0, Kept),
    row("R2", 0x0061, 4, LONG, 0, Kept),
    row("R3", 0x0063, 4, LONG, 0, Kept),
    row("R4", 0x0065, 4, LONG, 0, Kept),
    row("RC", 0x0067, 1, Range(1, 100), 25, Kept),
    row("S",  0x0076, 1, BYTE, 0, Command),
    row("SF", 0x0077, 2, Range(0, 65_000), 15, Kept).plus(),
    row("SL", 0x0078, 4, Range(-5_000_000, 5_000_000), 0, Command),
    row("SM", 0x007A, 1, BIT, 0, Kept).plus(),
    row("ST", 0x007B, 1, BIT, 0, Passing).plus(),
    // Another test checks which trips exist.
    row("TE", 0x007D, 1, Range(0, 43), 0, Command),
    row("V",  0x0085, 4, LONG, 0, ReadOnly),
    row("VC", 0x0088, 1, BIT, 0, ReadOnly),
    row("VI", 0x0089, 4, Range(1, 767_999), 1_000, Kept),
    row("VM", 0x008B, 4, Range(1_001, 5_000_000), 768_000, Kept),

    row("AS", 0x008E, 1, Range(0, 3), 2, Kept).hybrid(),
    row("AF", 0x008F, 1, BYTE, 0, ReadOnly).unknown().hybrid(),
    row("CA", 0x0090, 1, BIT, 1, Kept).hybrid(),
    row("CB", 0x0091, 1, Range(0, 3), 1, Kept).hybrid(),
    row("CC", 0x0092, 1, Range(1, 100), 100, Kept).hybrid(),
    row("CF", 0x0093, 1, BYTE, 0, Command).hybrid(),
    row("CT", 0x0094, 2, Range(2, 65_535), 200, Kept).hybrid(),
    row("LD", 0x0095, 4, STEPS, 102_400, Kept).hybrid(),
    row("LG", 0x0097, 4, STEPS, 102_400, Kept).hybrid(),
    row("LL", 0x0099, 4, LONG, 0, ReadOnly).hybrid(),
    row("LR", 0x009B, 1, BIT, 0, ReadOnly).hybrid(),
    row("LT", 0x009C, 2, Range(2, 65_535), 2_000, Kept).two().hybrid(),
    row("MF", 0x009E, 4, Range(306, 5_000_000), 768_000, Kept).hybrid(),
    row("MU", 0x00A0, 1, Range(0, 2), 0, Kept).hybrid(),
    row("SC", 0x00A1, 1, BYTE, 0, Command).hybrid(),
    row("SS", 0x00A2, 1, BYTE, 0, Kept).hybrid(),
    row("TD", 0x00A5, 1, BIT, 1, Kept).hybrid(),
    row("TQ", 0x00A6, 1, Range(1, 100), 25, Kept).hybrid(),
    row("TS", 0x00A7, 1, BYTE, 0, Kept).hybrid(),

    row("V1", 0x00A8, 4, LONG, 0, User),
    row("V2", 0x00AA, 4, LONG, 0, User),
    row("V3", 0x00AC, 4, LONG, 0, User),
    row("V4", 0x00AE, 4, LONG, 0, User),
    row("V5", 0x00B0, 4, LONG, 0, User),
    row("V6", 0x00B2, 4, LONG, 0, User),
    row("V7", 0x00B4, 4, LONG, 0, User),
    row("V8", 0x00B6, 4, LONG, 0, User),
];

/// Addresses that FB calls reserved: first and last of each range.
pub(crate) const RESERVED: &[(u16, u16)] = &[
    (0x0002, 0x0004),
    (0x000A, 0x000A),
    (0x000C, 0x000E),
    (0x0014, 0x0017),
    (0x001D, 0x001D),
    (0x0020, 0x0020),
    (0x0022, 0x0028),
    (0x002A, 0x002A),
    (0x0033, 0x0036),
    (0x0038, 0x0039),
    (0x003C, 0x003E),
    (0x0040, 0x0041),
    (0x004F, 0x0054),
    (0x005B, 0x005B),
    (0x005D, 0x005E),
    (0x0068, 0x0075),
    (0x007C, 0x007C),
    (0x007E, 0x0084),
    (0x0087, 0x0087),
    (0x008D, 0x008D),
    (0x00A3, 0x00A4),
];

/// Finds a row by its mnemonic.
pub(crate) fn find(name: &str) -> &'static Row {
    TABLE.iter().find(|row| row.name == name).expect("a row")
}

/// The rows and the reserved addresses together cover the whole map without a gap or an overlap.
#[test]
fn the_table_is_the_whole_map() {
    let rows = TABLE.iter().map(|row| (row.address, row.address + row.count - 1));
    let mut all: Vec<(u16, u16)> = rows.chain(RESERVED.iter().copied()).collect();
    all.sort_unstable();
    let mut next = 0;
    for (first, last) in all {
        assert_eq!(first, next, "after {next:#06X}");
        next = last + 1;
    }
    assert_eq!(next, 0x00B8);
    // FB 5 has 61 rows, seven of them only for the MDrivePlus; FB 5.1 has 19 for the Hybrid, FB 5.2 has 8 for
    // the user.
    let rows = KINDS.map(|kind| TABLE.iter().filter(|row| row.is_on(kind)).count());
    assert_eq!(rows, [61 + 8, 61 - 7 + 19 + 8]);
}
