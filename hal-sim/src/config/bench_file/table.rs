//! Tables of a bench file: their keys, and values of the required type, each with its position.

use toml::Spanned;
use toml::de::{DeInteger, DeTable, DeValue};

use super::expand::Filled;
use crate::config::preset::Number;
use crate::suggest;

/// An error at a byte offset of the text.
#[derive(Debug)]
pub(super) struct LocatedError {
    pub(super) at: usize,
    pub(super) what: String,
}

impl LocatedError {
    /// Adds a position to an error message.
    pub(super) fn at(at: usize) -> impl Fn(String) -> Self {
        move |what| Self { at, what }
    }
}

/// A value, and its byte offset in the text.
#[derive(Clone, Copy, Debug)]
pub(super) struct Located<T> {
    pub(super) is: T,
    pub(super) at: usize,
}

impl<T> Located<T> {
    /// An error at this value.
    pub(super) fn wrong(&self, what: impl Into<String>) -> LocatedError {
        LocatedError { at: self.at, what: what.into() }
    }
}

/// A table.
#[derive(Clone, Copy)]
pub(super) struct Table<'a> {
    /// Name of the table in error messages.
    what: &'static str,
    /// Byte offset of the start of the table.
    pub(super) at: usize,
    keys: &'a DeTable<'a>,
    /// Strings that had a placeholder.
    filled: &'a Filled,
}

impl<'a> Table<'a> {
    /// A table. A key that is not in `known` is an error.
    pub(super) fn new(
        what: &'static str,
        at: usize,
        keys: &'a DeTable<'a>,
        filled: &'a Filled,
        known: &[&str],
    ) -> Result<Self, LocatedError> {
        let table = Self { what, at, keys, filled };
        let unknown = table.keys().into_iter().find(|key| !known.contains(&key.is));
        unknown.map_or(Ok(table), |key| {
            Err(key.wrong(suggest::unknown(&format!("key of {what}"), key.is, known.iter().copied())))
        })
    }

