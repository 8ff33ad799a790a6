//! A part of full scale.

use core::ops::Neg;

/// A part of full scale, from -1 to 1, as an exact fraction.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrobot) struct Ratio {
    numerator: i64,
    denominator: i64,
}

impl Ratio {
    pub(super) const NONE: Self = Self { numerator: 0, denominator: 1 };
    pub(super) const ALL: Self = Self { numerator: 1, denominator: 1 };

    /// `numerator` of `denominator`, which is not negative; 0 of 0 is 0. Values beyond full scale are limited
    /// to 1.
    pub(super) fn new(numerator: i64, denominator: i64) -> Self {
        Self { numerator: numerator.min(denominator).max(-denominator), denominator }
    }

    /// The share of `full`, rounded towards zero.
    pub(in crate::mdrobot) fn of(self, full: u16) -> i32 {
        // The result is at most `full`, because the ratio is at most 1.
        (self.numerator * i64::from(full)).checked_div(self.denominator).unwrap_or(0) as i32
    }
}

impl Neg for Ratio {
    type Output = Self;
    fn neg(self) -> Self {
        Self { numerator: -self.numerator, ..self }
    }
}
