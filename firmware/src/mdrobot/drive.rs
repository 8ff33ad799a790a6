//! An MD controller without its serial port. It joins its parts, which own their state and do not know the drive.
//!
//! | file | part of the drive |
//! |---|---|
//! | `registers` | the table of PIDs |
//! | `drive/access` | reads and writes of PIDs |
//! | `command` | the codes of COMMAND |
//! | `startup` | the start-up |
//! | `saved` | PIDs in the non-volatile memory |
//! | `inputs` | the connectors: contacts, speed input |
//! | `reference` | the source of commands, and the order to the motor; functions |
//! | `alarm` | alarms, their causes and outputs |
//! | `reasons` | reasons why an accepted request has no effect |
//! | `servo` | control of the motor according to the order |

mod access;
#[cfg(test)]
mod tests;

use drivetwin_protocol::registers::Bank;

pub(super) use self::access::Bus;
use super::alarm::Alarms;
use super::inputs::{Change, Inputs};
use super::reasons::Why;
use super::reference::{Environment, Event, Reference};
use super::registers::{Pid, Words, line, poles};
use super::saved;
use super::servo::{self, Sensor, Servo, Settings};
use super::startup::Startup;
use super::{ENC_A, ENC_B, ENCODER_FAIL, HALL_FAIL, HU, HV, HW, INVERSE_VELOCITY, OVER_VOLTAGE, SPEED_IN};
use crate::device::{Boot, Context, Fault, Input, Instant, Line, Pin};
use crate::motor::Parameters;

/// An MD controller without its serial port.
#[derive(Clone, Debug)]
pub(super) struct Drive {
    startup: Startup,
    bank: Words,
    /// The address on which the drive answers: the one that was saved at power-on (MDROBOT-4).
    unit: u8,
    alarms: Alarms,
    inputs: Inputs,
    reference: Reference,
    servo: Servo,
    /// Poles of the built-in motor, from `HALL_TYPE` at power-on.
    poles: u16,
    /// True if the motor's parameters have changed since the last [`Drive::new_motor`].
    other_motor: bool,
}

impl Drive {
    // Inlined, so that the value is built in place: a copy takes space on a board's stack.
    #[inline(always)]
    pub(super) fn new() -> Self {
        let bank = Bank::factory();
        Self {
            startup: Startup::OFF,
            servo: Servo::new(Settings::of(&bank)),
            poles: poles(&bank),
            bank,
            unit: 1,
            alarms: Alarms::NONE,
            inputs: Inputs::REST,
            reference: Reference::NONE,
            other_motor: false,
        }
    }

    /// Handles power-on. The caller passes the state of all inputs afterwards.
    pub(super) fn power_on(&mut self, at: Instant, boot: Boot, out: &mut dyn Context) {
        saved::load(&mut self.bank, out.memory());
        self.unit = (self.bank.word(Pid::CONTROLLER_ID) & 0xFF) as u8;
        self.alarms = Alarms::NONE;
        self.inputs = Inputs::REST;
        self.reference = Reference::NONE;
        self.startup.power_on(at, boot);
        (self.poles, self.other_motor) = (poles(&self.bank), true);
        self.servo.power_on(at, Settings::of(&self.bank), out);
    }

    /// Switches the power off. Only presets follow until the next power-on.
    pub(super) fn power_off(&mut self) {
        self.startup.power_off();
    }

    pub(super) fn deadline(&self) -> Instant {
        self.startup
            .deadline()
            .min(self.inputs.deadline())
            .min(self.reference.deadline())
            .min(self.servo.deadline())
    }

