//! A stepper motor.

/// What a stepper motor and its load are.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Parameters {
    /// Full steps in a turn, 4 to 10,000.
    pub steps_per_rev: u16,
    /// Torque that holds it at its rated current, in µN·m, up to 100,000,000; 0: it follows whatever the load is.
    pub holding_unm: u32,
    /// Peak current of that torque, in mA, 1 to 100,000.
    pub rated_ma: u32,
    /// The speed at which no torque is left, in rpm, 1 to 200,000; it falls evenly with the speed.
    pub pull_out_rpm: u32,
    /// Of rotor and load, in g·cm², 1 to 10,000,000.
    pub inertia_gcm2: u32,
    /// Torque against any motion, in µN·m, up to 100,000,000.
    pub friction_unm: u32,
    /// Torque of the load, in µN·m, up to 100,000,000, positive against forward motion.
    pub load_unm: i32,
}

impl Parameters {
    /// 200 steps, and no load that it could not follow.
    pub const NOMINAL: Self = Self {
        steps_per_rev: 200,
        holding_unm: 0,
        rated_ma: 3_000,
        pull_out_rpm: 3_000,
        inertia_gcm2: 400,
        friction_unm: 10_000,
        load_unm: 0,
    };
}
