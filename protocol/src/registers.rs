//! A register map, declared once.
//!
//! A drive writes its map as one table, in the order and with the names of its manual, with
//! [`registers!`](crate::registers!). From it come the enum that the drive matches on, the storage
//! ([`Bank`]), what the bus may do, the generated reference, and the names users type. A bad table
//! (two rows at one address, a factory value that the row itself refuses) does not compile (PROJECT-9).
//!
//! *The table decides what is legal; one `match` in the drive decides what it means.*

use core::marker::PhantomData;
use core::ops::{Deref, Range};

/// Which word of a value of several words has the lower address.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Order {
    /// The high word (MD3, MDrive).
    HighFirst,
    /// The low word (RS 434544, MDROBOT).
    LowFirst,
}

/// Use of addresses in a map.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Layout {
    /// Order of the words of a value.
    pub order: Order,
    /// True if an address names a whole value, however long (QSB, MDROBOT), and not one word of it.
    pub objects: bool,
}

/// The layouts as [`registers!`](crate::registers!) spells them.
#[expect(non_upper_case_globals, reason = "they stand where a type's name would: `enum Reg: HighFirst`")]
impl Layout {
    /// Words with the high one first.
    pub const HighFirst: Self = Self { order: Order::HighFirst, objects: false };
    /// Words with the low one first.
    pub const LowFirst: Self = Self { order: Order::LowFirst, objects: false };
    /// Whole values with the high word first.
    pub const ObjectsHighFirst: Self = Self { order: Order::HighFirst, objects: true };
    /// Whole values with the low word first.
    pub const ObjectsLowFirst: Self = Self { order: Order::LowFirst, objects: true };
}

/// Space of a row: the four address spaces of Modbus, and two that no bus reaches.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Space {
    /// Coils: functions 1, 5, 15.
    Coil,
    /// Discrete inputs: function 2.
    Discrete,
    /// Input registers: function 4.
    Input,
    /// Holding registers: functions 3, 6, 16; also registers of an ASCII language.
    Holding,
    /// A variable of the drive's own language (MCode), which has a name and no address.
    Variable,
    /// A choice of the stand-in where the manual leaves one; set by its name only.
    Setting,
}

/// Access of the bus to a row.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Access {
    /// Read and write.
    ReadWrite,
    /// Read only.
    ReadOnly,
    /// Write only.
    WriteOnly,
    /// Named in the manual without any detail: neither read nor written.
    Known,
}

impl Access {
    /// Returns whether the bus may read it.
    #[must_use]
    pub const fn reads(self) -> bool {
        matches!(self, Self::ReadWrite | Self::ReadOnly)
    }

    /// Returns whether the bus may write it.
    #[must_use]
    pub const fn writes(self) -> bool {
        matches!(self, Self::ReadWrite | Self::WriteOnly)
    }

    /// As tables of registers print it.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::ReadWrite => "R/W",
            Self::ReadOnly => "R",
            Self::WriteOnly => "W",
            Self::Known => "-",
        }
    }
}

/// The form of a value.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Shape {
    /// A bit: coil or discrete input.
    Bit,
    /// A byte, in the low half of a word.
    U8,
    /// An unsigned word.
    U16,
    /// A signed word.
    I16,
    /// Two words, unsigned.
    U32,
    /// Two words, signed.
    I32,
    /// Words, that many, with a meaning each; no number as a whole.
    Words(u8),
}

impl Shape {
    /// Words that it takes.
    #[must_use]
    pub const fn words(self) -> u16 {
        match self {
            Self::Bit | Self::U8 | Self::U16 | Self::I16 => 1,
            Self::U32 | Self::I32 => 2,
            Self::Words(n) => n as u16,
        }
    }

    /// The least and the greatest number it holds.
    #[must_use]
    pub const fn limits(self) -> (i64, i64) {
        match self {
            Self::Bit => (0, 1),
            Self::U8 => (0, u8::MAX as i64),
            Self::U16 => (0, u16::MAX as i64),
            Self::I16 => (i16::MIN as i64, i16::MAX as i64),
            Self::U32 => (0, u32::MAX as i64),
            Self::I32 => (i32::MIN as i64, i32::MAX as i64),
            Self::Words(_) => (i64::MIN, i64::MAX),
        }
    }

    /// As tables of registers print it.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Bit => "bit",
            Self::U8 => "u8",
            Self::U16 => "u16",
            Self::I16 => "i16",
            Self::U32 => "u32",
            Self::I32 => "i32",
            Self::Words(_) => "words",
        }
    }
}

