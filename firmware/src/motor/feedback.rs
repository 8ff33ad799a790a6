//! Feedback of a motor to the control loop of its drive.
//!
//! A real drive estimates the state of the motor between two edges of its sensors. Here the motor is
//! simulated in the same process. It reports its [`Parameters`] and its [`Rotation`], so the drive does not
//! estimate them. The control loop still controls the position and the speed that the sensors show
//! ([`Edges`](super::Edges)). If a sensor's pins are driven from outside, there is no report of the shaft.
//! Then the speed comes from the edges alone.

use fixed::types::I40F24;

use super::{Parameters, Rotation};
use crate::device::{Duration, Input, Instant};

/// Period of a control loop.
pub(crate) const TICK: Duration = Duration::millis(1);
/// Duty of the whole supply voltage.
pub(crate) const FULL_DUTY: i32 = 1 << 16;
/// Distance from the middle of a count, in counts, within which a move ends. With a smaller value the least
/// duty would push the shaft to and fro. With a greater one a little drift would change the count.
pub(crate) const NEAR: I40F24 = I40F24::lit("0.25");
/// Upper limit of torques, as a multiple of the motor's torque at standstill. No motor can turn against such
/// a torque, so a greater one has the same effect.
const MOST_TORQUE: i64 = 4;

/// A motor in the units of a control loop. Torques and currents are expressed as the loss of speed, in rpm,
/// that they cause.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct ControlModel {
    /// Speed at the whole supply voltage without any torque.
    full: I40F24,
    /// Duty per rpm.
    per_rpm: I40F24,
    /// Current at the whole supply voltage at standstill, in mA.
    stall_ma: i64,
    /// Part of the difference to the final speed that the motor covers in a [`TICK`], above 0.
    pub(crate) gain: I40F24,
    /// Inverse of `gain`.
    inverse: I40F24,
    /// Time in which the difference to the final speed falls to 1/e, as a multiple of [`TICK`].
    pub(crate) slowness: I40F24,
    /// Loss of speed by friction.
    pub(crate) friction: I40F24,
    /// Loss of speed by the load in forward motion.
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

    /// Loss of speed by a current in the winding, at most twice that of the current at standstill.
    pub(crate) fn speed_drop(&self, ma: i64) -> I40F24 {
        let most = 2 * self.stall_ma;
        self.full * ratio(ma.min(most).max(-most), self.stall_ma)
    }

    /// Loss of speed by load and friction. `way` is 1 for a shaft that turns forward, and −1 for one that
    /// turns backward. At rest, 0, only the part of the load counts that friction does not hold.
    pub(crate) fn torque(&self, way: i64) -> I40F24 {
        match way {
            0 => self.load - self.load.max(-self.friction).min(self.friction),
            way => self.load + self.friction * way.signum(),
        }
    }

    /// Returns true if friction holds a shaft at rest without a current.
    pub(crate) fn holds(&self) -> bool {
        self.load.abs() <= self.friction
    }

    /// Greatest decrease of speed in a [`TICK`], in rpm, of a shaft that turns in the direction `way`. The
    /// current limit `limit_ma`, the duty `most_duty`, load and friction determine it.
    pub(crate) fn max_deceleration(&self, limit_ma: u32, most_duty: i32, way: i64) -> I40F24 {
        let current = self.speed_drop(limit_ma.into()).min(self.rpm(most_duty));
        (current + self.torque(way) * way) * self.gain
    }

    /// The duty at which the speed without current is `rpm`. Its limit is far beyond the whole supply
    /// voltage.
    pub(crate) fn duty(&self, rpm: I40F24) -> I40F24 {
        const MOST: I40F24 = I40F24::const_from_int(1 << 30);
        rpm.saturating_mul(self.per_rpm).clamp(-MOST, MOST)
    }

    /// The speed without current at a duty.
    pub(crate) fn rpm(&self, duty: i32) -> I40F24 {
        I40F24::from_bits((self.full.to_bits() * i64::from(duty)) >> 16)
    }

    /// The duty that brings the speed from `rpm` to `wanted` in a [`TICK`]. Its limit is far beyond the whole
    /// supply voltage.
    pub(crate) fn duty_to_reach(&self, rpm: I40F24, wanted: I40F24) -> I40F24 {
        let way = if rpm == 0 { wanted.signum() } else { rpm.signum() };
        let step = (wanted - rpm).saturating_mul(self.inverse);
        self.duty(rpm.saturating_add(step).saturating_add(self.torque(way.to_num::<i64>())))
    }
}

