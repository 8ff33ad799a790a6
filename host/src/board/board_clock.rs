//! Wall time of the times of a board.
//!
//! The board says its time when it is asked. At that time the wall clock was between the question and the answer. So each
//! answer bounds the offset between the two clocks, and all answers together bound it more closely. Between two answers the
//! bounds widen by as much as the clocks can drift apart.

use std::time::{Duration, Instant as WallInstant};

use drivetwin_firmware::device::Instant;
use drivetwin_protocol::time::TICKS_PER_SECOND;

/// Greatest drift between a quartz of a board and the clock of a computer: one part in so many.
const DRIFT: i64 = 5_000;

/// Time of a board, between two times of the wall clock.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    /// Time of the board.
    pub(crate) at: Instant,
    /// Wall time before it.
    pub(crate) asked: WallInstant,
    /// Wall time after it.
    pub(crate) answered: WallInstant,
}

/// Estimate of the offset between the clock of a board and the wall clock, in ns.
#[derive(Clone, Debug)]
pub(crate) struct BoardClock {
    /// Wall time from which wall times are counted.
    start: WallInstant,
    /// Bounds of the offset at the wall time of the last answer.
    least: i64,
    greatest: i64,
    answered: i64,
    /// The offset that is used. It changes only when it leaves the bounds, so that distances between events stay exact.
    offset: i64,
}

/// A time of a board in ns.
fn nanos(at: Instant) -> i64 {
    let nanos = u128::from(at.ticks()) * 1_000_000_000 / u128::from(TICKS_PER_SECOND);
    i64::try_from(nanos).unwrap_or(i64::MAX)
}

impl BoardClock {
    /// The clock of a board that has said its time once.
    pub(crate) fn new(seen: Seen) -> Self {
        let start = seen.asked;
        let mut clock = Self { start, least: 0, greatest: 0, answered: 0, offset: 0 };
        (clock.least, clock.greatest) = clock.bounds(seen);
        clock.answered = clock.wall(seen.answered);
        clock.offset = clock.least.midpoint(clock.greatest);
        clock
    }

    /// Wall time in ns since the start.
    fn wall(&self, at: WallInstant) -> i64 {
        i64::try_from(at.saturating_duration_since(self.start).as_nanos()).unwrap_or(i64::MAX)
    }

    /// Bounds of the offset from one answer.
    fn bounds(&self, seen: Seen) -> (i64, i64) {
        let at = nanos(seen.at);
        (self.wall(seen.asked).saturating_sub(at), self.wall(seen.answered).saturating_sub(at))
    }

    /// Takes a further answer. A clock that has jumped, or runs at another rate, has the bounds of this answer alone.
    pub(crate) fn see(&mut self, seen: Seen) {
        let (least, greatest) = self.bounds(seen);
        let answered = self.wall(seen.answered);
        let drift = answered.saturating_sub(self.answered) / DRIFT;
        let closer =
            (self.least.saturating_sub(drift).max(least), self.greatest.saturating_add(drift).min(greatest));
        (self.least, self.greatest) = if closer.0 <= closer.1 { closer } else { (least, greatest) };
        self.answered = answered;
        self.offset = self.offset.clamp(self.least, self.greatest);
    }

    /// Greatest error of the wall times.
    pub(crate) fn error(&self) -> Duration {
        Duration::from_nanos(self.greatest.abs_diff(self.least))
    }

