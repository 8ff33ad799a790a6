//! Current of the motor at rest: it falls from RC to HC when HT has passed since the end of all motion (MC
//! 5-32; MDRIVE-19).

use super::Activity;
use super::Settings;
use crate::device::{Duration, Instant};

/// State of the current.
#[derive(Clone, Debug)]
pub(super) struct Current {
    /// True if the current is that of HC.
    holds: bool,
    /// Time since which the motor has been at rest.
    rested: Instant,
}

impl Current {
    /// State at power-on.
    pub(super) fn at_power_on(at: Instant) -> Self {
        Self { holds: true, rested: at }
    }

    /// Begins the current of a motion.
    pub(super) fn run(&mut self) {
        self.holds = false;
    }

    /// Handles the end of all motion.
    pub(super) fn rest(&mut self, at: Instant) {
        self.rested = at;
    }

    /// Returns true if the current does not fall to that of HC, because HT is 0.
    pub(super) fn never_holds(&self, settings: &Settings) -> bool {
        !self.holds && settings.hold_delay_ms == 0
    }

    /// Time at which the current falls to that of HC.
    pub(super) fn deadline(&self, settings: &Settings, activity: &Activity) -> Instant {
        if self.holds || self.never_holds(settings) || !activity.is_rest() {
            return Instant::NEVER;
        }
        self.rested + Duration::millis(settings.hold_delay_ms.into())
    }

    /// Lowers the current if that is due.
    pub(super) fn timeout(&mut self, at: Instant, settings: &Settings, activity: &Activity) {
        self.holds |= self.deadline(settings, activity) <= at;
    }

    /// Current that the motor is to have, in %; `None` if the bridge is off.
    pub(super) fn percent(&self, settings: &Settings, activity: &Activity) -> Option<u8> {
        let percent = match *activity {
            Activity::CircuitDriven { percent, .. } => percent,
            _ if self.holds => settings.hold_percent,
            _ => settings.run_percent,
        };
        settings.enabled.then_some(percent)
    }

    #[cfg(test)]
    pub(super) fn holds(&self) -> bool {
        self.holds
    }
}
