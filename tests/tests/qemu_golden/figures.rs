//! Figures that a replay finds about the board.

use std::fmt;

use drivetwin_firmware::device::Duration;

/// Figures of a replay.
#[derive(Default)]
pub(crate) struct Figures {
    /// Virtual time at the end.
    pub(crate) time: Duration,
    /// The longest that anything took.
    pub(crate) latency: Duration,
    /// The longest that anything took for which a plan was computed first.
    pub(crate) planning: Duration,
    /// From the start of the clock until the loop slept for the first time.
    pub(crate) boot: Duration,
    /// Step pulses.
    pub(crate) steps: u32,
    /// Stops of the machine.
    pub(crate) stops: u32,
    /// Bytes of the stack that were ever used.
    pub(crate) stack: u32,
}

impl fmt::Display for Figures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { time, latency, planning, boot, steps, stops, stack } = self;
        let [latency, planning, boot] = [latency, planning, boot].map(|span| micros(*span));
        write!(f, "{:>6} ms, {latency:>3} µs late, {planning:>3} µs with a plan, ", micros(*time) / 1_000)?;
        write!(f, "boot {boot:>3} µs, {steps:>5} steps, {stops:>5} stops, stack {stack}")
    }
}

/// Microseconds, rounded up.
fn micros(span: Duration) -> u64 {
    span.ticks().div_ceil(Duration::micros(1).ticks())
}
