//! The contacts IN1, IN2 and HARD_STOP, and what they ask for in the five ways of MODE_EXT_IN (6.1, 6.5).

use super::drive::{Drive, State};
use super::errors::error;
use super::motion::Heading;
use super::registers::Reg;
use super::{CLR_FLASH, HA, HARD_STOP, HB, IN1, IN2};
use crate::device::{Context, Duration, Instant, Pin};

/// A contact that bounces (6.1, Fig. 5).
#[derive(Clone, Copy, Debug)]
pub(super) struct Contact {
    /// True while it is closed.
    pub(super) closed: bool,
    /// Debounced state: closed for long enough, and not open for long enough since.
    on: bool,
    /// Time at which the present state has lasted long enough.
    pub(super) due: Instant,
}

impl Contact {
    const OPEN: Self = Self { closed: false, on: false, due: Instant::NEVER };

    /// Accepts the present state.
    fn accept(&mut self) {
        *self = Self { on: self.closed, due: Instant::NEVER, ..*self };
    }

    /// Handles a change, which must last for `pressed` if it is closed now, for `waited` if open.
    fn change(&mut self, at: Instant, closed: bool, pressed: Duration, waited: Duration) {
        if closed == self.closed {
            return;
        }
        self.closed = closed;
        let lasts = if closed { pressed } else { waited };
        self.due = if closed == self.on { Instant::NEVER } else { at + lasts };
    }

    /// Returns whether the debounced state changes now.
    fn timeout(&mut self, at: Instant) -> bool {
        let changes = self.due <= at;
        if changes {
            self.accept();
        }
        changes
    }
}

/// The contacts of the drive, as they are.
#[derive(Clone, Copy, Debug)]
pub(super) struct Inputs {
    pub(super) in1: Contact,
    pub(super) in2: Contact,
    /// The emergency stop is closed: the motor may move.
    pub(super) hard_stop: bool,
    /// CLR_FLASH is closed.
    pub(super) clr_flash: bool,
    /// The Hall sensors A and B are high; `None` before their first event.
    halls: [Option<bool>; 2],
}

impl Inputs {
    /// Without any wire.
    pub(super) const OPEN: Self =
        Self { in1: Contact::OPEN, in2: Contact::OPEN, hard_stop: true, clr_flash: false, halls: [None; 2] };

    /// The drive starts: nothing is waited for.
    pub(super) fn cancel_debounce(&mut self) {
        (self.in1.due, self.in2.due) = (Instant::NEVER, Instant::NEVER);
    }

    pub(super) fn due(&self) -> Instant {
        self.in1.due.min(self.in2.due)
    }
}

impl Drive {
    /// A contact or a Hall sensor has changed.
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

    /// Passes the present levels of the Hall sensors to the servo: after a restart no event brings them again.
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
            // When the drive is ready it takes them for what they are.
            contact.due = Instant::NEVER;
        }
    }

    /// The drive is ready: contacts are taken for what they are, and levels act.
    pub(super) fn apply_inputs(&mut self, at: Instant, out: &mut dyn Context) {
        self.inputs.in1.accept();
        self.inputs.in2.accept();
        self.levels_act(at, out);
    }

    /// A contact has lasted long enough.
    pub(super) fn inputs_timeout(&mut self, at: Instant, out: &mut dyn Context) {
        let (first, second) = (self.inputs.in1.timeout(at), self.inputs.in2.timeout(at));
        if (!first && !second) || !self.is_by_inputs() {
            return;
        }
        // A pulse is over when its contact has opened (RS434-21).
        let pulse_1 = first && !self.inputs.in1.on;
        let pulse_2 = second && !self.inputs.in2.on;
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
                    self.start(at, Heading::Registers, out);
                } else {
                    self.stop();
                }
            }
            3 | 4 if first => self.run_by_level(at, out),
            5 => self.run_by_both(at, out),
            _ => {}
        }
    }

    /// Does what levels ask for: when the drive is ready, and when MODE_DEVICE or MODE_EXT_IN is written (RS434-22).
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

    /// Returns whether the inputs control the motor, and not the bus.
    pub(super) fn is_by_inputs(&self) -> bool {
        self.bank.word(Reg::MODE_DEVICE) == 2
    }

    /// Returns whether each input has its own direction: way 5.
    pub(super) fn is_by_both(&self) -> bool {
        self.is_by_inputs() && self.bank.word(Reg::MODE_EXT_IN) == 5
    }

    /// IN2 is the direction: closed is backward.
    fn direction_by_level(&mut self, at: Instant, out: &mut dyn Context) {
        self.set_direction(at, if self.inputs.in2.on { 2 } else { 1 }, out);
    }

    /// IN1 lets the motor run while it is closed.
    fn run_by_level(&mut self, at: Instant, out: &mut dyn Context) {
        self.run(at, self.inputs.in1.on.then_some(Heading::Registers), out);
    }

    /// IN1 lets it run forward, IN2 backward, both together not at all; to a position either of them.
    fn run_by_both(&mut self, at: Instant, out: &mut dyn Context) {
        let heading = match (self.inputs.in1.on, self.inputs.in2.on) {
            (true, false) => Some(Heading::Forward),
            (false, true) => Some(Heading::Backward),
            _ => None,
        };
        self.run(at, heading, out);
    }
}
