//! Formulas of a DC motor.

use std::f64::consts::TAU;

use drivetwin_firmware::motor::Parameters;

/// Limits of a drive.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    /// Current of the winding, in A.
    pub(crate) amps: f64,
    /// Greatest duty, as a part of the supply.
    pub(crate) duty: f64,
    /// Acceleration of the reference, in rpm per second.
    pub(crate) ramp: f64,
}

/// Final state of a motor that is commanded to turn forward.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) enum End {
    /// At its target, with this current in A.
    Target(f64),
    /// At full duty, below its target, with this speed in rpm.
    FullDuty(f64),
    /// At the limit of its current, below its target.
    CurrentLimit,
}

/// A DC motor, in SI units except for the speed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Motor {
    pub(crate) supply_v: f64,
    pub(crate) no_load_rpm: f64,
    pub(crate) resistance: f64,
    pub(crate) inertia: f64,
    pub(crate) friction: f64,
    /// Load torque against forward motion.
    pub(crate) load: f64,
}

impl Motor {
    /// A motor with an inertia that gives the time constant `seconds`. `friction` and `load` are parts of the
    /// torque at 25 A, or at standstill if that torque is less.
    pub(crate) fn new(
        supply_v: f64,
        no_load_rpm: f64,
        resistance: f64,
        seconds: f64,
        friction: f64,
        load: f64,
    ) -> Self {
        let whole = |x: f64, unit: f64| (x / unit).round() * unit;
        let supply_v = whole(supply_v, 0.1);
        let no_load_rpm = no_load_rpm.round();
        let resistance = whole(resistance, 0.001);
        let mut motor = Self { supply_v, no_load_rpm, resistance, inertia: 0.0, friction: 0.0, load: 0.0 };
        let k = motor.torque_constant();
        let torque = k * (supply_v / resistance).min(25.0);
        motor.inertia = whole(seconds * k * k / resistance, 1e-7).clamp(1e-7, 1.0);
        motor.friction = whole(friction * torque, 1e-6).min(100.0);
        motor.load = whole(load * torque, 1e-6).clamp(-100.0, 100.0);
        motor
    }

    pub(crate) fn parameters(&self) -> Parameters {
        Parameters {
            supply_mv: (self.supply_v * 1e3).round() as u32,
            no_load_rpm: self.no_load_rpm as u32,
            resistance_mohm: (self.resistance * 1e3).round() as u32,
            inertia_gcm2: (self.inertia * 1e7).round() as u32,
            friction_unm: (self.friction * 1e6).round() as u32,
            load_unm: (self.load * 1e6).round() as i32,
            ..Parameters::NOMINAL
        }
    }

    /// Torque constant in V·s, or N·m/A.
    fn torque_constant(&self) -> f64 {
        self.supply_v / (self.no_load_rpm * TAU / 60.0)
    }

    /// Torque at the greatest possible current, in N·m.
    pub(crate) fn torque_limit(&self, limits: &Limits) -> f64 {
        self.torque_constant() * limits.amps.min(self.supply_v / self.resistance)
    }

    /// Final state of the motor for the target `rpm`, which is above 0.
    pub(crate) fn end(&self, rpm: f64, limits: &Limits) -> End {
        let amps = (self.load + self.friction) / self.torque_constant();
        if amps > limits.amps && self.supply_v * limits.duty / self.resistance > limits.amps {
            return End::CurrentLimit;
        }
        // U·duty = I·R + U·n/n₀
        let lost = amps * self.resistance / self.supply_v;
        let most = (limits.duty - lost) * self.no_load_rpm;
        if rpm <= most {
            return End::Target(amps);
        }
        // At standstill friction may hold the shaft, or the load may turn it backward.
        let amps = (self.load - self.friction) / self.torque_constant();
        if amps > limits.amps {
            return End::CurrentLimit;
        }
        let still = amps * self.resistance / self.supply_v;
        End::FullDuty(if most > 0.0 { most } else { ((limits.duty - still) * self.no_load_rpm).min(0.0) })
    }

    /// Part of the supply that moves the motor from rest, in both directions.
    pub(crate) fn supply_at_rest(&self) -> f64 {
        (self.load.abs() + self.friction) / self.torque_constant() * self.resistance / self.supply_v
    }

    /// Time in s for which the current limit slows the motor down on the way to `rpm`.
    pub(crate) fn seconds_at_limit(&self, rpm: f64, limits: &Limits) -> f64 {
        let spare = self.torque_limit(limits) - self.load - self.friction;
        if spare > 0.0 { self.inertia * rpm * TAU / 60.0 / spare } else { f64::INFINITY }
    }

    /// Time in s after which the motor has reached its final state.
    pub(crate) fn settles(&self, rpm: f64, limits: &Limits) -> f64 {
        let k = self.torque_constant();
        let seconds = self.inertia * self.resistance / (k * k);
        let spare = (self.torque_limit(limits) - (self.load + self.friction).abs()).abs();
        let speed = rpm.max(self.no_load_rpm) * TAU / 60.0;
        let limited = self.inertia * speed / spare;
        0.5 + rpm / limits.ramp + 8.0 * seconds + 1.5 * limited
    }
}
