//! Registers set by name, past the bus: `--set REG=VALUE` and the control API.

use standin_firmware::device::{Refused, Spec};
use standin_protocol::registers::{Legal, Order, Row, Shape};

use crate::nearest;

/// A value for a register, or for the high or low word of one.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Preset {
    /// Its row.
    pub row: usize,
    /// Which half is meant, if not the whole.
    half: Option<Half>,
    value: i64,
}

/// One word of a value of two.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Half {
    High,
    Low,
}

impl Preset {
    /// `value` for the register called `name`.
    ///
    /// # Errors
    /// One sentence: there is no such register, or it does not take the value.
    pub fn new(spec: &Spec, name: &str, value: Number) -> Result<Self, String> {
        let rows = spec.registers.rows;
        let found = spec.find(name);
        let (named, row) = found.and_then(|named| Some((named, rows.get(named.row)?))).ok_or_else(|| {
            if spec.registers.find(name).is_some() {
                return format!("{name} is a register of other variants; {} does not have it", spec.kind);
            }
            let what = format!("register of {}", spec.kind);
            nearest::unknown(&what, name, spec.rows().map(|(_, row)| row.name))
        })?;
        let half = named.word.map(|word| {
            let first_is_high = spec.registers.layout.order == Order::HighFirst;
            if (word == 0) == first_is_high { Half::High } else { Half::Low }
        });
        let shape = if half.is_some() { Shape::U16 } else { row.shape };
        let value = value.shaped(shape);
        let (least, greatest) = shape.limits();
        let legal = if half.is_some() { least <= value && value <= greatest } else { row.accepts(value) };
        if !legal {
            let takes = if half.is_some() { span(least, greatest) } else { takes(row) };
            return Err(format!("{name} takes {takes}, not {value}"));
        }
        Ok(Self { row: named.row, half, value })
    }

    /// Whether only a half is meant.
    pub fn is_half(&self) -> bool {
        self.half.is_some()
    }

    /// Whether a save keeps all that is set; of some registers it keeps some bits, and the others
    /// are forgotten until the drive has started.
    ///
    /// # Errors
    /// One sentence: which bits can be preset.
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
        Err(format!("of {} only {bits} can be preset, so it cannot be {}", row.name, self.value))
    }

    /// The register's new value, where `old` is its present one.
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

/// A number as somebody typed it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Number {
    /// A value.
    Decimal(i64),
    /// The bits of one: `0xFFFF` is −1 where the register is a signed word.
    Bits(i64),
}

impl Number {
    /// Reads `8000`, `-5` or `0x1F40`.
    pub fn parse(text: &str) -> Option<Self> {
        match text.strip_prefix("0x").or_else(|| text.strip_prefix("0X")) {
            // Not `0x-5`, which `from_str_radix` would take.
            Some(digits) if digits.starts_with(['+', '-']) => None,
            Some(digits) => i64::from_str_radix(digits, 16).ok().map(Self::Bits),
            None => text.parse().ok().map(Self::Decimal),
        }
    }

    /// As a value of that shape; bits that it does not hold stay, so that it is refused.
    fn shaped(self, shape: Shape) -> i64 {
        match (self, shape) {
            (Self::Bits(bits), Shape::I16) => {
                u16::try_from(bits).map_or(bits, |word| word.cast_signed().into())
            }
            (Self::Bits(bits), Shape::I32) => {
                u32::try_from(bits).map_or(bits, |pair| pair.cast_signed().into())
            }
            (Self::Bits(value) | Self::Decimal(value), _) => value,
        }
    }
}

/// What a row takes, in words.
fn takes(row: &Row) -> String {
    match row.legal {
        Legal::Any => {
            let (least, greatest) = row.shape.limits();
            span(least, greatest)
        }
        Legal::Range(least, greatest) => span(least, greatest),
        Legal::OneOf(codes) => {
            let codes: Vec<String> = codes.iter().map(ToString::to_string).collect();
            format!("one of {}", codes.join(", "))
        }
    }
}

fn span(least: i64, greatest: i64) -> String {
    format!("{least} to {greatest}")
}

/// Why a drive does not take a preset, as the end of a sentence.
pub fn why(refused: Refused) -> &'static str {
    match refused {
        Refused::NoSuchRegister => "the drive has no such register",
        Refused::ReadOnly => "the drive sets it itself",
        Refused::OutOfRange => "the drive does not take the value",
        Refused::BadMemory => "the drive's memory is bad, so what is saved there cannot be changed",
        Refused::Busy => "the drive cannot do that while it does what it does now",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    standin_protocol::registers! {
        /// A toy's map.
        enum Reg: HighFirst {
            /// Bus address.
            DeviceAddress = rw(0x00, "1").reset(1).range(1, 247).saved(),
            /// Steps per second.
            Speed = rw(0x14, "2").i32().reset(5_000).saved(),
            /// A code.
            Mode = rw(0x20, "3").one_of(&[0, 3]),
            /// Some of it is saved.
            Control = rw(0x21, "4").saved_bits(0x0020),
            /// Only of another variant.
            Jog = rw(0x22, "5").only(2),
        }
    }

    fn spec() -> Spec {
        use standin_protocol::registers::Register;
        let _ = (Reg::WORDS, Reg::DeviceAddress, Reg::Speed, Reg::Mode, Reg::Control, Reg::Jog);
        Spec { kind: "toy", registers: Reg::TABLE, variant: 1, address: Some(0), ..Spec::BARE }
    }

    fn preset(name: &str, value: &str) -> Result<Preset, String> {
        Preset::new(&spec(), name, Number::parse(value).unwrap())
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
    fn bits_that_are_not_saved_cannot_be_preset() {
        let check = |name: &str, value: &str| preset(name, value).unwrap().check_saved(&spec());
        assert_eq!(check("Control", "0x20"), Ok(()));
        assert_eq!(
            check("Control", "1").unwrap_err(),
            "of Control only bit 5 can be preset, so it cannot be 1"
        );
        assert_eq!(check("Speed", "-1"), Ok(()));
        assert_eq!(check("Mode", "3"), Ok(()), "it is set after every power-on");
    }

    #[test]
    fn what_a_row_does_not_take_is_said_with_what_it_takes() {
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
            "there is no register of toy 'Jo'; what there is: DeviceAddress, Speed, Mode, Control"
        );
    }
}
