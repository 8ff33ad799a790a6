//! Register maps, each declared once.
//!
//! A drive declares its map as one table with [`registers!`](crate::registers!), in the order and with the
//! names of its manual. This table gives the enum that the drive matches on, the storage ([`Bank`]), the
//! rules of the bus, the generated reference, and the names that users type. A bad table does not compile:
//! for example, two rows at one address, or a factory value that the row itself refuses (PROJECT-9).
//!
//! *The table decides which values are legal; one `match` in the drive decides what a write does.*

use core::marker::PhantomData;
use core::ops::{Deref, Range};

use crate::modbus::rtu;

/// The word with the lower address, in a value of several words.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Order {
    /// The high word has the lower address (MD3, MDrive).
    HighFirst,
    /// The low word has the lower address (RS 434544, MDROBOT).
    LowFirst,
}

/// Use of addresses in a map.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Layout {
    /// Order of the words of a value.
    pub order: Order,
    /// True if each address is that of a whole value of any length (QSB, MDROBOT). False if each address is
    /// that of one word.
    pub objects: bool,
}

/// The layouts under the names that [`registers!`](crate::registers!) uses.
#[expect(non_upper_case_globals, reason = "they stand where a type's name would: `enum Reg: HighFirst`")]
impl Layout {
    /// A word per address, high word first.
    pub const HighFirst: Self = Self { order: Order::HighFirst, objects: false };
    /// A word per address, low word first.
    pub const LowFirst: Self = Self { order: Order::LowFirst, objects: false };
    /// A whole value per address, high word first.
    pub const ObjectsHighFirst: Self = Self { order: Order::HighFirst, objects: true };
    /// A whole value per address, low word first.
    pub const ObjectsLowFirst: Self = Self { order: Order::LowFirst, objects: true };
}

/// Address space of a row: one of the four of Modbus, or one of two that the bus cannot reach.
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
    /// A setting of the emulated drive where the manual leaves the behaviour open. It is set by its name
    /// only.
    Setting,
}

/// Permission of the bus for a row.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Access {
    /// Read and write.
    ReadWrite,
    /// Read only.
    ReadOnly,
    /// Write only.
    WriteOnly,
    /// Named in the manual without any detail. The bus can neither read nor write the row.
    Known,
}

impl Access {
    /// Returns true if the bus may read the row.
    #[must_use]
    pub const fn reads(self) -> bool {
        matches!(self, Self::ReadWrite | Self::ReadOnly)
    }

    /// Returns true if the bus may write the row.
    #[must_use]
    pub const fn writes(self) -> bool {
        matches!(self, Self::ReadWrite | Self::WriteOnly)
    }

    /// The access as printed in register tables.
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

/// Type of a value.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Shape {
    /// A bit: a coil or a discrete input.
    Bit,
    /// A byte, in the low half of one word.
    U8,
    /// An unsigned word.
    U16,
    /// A signed word.
    I16,
    /// Two words, unsigned.
    U32,
    /// Two words, signed.
    I32,
    /// This number of words. Each has a meaning of its own; together they are not one number.
    Words(u8),
}

impl Shape {
    /// Number of words of a value.
    #[must_use]
    pub const fn words(self) -> u16 {
        match self {
            Self::Bit | Self::U8 | Self::U16 | Self::I16 => 1,
            Self::U32 | Self::I32 => 2,
            Self::Words(n) => n as u16,
        }
    }

    /// The least and the greatest value of this shape.
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

