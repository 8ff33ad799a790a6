//! Features of the drive's serial variants, which share a line (MC 7.1): party mode, in which a line begins with the
//! name of the drive that it is for and ends with Ctrl-J, and checksums.

use super::super::drive::Drive;
use super::super::registers::Reg;

/// "Accepted" in place of CR LF, where there are check sums.
pub(super) const ACK: u8 = 0x06;
/// "Refused".
pub(super) const NAK: u8 = 0x15;

/// The name that all drives have (MC 5-59).
const ALL: u8 = b'*';
/// The name that all drives with QD have (MC 5-60).
const QUEUED: u8 = b'^';

/// Party mode, which is the drive's and not a connection's.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Party {
    Off,
    /// On since power-up, or since PY = 1: the first Ctrl-J activates it, on whatever connection (MC 5-59;
    /// MDRIVE-37).
    Waiting,
    Active,
}

/// Addressee of a line.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum PartyAddress {
    /// The only drive there is.
    Plain,
    /// Selected by the next character.
    Next,
    /// The drive itself, called by that name.
    Me(u8),
    /// All drives.
    All,
    Others,
}

impl PartyAddress {
    /// The name that was called; 0 if none was.
    pub(super) fn name(self) -> u8 {
        match self {
            Self::Me(name) => name,
            Self::All => ALL,
            Self::Plain | Self::Next | Self::Others => 0,
        }
    }
}

impl Drive {
    /// Returns whether lines begin with a name.
    pub(super) fn is_party(&self) -> bool {
        self.is_serial() && self.bank.word(Reg::PY) != 0
    }

    /// Party mode begins or ends, by whatever has changed PY.
    pub(in crate::mdrive) fn update_party(&mut self) {
        self.mcode.consoles.set_party(self.is_party());
    }

    /// CK: 0 without check sums.
    pub(super) fn check_sums(&self) -> u16 {
        if self.is_serial() { self.bank.word(Reg::CK) } else { 0 }
    }

    /// Returns whether the drive is a serial variant.
    pub(super) fn is_serial(&self) -> bool {
        self.bank.word(Reg::SerialCommands) != 0
    }

    /// The addressee of a name.
    pub(super) fn addressee(&self, name: u8) -> PartyAddress {
        match name {
            ALL => PartyAddress::All,
            QUEUED if self.bank.word(Reg::QD) != 0 => PartyAddress::Me(name),
            _ if self.bank.word(Reg::DN) == u16::from(name) => PartyAddress::Me(name),
            _ => PartyAddress::Others,
        }
    }

    /// Returns whether the drive answers a line that called it so: all together only with DG 0 (MC 5-19).
    pub(super) fn answers(&self, address_state: PartyAddress) -> bool {
        match address_state {
            PartyAddress::Plain | PartyAddress::Me(_) => true,
            PartyAddress::All => self.bank.word(Reg::DG) == 0,
            PartyAddress::Next | PartyAddress::Others => false,
        }
    }
}

/// The check sum of a text: with it the sum of all characters is 0 in seven bits (MC 7.1.2).
pub(super) fn check_sum(text: &[u8]) -> u8 {
    sum(text).wrapping_neg() | 0x80
}

/// Returns whether a line, with the name before it, ends with its checksum.
pub(super) fn is_checked(name: u8, line: &[u8]) -> bool {
    sum(line).wrapping_add(name) & 0x7F == 0
}

fn sum(text: &[u8]) -> u8 {
    text.iter().fold(0, |sum, character| sum.wrapping_add(*character))
}
