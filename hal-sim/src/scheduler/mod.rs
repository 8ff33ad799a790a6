//! The order of events: classes of one instant, a queue of events, a tournament of deadlines.

mod queue;
mod tournament;

use crate::record::trace::Fed;
pub(crate) use queue::{Event, Queue};
pub(crate) use tournament::Tournament;

/// Order of events at one instant.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(crate) enum Class {
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

impl Class {
    /// Class of an input.
    pub(crate) fn of(fed: &Fed) -> Self {
        match fed {
            Fed::Power(_) => Self::Power,
            Fed::Fault { .. } => Self::Fault,
            Fed::Edge { .. }
            | Fed::Open { .. }
            | Fed::Millivolts { .. }
            | Fed::Count { .. }
            | Fed::Slipped { .. }
            | Fed::Draws { .. }
            | Fed::Motor { .. }
            | Fed::Rotation { .. } => Self::Pin,
            Fed::Bytes { .. }
            | Fed::Spoiled { .. }
            | Fed::Idle { .. }
            | Fed::Attached { .. }
            | Fed::Opened { .. }
            | Fed::Message { .. }
            | Fed::Closed { .. } => Self::Line,
            Fed::Poke { .. } => Self::Preset,
        }
    }
}