/// The speed reference of a control loop one [`TICK`] after `setpoint`, on the way to `target`. Its magnitude
/// rises at most by `up` and falls at most by `down`, at any rate if there is none; it changes its sign only at 0.
pub(crate) fn ramped(setpoint: I40F24, target: I40F24, up: Option<I40F24>, down: Option<I40F24>) -> I40F24 {
    let turns_round = setpoint.signum() * target.signum() < 0;
    let (slows, aim) =
        if turns_round { (true, I40F24::ZERO) } else { (target.abs() < setpoint.abs(), target) };
    let next = match if slows { down } else { up } {
        Some(rate) => setpoint + (aim - setpoint).min(rate).max(-rate),
        None => aim,
    };
    // Without a ramp down, the reference reaches 0 at once and changes its sign in the same ms.
    if turns_round && next == 0 && down.is_none() { ramped(next, target, up, down) } else { next }
}

/// Quotient of two numbers. The second must be above 0.
pub(crate) fn ratio(one: i64, other: i64) -> I40F24 {
    const MOST: i64 = 1 << 38;
    I40F24::from_bits((one.clamp(-MOST, MOST) << 24).checked_div(other).unwrap_or(0))
}

/// Reports from the motor of a drive.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Feedback {
    /// Model of the reported motor; before the first report, of the motor that the drive expects.
    pub(crate) motor: ControlModel,
    /// The last report of the rotation, and its time.
    rotation: Option<(Instant, Rotation)>,
    /// Current of the motor in mA, with the sign of the duty.
    pub(crate) ma: i32,
}

impl Feedback {
    /// State without reports. The motor is the one that the drive expects.
    pub(crate) fn new(expected: &Parameters) -> Self {
        Self { motor: ControlModel::of(expected), rotation: None, ma: 0 }
    }

    /// Stores a report of the motor: its current, its parameters, or its rotation from `at` on.
    #[inline]
    pub(crate) fn report(&mut self, at: Instant, input: &Input<'_>) {
        match *input {
            Input::MotorCurrent { ma, .. } => self.ma = ma,
            Input::Motor { parameters, .. } => self.motor = ControlModel::of(parameters),
            Input::Rotation { rotation, .. } => self.rotation = Some((at, rotation)),
            _ => {}
        }
    }

    /// Returns true if a motor has reported its rotation.
    pub(crate) fn is_reported(&self) -> bool {
        self.rotation.is_some()
    }

    fn now(&self, at: Instant) -> Option<Rotation> {
        self.rotation.map(|(since, rotation)| rotation.after(at.since(since)))
    }

    /// Angle of the shaft in 2⁻³² turns; `None` without a report.
    pub(crate) fn angle(&self, at: Instant) -> Option<i64> {
        self.now(at).map(|rotation| rotation.angle)
    }

    /// Speed of the shaft in rpm; `None` without a report.
    pub(crate) fn rpm(&self, at: Instant) -> Option<I40F24> {
        self.now(at).map(Rotation::rpm)
    }

    /// Returns true if the current limit reduces the motor's current.
    pub(crate) fn is_limited(&self, limit_ma: u32) -> bool {
        limit_ma > 0 && self.ma.unsigned_abs() >= limit_ma
    }

    /// The effective duty at the terminals. While the current limit acts, this is less than `duty`.
    pub(crate) fn applied(&self, at: Instant, duty: i32, limit_ma: u32) -> i32 {
        if duty == 0 || limit_ma == 0 {
            return 0;
        }
        let rpm = self.rpm(at).filter(|_| self.is_limited(limit_ma));
        let left = rpm.map(|rpm| self.motor.duty(rpm + self.motor.speed_drop(self.ma.into())).to_num());
        left.map_or(duty, |left: i32| left.clamp(-FULL_DUTY, FULL_DUTY))
    }
}
