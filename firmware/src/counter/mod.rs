//! Counters of edges: the LS7366R, and the filter that it shares with other counters.

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
