//! Alarms: their causes, their effects, and how they are cleared (p. 9).

use super::registers::SUPPLY;
use super::{
    ALARM, CTRL_FAIL, ENCODER_FAIL, HALL_FAIL, INVERSE_VELOCITY, OVER_TEMPERATURE, OVER_VOLTAGE, OVERLOAD,
    REGEN_OVER_TEMPERATURE,
};
use crate::device::{Context, Fault, Instant, Level, Output};

/// Alarms, with their bits in the last word of `MONITOR`: `CTRL_STATUS` (p. 9) in the low byte, status2 in the high byte.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[repr(u16)]
pub(super) enum Alarm {
    CtrlFail = 1 << 1,
    OverVolt = 1 << 2,
    OverTemp = 1 << 3,
    OverLoad = 1 << 4,
    HallFail = 1 << 5,
    InvVel = 1 << 6,
    Stall = 1 << 7,
    RegenOverTemp = 1 << 8,
    EncoderFail = 1 << 9,
}

/// Bit 0 of `CTRL_STATUS`: an alarm is active.
const ANY: u16 = 1 << 0;

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
        if self.any() { self.latched | ANY } else { 0 }
    }

    /// The value of `VOLT_IN`, in 0.1 V.
    pub(super) fn supply(self) -> u16 {
        if self.has(OVER_VOLTAGE) { TOO_MUCH_SUPPLY } else { self.supply }
    }

    /// Injects or removes the cause of a fault.
    pub(super) fn set_fault(&mut self, fault: Fault, on: bool) {
        self.faults = if on { self.faults | mask(fault) } else { self.faults & !mask(fault) };
    }

    /// Sets the supply, in 0.1 V.
    pub(super) fn set_supply(&mut self, supply: u16) {
        self.supply = supply;
    }

    /// Returns true if a fault is injected.
    pub(super) fn has(self, fault: Fault) -> bool {
        self.faults & mask(fault) != 0
    }

    /// The alarm bits `bits` if a fault is injected, else none.
    fn of(self, fault: Fault, bits: u16) -> u16 {
        if self.has(fault) { bits } else { 0 }
    }

    /// Alarms that are active independently of the motor (MDROBOT-32). `halls_are_broken` is true if the Hall sensors
    /// have an impossible code.
    fn immediate(self, halls_are_broken: bool) -> u16 {
        let supply = if self.supply() > MAX_SUPPLY { Alarm::OverVolt as u16 } else { 0 };
        let halls = if halls_are_broken { Alarm::HallFail as u16 } else { 0 };
        supply
            | halls
            | self.of(OVER_TEMPERATURE, Alarm::OverTemp as u16)
            | self.of(OVERLOAD, Alarm::OverLoad as u16)
            | self.of(CTRL_FAIL, Alarm::CtrlFail as u16)
            | self.of(REGEN_OVER_TEMPERATURE, Alarm::RegenOverTemp as u16)
    }

    /// Latches the alarms `found` by the servo and those that are active independently of the motor. Returns true if one
    /// of them is new.
    pub(super) fn raise(&mut self, found: u16, halls_are_broken: bool) -> bool {
        let alarms = found | self.immediate(halls_are_broken);
        let is_new = alarms & !self.latched != 0;
        self.latched |= alarms;
        is_new
    }

    /// Clears the alarms that have no cause any more. The servo only finds some causes while the motor turns. A broken
    /// encoder causes an alarm only if the encoder is the speed sensor.
    pub(super) fn reset(&mut self, halls_are_broken: bool, has_encoder: bool) {
        let encoder = if has_encoder { Alarm::HallFail as u16 | Alarm::EncoderFail as u16 } else { 0 };
        self.latched &= self.immediate(halls_are_broken)
            | self.of(ENCODER_FAIL, encoder)
            | self.of(HALL_FAIL, Alarm::HallFail as u16)
            | self.of(INVERSE_VELOCITY, Alarm::InvVel as u16);
    }

    /// Sets the ALARM pin of a ready drive: low during an alarm, or if `inverted` (`INV_ALARM`) low while there is no
    /// alarm (MDROBOT-26). Before that the pin is high.
    pub(super) fn update_pin(&mut self, at: Instant, is_ready: bool, inverted: bool, out: &mut dyn Context) {
        let low = is_ready && self.any() != inverted;
        if low != self.low {
            self.low = low;
            let level = if low { Level::Low } else { Level::High };
            out.put(at, Output::Level { pin: ALARM, level });
        }
    }
}

/// The bit of a fault.
const fn mask(fault: Fault) -> u16 {
    1_u16.unbounded_shl(fault.0 as u32)
}