    /// The shape as printed in register tables.
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

/// The values that a write may have.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Legal {
    /// All values of the shape.
    Any,
    /// Values from the first number to the second, both included.
    Range(i64, i64),
    /// Exactly these values.
    OneOf(&'static [i64]),
    /// A range for each word, in bus order: least and greatest value. Only for maps with the low word first.
    Each(&'static [(u16, u16)]),
    /// Text of up to eight characters from blank to `~`, two characters in a word, filled up with 0 after the
    /// last one. Only for maps with the high word first.
    Text,
}

/// Packs up to eight characters into a value of a row with [`Legal::Text`].
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

/// The characters in a value of a row with [`Legal::Text`].
pub fn characters(value: i64) -> impl Iterator<Item = u8> {
    value.to_be_bytes().into_iter().filter(|&character| character != 0)
}

/// Returns true if `value` is legal for [`Legal::Text`].
const fn is_text(value: i64) -> bool {
    let (mut rest, mut left, mut has_ended) = (value, 8, true);
    // From the last character to the first.
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

/// The part of a [`Row`] that the bus and the drive need.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct Entry {
    /// Address space.
    pub space: Space,
    /// Address in this space. For several words, the lowest address.
    pub address: u16,
    /// A second space, of bits, in which the row is at the same address. The bit is 1 if the row's word is
    /// not 0.
    pub also: Option<Space>,
    /// Accesses that the bus allows: read, write or both.
    pub access: Access,
    /// Shape of the value.
    pub shape: Shape,
    /// Legal values of a write. The bus refuses any other value.
    pub legal: Legal,
    /// Limits that the drive applies when it uses the value. A read returns the value as written.
    pub clamp: Option<(i64, i64)>,
    /// The factory value.
    pub reset: i64,
    /// Bits of each word that a save stores; 0 if the row is not saved.
    pub saved: u16,
    /// True if the drive updates the value before each read.
    pub live: bool,
    /// True if the bus can have the value streamed, that is, sent repeatedly (QSB).
    pub streams: bool,
    /// Variants of the product that have the row, one bit each.
    pub variants: u8,
    /// True if the row is present only at times. The drive decides when.
    pub optional: bool,
}

/// Bits of a register that have a meaning of their own, or the whole register if its values have names.
///
/// ```
/// use drivetwin_protocol::registers::Field;
/// let parity = Field::bits(5, 4, "parity").values(&[(0, "none"), (1, "odd"), (2, "even")]);
/// assert_eq!(parity.of(0x0021), 2);
/// ```
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[non_exhaustive]
pub struct Field {
    /// Highest bit of the field, 0 to 15.
    pub high: u8,
    /// Lowest bit of the field.
    pub low: u8,
    /// Name or meaning, with the unit of a number; empty for a whole register.
    pub name: &'static str,
    /// Values that have a name, with it.
    pub values: &'static [(u16, &'static str)],
}

impl Field {
    /// The bits from `high` down to `low`.
    #[must_use]
    pub const fn bits(high: u8, low: u8, name: &'static str) -> Self {
        Self { high, low, name, values: &[] }
    }

    /// One bit.
    #[must_use]
    pub const fn bit(bit: u8, name: &'static str) -> Self {
        Self::bits(bit, bit, name)
    }

    /// A whole register whose values have names.
    #[must_use]
    pub const fn whole(values: &'static [(u16, &'static str)]) -> Self {
        Self { high: 15, low: 0, name: "", values }
    }

    /// Names of values.
    #[must_use]
    pub const fn values(mut self, values: &'static [(u16, &'static str)]) -> Self {
        self.values = values;
        self
    }

    /// Value of the field in the value of its register.
    #[must_use]
    pub const fn of(&self, register: u16) -> u16 {
        (register >> self.low) & self.greatest()
    }

    /// Greatest value of the field.
    const fn greatest(&self) -> u16 {
        u16::MAX >> (15 - (self.high - self.low))
    }
}

