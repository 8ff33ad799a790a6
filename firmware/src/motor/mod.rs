//! Motors that are not there, and a drive that turns one.

mod rig;

pub use self::rig::{Rig, Turns};

/// What a brush motor and its load are.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Parameters {
    /// What feeds the drive, in mV.
    pub supply_mv: u32,
    /// How fast the motor turns at the full supply without load and friction, in rpm: its torque constant.
    pub no_load_rpm: u32,
    /// Of its winding, in mΩ.
    pub resistance_mohm: u32,
    /// Of rotor and load, in g·cm².
    pub inertia_gcm2: u32,
    /// Torque against any motion, in µN·m; also what holds it at rest.
    pub friction_unm: u32,
    /// Torque of the load, in µN·m, positive against forward motion; also at rest.
    pub load_unm: i32,
    /// Pulses of a Hall sensor in a turn.
    pub hall_pulses: u16,
}

impl Parameters {
    /// A motor of some 200 W at 24 V, without load.
    pub const NOMINAL: Self = Self {
        supply_mv: 24_000,
        no_load_rpm: 3_000,
        resistance_mohm: 500,
        inertia_gcm2: 400,
        friction_unm: 10_000,
        load_unm: 0,
        hall_pulses: 4,
    };
}
