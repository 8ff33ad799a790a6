//! Counters of edges: the LS7366R, and what it shares with other counters: the filter, and the direction of an edge.

mod filter;
mod ls7366r;

pub(crate) use filter::Filter;
pub use ls7366r::{Ls7366r, Transmission, status};

/// An input of a quadrature counter.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Channel {
    /// A, which leads B while counting up.
    A,
    /// B.
    B,
    /// The index: INDEX/ of an LS7366R, active low.
    Index,
}

/// Returns true if A leads B at an edge: A and B pass through 00, 10, 11, 01, 00. `a` and `b` are the levels after an edge of
/// A, or of B if `of_a` is false.
pub(crate) const fn a_leads(of_a: bool, a: bool, b: bool) -> bool {
    (a != b) == of_a
}

/// Returns true if the next edge is one of A, while A leads B, or while B leads A if `a_leads` is false. `a` and `b` are the
/// present levels.
pub(crate) const fn next_is_a(a_leads: bool, a: bool, b: bool) -> bool {
    (a == b) == a_leads
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_leads_b_through_00_10_11_01() {
        let states = [(false, false), (true, false), (true, true), (false, true), (false, false)];
        for (states, of_a) in states.windows(2).zip([true, false, true, false]) {
            let [(a, b), (next_a, next_b)] = [states[0], states[1]];
            assert!(a_leads(of_a, next_a, next_b) && !a_leads(of_a, a, b), "{states:?}");
            assert_eq!((next_is_a(true, a, b), next_is_a(false, next_a, next_b)), (of_a, of_a), "{states:?}");
        }
    }
}
