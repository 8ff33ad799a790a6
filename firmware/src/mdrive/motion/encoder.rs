//! The encoder: the one on the drive's own shaft, or a remote one (MC 5-22).

use super::motor::Motor;
use crate::device::{Duration, Instant};

/// The encoder, which counts as C2 does, but is never preset.
///
/// The built-in encoder is at count 0, on its index, at angle 0. A remote one counts instead once something drives its
/// channels, from the same count on; forward its channel A is before B (MDRIVE-21).
#[derive(Clone, Debug)]
pub(super) struct Encoder {
    /// Counts of the built-in encoder in a turn.
    counts_per_rev: u32,
    /// Offset of the count to that of the encoder that counts.
    origin: i32,
    remote: i32,
    channels: [Option<bool>; 3],
}

/// A pin of a remote encoder, as [`Encoder`] numbers them.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) enum Channel {
    A,
    B,
    Index,
}

impl Encoder {
    /// The built-in one has so many lines.
    pub(super) fn new(lines: u16) -> Self {
        Self { counts_per_rev: 4 * u32::from(lines), origin: 0, remote: 0, channels: [None; 3] }
    }

    /// Returns whether a remote encoder counts.
    pub(super) fn is_remote(&self) -> bool {
        matches!(self.channels, [Some(_), ..] | [_, Some(_), _])
    }

    pub(super) fn count(&self, at: Instant, motor: &Motor) -> i32 {
        let count = if self.is_remote() { self.remote } else { self.built_in(motor.angle(at)) as i32 };
        count.wrapping_add(self.origin)
    }

    /// Returns whether it is on its index.
    pub(super) fn is_on_index(&self, at: Instant, motor: &Motor) -> bool {
        match self.channels {
            [.., index] if self.is_remote() => index == Some(true),
            _ => self.turned(self.built_in(motor.angle(at))) == 0,
        }
    }

    /// The built-in count at an angle.
    fn built_in(&self, angle: i64) -> i64 {
        ((i128::from(angle) * i128::from(self.counts_per_rev)) >> 32) as i64
    }

    /// Counts beyond the last index.
    fn turned(&self, count: i64) -> i64 {
        count.checked_rem_euclid(self.counts_per_rev.into()).unwrap_or(0)
    }

    /// Time at which the built-in encoder comes onto its index next, or leaves it; never if the shaft changes its
    /// motion before.
    pub(super) fn index_changes(&self, at: Instant, motor: &Motor) -> Instant {
        let kinematics = motor.kinematics();
        let way = if kinematics.half_speed == 0 {
            kinematics.half_acceleration.signum()
        } else {
            kinematics.half_speed.signum()
        };
        if way == 0 || self.is_remote() {
            return Instant::NEVER;
        }
        let now = self.built_in(motor.angle(at));
        let change = match (self.turned(now), way) {
            (0, way) => now + way,
            (turned, 1) => now - turned + i64::from(self.counts_per_rev),
            (turned, _) => now - turned,
        };
        self.passes(at, motor, change)
    }

    /// The first tick after `at` at which the shaft has come to `count`, or beyond; never if that is not before it
    /// turns otherwise.
    fn passes(&self, at: Instant, motor: &Motor, count: i64) -> Instant {
        let now = self.built_in(motor.angle(at));
        let is_there = |tick: u64| {
            let here = self.built_in(motor.angle(at + Duration::from_ticks(tick)));
            if count > now { here >= count } else { here <= count }
        };
        let (mut first, mut last) = (1, motor.deadline().since(at).ticks());
        if count == now || !is_there(last) {
            return Instant::NEVER;
        }
        while first < last {
            let middle = first + (last - first) / 2;
            if is_there(middle) { last = middle } else { first = middle + 1 }
        }
        at + Duration::from_ticks(first)
    }

    /// Time at which the built-in encoder comes to `count` next, by [`Self::count`]; never if the shaft changes its
    /// motion before, or a remote one counts.
    pub(super) fn reaches(&self, at: Instant, motor: &Motor, count: i32) -> Instant {
        let kinematics = motor.kinematics();
        if self.is_remote() || kinematics.half_speed == 0 && kinematics.half_acceleration == 0 {
            return Instant::NEVER;
        }
        let way = count.wrapping_sub(self.count(at, motor));
        self.passes(at, motor, self.built_in(motor.angle(at)) + i64::from(way))
    }

    /// A pin of a remote encoder is driven to a level, or by nothing any more.
    pub(super) fn channel(&mut self, at: Instant, motor: &Motor, channel: Channel, level: Option<bool>) {
        let phase = self.phase();
        let mut channels = self.channels;
        if let Some(place) = channels.get_mut(channel as usize) {
            *place = level;
        }
        self.connect(at, motor, channels);
        if let (Some(before), Some(now)) = (phase, self.phase()) {
            let edges = match (now - before) & 3 {
                1 => 1,
                3 => -1,
                _ => 0,
            };
            self.remote = self.remote.wrapping_add(edges);
        }
    }

    /// Adds edges of a remote encoder that were counted outside, with its channels A and B at these levels.
    pub(super) fn take_edges(&mut self, at: Instant, motor: &Motor, edges: i32, [a, b]: [bool; 2]) {
        let [.., index] = self.channels;
        self.connect(at, motor, [Some(a), Some(b), index]);
        self.remote = self.remote.wrapping_add(edges);
    }

    /// Present levels of the channels: another counter may count from here, from the same count on.
    fn connect(&mut self, at: Instant, motor: &Motor, channels: [Option<bool>; 3]) {
        let count = self.count(at, motor);
        self.channels = channels;
        self.origin = self.origin.wrapping_add(count.wrapping_sub(self.count(at, motor)));
    }

    /// Quarters of a cycle, while both channels are driven.
    fn phase(&self) -> Option<i8> {
        match self.channels {
            [Some(true), Some(true), _] => Some(0),
            [Some(false), Some(true), _] => Some(1),
            [Some(false), Some(false), _] => Some(2),
            [Some(true), Some(false), _] => Some(3),
            _ => None,
        }
    }
}
