//! Alarms: their causes, their effects, and how they are cleared (p. 9).

use super::drive::{Drive, State};
use super::reasons::Why;
use super::registers::{Pid, SUPPLY};
use super::{
    ALARM, CTRL_FAIL, ENCODER_FAIL, HALL_FAIL, INVERSE_VELOCITY, OVER_TEMPERATURE, OVER_VOLTAGE, OVERLOAD,
    REGEN_OVER_TEMPERATURE,
};
use crate::device::{Context, Fault, Instant, Level, Output};

/// Bits of the last word of `MONITOR`: `CTRL_STATUS` (p. 9) in the low byte, status2 in the high byte.
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

/// Greatest supply without `OVER_VOLT`, in 0.1 V.
const MAX_SUPPLY: u16 = 600;
/// Supply while the fault `over_voltage` is injected, in 0.1 V.
const TOO_MUCH_SUPPLY: u16 = 610;

/// Latched alarms, and injected faults.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Alarms {
    /// Bits as in `MONITOR`, without bit 0.
    latched: u16,
    /// A bit for each fault that is injected now.
    faults: u16,
    /// The supply that `VOLT_IN` shows, in 0.1 V, as a preset or the bench has set it.
    supply: u16,
    /// True while the ALARM pin is low.
    low: bool,
}

impl Alarms {
    pub(super) const NONE: Self = Self { latched: 0, faults: 0, supply: SUPPLY, low: false };

    /// Returns true if an alarm is latched, so that the output is off.
    pub(super) fn any(self) -> bool {
        self.latched != 0
    }

    /// `CTRL_STATUS` in the low byte, status2 in the high byte.
    pub(super) fn status(self) -> u16 {
        if self.any() { self.latched | status::ALARM } else { 0 }
    }

    /// The value of `VOLT_IN`, in 0.1 V.
    pub(super) fn supply(self) -> u16 {
        if self.has(OVER_VOLTAGE) { TOO_MUCH_SUPPLY } else { self.supply }
    }

    /// Returns true if a fault is injected.
    fn has(self, fault: Fault) -> bool {
        self.faults & mask(fault) != 0
    }

    /// The alarm bits `bits` if a fault is injected, else none.
    fn of(self, fault: Fault, bits: u16) -> u16 {
        if self.has(fault) { bits } else { 0 }
    }

    /// Alarms of the injected faults that are active independently of the motor (MDROBOT-32).
    fn immediate(self) -> u16 {
        let supply = if self.supply() > MAX_SUPPLY { status::OVER_VOLT } else { 0 };
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
    /// Injects or removes the cause of a fault.
    pub(super) fn set_fault(&mut self, at: Instant, fault: Fault, on: bool, out: &mut dyn Context) {
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
        self.check_alarms(at, out);
    }

    /// Sets the supply, in 0.1 V.
    pub(super) fn set_supply(&mut self, at: Instant, supply: u16, out: &mut dyn Context) {
        self.alarms.supply = supply;
        self.supply_changed(at, out);
        self.check_alarms(at, out);
    }

    /// Alarms that are active independently of the motor.
    fn immediate(&self) -> u16 {
        let halls = if self.servo.halls_are_broken() { status::HALL_FAIL } else { 0 };
        self.alarms.immediate() | halls
    }

    /// Alarms that cannot be cleared now, including those that the servo only finds while the motor turns.
    fn causes(&self) -> u16 {
        let alarms = self.alarms;
        // A broken encoder causes an alarm only if the encoder is the speed sensor.
        let encoder = match self.bank.word(Pid::ENC_PPR) {
            0 => 0,
            _ => alarms.of(ENCODER_FAIL, status::HALL_FAIL | status::ENCODER_FAIL),
        };
        self.immediate()
            | encoder
            | alarms.of(HALL_FAIL, status::HALL_FAIL)
            | alarms.of(INVERSE_VELOCITY, status::INV_VEL)
    }

    /// Raises the present alarms. It is called at the end of the start-up, and after any change of their
    /// causes.
    pub(super) fn check_alarms(&mut self, at: Instant, out: &mut dyn Context) {
        let found = self.servo.alarms();
        if self.state == State::Ready {
            self.raise(at, found | self.immediate(), out);
        }
    }

    /// Latches alarms. A new alarm switches the output off.
    fn raise(&mut self, at: Instant, alarms: u16, out: &mut dyn Context) {
        if alarms & !self.alarms.latched == 0 {
            return;
        }
        self.alarms.latched |= alarms;
        self.drop_reference(at, out);
        self.update_alarm_pin(at, out);
    }

    /// Clears the alarms that have no cause any more. Returns the reason why an alarm stays.
    pub(super) fn reset_alarms(&mut self, at: Instant, out: &mut dyn Context) -> Option<Why> {
        let any = self.alarms.any();
        self.alarms.latched &= self.causes();
        self.update_alarm_pin(at, out);
        if self.alarms.any() {
            return Some(Why::CauseStays);
        }
        if any {
            self.alarms_cleared(at, out);
        }
        None
    }

    /// Sets the ALARM pin: low during an alarm, or with `INV_ALARM` low while there is no alarm (MDROBOT-26).
    pub(super) fn update_alarm_pin(&mut self, at: Instant, out: &mut dyn Context) {
        let low = self.state == State::Ready && self.alarms.any() != (self.bank.word(Pid::INV_ALARM) != 0);
        if low != self.alarms.low {
            self.alarms.low = low;
            let level = if low { Level::Low } else { Level::High };
            out.put(at, Output::Level { pin: ALARM, level });
        }
    }
}
