//! Statements: lines of MCode after parsing.

use heapless::Vec;

use super::super::registers::Reg;
use super::names::Name;
use super::operand::{List, Operand, Parameter, Place};
use super::parse::Expression;

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
