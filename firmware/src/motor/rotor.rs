//! What turns, seen by what is on its shaft.

use crate::device::{Device, Instant};

/// A motor as those see it who look at its shaft: encoders, switches, people.
///
/// Angles are in 2⁻³² turns and wrap. What is asked about an instant holds from the last call of the device on and
/// before [`until`](Self::until); in that time the shaft does not turn round.
pub trait Rotor: Device {
    /// When it begins to turn otherwise if nothing happens to it: one of its deadlines.
    fn until(&self) -> Instant;

    /// Where the shaft is.
    fn angle_at(&self, at: Instant) -> i64;

    /// Whether the shaft is at an angle, or forward of it.
    fn is_at_least(&self, at: Instant, angle: i64) -> bool {
        self.angle_at(at).wrapping_sub(angle) >= 0
    }

    /// How it turns at present.
    fn pace(&self) -> Pace;

    /// Whether it cannot follow its drive.
    fn stalled(&self) -> bool;

    /// What it draws, in mA, signed as a duty is.
    fn draws_ma(&self) -> i32;
}

/// How a shaft turns from an instant on, to reckon with where a tick more or less does not matter.
///
/// *d* ticks later it has made `d·(2h + a·d)` of the `turn` parts of a turn.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Pace {
    /// From when on.
    pub since: Instant,
    /// Where it was then, in 2⁻³² turns.
    pub angle: i64,
    /// Half of its speed, in parts of a turn a tick, signed.
    pub h: i64,
    /// Half of its acceleration, in parts of a turn a tick².
    pub a: i64,
    /// The parts of a turn.
    pub turn: i128,
}
