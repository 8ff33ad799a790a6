//! A part of full scale.

use core::ops::Neg;

/// A part of full scale, from -1 to 1, as an exact fraction.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrobot) struct Ratio {
    part: i64,
    whole: i64,
}

impl Ratio {
    pub(super) const NONE: Self = Self { part: 0, whole: 1 };
    pub(super) const ALL: Self = Self { part: 1, whole: 1 };

    /// `part` of `whole`, which is not negative; nothing of nothing. What is beyond it is all.
    pub(super) fn new(part: i64, whole: i64) -> Self {
        Self { part: part.min(whole).max(-whole), whole }
    }

    /// The share of `full`, towards zero.
    pub(in crate::mdrobot) fn of(self, full: u16) -> i32 {
        // No more than `full`, because no part is more than its whole.
        (self.part * i64::from(full)).checked_div(self.whole).unwrap_or(0) as i32
    }
}

impl Neg for Ratio {
    type Output = Self;
    fn neg(self) -> Self {
        Self { part: -self.part, ..self }
    }
}