/// A row of a register map: an [`Entry`], and documentation that no board needs. The methods of `Row` are the
/// words of [`registers!`](crate::registers!).
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct Row {
    /// The manual's name.
    pub name: &'static str,
    /// Meaning and unit: the rustdoc of the row.
    pub doc: &'static str,
    /// Section of the manual.
    pub section: &'static str,
    /// Bits and values that have a meaning of their own, in the order of the manual.
    pub fields: &'static [Field],
    /// Reason why the row is not modelled; empty if it is modelled.
    pub missing: &'static str,
    /// True if the factory value means that nothing is set. A write cannot have this value.
    pub unset: bool,
    /// The part that the bus and the drive need.
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
        Self { name: "", doc: "", section, fields: &[], missing: "", unset: false, entry }
    }

    /// Bits or values that have a meaning of their own.
    #[must_use]
    pub const fn fields(mut self, fields: &'static [Field]) -> Self {
        self.fields = fields;
        self
    }

    /// A holding register for reading and writing.
    #[must_use]
    pub const fn rw(address: u16, section: &'static str) -> Self {
        Self::new(Space::Holding, Access::ReadWrite, address, section)
    }

    /// A holding register for reading only.
    #[must_use]
    pub const fn ro(address: u16, section: &'static str) -> Self {
        Self::new(Space::Holding, Access::ReadOnly, address, section)
    }

    /// A holding register for writing only.
    #[must_use]
    pub const fn wo(address: u16, section: &'static str) -> Self {
        Self::new(Space::Holding, Access::WriteOnly, address, section)
    }

    /// A holding register that the manual names but does not describe. So it is not modelled.
    #[must_use]
    pub const fn known(address: u16, section: &'static str) -> Self {
        Self::new(Space::Holding, Access::Known, address, section)
            .not_modelled("the manual does not describe it")
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

    /// A variable of the drive's own language. `number` only makes the row unique.
    #[must_use]
    pub const fn variable(number: u16, section: &'static str) -> Self {
        Self::new(Space::Variable, Access::ReadWrite, number, section)
    }

    /// A read-only variable of the drive's own language. `number` only makes the row unique.
    #[must_use]
    pub const fn fact(number: u16, section: &'static str) -> Self {
        Self::new(Space::Variable, Access::ReadOnly, number, section)
    }

    /// A setting of the emulated drive ([`Space::Setting`]). `number` only makes the row unique.
    #[must_use]
    pub const fn setting(number: u16, section: &'static str) -> Self {
        Self::new(Space::Setting, Access::ReadWrite, number, section)
    }

    /// Sets the name and the documentation of the row, from the table.
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

    /// Makes the value a byte.
    #[must_use]
    pub const fn u8(self) -> Self {
        self.shaped(Shape::U8)
    }

    /// Makes the value a signed word.
    #[must_use]
    pub const fn i16(self) -> Self {
        self.shaped(Shape::I16)
    }

    /// Makes the value two words, unsigned.
    #[must_use]
    pub const fn u32(self) -> Self {
        self.shaped(Shape::U32)
    }

    /// Makes the value two words, signed.
    #[must_use]
    pub const fn i32(self) -> Self {
        self.shaped(Shape::I32)
    }

    /// Makes the value `n` words, each with a meaning of its own.
    #[must_use]
    pub const fn words(self, n: u8) -> Self {
        self.shaped(Shape::Words(n))
    }

    /// Makes writes of values outside `least..=greatest` fail.
    #[must_use]
    pub const fn range(mut self, least: i64, greatest: i64) -> Self {
        self.entry.legal = Legal::Range(least, greatest);
        self
    }

    /// Makes writes of values that are not in `codes` fail.
    #[must_use]
    pub const fn one_of(mut self, codes: &'static [i64]) -> Self {
        self.entry.legal = Legal::OneOf(codes);
        self
    }

    /// Makes a write fail unless each word is in its range. The ranges are in bus order; only for maps with
    /// the low word first.
    #[must_use]
    pub const fn each(mut self, ranges: &'static [(u16, u16)]) -> Self {
        self.entry.legal = Legal::Each(ranges);
        self
    }

    /// Makes the value a text of up to eight characters.
    #[must_use]
    pub const fn text(mut self) -> Self {
        self.entry.legal = Legal::Text;
        self.shaped(Shape::Words(4))
    }

    /// Declares that the factory value means "nothing is set" and is outside the range of a write.
    #[must_use]
    pub const fn unset(mut self) -> Self {
        self.unset = true;
        self
    }

    /// Makes the row accept all values. The drive limits the value to `least..=greatest` when it uses it.
    #[must_use]
    pub const fn clamped(mut self, least: i64, greatest: i64) -> Self {
        self.entry.clamp = Some((least, greatest));
        self
    }

    /// Sets the factory value. Without this it is 0.
    #[must_use]
    pub const fn reset(mut self, value: i64) -> Self {
        self.entry.reset = value;
        self
    }

    /// Makes a save store the value.
    #[must_use]
    pub const fn saved(self) -> Self {
        self.saved_bits(u16::MAX)
    }

    /// Makes a save store only the bits in `mask` of each word.
    #[must_use]
    pub const fn saved_bits(mut self, mask: u16) -> Self {
        self.entry.saved = mask;
        self
    }

    /// Makes the drive update the value before each read.
    #[must_use]
    pub const fn live(mut self) -> Self {
        self.entry.live = true;
        self
    }

    /// Allows the bus to have the value streamed, that is, sent repeatedly.
    #[must_use]
    pub const fn streams(mut self) -> Self {
        self.entry.streams = true;
        self
    }

    /// Limits the row to these variants of the product, one bit each.
    #[must_use]
    pub const fn only(mut self, variants: u8) -> Self {
        self.entry.variants = variants;
        self
    }

    /// Makes the row present only at times. The drive decides when.
    #[must_use]
    pub const fn optional(mut self) -> Self {
        self.entry.optional = true;
        self
    }

    /// Makes the register also a coil at the same address.
    #[must_use]
    pub const fn also_coil(mut self) -> Self {
        self.entry.also = Some(Space::Coil);
        self
    }

    /// Makes the register also a discrete input at the same address.
    #[must_use]
    pub const fn also_discrete(mut self) -> Self {
        self.entry.also = Some(Space::Discrete);
        self
    }

    /// Declares that the value is stored and read back, but has no effect, and the reason.
    #[must_use]
    pub const fn not_modelled(mut self, reason: &'static str) -> Self {
        self.missing = reason;
        self
    }
}

