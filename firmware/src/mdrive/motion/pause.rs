//! PS and RS: motion stops and continues (MC 5-57, 5-61).

use super::Motion;
use super::orders::{Activity, Task};
use crate::device::{Context, Instant};

impl Motion {
    /// PS: stops with D and stores the rest of the motion. A jog or a motion by the clock is not stored,
    /// because it is not the program's.
    pub(in crate::mdrive) fn pause(&mut self, at: Instant, out: &mut dyn Context) {
        let left = match self.activity {
            Activity::Planning(way) | Activity::Moves(way) if way.ordered => Some(Task::Move(way)),
            Activity::Slews(speed) => Some(Task::Slew(speed)),
            Activity::Homes(homing) => Some(Task::Home(homing.order())),
            _ => self.left,
        };
        (self.paused, self.left) = (true, left);
        if !matches!(self.activity, Activity::Settles(_)) {
            self.ramp_down(at, false, out);
        }
        self.refresh(at, out);
    }

    /// RS: continues with the stored motion.
    pub(in crate::mdrive) fn resume(&mut self, at: Instant, out: &mut dyn Context) {
        if !core::mem::take(&mut self.paused) {
            return;
        }
        match (self.left.take(), self.activity) {
            (Some(task), Activity::Rest) => {
                self.begin(at, task, out);
                // A limit may have prevented the start of the task.
                if self.activity == Activity::Rest {
                    self.over(at, out);
                }
            }
            // Another motion was commanded meanwhile.
            (Some(task), activity) => {
                self.waiting = Some(task);
                if matches!(activity, Activity::Slews(_) | Activity::Jogs { .. } | Activity::Follows) {
                    self.ramp_down(at, true, out);
                }
            }
            (None, Activity::Rest) => self.over(at, out),
            (None, _) => {}
        }
        self.refresh(at, out);
    }
}
