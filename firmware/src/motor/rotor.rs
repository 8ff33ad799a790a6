//! A rotor, as the sensors on its shaft see it.

use crate::device::{Device, Instant};

/// A motor as seen from its shaft: for encoders, switches and displays.
///
/// Angles are in 2⁻³² turns and wrap. Instants are from the last call of the device on and before
/// [`until`](Self::until); in that time the shaft does not change its direction.
pub trait Rotor: Device {
    /// Time until which it turns as at present if nothing happens to it: one of its deadlines.
    fn until(&self) -> Instant;

    /// Angle of the shaft.
    fn angle_at(&self, at: Instant) -> i64;

    /// Returns whether the shaft is at an angle, or forward of it.
    fn is_at_least(&self, at: Instant, angle: i64) -> bool {
        self.angle_at(at).wrapping_sub(angle) >= 0
    }

    /// Present motion.
    fn kinematics(&self) -> Kinematics;

    /// Returns whether it cannot follow its drive.
    fn stalled(&self) -> bool;

    /// Current in mA, signed as a duty is.
    fn draws_ma(&self) -> i32;
}

/// Motion of a shaft from an instant on, to compute with where a tick more or less does not matter.
///
/// *d* ticks later it has made `d·(2·half_speed + half_acceleration·d)` of the `turn` parts of a turn.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Kinematics {
    /// From when on.
    pub since: Instant,
    /// Angle then, in 2⁻³² turns.
    pub angle: i64,
    /// Half of its speed, in parts of a turn a tick, signed.
    pub half_speed: i64,
    /// Half of its acceleration, in parts of a turn a tick².
    pub half_acceleration: i64,
    /// The parts of a turn.
    pub turn: i128,
}