    /// Handles all deadlines up to `at`. It is also called before a character of this instant.
    pub(super) fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        if self.deadline() > at {
            return;
        }
        if self.startup.timeout(at) {
            self.ready(at, out);
        }
        self.sources_timeout(at, out);
        if self.servo.timeout(at, out) && self.reference.reverses() {
            self.refer(at, Event::Update, out);
        }
        self.settle(at, out);
    }

    /// Ends the start-up: faults raise alarms, and the connectors take effect.
    fn ready(&mut self, at: Instant, out: &mut dyn Context) {
        self.settle(at, out);
        self.update_alarm_pin(at, out);
        self.refer(at, Event::Ready, out);
    }

    fn sources_timeout(&mut self, at: Instant, out: &mut dyn Context) {
        let measured = self.inputs.timeout(at);
        if self.reference.timeout(at) || measured {
            self.refer(at, Event::Update, out);
        }
    }

    /// Handles an input other than characters.
    pub(super) fn input(&mut self, at: Instant, input: &Input<'_>, out: &mut dyn Context) {
        match *input {
            Input::Edge { pin, high } => self.edge(at, pin, high, out),
            Input::Open { pin } => {
                let change = self.inputs.opened(pin);
                self.connectors_changed(at, change, out);
            }
            Input::Millivolts { pin: SPEED_IN, mv } => {
                self.inputs.voltage(mv);
                self.connectors_changed(at, Change::Speed, out);
            }
            Input::Fault { fault, on } => self.set_fault(at, fault, on, out),
            _ => self.servo.report(at, input),
        }
        self.settle(at, out);
    }

    /// Handles a new level of a contact, a sensor or a speed input.
    fn edge(&mut self, at: Instant, pin: Pin, high: bool, out: &mut dyn Context) {
        let sensor = match pin {
            HU => Sensor::Hall(0),
            HV => Sensor::Hall(1),
            HW => Sensor::Hall(2),
            ENC_A => Sensor::EncoderA,
            ENC_B => Sensor::EncoderB,
            _ => {
                let change = self.inputs.edge(at, pin, high, &self.bank);
                return self.connectors_changed(at, change, out);
            }
        };
        self.servo.edge(at, sensor, high);
    }

    fn connectors_changed(&mut self, at: Instant, change: Change, out: &mut dyn Context) {
        match change {
            Change::Speed => {
                self.refer(at, Event::Update, out);
            }
            Change::Contact { resets } if self.startup.is_ready() => {
                if resets {
                    self.reset_alarms(at, out);
                }
                self.refer(at, Event::Contact, out);
            }
            Change::Contact { .. } | Change::Nothing => {}
        }
    }

    /// Injects or removes the cause of a fault.
    fn set_fault(&mut self, at: Instant, fault: Fault, on: bool, out: &mut dyn Context) {
        self.alarms.set_fault(fault, on);
        match fault {
            HALL_FAIL | ENCODER_FAIL => {
                self.servo.cut(at, self.alarms.has(HALL_FAIL), self.alarms.has(ENCODER_FAIL));
            }
            INVERSE_VELOCITY => self.servo.swap(at, on, out),
            OVER_VOLTAGE => self.supply_changed(at, out),
            _ => {}
        }
    }

    /// Raises the present alarms. Called after every event that can cause one. A new alarm switches the output off.
    fn settle(&mut self, at: Instant, out: &mut dyn Context) {
        let found = self.servo.alarms();
        if self.startup.is_ready() && self.alarms.raise(found, self.servo.halls_are_broken()) {
            self.refer(at, Event::Alarm, out);
            self.update_alarm_pin(at, out);
        }
    }

    /// Clears the alarms that have no cause any more. Returns the reason why an alarm stays.
    fn reset_alarms(&mut self, at: Instant, out: &mut dyn Context) -> Option<Why> {
        let any = self.alarms.any();
        self.alarms.reset(self.servo.halls_are_broken(), self.bank.word(Pid::ENC_PPR) != 0);
        self.update_alarm_pin(at, out);
        if self.alarms.any() {
            return Some(Why::CauseStays);
        }
        if any {
            self.refer(at, Event::NoAlarm, out);
        }
        None
    }

    fn update_alarm_pin(&mut self, at: Instant, out: &mut dyn Context) {
        let inverted = self.bank.word(Pid::INV_ALARM) != 0;
        self.alarms.update_pin(at, self.startup.is_ready(), inverted, out);
    }

    /// Passes an event to the reference. Returns the reason why a command of the bus does not do what it says.
    fn refer(&mut self, at: Instant, event: Event, out: &mut dyn Context) -> Option<Why> {
        let mut env = Environment {
            at,
            bank: &self.bank,
            inputs: &self.inputs,
            servo: &mut self.servo,
            is_ready: self.startup.is_ready(),
            has_alarm: self.alarms.any(),
            out,
        };
        self.reference.handle(event, &mut env)
    }

    /// End of the start-up, asked at power-on.
    pub(super) fn ready_at(&self) -> Instant {
        self.startup.deadline()
    }

    /// Settings of the serial line after the next power-on.
    pub(super) fn line(&self) -> Line {
        line(self.bank.word(Pid::CONTROLLER_BAUD))
    }

    /// The address on which the drive answers.
    pub(super) fn unit(&self) -> u8 {
        self.unit
    }

    /// Parameters of the built-in motor at the present supply.
    pub(super) fn motor(&self) -> Parameters {
        servo::motor(self.poles, self.alarms.supply())
    }

    /// Handles a change of the supply.
    fn supply_changed(&mut self, at: Instant, out: &mut dyn Context) {
        self.other_motor = true;
        self.set_servo(at, out);
    }

    /// Parameters as from [`Drive::motor`], if they may have changed since the last call.
    pub(super) fn new_motor(&mut self) -> Option<Parameters> {
        core::mem::take(&mut self.other_motor).then(|| self.motor())
    }

    /// Passes the settings from the registers to the servo.
    fn set_servo(&mut self, at: Instant, out: &mut dyn Context) {
        self.servo.set(at, Settings::of(&self.bank), out);
    }
}
