//! Reading and writing of variables, by the bus and by MCode.
//!
//! The drive stores a value of each (`stored`). All values of a write are validated first (`reader::judge`), then
//! applied (`apply`).

mod apply;
mod stored;

use drivetwin_protocol::registers::{Entry, Register, Row, Shape};

pub(super) use self::stored::{CLOSED_MICROSTEPS, Registers};
use super::mcode::names::Name;
use super::registers::Reg;

/// Stored value of CR for a ratio of 1.
pub(super) const RATIO_ONE: i32 = 1_000;
/// The value that HT does not take: it is 0 or at least 2 ms (MC 5-32).
pub(super) const NO_DELAY_MS: i32 = 1;

/// Frequency that SS and TS divide (FB 5.1; MDRIVE-23), in Hz.
const OSCILLATOR: i32 = 10_000_000;

/// Speed for a value 0 to 255 of SS or TS, in steps/s.
pub(super) fn frequency(n: i32) -> i32 {
    OSCILLATOR.checked_div(n.saturating_add(2)).unwrap_or(0)
}

/// Value of SS or TS for a speed in steps/s. Its speed is not below the given one.
pub(super) fn divider(frequency: i32) -> i32 {
    OSCILLATOR.checked_div(frequency).unwrap_or(0) - 2
}

/// Entry of a variable in the register map.
pub(super) fn entry(reg: Reg) -> &'static Entry {
    static NONE: Entry = Row::setting(0, "no row").entry;
    Reg::ENTRIES.list.get(reg.row()).unwrap_or(&NONE)
}

/// Splits the number of a row into the values of a set-up. Unused values at the end are 0.
pub(super) fn words(reg: Reg, value: i64) -> [u16; 3] {
    let word = |n: u16| (value >> (16 * n) & 0xFFFF) as u16;
    match entry(reg).shape.words() {
        3 => [word(2), word(1), word(0)],
        _ => [word(1), word(0), 0],
    }
}

/// Returns true if a variable has one value, not several.
pub(super) fn is_number(reg: Reg) -> bool {
    !matches!(entry(reg).shape, Shape::Words(_))
}

/// Amount that IC or DC adds.
pub(super) fn step(reg: Reg) -> i32 {
    if reg == Reg::DC { -1 } else { 1 }
}

/// Bit of an output, O1 to O4, in OL.
pub(super) fn output_bit(reg: Reg) -> i32 {
    match reg {
        Reg::O1 => 1,
        Reg::O2 => 2,
        Reg::O3 => 4,
        _ => 8,
    }
}

/// Name of the user variable behind one of the registers V1 to V8 (FB 5.2).
pub(super) fn user_name(reg: Reg) -> Option<Name> {
    let digit = match reg {
        Reg::V1 => b'1',
        Reg::V2 => b'2',
        Reg::V3 => b'3',
        Reg::V4 => b'4',
        Reg::V5 => b'5',
        Reg::V6 => b'6',
        Reg::V7 => b'7',
        Reg::V8 => b'8',
        _ => return None,
    };
    Some([b'V', digit])
}
