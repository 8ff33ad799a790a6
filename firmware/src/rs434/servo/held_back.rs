//! Detection of a motor that is held back by the current limit.

use fixed::types::I40F24;

use crate::device::{Duration, Instant};

/// Time without a gain of speed at the current limit after which a motor counts as held back. The time is our
/// choice, because the manual specifies none. A motor that accelerates or brakes at the limit gains speed.
const MIN_TIME: Duration = Duration::millis(100);

/// State of a motor at its current limit, since its last gain of speed.
#[derive(Clone, Copy, Debug)]
pub(super) struct HeldBack {
    /// Direction of the current's torque: 1, −1, or 0 below the limit.
    direction: i32,
    since: Instant,
    /// Speed in this direction at the instant `since`.
    best: I40F24,
}

impl HeldBack {
    /// State below the limit.
    pub(super) const NONE: Self = Self { direction: 0, since: Instant::ZERO, best: I40F24::ZERO };

    /// Returns true if the motor is held back at `at`. `direction` is that of the torque at the current
    /// limit, or 0 below it. `rpm` is the speed of the shaft, if known.
    pub(super) fn update(&mut self, at: Instant, direction: i32, rpm: Option<I40F24>) -> bool {
        let gained = rpm.unwrap_or(I40F24::ZERO) * i64::from(direction);
        if direction == 0 || direction != self.direction || gained > self.best {
            *self = Self { direction, since: at, best: gained };
        }
        direction != 0 && at.since(self.since) >= MIN_TIME
    }
}
