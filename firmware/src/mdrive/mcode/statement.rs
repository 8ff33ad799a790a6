//! A line of MCode, taken apart.

use core::ops::Range;

use heapless::Vec;

use super::super::registers::Reg;

/// A name of one or two characters, in capitals; the second of one is a blank.
pub(in crate::mdrive) type Name = [u8; 2];

/// A number, or what has one.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) enum Operand {
    Number(i32),
    /// A number that CR is set to or compared with, in thousandths.
    Ratio(i32),
    Variable(Reg),
    User(Name),
}

impl Operand {
    /// Whether it may have a fraction.
    pub(super) fn is_ratio(self) -> bool {
        matches!(self, Self::Ratio(_) | Self::Variable(Reg::CR))
    }
}

/// What an expression does with its two operands (MC 4.9).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) enum Operator {
    Plus,
    Minus,
    Times,
    /// Truncates; by 0 it is error 21.
    Over,
    And,
    Or,
    Xor,
}

/// An operand and what is done to it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) struct Expression {
    /// `!`: of the first operand all bits are turned.
    pub(in crate::mdrive) not: bool,
    pub(in crate::mdrive) first: Operand,
    pub(in crate::mdrive) then: Option<(Operator, Operand)>,
}

impl Expression {
    /// Whether it may have a fraction.
    pub(super) fn is_ratio(&self) -> bool {
        self.first.is_ratio() || self.then.is_some_and(|(_, second)| second.is_ratio())
    }
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

/// The condition of BR and CL; without a relation it holds for what is not 0.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) struct Condition {
    pub(in crate::mdrive) left: Operand,
    pub(in crate::mdrive) right: Option<(Relation, Operand)>,
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
    /// CA, MU: a variable and a parameter that is not kept.
    With(Reg),
    /// Trips (MC 5-71 to 5-76).
    Trip(Trip),
}

impl List {
    /// How many values it has.
    pub(in crate::mdrive) fn len(self) -> usize {
        match self {
            Self::Io(Reg::S1 | Reg::S2 | Reg::S3 | Reg::S4) => 3,
            Self::Io(_) | Self::With(_) => 2,
            Self::Trip(trip) => trip.parameters().len(),
        }
    }

    /// Which of them, from 0, is the subroutine of a trip.
    pub(in crate::mdrive) fn label(self) -> Option<usize> {
        match self {
            Self::Trip(trip) => Trip::SUBROUTINE.checked_sub(trip.parameters().start),
            Self::Io(_) | Self::With(_) => None,
        }
    }
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) enum Trip {
    /// TI.
    Input,
    /// TP.
    Position,
    /// TC.
    Capture,
    /// TT.
    Time,
    /// TR.
    Relative,
    /// TA.
    Hybrid,
}

impl Trip {
    /// The subroutine's place among [`Self::parameters`].
    const SUBROUTINE: usize = 1;

    /// Which it has of: what it waits for, its subroutine, how often.
    pub(super) fn parameters(self) -> Range<usize> {
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
    /// The subroutine of a trip; its address is a value.
    Label(Name),
    /// Nothing between two commas.
    Absent,
}

/// What a line says.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(in crate::mdrive) enum Statement<'a> {
    /// Nothing but blanks or a comment.
    Empty,
    /// A number alone: the last motion command again, or what IV waits for.
    Number(Expression),
    /// A variable or a flag is set; HM, too.
    Set(Reg, Expression),
    SetUser(Name, Expression),
    SetList(List, Vec<Parameter, 3>),
    /// VA.
    Declare(Name, Option<Expression>),
    /// MA or MR: with the name at the end, and going on there.
    Move {
        relative: bool,
        way: Expression,
        announces: bool,
        goes_on: bool,
    },
    Slew(Expression),
    HomeToIndex(Expression),
    /// H, with a time in ms.
    Hold(Option<Expression>),
    Branch(Place, Option<Condition>),
    Call(Place, Option<Condition>),
    Return,
    End,
    /// EX, with its mode.
    Execute(Place, Option<Expression>),
    Pause,
    Resume,
    /// PG.
    Program(Option<Place>),
    Label(Name),
    OnError(Place),
    BreakPoint(Place, Option<Expression>),
    ListProgram(Option<Place>),
    Clear(Option<Place>),
    /// PR, with what is behind it.
    Print(&'a [u8]),
    /// IV.
    Input(Operand),
    Increment(Operand),
    Decrement(Operand),
    Save,
    Defaults,
    /// IP.
    Initialize,
    /// SC, with its mode.
    Calibrate(Option<Expression>),
    /// CF.
    ClearLocked,
}
