//! Statements: lines of MCode after parsing.

use core::ops::Range;

use heapless::Vec;

use super::super::registers::Reg;
use super::parse::Expression;

/// A name of one or two characters, in capitals. After a single character comes a blank.
pub(in crate::mdrive) type Name = [u8; 2];

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

/// A statement: the meaning of a line.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(in crate::mdrive) enum Statement<'a> {
    /// Only blanks or a comment.
    Empty,
    /// A number alone: repeats the last motion command, or is the number that IV waits for.
    Number(Expression<'a>),
    /// Sets a variable, a flag or HM.
    Set(Reg, Expression<'a>),
    SetUser(Name, Expression<'a>),
    SetList(List, Vec<Parameter, 3>),
    /// VA: declares a user variable.
    Declare(Name, Option<Expression<'a>>),
    /// DN, as the code of its character.
    Name(i32),
    /// MA or MR. The drive may send its name at the end, and the motion may continue there.
    Move {
        relative: bool,
        way: Expression<'a>,
        notify_on_end: bool,
        continuous: bool,
    },
    Slew(Expression<'a>),
    HomeToIndex(Expression<'a>),
    /// H: waits for a time in ms, or for the end of motion.
    Hold(Option<Expression<'a>>),
    Branch(Place, Option<Expression<'a>>),
    Call(Place, Option<Expression<'a>>),
    Return,
    End,
    /// EX: runs the program, with a mode.
    Execute(Place, Option<Expression<'a>>),
    Pause,
    Resume,
    /// PG: begins or ends program mode.
    Program(Option<Place>),
    Label(Name),
    OnError(Place),
    BreakPoint(Place, Option<Expression<'a>>),
    ListProgram(Option<Place>),
    Clear(Option<Place>),
    /// PR and its items.
    Print(&'a [u8]),
    /// IV: waits for a typed number.
    Input(Operand),
    Increment(Operand),
    Decrement(Operand),
    Save,
    Defaults,
    /// IP: loads the saved variables.
    Initialize,
    /// SC: calibrates, with a mode.
    Calibrate(Option<Expression<'a>>),
    /// CF: clears a locked rotor.
    ClearLocked,
}
