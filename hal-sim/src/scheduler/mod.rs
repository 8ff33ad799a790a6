//! The order of events: classes of one instant, a queue of events, a tournament of deadlines.

mod queue;
mod tournament;

use crate::record::trace::InputRecord;
pub(crate) use queue::{Event, Queue};
pub(crate) use tournament::Tournament;

/// Order of events at one instant.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(crate) enum Phase {
    Power,
    Fault,
    Pin,
    Line,
    Deadline,
    /// A preset: it returns what became of it, so it cannot wait for its turn.
    Preset,
    /// End of a turn on a line, after all drives have acted.
    Turn,
}

impl Phase {
    /// Class of an input.
    pub(crate) fn of(fed: &InputRecord) -> Self {
        match fed {
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