    /// The tables under a key that may occur several times, like `[[drive]]`.
    pub(super) fn each(
        &self,
        key: &str,
        what: &'static str,
        known: &[&str],
    ) -> Result<Vec<Table<'a>>, LocatedError> {
        let Some(value) = self.keys.get(key) else { return Ok(Vec::new()) };
        let wrong = |value: &Spanned<DeValue<'_>>| LocatedError {
            at: value.span().start,
            what: format!("{key} is written {what}, above its keys"),
        };
        let DeValue::Array(tables) = value.get_ref() else { return Err(wrong(value)) };
        let tables = tables.iter().map(|value| match value.get_ref() {
            DeValue::Table(keys) => Self::new(what, value.span().start, keys, self.filled, known),
            _ => Err(wrong(value)),
        });
        tables.collect()
    }

    /// The tables of a list, `[{ … }, { … }]`, each called `what` in error messages.
    pub(super) fn tables(
        &self,
        key: &str,
        what: &'static str,
        known: &[&str],
    ) -> Result<Option<Vec<Table<'a>>>, LocatedError> {
        let wants = || "a list of tables, like [{ … }]".to_owned();
        let Some(list) = self.get(key, wants, DeValue::as_array)? else { return Ok(None) };
        let tables = list.is.iter().map(|value| match value.get_ref() {
            DeValue::Table(keys) => Self::new(what, value.span().start, keys, self.filled, known),
            other => {
                let not = format!("{key} takes {}, and {} is not one", wants(), shown(other));
                Err(LocatedError { at: value.span().start, what: not })
            }
        });
        tables.collect::<Result<_, _>>().map(Some)
    }

    /// All keys, in the order of the text.
    pub(super) fn keys(&self) -> Vec<Located<&'a str>> {
        let keys = self.keys.keys().map(|key| Located { is: key.get_ref().as_ref(), at: key.span().start });
        let mut keys: Vec<_> = keys.collect();
        keys.sort_by_key(|key| key.at);
        keys
    }

    /// The first key in the text that is one of `keys`.
    pub(super) fn any_of(&self, keys: &[&str]) -> Option<Located<&'a str>> {
        self.keys().into_iter().find(|key| keys.contains(&key.is))
    }

    /// Returns true if the value of a key is a table.
    pub(super) fn is_table(&self, key: &str) -> bool {
        self.keys.get(key).is_some_and(|value| value.get_ref().as_table().is_some())
    }

    /// Returns true if the value of a key is `true` or `false`.
    pub(super) fn is_flag(&self, key: &str) -> bool {
        self.keys.get(key).is_some_and(|value| value.get_ref().as_bool().is_some())
    }

    /// Returns `value`; without a value, an error that the table needs the key.
    pub(super) fn needs<T>(&self, key: &str, value: Option<T>) -> Result<T, LocatedError> {
        value.ok_or_else(|| LocatedError { at: self.at, what: format!("{} needs '{key}'", self.what) })
    }

    /// The value of a key as `read` converts it. If `read` returns `None`, the error names the required type.
    fn get<T>(
        &self,
        key: &str,
        wants: impl FnOnce() -> String,
        read: impl FnOnce(&'a DeValue<'a>) -> Option<T>,
    ) -> Result<Option<Located<T>>, LocatedError> {
        let Some(value) = self.keys.get(key) else { return Ok(None) };
        let at = value.span().start;
        let is = read(value.get_ref()).ok_or_else(|| LocatedError {
            at,
            what: format!("{key} takes {}, not {}", wants(), shown(value.get_ref())),
        });
        is.map(|is| Some(Located { is, at }))
    }

    /// The value of a key that is not a string, as `read` converts it. A string that had a placeholder is read
    /// as the value that it stands for.
    fn get_plain<T>(
        &self,
        key: &str,
        wants: impl FnOnce() -> String,
        read: impl FnOnce(&DeValue<'_>) -> Option<T>,
    ) -> Result<Option<Located<T>>, LocatedError> {
        let Some(value) = self.keys.get(key) else { return Ok(None) };
        match value.get_ref() {
            DeValue::String(text) if self.filled.contains(&value.span().start) => {
                let at = value.span().start;
                let is = DeValue::parse(text).ok().and_then(|value| read(value.get_ref()));
                let wrong = || LocatedError { at, what: format!("{key} takes {}, not '{text}'", wants()) };
                is.map(|is| Some(Located { is, at })).ok_or_else(wrong)
            }
            _ => self.get(key, wants, read),
        }
    }

    /// The value of a key that takes a string.
    pub(super) fn text(&self, key: &str) -> Result<Option<Located<&'a str>>, LocatedError> {
        self.get(key, || "a string".to_owned(), DeValue::as_str)
    }

    /// The value of a required key that takes a string.
    pub(super) fn needed_text(&self, key: &str) -> Result<Located<&'a str>, LocatedError> {
        self.needs(key, self.text(key)?)
    }

    /// The value of a key that takes a list of strings.
    pub(super) fn texts(&self, key: &str) -> Result<Option<Located<Vec<Located<&'a str>>>>, LocatedError> {
        let wants = || "a list of strings".to_owned();
        let Some(list) = self.get(key, wants, DeValue::as_array)? else { return Ok(None) };
        let texts = list.is.iter().map(|value| {
            let at = value.span().start;
            let what = || format!("{key} takes {}, and {} is not one", wants(), shown(value.get_ref()));
            value
                .get_ref()
                .as_str()
                .map(|is| Located { is, at })
                .ok_or_else(|| LocatedError { at, what: what() })
        });
        Ok(Some(Located { is: texts.collect::<Result<_, _>>()?, at: list.at }))
    }

    /// The value of a key that takes `true` or `false`.
    pub(super) fn flag(&self, key: &str) -> Result<Option<Located<bool>>, LocatedError> {
        self.get_plain(key, || "true or false".to_owned(), |value| value.as_bool())
    }

    /// The value of a key that takes a whole number from `least` to `greatest`.
    pub(super) fn whole<T>(
        &self,
        key: &str,
        least: T,
        greatest: T,
    ) -> Result<Option<Located<T>>, LocatedError>
    where
        T: Copy + PartialOrd + TryFrom<i128> + std::fmt::Display,
    {
        let wants = || format!("a whole number from {least} to {greatest}");
        self.get_plain(key, wants, |value| {
            let value = T::try_from(whole(value.as_integer()?)?).ok()?;
            (least <= value && value <= greatest).then_some(value)
        })
    }

    /// The value of a key that takes a number from `least` to `greatest`.
    pub(super) fn number(
        &self,
        key: &str,
        least: f64,
        greatest: f64,
    ) -> Result<Option<Located<f64>>, LocatedError> {
        let wants = || format!("a number from {least} to {greatest}");
        self.get_plain(key, wants, |value| {
            let value = match value {
                DeValue::Integer(value) => whole(value)? as f64,
                DeValue::Float(value) => value.as_str().parse().ok()?,
                _ => return None,
            };
            (least..=greatest).contains(&value).then_some(value)
        })
    }

    /// The value of a key that takes any whole number.
    pub(super) fn integer(&self, key: &str) -> Result<Option<Located<Number>>, LocatedError> {
        self.get_plain(key, || "a whole number".to_owned(), integer)
    }

    /// The value of a key that takes any whole number or a list of them.
    pub(super) fn integers(&self, key: &str) -> Result<Option<Located<Number>>, LocatedError> {
        self.get_plain(
            key,
            || "a whole number or a list of them".to_owned(),
            |value| match value.as_array() {
                Some(list) => {
                    let words =
                        list.iter().map(|value| i64::try_from(whole(value.get_ref().as_integer()?)?).ok());
                    words.collect::<Option<_>>().map(Number::Words)
                }
                None => integer(value),
            },
        )
    }

    /// The table of a key. Inside, a key that is not in `known` is an error.
    pub(super) fn table(&self, key: &'static str, known: &[&str]) -> Result<Option<Table<'a>>, LocatedError> {
        let Some(keys) = self.any_table(key)? else { return Ok(None) };
        Self::new(key, keys.at, keys.keys, self.filled, known).map(Some)
    }

    /// The table of a key, with any keys inside.
    pub(super) fn any_table(&self, key: &'static str) -> Result<Option<Table<'a>>, LocatedError> {
        let keys = self.get(key, || "a table, like { … }".to_owned(), DeValue::as_table)?;
        Ok(keys.map(|keys| Table { what: key, at: keys.at, keys: keys.is, filled: self.filled }))
    }
}

/// A whole number; its bits if it is not decimal, like `0xFF`.
fn integer(value: &DeValue<'_>) -> Option<Number> {
    let integer = value.as_integer()?;
    let value = i64::try_from(whole(integer)?).ok()?;
    Some(if integer.radix() == 10 { Number::Decimal(value) } else { Number::Bits(value) })
}

fn whole(integer: &DeInteger<'_>) -> Option<i128> {
    i128::from_str_radix(integer.as_str(), integer.radix()).ok()
}

/// A value as text for the end of an error message.
fn shown(value: &DeValue<'_>) -> String {
    match value {
        DeValue::Integer(value) => value.to_string(),
        DeValue::Float(value) => value.to_string(),
        DeValue::Boolean(value) => value.to_string(),
        DeValue::String(_) => "a string".to_owned(),
        DeValue::Datetime(_) => "a date".to_owned(),
        DeValue::Array(_) => "a list".to_owned(),
        DeValue::Table(_) => "a table".to_owned(),
    }
}
