//! The instants of a plan's steps, one after the other.

use standin_protocol::time::{Duration, Instant};

use super::Plan;

/// A step of an axis.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Step {
    /// The tick nearest to its instant.
    pub at: Instant,
    /// Whether the position grows.
    pub forward: bool,
}

/// Walks a plan: yields its steps in order, each as soon as the one before it has been taken.
#[derive(Clone, Debug)]
pub struct Walker {
    plan: Plan,
    after: Instant,
}

impl Walker {
    /// Of `plan`, from its first step later than `after`, which is not before the plan's start.
    #[must_use]
    pub fn new(plan: &Plan, after: Instant) -> Self {
        Self { plan: *plan, after: after.max(plan.start()) }
    }
}

impl Iterator for Walker {
    type Item = Step;

    fn next(&mut self) -> Option<Step> {
        let from = self.plan.position_at(self.after);
        let last = self.plan.end().min(self.after + Duration::secs(1_000));
        if self.plan.position_at(last) == from {
            return None;
        }
        let (mut low, mut high) = (self.after, last);
        while high.since(low) > Duration::TICK {
            let middle = low + Duration::from_ticks(high.since(low).ticks() / 2);
            if self.plan.position_at(middle) == from { low = middle } else { high = middle }
        }
        self.after = high;
        let forward = self.plan.position_at(high).wrapping_sub(from) > 0;
        Some(Step { at: high, forward })
    }
}
