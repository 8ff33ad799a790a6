//! Settings of a motion: register values (6.5), and the same in the servo's units.

use fixed::types::I40F24;

use super::path::Limits;
use crate::motor::Parameters;
use crate::rs434::registers::{Reg, Words};

/// Ticks of the servo per second.
const TICKS_PER_SECOND: i64 = 1_000;
/// The speed of one turn per tick, in rpm.
pub(super) const RPM: i64 = 60 * TICKS_PER_SECOND;

/// Settings of a motion, from the registers (6.5).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::rs434) struct Settings {
    /// SPEED, in rpm.
    pub(super) speed: u16,
    /// ACC, as the register holds it.
    pub(super) acc: u16,
    /// DEC, as the register holds it.
    pub(super) dec: u16,
    /// RATED_SPEED in rpm: the MAX_SPEED of the manual (RS434-19).
    pub(super) rated: u16,
    /// PULSES_PER_REVOLUTION.
    pub(super) pulses: u16,
    /// USE_HALL.
    pub(super) halls: u16,
    /// REF_CURRENT, in mA.
    pub(super) limit_ma: u32,
    /// MODE_COIL: true if the terminals are closed while the motor stands.
    pub(super) closed: bool,
}

impl Settings {
    /// The settings in the registers. `halves_limit` halves the current limit.
    pub(in crate::rs434) fn of(bank: &Words, halves_limit: bool) -> Self {
        Self {
            speed: bank.word(Reg::SPEED),
            acc: bank.word(Reg::ACC),
            dec: bank.word(Reg::DEC),
            rated: bank.word(Reg::RATED_SPEED),
            pulses: bank.word(Reg::PULSES_PER_REVOLUTION),
            halls: bank.word(Reg::USE_HALL),
            limit_ma: u32::from(bank.word(Reg::REF_CURRENT)) / if halves_limit { 2 } else { 1 },
            closed: bank.word(Reg::MODE_COIL) == 1,
        }
    }

    /// Parameters of the motor, from the registers.
    pub(in crate::rs434) fn motor(&self) -> Parameters {
        Parameters { no_load_rpm: self.rated.into(), hall_pulses: self.pulses, ..Parameters::NOMINAL }
    }

    /// Counts per turn.
    pub(super) fn counts(&self) -> i64 {
        2 * i64::from(self.pulses.max(1)) * i64::from(self.halls.max(1))
    }

    /// Returns true if sensors give the motor's position.
    pub(super) fn has_sensors(&self) -> bool {
        self.halls > 0
    }

    /// A speed in rpm converted to counts per tick.
    pub(super) fn of_rpm(&self, rpm: u16) -> I40F24 {
        I40F24::from_bits(((i64::from(rpm) * self.counts()) << 24) / RPM)
    }

    /// ACC or DEC converted to counts per tick²: 10 is 100 rps², 1,000 is 5,000 rps² (6.5; RS434-14).
    fn of_ramp(&self, ramp: u16) -> I40F24 {
        let over = i64::from(ramp) - 10;
        let rps2_times_990 = 100 * 990 + over * (5_000 - 100);
        let bits = ((rps2_times_990 * self.counts()) << 24) / (990 * TICKS_PER_SECOND * TICKS_PER_SECOND);
        I40F24::from_bits(bits.max(1))
    }

    /// Speed and ramps in counts and ticks.
    pub(super) fn rates(&self) -> Limits {
        Limits { speed: self.of_rpm(self.speed), up: self.of_ramp(self.acc), down: self.of_ramp(self.dec) }
    }
}
