//! Bench time from the wall clock. This is the only file that reads the wall clock or sleeps.

use std::time::{Duration as WallSpan, Instant as WallInstant};

use drivetwin_firmware::device::{Duration, Instant};
use drivetwin_protocol::time::TICKS_PER_SECOND;
use rustix::time::{ClockId, clock_gettime};

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

/// Time of the computer.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Now {
    /// Time of the wall clock, which stands still while the computer is suspended.
    pub(crate) wall: WallInstant,
    /// Time since the computer was started, also while it was suspended.
    pub(crate) since_boot: WallSpan,
}

impl Now {
    /// Time that has passed since `before`, also while the computer was suspended.
    pub(crate) fn since(self, before: Self) -> WallSpan {
        self.since_boot.saturating_sub(before.since_boot)
    }

    /// Returns true if the computer was suspended since `before`.
    pub(crate) fn was_suspended_since(self, before: Self) -> bool {
        let awake = self.wall.saturating_duration_since(before.wall);
        self.since(before) > awake + AT_ONCE
    }
}

/// Longest time between the two reads of one [`Now`] that is no suspension.
const AT_ONCE: WallSpan = WallSpan::from_millis(500);

/// Time of the computer now.
pub(crate) fn now() -> Now {
    let since_boot = WallSpan::try_from(clock_gettime(ClockId::Boottime)).unwrap_or_default();
    Now { wall: wall(), since_boot }
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
    fn a_suspension_is_told_from_time_that_passes() {
        let start = now();
        let after = |awake: u64, asleep: u64| Now {
            wall: start.wall + WallSpan::from_secs(awake),
            since_boot: start.since_boot + WallSpan::from_secs(awake + asleep),
        };
        assert!(!after(3_600, 0).was_suspended_since(start));
        assert!(after(1, 60).was_suspended_since(start));
        assert!(!after(2, 60).was_suspended_since(after(1, 60)));
        assert_eq!(after(1, 60).since(start), WallSpan::from_secs(61));
        let later = now();
        assert!(later.since_boot >= start.since_boot && later.wall >= start.wall);
    }

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