impl Entry {
    /// Returns true if a write may have `value`.
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

    /// `value` limited to the row's clamp: the value that takes effect.
    #[must_use]
    pub const fn clamped_value(&self, value: i64) -> i64 {
        match self.clamp {
            Some((least, _)) if value < least => least,
            Some((_, greatest)) if value > greatest => greatest,
            _ => value,
        }
    }

    /// Returns true if the row is in `space`, by its own space or by its second one.
    #[must_use]
    pub const fn is_in(&self, space: Space) -> bool {
        self.space as u8 == space as u8 || matches!(self.also, Some(also) if also as u8 == space as u8)
    }

    /// Returns true if a drive may lack the row, because only some variants have it or because it is present
    /// only at times.
    #[must_use]
    pub const fn is_conditional(&self) -> bool {
        self.optional || self.variants != u8::MAX
    }

    /// Number of addresses of the row.
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

/// True if a [`Table`] has its rows. No board needs their texts, so an image does not have them.
const HAS_ROWS: bool = cfg!(feature = "rows");

/// A whole register map.
#[derive(Debug)]
pub struct Table {
    /// Rows, in the manual's order; none without the feature `rows`.
    pub rows: &'static [Row],
    /// The part of the rows that the bus and the drive need.
    pub entries: &'static Entries,
    /// A number for the names of the rows: it differs if a row has been added, moved or renamed.
    pub names: u16,
}

impl Deref for Table {
    type Target = Entries;

    fn deref(&self) -> &Entries {
        self.entries
    }
}

/// The part of a [`Table`] that the bus and the drive need.
#[derive(Debug)]
pub struct Entries {
    /// Entries in the order of the rows.
    pub list: &'static [Entry],
    /// Use of addresses in the map.
    pub layout: Layout,
    /// Index in the bank of each row's first word.
    offsets: &'static [u16],
    /// Ranges of addresses that one read may cover.
    ranges: &'static [AddressRange],
    /// True if any row is live.
    live: bool,
    /// True if a drive may lack a row.
    conditional: bool,
}

/// A row, or one word of a row, found by its name.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Named {
    /// Index of the row.
    pub row: usize,
    /// The word of the row that the name means (`SpeedHigh`), in bus order; `None` for the whole row.
    pub word: Option<u16>,
}

impl Table {
    /// A map without rows.
    pub const EMPTY: Self = Self::new(&[], &Entries::new(&[], Layout::HighFirst, &[], &[]));

    /// The map of these rows and their entries.
    #[must_use]
    pub const fn new(rows: &'static [Row], entries: &'static Entries) -> Self {
        let (mut names, mut rest) = (0_u16, rows);
        while let [row, more @ ..] = rest {
            names = names.rotate_left(1) ^ rtu::crc(row.name.as_bytes());
            rest = more;
        }
        Self { rows: if HAS_ROWS { rows } else { &[] }, entries, names }
    }

    /// The same map with other rows, which have the same shapes and addresses. For a variant of a product
    /// with other factory values.
    #[must_use]
    pub const fn with_rows(&self, rows: &'static [Row]) -> Self {
        Self::new(rows, self.entries)
    }

    /// The row `name`, or the high or low word of a row if `name` ends in `High` or `Low`.
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
    /// The same map with other entries, which have the same shapes and addresses. For a variant of a product
    /// with other limits.
    #[must_use]
    pub const fn with_list(&self, list: &'static [Entry]) -> Self {
        Self { list, ..*self }
    }

    /// Constructor for [`registers!`](crate::registers!).
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

    /// Index in the bank of a row's first word.
    #[must_use]
    #[inline]
    pub fn offset(&self, row: usize) -> usize {
        self.offsets.get(row).copied().map_or(usize::MAX, usize::from)
    }

