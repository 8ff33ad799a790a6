//! Parts that the tests of several crates share.

/// Compiles the examples of the README as doctests.
#[cfg(doctest)]
#[allow(rustdoc::invalid_codeblock_attributes, reason = "fences tell tests/foreign/documents.py what to do")]
#[doc = include_str!("../../README.md")]
pub struct Readme;

pub mod at_cable;
pub mod busy;
pub mod exact;
pub mod fuzzed;
pub mod md3;
pub mod on_shell;
pub mod ramps;
pub mod rs434;
pub mod toy;
