//! Computes the acceleration of a motor.
//!
//! The winding has no inductance. So at a constant duty the speed of a motor approaches its final value
//! exponentially. With *full* for the speed at the whole supply voltage and *stall* for the acceleration that
//! this voltage gives at standstill:
//!
//! ```text
//! acceleration = stall·(duty − speed/full) − load − friction      time constant T = full/stall
//! ```
//!
//! In a step of length *h* the mean acceleration is its value at the beginning times (1 − e⁻ˣ)/x, with *x* =
//! h/T. The code uses e⁻ˣ = 1/(1 + x + x²/2). This needs no exponential function, is exact up to x², and
//! never exceeds the final speed for any *x*. Current and acceleration are proportional, so a limit of the
//! current is a limit of the acceleration.
//!
//! If a load turns the shaft faster than *full*, the motor charges the supply through the diodes of the
//! bridge, as if the whole supply voltage were at the terminals. The duty and the current limit have no
//! effect on this. So the speed exceeds *full* at most by *full* times the ratio of the load to the motor's
//! torque at standstill.

use drivetwin_protocol::time::TICKS_PER_SECOND;

use super::{FULL_DUTY, MotionInterval, Parameters};
use crate::device::Duration;

/// The longest simulation step.
const STEP: Duration = Duration::millis(1);
/// The shortest simulation step. A motor with a time constant of less than twice this time reaches its speed
/// in one step.
const LEAST_STEP: Duration = Duration::micros(50);

/// Greatest acceleration by a torque. No real shaft has a greater one.
const MAX_ACCELERATION: i64 = 16 * MotionInterval::MAX_ACCELERATION;

/// Connection of a motor's terminals.
#[derive(Clone, Copy, Debug)]
pub(super) enum Terminals {
    /// A bridge without power.
    Dead,
    /// A bridge that leaves the terminals open.
    Open,
    /// A bridge that drives the terminals.
    Driven {
        /// Duty in 1/65536 of the supply voltage; 0 shorts the terminals.
        duty: i32,
        /// Current limit, in mA.
        limit_ma: u32,
    },
}

/// Constants computed from the parameters, in the units of a [`MotionInterval`].
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Constants {
    /// The speed at which the motor's own voltage is that of the supply.
    full: i64,
    /// Acceleration by the full supply voltage at standstill, above 0 and bounded. A motor with a greater
    /// acceleration reaches its speed within one step anyway.
    pub(super) stall: i64,
    /// The same acceleration without a bound. A limited current gives a proportional part of it.
    torque: i64,
    /// Current at the full supply voltage at standstill, in mA.
    pub(super) stall_ma: i64,
    friction: i64,
    /// Deceleration of forward motion by the load.
    load: i64,
    /// Friction and load scaled by `stall`/`torque`, so that a motor whose `stall` is bounded reaches the
    /// right speed.
    pub(super) bounded_friction: i64,
    pub(super) bounded_load: i64,
    step: Duration,
    /// Mean acceleration of a step, in 1/65536 of the acceleration at its beginning.
    mean: i64,
}

impl Constants {
    pub(super) fn of(parameters: &Parameters) -> Self {
        /// Torque in µN·m per mA of a motor with 1 mV per rpm: 60/2π, in 1/65536.
        const TORQUE: u64 = 625_823;
        /// 1 rpm in 2⁻⁶⁴ turns per tick.
        const RPM: u64 = (1 << 60) / (60 * TICKS_PER_SECOND / 16);
        /// Acceleration by 1 µN·m at 1 g·cm²: 10·2⁶⁴ / (2π·f²), in 2⁻⁶⁴ turns per tick², where f is the
        /// number of ticks per second. The constant is 16 times this value.
        const ACCELERATION: i64 = 1_834_932;
        let (least, most) = (Parameters::LEAST, Parameters::MOST);
        let supply = u64::from(parameters.supply_mv.clamp(least.supply_mv, most.supply_mv));
        let rpm = u64::from(parameters.full_rpm());
        let resistance =
            i64::from(parameters.resistance_mohm.clamp(least.resistance_mohm, most.resistance_mohm));
        let inertia = i64::from(parameters.inertia_gcm2.clamp(least.inertia_gcm2, most.inertia_gcm2));
        let friction = parameters.friction_unm.clamp(least.friction_unm, most.friction_unm);
        let load = parameters.load_unm.clamp(least.load_unm, most.load_unm);
        let accelerated =
            |unm: i64| ((unm * ACCELERATION / inertia) >> 4).clamp(-MAX_ACCELERATION, MAX_ACCELERATION);

        let stall_ma = (supply * 1_000).cast_signed() / resistance;
        // Not computed from whole mA, because some motors draw only a few.
        let stall_unm =
            ((supply * TORQUE / rpm).cast_signed() * (supply * 1_000).cast_signed() / resistance) >> 16;
        let full = ((rpm * RPM) >> 8).cast_signed();
        let torque = (stall_unm * ACCELERATION / inertia) >> 4;
        let stall = torque.clamp(1, 1 << 34);
        let bounded = |unm: i64| match (unm * stall).checked_div(stall_unm) {
            Some(part) if torque != stall => part.clamp(-MAX_ACCELERATION, MAX_ACCELERATION),
            _ => accelerated(unm),
        };
        let mut constants = Self {
            full,
            stall,
            torque,
            stall_ma,
            friction: accelerated(friction.into()),
            load: accelerated(load.into()),
            bounded_friction: bounded(friction.into()),
            bounded_load: bounded(load.into()),
            step: STEP,
            mean: 0,
        };
        let t = constants.time_constant();
        constants.step = Duration::from_ticks(t.ticks() / 2).max(LEAST_STEP).min(STEP);
        let (t, h) = (t.ticks(), constants.step.ticks());
        // (1 + x/2)/(1 + x + x²/2)
        constants.mean = (((2 * t * t + t * h) << 16) / (2 * t * t + 2 * t * h + h * h)).cast_signed();
        constants
    }

