//! Speed of a shaft, computed from the edges of a sensor.

use drivetwin_protocol::time::TICKS_PER_SECOND;
use fixed::types::I40F24;

use super::Feedback;
use crate::device::{Duration, Instant};

/// Least time over which a speed is measured. A window has a whole number of counts. The minimum keeps the
/// rounding to ticks out of the result.
const MIN_WINDOW: Duration = Duration::millis(2);
/// Least time over which the counts per turn are measured in a new direction, which may reverse before a window is
/// complete. The rounding of two edges to ticks is then 1/512.
const MIN_TURNED: Duration = Duration::from_ticks(2 * 512);
/// Time without an edge after which a shaft counts as standing. Our choice, because the manuals do not
/// specify it: 5 rpm with 12 counts per turn.
const STILL_AFTER: Duration = Duration::secs(1);
/// Number of missed edges after which the sensor's speed is no longer used, because its wires must be broken.
const MAX_MISSED: I40F24 = I40F24::lit("4");
/// Time after power-on in which sensors report their levels one after another. These changes do not count as
/// edges. Our choice, far below the time between two edges.
pub(crate) const SETTLE: Duration = Duration::micros(20);
/// Distance from an edge to the middle of a count, in counts.
const MIDDLE: I40F24 = I40F24::lit("0.5");
/// A deviation of the counts per turn below 1/256 is a rounding to ticks and is ignored.
const ROUNDING: i64 = 256;

/// An edge of a sensor.
#[derive(Clone, Copy, Debug)]
struct Edge {
    at: Instant,
    forward: bool,
}

/// Edges of a sensor on a shaft, and the speed measured from them.
#[derive(Clone, Debug)]
pub(crate) struct Edges {
    /// Nominal edges per turn; 0 without a sensor.
    turn: i32,
    /// Time of the edge at which the present window began, and the angle of the shaft there, in 2⁻³² turns.
    since: Instant,
    window_angle: Option<i64>,
    /// Counts since the window began.
    counts: i32,
    last: Option<Edge>,
    /// Angle of the shaft at a reference point: the last edge, or the start of the motion. `count_fraction`
    /// is the distance in counts from the edge behind the shaft to this point.
    angle: Option<i64>,
    count_fraction: I40F24,
    /// The last complete window in the present direction: its counts, negative if backward, and its duration.
    measured: Option<(i32, Duration)>,
    /// Measured counts per turn of the shaft, negative if the sensor counts in the other direction; `None`
    /// until measured.
    per_turn: Option<i64>,
}

impl Edges {
    /// State before the first edge of a sensor that nominally has `turn` edges per turn. The shaft is in the middle of a
    /// count.
    pub(crate) const fn new(turn: i32) -> Self {
        Self {
            turn,
            since: Instant::ZERO,
            window_angle: None,
            counts: 0,
            last: None,
            angle: None,
            count_fraction: MIDDLE,
            measured: None,
            per_turn: None,
        }
    }

    /// Nominal edges per turn.
    pub(crate) fn turn(&self) -> i64 {
        self.turn.into()
    }

    /// Changes the nominal number of edges per turn.
    pub(crate) fn set_turn(&mut self, turn: i32) {
        self.turn = turn;
    }

    /// Handles an edge.
    pub(crate) fn edge(&mut self, at: Instant, forward: bool, feedback: &Feedback) {
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
        let least = if self.measured.is_none() { MIN_TURNED } else { MIN_WINDOW };
        if span >= least
            && let (Some(from), Some(to)) = (self.window_angle, self.angle)
        {
            self.measure(self.counts, to.wrapping_sub(from));
        }
        if span < MIN_WINDOW {
            return;
        }
        let counts = core::mem::take(&mut self.counts);
        (self.since, self.window_angle, self.measured) = (at, self.angle, Some((counts, span)));
    }

    /// Measures the counts per turn: `counts` counts were made in `turned`, in 2⁻³² turns.
    fn measure(&mut self, counts: i32, turned: i64) {
        const MOST: i32 = 1 << 20;
        let twice = (i64::from(counts.clamp(-MOST, MOST)) << 33).checked_div(turned).unwrap_or(0);
        let per_turn = ((twice + twice.signum()) / 2).clamp(-i64::from(MOST), MOST.into());
        let present = self.per_turn();
        if per_turn != 0 && (per_turn - present).abs() * ROUNDING > present.abs() {
            self.per_turn = Some(per_turn);
        }
    }

    /// Counts per turn of the shaft, negative if the sensor counts in the other direction: the measured
    /// number, or else the nominal one. Never 0.
    pub(crate) fn per_turn(&self) -> i64 {
        self.per_turn.unwrap_or(self.turn.max(1).into())
    }

