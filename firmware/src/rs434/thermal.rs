//! Temperatures of the drive. They rise with the square of the motor's current. No motor current alone
//! reaches the limits.
//!
//! The manual specifies neither limits nor times. Each part approaches its final temperature with a time
//! constant of about a minute, in steps of a second. The steps are computed when a temperature is needed.

use super::errors::Error;
use crate::device::{Duration, Instant};

const STEP: Duration = Duration::secs(1);
/// Number of steps after which the initial temperature has no more influence.
const MOST_STEPS: u64 = 2_048;
/// In each step the difference to the final temperature decreases by 1/2⁶.
const DIVISOR: u32 = 6;
/// Temperature at rest, in 0.1 °C.
const AMBIENT: u16 = 250;
/// Temperature rise of the power circuit at the rated current, in 0.1 °C. The processor next to it has a
/// quarter of this rise.
const POWER_RISE: u32 = 400;
/// Temperature rise of the brake circuit while a motor feeds back the rated current, in 0.1 °C.
const BRAKE_RISE: u32 = 500;

/// A part of the drive whose temperature is a register (6.3).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Part {
    /// TEMPERATURE_MCU.
    Mcu,
    /// TEMPERATURE_MOSFET.
    Power,
    /// TEMPERATURE_BRAKE.
    Brake,
}

/// A part that gets warm. Temperatures are in 1/65536 of 0.1 °C above [`AMBIENT`].
#[derive(Clone, Copy, Debug)]
struct Body {
    rise: u32,
    end: u32,
}

impl Body {
    const COLD: Self = Self { rise: 0, end: 0 };

    fn step(&mut self) {
        let way = self.end.abs_diff(self.rise) >> DIVISOR;
        self.rise = if self.end > self.rise { self.rise + way } else { self.rise - way };
    }
}

/// The temperatures of the drive.
#[derive(Clone, Copy, Debug)]
pub(super) struct Thermal {
    rated_ma: u32,
    /// Time up to which the temperatures are computed.
    since: Instant,
    power: Body,
    brake: Body,
    /// Injected temperatures of the parts, in 0.1 °C.
    injected: [Option<u16>; 3],
}

impl Thermal {
    /// State with all parts cold.
    pub(super) fn new(at: Instant, rated_ma: u16) -> Self {
        let rated_ma = u32::from(rated_ma);
        Self { rated_ma, since: at, power: Body::COLD, brake: Body::COLD, injected: [None; 3] }
    }

    /// Sets the motor current from `at` on. While the motor `brakes`, it feeds this current back.
    pub(super) fn draws(&mut self, at: Instant, ma: u32, brakes: bool) {
        self.catch_up(at);
        let ma = u64::from(ma.min(self.rated_ma));
        let square = ((ma * ma) << 16).checked_div(u64::from(self.rated_ma).pow(2)).unwrap_or(0) as u32;
        self.power.end = square * POWER_RISE;
        self.brake.end = if brakes { square * BRAKE_RISE } else { 0 };
    }

    /// Temperature of a part, in 0.1 °C.
    pub(super) fn temperature(&self, at: Instant, part: Part) -> u16 {
        let [mcu, power, brake] = self.injected;
        let mut now = *self;
        now.catch_up(at);
        let (injected, rise) = match part {
            Part::Mcu => (mcu, now.power.rise / 4),
            Part::Power => (power, now.power.rise),
            Part::Brake => (brake, now.brake.rise),
        };
        injected.unwrap_or(AMBIENT + (rise >> 16) as u16)
    }

    /// Injects a temperature of a part, in 0.1 °C, from now on.
    pub(super) fn inject(&mut self, part: Part, temperature: u16) {
        let [mcu, power, brake] = &mut self.injected;
        let injected = match part {
            Part::Mcu => mcu,
            Part::Power => power,
            Part::Brake => brake,
        };
        *injected = Some(temperature);
    }

    /// Bits of ERROR of the parts that are too hot.
    pub(super) fn errors(&self, at: Instant) -> u16 {
        [
            (Part::Mcu, Error::McuOverheat),
            (Part::Power, Error::PowerOverheat),
            (Part::Brake, Error::BrakeOverheat),
        ]
        .into_iter()
        .filter(|&(part, _)| self.is_too_hot(at, part))
        .fold(0, |bits, (_, error)| bits | error as u16)
    }

    /// Returns true if a part is so hot that the motor must stop.
    fn is_too_hot(&self, at: Instant, part: Part) -> bool {
        let limit = match part {
            Part::Mcu => 850,
            Part::Power | Part::Brake => 1_000,
        };
        self.temperature(at, part) >= limit
    }

    fn catch_up(&mut self, at: Instant) {
        let steps = at.since(self.since) / STEP;
        self.since += STEP * steps;
        for _ in 0..steps.min(MOST_STEPS) {
            self.power.step();
            self.brake.step();
        }
    }
}

#[cfg(test)]
mod tests {
    use drivetwin_protocol::time::Span;

    use super::*;

    fn parts(thermal: &Thermal, at: Instant) -> [u16; 3] {
        [Part::Mcu, Part::Power, Part::Brake].map(|part| thermal.temperature(at, part))
    }

    #[test]
    fn a_drive_at_rest_stays_at_25_degrees() {
        let thermal = Thermal::new(Instant::ZERO, 20_000);
        assert_eq!(parts(&thermal, Instant::ZERO), [250; 3]);
        assert_eq!(parts(&thermal, 1_000_000.secs().into()), [250; 3]);
    }

    #[test]
    fn the_rated_current_warms_it_and_stays_below_the_limits() {
        let mut thermal = Thermal::new(Instant::ZERO, 20_000);
        thermal.draws(Instant::ZERO, 20_000, true);
        // 63 % of the final rise after the time constant of 64 steps.
        let [_, power, brake] = parts(&thermal, 64.secs().into());
        assert!((500..=506).contains(&power), "{power}");
        assert!((563..=570).contains(&brake), "{brake}");
        let end = parts(&thermal, 10_000.secs().into());
        assert_eq!(end, [349, 649, 749]);
        assert!(!thermal.is_too_hot(10_000.secs().into(), Part::Mcu));
        // Half of the current gives a quarter of the heat.
        thermal.draws(10_000.secs().into(), 10_000, false);
        assert_eq!(parts(&thermal, 20_000.secs().into()), [275, 350, 250]);
    }

    #[test]
    fn looking_at_it_changes_nothing() {
        let mut thermal = Thermal::new(Instant::ZERO, 20_000);
        let mut asked = thermal;
        for n in 0..300 {
            let at = (n * 370).millis().into();
            let ma = (n as u32 * 7_919) % 20_000;
            thermal.draws(at, ma, n % 2 == 0);
            asked.draws(at, ma, n % 2 == 0);
            for later in 0..370 {
                let _ = parts(&asked, at + later.millis());
            }
        }
        let at = 200.secs().into();
        assert_eq!(parts(&thermal, at), parts(&asked, at));
    }

    #[test]
    fn what_is_injected_stays() {
        let mut thermal = Thermal::new(Instant::ZERO, 20_000);
        thermal.inject(Part::Mcu, 849);
        assert!(!thermal.is_too_hot(Instant::ZERO, Part::Mcu));
        thermal.inject(Part::Mcu, 850);
        thermal.inject(Part::Brake, 1_000);
        assert_eq!(parts(&thermal, 1_000.secs().into()), [850, 250, 1_000]);
        let hot = [Part::Mcu, Part::Power, Part::Brake].map(|part| thermal.is_too_hot(1.secs().into(), part));
        assert_eq!(hot, [true, false, true]);
    }
}