/// The values that a write may bring.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Legal {
    /// All that the shape holds.
    Any,
    /// From the first to the second.
    Range(i64, i64),
    /// These.
    OneOf(&'static [i64]),
    /// Each word from the first to the second, in bus order; only where the low word is first.
    Each(&'static [(u16, u16)]),
    /// Text of up to eight characters from blank to `~`, two in a word, 0 behind the last one; only where the high word
    /// is first.
    Text,
}

/// The value of a row of [`Legal::Text`]: up to eight characters.
#[must_use]
pub const fn text(mut characters: &[u8]) -> i64 {
    let (mut value, mut left) = (0, 8);
    while left > 0 {
        value <<= 8;
        if let [character, rest @ ..] = characters {
            value |= *character as i64;
            characters = rest;
        }
        left -= 1;
    }
    value
}

/// The characters of a value of a row of [`Legal::Text`].
pub fn characters(value: i64) -> impl Iterator<Item = u8> {
    value.to_be_bytes().into_iter().filter(|&character| character != 0)
}

/// Returns whether it is a value of [`Legal::Text`].
const fn is_text(value: i64) -> bool {
    let (mut rest, mut left, mut has_ended) = (value, 8, true);
    // From the last one on.
    while left > 0 {
        let character = (rest & 0xFF) as u8;
        has_ended = has_ended && character == 0;
        if !has_ended && !matches!(character, b' '..=b'~') {
            return false;
        }
        (rest, left) = (rest >> 8, left - 1);
    }
    true
}

/// The part of a [`Row`] that a bus and a drive use.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct Entry {
    /// Address space.
    pub space: Space,
    /// Address in it; of several words the lowest.
    pub address: u16,
    /// The space of bits in which its one word is too, at the same address: set or not.
    pub also: Option<Space>,
    /// Access of the bus.
    pub access: Access,
    /// Shape of the value.
    pub shape: Shape,
    /// Legal values of a write; any other is refused.
    pub legal: Legal,
    /// Limits applied when the value is used; it reads back as written.
    pub clamp: Option<(i64, i64)>,
    /// The factory value.
    pub reset: i64,
    /// Bits of each word that a save keeps; 0 for a row that is not saved.
    pub saved: u16,
    /// True if the drive updates it before each read.
    pub live: bool,
    /// True if the bus can have it streamed (QSB).
    pub streams: bool,
    /// Which variants of the product have it, a bit each.
    pub variants: u8,
    /// True if it is present only at times, which the drive knows.
    pub optional: bool,
}

/// A row of a register map: an [`Entry`], and documentation, which no board needs. Built by the words of
/// [`registers!`](crate::registers!).
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct Row {
    /// The manual's name.
    pub name: &'static str,
    /// Meaning and unit: the rustdoc of the row.
    pub doc: &'static str,
    /// The section of the manual.
    pub section: &'static str,
    /// Reason why it is not modelled; empty if it is.
    pub missing: &'static str,
    /// The factory value means that nothing is set; a write cannot bring it.
    pub unset: bool,
    /// All else.
    pub entry: Entry,
}

impl Deref for Row {
    type Target = Entry;

    fn deref(&self) -> &Entry {
        &self.entry
    }
}

impl Row {
    const fn new(space: Space, access: Access, address: u16, section: &'static str) -> Self {
        let shape = match space {
            Space::Coil | Space::Discrete => Shape::Bit,
            Space::Input | Space::Holding | Space::Variable | Space::Setting => Shape::U16,
        };
        let entry = Entry {
            space,
            address,
            also: None,
            access,
            shape,
            legal: Legal::Any,
            clamp: None,
            reset: 0,
            saved: 0,
            live: false,
            streams: false,
            variants: u8::MAX,
            optional: false,
        };
        Self { name: "", doc: "", section, missing: "", unset: false, entry }
    }

    /// A holding register to read and write.
    #[must_use]
    pub const fn rw(address: u16, section: &'static str) -> Self {
        Self::new(Space::Holding, Access::ReadWrite, address, section)
    }

    /// A holding register to read.
    #[must_use]
    pub const fn ro(address: u16, section: &'static str) -> Self {
        Self::new(Space::Holding, Access::ReadOnly, address, section)
    }

    /// A holding register to write.
    #[must_use]
    pub const fn wo(address: u16, section: &'static str) -> Self {
        Self::new(Space::Holding, Access::WriteOnly, address, section)
    }

    /// A holding register that the manual names and does not describe, and that is not modelled therefore.
    #[must_use]
    pub const fn known(address: u16, section: &'static str) -> Self {
        Self::new(Space::Holding, Access::Known, address, section)
            .not_modelled("the manual says no more of it")
    }

    /// An input register.
    #[must_use]
    pub const fn input(address: u16, section: &'static str) -> Self {
        Self::new(Space::Input, Access::ReadOnly, address, section)
    }

    /// A coil.
    #[must_use]
    pub const fn coil(address: u16, section: &'static str) -> Self {
        Self::new(Space::Coil, Access::ReadWrite, address, section)
    }

    /// A discrete input.
    #[must_use]
    pub const fn discrete(address: u16, section: &'static str) -> Self {
        Self::new(Space::Discrete, Access::ReadOnly, address, section)
    }

