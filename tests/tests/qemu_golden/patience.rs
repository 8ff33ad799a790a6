//! Allowed lateness of the board.

use drivetwin_firmware::device::{Duration, Instant, Spec};
use drivetwin_sim::record::trace::{Event, OutputRecord, Trace};

use crate::expected::Expected;

/// Allowed delay of an output or an input of the board: interrupts and the loop. This bound and the next ones limit
/// the run time of its code, at 16 ns per instruction. Longest is a reply while the servo of an MDROBOT or RS drive
/// runs: 329 µs.
const LATENCY: Duration = Duration::micros(450);
/// Allowed delay of inputs from the network: frames, each answered by others, and all of their check sums. Longest is
/// the list of a whole program of an MDrive (L), line by line: 764 µs.
const ON_NETWORK: Duration = Duration::micros(850);
/// Allowed delay if the motor gets a new plan then, which the loop computes before it does anything else.
pub(crate) const PLANNING: Duration = Duration::micros(700);
/// Allowed time from its first instruction until it has done all that it does at power-on. Longest,
/// for its memory, is an MDROBOT, which judges each of its rows: 790 µs.
const BOOT: Duration = Duration::micros(800);
/// Additional time for each byte of its memory, which is read and checked then; the same where the drive checks and
/// stores [many](MANY) bytes.
const BYTE: Duration = Duration::from_ticks(4);
/// Bytes that are stored in no time.
const MANY: usize = 256;

/// Allowed lateness in a trace.
pub(crate) struct Patience {
    /// With anything else.
    latency: Duration,
    /// Instants at which it stores many bytes, and the allowed time for that.
    stores: Vec<Instant>,
    storing: Duration,
    /// Allowed time of its start.
    pub(crate) boot: Duration,
}

impl Patience {
    /// With the only drive of a trace.
    pub(crate) fn of(trace: &Trace, spec: &Spec, is_on_network: bool) -> Self {
        let memory = BYTE * u64::from(spec.memory);
        Self {
            latency: if is_on_network { ON_NETWORK } else { LATENCY },
            stores: stores(trace),
            storing: LATENCY + memory,
            boot: BOOT + memory,
        }
    }

    /// With what is due at `at`, but for a start.
    pub(crate) fn at(&self, expected: &Expected, at: Instant) -> Duration {
        match at {
            _ if self.stores.iter().any(|store| (earlier(at, self.storing)..=at).contains(store)) => {
                self.storing
            }
            _ if expected.plans(earlier(at, PLANNING), at) => PLANNING,
            _ => self.latency,
        }
    }
}

/// Instants at which many bytes are stored, a user program of an RS 434544 is restored (FLAG_SAVE_USER_PROGRAM), or
/// an MDrive starts again and sends its sign-on.
fn stores(trace: &Trace) -> Vec<Instant> {
    let many = |event: &Event| match event {
        Event::Output(OutputRecord::Store { bytes, .. }) => bytes.len() > MANY,
        Event::Output(OutputRecord::Bytes { bytes, .. }) => bytes.get(1..4) == Some(&[6, 0x50, 0x25]),
        Event::Output(OutputRecord::Message { bytes, .. }) => bytes.starts_with(b"Copyright"),
        _ => false,
    };
    trace.events().filter(|entry| many(&entry.event)).map(|entry| entry.at).collect()
}

/// The instant `by` before `at`, at least 0.
pub(crate) fn earlier(at: Instant, by: Duration) -> Instant {
    Instant::from_ticks(at.ticks().saturating_sub(by.ticks()))
}
