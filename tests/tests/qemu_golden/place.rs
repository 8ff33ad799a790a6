//! Positions in a trace, for messages.

use drivetwin_firmware::device::{Duration, Instant};
use drivetwin_sim::record::trace::Trace;

/// The name of a trace and the instants of its lines.
pub(crate) struct Places {
    name: String,
    lines: Vec<(Instant, usize)>,
}

impl Places {
    pub(crate) fn of(name: &str, trace: &Trace) -> Self {
        let lines = trace.events().map(|entry| (entry.at, entry.line)).collect();
        Self { name: name.to_owned(), lines }
    }

    /// The name of the trace, the instant in the format of traces, and the last line up to that instant.
    pub(crate) fn at(&self, at: Instant) -> String {
        let line = self.lines.iter().rev().find(|(from, _)| *from <= at).map_or(1, |(_, line)| *line);
        let ms = at.ticks() as f64 / Duration::millis(1).ticks() as f64;
        format!("{}, {ms:.6} ms, line {line}", self.name)
    }
}