    /// A variable of the drive's own language; `number` only makes it unique.
    #[must_use]
    pub const fn variable(number: u16, section: &'static str) -> Self {
        Self::new(Space::Variable, Access::ReadWrite, number, section)
    }

    /// A variable of the drive's own language that can only be read; `number` only makes it unique.
    #[must_use]
    pub const fn fact(number: u16, section: &'static str) -> Self {
        Self::new(Space::Variable, Access::ReadOnly, number, section)
    }

    /// A choice of the stand-in; `number` only makes it unique.
    #[must_use]
    pub const fn setting(number: u16, section: &'static str) -> Self {
        Self::new(Space::Setting, Access::ReadWrite, number, section)
    }

    /// With the names from the table.
    #[doc(hidden)]
    #[must_use]
    pub const fn named(mut self, name: &'static str, doc: &'static str) -> Self {
        self.name = name;
        self.doc = doc;
        self
    }

    const fn shaped(mut self, shape: Shape) -> Self {
        self.entry.shape = shape;
        self
    }

    /// A byte.
    #[must_use]
    pub const fn u8(self) -> Self {
        self.shaped(Shape::U8)
    }

    /// A signed word.
    #[must_use]
    pub const fn i16(self) -> Self {
        self.shaped(Shape::I16)
    }

    /// Two words, unsigned.
    #[must_use]
    pub const fn u32(self) -> Self {
        self.shaped(Shape::U32)
    }

    /// Two words, signed.
    #[must_use]
    pub const fn i32(self) -> Self {
        self.shaped(Shape::I32)
    }

    /// `n` words with a meaning each.
    #[must_use]
    pub const fn words(self, n: u8) -> Self {
        self.shaped(Shape::Words(n))
    }

    /// Refuses what is not in `least..=greatest`.
    #[must_use]
    pub const fn range(mut self, least: i64, greatest: i64) -> Self {
        self.entry.legal = Legal::Range(least, greatest);
        self
    }

    /// Refuses what is not in `codes`.
    #[must_use]
    pub const fn one_of(mut self, codes: &'static [i64]) -> Self {
        self.entry.legal = Legal::OneOf(codes);
        self
    }

    /// Refuses it unless each word is in its range; in bus order, only where the low word is first.
    #[must_use]
    pub const fn each(mut self, ranges: &'static [(u16, u16)]) -> Self {
        self.entry.legal = Legal::Each(ranges);
        self
    }

    /// Text of up to eight characters.
    #[must_use]
    pub const fn text(mut self) -> Self {
        self.entry.legal = Legal::Text;
        self.shaped(Shape::Words(4))
    }

    /// The factory value means that nothing is set, and lies outside the range of a write.
    #[must_use]
    pub const fn unset(mut self) -> Self {
        self.unset = true;
        self
    }

    /// Accepts everything and limits it to `least..=greatest` when it is used.
    #[must_use]
    pub const fn clamped(mut self, least: i64, greatest: i64) -> Self {
        self.entry.clamp = Some((least, greatest));
        self
    }

    /// The factory value, where it is not 0.
    #[must_use]
    pub const fn reset(mut self, value: i64) -> Self {
        self.entry.reset = value;
        self
    }

    /// Kept by a save.
    #[must_use]
    pub const fn saved(self) -> Self {
        self.saved_bits(u16::MAX)
    }

    /// Makes it a value of which a save keeps these bits.
    #[must_use]
    pub const fn saved_bits(mut self, mask: u16) -> Self {
        self.entry.saved = mask;
        self
    }

    /// Brought up to date before each read.
    #[must_use]
    pub const fn live(mut self) -> Self {
        self.entry.live = true;
        self
    }

    /// Which the bus may have sent again and again.
    #[must_use]
    pub const fn streams(mut self) -> Self {
        self.entry.streams = true;
        self
    }

    /// Which only these variants of the product have, a bit each.
    #[must_use]
    pub const fn only(mut self, variants: u8) -> Self {
        self.entry.variants = variants;
        self
    }

    /// Present only at times, which the drive decides.
    #[must_use]
    pub const fn optional(mut self) -> Self {
        self.entry.optional = true;
        self
    }

    /// Which is a coil too, at the same address.
    #[must_use]
    pub const fn also_coil(mut self) -> Self {
        self.entry.also = Some(Space::Coil);
        self
    }

    /// Which is a discrete input too, at the same address.
    #[must_use]
    pub const fn also_discrete(mut self) -> Self {
        self.entry.also = Some(Space::Discrete);
        self
    }

    /// Kept and read back, but without its effect, and why.
    #[must_use]
    pub const fn not_modelled(mut self, reason: &'static str) -> Self {
        self.missing = reason;
        self
    }
}

