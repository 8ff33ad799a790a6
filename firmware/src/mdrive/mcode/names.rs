//! Labels and user variables, 192 at most together (MC 3.2.2, 5-40, 5-78).

use heapless::Vec;

use super::super::error::Error;

/// A name of one or two characters, in capitals. After a single character comes a blank.
pub(in crate::mdrive) type Name = [u8; 2];

/// Maximum number of names.
pub(in crate::mdrive) const MAX: usize = 192;

/// Meaning of a user's name.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) enum Meaning {
    /// LB: the address of the label's line.
    Label(u16),
    /// VA outside of a program: a variable that S saves.
    Global(i32),
    /// VA within a program: a variable that exists until a program is started again (MDRIVE-16).
    Local(i32),
}

/// All names of the user, in the order in which they were declared.
#[derive(Clone, Debug)]
pub(in crate::mdrive) struct Names {
    list: Vec<(Name, Meaning), MAX>,
}

impl Names {
    pub(in crate::mdrive) const fn new() -> Self {
        Self { list: Vec::new() }
    }

    pub(in crate::mdrive) fn find(&self, name: Name) -> Option<Meaning> {
        self.list.iter().find(|(known, _)| *known == name).map(|(_, meaning)| *meaning)
    }

    /// Value of a user variable, if there is one of this name.
    pub(in crate::mdrive) fn value(&self, name: Name) -> Option<i32> {
        match self.find(name)? {
            Meaning::Global(value) | Meaning::Local(value) => Some(value),
            Meaning::Label(_) => None,
        }
    }

    /// All names with their meanings.
    pub(in crate::mdrive) fn iter(&self) -> impl Iterator<Item = (Name, Meaning)> + '_ {
        self.list.iter().copied()
    }

    /// Checks that [`Self::add`] would take a name.
    ///
    /// # Errors
    /// Error 28 if the name exists, 31 if there is no room.
    pub(in crate::mdrive) fn has_room_for(&self, name: Name) -> Result<(), Error> {
        if self.find(name).is_some() {
            Err(Error::Redefined)
        } else if self.list.is_full() {
            Err(Error::LabelsFull)
        } else {
            Ok(())
        }
    }

    /// Adds a name.
    ///
    /// # Errors
    /// Error 28 if the name exists, 31 if there is no room.
    pub(in crate::mdrive) fn add(&mut self, name: Name, meaning: Meaning) -> Result<(), Error> {
        self.has_room_for(name)?;
        self.list.push((name, meaning)).map_err(|_| Error::LabelsFull)
    }

    /// Sets a user variable.
    ///
    /// # Errors
    /// That of [`unknown`] if the name does not exist, 32 if it is a label.
    pub(in crate::mdrive) fn set(&mut self, name: Name, value: i32) -> Result<(), Error> {
        match self.list.iter_mut().find(|(known, _)| *known == name) {
            None => Err(unknown(&name)),
            Some((_, Meaning::Label(_))) => Err(Error::IsLabel),
            Some((_, Meaning::Global(held) | Meaning::Local(held))) => {
                *held = value;
                Ok(())
            }
        }
    }

    /// Keeps only the names for which `keeps` is true.
    pub(in crate::mdrive) fn retain(&mut self, mut keeps: impl FnMut(Name, Meaning) -> bool) {
        self.list.retain(|(name, meaning)| keeps(*name, *meaning));
    }
}

/// A name of one or two characters in the form for comparison: in capitals, with a blank if it has one
/// character.
pub(in crate::mdrive) fn name(word: &[u8]) -> Option<Name> {
    match *word {
        [a] if a.is_ascii_alphabetic() => Some([a.to_ascii_uppercase(), b' ']),
        [a, b] if a.is_ascii_alphabetic() && b.is_ascii_alphanumeric() => {
            Some([a.to_ascii_uppercase(), b.to_ascii_uppercase()])
        }
        _ => None,
    }
}

/// Error for setting a name that does not exist: 10 if an I/O might have the name, else 20 (MC 9.1, 9.2).
pub(in crate::mdrive) fn unknown(name: &[u8]) -> Error {
    match name.trim_ascii_end() {
        [letter, number @ ..] if b"DIOSdios".contains(letter) && is_number(number) => Error::IllegalIo,
        _ => Error::Unknown,
    }
}

fn is_number(text: &[u8]) -> bool {
    !text.is_empty() && text.iter().all(u8::is_ascii_digit)
}