    /// Takes the present angle as the reference, at the start of a motion.
    pub(crate) fn begin(&mut self, at: Instant, feedback: &Feedback) {
        (self.count_fraction, self.angle) = (self.count_fraction_at(at, feedback), feedback.angle(at));
    }

    /// Distance in counts from the edge behind the shaft to the shaft, 0 to 1.
    fn count_fraction_at(&self, at: Instant, feedback: &Feedback) -> I40F24 {
        self.count_fraction.saturating_add(self.since_edge(at, feedback)).clamp(I40F24::ZERO, I40F24::ONE)
    }

    /// Distance from the shaft to the middle of the count that is `counts` ahead, limited to `most`.
    pub(crate) fn distance(&self, counts: i64, most: i64, at: Instant, feedback: &Feedback) -> I40F24 {
        I40F24::from_num(counts.min(most).max(-most)) + MIDDLE - self.count_fraction_at(at, feedback)
    }

    /// Sets the measured speed to 0. The last edges no longer count.
    pub(crate) fn set_standstill(&mut self) {
        (self.last, self.measured) = (None, None);
    }

    /// Time of the last edge.
    pub(crate) fn last(&self) -> Option<Instant> {
        self.last.map(|last| last.at)
    }

    /// Returns true if there was no edge for so long that the shaft counts as standing.
    pub(crate) fn is_silent(&self, at: Instant) -> bool {
        self.last().is_none_or(|last| at.since(last) >= STILL_AFTER)
    }

    /// Counts made by the shaft since the last edge, signed; 0 without a report of the shaft.
    fn since_edge(&self, at: Instant, feedback: &Feedback) -> I40F24 {
        self.angle.map_or(I40F24::ZERO, |from| self.counts_from(from, at, feedback))
    }

    /// Counts made by the shaft since it was at the angle `from`, in 2⁻³² turns, signed; 0 without a report
    /// of the shaft.
    pub(crate) fn counts_from(&self, from: i64, at: Instant, feedback: &Feedback) -> I40F24 {
        const MOST: i64 = 1 << 36;
        let turned = feedback.angle(at).map_or(0, |to| to.wrapping_sub(from).clamp(-MOST, MOST));
        I40F24::from_bits((turned >> 8).saturating_mul(self.per_turn()))
    }

    /// Speed of the shaft in rpm as this sensor shows it, at most 2²⁴ in either direction. It is computed from the motor's report, or else from the edges alone. A sensor
    /// that has missed counts shows 0.
    pub(crate) fn reading(&self, at: Instant, feedback: &Feedback) -> I40F24 {
        const MOST: I40F24 = I40F24::const_from_int(1 << 24);
        let Some(rpm) = feedback.rpm(at) else {
            return I40F24::from_num(self.rpm(at)).clamp(-MOST, MOST);
        };
        if self.since_edge(at, feedback).abs() > MAX_MISSED {
            return I40F24::ZERO;
        }
        scaled(rpm, self.per_turn(), self.turn()).clamp(-MOST, MOST)
    }

    /// Speed of the shaft for a speed that this sensor shows, in the same direction.
    pub(crate) fn of_shaft(&self, rpm: I40F24) -> I40F24 {
        scaled(rpm, self.turn(), self.per_turn().abs())
    }

    /// Speed that this sensor shows for a speed of the shaft, in the same direction.
    pub(crate) fn of_sensor(&self, rpm: I40F24) -> I40F24 {
        scaled(rpm, self.per_turn().abs(), self.turn())
    }

    /// Speed in rpm from the edges alone. It is the last measured speed, but no
    /// more than the speed at which the next edge would be due now.
    pub(crate) fn rpm(&self, at: Instant) -> i32 {
        let (Some(last), Some((counts, span))) = (self.last(), self.measured) else { return 0 };
        if self.is_silent(at) {
            return 0;
        }
        let (waited, size) = (at.since(last).ticks(), u64::from(counts.unsigned_abs()));
        let (size, ticks) =
            if waited.saturating_mul(size) > span.ticks() { (1, waited) } else { (size, span.ticks()) };
        let turns = ticks.saturating_mul(self.turn.unsigned_abs().into());
        let minute = (60 * TICKS_PER_SECOND).saturating_mul(size);
        let rpm = minute.saturating_add(turns / 2).checked_div(turns).unwrap_or(0);
        rpm.min(i32::MAX.unsigned_abs().into()) as i32 * counts.signum()
    }
}

/// Converts a speed between two numbers of counts per turn: `rpm`·`to`/`from`.
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
