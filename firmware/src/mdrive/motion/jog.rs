//! Jog: an active contact turns the motor (MC 5-39, 5-63).

use fixed::types::I24F8;

use super::orders::{Activity, Task};
use super::{Contact, Motion};
use crate::device::{Context, Instant};
use crate::mdrive::error::Error;

impl Motion {
    /// Direction of the jog that the contacts request, true for backward; `None` if neither or both are
    /// active (MC 5-39).
    fn jog_wanted(&self) -> Option<bool> {
        let is_active = |contact| self.is_active(contact);
        match (is_active(Contact::JogPlus), is_active(Contact::JogMinus)) {
            (true, false) => Some(false),
            (false, true) => Some(true),
            _ => None,
        }
    }

    /// Handles a change of a jog contact. At standstill an activation begins a jog. A jog ends when its own
    /// contact becomes inactive. If a contact is active when the motor has stopped, another jog begins.
    pub(super) fn jog(&mut self, at: Instant, active: bool, out: &mut dyn Context) {
        match self.activity {
            Activity::Jogs { back } if self.jog_ends(back) => {
                self.waiting = Some(Task::Jog);
                self.ramp_down(at, false, out);
            }
            Activity::Rest if active => self.begin_jog(at, out),
            _ => {}
        }
    }

    fn jog_ends(&self, back: bool) -> bool {
        !self.is_active(if back { Contact::JogMinus } else { Contact::JogPlus })
    }

    pub(super) fn begin_jog(&mut self, at: Instant, out: &mut dyn Context) {
        let Some(back) = self.jog_wanted().filter(|_| self.settings.jogs) else { return };
        if self.settings.follows_clock {
            self.fail(Error::JogInClockMode);
        } else if self.is_barred(back) {
            self.fail_at_limit(back);
        } else {
            let rates = self.settings.rates();
            let speed = I24F8::saturating_from_num(rates.max_speed);
            self.run_at_speed(at, Activity::Jogs { back }, if back { -speed } else { speed }, rates, out);
        }
    }

    /// Handles a write to JE. `before` is the value of JE before the write. JE = 0 ends a jog and allows
    /// none. JE = 1 begins a jog if a contact is active already.
    pub(super) fn permit_jog(&mut self, at: Instant, before: bool, out: &mut dyn Context) {
        match self.activity {
            Activity::Jogs { .. } if !self.settings.jogs => self.ramp_down(at, false, out),
            Activity::Rest if self.settings.jogs && !before => self.begin_jog(at, out),
            _ => {}
        }
    }
}
