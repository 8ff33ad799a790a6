//! Copies of a trace that are made in several calls, so that a long trace does not stop the bench.

use std::collections::HashSet;
use std::mem;

use drivetwin_firmware::device::Instant;

use super::{Entry, Event, Group, Retention, Trace};
use crate::ids::DriveId;
use crate::record::journal::{self, Outcome};

impl Trace {
    /// The retained events after the first `mark`, in the order of recording.
    pub fn since(&self, mark: u64) -> impl ExactSizeIterator<Item = &Entry> {
        let skip = usize::try_from(mark.saturating_sub(self.lost)).unwrap_or(usize::MAX);
        self.events.range(skip.min(self.events.len())..)
    }

    /// The events of several traces, each of one drive, in one trace of the drives of `original`, in the order in
    /// which they were recorded. Of a frame on a shared line each trace has an outcome; one for another address is
    /// left out if a drive of the others received the frame.
    pub(crate) fn joined(original: &Self, parts: &[&Self]) -> Self {
        let mut events: Vec<(Instant, Entry)> = Vec::new();
        let mut claimed = HashSet::new();
        for (drive, part) in parts.iter().enumerate() {
            let mut now = Instant::ZERO;
            for entry in part.events() {
                if !entry.is_ahead() {
                    now = now.max(entry.at);
                }
                if let Event::Received(received) = &entry.event
                    && received.outcome != Outcome::NoDrive
                {
                    claimed.insert((received.at, received.message().to_vec()));
                }
                events.push((now, Entry { drive, ..entry.clone() }));
            }
        }
        events.retain(|(_, entry)| match &entry.event {
            Event::Received(received) if received.outcome == Outcome::NoDrive => {
                !claimed.contains(&(received.at, received.message().to_vec()))
            }
            _ => true,
        });
        events.sort_by_key(|(now, _)| *now);
        let events = events.into_iter().map(|(_, entry)| entry).collect();
        let drives = original.drives.clone();
        Self { drives, events, end: original.end, ..Self::new(original.seed, Retention::All) }
    }

    /// Adds the outcomes of messages from journals to a trace in which none are recorded, each at the end of its
    /// message.
    pub fn add_outcomes(&mut self, mut outcomes: Vec<(DriveId, journal::Entry)>) {
        let Some(first) = self.events.front().map(|entry| entry.at) else { return };
        if self.events.iter().any(|entry| matches!(entry.event, Event::Received(_))) {
            return;
        }
        outcomes.retain(|(_, outcome)| outcome.at >= first && outcome.at <= self.end);
        outcomes.sort_by_key(|(_, outcome)| (outcome.at, outcome.number));
        let mut outcomes = outcomes.into_iter().peekable();
        let event = |(drive, outcome): (DriveId, journal::Entry)| Entry {
            at: outcome.at,
            drive: drive.0 as usize,
            event: Event::Received(Box::new(outcome)),
            line: 0,
        };
        for entry in mem::take(&mut self.events) {
            while !entry.is_ahead()
                && let Some(earlier) = outcomes.next_if(|(_, outcome)| outcome.at < entry.at)
            {
                self.events.push_back(event(earlier));
            }
            self.events.push_back(entry);
        }
        self.events.extend(outcomes.map(event));
    }

    /// A copy without events; [`copy_back`](Self::copy_back) adds them.
    #[must_use]
    pub fn outline(&self) -> Self {
        let (seed, drives, compare) = (self.seed, self.drives.clone(), self.compare.clone());
        let generation = self.generation;
        Self {
            drives,
            compare,
            generation,
            lost: self.mark(),
            end: self.end,
            ..Self::new(seed, Retention::All)
        }
    }

