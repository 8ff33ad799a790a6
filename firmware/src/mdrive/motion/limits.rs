//! The contacts of the I/O, and what limits stop (MC 5-43).

use super::home::Stage;
use super::orders::Activity;
use super::{Contact, Event, Motion};
use crate::device::{Instant, Sink};
use crate::mdrive::error::Error;

impl Motion {
    pub(super) fn is_active(&self, contact: Contact) -> bool {
        self.contacts & bit(contact) != 0
    }

    /// A contact becomes active, or not.
    pub(in crate::mdrive) fn contact(
        &mut self,
        at: Instant,
        contact: Contact,
        active: bool,
        out: &mut dyn Sink,
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

    /// Whether a held limit forbids that direction. In clock mode limits do nothing (MC 5-13).
    pub(super) fn is_barred(&self, back: bool) -> bool {
        let limit = if back { Contact::MinusLimit } else { Contact::PlusLimit };
        self.is_active(limit) && !self.settings.follows_clock
    }

    pub(super) fn fail_at_limit(&mut self, back: bool) {
        self.fail(if back { Error::MinusLimit } else { Error::PlusLimit });
    }

    /// A limit becomes active: it stops what goes or will go in its direction.
    fn limit(&mut self, at: Instant, back: bool, out: &mut dyn Sink) {
        if !self.is_barred(back) || !self.motor.heads(at, back) {
            return;
        }
        match self.activity {
            // It has turned it round already.
            Activity::Homes(home) if home.stage == Stage::Turns => {}
            Activity::Uncounted { .. } => {}
            Activity::Homes(home) => self.limit_home(at, home, out),
            _ => self.stop_at_limit(at, back, out),
        }
    }

    /// A limit stops what moves, with its error, and with LM 3 and 6 the program.
    pub(super) fn stop_at_limit(&mut self, at: Instant, back: bool, out: &mut dyn Sink) {
        // The program first: its error's handler runs all the same.
        if matches!(self.settings.limit_mode, 3 | 6) {
            self.tell(Event::StopsProgram);
        }
        self.fail_at_limit(back);
        self.stop_for_limit(at, out);
    }

    /// With a ramp, or on the spot with LM 4 to 6; nothing goes on.
    pub(super) fn stop_for_limit(&mut self, at: Instant, out: &mut dyn Sink) {
        self.forget_what_waits();
        if self.settings.limit_mode < 4 { self.slow(at, false, out) } else { self.stand(at, out) }
    }
}

fn bit(contact: Contact) -> u8 {
    1 << contact as u8
}
