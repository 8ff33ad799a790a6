//! Presets: registers set by name, not through the bus, with `--set REG=VALUE` and the control API.

use std::iter::repeat;

use drivetwin_firmware::device::{PresetError, Spec};
use drivetwin_protocol::registers::{self, Entries, Legal, Order, Row, Shape};

use crate::suggest;
use crate::value::Value;

/// A value for a register, or for the high or low word of one.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Preset {
    /// Row of the register map.
    pub row: usize,
    /// Half of the register to set; `None`: the whole register.
    half: Option<Half>,
    value: i64,
}

/// Half of a value: one word of two.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Half {
    High,
    Low,
}

impl Preset {
    /// Preset of `value` for the register called `name`.
    ///
    /// # Errors
    /// One sentence that says what is wrong: there is no such register, or the register does not take the
    /// value.
    pub fn new(spec: &Spec, name: &str, value: &Number) -> Result<Self, String> {
        let Place { row, half, shape, is } = Place::find(spec, name)?;
        let (least, greatest) = shape.limits();
        let legal = |&value: &i64| match half {
            Some(_) => least <= value && value <= greatest,
            None => is.accepts(value),
        };
        let value = value.shaped(spec.registers, shape).filter(legal).ok_or_else(|| {
            let value = value.shown(spec.registers, shape);
            format!("{name} takes {}, not {value}", takes(is, half))
        })?;
        Ok(Self { row, half, value })
    }

    /// Presets for `text`, as typed by a user, for the register or the rows of text called `name`.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn typed(spec: &Spec, name: &str, text: &str) -> Result<Vec<Self>, String> {
        if let Some(presets) = Self::text(spec, name, text) {
            return presets;
        }
        let Some(number) = Number::parse(text) else {
            let Place { half, is, .. } = Place::find(spec, name)?;
            return Err(format!("{name} takes {}, not '{}'", takes(is, half), text.escape_debug()));
        };
        Self::new(spec, name, &number).map(|preset| vec![preset])
    }

    /// Presets of `text` for the rows of text called `name`, or `name` followed by 1, 2 and so on; `None` if there are
    /// no such rows.
    pub fn text(spec: &Spec, name: &str, text: &str) -> Option<Result<Vec<Self>, String>> {
        let rows: Vec<usize> = text_rows(spec, name).collect();
        let most = CHARACTERS * rows.len();
        if rows.is_empty() {
            return None;
        }
        let fits = (1..=most).contains(&text.len()) && text.bytes().all(|byte| matches!(byte, b' '..=b'~'));
        if !fits {
            let text = text.escape_debug();
            return Some(Err(format!(
                "{name} takes 1 to {most} printable characters of ASCII, not '{text}'"
            )));
        }
        let parts = text.as_bytes().chunks(CHARACTERS).chain(repeat(&[][..]));
        let presets = rows.iter().zip(parts);
        Some(Ok(presets.map(|(&row, part)| Self { row, half: None, value: registers::text(part) }).collect()))
    }

    /// Returns true if the preset sets only a half of the register.
    pub fn is_half(&self) -> bool {
        self.half.is_some()
    }

    /// Checks that a save stores all bits of the preset. Some registers save only some of their bits; the
    /// other bits would be lost before the drive has started.
    ///
    /// # Errors
    /// One sentence that names the bits that can be preset.
    pub fn check_saved(&self, spec: &Spec) -> Result<(), String> {
        let Some(row) = spec.registers.rows.get(self.row) else { return Ok(()) };
        let word = i64::from(row.saved);
        let both = word << 16 | word;
        if row.saved == 0 || row.saved == u16::MAX || self.value & 0xFFFF_FFFF & !both == 0 {
            return Ok(());
        }
        let bits = (0..16).filter(|bit| row.saved >> bit & 1 == 1).map(|bit: u32| bit.to_string());
        let bits: Vec<String> = bits.collect();
        let bits = format!("bit{} {}", if bits.len() == 1 { "" } else { "s" }, bits.join(", "));
        Err(format!("only {bits} of {} can be preset; {} has other bits", row.name, self.value))
    }

    /// New value of a register whose present value is `old`.
    pub fn onto(&self, spec: &Spec, old: i64) -> i64 {
        let pair = match self.half {
            None => return self.value,
            Some(Half::High) => self.value << 16 | old & 0xFFFF,
            Some(Half::Low) => old & 0xFFFF_0000 | self.value,
        };
        let signed = spec.registers.rows.get(self.row).is_some_and(|row| row.shape == Shape::I32);
        if signed { i64::from(pair as i32) } else { pair }
    }
}

