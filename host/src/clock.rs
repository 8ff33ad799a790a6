//! Bench time from the wall clock. This is the only file that reads the wall clock or sleeps.

use std::time::{Duration as WallSpan, Instant as WallInstant};

use drivetwin_firmware::device::{Duration, Instant};
use drivetwin_protocol::time::TICKS_PER_SECOND;

/// Bench time derived from the wall clock: when the wall clock showed `wall`, the bench time was `bench`.
pub(crate) struct Clock {
    pub(crate) factor: u32,
    wall: WallInstant,
    bench: Instant,
}

impl Clock {
    /// A clock that shows bench time `bench` at wall time `wall`.
    pub(crate) fn new(factor: u32, wall: WallInstant, bench: Instant) -> Self {
        Self { factor, wall, bench }
    }

    /// Bench time at `wall`.
    pub(crate) fn at(&self, wall: WallInstant) -> Instant {
        let passed = wall.saturating_duration_since(self.wall).as_nanos() * u128::from(self.factor);
        let ticks = passed * u128::from(TICKS_PER_SECOND) / 1_000_000_000;
        self.bench + Duration::from_ticks(u64::try_from(ticks).unwrap_or(u64::MAX))
    }

    /// Bench time now.
    pub(crate) fn now(&self) -> Instant {
        self.at(wall())
    }

    /// Wall time at which the clock shows `bench`, rounded up; `None` for never.
    pub(crate) fn when(&self, bench: Instant) -> Option<WallInstant> {
        if bench == Instant::NEVER {
            return None;
        }
        let ticks = u128::from(bench.since(self.bench).ticks()) * 1_000_000_000;
        let nanos = ticks.div_ceil(u128::from(TICKS_PER_SECOND) * u128::from(self.factor));
        self.wall.checked_add(WallSpan::from_nanos(u64::try_from(nanos).ok()?))
    }
}

/// Time of the wall clock.
#[expect(clippy::disallowed_methods, reason = "only this file reads the wall clock")]
pub(crate) fn wall() -> WallInstant {
    WallInstant::now()
}

/// Sleeps, where only a look again can tell what has happened meanwhile.
#[expect(clippy::disallowed_methods, reason = "only this file sleeps")]
pub(crate) fn sleep(span: WallSpan) {
    std::thread::sleep(span);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_shows_bench_time_and_wakes_no_tick_early() {
        let start = wall();
        let clock = Clock::new(10, start, Instant::from_ticks(7));
        assert_eq!(clock.at(start), Instant::from_ticks(7));
        assert_eq!(clock.at(start + WallSpan::from_millis(1)), Instant::from_ticks(7 + 160_000));
        assert_eq!(clock.when(Instant::NEVER), None);
        for ticks in [1, 2, 15, 16, 17, 12_345_678] {
            let due = Instant::from_ticks(7 + ticks);
            let when = clock.when(due).unwrap();
            assert!(clock.at(when) >= due);
            assert!(clock.at(when - WallSpan::from_nanos(1)) < due);
        }
    }
}
