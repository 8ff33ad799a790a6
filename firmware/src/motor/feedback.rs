//! Feedback of a motor to the control loop of its drive.
//!
//! A real drive estimates the state of the motor between two edges of its sensors. Here the motor is simulated in the
//! same process, so it reports its [`Parameters`] and its [`Rotation`], and nothing is estimated. Position and speed
//! are still read from the sensors ([`Edges`](super::Edges)): the loop controls their readings. A sensor without a
//! report of the shaft, because its pins are driven from outside, gives the speed by its edges alone.

use fixed::types::I40F24;

use super::{Parameters, Rotation};
use crate::device::{Duration, Instant};

/// The period of a control loop.
pub(crate) const TICK: Duration = Duration::millis(1);
/// The whole supply, as a duty.
pub(crate) const FULL_DUTY: i32 = 1 << 16;
/// A move ends so near to the middle of a count, in counts: nearer, the least duty would push it to and fro; farther,
/// little drift would be another count.
pub(crate) const NEAR: I40F24 = I40F24::lit("0.25");
/// Torque that is this many times that of the supply at standstill acts like any more: nothing can turn against it.
const MOST_TORQUE: i64 = 4;

/// A motor in the units of a control loop: torques and currents are the speeds in rpm that they cost.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct ControlModel {
    /// Speed at the whole supply without any torque.
    full: I40F24,
    /// Duty of a rpm.
    per_rpm: I40F24,
    /// Current of the whole supply at standstill, in mA.
    stall_ma: i64,
    /// Part of the way to its final speed that the motor makes in a [`TICK`], above 0.
    pub(crate) gain: I40F24,
    /// Inverse of that.
    inverse: I40F24,
    /// Time in which it comes within 1/e of its final speed, in ticks of the loop.
    pub(crate) slowness: I40F24,
    /// Speed that friction costs.
    pub(crate) friction: I40F24,
    /// Speed that the load costs in forward motion.
    pub(crate) load: I40F24,
}

impl ControlModel {
    pub(crate) fn of(parameters: &Parameters) -> Self {
        let motor = super::Constants::of(parameters);
        let full = I40F24::from_num(parameters.full_rpm());
        let most = motor.stall.saturating_mul(MOST_TORQUE);
        let cost = |acceleration: i64| full * ratio(acceleration.min(most).max(-most), motor.stall);
        // 1 − e⁻ˣ as (x + x²/2)/(1 + x + x²/2), x = tick / time constant.
        let x = ratio(TICK.ticks().cast_signed(), motor.time_constant_ticks()).max(I40F24::DELTA);
        let way = x + x * x / 2;
        let gain =
            if way < 1_024 { ratio(way.to_bits(), (I40F24::ONE + way).to_bits()) } else { I40F24::ONE };
        let gain = gain.max(I40F24::DELTA);
        Self {
            full,
            per_rpm: ratio(FULL_DUTY.into(), parameters.full_rpm().into()),
            stall_ma: motor.stall_ma.max(1),
            gain,
            inverse: ratio(I40F24::ONE.to_bits(), gain.to_bits()),
            slowness: ratio(motor.time_constant_ticks(), TICK.ticks().cast_signed()),
            friction: cost(motor.bounded_friction),
            load: cost(motor.bounded_load),
        }
    }

    /// The speed that a current costs in the winding, at most twice that of the whole supply.
    pub(crate) fn speed_drop(&self, ma: i64) -> I40F24 {
        let most = 2 * self.stall_ma;
        self.full * ratio(ma.min(most).max(-most), self.stall_ma)
    }

    /// The speed that load and friction cost a shaft that turns forward (1) or backward (−1); at rest (0) what they
    /// cost at least, while friction holds.
    pub(crate) fn torque(&self, way: i64) -> I40F24 {
        match way {
            0 => self.load - self.load.max(-self.friction).min(self.friction),
            way => self.load + self.friction * way.signum(),
        }
    }

    /// Returns whether friction holds a shaft at rest without a current.
    pub(crate) fn holds(&self) -> bool {
        self.load.abs() <= self.friction
    }