/// Register, or half of a register, that a name means.
struct Place {
    row: usize,
    half: Option<Half>,
    /// Shape of the half, or of the whole register.
    shape: Shape,
    is: &'static Row,
}

impl Place {
    fn find(spec: &Spec, name: &str) -> Result<Self, String> {
        let found = spec.find(name);
        let rows = spec.registers.rows;
        let (named, is) = found.and_then(|named| Some((named, rows.get(named.row)?))).ok_or_else(|| {
            if spec.registers.find(name).is_some() {
                return format!("{name} is a register of other variants; {} does not have it", spec.kind);
            }
            let what = format!("register of {}", spec.kind);
            // The names in the message have the prefix if the user typed it.
            let prefix = if name.starts_with(spec.prefix) { spec.prefix } else { "" };
            let names: Vec<_> = spec.rows().map(|(_, row)| format!("{prefix}{}", row.name)).collect();
            suggest::unknown(&what, name, names.iter().map(String::as_str))
        })?;
        let half = named.word.map(|word| {
            let first_is_high = spec.registers.layout.order == Order::HighFirst;
            if (word == 0) == first_is_high { Half::High } else { Half::Low }
        });
        let shape = if half.is_some() { Shape::U16 } else { is.shape };
        Ok(Self { row: named.row, half, shape, is })
    }
}

/// Number of characters in a row of text.
const CHARACTERS: usize = 8;

/// The rows of text called `name`, or `name` followed by a digit from 1 to 9.
fn text_rows<'a>(spec: &'a Spec, name: &'a str) -> impl Iterator<Item = usize> + 'a {
    let is_part = move |row: &Row| {
        row.name.strip_prefix(name).is_some_and(|part| matches!(part.as_bytes(), [] | [b'1'..=b'9']))
    };
    spec.rows().filter(move |(_, row)| row.legal == Legal::Text && is_part(row)).map(|(index, _)| index)
}

/// A value as typed by a user.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Number {
    /// A number.
    Decimal(i64),
    /// The bits of a number: `0xFFFF` is −1 if the register is a signed word.
    Bits(i64),
    /// Words in bus order, for a register whose words have a meaning each.
    Words(Vec<i64>),
}

impl From<Value> for Number {
    fn from(value: Value) -> Self {
        match value {
            Value::Number(value) => Self::Decimal(value),
            Value::Words(words) => Self::Words(words),
        }
    }
}

impl Number {
    /// Reads `8000`, `-5`, `0x1F40`, or words like `1000,10`.
    pub fn parse(text: &str) -> Option<Self> {
        if text.contains(',') {
            let word = |text: &str| match Self::parse(text.trim())? {
                Self::Decimal(value) | Self::Bits(value) => Some(value),
                Self::Words(_) => None,
            };
            return text.split(',').map(word).collect::<Option<_>>().map(Self::Words);
        }
        match text.strip_prefix("0x").or_else(|| text.strip_prefix("0X")) {
            // `from_str_radix` would accept a sign, as in `0x-5`.
            Some(digits) if digits.starts_with(['+', '-']) => None,
            Some(digits) => i64::from_str_radix(digits, 16).ok().map(Self::Bits),
            None => text.parse().ok().map(Self::Decimal),
        }
    }

