//! Alarms: what causes them, what they do, how they are cleared (p. 9).

use super::drive::{Drive, State};
use super::registers::{Pid, SUPPLY};
use super::{
    ALARM, CTRL_FAIL, ENCODER_FAIL, HALL_FAIL, INVERSE_VELOCITY, OVER_TEMPERATURE, OVER_VOLTAGE, OVERLOAD,
    REGEN_OVER_TEMPERATURE,
};
use crate::device::{Context, Fault, Instant, Level, Output};

/// Bits of the last word of MONITOR: CTRL_STATUS (p. 9), and above it status2.
pub(super) mod status {
    pub(in crate::mdrobot) const ALARM: u16 = 1 << 0;
    pub(in crate::mdrobot) const CTRL_FAIL: u16 = 1 << 1;
    pub(in crate::mdrobot) const OVER_VOLT: u16 = 1 << 2;
    pub(in crate::mdrobot) const OVER_TEMP: u16 = 1 << 3;
    pub(in crate::mdrobot) const OVER_LOAD: u16 = 1 << 4;
    pub(in crate::mdrobot) const HALL_FAIL: u16 = 1 << 5;
    pub(in crate::mdrobot) const INV_VEL: u16 = 1 << 6;
    pub(in crate::mdrobot) const STALL: u16 = 1 << 7;
    pub(in crate::mdrobot) const REGEN_OVER_TEMP: u16 = 1 << 8;
    pub(in crate::mdrobot) const ENCODER_FAIL: u16 = 1 << 9;
}

/// A supply above this is OVER_VOLT, in 0.1 V.
const MOST_SUPPLY: u16 = 600;
/// The supply of `over_voltage`.
const TOO_MUCH_SUPPLY: u16 = 610;

/// Alarms that are latched, and causes that somebody injected.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Alarms {
    /// As in MONITOR, without bit 0.
    latched: u16,
    /// A bit for each fault that is there.
    faults: u16,
    /// The supply that VOLT_IN was made to show, in 0.1 V.
    supply: u16,
    /// ALARM was made low.
    low: bool,
}

impl Alarms {
    pub(super) const NONE: Self = Self { latched: 0, faults: 0, supply: SUPPLY, low: false };

    /// Returns whether the output is off because of one.
    pub(super) fn any(self) -> bool {
        self.latched != 0
    }

    /// CTRL_STATUS, and above it status2.
    pub(super) fn status(self) -> u16 {
        if self.any() { self.latched | status::ALARM } else { 0 }
    }

    /// VOLT_IN, in 0.1 V.
    pub(super) fn supply(self) -> u16 {
        if self.has(OVER_VOLTAGE) { TOO_MUCH_SUPPLY } else { self.supply }
    }

    /// Returns whether a fault is injected.
    fn has(self, fault: Fault) -> bool {
        self.faults & mask(fault) != 0
    }

    /// The alarms of a fault that is there, or none.
    fn of(self, fault: Fault, bits: u16) -> u16 {
        if self.has(fault) { bits } else { 0 }
    }

    /// Alarms that somebody injects, and that are true whatever the motor does (MDROBOT-32).
    fn at_once(self) -> u16 {
        let supply = if self.supply() > MOST_SUPPLY { status::OVER_VOLT } else { 0 };
        supply
            | self.of(OVER_TEMPERATURE, status::OVER_TEMP)
            | self.of(OVERLOAD, status::OVER_LOAD)
            | self.of(CTRL_FAIL, status::CTRL_FAIL)
            | self.of(REGEN_OVER_TEMPERATURE, status::REGEN_OVER_TEMP)
    }
}

/// The bit of a fault.
const fn mask(fault: Fault) -> u16 {
    1_u16.unbounded_shl(fault.0 as u32)
}

impl Drive {
    /// The cause of a fault comes or goes.
    pub(super) fn set_cause(&mut self, at: Instant, fault: Fault, on: bool, out: &mut dyn Context) {
        let faults = &mut self.alarms.faults;
        *faults = if on { *faults | mask(fault) } else { *faults & !mask(fault) };
        match fault {
            HALL_FAIL | ENCODER_FAIL => {
                self.servo.cut(at, self.alarms.has(HALL_FAIL), self.alarms.has(ENCODER_FAIL));
            }
            INVERSE_VELOCITY => self.servo.swap(at, on, out),
            OVER_VOLTAGE => self.supply_changed(at, out),
            _ => {}
        }
        self.look_for_alarms(at, out);
    }

    /// The supply becomes another one, in 0.1 V.
    pub(super) fn set_supply(&mut self, at: Instant, supply: u16, out: &mut dyn Context) {
        self.alarms.supply = supply;
        self.supply_changed(at, out);
        self.look_for_alarms(at, out);
    }

    /// Alarms that are true whatever the motor does.
    fn at_once(&self) -> u16 {
        let halls = if self.servo.halls_are_broken() { status::HALL_FAIL } else { 0 };
        self.alarms.at_once() | halls
    }

    /// Alarms that cannot be cleared: also those that the servo finds when the motor turns.
    fn causes(&self) -> u16 {
        let alarms = self.alarms;
        // Nobody misses an encoder that is not the sensor of speed.
        let encoder = match self.bank.word(Pid::ENC_PPR) {
            0 => 0,
            _ => alarms.of(ENCODER_FAIL, status::HALL_FAIL | status::ENCODER_FAIL),
        };
        self.at_once()
            | encoder
            | alarms.of(HALL_FAIL, status::HALL_FAIL)
            | alarms.of(INVERSE_VELOCITY, status::INV_VEL)
    }

    /// Raises what is wrong now: at the end of the start, and after anything that may be.
    pub(super) fn look_for_alarms(&mut self, at: Instant, out: &mut dyn Context) {
        let seen = self.servo.alarms();
        if self.state == State::Ready {
            self.raise(at, seen | self.at_once(), out);
        }
    }

    /// Latches alarms. One that is new switches the output off.
    fn raise(&mut self, at: Instant, alarms: u16, out: &mut dyn Context) {
        if alarms & !self.alarms.latched == 0 {
            return;
        }
        self.alarms.latched |= alarms;
        self.drop_reference(at, out);
        self.show_alarm(at, out);
    }

    /// Clears the alarms whose cause is gone.
    pub(super) fn reset_alarms(&mut self, at: Instant, out: &mut dyn Context) {
        let any = self.alarms.any();
        self.alarms.latched &= self.causes();
        self.show_alarm(at, out);
        if any && !self.alarms.any() {
            self.alarms_cleared(at, out);
        }
    }

    /// ALARM is low while there is one, or while there is none with INV_ALARM (MDROBOT-26).
    pub(super) fn show_alarm(&mut self, at: Instant, out: &mut dyn Context) {
        let low = self.state == State::Ready && self.alarms.any() != (self.bank.word(Pid::INV_ALARM) != 0);
        if low != self.alarms.low {
            self.alarms.low = low;
            let level = if low { Level::Low } else { Level::High };
            out.put(at, Output::Level { pin: ALARM, level });
        }
    }
}
