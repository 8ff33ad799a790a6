//! A DC motor in formulas.

use std::f64::consts::TAU;

use drivetwin_firmware::motor::Parameters;

/// Limits of a drive.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    /// Current of the winding, in A.
    pub(crate) amps: f64,
    /// Part of the supply.
    pub(crate) duty: f64,
    /// Acceleration of the reference, in rpm a second.
    pub(crate) ramp: f64,
}

/// End of a motor that is to turn forward.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) enum End {
    /// At its target, with that current in A.
    Target(f64),
    /// As fast as the supply turns it, in rpm.
    FullDuty(f64),
    /// At the limit of its current, below its target.
    CurrentLimit,
}

/// A DC motor, in SI units but for the speed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Motor {
    pub(crate) supply_v: f64,
    pub(crate) no_load_rpm: f64,
    pub(crate) resistance: f64,
    pub(crate) inertia: f64,
    pub(crate) friction: f64,
    /// Against forward motion.
    pub(crate) load: f64,
}

impl Motor {
    /// With an inertia for that time constant in s; friction and load are parts of the torque of 25 A, or of standstill
    /// if that is less.
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

    /// V·s, or N·m/A.
    fn torque_constant(&self) -> f64 {
        self.supply_v / (self.no_load_rpm * TAU / 60.0)
    }

    /// The torque of the greatest current that there is, in N·m.
    pub(crate) fn torque_limit(&self, limits: &Limits) -> f64 {
        self.torque_constant() * limits.amps.min(self.supply_v / self.resistance)
    }

    /// End of the motor on the way to `rpm`, which is above 0.
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
        // At standstill friction may hold it, or the load turn it backward.
        let amps = (self.load - self.friction) / self.torque_constant();
        if amps > limits.amps {
            return End::CurrentLimit;
        }
        let still = amps * self.resistance / self.supply_v;
        End::FullDuty(if most > 0.0 { most } else { ((limits.duty - still) * self.no_load_rpm).min(0.0) })
    }

    /// The part of the supply that moves it from rest, either way.
    pub(crate) fn supply_at_rest(&self) -> f64 {
        (self.load.abs() + self.friction) / self.torque_constant() * self.resistance / self.supply_v
    }

    /// Time for which the limit of its current holds it back on the way to a speed, in s.
    pub(crate) fn seconds_at_limit(&self, rpm: f64, limits: &Limits) -> f64 {
        let spare = self.torque_limit(limits) - self.load - self.friction;
        if spare > 0.0 { self.inertia * rpm * TAU / 60.0 / spare } else { f64::INFINITY }
    }

    /// A time after which it has come to its end, in s.
    pub(crate) fn settles(&self, rpm: f64, limits: &Limits) -> f64 {
        let k = self.torque_constant();
        let seconds = self.inertia * self.resistance / (k * k);
        let spare = (self.torque_limit(limits) - (self.load + self.friction).abs()).abs();
        let speed = rpm.max(self.no_load_rpm) * TAU / 60.0;
        let limited = self.inertia * speed / spare;
        0.5 + rpm / limits.ramp + 8.0 * seconds + 1.5 * limited
    }
}
