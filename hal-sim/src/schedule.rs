//! Who is next: a tournament of deadlines, and a heap of what is under way.

use std::cmp::{Ordering, Reverse};
use std::collections::BinaryHeap;

use drivetwin_firmware::device::{Axis, Encoder, Instant, Level, Pin};

use crate::bench::Driving;
use crate::trace::Fed;

/// What comes first of what happens at one instant.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(crate) enum Class {
    Power,
    Fault,
    Pin,
    Line,
    Deadline,
    /// A preset: it returns what became of it, so it cannot wait for its turn.
    Preset,
    /// Whose turn it is on a line, when all drives have had their say.
    Turn,
}

impl Class {
    /// Where something belongs.
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

/// The total order of everything that happens on a bench. Seats count by the rank of their names, so
/// that the order in which they were added never matters.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(crate) struct Key {
    pub(crate) at: Instant,
    pub(crate) class: Class,
    pub(crate) rank: u32,
    pub(crate) sequence: u64,
}

/// Something under way.
#[derive(Debug)]
pub(crate) struct Event {
    pub(crate) key: Key,
    /// To which seat.
    pub(crate) seat: u32,
    pub(crate) what: What,
}

/// What is under way.
#[derive(Debug)]
pub(crate) enum What {
    /// To be fed to a device.
    Fed(Fed),
    /// To be fed to a device that shares a line with the one that began to say it then.
    Overheard { fed: Fed, began: Instant },
    /// A character to be fed to a device, if it overlaps no other one: it belongs to what has that number on the
    /// line.
    Exposed { fed: Fed, number: u32 },
    /// To be fed to a device, unless the connection on which that client said it is closed by then.
    Said { client: u32, fed: Fed },
    /// What hands do to a pin.
    Hand { pin: Pin, drive: Driving },
    /// Levels at the pins of a device that was seated at this instant.
    Contacts,
    /// The other end of a wire takes a level.
    Wired { wire: u32, level: Level },
    /// The next edge of a train of pulses. `number` tells it from earlier trains on the pin; so it is
    /// with encoders, waves and axes.
    Pulse { pin: Pin, number: u32 },
    /// The next edge of an encoder.
    Encoder { encoder: Encoder, number: u32 },
    /// The next edge of a wave on an output.
    Wave { pin: Pin, number: u32 },
    /// The next edge of the step pulses of an axis.
    Steps { axis: Axis, number: u32 },
    /// Something is due at the motor in place of a seat, as it was foreseen last.
    Motor { number: u32 },
    /// What a motor does arrives at its drive.
    Felt { motor: u32 },
    /// Somebody's turn on a line may end.
    Turn { bus: u32 },
}

impl PartialEq for Event {
    fn eq(&self, other: &Self) -> bool {
        self.key == other.key
    }
}

impl Eq for Event {}

impl PartialOrd for Event {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Event {
    fn cmp(&self, other: &Self) -> Ordering {
        self.key.cmp(&other.key)
    }
}

/// Everything under way, the first on top.
#[derive(Debug, Default)]
pub(crate) struct Heap {
    events: BinaryHeap<Reverse<Event>>,
    sequence: u64,
}

impl Heap {
    /// Sends something on its way.
    // Where it is inlined an event is written once, and not copied about on its way to its place.
    #[inline(always)]
    pub(crate) fn push(&mut self, at: Instant, class: Class, rank: u32, seat: u32, what: What) {
        self.sequence += 1;
        let key = Key { at, class, rank, sequence: self.sequence };
        self.events.push(Reverse(Event { key, seat, what }));
    }

    /// The key of the first.
    pub(crate) fn first(&self) -> Option<&Key> {
        self.events.peek().map(|Reverse(event)| &event.key)
    }

    pub(crate) fn pop(&mut self) -> Option<Event> {
        self.events.pop().map(|Reverse(event)| event)
    }

    /// Gives every event the rank that its seat has now.
    pub(crate) fn rank(&mut self, rank: impl Fn(u32) -> u32) {
        let mut events = std::mem::take(&mut self.events).into_vec();
        for Reverse(event) in &mut events {
            event.key.rank = rank(event.seat);
        }
        self.events = events.into();
    }
}

/// The next deadline of every seat, in a tree of winners: a change costs one comparison a level.
/// Of equal deadlines the lower rank wins.
#[derive(Debug)]
pub(crate) struct Tournament {
    /// The root at 1, the children of `n` at `2n` and `2n + 1`; the leaves are the second half.
    nodes: Vec<(Instant, u32)>,
}

impl Tournament {
    /// Of these deadlines, in the order of their ranks.
    pub(crate) fn new(deadlines: &[Instant]) -> Self {
        let leaves = deadlines.len().next_power_of_two();
        let mut nodes = vec![(Instant::NEVER, u32::MAX); 2 * leaves];
        for (rank, (leaf, &deadline)) in (0..).zip(nodes[leaves..].iter_mut().zip(deadlines)) {
            *leaf = (deadline, rank);
        }
        for node in (1..leaves).rev() {
            nodes[node] = nodes[2 * node].min(nodes[2 * node + 1]);
        }
        Self { nodes }
    }

    /// The earliest deadline and whose it is.
    pub(crate) fn first(&self) -> (Instant, u32) {
        self.nodes[1]
    }

    /// The next deadline of one.
    pub(crate) fn set(&mut self, rank: u32, deadline: Instant) {
        let mut node = self.nodes.len() / 2 + rank as usize;
        self.nodes[node] = (deadline, rank);
        while node > 1 {
            node /= 2;
            let winner = self.nodes[2 * node].min(self.nodes[2 * node + 1]);
            if self.nodes[node] == winner {
                break;
            }
            self.nodes[node] = winner;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_tournament_finds_what_a_scan_finds(
            mut deadlines in proptest::collection::vec(0_u64..50, 1..40),
            changes in proptest::collection::vec((any::<usize>(), 0_u64..50), 0..80),
        ) {
            let instants: Vec<Instant> = deadlines.iter().map(|&n| Instant::from_ticks(n)).collect();
            let mut tournament = Tournament::new(&instants);
            for (place, deadline) in changes {
                let place = place % deadlines.len();
                deadlines[place] = deadline;
                tournament.set(u32::try_from(place).unwrap(), Instant::from_ticks(deadline));
                let (rank, &first) = deadlines.iter().enumerate().min_by_key(|&(rank, &due)| (due, rank)).unwrap();
                prop_assert_eq!(tournament.first(), (Instant::from_ticks(first), u32::try_from(rank).unwrap()));
            }
        }
    }

    #[test]
    fn an_empty_bench_waits_for_ever() {
        assert_eq!(Tournament::new(&[]).first().0, Instant::NEVER);
    }
}
