//! What the replays find out about the board.

use std::path::Path;
use std::{fmt, fs};

use standin_firmware::device::Duration;

/// What a replay found out.
#[derive(Clone, Copy, Default)]
pub(crate) struct Figures {
    /// How far virtual time went.
    pub(crate) time: Duration,
    /// The longest that anything took.
    pub(crate) latency: Duration,
    /// The longest that anything took for which a plan was computed first.
    pub(crate) planning: Duration,
    /// From the start of the clock until the loop slept for the first time.
    pub(crate) boot: Duration,
    /// Step pulses.
    pub(crate) steps: u32,
    /// Times that the board stood.
    pub(crate) stops: u32,
    /// Bytes of the stack that were ever used.
    pub(crate) stack: u32,
}

impl Figures {
    /// The worse of each.
    pub(crate) fn worst(self, other: Self) -> Self {
        Self {
            time: self.time.max(other.time),
            latency: self.latency.max(other.latency),
            planning: self.planning.max(other.planning),
            boot: self.boot.max(other.boot),
            steps: self.steps.max(other.steps),
            stops: self.stops.max(other.stops),
            stack: self.stack.max(other.stack),
        }
    }
}

impl fmt::Display for Figures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { time, latency, planning, boot, steps, stops, stack } = self;
        let [latency, planning, boot] = [latency, planning, boot].map(|span| micros(*span));
        write!(f, "{:>6} ms, {latency:>3} µs late, {planning:>3} µs with a plan, ", micros(*time) / 1_000)?;
        write!(f, "boot {boot:>3} µs, {steps:>5} steps, {stops:>5} stops, stack {stack}")
    }
}

/// Writes down the worst of each kind, a name and a number a line, in `board-figures/lm3s6965.txt` beside
/// what cargo builds.
pub(crate) fn keep(kinds: impl Iterator<Item = (&'static str, Figures)>) {
    let mut text = String::new();
    for (kind, Figures { stack, boot, latency, planning, .. }) in kinds {
        text += &format!("{kind}.stack_bytes {stack}\n");
        for (name, span) in [("boot", boot), ("latency", latency), ("planning", planning)] {
            text += &format!("{kind}.{name}_us {}\n", micros(span));
        }
    }
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).with_file_name("board-figures");
    fs::create_dir_all(&folder).expect("a folder");
    fs::write(folder.join("lm3s6965.txt"), text).expect("written");
}

/// Microseconds, rounded up.
fn micros(span: Duration) -> u64 {
    span.ticks().div_ceil(Duration::micros(1).ticks())
}