impl Entry {
    /// Returns whether a write may bring `value`.
    #[must_use]
    pub const fn accepts(&self, value: i64) -> bool {
        let (least, greatest) = self.shape.limits();
        if value < least || value > greatest {
            return false;
        }
        match self.legal {
            Legal::Any => true,
            Legal::Range(least, greatest) => least <= value && value <= greatest,
            Legal::OneOf(mut codes) => {
                while let [code, rest @ ..] = codes {
                    if *code == value {
                        return true;
                    }
                    codes = rest;
                }
                false
            }
            Legal::Each(mut ranges) => {
                let mut rest = value;
                while let [(least, greatest), more @ ..] = ranges {
                    let word = (rest & 0xFFFF) as u16;
                    if word < *least || word > *greatest {
                        return false;
                    }
                    (rest, ranges) = (rest >> 16, more);
                }
                true
            }
            Legal::Text => is_text(value),
        }
    }

    /// `value` as it acts.
    #[must_use]
    pub const fn clamped_value(&self, value: i64) -> i64 {
        match self.clamp {
            Some((least, _)) if value < least => least,
            Some((_, greatest)) if value > greatest => greatest,
            _ => value,
        }
    }

    /// Returns whether it is in `space`, or there too.
    #[must_use]
    pub const fn is_in(&self, space: Space) -> bool {
        self.space as u8 == space as u8 || matches!(self.also, Some(also) if also as u8 == space as u8)
    }

    /// Returns whether a drive may lack it: only some variants have it, or it is present only at times.
    #[must_use]
    pub const fn is_conditional(&self) -> bool {
        self.optional || self.variants != u8::MAX
    }

    /// Addresses that it takes.
    const fn addresses(&self, layout: Layout) -> u16 {
        if layout.objects { 1 } else { self.shape.words() }
    }
}

/// A contiguous range of readable addresses whose words are adjacent in the bank.
#[derive(Clone, Copy, Debug)]
#[doc(hidden)]
pub struct AddressRange {
    space: Space,
    first: u16,
    addresses: u16,
    words: u16,
    offset: u16,
}

/// A whole register map.
#[derive(Debug)]
pub struct Table {
    /// Rows, in the manual's order.
    pub rows: &'static [Row],
    /// The part of them that a bus and a drive use.
    pub entries: &'static Entries,
}

impl Deref for Table {
    type Target = Entries;

    fn deref(&self) -> &Entries {
        self.entries
    }
}

/// The part of a [`Table`] that a bus and a drive use.
#[derive(Debug)]
pub struct Entries {
    /// Entries of the rows, in their order.
    pub list: &'static [Entry],
    /// Use of addresses.
    pub layout: Layout,
    /// Place of each row's first word in the bank.
    offsets: &'static [u16],
    /// Runs that one read may cover.
    ranges: &'static [AddressRange],
    /// True if any row is live.
    live: bool,
    /// True if a drive may lack a row.
    conditional: bool,
}

/// A row, or one word of it, found by its name.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Named {
    /// Index of the row.
    pub row: usize,
    /// The one word of the row that is meant (`SpeedHigh`), counted in bus order; all if `None`.
    pub word: Option<u16>,
}

impl Table {
    /// A map without rows.
    pub const EMPTY: Self = Self { rows: &[], entries: &Entries::new(&[], Layout::HighFirst, &[], &[]) };

    /// The same map with other rows of the same shapes at the same addresses: of a product's variant
    /// with other factory values.
    #[must_use]
    pub const fn with_rows(&self, rows: &'static [Row]) -> Self {
        Self { rows, ..*self }
    }

    /// The row of that name, or the half of it that `…High` or `…Low` names.
    #[must_use]
    pub fn find(&self, name: &str) -> Option<Named> {
        let whole = |name: &str| self.rows.iter().position(|row| row.name == name);
        if let Some(row) = whole(name) {
            return Some(Named { row, word: None });
        }
        let half = |suffix: &str, first: Order| {
            let row = whole(name.strip_suffix(suffix)?)?;
            let pair = self.rows.get(row)?.shape.words() == 2;
            pair.then_some(Named { row, word: Some(u16::from(self.layout.order != first)) })
        };
        half("High", Order::HighFirst).or_else(|| half("Low", Order::LowFirst))
    }
}

impl Entries {
    /// The same map with other entries of the same shapes at the same addresses: of a product's variant with
    /// other limits.
    #[must_use]
    pub const fn with_list(&self, list: &'static [Entry]) -> Self {
        Self { list, ..*self }
    }

    /// For [`registers!`](crate::registers!).
    #[doc(hidden)]
    #[must_use]
    #[expect(clippy::indexing_slicing, reason = "only ever evaluated by the compiler")]
    pub const fn new(
        list: &'static [Entry],
        layout: Layout,
        offsets: &'static [u16],
        ranges: &'static [AddressRange],
    ) -> Self {
        let (mut live, mut conditional, mut i) = (false, false, 0);
        while i < list.len() {
            live |= list[i].live;
            conditional |= list[i].is_conditional();
            i += 1;
        }
        Self { list, layout, offsets, ranges, live, conditional }
    }

