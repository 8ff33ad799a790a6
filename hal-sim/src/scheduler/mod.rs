//! The order of events: phases of one instant, a queue of events, and a tournament of deadlines.

mod queue;
mod tournament;

use crate::record::trace::InputRecord;
pub(crate) use queue::{Event, EventKey, Queue};
pub(crate) use tournament::Tournament;

/// Order of events at one instant.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(crate) enum Phase {
    /// An action of a scenario, which schedules the inputs of the same instant.
    Scenario,
    Power,
    Fault,
    Pin,
    Line,
    Deadline,
    /// A preset. It returns a result to its caller, so it is never queued.
    Preset,
    /// End of a turn on a line, after all drives have acted.
    Turn,
}

impl Phase {
    /// Phase of an input.
    pub(crate) fn of(input: &InputRecord) -> Self {
        match input {
            InputRecord::Power(_) => Self::Power,
            InputRecord::Fault { .. } => Self::Fault,
            InputRecord::Edge { .. }
            | InputRecord::Open { .. }
            | InputRecord::Millivolts { .. }
            | InputRecord::Count { .. }
            | InputRecord::StepsCorrection { .. }
            | InputRecord::MotorCurrent { .. }
            | InputRecord::Motor { .. }
            | InputRecord::Rotation { .. } => Self::Pin,
            InputRecord::Bytes { .. }
            | InputRecord::RxError { .. }
            | InputRecord::Idle { .. }
            | InputRecord::HostPresence { .. }
            | InputRecord::Opened { .. }
            | InputRecord::Message { .. }
            | InputRecord::Closed { .. } => Self::Line,
            InputRecord::Poke { .. } => Self::Preset,
        }
    }
}
