//! A motor that the limit of its current holds back.

use fixed::types::I40F24;

use crate::device::{Duration, Instant};

/// A motor that gains no speed at the limit for so long is held back; ours, as the manual names no time. A motor that
/// starts or brakes at the limit gains.
const MIN_TIME: Duration = Duration::millis(100);

/// Since when a motor has gained no speed at the limit of its current.
#[derive(Clone, Copy, Debug)]
pub(super) struct HeldBack {
    /// Direction in which the current pushes: 1, −1, or 0 below the limit.
    direction: i32,
    since: Instant,
    /// The speed in that direction at that instant.
    best: I40F24,
}

impl HeldBack {
    /// Below the limit.
    pub(super) const NONE: Self = Self { direction: 0, since: Instant::ZERO, best: I40F24::ZERO };

    /// Returns whether the motor is held back at `at`: its current is at the limit and pushes that `direction`, or is below
    /// it (0), and its shaft turns at so many rpm, if anybody knows.
    pub(super) fn update(&mut self, at: Instant, direction: i32, rpm: Option<I40F24>) -> bool {
        let gained = rpm.unwrap_or(I40F24::ZERO) * i64::from(direction);
        if direction == 0 || direction != self.direction || gained > self.best {
            *self = Self { direction, since: at, best: gained };
        }
        direction != 0 && at.since(self.since) >= MIN_TIME
    }
}