    /// The time constant full/stall in ticks, at least one.
    pub(super) fn time_constant_ticks(&self) -> i64 {
        (self.full << 8).checked_div(self.stall).unwrap_or(1).max(1)
    }

    /// The time constant, at most half a second.
    fn time_constant(&self) -> Duration {
        const LONGEST: i64 = 1 << 23;
        Duration::from_ticks(self.time_constant_ticks().min(LONGEST).cast_unsigned())
    }

    /// The next interval from `now` on, and the current at its beginning, in mA.
    pub(super) fn next(
        &self,
        now: MotionInterval,
        terminals: Terminals,
        blocked: bool,
    ) -> (MotionInterval, i32) {
        let (drive_acceleration, most_ma) = match terminals {
            Terminals::Driven { duty, limit_ma } => {
                (self.drive_acceleration(duty, now.speed), i64::from(limit_ma))
            }
            Terminals::Dead | Terminals::Open => (0, 0),
        };
        let regeneration =
            if matches!(terminals, Terminals::Dead) { 0 } else { self.regeneration(now.speed) };
        let part = |of: i64| most_ma.saturating_mul(of) / self.stall_ma.max(1);
        // At full speed against the supply the current is twice the standstill current. A higher limit has no
        // effect.
        let bounded = part(self.stall).min(2 * self.stall);
        let drives =
            stronger_brake(drive_acceleration.min(bounded).max(-bounded), regeneration, regeneration);
        let ma = stronger_brake(
            self.current_for(drive_acceleration).min(most_ma).max(-most_ma),
            regeneration,
            self.current_for(regeneration),
        );
        let way = if now.speed != 0 {
            now.speed.signum()
        } else if (drives - self.bounded_load).abs() > self.bounded_friction {
            (drives - self.bounded_load).signum()
        } else {
            0
        };
        let against = self.load + way * self.friction;
        let mean = |drive_acceleration: i64| {
            ((drive_acceleration - self.bounded_load - way * self.bounded_friction) * self.mean) >> 16
        };
        let limit = part(self.torque).min(4 * MAX_ACCELERATION);
        let driven = match terminals {
            Terminals::Driven { .. } => mean(drive_acceleration).min(limit - against).max(-limit - against),
            Terminals::Dead | Terminals::Open => -against,
        };
        let acceleration = stronger_brake(driven, regeneration, mean(regeneration));
        let stands = way == 0 || (now.speed == 0 && acceleration == 0);
        let next = if blocked || stands {
            MotionInterval::at_rest(now.since(), now.angle)
        } else {
            self.interval(now, acceleration, terminals)
        };
        (next, ma.clamp(i32::MIN.into(), i32::MAX.into()) as i32)
    }

    /// The interval from `now` on with a constant acceleration. The interval lasts one step at most. It may
    /// last longer if the terminals are dead. It may also last longer if they are open and the motor is not
    /// faster than the supply would turn it.
    fn interval(&self, now: MotionInterval, acceleration: i64, terminals: Terminals) -> MotionInterval {
        let coasts = now.with(acceleration, MotionInterval::LONGEST);
        let steady = match terminals {
            Terminals::Dead => true,
            Terminals::Open => now.speed.abs().max(coasts.last_speed().abs()) <= self.full,
            Terminals::Driven { .. } => false,
        };
        if steady { coasts } else { now.with(acceleration, self.step) }
    }

    /// Acceleration by a duty at a speed, without current limit, friction and load.
    fn drive_acceleration(&self, duty: i32, speed: i64) -> i64 {
        let against = self.stall * (speed >> 16) / (self.full >> 16).max(1);
        ((self.stall * i64::from(duty.clamp(-FULL_DUTY, FULL_DUTY))) >> 16) - against
    }

    /// Current in mA that gives an acceleration by a duty.
    fn current_for(&self, drive_acceleration: i64) -> i64 {
        ((2 * drive_acceleration).saturating_mul(self.stall_ma).div_euclid(self.stall.max(1)) + 1) >> 1
    }

    /// Acceleration by the current with which the motor charges its supply; it brakes. 0 unless the motor is
    /// faster than the supply would turn it.
    fn regeneration(&self, speed: i64) -> i64 {
        let way = speed.signum() as i32;
        let drive_acceleration =
            if speed.abs() > self.full { self.drive_acceleration(way * FULL_DUTY, speed) } else { 0 };
        if drive_acceleration.signum() * i64::from(way) < 0 { drive_acceleration } else { 0 }
    }
}

/// Returns `acceleration`, or `with_charge` if the motor charges its supply and `with_charge` brakes more.
/// The sign of `regeneration` is the direction that brakes.
fn stronger_brake(acceleration: i64, regeneration: i64, with_charge: i64) -> i64 {
    match regeneration.signum() {
        -1 => acceleration.min(with_charge),
        1 => acceleration.max(with_charge),
        _ => acceleration,
    }
}