    /// Indices in the bank of the words that a read returns: of `count` addresses from `first` on, or of the
    /// object at `first` with `count` words. `None` if an address cannot be read, or if the object does not
    /// have `count` words.
    #[must_use]
    pub fn readable(&self, space: Space, first: u16, count: u16) -> Option<Range<usize>> {
        for range in self.ranges {
            let skipped = first.wrapping_sub(range.first);
            if skipped < range.addresses && range.space == space {
                // For an object, `count` is its words; otherwise `count` is a number of addresses.
                let (skipped, room) =
                    if self.layout.objects { (0, range.words) } else { (skipped, range.addresses - skipped) };
                let whole = if self.layout.objects { count == room } else { count <= room };
                let start = usize::from(range.offset) + usize::from(skipped);
                return whole.then_some(start..start + usize::from(count));
            }
        }
        None
    }

    /// The row that contains `address`, and the word of the row at this address.
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

    /// The value of a row in the bank `words`.
    #[must_use]
    pub fn value(&self, words: &[u16], row: usize) -> i64 {
        let Some(shape) = self.list.get(row).map(|row| row.shape) else { return 0 };
        let offset = self.offset(row);
        self.assemble(shape, |n| words.get(offset.wrapping_add(n)).copied().unwrap_or(0))
    }

    /// The value of a shape; `word` returns its words, in bus order. If there are more than four words, only
    /// the first four are used.
    #[must_use]
    pub fn assemble(&self, shape: Shape, word: impl Fn(usize) -> u16) -> i64 {
        let value = self.words_from_high(shape).fold(0, |value, n| value << 16 | i64::from(word(n)));
        match shape {
            Shape::I16 => i64::from(value as i16),
            Shape::I32 => i64::from(value as i32),
            _ => value,
        }
    }

    /// Word `n`, in bus order, of the value of a shape; 0 if there is no such word.
    #[must_use]
    pub fn word(&self, shape: Shape, value: i64, n: usize) -> u16 {
        let upward = self.words_from_high(shape).rev().position(|offset| offset == n);
        upward.map_or(0, |offset| (value >> (16 * offset) & 0xFFFF).cast_unsigned() as u16)
    }

    /// Stores `value` into a row's words in the bank, truncated to the row's shape.
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

    /// Indices, in bus order, of a value's words, from the highest word to the lowest.
    fn words_from_high(&self, shape: Shape) -> impl DoubleEndedIterator<Item = usize> {
        let count = usize::from(shape.words()).min(4);
        let low_first = self.layout.order == Order::LowFirst;
        (0..count).map(move |n| if low_first { count - 1 - n } else { n })
    }

    /// Returns true if any row must be updated before it is read.
    #[must_use]
    pub fn has_live(&self) -> bool {
        self.live
    }

    /// The live rows that have words at these indices of the bank.
    pub fn live_rows_at(&self, offsets: &Range<usize>) -> impl Iterator<Item = usize> + use<'_> {
        self.rows_at(offsets, |row| row.live)
    }

    /// Returns true if a drive may lack any row.
    #[must_use]
    pub fn has_conditional(&self) -> bool {
        self.conditional
    }

    /// The rows with words at these indices of the bank that a drive may lack.
    pub fn conditional_rows_at(&self, offsets: &Range<usize>) -> impl Iterator<Item = usize> + use<'_> {
        self.rows_at(offsets, Entry::is_conditional)
    }

    fn rows_at<F: Fn(&Entry) -> bool>(
        &self,
        offsets: &Range<usize>,
        which: F,
    ) -> impl Iterator<Item = usize> + use<'_, F> {
        let (start, end) = (offsets.start, offsets.end);
        // Offsets ascend, so the first of these rows is the last row that begins at or before `start`.
        let first = self.offsets.partition_point(|&offset| usize::from(offset) <= start).saturating_sub(1);
        let rows = self.list.iter().enumerate().skip(first);
        let rows = rows.take_while(move |&(index, _)| self.offset(index) < end);
        rows.filter_map(move |(index, row)| {
            let touched = start < self.offset(index) + usize::from(row.shape.words());
            (which(row) && touched).then_some(index)
        })
    }
}

/// The enum of a register map. [`registers!`](crate::registers!) implements this trait.
pub trait Register: Copy + 'static {
    /// The map whose rows the enum names.
    const TABLE: &'static Table;
    /// The part of the map that the bus and the drive need.
    const ENTRIES: &'static Entries;

    /// Index of the row.
    fn row(self) -> usize;

    /// The register of a row; `None` if there is no such row.
    fn from_row(row: usize) -> Option<Self>;
}

