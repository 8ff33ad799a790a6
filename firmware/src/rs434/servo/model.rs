//! What the drive knows of its motor, as if someone had told it: RATED_SPEED and [`Parameters::NOMINAL`].

use fixed::types::I40F24;

use super::LOOK;
use super::settings::Settings;
use crate::motor::Parameters;

/// Full duty.
const FULL: i64 = 1 << 16;
/// The most and the least that is not 0 (3).
pub(super) const MOST_DUTY: i64 = FULL * 98 / 100;
pub(super) const LEAST_DUTY: i64 = FULL / 100 + 1;

/// So much of a current may be rounding: less by it is not at the limit, and more is not standing. Without it
/// a limit that was asked for would be taken for one that holds the motor back.
pub(super) const MARGIN_MA: i64 = 4;

/// The part of its full speed that may be standing still: less than the least duty, 1/100, or what turns as
/// slowly as it can would be taken for what stands.
const STANDING: i64 = 128;
/// The part of a count that shorted terminals may still let pass once the motor is said to stand. With
/// [`NEAR`](super::NEAR) it is less than the half count to the next edge, or a move could leave its count
/// after its end.
const SLIDE: i64 = 8;

/// What the drive knows of its motor, in counts and looks.
#[derive(Clone, Copy, Debug)]
pub(super) struct Model {
    /// RATED_SPEED, in rpm.
    rated: u16,
    /// Speed at full duty.
    full: I40F24,
    /// The part of the way to its final speed that a motor makes in a look.
    pub(super) gain: I40F24,
    /// 1/gain.
    pub(super) inverse: I40F24,
    /// How slow is standing.
    pub(super) slow: I40F24,
}

impl Model {
    pub(super) fn of(settings: &Settings) -> Self {
        let full = settings.of_rpm(settings.rated);
        let motor = Parameters { no_load_rpm: settings.rated.into(), ..Parameters::NOMINAL };
        // 1 − e⁻ˣ as (x + x²/2)/(1 + x + x²/2), x = look / time constant.
        let (h, t) = (LOOK.ticks(), motor.time_constant().ticks().clamp(1, 1 << 22));
        let (part, whole) = (h * (2 * t + h), 2 * t * t + 2 * t * h + h * h);
        let gain = I40F24::from_bits(((part << 12) / (whole >> 12).max(1)).cast_signed());
        Self {
            rated: settings.rated,
            full,
            gain,
            inverse: I40F24::from_bits((((whole << 12) / part.max(1)) << 12).cast_signed()),
            // From a speed v shorted terminals let pass v/gain.
            slow: (full / STANDING).min(gain / SLIDE),
        }
    }

    /// The speed whose voltage so much current loses in the winding.
    pub(super) fn lost(&self, ma: i64) -> I40F24 {
        const RESISTANCE: i64 = Parameters::NOMINAL.resistance_mohm as i64;
        const SUPPLY: i64 = Parameters::NOMINAL.supply_mv as i64 * 1_000;
        I40F24::from_bits(self.full.to_bits() * ma * RESISTANCE / SUPPLY)
    }

    /// The speed that a duty would give without any current.
    pub(super) fn of_duty(&self, duty: i32) -> I40F24 {
        I40F24::from_bits((self.full.to_bits() * i64::from(duty)) >> 16)
    }

    /// That speed in rpm, without its sign.
    pub(super) fn rpm(&self, duty: i32) -> u16 {
        ((i64::from(duty.abs()) * i64::from(self.rated) + FULL / 2) >> 16) as u16
    }

    /// The nearest duty that there is.
    pub(super) fn duty(&self, speed: I40F24) -> i32 {
        let (size, full) = (speed.abs().to_bits() << 16, self.full.to_bits());
        let size = (size + full / 2).checked_div(full).unwrap_or(0).min(MOST_DUTY);
        let size = if size < LEAST_DUTY / 2 { 0 } else { size.max(LEAST_DUTY) };
        (size * speed.to_bits().signum()) as i32
    }
}