    /// Converts to a value of a shape. Excess bits are kept, so that the value is refused later. `None` if
    /// the number of words is wrong.
    fn shaped(&self, entries: &Entries, shape: Shape) -> Option<i64> {
        match (self, shape) {
            (Self::Words(words), Shape::Words(count)) => {
                let words: Option<Vec<u16>> = words.iter().map(|&word| bits_of(word)).collect();
                let words = words.filter(|words| words.len() == usize::from(count))?;
                Some(entries.assemble(shape, |n| words.get(n).copied().unwrap_or(0)))
            }
            (Self::Words(_), _) | (_, Shape::Words(_)) => None,
            (&Self::Bits(bits), Shape::I16) => {
                Some(u16::try_from(bits).map_or(bits, |word| word.cast_signed().into()))
            }
            (&Self::Bits(bits), Shape::I32) => {
                Some(u32::try_from(bits).map_or(bits, |pair| pair.cast_signed().into()))
            }
            (&Self::Bits(value) | &Self::Decimal(value), _) => Some(value),
        }
    }

    /// The value as text for messages.
    fn shown(&self, entries: &Entries, shape: Shape) -> String {
        match self {
            Self::Words(words) => Value::Words(words.clone()).to_string(),
            &(Self::Decimal(value) | Self::Bits(value)) => {
                self.shaped(entries, shape).unwrap_or(value).to_string()
            }
        }
    }
}

/// A word, which may also be written as a negative number.
fn bits_of(word: i64) -> Option<u16> {
    u16::try_from(word).ok().or_else(|| i16::try_from(word).ok().map(i16::cast_unsigned))
}

/// Legal values of a row, or of a half of a row, as text for messages.
fn takes(row: &Row, half: Option<Half>) -> String {
    if half.is_some() {
        let (least, greatest) = Shape::U16.limits();
        return span(least, greatest);
    }
    let (least, greatest) = row.shape.limits();
    match (row.legal, row.shape) {
        (Legal::Any, Shape::Words(count)) => format!("{count} words, each {}", span(0, u16::MAX.into())),
        (Legal::Any, _) => span(least, greatest),
        (Legal::Range(least, greatest), _) => span(least, greatest),
        (Legal::OneOf(codes), _) => {
            let codes: Vec<String> = codes.iter().map(ToString::to_string).collect();
            format!("one of {}", codes.join(", "))
        }
        (Legal::Text, _) => "text, or 4 words of it".into(),
        (Legal::Each(ranges), _) => {
            let each = ranges.iter().map(|&(least, greatest)| span(least.into(), greatest.into()));
            format!("{} words: {}", ranges.len(), each.collect::<Vec<_>>().join(", "))
        }
    }
}

fn span(least: i64, greatest: i64) -> String {
    format!("{least} to {greatest}")
}

/// The reason why a drive refuses a preset of a row, called `name` in the message, in one sentence.
pub fn refusal(spec: &Spec, row: usize, name: &str, refused: PresetError) -> String {
    let is_optional = spec.registers.rows.get(row).is_some_and(|row| row.optional);
    let why = match refused {
        PresetError::NoSuchRegister if is_optional => {
            "it exists only after a client or a program of the drive has declared it".to_owned()
        }
        PresetError::Busy => format!("{refused}; first preset the registers that it depends on"),
        _ => refused.to_string(),
    };
    format!("{name} cannot be preset: {why}")
}

#[cfg(test)]
mod tests {
    use super::*;

    drivetwin_protocol::registers! {
        /// A register map for tests.
        enum Reg: HighFirst {
            /// Bus address.
            DeviceAddress = rw(0x00, "1").reset(1).range(1, 247).saved(),
            /// Steps per second.
            Speed = rw(0x14, "2").i32().reset(5_000).saved(),
            /// A code.
            Mode = rw(0x20, "3").one_of(&[0, 3]),
            /// Only some bits are saved.
            Control = rw(0x21, "4").saved_bits(0x0020),
            /// Only in another variant.
            Jog = rw(0x22, "5").only(2),
        }
    }