    /// Place of a row's first word in the bank.
    #[must_use]
    pub fn offset(&self, row: usize) -> usize {
        self.offsets.get(row).copied().map_or(usize::MAX, usize::from)
    }

    /// Places in the bank of the words that a read of `count` addresses from `first` brings; `None`
    /// if one of them cannot be read, or is half of something.
    #[must_use]
    pub fn readable(&self, space: Space, first: u16, count: u16) -> Option<Range<usize>> {
        for range in self.ranges {
            let skipped = first.wrapping_sub(range.first);
            if skipped < range.addresses && range.space == space {
                // Of an object the count is its words, of anything else its addresses.
                let (skipped, room) =
                    if self.layout.objects { (0, range.words) } else { (skipped, range.addresses - skipped) };
                let whole = if self.layout.objects { count == room } else { count <= room };
                let start = usize::from(range.offset) + usize::from(skipped);
                return whole.then_some(start..start + usize::from(count));
            }
        }
        None
    }

    /// The row that holds `address`, and which of its words that is.
    #[must_use]
    pub fn at(&self, space: Space, address: u16) -> Option<(usize, u16)> {
        for (index, row) in self.list.iter().enumerate() {
            let word = address.wrapping_sub(row.address);
            if word < row.addresses(self.layout) && row.is_in(space) {
                return Some((index, word));
            }
        }
        None
    }

    /// The value of a row of which `words` are the bank.
    #[must_use]
    pub fn value(&self, words: &[u16], row: usize) -> i64 {
        let Some(shape) = self.list.get(row).map(|row| row.shape) else { return 0 };
        let offset = self.offset(row);
        self.assemble(shape, |n| words.get(offset.wrapping_add(n)).copied().unwrap_or(0))
    }

    /// The value of a shape of which `word` gives the words, in bus order. Of more than four words
    /// the first four count.
    #[must_use]
    pub fn assemble(&self, shape: Shape, word: impl Fn(usize) -> u16) -> i64 {
        let value = self.words_from_high(shape).fold(0, |value, n| value << 16 | i64::from(word(n)));
        match shape {
            Shape::I16 => i64::from(value as i16),
            Shape::I32 => i64::from(value as i32),
            _ => value,
        }
    }

    /// The word of a shape's value that comes `n`-th on the bus; 0 for one that it does not hold.
    #[must_use]
    pub fn word(&self, shape: Shape, value: i64, n: usize) -> u16 {
        let upward = self.words_from_high(shape).rev().position(|offset| offset == n);
        upward.map_or(0, |offset| (value >> (16 * offset) & 0xFFFF).cast_unsigned() as u16)
    }

    /// Puts `value` into a row's words in the bank, cut to its shape.
    pub fn put(&self, words: &mut [u16], row: usize, value: i64) {
        let Some(shape) = self.list.get(row).map(|row| row.shape) else { return };
        let offset = self.offset(row);
        let mut rest = value;
        for n in self.words_from_high(shape).rev() {
            if let Some(word) = words.get_mut(offset.wrapping_add(n)) {
                *word = (rest & 0xFFFF).cast_unsigned() as u16;
            }
            rest >>= 16;
        }
    }

    /// Places in bus order of a value's words, the highest one first.
    fn words_from_high(&self, shape: Shape) -> impl DoubleEndedIterator<Item = usize> {
        let count = usize::from(shape.words()).min(4);
        let low_first = self.layout.order == Order::LowFirst;
        (0..count).map(move |n| if low_first { count - 1 - n } else { n })
    }

    /// Returns whether any row is to be updated before it is read.
    #[must_use]
    pub fn has_live(&self) -> bool {
        self.live
    }

    /// The live rows with words at these places of the bank.
    pub fn live_rows_at(&self, offsets: &Range<usize>) -> impl Iterator<Item = usize> + use<'_> {
        self.rows_at(offsets, |row| row.live)
    }

    /// Returns whether a drive may lack a row.
    #[must_use]
    pub fn has_conditional(&self) -> bool {
        self.conditional
    }

    /// The rows with words at these places of the bank that a drive may be without.
    pub fn conditional_rows_at(&self, offsets: &Range<usize>) -> impl Iterator<Item = usize> + use<'_> {
        self.rows_at(offsets, Entry::is_conditional)
    }

    fn rows_at<F: Fn(&Entry) -> bool>(
        &self,
        offsets: &Range<usize>,
        which: F,
    ) -> impl Iterator<Item = usize> + use<'_, F> {
        let (start, end) = (offsets.start, offsets.end);
        // Places ascend, so the first of these rows is the last one that begins at `start` or before.
        let first = self.offsets.partition_point(|&offset| usize::from(offset) <= start).saturating_sub(1);
        let rows = self.list.iter().enumerate().skip(first);
        let rows = rows.take_while(move |&(index, _)| self.offset(index) < end);
        rows.filter_map(move |(index, row)| {
            let touched = start < self.offset(index) + usize::from(row.shape.words());
            (which(row) && touched).then_some(index)
        })
    }
}