    /// Wall time at which the board was at `at`, but not after `received`.
    pub(crate) fn wall_at(&self, at: Instant, received: WallInstant) -> WallInstant {
        let nanos = u64::try_from(nanos(at).saturating_add(self.offset)).unwrap_or(0);
        let wall = self.start.checked_add(Duration::from_nanos(nanos));
        wall.map_or(received, |wall| wall.min(received))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::clock;

    /// A board whose clock began `ahead` ns before the wall clock, and is fast by `ppm`.
    struct Board {
        start: WallInstant,
        ahead: i64,
        ppm: i64,
    }

    impl Board {
        fn wall(&self, nanos: i64) -> WallInstant {
            self.start + Duration::from_nanos(nanos.unsigned_abs())
        }

        /// Time of the board at a wall time in ns.
        fn time(&self, nanos: i64) -> Instant {
            let own = self.ahead + nanos + nanos * self.ppm / 1_000_000;
            Instant::from_ticks(own.unsigned_abs() * 2 / 125)
        }

        /// An answer: asked at a wall time, with these times to the board and back.
        fn seen(&self, asked: i64, there: i64, back: i64) -> Seen {
            let at = self.time(asked + there);
            Seen { at, asked: self.wall(asked), answered: self.wall(asked + there + back) }
        }

        /// Error of the estimated wall time of what happens at a wall time.
        fn error(&self, clock: &BoardClock, nanos: i64) -> i64 {
            let wall = clock.wall_at(self.time(nanos), self.wall(i64::MAX / 4));
            let found = wall.saturating_duration_since(self.start).as_nanos();
            (i64::try_from(found).unwrap() - nanos).abs()
        }
    }

    proptest! {
        /// The error is at most half of the first, and the whole of the shortest round trip since, plus the drift.
        #[test]
        fn the_offset_is_known_within_the_shortest_round_trip(
            ahead in 1_000_000_i64..1_000_000_000_000,
            ppm in -100_i64..=100,
            trips in proptest::collection::vec((500_000_i64..20_000_000, 500_000_i64..20_000_000), 1..40),
        ) {
            let board = Board { start: clock::wall(), ahead, ppm };
            let mut clock: Option<BoardClock> = None;
            let mut shortest = i64::MAX;
            for (n, (there, back)) in (0_i64..).zip(trips) {
                let asked = 1_000_000_000 * (n + 1);
                let seen = board.seen(asked, there, back);
                // What was known a second ago has drifted by 200 µs.
                shortest = (there + back).min(shortest.saturating_add(200_000 * 2));
                match &mut clock {
                    Some(clock) => clock.see(seen),
                    None => clock = Some(BoardClock::new(seen)),
                }
                let error = board.error(clock.as_ref().unwrap(), asked + there + back);
                prop_assert!(error <= shortest + 10_000, "{error} after {shortest}");
                let greatest = clock.as_ref().unwrap().error().as_nanos();
                prop_assert!(error <= i64::try_from(greatest).unwrap() + 10_000, "{error} is not within {greatest}");
            }
        }
    }

    #[test]
    fn the_offset_stays_while_it_may_be_right() {
        let board = Board { start: clock::wall(), ahead: 5_000_000_000, ppm: 0 };
        let mut clock = BoardClock::new(board.seen(1_000_000_000, 1_000_000, 1_000_000));
        let offset = clock.offset;
        for n in 2..100 {
            clock.see(board.seen(n * 1_000_000_000, 1_000_000 + n * 10_000, 9_000_000 - n * 20_000));
            assert_eq!(clock.offset, offset, "{n}");
        }
    }

    #[test]
    fn a_clock_that_jumps_is_followed_at_once_and_no_event_is_in_the_future() {
        let board = Board { start: clock::wall(), ahead: 5_000_000_000, ppm: 0 };
        let mut clock = BoardClock::new(board.seen(1_000_000_000, 500_000, 500_000));
        // The computer was asleep for an hour, in which the board went on or not.
        for ahead in [3_600_000_000_000, 4_000_000_000] {
            let later = Board { ahead, ..board };
            clock.see(later.seen(10_000_000_000, 500_000, 500_000));
            assert!(later.error(&clock, 10_000_000_000) <= 1_000_000);
            let received = later.wall(11_000_000_000);
            assert_eq!(clock.wall_at(later.time(12_000_000_000), received), received);
        }
    }
}
