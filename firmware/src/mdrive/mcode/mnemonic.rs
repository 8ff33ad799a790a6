//! Names of the language. A user's label or variable cannot have such a name (MC 3.2, 5).

mod table;

use drivetwin_protocol::registers::Register;

use self::table::{Class, ITEMS, Item};
use super::super::registers::{HYBRID, Reg};
use super::operand::List;

/// Meaning of a name of the language.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) enum Mnemonic {
    /// A variable or a flag with one number.
    Variable(Reg),
    /// A list of several values.
    List(List),
    /// An instruction.
    Instruction(Instruction),
    /// A word that only PR accepts.
    Keyword(Keyword),
    /// This drive does not have it (error 37), but the name is taken.
    NotAvailable,
}

/// An instruction, by its name (MC 5). Some instructions also have a register on the bus.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) enum Instruction {
    BP,
    BR,
    CF,
    CL,
    CP,
    DC,
    E,
    EX,
    FD,
    H,
    HI,
    HM,
    IC,
    IP,
    IV,
    L,
    LB,
    MA,
    MR,
    OE,
    PG,
    PR,
    PS,
    RS,
    RT,
    S,
    SC,
    SL,
    VA,
}

impl Instruction {
    /// Returns true if the instruction takes no operand.
    pub(super) fn stands_alone(self) -> bool {
        matches!(self, Self::E | Self::RT | Self::PS | Self::RS | Self::S | Self::FD | Self::IP | Self::CF)
    }
}

/// A keyword of PR, by its name (MC 5).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) enum Keyword {
    /// All variables and flags.
    AL,
    /// The last motion command.
    MD,
    /// The part number.
    PN,
    /// The serial number.
    SN,
    /// The user's variables and labels.
    UV,
    /// The version.
    VR,
}

/// A name in capitals, padded with blanks.
pub(in crate::mdrive) type Word = [u8; 3];

/// Bit that is set, in addition to the bits of the variants, if the commands of drives with a serial port are
/// available.
pub(in crate::mdrive) const SERIAL: u8 = 1 << 7;

/// Meaning of `word`, in upper or lower case, for a drive of these variants; `None` if the user may define the
/// word.
pub(in crate::mdrive) fn find(word: &[u8], variants: u8) -> Option<Mnemonic> {
    let word = padded(word)?.map(|character| character.to_ascii_uppercase());
    let item = ITEMS.get(ITEMS.binary_search_by(|item| item.word.cmp(&word)).ok()?)?;
    if item.variants & variants != 0 {
        return Some(item.mnemonic());
    }
    // On the other model the user may define a name of the Hybrid's, as MC 5-58 states for another product's
    // name.
    (item.variants != HYBRID).then_some(Mnemonic::NotAvailable)
}

/// All variables, flags and lists of these variants, and MD and VR, in the order of their names.
pub(in crate::mdrive) fn variables(variants: u8) -> impl Iterator<Item = (&'static Word, Mnemonic)> {
    ITEMS
        .iter()
        .filter(move |item| item.variants & variants != 0)
        .map(|item| (&item.word, item.mnemonic()))
        .filter(|(_, mnemonic)| {
            use Mnemonic::{Keyword as Word, List, Variable};
            matches!(mnemonic, Variable(_) | List(_) | Word(Keyword::MD | Keyword::VR))
        })
}

/// Pads one to three characters with blanks.
fn padded(text: &[u8]) -> Option<Word> {
    match *text {
        [a] => Some([a, b' ', b' ']),
        [a, b] => Some([a, b, b' ']),
        [a, b, c] => Some([a, b, c]),
        _ => None,
    }
}

impl Item {
    fn mnemonic(self) -> Mnemonic {
        match self.class {
            Class::Instruction(instruction) => Mnemonic::Instruction(instruction),
            Class::Keyword(keyword) => Mnemonic::Keyword(keyword),
            Class::NotAvailable => Mnemonic::NotAvailable,
            Class::Trip(trip) => Mnemonic::List(List::Trip(trip)),
            Class::Row(row) => match Reg::from_row(row.into()) {
                Some(
                    reg @ (Reg::S1 | Reg::S2 | Reg::S3 | Reg::S4 | Reg::S5 | Reg::S7 | Reg::S8 | Reg::S13),
                ) => Mnemonic::List(List::Io(reg)),
                Some(reg @ (Reg::CA | Reg::MU)) => Mnemonic::List(List::With(reg)),
                Some(reg) => Mnemonic::Variable(reg),
                None => Mnemonic::NotAvailable,
            },
        }
    }
}
