//! What the statements of MCode are made of: operands, steps of expressions, places, lists.

use core::ops::Range;

use super::super::registers::Reg;
use super::names::Name;

/// A number, or a variable that has one.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) enum Operand {
    Number(i32),
    /// A number that CR is set to or compared with, in thousandths.
    Ratio(i32),
    Variable(Reg),
    User(Name),
}

impl Operand {
    /// Returns true if the operand may have a fraction.
    pub(in crate::mdrive) fn is_ratio(self) -> bool {
        matches!(self, Self::Ratio(_) | Self::Variable(Reg::CR))
    }
}

/// Operator of an expression (MC 4.9).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) enum Operator {
    Plus,
    Minus,
    Times,
    /// Truncates. A division by 0 is error 21.
    Over,
    And,
    Or,
    Xor,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) enum Relation {
    Equal,
    Unequal,
    Less,
    AtMost,
    Greater,
    AtLeast,
}

impl Relation {
    pub(in crate::mdrive) fn holds(self, left: i64, right: i64) -> bool {
        match self {
            Self::Equal => left == right,
            Self::Unequal => left != right,
            Self::Less => left < right,
            Self::AtMost => left <= right,
            Self::Greater => left > right,
            Self::AtLeast => left >= right,
        }
    }
}

/// Step of an expression, applied to the result of the steps before it. The first step is applied to 0.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) enum Step {
    Calculate {
        operator: Operator,
        /// `!`: all bits of the operand are inverted.
        not: bool,
        operand: Operand,
    },
    /// 1 if the relation is true, 0 if not.
    Compare(Relation, Operand),
}

impl Step {
    pub(in crate::mdrive) fn operand(self) -> Operand {
        match self {
            Self::Calculate { operand, .. } | Self::Compare(_, operand) => operand,
        }
    }

    pub(super) fn is_logic(self) -> bool {
        matches!(self, Self::Calculate { operator: Operator::And | Operator::Or | Operator::Xor, .. })
    }
}

/// A place in the program.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) enum Place {
    Address(i32),
    Label(Name),
}

/// Variables of several values.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) enum List {
    /// S1 to S4, S5, S7, S8, S13.
    Io(Reg),
    /// CA, MU: a variable with a second value.
    With(Reg),
    /// Trips (MC 5-71 to 5-76).
    Trip(Trip),
}

impl List {
    /// Number of values.
    pub(in crate::mdrive) fn len(self) -> usize {
        match self {
            Self::Io(Reg::S1 | Reg::S2 | Reg::S3 | Reg::S4) => 3,
            Self::Io(_) | Self::With(_) => 2,
            Self::Trip(trip) => trip.parameters().len(),
        }
    }

    /// Index of the value that names the subroutine of a trip, from 0; `None` if no value does.
    pub(in crate::mdrive) fn label(self) -> Option<usize> {
        match self {
            Self::Trip(trip) => Trip::SUBROUTINE.checked_sub(trip.parameters().start),
            Self::Io(_) | Self::With(_) => None,
        }
    }
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) enum Trip {
    /// TI: an input.
    Input,
    /// TP: a position.
    Position,
    /// TC: the capture input.
    Capture,
    /// TT: a time.
    Time,
    /// TR: a distance, repeatedly.
    Relative,
    /// TA: the status of a Hybrid.
    Hybrid,
}

impl Trip {
    /// Index of the subroutine among [`Self::parameters`].
    const SUBROUTINE: usize = 1;

    /// Range of the parameters that this trip has. The parameters are 0, a condition; 1, a subroutine; 2, a
    /// number of repeats.
    pub(in crate::mdrive) fn parameters(self) -> Range<usize> {
        match self {
            Self::Capture => 1..2,
            Self::Relative => 0..3,
            Self::Input | Self::Position | Self::Time | Self::Hybrid => 0..2,
        }
    }
}

/// A value of a [`List`].
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) enum Parameter {
    Value(Operand),
    /// Subroutine of a trip, by its label; by its address it is a value.
    Label(Name),
    /// No value between two commas.
    Absent,
}
