//! Allowed lateness of the board.

use drivetwin_firmware::device::{Duration, Instant, Spec};
use drivetwin_sim::record::trace::{Event, OutputRecord, Trace};

use crate::expected::Expected;

/// Allowed delay of an output or an input of the board, caused by interrupts and the loop. This bound and the
/// next ones limit how many instructions the code executes, at 16 ns per instruction. The longest measured delay
/// is that of a reply while the servo of an MDROBOT or RS drive runs: 329 µs.
const LATENCY: Duration = Duration::micros(450);
/// Allowed delay of inputs from the network. It includes the frames, the frames that answer each of them, and
/// all check sums. The longest measured delay is that of an MDrive that lists a whole program (L): 764 µs.
const ON_NETWORK: Duration = Duration::micros(850);
/// Allowed delay if the motor gets a new plan, which the loop computes before it does anything else.
pub(crate) const PLANNING: Duration = Duration::micros(700);
/// Allowed time from the first instruction until the start-up is done, without the time for the memory
/// ([`BYTE`]). The longest start-up is that of an MDROBOT, which checks each of its rows: 790 µs with the
/// time for its memory.
const BOOT: Duration = Duration::micros(800);
/// Additional time for each byte of the memory, which is read and checked at the start. The same time applies
/// if the drive checks and stores [many](MANY) bytes.
const BYTE: Duration = Duration::from_ticks(4);
/// Number of bytes that the drive stores without additional time.
const MANY: usize = 256;

/// Allowed lateness of the outputs of a trace.
pub(crate) struct Patience {
    /// Allowed lateness in all other cases.
    latency: Duration,
    /// Instants at which the drive stores many bytes, and the allowed time for that.
    stores: Vec<Instant>,
    storing: Duration,
    /// Allowed time of the start-up.
    pub(crate) boot: Duration,
}

impl Patience {
    /// Allowed lateness for a trace with one drive.
    pub(crate) fn of(trace: &Trace, spec: &Spec, is_on_network: bool) -> Self {
        let memory = BYTE * u64::from(spec.memory);
        Self {
            latency: if is_on_network { ON_NETWORK } else { LATENCY },
            stores: stores(trace),
            storing: LATENCY + memory,
            boot: BOOT + memory,
        }
    }

    /// Allowed lateness of an output that is due at `at`, except at a start-up.
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

/// Instants at which many bytes are stored, a user program of an RS 434544 is restored
/// (FLAG_SAVE_USER_PROGRAM), or an MDrive restarts and sends its sign-on.
fn stores(trace: &Trace) -> Vec<Instant> {
    let many = |event: &Event| match event {
        Event::Output(OutputRecord::Store { bytes, .. }) => bytes.len() > MANY,
        Event::Output(OutputRecord::Bytes { bytes, .. }) => bytes.get(1..4) == Some(&[6, 0x50, 0x25]),
        Event::Output(OutputRecord::Message { bytes, .. }) => bytes.starts_with(b"Copyright"),
        _ => false,
    };
    trace.events().filter(|entry| many(&entry.event)).map(|entry| entry.at).collect()
}

/// The instant `by` before `at`, or 0 if that would be negative.
pub(crate) fn earlier(at: Instant, by: Duration) -> Instant {
    Instant::from_ticks(at.ticks().saturating_sub(by.ticks()))
}
