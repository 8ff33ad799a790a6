//! Table of all names, merged and sorted at compile time: those of the table of variables, and those that
//! have no row there.
#![expect(clippy::indexing_slicing, reason = "only ever evaluated by the compiler")]

use super::super::super::registers::{HYBRID, ROWS};
use super::super::operand::Trip;
use super::{Instruction, Keyword, SERIAL, Word};

#[rustfmt::skip]
const INSTRUCTIONS: &[Item] = &[
    does(b"BP", Instruction::BP), does(b"BR", Instruction::BR), does(b"CF", Instruction::CF),
    does(b"CL", Instruction::CL), does(b"CP", Instruction::CP), does(b"DC", Instruction::DC),
    does(b"E", Instruction::E), does(b"EX", Instruction::EX), does(b"FD", Instruction::FD),
    does(b"H", Instruction::H), does(b"HI", Instruction::HI), does(b"HM", Instruction::HM),
    does(b"IC", Instruction::IC), does(b"IP", Instruction::IP), does(b"IV", Instruction::IV),
    does(b"L", Instruction::L), does(b"LB", Instruction::LB), does(b"MA", Instruction::MA),
    does(b"MR", Instruction::MR), does(b"OE", Instruction::OE), does(b"PG", Instruction::PG),
    does(b"PR", Instruction::PR), does(b"PS", Instruction::PS), does(b"RS", Instruction::RS),
    does(b"RT", Instruction::RT), does(b"S", Instruction::S), does(b"SC", Instruction::SC),
    does(b"SL", Instruction::SL), does(b"VA", Instruction::VA),
];

const TRIPS: &[Item] = &[
    trips(b"TA", Trip::Hybrid),
    trips(b"TC", Trip::Capture),
    trips(b"TI", Trip::Input),
    trips(b"TP", Trip::Position),
    trips(b"TR", Trip::Relative),
    trips(b"TT", Trip::Time),
];

const KEYWORDS: &[Item] = &[
    prints(b"AL", Keyword::AL),
    prints(b"MD", Keyword::MD),
    prints(b"PN", Keyword::PN),
    prints(b"SN", Keyword::SN),
    prints(b"UV", Keyword::UV),
    prints(b"VR", Keyword::VR),
];

/// Commands of drives with a serial port (MC 5-4 to 5-60; MDRIVE-11).
const SERIAL_COMMANDS: &[Word] = &[*b"BD ", *b"CK ", *b"DG ", *b"DN ", *b"PY ", *b"QD "];

/// Names that are not available: reserved names (MC 5-3, 5-27, 5-34, 5-35), I/O points that the models with
/// Ethernet do not have (FB 1.2.1), and the upgrade of the firmware (MC 5-77).
#[rustfmt::skip]
const UNAVAILABLE: &[Item] = &[
    takes(b"AT"), takes(b"FT"), takes(b"I7"), takes(b"I8"), takes(b"I13"), takes(b"D9"), takes(b"D10"),
    takes(b"D11"), takes(b"D12"), takes(b"I9"), takes(b"I10"), takes(b"I11"), takes(b"I12"), takes(b"IH"),
    takes(b"O9"), takes(b"O10"), takes(b"O11"), takes(b"O12"), takes(b"OH"), takes(b"S9"), takes(b"S10"),
    takes(b"S11"), takes(b"S12"), takes(b"UG"),
];

#[derive(Clone, Copy)]
pub(super) struct Item {
    pub(super) word: Word,
    pub(super) class: Class,
    /// Variants of the product that have the name, and [`SERIAL`].
    pub(super) variants: u8,
}

#[derive(Clone, Copy)]
pub(super) enum Class {
    Row(u8),
    Trip(Trip),
    Instruction(Instruction),
    Keyword(Keyword),
    NotAvailable,
}

/// Item of an instruction.
const fn does(name: &[u8], instruction: Instruction) -> Item {
    Item { word: word(name), class: Class::Instruction(instruction), variants: u8::MAX }
}

/// Item of a trip.
const fn trips(name: &[u8], trip: Trip) -> Item {
    let variants = if matches!(trip, Trip::Hybrid) { HYBRID } else { u8::MAX };
    Item { word: word(name), class: Class::Trip(trip), variants }
}

/// Item of a word of PR.
const fn prints(name: &[u8], keyword: Keyword) -> Item {
    Item { word: word(name), class: Class::Keyword(keyword), variants: u8::MAX }
}

/// Item of a name that is taken although the drive does not have it.
const fn takes(name: &[u8]) -> Item {
    Item { word: word(name), class: Class::NotAvailable, variants: 0 }
}

/// All names, in alphabetical order.
pub(super) static ITEMS: [Item; LIST.1] = {
    let mut items = [NOTHING; LIST.1];
    let mut i = 0;
    while i < LIST.1 {
        items[i] = LIST.0[i];
        i += 1;
    }
    items
};

/// Names, with room for 256, and their number.
const LIST: ([Item; 256], usize) = {
    let mut list = ([NOTHING; 256], 0);
    let mut i = 0;
    while i < ROWS.len() {
        let name = ROWS[i].name.as_bytes();
        // Left out are settings, which have longer names, and V1 to V8, which are names that users declare.
        if name.len() <= 3 && !matches!(name, [b'V', b'1'..=b'8']) {
            let word = word(name);
            let variants = match &word {
                // The Hybrid has no register I6, but MCode has I6 on a Hybrid (MC 5-34).
                b"I6 " => u8::MAX,
                _ if has(SERIAL_COMMANDS, word) => SERIAL,
                _ => ROWS[i].entry.variants,
            };
            list = with(list, Item { word, class: class_of(word, i as u8), variants });
        }
        i += 1;
    }
    list = with_all(list, INSTRUCTIONS);
    list = with_all(list, KEYWORDS);
    list = with_all(list, UNAVAILABLE);
    with_all(list, TRIPS)
};

const NOTHING: Item = takes(b" ");

/// Class of the name of a row: its instruction if there is one, else the row.
const fn class_of(word: Word, row: u8) -> Class {
    let mut i = 0;
    while i < INSTRUCTIONS.len() {
        if number(INSTRUCTIONS[i].word) == number(word) {
            return INSTRUCTIONS[i].class;
        }
        i += 1;
    }
    Class::Row(row)
}

/// Adds items to a list.
const fn with_all(mut list: ([Item; 256], usize), items: &[Item]) -> ([Item; 256], usize) {
    let mut i = 0;
    while i < items.len() {
        list = with(list, items[i]);
        i += 1;
    }
    list
}

/// Adds an item to a sorted list. If the name is in the list already, nothing changes.
const fn with(list: ([Item; 256], usize), item: Item) -> ([Item; 256], usize) {
    let (mut items, count) = list;
    let mut place = count;
    while place > 0 && number(items[place - 1].word) >= number(item.word) {
        if number(items[place - 1].word) == number(item.word) {
            return list;
        }
        items[place] = items[place - 1];
        place -= 1;
    }
    items[place] = item;
    (items, count + 1)
}

const fn has(words: &[Word], word: Word) -> bool {
    let mut i = 0;
    while i < words.len() {
        if number(words[i]) == number(word) {
            return true;
        }
        i += 1;
    }
    false
}

const fn word(name: &[u8]) -> Word {
    let second = if name.len() > 1 { name[1] } else { b' ' };
    let third = if name.len() > 2 { name[2] } else { b' ' };
    [name[0], second, third]
}

/// Number by which words are compared at compile time.
const fn number(word: Word) -> u32 {
    u32::from_be_bytes([0, word[0], word[1], word[2]])
}
