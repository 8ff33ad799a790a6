//! Contacts of the I/O that motion uses: home switch, limits, jog (MC 5-39, 5-43).

use crate::mdrive::error::Error;

/// Contacts that the motion uses, each of them active or not.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) enum Contact {
    Home,
    PlusLimit,
    MinusLimit,
    JogPlus,
    JogMinus,
}

/// Active contacts, one bit each.
#[derive(Clone, Copy, Debug)]
pub(super) struct Contacts(u8);

impl Contacts {
    pub(super) const NONE: Self = Self(0);

    /// Sets a contact active or inactive. Returns true if that is a change.
    pub(super) fn set(&mut self, contact: Contact, active: bool) -> bool {
        let changes = self.is_active(contact) != active;
        if changes {
            self.0 ^= bit(contact);
        }
        changes
    }

    pub(super) fn is_active(self, contact: Contact) -> bool {
        self.0 & bit(contact) != 0
    }

    /// Returns true if the limit in a direction is active.
    pub(super) fn is_at_limit(self, back: bool) -> bool {
        self.is_active(if back { Contact::MinusLimit } else { Contact::PlusLimit })
    }

    /// Returns true if the jog contact of a direction is active.
    pub(super) fn jogs(self, back: bool) -> bool {
        self.is_active(if back { Contact::JogMinus } else { Contact::JogPlus })
    }

    /// Direction of the jog that the contacts request, true for backward; `None` if neither or both are
    /// active (MC 5-39).
    pub(super) fn jog(self) -> Option<bool> {
        match (self.jogs(false), self.jogs(true)) {
            (true, false) => Some(false),
            (false, true) => Some(true),
            _ => None,
        }
    }
}

fn bit(contact: Contact) -> u8 {
    1 << contact as u8
}

/// Error at the limit in a direction.
pub(super) fn limit_error(back: bool) -> Error {
    if back { Error::MinusLimit } else { Error::PlusLimit }
}
