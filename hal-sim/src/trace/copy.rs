//! Copies that are made piece by piece, so that nobody has to wait for the whole of a long trace.

use super::{Entry, Trace, TraceKeep};

impl Trace {
    /// The events that are kept of those after the first `mark`, in the order in which they happened.
    pub fn since(&self, mark: u64) -> impl ExactSizeIterator<Item = &Entry> {
        let skip = usize::try_from(mark.saturating_sub(self.lost)).unwrap_or(usize::MAX);
        self.events.range(skip.min(self.events.len())..)
    }

    /// A copy without the events, which [`copy_on`](Self::copy_on) brings.
    #[must_use]
    pub fn outline(&self) -> Self {
        let (seed, drives, compare) = (self.seed, self.drives.clone(), self.compare.clone());
        Self { drives, compare, lost: self.lost, end: self.end, ..Self::new(seed, TraceKeep::All) }
    }

    /// Brings at most `most` more events of what this is an [outline](Self::outline) of, none beyond
    /// `mark`; whether there are more. What the ring has dropped meanwhile is lost here, too, with all
    /// before it.
    pub fn copy_on(&mut self, original: &Self, mark: u64, most: usize) -> bool {
        if original.lost > self.mark() {
            self.events.clear();
            self.bytes = 0;
            self.lost = original.lost.min(mark);
        }
        let missing = usize::try_from(mark - self.mark()).unwrap_or(usize::MAX);
        self.events.reserve(missing);
        for entry in original.since(self.mark()).take(missing.min(most)) {
            self.bytes += entry.size();
            self.events.push_back(entry.clone());
        }
        self.mark() < mark
    }
}

#[cfg(test)]
mod tests {
    use standin_protocol::time::Span;

    use super::*;
    use crate::bench::{Bench, Driving, Settings};
    use crate::toy::{LEVEL, Toy};

    /// A bench whose trace is that short, and something that happens on it again and again.
    fn bench(keep: TraceKeep) -> (Bench, impl Fn(&mut Bench, i32)) {
        let mut bench = Bench::with(Settings { trace: keep, ..Settings::default() });
        let toy = bench.add::<Toy>("toy");
        let happen = move |bench: &mut Bench, times: i32| {
            for mv in 0..times {
                bench.set_pin(toy, LEVEL, Driving::Millivolts(mv));
                bench.run_until(bench.now() + 1.millis());
            }
        };
        (bench, happen)
    }

    #[test]
    fn in_pieces_it_is_what_it_was_at_the_mark() {
        let (mut bench, happen) = bench(TraceKeep::All);
        happen(&mut bench, 20);
        let text = bench.trace().to_text();
        let (mut copy, mark) = (bench.trace().outline(), bench.trace().mark());
        let mut pieces = 1;
        while copy.copy_on(bench.trace(), mark, 3) {
            happen(&mut bench, 1);
            pieces += 1;
        }
        assert_eq!(pieces, mark.div_ceil(3));
        assert_eq!(copy.to_text(), text);
    }

    #[test]
    fn what_the_ring_drops_meanwhile_is_lost_with_all_before_it() {
        let (mut bench, happen) = bench(TraceKeep::Ring(1_000));
        happen(&mut bench, 20);
        let (mut copy, mark) = (bench.trace().outline(), bench.trace().mark());
        assert!(copy.lost > 0 && copy.copy_on(bench.trace(), mark, 1));
        happen(&mut bench, 2);
        while copy.copy_on(bench.trace(), mark, 1) {}
        assert_eq!((copy.mark(), copy.lost), (mark, bench.trace().lost));
        assert!(copy.events().len() > 0);
        let kept: Vec<_> = bench.trace().events().take(copy.events().len()).collect();
        assert_eq!(copy.events().collect::<Vec<_>>(), kept);
        happen(&mut bench, 20);
        let mut copy = copy.outline();
        while copy.copy_on(bench.trace(), mark, 1) {}
        assert_eq!(
            (copy.lost, copy.events().len()),
            (mark, 0),
            "nothing is left of what was before the mark"
        );
    }
}
