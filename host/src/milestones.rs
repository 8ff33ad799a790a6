//! The counts that the log shows of what happens again and again.

/// The counts that the log shows of what happens again and again: the first one, and again at each power of ten.
#[derive(Default)]
pub(crate) struct Milestones {
    next: u64,
}

impl Milestones {
    /// Returns true if the log shows this count.
    pub(crate) fn is_reached(&mut self, count: u64) -> bool {
        let is_reached = count > 0 && count >= self.next;
        if is_reached {
            self.next = 10_u64.saturating_pow(count.ilog10() + 1);
        }
        is_reached
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_log_shows_the_first_count_and_powers_of_ten() {
        let mut milestones = Milestones::default();
        let shown: Vec<u64> = (0..=1_000).filter(|&count| milestones.is_reached(count)).collect();
        assert_eq!(shown, [1, 10, 100, 1_000]);
        // A count that jumps is shown where it lands.
        assert_eq!(
            [9_999, 10_500, 99_999, 250_000].map(|count| milestones.is_reached(count)),
            [false, true, false, true]
        );
    }
}
