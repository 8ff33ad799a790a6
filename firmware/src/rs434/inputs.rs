//! The contacts IN1, IN2 and HARD_STOP, and their functions in the five modes of MODE_EXT_IN (6.1, 6.5).

use super::drive::{Drive, State};
use super::errors::error;
use super::motion::Heading;
use super::registers::Reg;
use super::{CLR_FLASH, HA, HARD_STOP, HB, IN1, IN2};
use crate::debounce::Debounce;
use crate::device::{Context, Duration, Instant, Pin};

/// A contact, which is debounced (6.1, Fig. 5).
#[derive(Clone, Copy, Debug)]
pub(super) struct Contact {
    /// Present state: true while the contact is closed.
    pub(super) closed: bool,
    /// Debounced state. It becomes true after the contact was closed for long enough, and false after it was
    /// open for long enough.
    debounced: Debounce,
}

impl Contact {
    const OPEN: Self = Self { closed: false, debounced: Debounce::new(false) };

    /// Makes the present state the debounced state.
    fn accept(&mut self) {
        self.debounced = Debounce::new(self.closed);
    }

    /// Handles a change. A closed contact must stay closed for `pressed`, an open one open for `waited`.
    fn change(&mut self, at: Instant, closed: bool, pressed: Duration, waited: Duration) {
        if closed != self.closed {
            self.closed = closed;
            self.debounced.note(at, closed, if closed { pressed } else { waited });
        }
    }

    /// Returns true in the debounced state "closed".
    fn is_on(&self) -> bool {
        self.debounced.level()
    }
}

/// Present states of the drive's contacts.
#[derive(Clone, Copy, Debug)]
pub(super) struct Inputs {
    pub(super) in1: Contact,
    pub(super) in2: Contact,
    /// True while the emergency stop is closed: the motor may move.
    pub(super) hard_stop: bool,
    /// True while CLR_FLASH is closed.
    pub(super) clr_flash: bool,
    /// True for each of the Hall sensors A and B that is high; `None` before its first event.
    halls: [Option<bool>; 2],
}

impl Inputs {
    /// States of inputs without any wire.
    pub(super) const OPEN: Self =
        Self { in1: Contact::OPEN, in2: Contact::OPEN, hard_stop: true, clr_flash: false, halls: [None; 2] };

    /// Stops waiting for contacts, because the drive starts.
    pub(super) fn cancel_debounce(&mut self) {
        self.in1.debounced.cancel();
        self.in2.debounced.cancel();
    }

    pub(super) fn due(&self) -> Instant {
        self.in1.debounced.due().min(self.in2.debounced.due())
    }
}

impl Drive {
    /// Handles a change of a contact or a Hall sensor.
    pub(super) fn edge(&mut self, at: Instant, pin: Pin, high: bool, out: &mut dyn Context) {
        let closed = !high;
        match pin {
            IN1 | IN2 => self.contact_changed(at, pin, closed),
            HARD_STOP => {
                self.inputs.hard_stop = closed;
                if !closed && self.state == State::Ready {
                    self.raise(at, error::EMERGENCY_STOP, out);
                }
            }
            CLR_FLASH => {
                self.inputs.clr_flash = closed;
                self.clr_flash_changed(at, out);
            }
            HA | HB => {
                let [a, b] = &mut self.inputs.halls;
                *if pin == HA { a } else { b } = Some(high);
                self.servo.edge(at, pin == HA, high);
            }
            _ => {}
        }
    }

    /// Passes the present levels of the Hall sensors to the servo, because no event reports them after a
    /// restart.
    pub(super) fn update_halls(&mut self, at: Instant) {
        let [a, b] = self.inputs.halls;
        for (is_a, high) in [(true, a), (false, b)] {
            if let Some(high) = high {
                self.servo.edge(at, is_a, high);
            }
        }
    }

