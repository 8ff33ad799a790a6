//! The speed of a shaft by the edges of a sensor.

use drivetwin_protocol::time::TICKS_PER_SECOND;
use fixed::types::I40F24;

use super::Feedback;
use crate::device::{Duration, Instant};

/// A speed is taken over a whole number of counts and at least this long, so that ticks do not show in it.
const MIN_WINDOW: Duration = Duration::millis(2);
/// A shaft without an edge for so long counts as standing; ours, because the manuals do not specify it: 5 rpm with 12
/// counts in a turn.
const STILL_AFTER: Duration = Duration::secs(1);
/// Counts without an edge after which the sensor's speed is no longer used: its wires are broken.
const MAX_MISSED: I40F24 = I40F24::lit("4");
/// Time after power in which sensors report their levels one after another, which are no edges; ours, far below the
/// time between two edges.
pub(crate) const SETTLE: Duration = Duration::micros(20);
/// From an edge to the middle of its count.
const MIDDLE: I40F24 = I40F24::lit("0.5");
/// A deviation below this part of the counts in a turn is that of ticks.
const ROUNDING: i64 = 256;

/// An edge of a sensor.
#[derive(Clone, Copy, Debug)]
struct Edge {
    at: Instant,
    forward: bool,
}

/// Edges of a sensor on a shaft.
#[derive(Clone, Debug)]
pub(crate) struct Edges {
    /// The edge at which the present window began, and where the shaft was, in 2⁻³² turns.
    since: Instant,
    window_angle: Option<i64>,
    /// Counts since.
    counts: i32,
    last: Option<Edge>,
    /// Angle of the shaft at the last edge, or when the motion began, and the part of a count from there back to the
    /// edge behind it.
    angle: Option<i64>,
    count_fraction: I40F24,
    /// The last window that ended in the present direction: counts, forward or less than 0, and their time.
    measured: Option<(i32, Duration)>,
    /// Counts in a turn of the shaft, less than 0 if they go the other way; `None` until they are measured.
    per_turn: Option<i64>,
}

impl Edges {
    /// No edge has come: the shaft is in the middle of a count.
    pub(crate) const NONE: Self = Self {
        since: Instant::ZERO,
        window_angle: None,
        counts: 0,
        last: None,
        angle: None,
        count_fraction: MIDDLE,
        measured: None,
        per_turn: None,
    };

    /// An edge came of a sensor that is to make `turn` of them in a turn.
    pub(crate) fn edge(&mut self, at: Instant, forward: bool, turn: i64, feedback: &Feedback) {
        let continues = !self.is_silent(at) && self.last.is_some_and(|before| before.forward == forward);
        self.last = Some(Edge { at, forward });
        self.angle = feedback.angle(at);
        self.count_fraction = if forward { I40F24::ZERO } else { I40F24::ONE };
        if !continues {
            (self.since, self.window_angle, self.counts, self.measured) = (at, self.angle, 0, None);
            return;
        }
        self.counts = self.counts.saturating_add(if forward { 1 } else { -1 });
        let span = at.since(self.since);
        if span < MIN_WINDOW {
            return;
        }
        let counts = core::mem::take(&mut self.counts);
        if let (Some(from), Some(to)) = (self.window_angle, self.angle) {
            self.measure(counts, to.wrapping_sub(from), turn);
        }
        (self.since, self.window_angle, self.measured) = (at, self.angle, Some((counts, span)));
    }

    /// Measures the counts in a turn: so many counts were so much of a turn, in 2⁻³² turns.
    fn measure(&mut self, counts: i32, turned: i64, turn: i64) {
        const MOST: i32 = 1 << 20;
        let twice = (i64::from(counts.clamp(-MOST, MOST)) << 33).checked_div(turned).unwrap_or(0);
        let per_turn = ((twice + twice.signum()) / 2).clamp(-i64::from(MOST), MOST.into());
        let present = self.per_turn(turn);
        if per_turn != 0 && (per_turn - present).abs() * ROUNDING > present.abs() {
            self.per_turn = Some(per_turn);
        }
    }

    /// Counts in a turn of the shaft, less than 0 if they go the other way: as measured, or else `turn`. Never 0.
    pub(crate) fn per_turn(&self, turn: i64) -> i64 {
        self.per_turn.unwrap_or(turn.max(1))
    }

    /// The sensor is another one, or read otherwise.
    pub(crate) fn reset(&mut self) {
        *self = Self::NONE;
    }

    /// A motion begins.
    pub(crate) fn begin(&mut self, at: Instant, turn: i64, feedback: &Feedback) {
        (self.count_fraction, self.angle) = (self.count_fraction_at(at, turn, feedback), feedback.angle(at));
    }

    /// The part of a count from the edge behind the shaft to it, 0 to 1.
    fn count_fraction_at(&self, at: Instant, turn: i64, feedback: &Feedback) -> I40F24 {
        self.count_fraction
            .saturating_add(self.since_edge(at, turn, feedback))
            .clamp(I40F24::ZERO, I40F24::ONE)
    }