/// Implemented by [`registers!`](crate::registers!) for its enum.
pub trait Register: Copy + 'static {
    /// The map it names the rows of.
    const TABLE: &'static Table;
    /// The part of the map that a bus and a drive use.
    const ENTRIES: &'static Entries;

    /// Index of the row.
    fn row(self) -> usize;

    /// The name of a row.
    fn from_row(row: usize) -> Option<Self>;
}

/// The storage of a register map: bus words in bus order, so that a read copies a slice.
#[derive(Clone, Debug)]
pub struct Bank<R, const WORDS: usize> {
    words: [u16; WORDS],
    registers: PhantomData<R>,
}

impl<R: Register, const WORDS: usize> Default for Bank<R, WORDS> {
    fn default() -> Self {
        Self::factory()
    }
}

impl<R: Register, const WORDS: usize> Bank<R, WORDS> {
    /// A bank with the factory values.
    #[must_use]
    pub fn factory() -> Self {
        Self::of(R::ENTRIES)
    }

    /// A bank with the factory values of a variant of the product.
    #[must_use]
    pub fn of(entries: &Entries) -> Self {
        let mut bank = Self { words: [0; WORDS], registers: PhantomData };
        for (index, row) in entries.list.iter().enumerate() {
            entries.put(&mut bank.words, index, row.reset);
        }
        bank
    }

    /// The value of a register, as written.
    #[must_use]
    pub fn get(&self, register: R) -> i64 {
        R::ENTRIES.value(&self.words, register.row())
    }

    /// The value of a register as it acts: within the limits of its row.
    #[must_use]
    pub fn clamped_value(&self, register: R) -> i64 {
        let value = self.get(register);
        R::ENTRIES.list.get(register.row()).map_or(value, |row| row.clamped_value(value))
    }

    /// The first word of a register: the whole value if it has one word.
    #[must_use]
    pub fn word(&self, register: R) -> u16 {
        self.words.get(R::ENTRIES.offset(register.row())).copied().unwrap_or(0)
    }

    /// Sets a register, past all rules.
    pub fn set(&mut self, register: R, value: i64) {
        R::ENTRIES.put(&mut self.words, register.row(), value);
    }

    /// All words, in the order of the table.
    #[must_use]
    pub fn words(&self) -> &[u16] {
        &self.words
    }

    /// All words, in the order of the table, past all rules.
    pub fn words_mut(&mut self) -> &mut [u16] {
        &mut self.words
    }
}

/// Everything that can be wrong with a table, found while it compiles.
#[doc(hidden)]
#[expect(clippy::panic, clippy::indexing_slicing, reason = "only ever evaluated by the compiler")]
pub const fn check(rows: &[Row], layout: Layout) {
    let mut i = 0;
    while i < rows.len() {
        let Row { doc, section, unset, entry: row, .. } = &rows[i];
        let (least, greatest) = row.shape.limits();
        if doc.is_empty() || section.is_empty() {
            panic!("a row says what it is and which section of the manual describes it");
        }
        if row.accepts(row.reset) == *unset && !matches!(row.access, Access::WriteOnly) {
            panic!("a factory value is one that the row accepts, unless it says that nothing is set");
        }
        if let Legal::Range(low, high) = row.legal
            && (low > high || low < least || high > greatest)
        {
            panic!("a range lies within its shape");
        }
        if let Legal::Each(ranges) = row.legal
            && (ranges.len() != row.shape.words() as usize || matches!(layout.order, Order::HighFirst))
        {
            panic!("each word has its range, and the low word is first");
        }
        if matches!(row.legal, Legal::Text) && matches!(layout.order, Order::LowFirst) {
            panic!("text begins with the high word");
        }
        if let Some((low, high)) = row.clamp
            && (low > high || low < least || high > greatest)
        {
            panic!("a clamp lies within its shape");
        }
        if matches!(row.space, Space::Coil | Space::Discrete) != matches!(row.shape, Shape::Bit) {
            panic!("coils and discrete inputs are bits, registers are not");
        }
        if row.also.is_some()
            && (row.shape.words() != 1 || !matches!(row.space, Space::Input | Space::Holding))
        {
            panic!("only a register of one word is a bit too");
        }
        if row.address as u32 + row.addresses(layout) as u32 > 0x1_0000 {
            panic!("a row ends past the last address");
        }
        let mut j = 0;
        while j < i {
            let other = &rows[j].entry;
            if share_a_space(row, other)
                && row.variants & other.variants != 0
                && row.address < other.address + other.addresses(layout)
                && other.address < row.address + row.addresses(layout)
            {
                panic!("two rows share an address");
            }
            j += 1;
        }
        i += 1;
    }
}

