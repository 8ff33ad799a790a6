//! Figures about the board that a replay measures.

use std::fmt;

use drivetwin_firmware::device::Duration;

/// Figures of a replay.
#[derive(Default)]
pub(crate) struct Figures {
    /// Virtual time at the end of the replay.
    pub(crate) time: Duration,
    /// Greatest delay of an output or input.
    pub(crate) latency: Duration,
    /// Greatest delay of an output or input before which the loop had to compute a plan.
    pub(crate) planning: Duration,
    /// Time from the start of the clock until the loop first sleeps.
    pub(crate) boot: Duration,
    /// Number of step pulses.
    pub(crate) steps: u32,
    /// Number of stops of the machine.
    pub(crate) stops: u32,
    /// Number of bytes of the stack that were used.
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
