//! Party mode and checksums of drives with a serial port, several of which share a serial line (MC 7.1). In
//! party mode a line begins with the name of the drive that it is for, and ends with Ctrl-J.

use super::super::registers::Reg;
use super::super::variables::Registers;

/// "Accepted", sent instead of CR LF if there are checksums.
pub(in crate::mdrive) const ACK: u8 = 0x06;
/// "Refused", sent in the same way.
pub(in crate::mdrive) const NAK: u8 = 0x15;

/// Name that addresses all drives (MC 5-59).
const ALL: u8 = b'*';
/// Name that addresses all drives with QD (MC 5-60).
const QUEUED: u8 = b'^';

/// Party mode. It belongs to the drive, not to a connection.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Party {
    Off,
    /// On since power-up, or since PY = 1, but not yet active. The first Ctrl-J on any connection activates
    /// it (MC 5-59; MDRIVE-37).
    Waiting,
    Active,
}

/// Addressee of a line.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum PartyAddress {
    /// This drive, without a name, because party mode is off.
    Plain,
    /// Not known yet: the next character selects the addressee.
    Next,
    /// This drive, called by this name.
    Me(u8),
    /// All drives.
    All,
    Others,
}

impl PartyAddress {
    /// Name by which the line called this drive; 0 if it called none.
    pub(super) fn name(self) -> u8 {
        match self {
            Self::Me(name) => name,
            Self::All => ALL,
            Self::Plain | Self::Next | Self::Others => 0,
        }
    }
}

impl Registers {
    /// Returns true if lines begin with a name.
    pub(in crate::mdrive) fn is_party(&self) -> bool {
        self.is_serial() && self.word(Reg::PY) != 0
    }

    /// CK; 0 means no checksums.
    pub(in crate::mdrive) fn check_sums(&self) -> u16 {
        if self.is_serial() { self.word(Reg::CK) } else { 0 }
    }

    /// Returns true if the drive has the commands of drives with a serial port.
    pub(super) fn is_serial(&self) -> bool {
        self.word(Reg::SerialCommands) != 0
    }

    /// Addressee that a name selects.
    pub(super) fn addressee(&self, name: u8) -> PartyAddress {
        match name {
            ALL => PartyAddress::All,
            QUEUED if self.word(Reg::QD) != 0 => PartyAddress::Me(name),
            _ if self.word(Reg::DN) == u16::from(name) => PartyAddress::Me(name),
            _ => PartyAddress::Others,
        }
    }

    /// Returns true if the drive answers a line with this addressee. A line for all drives is answered with
    /// DG 0 only (MC 5-19).
    pub(super) fn answers(&self, address_state: PartyAddress) -> bool {
        match address_state {
            PartyAddress::Plain | PartyAddress::Me(_) => true,
            PartyAddress::All => self.word(Reg::DG) == 0,
            PartyAddress::Next | PartyAddress::Others => false,
        }
    }
}

/// Checksum of a text. With it the sum of all characters is 0 in seven bits (MC 7.1.2).
pub(in crate::mdrive) fn check_sum(text: &[u8]) -> u8 {
    sum(text).wrapping_neg() | 0x80
}

/// Returns true if a line, with the name before it, ends with its checksum.
pub(in crate::mdrive) fn is_checked(name: u8, line: &[u8]) -> bool {
    sum(line).wrapping_add(name) & 0x7F == 0
}

fn sum(text: &[u8]) -> u8 {
    text.iter().fold(0, |sum, character| sum.wrapping_add(*character))
}
