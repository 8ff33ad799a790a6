//! A tournament of deadlines, a tree in which the earliest deadline wins.

use drivetwin_firmware::device::Instant;

/// The next deadline of every drive, in a tree of winners. A change costs at most one comparison per level of the tree. If
/// deadlines are equal, the lower rank wins.
#[derive(Debug)]
pub(crate) struct Tournament {
    /// The root is at index 1, the children of `n` are at `2n` and `2n + 1`, and the leaves are the second
    /// half.
    nodes: Vec<(Instant, u32)>,
    /// Leaves whose new deadlines are not compared yet.
    changed: Vec<u32>,
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
        Self { nodes, changed: Vec::new() }
    }

    /// Sets the next deadline of a rank.
    pub(crate) fn set(&mut self, rank: u32, deadline: Instant) {
        let leaf = (self.nodes.len() / 2) as u32 + rank;
        if std::mem::replace(&mut self.nodes[leaf as usize].0, deadline) != deadline {
            self.changed.push(leaf);
        }
    }

    /// Compares the new deadlines, level by level, up to the winners that stay.
    pub(crate) fn compare(&mut self) {
        // Most events change one deadline.
        if let [leaf] = self.changed[..] {
            self.changed.clear();
            let mut node = leaf as usize;
            while node > 1 && self.play(node / 2) {
                node /= 2;
            }
            return;
        }
        while self.changed.first().is_some_and(|&node| node > 1) {
            let mut kept = 0;
            for n in 0..self.changed.len() {
                let parent = self.changed[n] / 2;
                if self.play(parent as usize) {
                    self.changed[kept] = parent;
                    kept += 1;
                }
            }
            self.changed.truncate(kept);
        }
        self.changed.clear();
    }

    /// Compares the children of a node. Returns true if the winner is another one.
    fn play(&mut self, node: usize) -> bool {
        let (left, right) = (self.nodes[2 * node], self.nodes[2 * node + 1]);
        let winner = if right.0 < left.0 { right } else { left };
        std::mem::replace(&mut self.nodes[node], winner) != winner
    }

    /// The earliest deadline and its rank. Without new deadlines since [`compare`](Self::compare) this is a look at the root,
    /// otherwise at all deadlines.
    pub(crate) fn first(&self) -> (Instant, u32) {
        if self.changed.is_empty() {
            return self.nodes[1];
        }
        let leaves = &self.nodes[self.nodes.len() / 2..];
        leaves.iter().min().copied().unwrap_or((Instant::NEVER, u32::MAX))
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
            for (place, deadline, compares) in changes {
                let place = place % deadlines.len();
                deadlines[place] = deadline;
                tournament.set(u32::try_from(place).unwrap(), Instant::from_ticks(deadline));
                if compares {
                    tournament.compare();
                    prop_assert!(tournament.changed.is_empty());
                }
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