    fn spec() -> Spec {
        use drivetwin_protocol::registers::Register;
        let _ = (Reg::WORDS, Reg::DeviceAddress, Reg::Speed, Reg::Mode, Reg::Control, Reg::Jog);
        Spec { kind: "toy", registers: Reg::TABLE, variant: 1, address: Some(0), ..Spec::EMPTY }
    }

    fn preset(name: &str, value: &str) -> Result<Preset, String> {
        Preset::new(&spec(), name, &Number::parse(value).unwrap())
    }

    #[test]
    fn numbers_are_decimal_or_hexadecimal() {
        assert_eq!(Number::parse("-5"), Some(Number::Decimal(-5)));
        assert_eq!(Number::parse("0x1f"), Some(Number::Bits(31)));
        assert_eq!(Number::parse("0x-5"), None);
        assert_eq!(Number::parse("5.0"), None);
        assert_eq!(Number::parse(""), None);
    }

    #[test]
    fn a_whole_value_replaces_a_half_changes_its_word() {
        let spec = spec();
        assert_eq!(preset("Speed", "-7").unwrap().onto(&spec, 5_000), -7);
        assert_eq!(preset("Speed", "0xFFFFFFFF").unwrap().onto(&spec, 5_000), -1);
        assert_eq!(preset("SpeedHigh", "0xFFFF").unwrap().onto(&spec, 5_000), -0x1_0000 + 5_000);
        assert_eq!(preset("SpeedLow", "2").unwrap().onto(&spec, -1), -0x1_0000 + 2);
    }

    #[test]
    fn words_are_a_list() {
        use drivetwin_firmware::mdrobot::Pid;
        use drivetwin_protocol::registers::Register;
        let spec = Spec { kind: "toy", registers: Pid::TABLE, prefix: "PID_", ..Spec::EMPTY };
        let set = |name: &str, value: &str| {
            let preset = Preset::new(&spec, name, &Number::parse(value).unwrap())?;
            Ok::<_, String>(preset.onto(&spec, 0))
        };
        // The low word comes first.
        assert_eq!(set("PID_FUNC_SPEED", "1000,10"), Ok(10 << 16 | 1_000));
        assert_eq!(set("FUNC_POSI", "0x5DC, -240"), Ok(0xFF10 << 16 | 1_500));
        assert_eq!(set("SPEED_LIMIT", "512,512"), Ok(512 << 16 | 512));
        for (name, value, sentence) in [
            ("FUNC_SPEED", "1000", "FUNC_SPEED takes 2 words, each 0 to 65535, not 1000"),
            ("FUNC_SPEED", "1,2,3", "FUNC_SPEED takes 2 words, each 0 to 65535, not 1, 2, 3"),
            ("FUNC_SPEED", "1,65536", "FUNC_SPEED takes 2 words, each 0 to 65535, not 1, 65536"),
            ("SPEED_LIMIT", "0,511", "SPEED_LIMIT takes 2 words: 0 to 512, 512 to 1023, not 0, 511"),
            ("MAX_RPM", "1,2", "MAX_RPM takes 0 to 65535, not 1, 2"),
            ("PID_MAX_RPN", "1", "there is no register of toy 'PID_MAX_RPN'; the nearest is 'PID_MAX_RPM'"),
        ] {
            assert_eq!(set(name, value).unwrap_err(), sentence);
        }
    }

