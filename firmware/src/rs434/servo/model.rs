//! What the drive knows of its motor: at first what RATED_SPEED and [`Parameters::NOMINAL`] say, as if someone had
//! told it. Of a motor that is another one it learns what a voltage is in counts, what its winding resists, and how
//! soon it follows. Of one that is as it was told there is nothing to learn, and nothing changes.

use fixed::types::I40F24;

use super::LOOK;
use super::response::Answer;
use super::seen::{ratio, scaled};
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

/// What is faster does not stand, whatever was learnt: friction alone would let it leave its count.
const SLOW: I40F24 = I40F24::lit("0.025");

/// The supply in nV, as parts of a resistance have it.
const SUPPLY: i64 = Parameters::NOMINAL.supply_mv as i64 * 1_000 * PARTS;
/// Of a mΩ.
const PARTS: i64 = 8;
const LEAST_RESISTANCE: i64 = 10 * PARTS;
const MOST_RESISTANCE: i64 = 4_000 * PARTS;
/// The part of a resistance that may be rounding, or a motor that was not quite at rest.
const SAME: i64 = 128;

/// Smaller changes of the speed are too coarse to learn from.
const COARSE_MA: i64 = 16;
/// So must the push be where the motor turned round: much more than its friction, which turned round, too.
const BEYOND_FRICTION_MA: i64 = 2_000;
/// The part of a change that may be another one than was expected: without it a load that comes or goes would
/// make another motor of the one that was told. One that is another anyhow is learnt more closely.
const PLAUSIBLE: i64 = 2;
const PLAUSIBLE_OF_ANOTHER: i64 = 8;
/// The most that is learnt at once.
const TIMES: i64 = 4;
const LEAST_GAIN: I40F24 = I40F24::lit("0.001");
/// A gain that was learnt is known no better than this: what is less would be pushed by rounding alone.
const LEAST_PUSHED: I40F24 = I40F24::lit("0.03125");
/// Bounds of the speed at full duty that is learnt: no motor of the bench is beyond.
const LEAST_FULL: I40F24 = I40F24::lit("0.002");
const MOST_FULL: I40F24 = I40F24::lit("64");

/// What the drive knows of its motor, in counts and looks.
#[derive(Clone, Copy, Debug)]
pub(super) struct Model {
    /// RATED_SPEED, in rpm.
    rated: u16,
    /// Speed at full duty.
    full: I40F24,
    /// Of its winding, in 1/8 mΩ.
    resistance: i64,
    /// It is another one than it was told.
    pub(super) another: bool,
    /// The part of the way to its final speed that a motor makes in a look.
    pub(super) gain: I40F24,
    /// 1/gain: by how much more of a push it gets so much faster in a look.
    pub(super) inverse: I40F24,
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
            resistance: i64::from(Parameters::NOMINAL.resistance_mohm) * PARTS,
            another: false,
            inverse: I40F24::from_bits((((whole << 12) / part.max(1)) << 12).cast_signed()),
        }
    }

    /// The registers say something else now. What was learnt of another motor holds, as far as sensors tell of it.
    /// Whether anything is believed otherwise than before.
    pub(super) fn told(&mut self, now: &Settings, before: &Settings) -> bool {
        let motor = |of: &Settings| (of.rated, of.pulses, of.halls);
        if motor(now) == motor(before) {
            return false;
        }
        let learnt = core::mem::replace(self, Self::of(now));
        if learnt.another && now.sees() && before.sees() {
            let full = scaled(learnt.full, now.counts(), before.counts());
            *self = Self { rated: now.rated, full: full.clamp(LEAST_FULL, MOST_FULL), ..learnt };
        }
        true
    }

    /// Standing it drew so much at that duty.
    pub(super) fn stood(&mut self, duty: i32, ma: i32) {
        let voltage = SUPPLY / FULL * i64::from(duty.abs());
        let resistance = voltage.checked_div(i64::from(ma.abs())).unwrap_or(MOST_RESISTANCE);
        let resistance = resistance.clamp(LEAST_RESISTANCE, MOST_RESISTANCE);
        if self.another || (resistance - self.resistance).abs() * SAME > self.resistance {
            (self.resistance, self.another) = (resistance, true);
        }
    }

    /// Standing it would have drawn more than the limit of its current, at a duty that was to stay below it.
    pub(super) fn stood_at_limit(&mut self) {
        (self.resistance, self.another) = ((self.resistance / 2).max(LEAST_RESISTANCE), true);
    }

    /// It turns so many times as fast by a voltage as was believed.
    pub(super) fn turns(&mut self, times: I40F24) {
        (self.full, self.another) = ((self.full * times).clamp(LEAST_FULL, MOST_FULL), true);
    }

    /// It answered like that.
    pub(super) fn answered(&mut self, answer: Answer) {
        let Answer { push, change, turned } = answer;
        let (expected, plausible) =
            (push * self.gain, if self.another { PLAUSIBLE_OF_ANOTHER } else { PLAUSIBLE });
        if expected.abs() < self.lost(COARSE_MA)
            || turned && push.abs() < self.lost(BEYOND_FRICTION_MA)
            || (change - expected).abs() < expected.abs() / plausible
        {
            return;
        }
        let gain = ratio(change, push).max(self.gain / TIMES).min(self.gain * TIMES);
        self.gain = ((gain + self.gain) / 2).clamp(LEAST_GAIN, I40F24::ONE);
        self.inverse = ratio(I40F24::ONE, self.gain.max(LEAST_PUSHED));
        self.another = true;
    }

    /// How slow is standing. From a speed v shorted terminals let pass v/gain. What the current does not tell from
    /// standing is standing.
    pub(super) fn slow(&self) -> I40F24 {
        (self.full / STANDING).min(self.gain / SLIDE).min(SLOW).max(self.lost(MARGIN_MA))
    }

    /// The speed whose voltage so much current loses in the winding.
    pub(super) fn lost(&self, ma: i64) -> I40F24 {
        I40F24::from_bits(self.full.to_bits() * ma * self.resistance / SUPPLY)
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