    /// Distance from the shaft to the middle of the count that is `counts` ahead, limited to `most`.
    pub(crate) fn distance(
        &self,
        counts: i64,
        most: i64,
        at: Instant,
        turn: i64,
        feedback: &Feedback,
    ) -> I40F24 {
        I40F24::from_num(counts.min(most).max(-most)) + MIDDLE - self.count_fraction_at(at, turn, feedback)
    }

    /// Sets the speed to 0, whatever the last edges were.
    pub(crate) fn set_standstill(&mut self) {
        (self.last, self.measured) = (None, None);
    }

    /// The last edge.
    pub(crate) fn last(&self) -> Option<Instant> {
        self.last.map(|last| last.at)
    }

    /// Returns whether the time since the last edge is so long that the shaft counts as standing.
    pub(crate) fn is_silent(&self, at: Instant) -> bool {
        self.last().is_none_or(|last| at.since(last) >= STILL_AFTER)
    }

    /// Counts that the shaft has made since the last edge, signed; 0 without a report of the shaft.
    fn since_edge(&self, at: Instant, turn: i64, feedback: &Feedback) -> I40F24 {
        self.angle.map_or(I40F24::ZERO, |from| self.counts_from(from, at, turn, feedback))
    }

    /// Counts that the shaft has made from an angle in 2⁻³² turns, signed; 0 without a report of the shaft.
    pub(crate) fn counts_from(&self, from: i64, at: Instant, turn: i64, feedback: &Feedback) -> I40F24 {
        const MOST: i64 = 1 << 36;
        let turned = feedback.angle(at).map_or(0, |to| to.wrapping_sub(from).clamp(-MOST, MOST));
        I40F24::from_bits((turned >> 8).saturating_mul(self.per_turn(turn)))
    }

    /// Speed of the shaft as this sensor reads it, in rpm, with so many counts in a turn, at most 2²⁴ either way:
    /// by the motor's report, or by edges alone. A sensor that has missed counts reads 0.
    pub(crate) fn reading(&self, at: Instant, turn: i64, feedback: &Feedback) -> I40F24 {
        const MOST: I40F24 = I40F24::const_from_int(1 << 24);
        let Some(rpm) = feedback.rpm(at) else {
            return I40F24::from_num(self.rpm(at, turn)).clamp(-MOST, MOST);
        };
        if self.since_edge(at, turn, feedback).abs() > MAX_MISSED {
            return I40F24::ZERO;
        }
        scaled(rpm, self.per_turn(turn), turn).clamp(-MOST, MOST)
    }

    /// A speed that this sensor reads, as the shaft's, either way.
    pub(crate) fn of_shaft(&self, rpm: I40F24, turn: i64) -> I40F24 {
        scaled(rpm, turn, self.per_turn(turn).abs())
    }

    /// A speed of the shaft, as this sensor reads it, either way.
    pub(crate) fn of_sensor(&self, rpm: I40F24, turn: i64) -> I40F24 {
        scaled(rpm, self.per_turn(turn).abs(), turn)
    }

    /// Speed by edges alone, in rpm, with so many in a turn: as measured last, and no faster than would already have
    /// brought the next one.
    pub(crate) fn rpm(&self, at: Instant, turn: i64) -> i32 {
        let (Some(last), Some((counts, span))) = (self.last(), self.measured) else { return 0 };
        if self.is_silent(at) {
            return 0;
        }
        let (waited, size) = (at.since(last).ticks(), u64::from(counts.unsigned_abs()));
        let (size, ticks) =
            if waited.saturating_mul(size) > span.ticks() { (1, waited) } else { (size, span.ticks()) };
        let turns = ticks.saturating_mul(turn.unsigned_abs());
        let minute = (60 * TICKS_PER_SECOND).saturating_mul(size);
        let rpm = minute.saturating_add(turns / 2).checked_div(turns).unwrap_or(0);
        rpm.min(i32::MAX.unsigned_abs().into()) as i32 * counts.signum()
    }
}

/// A speed in other counts: `to` for `from`.
pub(crate) fn scaled(rpm: I40F24, to: i64, from: i64) -> I40F24 {
    if to == from {
        return rpm;
    }
    let size = rpm.to_bits().unsigned_abs();
    let (whole, rest) = (size.checked_div(from.unsigned_abs()), size.checked_rem(from.unsigned_abs()));
    let (whole, rest) = (whole.unwrap_or(0), rest.unwrap_or(0));
    let to_size = to.unsigned_abs();
    let size = whole.saturating_mul(to_size).saturating_add(rest * to_size / from.unsigned_abs().max(1));
    let sign = rpm.to_bits().signum() * to.signum() * from.signum();
    I40F24::from_bits(size.min(i64::MAX as u64).cast_signed() * sign)
}
