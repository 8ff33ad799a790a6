//! The contacts of CTRL (p. 8, 9, 11).

use crate::device::Pin;
use crate::mdrobot::{ALARM_RESET, DIR, INT_SPEED, RUN_BRAKE, START_STOP};

/// Contact at an input of CTRL.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Contact {
    /// No contact is wired.
    Unwired,
    /// The contact is open, or its level is high.
    Open,
    /// The contact is closed to ground.
    Closed,
}

impl Contact {
    /// Returns true if the contact is ON: closed, or open if it is inverted.
    pub(super) fn is_on(self, inverted: bool) -> bool {
        self == if inverted { Self::Open } else { Self::Closed }
    }
}

/// Present states of the contacts.
#[derive(Clone, Copy, Debug)]
pub(super) struct Contacts {
    pub(super) int_speed: Contact,
    pub(super) alarm_reset: Contact,
    pub(super) dir: Contact,
    pub(super) run_brake: Contact,
    pub(super) start_stop: Contact,
}

impl Contacts {
    pub(super) const UNWIRED: Self = Self {
        int_speed: Contact::Unwired,
        alarm_reset: Contact::Unwired,
        dir: Contact::Unwired,
        run_brake: Contact::Unwired,
        start_stop: Contact::Unwired,
    };

    /// The contact at a pin.
    pub(super) fn at(&mut self, pin: Pin) -> Option<&mut Contact> {
        match pin {
            INT_SPEED => Some(&mut self.int_speed),
            ALARM_RESET => Some(&mut self.alarm_reset),
            DIR => Some(&mut self.dir),
            RUN_BRAKE => Some(&mut self.run_brake),
            START_STOP => Some(&mut self.start_stop),
            _ => None,
        }
    }

    /// The value of DI (p. 11): 1 is a closed contact, or a high encoder channel (MDROBOT-22).
    pub(super) fn bits(self, enc_a: bool, enc_b: bool) -> u8 {
        let contacts = [self.int_speed, self.alarm_reset, self.dir, self.run_brake, self.start_stop];
        let bits = contacts.map(|contact| contact == Contact::Closed).into_iter().chain([enc_b, enc_a]);
        bits.rev().fold(0, |bits, on| bits << 1 | u8::from(on))
    }
}
