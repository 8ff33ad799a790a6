//! Events of the motion for the rest of the drive, which takes them after each input.

use heapless::Deque;

use crate::mdrive::error::Error;

/// Event of the motion.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) enum Event {
    /// An error.
    Failed(Error),
    /// A limit also stops the program (LM 3, 6).
    StopsProgram,
    /// A move with parameter 2 has ended: the drive sends its name.
    Announce,
}

/// Events that the drive has not taken yet.
#[derive(Clone, Debug)]
pub(super) struct Events(Deque<Event, 8>);

impl Events {
    pub(super) const NONE: Self = Self(Deque::new());

    pub(super) fn push(&mut self, event: Event) {
        let queued = self.0.push_back(event);
        debug_assert!(queued.is_ok(), "the drive takes events after each input, each line of a message, too");
    }

    /// Reports an error.
    pub(super) fn fail(&mut self, error: Error) {
        self.push(Event::Failed(error));
    }

    /// Takes the oldest event, if any.
    pub(super) fn next(&mut self) -> Option<Event> {
        self.0.pop_front()
    }
}