    /// By how much a limit of the current, and so much of the supply as a duty, can slow down in a [`TICK`] a shaft
    /// that turns that way, with what load and friction do, in rpm.
    pub(crate) fn max_deceleration(&self, limit_ma: u32, most_duty: i32, way: i64) -> I40F24 {
        let current = self.speed_drop(limit_ma.into()).min(self.rpm(most_duty));
        (current + self.torque(way) * way) * self.gain
    }

    /// The duty of a speed without any current, far beyond the supply at most.
    pub(crate) fn duty(&self, rpm: I40F24) -> I40F24 {
        const MOST: I40F24 = I40F24::const_from_int(1 << 30);
        rpm.saturating_mul(self.per_rpm).clamp(-MOST, MOST)
    }

    /// The speed without any current of a duty.
    pub(crate) fn rpm(&self, duty: i32) -> I40F24 {
        I40F24::from_bits((self.full.to_bits() * i64::from(duty)) >> 16)
    }

    /// The duty that brings a shaft from one speed to another in a [`TICK`], far beyond the supply at most.
    pub(crate) fn duty_to_reach(&self, rpm: I40F24, wanted: I40F24) -> I40F24 {
        let way = if rpm == 0 { wanted.signum() } else { rpm.signum() };
        let step = (wanted - rpm).saturating_mul(self.inverse);
        self.duty(rpm.saturating_add(step).saturating_add(self.torque(way.to_num::<i64>())))
    }
}

/// Quotient of two numbers, of which the second is above 0.
pub(crate) fn ratio(one: i64, other: i64) -> I40F24 {
    const MOST: i64 = 1 << 38;
    I40F24::from_bits((one.clamp(-MOST, MOST) << 24).checked_div(other).unwrap_or(0))
}

/// Reports of the motor of a drive.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Feedback {
    /// The motor, or the one that the drive expects.
    pub(crate) motor: ControlModel,
    /// The last report of its shaft.
    rotation: Option<(Instant, Rotation)>,
    /// The current that it draws, in mA, signed as the duty.
    pub(crate) ma: i32,
}

impl Feedback {
    /// No reports yet; the motor is as the drive expects it.
    pub(crate) fn new(expected: &Parameters) -> Self {
        Self { motor: ControlModel::of(expected), rotation: None, ma: 0 }
    }

    /// The motor reports how it turns from `at` on.
    pub(crate) fn turns(&mut self, at: Instant, rotation: Rotation) {
        self.rotation = Some((at, rotation));
    }

    /// Returns whether a motor has reported a shaft.
    pub(crate) fn is_reported(&self) -> bool {
        self.rotation.is_some()
    }

    fn now(&self, at: Instant) -> Option<Rotation> {
        self.rotation.map(|(since, rotation)| rotation.after(at.since(since)))
    }

    /// Angle of the shaft, in 2⁻³² turns, if its motor reports it.
    pub(crate) fn angle(&self, at: Instant) -> Option<i64> {
        self.now(at).map(|rotation| rotation.angle)
    }

    /// Speed of the shaft, in rpm, if its motor reports it.
    pub(crate) fn rpm(&self, at: Instant) -> Option<I40F24> {
        self.now(at).map(Rotation::rpm)
    }

    /// Returns whether a limit of the current holds the motor back.
    pub(crate) fn is_limited(&self, limit_ma: u32) -> bool {
        limit_ma > 0 && self.ma.unsigned_abs() >= limit_ma
    }

    /// The duty that the terminals get of the `duty` they are put to: a limit of the current leaves less.
    pub(crate) fn applied(&self, at: Instant, duty: i32, limit_ma: u32) -> i32 {
        if duty == 0 || limit_ma == 0 {
            return 0;
        }
        let rpm = self.rpm(at).filter(|_| self.is_limited(limit_ma));
        let left = rpm.map(|rpm| self.motor.duty(rpm + self.motor.speed_drop(self.ma.into())).to_num());
        left.map_or(duty, |left: i32| left.clamp(-FULL_DUTY, FULL_DUTY))
    }
}
