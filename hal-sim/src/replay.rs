//! A trace once more, and the first difference.

use standin_firmware::device::Device;

use crate::trace::Trace;

/// Where a replay differs from its trace.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Difference {
    /// The line of the trace, from 1; where the trace ends if something more came.
    pub line: usize,
    /// What the trace says; `None` if something more came.
    pub expected: Option<String>,
    /// What came instead; `None` if nothing did.
    pub got: Option<String>,
}

/// Why a trace cannot be replayed at all.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Unplayable(pub String);

/// Runs `trace` on a fresh bench, whose drives `make` makes by their kind, and returns the first
/// difference.
///
/// # Errors
/// Why it cannot be run.
pub fn run(
    _trace: &Trace,
    _make: &dyn Fn(&str) -> Option<Box<dyn Device>>,
) -> Result<Option<Difference>, Unplayable> {
    unimplemented!()
}

/// The text of a trace with what it compares brought up to date; comments and all it feeds stay.
///
/// # Errors
/// Why it cannot be run.
pub fn rewrite(_text: &str, _make: &dyn Fn(&str) -> Option<Box<dyn Device>>) -> Result<String, Unplayable> {
    unimplemented!()
}
