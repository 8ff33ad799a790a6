//! A motor that the limit of its current holds back.

use fixed::types::I40F24;

use crate::device::{Duration, Instant};

/// A motor that gains no speed at the limit for so long is held back; ours, as the manual names no time. A motor that
/// starts or brakes at the limit gains.
const HELD: Duration = Duration::millis(100);

/// Since when a motor has gained no speed at the limit of its current.
#[derive(Clone, Copy, Debug)]
pub(super) struct HeldBack {
    /// Direction in which the current pushes: 1, −1, or 0 below the limit.
    way: i32,
    since: Instant,
    /// The speed in that direction at that instant.
    best: I40F24,
}

impl HeldBack {
    /// Below the limit.
    pub(super) const NOT: Self = Self { way: 0, since: Instant::ZERO, best: I40F24::ZERO };

    /// Returns whether the motor is held back at `at`: its current is at the limit and pushes that `way`, or is below
    /// it (0), and its shaft turns at so many rpm, if anybody knows.
    pub(super) fn holds(&mut self, at: Instant, way: i32, rpm: Option<I40F24>) -> bool {
        let gained = rpm.unwrap_or(I40F24::ZERO) * i64::from(way);
        if way == 0 || way != self.way || gained > self.best {
            *self = Self { way, since: at, best: gained };
        }
        way != 0 && at.since(self.since) >= HELD
    }
}
