//! How fast a sensor's edges come.

use standin_protocol::time::TICKS_PER_SECOND;

use crate::device::{Duration, Instant};

/// A speed is taken over a whole number of counts and at least this long, so that ticks do not show in it.
const LEAST: Duration = Duration::millis(2);
/// What makes no edge for so long stands.
const STILL_AFTER: Duration = Duration::secs(1);

/// What an edge was in the measurement.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Window {
    /// The first one: from here on it is measured.
    Begins,
    /// One of many.
    GoesOn,
    /// The last one of so many counts in that time, and the first of the next window.
    Ends {
        /// Forward, or less than 0.
        counts: i32,
        /// How long they took.
        span: Duration,
    },
}

/// How fast edges come.
#[derive(Clone, Debug)]
pub(super) struct Speed {
    /// The edge at which the present window began.
    since: Instant,
    /// Counts since.
    counts: i32,
    /// The last edge, and whether it was forward.
    last: Option<(Instant, bool)>,
    /// The last window that ended in the present direction: counts, forward or less than 0, and their time.
    measured: Option<(i32, Duration)>,
}

impl Speed {
    /// No edge has come.
    pub(super) const NONE: Self = Self { since: Instant::ZERO, counts: 0, last: None, measured: None };

    /// An edge came.
    pub(super) fn edge(&mut self, at: Instant, forward: bool) -> Window {
        let goes_on = !self.is_silent(at) && self.last.is_some_and(|(_, before)| before == forward);
        self.last = Some((at, forward));
        if !goes_on {
            (self.since, self.counts, self.measured) = (at, 0, None);
            return Window::Begins;
        }
        self.counts = self.counts.saturating_add(if forward { 1 } else { -1 });
        let span = at.since(self.since);
        if span < LEAST {
            return Window::GoesOn;
        }
        let counts = core::mem::take(&mut self.counts);
        (self.since, self.measured) = (at, Some((counts, span)));
        Window::Ends { counts, span }
    }

    /// It stands, whatever its edges told.
    pub(super) fn stands(&mut self) {
        self.measured = None;
    }

    /// Counts in the present window.
    pub(super) fn counts(&self) -> i32 {
        self.counts
    }

    /// The last edge.
    pub(super) fn last(&self) -> Option<Instant> {
        self.last.map(|(last, _)| last)
    }

    /// Whether no edge has come for so long that it stands.
    pub(super) fn is_silent(&self, at: Instant) -> bool {
        self.last().is_none_or(|last| at.since(last) >= STILL_AFTER)
    }

    /// In rpm, with so many counts in a turn: as measured last, and no faster than would already have brought the
    /// next edge.
    pub(super) fn rpm(&self, at: Instant, turn: u32) -> i32 {
        let (Some(last), Some((counts, span))) = (self.last(), self.measured) else { return 0 };
        if self.is_silent(at) {
            return 0;
        }
        let (waited, size) = (at.since(last).ticks(), u64::from(counts.unsigned_abs()));
        let (size, ticks) =
            if waited.saturating_mul(size) > span.ticks() { (1, waited) } else { (size, span.ticks()) };
        let turns = ticks.saturating_mul(turn.into());
        let minute = (60 * TICKS_PER_SECOND).saturating_mul(size);
        let rpm = minute.saturating_add(turns / 2).checked_div(turns).unwrap_or(0);
        rpm.min(i32::MAX.unsigned_abs().into()) as i32 * counts.signum()
    }
}