/// The storage of a register map: words in the order of the bus, so that a read copies a slice.
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

    /// The value of a register as it takes effect: limited to its row's clamp.
    #[must_use]
    pub fn clamped_value(&self, register: R) -> i64 {
        let value = self.get(register);
        R::ENTRIES.list.get(register.row()).map_or(value, |row| row.clamped_value(value))
    }

    /// The first word of a register. This is the whole value if the register has one word.
    #[must_use]
    pub fn word(&self, register: R) -> u16 {
        self.words.get(R::ENTRIES.offset(register.row())).copied().unwrap_or(0)
    }

    /// Sets a register without any check.
    pub fn set(&mut self, register: R, value: i64) {
        R::ENTRIES.put(&mut self.words, register.row(), value);
    }

    /// All words, in the order of the table.
    #[must_use]
    pub fn words(&self) -> &[u16] {
        &self.words
    }

    /// All words, in the order of the table, writable without any check.
    pub fn words_mut(&mut self) -> &mut [u16] {
        &mut self.words
    }
}

/// Checks a whole table at compile time and panics at the first error.
#[doc(hidden)]
#[expect(clippy::panic, clippy::indexing_slicing, reason = "only ever evaluated by the compiler")]
pub const fn check(rows: &[Row], layout: Layout) {
    let mut i = 0;
    while i < rows.len() {
        let Row { doc, section, fields, unset, entry: row, .. } = &rows[i];
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
        check_fields(fields, row.shape);
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

/// Checks the fields of a row at compile time.
#[expect(clippy::panic, clippy::indexing_slicing, reason = "only ever evaluated by the compiler")]
const fn check_fields(fields: &[Field], shape: Shape) {
    let mut seen: u16 = 0;
    let mut i = 0;
    while i < fields.len() {
        let field = &fields[i];
        if field.high > 15 || field.low > field.high || !matches!(shape, Shape::U8 | Shape::U16) {
            panic!("a field is in a register of one word, its highest bit first");
        }
        let mask = field.greatest() << field.low;
        if seen & mask != 0 {
            panic!("two fields share a bit");
        }
        seen |= mask;
        let mut j = 0;
        while j < field.values.len() {
            if field.values[j].0 > field.greatest() {
                panic!("a value does not fit into its field");
            }
            j += 1;
        }
        i += 1;
    }
}

/// Returns true if two rows have a space in common.
const fn share_a_space(row: &Entry, other: &Entry) -> bool {
    row.is_in(other.space) || matches!(other.also, Some(also) if row.is_in(also))
}

/// The entries of a map's rows.
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

/// Number of words in the bank of a map.
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

/// Number of words of a map that a save stores.
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

/// Index in the bank of each row's first word.
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

/// The contiguous readable ranges of a map.
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

/// Space of a row in which to look: its own, or the second one, of bits.
#[derive(Clone, Copy)]
enum View {
    Own,
    Also,
}

/// Both views.
const VIEWS: &[View] = &[View::Own, View::Also];

/// Space in which the bus may read a row; `None` if the bus may not.
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

/// Declares a register map: an enum with a variant for each row, and its [`Table`].
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
/// A factory value that its own row refuses does not compile:
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
/// Two fields that share a bit do not compile:
///
/// ```compile_fail
/// drivetwin_protocol::registers! {
///     /// A map.
///     pub enum Reg: HighFirst {
///         /// Settings of the line.
///         Line = rw(0x1c, "1").fields(&[
///             drivetwin_protocol::registers::Field::bits(5, 3, "parity"),
///             drivetwin_protocol::registers::Field::bit(3, "stop bits"),
///         ]),
///     }
/// }
/// # fn main() { let _ = Reg::Line; }
/// ```
///
/// A register that is also a coil, at the address of another coil, does not compile:
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
            /// Number of words in the map's bank.
            $vis const WORDS: usize = $crate::registers::word_count(&Self::ROWS);
            /// Number of the map's words that a save stores.
            $vis const SAVED_WORDS: usize = $crate::registers::saved_word_count(&Self::ROWS);
        }

        const _: () = $crate::registers::check(&$Reg::ROWS, $Reg::LAYOUT);

        impl $crate::registers::Register for $Reg {
            const TABLE: &'static $crate::registers::Table = {
                static ROWS: [$crate::registers::Row; $Reg::ROWS.len()] = $Reg::ROWS;
                static TABLE: $crate::registers::Table =
                    $crate::registers::Table::new(&ROWS, $Reg::ENTRIES);
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
