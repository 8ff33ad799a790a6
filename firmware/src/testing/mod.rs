//! Test equipment for any [`Device`](crate::device::Device): recorders of its outputs, a memory, and a clock.
//! It needs `std` and may panic. Only tests enable the feature `testing`.
//!
//! | type | use |
//! |---|---|
//! | [`Fixture`] | a device, the record of its outputs, and the current time |
//! | [`Recorder`] | outputs by kind, each with its timestamp |
//! | [`Transcript`] | outputs as text lines, in the order in which they were put |
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

/// Writes a store into `memory`, as long as power lasts. `left` is the number of bytes that can still be
/// written.
fn store(memory: &mut [u8], left: &mut usize, offset: u16, bytes: &[u8]) {
    let count = bytes.len().min(*left);
    memory[usize::from(offset)..][..bytes.len()][..count].copy_from_slice(&bytes[..count]);
    *left -= count;
}

/// A new memory: all bytes are `0xFF`.
fn new_memory(size: usize) -> Vec<u8> {
    std::vec![0xFF; size]
}