    fn contact_changed(&mut self, at: Instant, pin: Pin, closed: bool) {
        let time = |reg| Duration::millis(self.bank.word(reg).into());
        let (pressed, waited) = (time(Reg::PRESSED_INPUTS_EXTERN), time(Reg::WAITED_INPUTS_EXTERN));
        let contact = if pin == IN1 { &mut self.inputs.in1 } else { &mut self.inputs.in2 };
        contact.change(at, closed, pressed, waited);
        if self.state != State::Ready {
            // A drive that becomes ready uses the states at that time.
            contact.debounced.cancel();
        }
    }

    /// Called when the drive is ready. Uses the present states of the contacts, and executes levels.
    pub(super) fn apply_inputs(&mut self, at: Instant, out: &mut dyn Context) {
        self.inputs.in1.accept();
        self.inputs.in2.accept();
        self.levels_act(at, out);
    }

    /// Handles contacts whose state has lasted long enough.
    pub(super) fn inputs_timeout(&mut self, at: Instant, out: &mut dyn Context) {
        let Inputs { in1, in2, .. } = &mut self.inputs;
        let (first, second) = (in1.debounced.timeout(at), in2.debounced.timeout(at));
        if (!first && !second) || !self.is_by_inputs() {
            return;
        }
        // A pulse ends when its contact opens (RS434-21).
        let pulse_1 = first && !self.inputs.in1.is_on();
        let pulse_2 = second && !self.inputs.in2.is_on();
        match self.bank.word(Reg::MODE_EXT_IN) {
            1 | 3 if pulse_2 => {
                let reversed = if self.is_forward() { 2 } else { 1 };
                self.set_direction(at, reversed, out);
            }
            2 | 4 if second => self.direction_by_level(at, out),
            _ => {}
        }
        match self.bank.word(Reg::MODE_EXT_IN) {
            1 | 2 if pulse_1 => {
                if self.servo.direction() == 0 {
                    let _ = self.start(at, Heading::Registers, out);
                } else {
                    self.stop();
                }
            }
            3 | 4 if first => self.run_by_level(at, out),
            5 => self.run_by_both(at, out),
            _ => {}
        }
    }

    /// Executes the present levels. Called when the drive is ready, and when MODE_DEVICE or MODE_EXT_IN is
    /// written (RS434-22).
    pub(super) fn levels_act(&mut self, at: Instant, out: &mut dyn Context) {
        if self.state != State::Ready || !self.is_by_inputs() {
            return;
        }
        match self.bank.word(Reg::MODE_EXT_IN) {
            2 => self.direction_by_level(at, out),
            3 => self.run_by_level(at, out),
            4 => {
                self.direction_by_level(at, out);
                self.run_by_level(at, out);
            }
            5 => self.run_by_both(at, out),
            _ => {}
        }
    }

    /// Returns true if the inputs control the motor, and not the bus.
    pub(super) fn is_by_inputs(&self) -> bool {
        self.bank.word(Reg::MODE_DEVICE) == 2
    }

    /// Returns true if each input has a direction of its own: mode 5.
    pub(super) fn is_by_both(&self) -> bool {
        self.is_by_inputs() && self.bank.word(Reg::MODE_EXT_IN) == 5
    }

    /// IN2 selects the direction: closed means backward.
    fn direction_by_level(&mut self, at: Instant, out: &mut dyn Context) {
        self.set_direction(at, if self.inputs.in2.is_on() { 2 } else { 1 }, out);
    }

    /// The motor runs while IN1 is closed.
    fn run_by_level(&mut self, at: Instant, out: &mut dyn Context) {
        self.run(at, self.inputs.in1.is_on().then_some(Heading::Registers), out);
    }

    /// IN1 makes the motor run forward, IN2 backward. With both closed the motor stops. For a move to a
    /// position either input will do.
    fn run_by_both(&mut self, at: Instant, out: &mut dyn Context) {
        let heading = match (self.inputs.in1.is_on(), self.inputs.in2.is_on()) {
            (true, false) => Some(Heading::Forward),
            (false, true) => Some(Heading::Backward),
            _ => None,
        };
        self.run(at, heading, out);
    }
}
