//! A time in which a shaft has one acceleration.

use crate::device::{Duration, Instant};

/// The greatest speed: 234,000 rpm.
const MOST: i64 = 1 << 44;

/// How a shaft turns from an instant on. It never turns round inside: the speed ends at 0.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Stretch {
    since: Instant,
    /// In 2⁻³² turns; wraps.
    pub(super) angle: i64,
    /// In 2⁻⁵⁶ turns a tick.
    pub(super) speed: i64,
    /// In 2⁻⁶⁴ turns a tick².
    acceleration: i64,
    /// How long; without end only where nothing moves.
    length: Duration,
}

impl Stretch {
    /// The longest one in which something moves. With it and [`Constants`](super::Constants)' limits nothing
    /// here exceeds 63 bits.
    pub(super) const LONGEST: Duration = Duration::from_ticks(1 << 16);
    /// The greatest acceleration.
    pub(super) const STEEPEST: i64 = 1 << 36;

    /// Standing.
    pub(super) fn rest(since: Instant, angle: i64) -> Self {
        Self { since, angle, speed: 0, acceleration: 0, length: Duration::FOREVER }
    }

    /// What begins here with that acceleration and lasts `length`, or until it stands.
    pub(super) fn with(self, acceleration: i64, length: Duration) -> Self {
        let acceleration = acceleration.clamp(-Self::STEEPEST, Self::STEEPEST);
        let length = length.min(Self::LONGEST);
        let stops = if (self.speed < 0) == (acceleration < 0) || self.speed == 0 {
            None
        } else {
            (self.speed.unsigned_abs() << 8).div_ceil(acceleration.unsigned_abs().max(1)).into()
        };
        let length = stops.map_or(length, |ticks| length.min(Duration::from_ticks(ticks)));
        Self { acceleration, length, ..self }
    }

    pub(super) fn since(&self) -> Instant {
        self.since
    }

    pub(super) fn end(&self) -> Instant {
        self.since + self.length
    }

    /// Where it is at `at`, not before it began nor after its end; from there on it stands, or goes on
    /// [`with`](Self::with) something.
    pub(super) fn at(&self, at: Instant) -> Self {
        let moves = self.speed != 0 || self.acceleration != 0;
        let passed = at.since(self.since).ticks().min(self.length.ticks());
        let ticks = if moves { passed.cast_signed() } else { 0 };
        let gain = (self.acceleration * ticks) >> 8;
        let speed = self.speed + gain;
        let turned_round = self.speed.signum() * speed.signum() < 0;
        Self {
            since: at,
            angle: self.angle.wrapping_add(((2 * self.speed + gain) * ticks) >> 25),
            speed: if turned_round { 0 } else { speed.clamp(-MOST, MOST) },
            ..*self
        }
    }

    /// The angle at `at`, not after its end.
    pub(super) fn angle_at(&self, at: Instant) -> i64 {
        self.at(at).angle
    }
}
