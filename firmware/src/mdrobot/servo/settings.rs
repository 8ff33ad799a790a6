//! Settings of the servo, and the motor that it expects.

use crate::mdrobot::registers::{MA_PER_UNIT, Pid, SUPPLY, Words, max_rpm, poles};
use crate::motor::Parameters;

/// Unit of VOLT_IN, in mV.
const MV_PER_UNIT: u32 = 100;

/// The built-in motor at the nominal supply: 0.06 V·s, which is 0.06 Nm/A. `HALL_TYPE` selects its poles (MDROBOT-27).
pub(super) const MOTOR: Parameters = Parameters {
    supply_mv: SUPPLY as u32 * MV_PER_UNIT,
    no_load_rpm: 3_820,
    resistance_mohm: 300,
    inertia_gcm2: 5_000,
    hall_sensors: 3,
    ..Parameters::NOMINAL
};

/// The built-in motor with this number of poles, at a supply in 0.1 V.
pub(in crate::mdrobot) fn motor(poles: u16, supply: u16) -> Parameters {
    let supply = u32::from(supply).min(Parameters::MOST.supply_mv / MV_PER_UNIT);
    Parameters {
        supply_mv: supply * MV_PER_UNIT,
        no_load_rpm: MOTOR.no_load_rpm * supply / u32::from(SUPPLY),
        hall_pulses: poles / 2,
        ..MOTOR
    }
}

/// Settings from the registers.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrobot) struct Settings {
    /// `MAX_RPM`, limited to its range.
    pub(super) max_rpm: u16,
    /// `MAX_LOAD`, limited to its range, in mA.
    pub(super) limit_ma: u32,
    /// `PV_GAIN`, in rpm for each count.
    pub(super) pv_gain: u16,
    /// P_GAIN.
    pub(super) p_gain: u16,
    /// I_GAIN.
    pub(super) i_gain: u16,
    /// SLOW_START, 0 to 1,023.
    pub(super) slow_start: u16,
    /// SLOW_DOWN, 0 to 1,023.
    pub(super) slow_down: u16,
    /// STOP_STATUS, 0 to 3.
    pub(super) stop_status: u16,
    /// Poles of the motor, from `HALL_TYPE`.
    pub(super) poles: u16,
    /// ENC_PPR; 0 without an encoder.
    pub(super) enc_ppr: u16,
}

impl Settings {
    /// The settings in the registers (MDROBOT-8).
    pub(in crate::mdrobot) fn of(bank: &Words) -> Self {
        let word = |pid| bank.word(pid);
        Self {
            max_rpm: max_rpm(bank),
            limit_ma: bank.clamped_value(Pid::MAX_LOAD) as u32 * MA_PER_UNIT,
            pv_gain: word(Pid::PV_GAIN),
            p_gain: word(Pid::P_GAIN),
            i_gain: word(Pid::I_GAIN),
            slow_start: word(Pid::SLOW_START),
            slow_down: word(Pid::SLOW_DOWN),
            stop_status: word(Pid::STOP_STATUS),
            poles: poles(bank),
            enc_ppr: word(Pid::ENC_PPR),
        }
    }

    /// Settings of a new drive.
    #[cfg(test)]
    pub(super) const FACTORY: Self = Self {
        max_rpm: 3_000,
        limit_ma: 20_000,
        pv_gain: 20,
        p_gain: 6_000,
        i_gain: 6_000,
        slow_start: 0,
        slow_down: 0,
        stop_status: 0,
        poles: 4,
        enc_ppr: 0,
    };

    /// Counts of the Hall sensors in a turn: the edges of three sensors for each pair of poles.
    pub(super) fn counts(&self) -> i32 {
        3 * i32::from(self.poles.max(1))
    }

    /// Counts of the encoder in a turn (MDROBOT-29).
    pub(super) fn encoder_counts(&self) -> i32 {
        4 * i32::from(self.enc_ppr)
    }
}
