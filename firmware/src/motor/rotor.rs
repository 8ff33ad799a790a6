//! The interface between a motor and the sensors on its shaft.

use crate::device::{Device, Instant};

/// A motor as seen from its shaft, for encoders, switches and displays.
///
/// Angles are in 2⁻³² turns and wrap. Instants passed to these functions are not before the last call of the
/// device, and are before [`until`](Self::until). In this time the shaft does not reverse.
pub trait Rotor: Device {
    /// Time until which the present motion lasts if the motor gets no input. This is one of the motor's
    /// deadlines.
    fn until(&self) -> Instant;

    /// Angle of the shaft.
    fn angle_at(&self, at: Instant) -> i64;

    /// Returns true if the shaft is at `angle` or forward of it.
    fn is_at_least(&self, at: Instant, angle: i64) -> bool {
        self.angle_at(at).wrapping_sub(angle) >= 0
    }

    /// The present motion.
    fn kinematics(&self) -> Kinematics;

    /// Returns true if the motor cannot follow its drive.
    fn stalled(&self) -> bool;

    /// Current in mA, with the sign of a duty.
    fn draws_ma(&self) -> i32;
}

/// Motion of a shaft from an instant on, for computations where an error of a tick does not matter.
///
/// After *d* ticks the shaft has turned by `d·(2·half_speed + half_acceleration·d)` parts; `turn` parts are
/// one turn.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Kinematics {
    /// Start of this motion.
    pub since: Instant,
    /// Angle at the start, in 2⁻³² turns.
    pub angle: i64,
    /// Half of the speed, in parts of a turn per tick, signed.
    pub half_speed: i64,
    /// Half of the acceleration, in parts of a turn per tick².
    pub half_acceleration: i64,
    /// Number of parts of a turn.
    pub turn: i128,
}
