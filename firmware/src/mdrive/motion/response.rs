//! SS: the maximum speed of a rotor (FB 5.1). The rotor loses the part of the plan beyond this speed
//! (MDRIVE-29).

use core::num::NonZero;

use fixed::types::I24F8;

use crate::device::{Duration, Instant, Plan};
use crate::motion::Segment;
use drivetwin_protocol::time::TICKS_PER_SECOND;

/// Deceleration of a shaft down to the maximum speed, in steps/s²: the factory's A and D.
const DECELERATION: u32 = 1_000_000;

/// Speed limit of the shaft.
#[derive(Clone, Copy, Debug)]
pub(super) struct Response {
    /// Maximum speed, in steps/s.
    max_speed: u32,
    /// True if the plan is faster.
    is_too_fast: bool,
    /// Time at which the plan becomes too fast, or no longer is.
    due: Instant,
}

impl Response {
    pub(super) const FULL: Self = Self { max_speed: u32::MAX, is_too_fast: false, due: Instant::NEVER };

    /// Sets the maximum speed. Returns true if that is a change.
    pub(super) fn set_max_speed(&mut self, max_speed: u32) -> bool {
        core::mem::replace(&mut self.max_speed, max_speed) != max_speed
    }

    /// Returns true if the plan is faster.
    pub(super) fn is_too_fast(&self) -> bool {
        self.is_too_fast
    }

    /// Time at which the plan becomes too fast, or no longer is.
    pub(super) fn deadline(&self) -> Instant {
        self.due
    }

    /// Checks the speed of the plan. Returns true if the plan has become too fast, or no longer is.
    pub(super) fn update(&mut self, at: Instant, plan: &Plan) -> bool {
        let before = self.is_too_fast;
        let (segment, d) = plan.segment_at(at);
        self.is_too_fast = segment.speed(d) > self.max_in_plan_units();
        self.due = self.changes(at, plan);
        self.is_too_fast != before
    }

    /// Motion of the shaft for this plan.
    pub(super) fn of(&self, at: Instant, plan: &Plan) -> Plan {
        if !self.is_too_fast {
            return *plan;
        }
        let most = I24F8::saturating_from_num(self.max_speed);
        plan.ramp_to(at, if plan.speed_at(at) < 0 { -most } else { most }, DECELERATION)
    }

    /// Time at which a plan becomes too fast next, or no longer is.
    fn changes(&self, at: Instant, plan: &Plan) -> Instant {
        let mut begin = plan.start();
        for segment in plan.segments() {
            let from = at.since(begin).ticks();
            if let Some(d) = self.passes(segment, from) {
                return begin + Duration::from_ticks(d);
            }
            begin += Duration::from_ticks(segment.ticks);
        }
        if self.is_too_fast { begin } else { Instant::NEVER }
    }

    /// Tick of this change within a segment, at `from` or later.
    fn passes(&self, segment: &Segment, from: u64) -> Option<u64> {
        if from >= segment.ticks {
            return None;
        }
        let is_too_fast = |d| segment.speed(d) > self.max_in_plan_units();
        if is_too_fast(from) != self.is_too_fast {
            return Some(from);
        }
        let a = NonZero::new(u64::from(segment.acceleration.unsigned_abs()))?;
        let way = (self.max_in_plan_units() - segment.start_speed).unsigned_abs();
        let d = match (self.is_too_fast, segment.acceleration > 0) {
            (false, true) => way / a + 1,
            (true, false) => way.saturating_add(a.get() - 1) / a,
            _ => return None,
        };
        (d > from && d < segment.ticks).then_some(d)
    }

    /// Maximum speed in the unit of a segment's speed.
    fn max_in_plan_units(&self) -> i64 {
        i64::from(self.max_speed) * TICKS_PER_SECOND.cast_signed()
    }
}
