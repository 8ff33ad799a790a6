//! All names in one table, put together and sorted while the program is compiled: those of the table of variables
//! and those without a row there.
#![expect(clippy::indexing_slicing, reason = "only ever evaluated by the compiler")]

use super::super::super::registers::{HYBRID, ROWS};
use super::super::statement::Trip;
use super::{SERIAL, Word};

/// What is done and not set, also where the bus has a register for it.
const INSTRUCTIONS: &[Word] = &[
    *b"BP ", *b"BR ", *b"CF ", *b"CL ", *b"CP ", *b"DC ", *b"E  ", *b"EX ", *b"FD ", *b"H  ", *b"HI ",
    *b"HM ", *b"IC ", *b"IP ", *b"IV ", *b"L  ", *b"LB ", *b"MA ", *b"MR ", *b"OE ", *b"PG ", *b"PR ",
    *b"PS ", *b"RS ", *b"RT ", *b"S  ", *b"SC ", *b"SL ", *b"VA ",
];

const TRIPS: &[(Word, Trip)] = &[
    (*b"TA ", Trip::Hybrid),
    (*b"TC ", Trip::Capture),
    (*b"TI ", Trip::Input),
    (*b"TP ", Trip::Position),
    (*b"TR ", Trip::Relative),
    (*b"TT ", Trip::Time),
];

const KEYWORDS: &[Word] = &[*b"AL ", *b"MD ", *b"PN ", *b"SN ", *b"UV ", *b"VR "];

/// Commands of the serial sisters (MC 5-4 to 5-60).
const SERIAL_COMMANDS: &[Word] = &[*b"BD ", *b"CK ", *b"DG ", *b"DN ", *b"PY ", *b"QD "];

/// Reserved names (MC 5-3, 5-27, 5-34, 5-35), I/O points that the models with Ethernet do not have (FB 1.2.1), and
/// the upgrade of the firmware (MC 5-77).
const UNAVAILABLE: &[Word] = &[
    *b"AT ", *b"FT ", *b"I7 ", *b"I8 ", *b"I13", *b"D9 ", *b"D10", *b"D11", *b"D12", *b"I9 ", *b"I10",
    *b"I11", *b"I12", *b"IH ", *b"O9 ", *b"O10", *b"O11", *b"O12", *b"OH ", *b"S9 ", *b"S10", *b"S11",
    *b"S12", *b"UG ",
];

#[derive(Clone, Copy)]
pub(super) struct Item {
    pub(super) word: Word,
    pub(super) class: Class,
    /// Which variants of the product have it, and [`SERIAL`].
    pub(super) variants: u8,
}

#[derive(Clone, Copy)]
pub(super) enum Class {
    Row(u8),
    Trip(Trip),
    Instruction,
    Keyword,
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

/// As many as there is room for, and how many there are.
const LIST: ([Item; 256], usize) = {
    let mut list = ([NOTHING; 256], 0);
    let mut i = 0;
    while i < ROWS.len() {
        let name = ROWS[i].name.as_bytes();
        // Not a setting, and not V1 to V8, which are the user's.
        if name.len() <= 3 && !matches!(name, [b'V', b'1'..=b'8']) {
            let word = word(name);
            let class = if has(INSTRUCTIONS, word) { Class::Instruction } else { Class::Row(i as u8) };
            let variants = match &word {
                // The Hybrid has no register of it, and has it in MCode (MC 5-34).
                b"I6 " => u8::MAX,
                _ if has(SERIAL_COMMANDS, word) => SERIAL,
                _ => ROWS[i].entry.variants,
            };
            list = with(list, Item { word, class, variants });
        }
        i += 1;
    }
    list = with_all(list, INSTRUCTIONS, Class::Instruction, u8::MAX);
    list = with_all(list, KEYWORDS, Class::Keyword, u8::MAX);
    list = with_all(list, UNAVAILABLE, Class::Keyword, 0);
    let mut i = 0;
    while i < TRIPS.len() {
        let (word, trip) = TRIPS[i];
        let variants = if matches!(trip, Trip::Hybrid) { HYBRID } else { u8::MAX };
        list = with(list, Item { word, class: Class::Trip(trip), variants });
        i += 1;
    }
    list
};

const NOTHING: Item = Item { word: *b"   ", class: Class::Keyword, variants: 0 };

/// The same list with these words.
const fn with_all(
    mut list: ([Item; 256], usize),
    words: &[Word],
    class: Class,
    variants: u8,
) -> ([Item; 256], usize) {
    let mut i = 0;
    while i < words.len() {
        list = with(list, Item { word: words[i], class, variants });
        i += 1;
    }
    list
}

/// The same list with one item more, at its place; as it was if that name is there.
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

/// By which words are compared while the program is compiled.
const fn number(word: Word) -> u32 {
    u32::from_be_bytes([0, word[0], word[1], word[2]])
}