/// Returns whether two rows are in the same space.
const fn share_a_space(row: &Entry, other: &Entry) -> bool {
    row.is_in(other.space) || matches!(other.also, Some(also) if row.is_in(also))
}

/// Entries of a map's rows.
#[doc(hidden)]
#[must_use]
#[expect(clippy::indexing_slicing, reason = "only ever evaluated by the compiler")]
pub const fn entries<const N: usize>(rows: &[Row; N]) -> [Entry; N] {
    let mut entries = [Row::setting(0, "").entry; N];
    let mut i = 0;
    while i < N {
        entries[i] = rows[i].entry;
        i += 1;
    }
    entries
}

/// Words in the bank of a map.
#[doc(hidden)]
#[must_use]
#[expect(clippy::indexing_slicing, reason = "only ever evaluated by the compiler")]
pub const fn word_count(rows: &[Row]) -> usize {
    let (mut words, mut i) = (0, 0);
    while i < rows.len() {
        words += rows[i].entry.shape.words() as usize;
        i += 1;
    }
    words
}

/// Words that a save of a map keeps.
#[doc(hidden)]
#[must_use]
#[expect(clippy::indexing_slicing, reason = "only ever evaluated by the compiler")]
pub const fn saved_word_count(rows: &[Row]) -> usize {
    let (mut words, mut i) = (0, 0);
    while i < rows.len() {
        if rows[i].entry.saved != 0 {
            words += rows[i].entry.shape.words() as usize;
        }
        i += 1;
    }
    words
}

/// Place in the bank of each row's first word.
#[doc(hidden)]
#[must_use]
#[expect(clippy::indexing_slicing, reason = "only ever evaluated by the compiler")]
pub const fn offsets<const N: usize>(rows: &[Row; N]) -> [u16; N] {
    let mut offsets = [0; N];
    let (mut offset, mut i) = (0, 0);
    while i < N {
        offsets[i] = offset;
        offset += rows[i].entry.shape.words();
        i += 1;
    }
    offsets
}

/// Number of contiguous readable ranges of a map.
#[doc(hidden)]
#[must_use]
pub const fn range_count(rows: &[Row], layout: Layout) -> usize {
    let (mut count, mut views) = (0, VIEWS);
    while let [view, more @ ..] = views {
        let mut i = 0;
        while i < rows.len() {
            if starts_range(rows, i, *view, layout) {
                count += 1;
            }
            i += 1;
        }
        views = more;
    }
    count
}

/// The runs of readable addresses of a map.
#[doc(hidden)]
#[must_use]
#[expect(clippy::indexing_slicing, reason = "only ever evaluated by the compiler")]
pub const fn ranges<const N: usize>(rows: &[Row], layout: Layout) -> [AddressRange; N] {
    let mut ranges = [AddressRange { space: Space::Holding, first: 0, addresses: 0, words: 0, offset: 0 }; N];
    let (mut count, mut views) = (0, VIEWS);
    while let [view, more @ ..] = views {
        let (mut offset, mut i) = (0, 0);
        while i < rows.len() {
            let row = &rows[i].entry;
            if let Some(space) = readable_space(row, *view) {
                if starts_range(rows, i, *view, layout) {
                    ranges[count] =
                        AddressRange { space, first: row.address, addresses: 0, words: 0, offset };
                    count += 1;
                }
                ranges[count - 1].addresses += row.addresses(layout);
                ranges[count - 1].words += row.shape.words();
            }
            offset += row.shape.words();
            i += 1;
        }
        views = more;
    }
    ranges
}

/// Spaces in which rows are looked up: their own, and bits.
#[derive(Clone, Copy)]
enum View {
    Own,
    Also,
}

/// Every view.
const VIEWS: &[View] = &[View::Own, View::Also];

/// Space in which a bus may read a row.
const fn readable_space(row: &Entry, view: View) -> Option<Space> {
    if !row.access.reads() {
        return None;
    }
    match view {
        View::Own if matches!(row.space, Space::Variable | Space::Setting) => None,
        View::Own => Some(row.space),
        View::Also => row.also,
    }
}

/// Returns whether row `i` starts a new contiguous readable range.
#[expect(clippy::indexing_slicing, reason = "only ever evaluated by the compiler")]
const fn starts_range(rows: &[Row], i: usize, view: View, layout: Layout) -> bool {
    let row = &rows[i].entry;
    let Some(space) = readable_space(row, view) else { return false };
    if i == 0 || layout.objects {
        return true;
    }
    let last = &rows[i - 1].entry;
    let is_contiguous = match readable_space(last, view) {
        Some(other) => other as u8 == space as u8,
        None => false,
    };
    !is_contiguous || last.address as u32 + last.shape.words() as u32 != row.address as u32
}