    #[test]
    fn text_fills_the_rows_of_its_name() {
        use drivetwin_protocol::registers::{Register, text};
        drivetwin_protocol::registers! {
            /// A map in which a text has two rows.
            enum Named: HighFirst {
                /// First row of the text.
                Name1 = setting(1, "1").text().reset(text(b"ABCDEFGH")),
                /// Second row of the text.
                Name2 = setting(5, "1").text(),
                /// Another text, with one row.
                Short = setting(9, "1").text().only(1),
                /// Words, no text.
                Name3 = setting(13, "1").words(4),
            }
        }
        let _ = (Named::WORDS, Named::Name1, Named::Name2, Named::Short, Named::Name3);
        let spec = Spec { kind: "toy", registers: Named::TABLE, variant: 1, ..Spec::EMPTY };
        let set = |name: &str, value: &str| {
            let presets = Preset::text(&spec, name, value)?;
            Some(presets.map(|presets| presets.iter().map(|it| (it.row, it.value)).collect::<Vec<_>>()))
        };
        // "ABCDEFGH" and "I" are 41h to 49h.
        let halves = vec![(0, 0x4142_4344_4546_4748), (1, 0x4900_0000_0000_0000)];
        assert_eq!(set("Name", "ABCDEFGHI"), Some(Ok(halves)));
        assert_eq!(
            set("Name", "A"),
            Some(Ok(vec![(0, 0x4100_0000_0000_0000), (1, 0)])),
            "nothing is left of it"
        );
        assert_eq!(set("Short", "~ 1"), Some(Ok(vec![(2, 0x7E20_3100_0000_0000)])));
        assert_eq!(set("Name3", "A"), None);
        assert_eq!(set("Nam", "A"), None);
        for (name, value, sentence) in [
            ("Short", "123456789", "Short takes 1 to 8 printable characters of ASCII, not '123456789'"),
            ("Name", "", "Name takes 1 to 16 printable characters of ASCII, not ''"),
            ("Name", "a\tb", "Name takes 1 to 16 printable characters of ASCII, not 'a\\tb'"),
        ] {
            assert_eq!(set(name, value), Some(Err(sentence.into())));
        }
        let as_words = |value: &str| Preset::new(&spec, "Name1", &Number::parse(value).unwrap());
        assert!(as_words("0x4142,0x4300,0,0").is_ok());
        assert!(as_words("0x4142,0x0043,0,0").is_err(), "a gap");
    }

    #[test]
    fn bits_that_are_not_saved_cannot_be_preset() {
        let check = |name: &str, value: &str| preset(name, value).unwrap().check_saved(&spec());
        assert_eq!(check("Control", "0x20"), Ok(()));
        assert_eq!(
            check("Control", "1").unwrap_err(),
            "only bit 5 of Control can be preset; 1 has other bits"
        );
        assert_eq!(check("Speed", "-1"), Ok(()));
        assert_eq!(check("Mode", "3"), Ok(()), "it is set after every power-on");
    }

    #[test]
    fn a_value_that_is_not_a_number_is_refused_with_the_legal_values() {
        let typed = |name: &str, text: &str| Preset::typed(&spec(), name, text);
        assert_eq!(typed("Speed", "0x10"), Ok(vec![preset("Speed", "16").unwrap()]));
        for (name, text, sentence) in [
            ("DeviceAddress", "a", "DeviceAddress takes 1 to 247, not 'a'"),
            ("Mode", "", "Mode takes one of 0, 3, not ''"),
            ("SpeedLow", "5.0", "SpeedLow takes 0 to 65535, not '5.0'"),
            ("Sped", "fast", "there is no register of toy 'Sped'; the nearest is 'Speed'"),
        ] {
            assert_eq!(typed(name, text).unwrap_err(), sentence);
        }
    }

    #[test]
    fn an_illegal_value_is_refused_with_the_legal_values() {
        assert_eq!(preset("DeviceAddress", "300").unwrap_err(), "DeviceAddress takes 1 to 247, not 300");
        assert_eq!(preset("Mode", "1").unwrap_err(), "Mode takes one of 0, 3, not 1");
        assert_eq!(preset("SpeedHigh", "-1").unwrap_err(), "SpeedHigh takes 0 to 65535, not -1");
        assert_eq!(
            preset("Sped", "1").unwrap_err(),
            "there is no register of toy 'Sped'; the nearest is 'Speed'"
        );
        assert_eq!(
            preset("Jog", "1").unwrap_err(),
            "Jog is a register of other variants; toy does not have it"
        );
        assert_eq!(
            preset("Jo", "1").unwrap_err(),
            "there is no register of toy 'Jo'; available: DeviceAddress, Speed, Mode, Control"
        );
    }
}
