//! Parts that the benchmarks share: a stopwatch and a line of output.

use std::time::{Duration, Instant};

/// Wall-clock time of `act`.
#[expect(clippy::disallowed_methods, reason = "a benchmark measures the wall clock")]
pub(crate) fn took(act: impl FnOnce()) -> Duration {
    let start = Instant::now();
    act();
    start.elapsed()
}

/// Prints a line with a result.
pub(crate) fn line(name: &str, result: &str) {
    println!("  {name:<20} {result}");
}