/// Declares a register map: an enum with a variant a row, and its [`Table`].
///
/// ```
/// drivetwin_protocol::registers! {
///     /// A drive's guide, chapter 7.
///     pub enum Reg: HighFirst {
///         /// Bus address.
///         DeviceAddress = rw(0x00, "7.1").reset(1).range(1, 247).saved(),
///         /// Microsteps per second.
///         Speed = rw(0x14, "7.17").i32().clamped(-40_000, 40_000).reset(5_000).saved(),
///     }
/// }
/// # fn main() {
/// use drivetwin_protocol::registers::{Bank, Register};
/// let bank = Bank::<Reg, { Reg::WORDS }>::factory();
/// assert_eq!(bank.get(Reg::Speed), 5_000);
/// assert_eq!(Reg::TABLE.rows[1].section, "7.17");
/// # }
/// ```
///
/// Two rows at one address do not compile:
///
/// ```compile_fail
/// drivetwin_protocol::registers! {
///     /// A map.
///     pub enum Reg: HighFirst {
///         /// Two words.
///         Speed = rw(0x14, "1").i32(),
///         /// The second of them.
///         Mode = rw(0x15, "2"),
///     }
/// }
/// # fn main() { let _ = Reg::Mode; }
/// ```
///
/// Nor does a factory value that its own row refuses:
///
/// ```compile_fail
/// drivetwin_protocol::registers! {
///     /// A map.
///     pub enum Reg: HighFirst {
///         /// Bus address.
///         DeviceAddress = rw(0x00, "7.1").range(1, 247),
///     }
/// }
/// # fn main() { let _ = Reg::DeviceAddress; }
/// ```
///
/// Nor does a register that is a coil too, where another coil is:
///
/// ```compile_fail
/// drivetwin_protocol::registers! {
///     /// A map.
///     pub enum Reg: HighFirst {
///         /// Start.
///         Start = coil(0x4B, "1"),
///         /// An output.
///         O1 = rw(0x4B, "2").also_coil(),
///     }
/// }
/// # fn main() { let _ = Reg::O1; }
/// ```
#[macro_export]
macro_rules! registers {
    (
        $(#[$about:meta])*
        $vis:vis enum $Reg:ident: $layout:ident {
            $(
                $(#[doc = $doc:literal])+
                $Name:ident = $row:ident($($argument:expr),*) $(.$with:ident($($value:expr),*))*
            ),+ $(,)?
        }
    ) => {
        $(#[$about])*
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
        #[allow(clippy::enum_variant_names, reason = "the names are the manual's")]
        $vis enum $Reg {
            $( $(#[doc = $doc])+ $Name, )+
        }

        impl $Reg {
            const LAYOUT: $crate::registers::Layout = $crate::registers::Layout::$layout;
            const ROWS: [$crate::registers::Row; [$($Reg::$Name),+].len()] = [
                $(
                    $crate::registers::Row::$row($($argument),*)
                        .named(stringify!($Name), concat!($($doc),+))
                        $(.$with($($value),*))*,
                )+
            ];
            /// Words of the map's bank.
            $vis const WORDS: usize = $crate::registers::word_count(&Self::ROWS);
            /// Words of it that a save keeps.
            $vis const SAVED_WORDS: usize = $crate::registers::saved_word_count(&Self::ROWS);
        }

        const _: () = $crate::registers::check(&$Reg::ROWS, $Reg::LAYOUT);

        impl $crate::registers::Register for $Reg {
            const TABLE: &'static $crate::registers::Table = {
                static ROWS: [$crate::registers::Row; $Reg::ROWS.len()] = $Reg::ROWS;
                static TABLE: $crate::registers::Table =
                    $crate::registers::Table { rows: &ROWS, entries: $Reg::ENTRIES };
                &TABLE
            };

            const ENTRIES: &'static $crate::registers::Entries = {
                static LIST: [$crate::registers::Entry; $Reg::ROWS.len()] =
                    $crate::registers::entries(&$Reg::ROWS);
                static OFFSETS: [u16; $Reg::ROWS.len()] = $crate::registers::offsets(&$Reg::ROWS);
                static RANGES: [$crate::registers::AddressRange;
                    $crate::registers::range_count(&$Reg::ROWS, $Reg::LAYOUT)] =
                    $crate::registers::ranges(&$Reg::ROWS, $Reg::LAYOUT);
                static ENTRIES: $crate::registers::Entries =
                    $crate::registers::Entries::new(&LIST, $Reg::LAYOUT, &OFFSETS, &RANGES);
                &ENTRIES
            };

            fn row(self) -> usize {
                self as usize
            }

            fn from_row(row: usize) -> Option<Self> {
                static NAMES: &[$Reg] = &[$($Reg::$Name),+];
                NAMES.get(row).copied()
            }
        }
    };
}
