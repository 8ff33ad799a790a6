//! Values and conditions: operands with operators between them, computed from left to right (MDRIVE-9).

use core::iter::from_fn;
use core::mem;

use super::scanner::{Kind, Scanner};
use crate::mdrive::error::Error;
use crate::mdrive::mcode::mnemonic::Mnemonic;
use crate::mdrive::mcode::operand::{Operand, Operator, Relation, Step};

/// Text of a value or a condition that has been checked. It is parsed again when it is computed, so that a
/// long expression takes no more memory than a short one.
#[derive(Clone, Copy, Debug)]
pub(in crate::mdrive) struct Expression<'a> {
    text: &'a [u8],
    kind: Kind,
    variants: u8,
}

impl<'a> Expression<'a> {
    /// Steps of the computation, from left to right.
    pub(in crate::mdrive) fn steps(self) -> impl Iterator<Item = Step> + 'a {
        let mut scanner = Scanner { rest: self.text, variants: self.variants };
        let mut begins = true;
        from_fn(move || {
            let step = if mem::take(&mut begins) {
                scanner.first_step(self.kind).map(Some)
            } else {
                scanner.step(self.kind)
            };
            step.ok().flatten()
        })
    }

    /// Returns true if the expression may have a fraction.
    pub(in crate::mdrive) fn is_ratio(&self) -> bool {
        self.steps().any(|step| step.operand().is_ratio())
    }

    /// Value of the expression if it is a single number.
    pub(in crate::mdrive) fn constant(self) -> Option<i32> {
        let mut steps = self.steps();
        match (steps.next()?, steps.next()) {
            (
                Step::Calculate {
                    not: false,
                    operand: Operand::Number(number) | Operand::Ratio(number),
                    operator: Operator::Plus,
                },
                None,
            ) => Some(number),
            _ => None,
        }
    }
}

impl PartialEq for Expression<'_> {
    fn eq(&self, other: &Self) -> bool {
        self.steps().eq(other.steps())
    }
}

impl Eq for Expression<'_> {}

impl<'a> Scanner<'a> {
    /// Parses a value (MC 4.9).
    pub(super) fn expression(&mut self, kind: Kind) -> Result<Expression<'a>, Error> {
        self.chain(kind, |step| matches!(step, Step::Calculate { .. }))
    }

    /// Parses the condition of BR and CL. "Only one condition may exist" (MC 5-6), so there is at most one
    /// relation, and only logic after it.
    pub(super) fn condition(&mut self) -> Result<Expression<'a>, Error> {
        let word = self.word();
        let kind = match self.find(word) {
            Some(Mnemonic::Variable(reg)) => Kind::of(reg),
            _ => Kind::Whole,
        };
        let mut is_compared = false;
        self.chain(kind, |step| {
            let validate = !is_compared || step.is_logic();
            is_compared |= matches!(step, Step::Compare(..));
            validate
        })
    }

    /// Takes the first step of an expression, then further steps while `validate` accepts them.
    fn chain(
        &mut self,
        kind: Kind,
        mut validate: impl FnMut(&Step) -> bool,
    ) -> Result<Expression<'a>, Error> {
        let begin = self.rest;
        self.first_step(kind)?;
        let mut rest = self.rest;
        while self.step(kind)?.is_some_and(|step| validate(&step)) {
            rest = self.rest;
        }
        self.rest = rest;
        let text = begin.get(..begin.len() - rest.len()).unwrap_or(begin);
        Ok(Expression { text, kind, variants: self.variants })
    }

    /// Parses the first operand. A minus before a variable is an operator.
    fn first_step(&mut self, kind: Kind) -> Result<Step, Error> {
        let is_less = matches!(
            self.rest.trim_ascii_start(),
            [b'-', rest @ ..] if rest.trim_ascii_start().first().is_some_and(u8::is_ascii_alphabetic)
        );
        if is_less {
            self.take(b'-');
        }
        self.calculation(if is_less { Operator::Minus } else { Operator::Plus }, kind)
    }

    /// Parses the next operator or relation, if there is one, and its operand.
    fn step(&mut self, kind: Kind) -> Result<Option<Step>, Error> {
        use Relation::{AtLeast, AtMost, Equal, Greater, Less, Unequal};
        let operator = match self.peek() {
            Some(b'+') => Operator::Plus,
            Some(b'-') => Operator::Minus,
            Some(b'*') => Operator::Times,
            Some(b'/') => Operator::Over,
            Some(b'&') => Operator::And,
            Some(b'|') => Operator::Or,
            Some(b'^') => Operator::Xor,
            _ => {
                let (relation, count) = match self.rest {
                    [b'<', b'>', ..] => (Unequal, 2),
                    [b'<', b'=', ..] => (AtMost, 2),
                    [b'>', b'=', ..] => (AtLeast, 2),
                    [b'=', ..] => (Equal, 1),
                    [b'<', ..] => (Less, 1),
                    [b'>', ..] => (Greater, 1),
                    _ => return Ok(None),
                };
                self.skip(count);
                return Ok(Some(Step::Compare(relation, self.operand(kind)?)));
            }
        };
        self.skip(1);
        self.calculation(operator, kind).map(Some)
    }

    fn calculation(&mut self, operator: Operator, kind: Kind) -> Result<Step, Error> {
        let not = self.take(b'!');
        Ok(Step::Calculate { operator, not, operand: self.operand(kind)? })
    }
}
