//! Contacts of the I/O, and stops at limits (MC 5-43).

use super::orders::Activity;
use super::{Contact, Event, Motion};
use crate::device::{Context, Instant};
use crate::mdrive::error::Error;

impl Motion {
    pub(super) fn is_active(&self, contact: Contact) -> bool {
        self.contacts & bit(contact) != 0
    }

    /// Handles a contact that becomes active or inactive.
    pub(in crate::mdrive) fn contact(
        &mut self,
        at: Instant,
        contact: Contact,
        active: bool,
        out: &mut dyn Context,
    ) {
        if self.is_active(contact) == active {
            return;
        }
        self.contacts ^= bit(contact);
        match contact {
            Contact::PlusLimit if active => self.limit(at, false, out),
            Contact::MinusLimit if active => self.limit(at, true, out),
            Contact::PlusLimit | Contact::MinusLimit => {}
            Contact::Home => self.see_home(at, active, out),
            Contact::JogPlus | Contact::JogMinus => self.jog(at, active, out),
        }
        self.refresh(at, out);
    }

    /// Returns true if an active limit forbids a direction. In clock mode limits have no effect (MC 5-13).
    pub(super) fn is_barred(&self, back: bool) -> bool {
        let limit = if back { Contact::MinusLimit } else { Contact::PlusLimit };
        self.is_active(limit) && !self.settings.follows_clock
    }

    pub(super) fn fail_at_limit(&mut self, back: bool) {
        self.fail(if back { Error::MinusLimit } else { Error::PlusLimit });
    }

    /// Handles a limit that becomes active: stops a motion that goes in its direction, now or later.
    fn limit(&mut self, at: Instant, back: bool, out: &mut dyn Context) {
        if !self.is_barred(back) || !self.motor.moves(at, back) {
            return;
        }
        match self.activity {
            Activity::CircuitDriven { .. } => {}
            Activity::Homes(homing) => self.limit_home(at, homing, out),
            _ => self.stop_at_limit(at, back, out),
        }
    }

    /// Stops the motion at a limit and reports the error. With LM 3 and 6 the program ends, too.
    pub(super) fn stop_at_limit(&mut self, at: Instant, back: bool, out: &mut dyn Context) {
        // The program ends before the error is reported, so that the error's handler can still run.
        if matches!(self.settings.limit_mode, 3 | 6) {
            self.push_event(Event::StopsProgram);
        }
        self.fail_at_limit(back);
        self.stop_for_limit(at, out);
    }

    /// Stops with a ramp, or at the next whole step with LM 4 to 6, and drops the waiting task. The stop is
    /// at a whole step because a shaft that fell back by a part of a step could leave the limit again
    /// (MDRIVE-20).
    pub(super) fn stop_for_limit(&mut self, at: Instant, out: &mut dyn Context) {
        self.clear_waiting();
        if self.is_idle() {
            return self.ramp_down(at, false, out);
        }
        let (plan, rates) = (self.motor.plan(), self.settings.rates());
        let is_abrupt = self.settings.limit_mode >= 4;
        let plan = if is_abrupt { plan.finish_step(at) } else { plan.stop_on_step(at, rates) };
        self.run_plan(at, Activity::Stops { at_once: false }, plan, out);
    }
}

fn bit(contact: Contact) -> u8 {
    1 << contact as u8
}
