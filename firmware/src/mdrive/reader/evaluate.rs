//! Values of operands and expressions.

use super::Reader;
use crate::mdrive::error::Error;
use crate::mdrive::mcode::operand::{Operand, Operator, Step};
use crate::mdrive::mcode::parse::Expression;
use crate::mdrive::registers::Reg;
use crate::mdrive::variables::RATIO_ONE;

impl Reader<'_> {
    /// Value of an operand of MCode, without its fraction. Reading a variable has its side effects.
    ///
    /// # Errors
    /// Error 30: there is no such user variable.
    pub(super) fn operand(&mut self, operand: Operand) -> Result<i32, Error> {
        match operand {
            Operand::Number(number) => Ok(number),
            Operand::Ratio(thousandths) => Ok(thousandths / RATIO_ONE),
            Operand::Variable(Reg::CR) => Ok(self.bank.stored(Reg::CR) / RATIO_ONE),
            Operand::Variable(reg) => {
                let value = self.read_mcode(reg);
                self.has_read(reg);
                Ok(value)
            }
            Operand::User(name) => self.mcode.names.value(name).ok_or(Error::UnknownLabel),
        }
    }

    /// Value of an operand in thousandths, the unit in which CR is stored.
    ///
    /// # Errors
    /// Those of [`Self::operand`].
    fn thousandths(&mut self, operand: Operand) -> Result<i64, Error> {
        match operand {
            Operand::Ratio(thousandths) => Ok(thousandths.into()),
            Operand::Variable(Reg::CR) => Ok(self.bank.stored(Reg::CR).into()),
            whole => self.operand(whole).map(|value| i64::from(value) * i64::from(RATIO_ONE)),
        }
    }

    /// Computes an expression in 32 bits that wrap, and drops the fraction of the result.
    ///
    /// # Errors
    /// Error 21 for a division by 0, 30 for a name that is not a variable.
    pub(in crate::mdrive) fn evaluate(&mut self, expression: &Expression<'_>) -> Result<i32, Error> {
        let ratio = expression.is_ratio();
        let value = self.compute(expression, ratio)?;
        Ok(if ratio { value / i64::from(RATIO_ONE) } else { value } as i32)
    }

    /// Computes an expression, in thousandths if `ratio`.
    fn compute(&mut self, expression: &Expression<'_>, ratio: bool) -> Result<i64, Error> {
        let (mut value, mut ratio) = (0, ratio);
        for step in expression.steps() {
            let operand = self.term(step.operand(), ratio)?;
            value = match step {
                Step::Calculate { operator, not, .. } => {
                    operator.apply(value, if not { !operand } else { operand }, ratio)?
                }
                Step::Compare(relation, _) => {
                    // The result of a comparison has no fraction, whatever was compared.
                    ratio = false;
                    relation.holds(value, operand).into()
                }
            };
        }
        Ok(value)
    }

    /// Value of an operand, in thousandths if `ratio`.
    fn term(&mut self, operand: Operand, ratio: bool) -> Result<i64, Error> {
        if ratio { self.thousandths(operand) } else { self.operand(operand).map(i64::from) }
    }

    /// Computes an expression in thousandths. A value that does not fit in 32 bits becomes `i32::MAX`.
    ///
    /// # Errors
    /// Those of [`Self::evaluate`].
    pub(in crate::mdrive) fn evaluate_ratio(&mut self, expression: &Expression<'_>) -> Result<i32, Error> {
        Ok(i32::try_from(self.compute(expression, true)?).unwrap_or(i32::MAX))
    }

    /// Returns true if a condition is not 0.
    ///
    /// # Errors
    /// Those of [`Self::evaluate`].
    pub(in crate::mdrive) fn holds(&mut self, condition: &Expression<'_>) -> Result<bool, Error> {
        Ok(self.compute(condition, condition.is_ratio())? != 0)
    }
}

impl Operator {
    /// Applies the operator to two values, in 32 bits that wrap, or in thousandths if `ratio`.
    ///
    /// # Errors
    /// Error 21: a division by 0.
    fn apply(self, left: i64, right: i64, ratio: bool) -> Result<i64, Error> {
        let one = i64::from(RATIO_ONE);
        let value = match self {
            Self::Plus => left.saturating_add(right),
            Self::Minus => left.saturating_sub(right),
            Self::Times if ratio => left.saturating_mul(right) / one,
            Self::Times => left.wrapping_mul(right),
            Self::Over => {
                let left = if ratio { left.saturating_mul(one) } else { left };
                left.checked_div(right).ok_or(Error::IllegalValue)?
            }
            Self::And => left & right,
            Self::Or => left | right,
            Self::Xor => left ^ right,
        };
        Ok(if ratio { value } else { (value as i32).into() })
    }
}
