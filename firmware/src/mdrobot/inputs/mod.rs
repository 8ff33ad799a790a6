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
use super::drive::{Drive, State};
use super::registers::Pid;
use super::servo::Sensor;
use super::{ALARM_RESET, ENC_A, ENC_B, HU, HV, HW, PULSE_IN, SPEED_IN};
use crate::device::{Context, Instant, Pin};

/// Codes of INPUT_TYPE (p. 10).
mod input_type {
    pub(super) const JOYSTICK: u16 = 1;
    pub(super) const PULSES: u16 = 2;
    pub(super) const RC: u16 = 3;
    pub(super) const STEPS: u16 = 5;
}

/// The greatest step number, which selects full scale.
const STEPS: u16 = 7;

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

    /// Time at which the present measurement times out.
    pub(super) fn due(&self) -> Instant {
        self.speed_in.due.min(self.pulse_in.due)
    }

    /// Returns true if a measurement has timed out.
    pub(super) fn timeout(&mut self, at: Instant) -> bool {
        let speed_in = self.speed_in.timeout(at);
        self.pulse_in.timeout(at) || speed_in
    }
}

impl Drive {
    /// Handles a new level of a contact, a sensor or a pulse input.
    pub(super) fn edge(&mut self, at: Instant, pin: Pin, high: bool, out: &mut dyn Context) {
        let sensor = match pin {
            SPEED_IN => {
                if self.inputs.speed_in.edge(at, high) {
                    self.update_order(at, out);
                }
                return;
            }
            PULSE_IN => {
                // The rate of pulses is measured at rising edges, the width of RC pulses at falling edges.
                let of_interest = high != (self.bank.word(Pid::INPUT_TYPE) == input_type::RC);
                if self.inputs.pulse_in.edge(at, high) && of_interest {
                    self.update_order(at, out);
                }
                return;
            }
            HU => Sensor::Hall(0),
            HV => Sensor::Hall(1),
            HW => Sensor::Hall(2),
            ENC_A => Sensor::EncoderA,
            ENC_B => Sensor::EncoderB,
            _ => return self.contact(at, pin, if high { Contact::Open } else { Contact::Closed }, out),
        };
        self.servo.edge(at, sensor, high);
    }

    /// Handles a contact that is no longer wired.
    pub(super) fn opened(&mut self, at: Instant, pin: Pin, out: &mut dyn Context) {
        self.contact(at, pin, Contact::Unwired, out);
    }

    /// Handles a new voltage at `SPEED_IN`.
    pub(super) fn voltage(&mut self, at: Instant, mv: i32, out: &mut dyn Context) {
        self.inputs.speed_in.voltage(mv);
        self.update_order(at, out);
    }

    fn contact(&mut self, at: Instant, pin: Pin, contact: Contact, out: &mut dyn Context) {
        let Some(known) = self.inputs.contacts.at(pin) else { return };
        let was = core::mem::replace(known, contact);
        if was == contact || self.state != State::Ready {
            return;
        }
        if pin == ALARM_RESET && contact == Contact::Closed {
            self.reset_alarms(at, out);
        }
        self.signals_changed(at, out);
        self.update_order(at, out);
    }

    /// The value of DI.
    pub(super) fn digital_inputs(&self) -> u8 {
        let [enc_a, enc_b] = self.servo.encoder_levels();
        self.inputs.contacts.bits(enc_a, enc_b)
    }

    /// Returns true if START/STOP is ON, with the polarity of `START_INV_SIGN`.
    pub(super) fn start_contact(&self) -> bool {
        self.inputs.contacts.start_stop.is_on(self.flag(Pid::START_INV_SIGN))
    }

    /// Returns true if RUN/BRAKE is ON, with the polarity of `RUN_INV_SIGN`. A contact that is not wired
    /// counts as open (MDROBOT-21).
    fn run_contact(&self) -> bool {
        (self.inputs.contacts.run_brake == Contact::Closed) != self.flag(Pid::RUN_INV_SIGN)
    }

    /// Returns true if DIR is ON, which means CW.
    fn is_clockwise(&self) -> bool {
        self.inputs.contacts.dir.is_on(false)
    }

    /// The step number, 0 to 7; `None` unless contacts select the speed (p. 10).
    pub(super) fn step(&self) -> Option<u16> {
        let step = || {
            let bit = |on: bool, n: u16| u16::from(on) << n;
            bit(self.inputs.contacts.int_speed.is_on(false), 0)
                | bit(self.run_contact(), 1)
                | bit(self.start_contact(), 2)
        };
        (self.bank.word(Pid::INPUT_TYPE) == input_type::STEPS).then(step)
    }

    /// Returns true if RUN/BRAKE requests the electric brake. With steps, RUN/BRAKE is a bit of the step
    /// number instead.
    pub(super) fn is_braked(&self) -> bool {
        self.step().is_none() && !self.run_contact()
    }

    /// Returns true if a limit switch forbids motion in the direction `way`, positive CCW (p. 7; DIR permits
    /// CW, START/STOP CCW).
    pub(super) fn limit_forbids(&self, way: i32) -> bool {
        let Contacts { start_stop, dir, .. } = self.inputs.contacts;
        let switch = if way > 0 { start_stop } else { dir };
        way != 0 && self.flag(Pid::USE_LIMIT_SW) && switch == Contact::Open
    }

    /// Speed that the connectors request, positive CCW (MDROBOT-24).
    pub(super) fn speed_input(&self) -> Ratio {
        // Inputs with two directions of their own do not use DIR.
        let one_way = |share: Ratio| if self.is_clockwise() { -share } else { share };
        let Inputs { speed_in, pulse_in, .. } = self.inputs;
        if let Some(step) = self.step() {
            return one_way(Ratio::new(step.into(), STEPS.into()));
        }
        let tar_vel = self.bank.word(Pid::TAR_VEL);
        if tar_vel != 0 {
            return one_way(Ratio::new(tar_vel.into(), self.full_speed().into()));
        }
        if self.inputs.contacts.int_speed.is_on(false) {
            return one_way(self.analogue(self.bank.word(Pid::INT_VOLUME)));
        }
        match self.bank.word(Pid::INPUT_TYPE) {
            input_type::JOYSTICK => speed_in::joystick(speed_in.digit),
            input_type::PULSES => one_way(pulse_in.rate()),
            input_type::RC => pulse_in.rc(),
            _ => one_way(self.analogue(speed_in.digit)),
        }
    }

    /// Speed that a voltage requests, between `LOW_SPEED_LIMIT` and `HIGH_SPEED_LIMIT` (p. 14; MDROBOT-9).
    fn analogue(&self, digit: u16) -> Ratio {
        let high = match self.bank.word(Pid::HIGH_SPEED_LIMIT) {
            0 => FULL_SCALE,
            limit => limit,
        };
        speed_in::analogue(digit, self.bank.word(Pid::LOW_SPEED_LIMIT), high)
    }

    /// Returns true if a register of one bit is 1.
    pub(super) fn flag(&self, pid: Pid) -> bool {
        self.bank.word(pid) == 1
    }
}