    /// Copies at most `most` more events from `original`, of which this must be an [outline](Self::outline):
    /// the newest first, up to `room` bytes of memory. Returns true if events are left to copy. Events that the ring
    /// of `original` drops in the meantime are lost here, too.
    pub fn copy_back(&mut self, original: &Self, room: usize, most: usize) -> bool {
        let missing = usize::try_from(self.lost.saturating_sub(original.lost)).unwrap_or(usize::MAX);
        self.events.reserve(missing.min(room.saturating_sub(self.bytes) / size_of::<Entry>()));
        for entry in original.events.range(..missing).rev().take(most) {
            if self.bytes + entry.size() > room {
                return false;
            }
            self.bytes += entry.size();
            self.events.push_front(entry.clone());
            self.lost -= 1;
        }
        missing > most
    }
}

impl Entry {
    /// Returns true if the stamp of the event may be later than its recording.
    fn is_ahead(&self) -> bool {
        self.event.is_ahead()
    }
}

impl Event {
    /// Returns true if the stamp of the event may be later than its recording.
    pub(crate) fn is_ahead(&self) -> bool {
        matches!(self, Self::Output(output) if matches!(output.group(), Group::Tx | Group::Line))
    }
}

#[cfg(test)]
mod tests {
    use drivetwin_protocol::time::Span;

    use super::*;
    use crate::bench::{Bench, PinStimulus, Settings};
    use crate::testing::test_device::{LEVEL, TestDevice};

    /// A bench whose trace has that retention, and a function that makes that many inputs on the bench.
    fn bench(retention: Retention) -> (Bench, impl Fn(&mut Bench, i32)) {
        let mut bench = Bench::with(Settings { trace: retention, ..Settings::default() });
        let toy = bench.add::<TestDevice>("toy");
        let happen = move |bench: &mut Bench, times: i32| {
            for mv in 0..times {
                bench.set_pin(toy, LEVEL, PinStimulus::Millivolts(mv));
                bench.run_until(bench.now() + 1.millis());
            }
        };
        (bench, happen)
    }

    /// A limit of memory that none of these traces reaches.
    const ROOM: usize = 1 << 20;

    #[test]
    fn in_pieces_it_is_what_it_was_at_the_beginning() {
        let (mut bench, happen) = bench(Retention::All);
        happen(&mut bench, 20);
        let text = bench.trace().to_text();
        let mut copy = bench.trace().outline();
        let mut pieces = 1;
        while copy.copy_back(bench.trace(), ROOM, 3) {
            happen(&mut bench, 1);
            pieces += 1;
        }
        assert_eq!(pieces, copy.mark().div_ceil(3));
        assert_eq!(copy.to_text(), text);
    }

    #[test]
    fn what_the_ring_drops_meanwhile_is_lost() {
        let (mut bench, happen) = bench(Retention::Ring(1_000));
        happen(&mut bench, 20);
        let mut copy = bench.trace().outline();
        let mark = copy.mark();
        assert!(copy.copy_back(bench.trace(), ROOM, 1));
        happen(&mut bench, 5);
        let kept = bench.trace().lost;
        while copy.copy_back(bench.trace(), ROOM, 1) {}
        assert_eq!((copy.lost, copy.mark()), (kept, mark));
        assert!(bench.trace().events().zip(copy.events()).all(|(original, copy)| original == copy));

        let mut copy = copy.outline();
        happen(&mut bench, 20);
        assert!(!copy.copy_back(bench.trace(), ROOM, 1), "nothing is left of what was before the mark");
        assert_eq!((copy.lost, copy.events().len()), (mark, 0));
    }

    #[test]
    fn of_more_than_there_is_room_for_it_is_the_end() {
        let (mut bench, happen) = bench(Retention::All);
        happen(&mut bench, 20);
        let newest: Vec<_> = bench.trace().since(bench.trace().mark() - 5).collect();
        let room = newest.iter().map(|entry| entry.size()).sum();
        for room in [room, room + size_of::<Entry>() - 1] {
            let mut copy = bench.trace().outline();
            while copy.copy_back(bench.trace(), room, 2) {}
            assert_eq!(copy.events().collect::<Vec<_>>(), newest);
            assert_eq!(copy.mark(), bench.trace().mark());
            assert!(copy.to_text().contains(&format!("lost {}", copy.lost)), "{}", copy.to_text());
        }
    }
}
