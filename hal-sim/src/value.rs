//! A register's value as users see it.

use std::fmt;

use drivetwin_protocol::registers::{Entries, Shape};
use serde::{Deserialize, Serialize};

/// A number; or a list of words of 0 to 65,535 in bus order, if each word of the register has its own
/// meaning.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
#[serde(untagged, expecting = "a register takes a whole number, or a list of them,")]
pub enum Value {
    /// A number.
    Number(i64),
    /// Words.
    Words(Vec<i64>),
}

impl Value {
    /// The value of a register of up to four words.
    #[must_use]
    pub fn of(entries: &Entries, shape: Shape, value: i64) -> Self {
        Self::with_words(shape, value, |n| entries.word(shape, value, n))
    }

    /// The value of a register of this shape. It is the number `value`, or for [`Shape::Words`] the list of the
    /// words in bus order. `word` gives a word by its index.
    #[must_use]
    pub fn with_words(shape: Shape, value: i64, word: impl Fn(usize) -> u16) -> Self {
        match shape {
            Shape::Words(count) => Self::Words((0..count.into()).map(|n| word(n).into()).collect()),
            _ => Self::Number(value),
        }
    }
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(value) => value.fmt(f),
            Self::Words(words) => {
                let words: Vec<_> = words.iter().map(ToString::to_string).collect();
                f.write_str(&words.join(", "))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_in_bus_order() {
        use drivetwin_firmware::{md3, mdrobot};
        use drivetwin_protocol::registers::Register;
        let words = |first: i64, second: i64| Value::Words(vec![first, second]);
        // MDROBOT: a run time of 1 s follows the speed of 1,000 rpm (p. 16). The MD3 sends the high word
        // first.
        assert_eq!(Value::of(mdrobot::Pid::ENTRIES, Shape::Words(2), 10 << 16 | 1_000), words(1_000, 10));
        assert_eq!(Value::of(md3::Reg::ENTRIES, Shape::Words(2), 10 << 16 | 1_000), words(10, 1_000));
        assert_eq!(Value::of(md3::Reg::ENTRIES, Shape::I32, -5), Value::Number(-5));
        assert_eq!(words(1_000, 10).to_string(), "1000, 10");
    }
}
