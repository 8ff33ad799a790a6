//! A tournament of deadlines, a tree in which the earliest deadline wins.

use drivetwin_firmware::device::Instant;

/// The next deadline of every drive, in a tree of winners. A change costs one comparison per level of the
/// tree. If deadlines are equal, the lower rank wins.
#[derive(Debug)]
pub(crate) struct Tournament {
    /// The root is at index 1, the children of `n` are at `2n` and `2n + 1`, and the leaves are the second
    /// half.
    nodes: Vec<(Instant, u32)>,
    /// Leaves from the first to the last one that was changed and not yet compared.
    changed: Option<(usize, usize)>,
}

impl Tournament {
    /// A tournament of these deadlines; the index of a deadline is its rank.
    pub(crate) fn new(deadlines: &[Instant]) -> Self {
        let leaves = deadlines.len().next_power_of_two();
        let mut nodes = vec![(Instant::NEVER, u32::MAX); 2 * leaves];
        for (rank, (leaf, &deadline)) in (0..).zip(nodes[leaves..].iter_mut().zip(deadlines)) {
            *leaf = (deadline, rank);
        }
        for node in (1..leaves).rev() {
            nodes[node] = nodes[2 * node].min(nodes[2 * node + 1]);
        }
        Self { nodes, changed: None }
    }

    /// The earliest deadline and its rank.
    pub(crate) fn first(&self) -> (Instant, u32) {
        self.nodes[1]
    }

    /// Sets the next deadline of a rank, without comparing it: the [first](Self::first) deadline is unknown until
    /// [`compare`](Self::compare). For many changes at once, this costs less than [`set`](Self::set).
    pub(crate) fn set_uncompared(&mut self, rank: u32, deadline: Instant) {
        let leaf = self.nodes.len() / 2 + rank as usize;
        self.nodes[leaf] = (deadline, rank);
        let (first, last) = self.changed.unwrap_or((leaf, leaf));
        self.changed = Some((first.min(leaf), last.max(leaf)));
    }

    /// Compares all deadlines that were set without comparing them.
    pub(crate) fn compare(&mut self) {
        let Some((mut first, mut last)) = self.changed.take() else { return };
        while first > 1 {
            (first, last) = (first / 2, last / 2);
            for node in first..=last {
                self.nodes[node] = self.nodes[2 * node].min(self.nodes[2 * node + 1]);
            }
        }
    }

    /// Sets the next deadline of a rank.
    pub(crate) fn set(&mut self, rank: u32, deadline: Instant) {
        let mut node = self.nodes.len() / 2 + rank as usize;
        let mut winner = (deadline, rank);
        while self.nodes[node] != winner {
            self.nodes[node] = winner;
            if node == 1 {
                break;
            }
            winner = winner.min(self.nodes[node ^ 1]);
            node /= 2;
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
            changes in proptest::collection::vec((any::<usize>(), 0_u64..50, any::<bool>()), 0..80),
        ) {
            let instants: Vec<Instant> = deadlines.iter().map(|&n| Instant::from_ticks(n)).collect();
            let mut tournament = Tournament::new(&instants);
            for (place, deadline, at_once) in changes {
                let place = place % deadlines.len();
                deadlines[place] = deadline;
                let (rank, deadline) = (u32::try_from(place).unwrap(), Instant::from_ticks(deadline));
                if !at_once {
                    tournament.set_uncompared(rank, deadline);
                    continue;
                }
                tournament.compare();
                tournament.set(rank, deadline);
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
