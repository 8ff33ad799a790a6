//! The connectors: contacts of CTRL, `SPEED_IN`, `PULSE_IN`, and the speed that they request (p. 8 to 11, 13,
//! 14).

mod contacts;
mod pulse_in;
mod share;
mod speed_in;

use self::contacts::{Contact, Contacts};
use self::pulse_in::PulseIn;
pub(super) use self::share::Ratio;
use self::speed_in::{FULL_SCALE, SpeedIn};
use super::registers::{Pid, Words, flag, max_rpm};
use super::{ALARM_RESET, PULSE_IN, SPEED_IN};
use crate::device::{Instant, Pin};

/// Codes of INPUT_TYPE (p. 10).
mod input_type {
    pub(super) const JOYSTICK: u16 = 1;
    pub(super) const PULSES: u16 = 2;
    pub(super) const RC: u16 = 3;
    pub(super) const STEPS: u16 = 5;
}

/// The greatest step number, which selects full scale.
const STEPS: u16 = 7;

/// Consequence of an input.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Change {
    Nothing,
    /// A new measurement of the speed input.
    Speed,
    /// A contact has changed. `resets` is true for ALARM_RESET if it closes.
    Contact {
        resets: bool,
    },
}

/// State of the connectors.
#[derive(Clone, Copy, Debug)]
pub(super) struct Inputs {
    contacts: Contacts,
    speed_in: SpeedIn,
    pulse_in: PulseIn,
}

impl Inputs {
    /// State without any wire.
    pub(super) const REST: Self =
        Self { contacts: Contacts::UNWIRED, speed_in: SpeedIn::GROUND, pulse_in: PulseIn::SILENT };

    /// Handles a new level of a contact or of a speed input.
    pub(super) fn edge(&mut self, at: Instant, pin: Pin, high: bool, bank: &Words) -> Change {
        let measured = match pin {
            SPEED_IN => self.speed_in.edge(at, high),
            PULSE_IN => {
                // The rate of pulses is measured at rising edges, the width of RC pulses at falling edges.
                let of_interest = high != (bank.word(Pid::INPUT_TYPE) == input_type::RC);
                self.pulse_in.edge(at, high) && of_interest
            }
            _ => return self.contact(pin, if high { Contact::Open } else { Contact::Closed }),
        };
        if measured { Change::Speed } else { Change::Nothing }
    }

    /// Handles a contact that is no longer wired.
    pub(super) fn opened(&mut self, pin: Pin) -> Change {
        self.contact(pin, Contact::Unwired)
    }

    fn contact(&mut self, pin: Pin, contact: Contact) -> Change {
        let Some(known) = self.contacts.at(pin) else { return Change::Nothing };
        if core::mem::replace(known, contact) == contact {
            return Change::Nothing;
        }
        Change::Contact { resets: pin == ALARM_RESET && contact == Contact::Closed }
    }

    /// Handles a new voltage at `SPEED_IN`.
    pub(super) fn voltage(&mut self, mv: i32) {
        self.speed_in.voltage(mv);
    }

    /// Time at which the present measurement times out.
    pub(super) fn deadline(&self) -> Instant {
        self.speed_in.deadline().min(self.pulse_in.deadline())
    }

    /// Returns true if a measurement has timed out.
    pub(super) fn timeout(&mut self, at: Instant) -> bool {
        let speed_in = self.speed_in.timeout(at);
        self.pulse_in.timeout(at) || speed_in
    }

    /// The value of DI, with the channels of the encoder.
    pub(super) fn bits(&self, [enc_a, enc_b]: [bool; 2]) -> u8 {
        self.contacts.bits(enc_a, enc_b)
    }

    /// Returns true if START/STOP is ON, with the polarity of `START_INV_SIGN`.
    pub(super) fn start_contact(&self, bank: &Words) -> bool {
        self.contacts.start_stop.is_on(flag(bank, Pid::START_INV_SIGN))
    }

    /// Returns true if RUN/BRAKE is ON, with the polarity of `RUN_INV_SIGN`. A contact that is not wired
    /// counts as open (MDROBOT-21).
    fn run_contact(&self, bank: &Words) -> bool {
        (self.contacts.run_brake == Contact::Closed) != flag(bank, Pid::RUN_INV_SIGN)
    }

    /// Returns true if DIR is ON, which means CW.
    fn is_clockwise(&self) -> bool {
        self.contacts.dir.is_on(false)
    }

    /// The step number, 0 to 7; `None` unless contacts select the speed (p. 10).
    pub(super) fn step(&self, bank: &Words) -> Option<u16> {
        let step = || {
            let bit = |on: bool, n: u16| u16::from(on) << n;
            bit(self.contacts.int_speed.is_on(false), 0)
                | bit(self.run_contact(bank), 1)
                | bit(self.start_contact(bank), 2)
        };
        (bank.word(Pid::INPUT_TYPE) == input_type::STEPS).then(step)
    }

    /// Returns true if RUN/BRAKE requests the electric brake. With steps, RUN/BRAKE is a bit of the step
    /// number instead.
    pub(super) fn is_braked(&self, bank: &Words) -> bool {
        self.step(bank).is_none() && !self.run_contact(bank)
    }

    /// Returns true if a limit switch forbids motion in the direction `way`, positive CCW (p. 7; DIR permits
    /// CW, START/STOP CCW).
    pub(super) fn limit_forbids(&self, bank: &Words, way: i32) -> bool {
        let Contacts { start_stop, dir, .. } = self.contacts;
        let switch = if way > 0 { start_stop } else { dir };
        way != 0 && flag(bank, Pid::USE_LIMIT_SW) && switch == Contact::Open
    }

    /// Speed that the connectors request, positive CCW (MDROBOT-24).
    pub(super) fn speed_input(&self, bank: &Words) -> Ratio {
        // Inputs with two directions of their own do not use DIR.
        let one_way = |share: Ratio| if self.is_clockwise() { -share } else { share };
        let Inputs { speed_in, pulse_in, .. } = *self;
        if let Some(step) = self.step(bank) {
            return one_way(Ratio::new(step.into(), STEPS.into()));
        }
        let tar_vel = bank.word(Pid::TAR_VEL);
        if tar_vel != 0 {
            return one_way(Ratio::new(tar_vel.into(), max_rpm(bank).into()));
        }
        if self.contacts.int_speed.is_on(false) {
            return one_way(analogue(bank, bank.word(Pid::INT_VOLUME)));
        }
        match bank.word(Pid::INPUT_TYPE) {
            input_type::JOYSTICK => speed_in::joystick(speed_in.digit()),
            input_type::PULSES => one_way(pulse_in.rate()),
            input_type::RC => pulse_in.rc(),
            _ => one_way(analogue(bank, speed_in.digit())),
        }
    }
}

/// Speed that a voltage requests, between `LOW_SPEED_LIMIT` and `HIGH_SPEED_LIMIT` (p. 14; MDROBOT-9).
fn analogue(bank: &Words, digit: u16) -> Ratio {
    let high = match bank.word(Pid::HIGH_SPEED_LIMIT) {
        0 => FULL_SCALE,
        limit => limit,
    };
    speed_in::analogue(digit, bank.word(Pid::LOW_SPEED_LIMIT), high)
}
