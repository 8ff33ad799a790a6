//! Test equipment for anything that implements [`Device`](crate::device::Device): records of its outputs, a
//! memory, and a clock. It needs `std` and may panic: only tests switch the feature `testing` on.
//!
//! | type | use |
//! |---|---|
//! | [`Fixture`] | a device, the record of its outputs, and the time |
//! | [`Recorder`] | outputs by kind, each with its instant |
//! | [`Transcript`] | outputs as lines of text, in the order in which they were put |
#![allow(
    clippy::panic,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::indexing_slicing,
    reason = "a test may fail"
)]

mod fixture;
mod recorder;
#[cfg(test)]
mod tests;
mod transcript;

use std::vec::Vec;

pub use fixture::Fixture;
pub use recorder::{Recorder, Rule, Treatment};
pub use transcript::Transcript;

/// Carries out a store in `memory`, up to `left` bytes in all.
fn store(memory: &mut [u8], left: &mut usize, offset: u16, bytes: &[u8]) {
    let count = bytes.len().min(*left);
    memory[usize::from(offset)..][..bytes.len()][..count].copy_from_slice(&bytes[..count]);
    *left -= count;
}

/// A memory that is new: all `0xFF`.
fn new_memory(size: usize) -> Vec<u8> {
    std::vec![0xFF; size]
}
