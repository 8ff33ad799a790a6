//! The encoder: the one on the drive's own shaft, or a remote one (MC 5-22).

use crate::device::{Duration, Instant};
use crate::motor::Plant;
use crate::motor::stepper::StepperMotor;

/// Encoder with its count, which differs from C2 by C2's presets.
///
/// The built-in encoder has count 0 and its index at angle 0 of the shaft. Once something drives the channels
/// of a remote encoder, the remote encoder counts instead and continues from the same count. In forward
/// motion its channel A leads B (MDRIVE-21).
#[derive(Clone, Debug)]
pub(super) struct Encoder {
    /// Counts per revolution of the built-in encoder.
    counts_per_rev: u32,
    /// Added to the count of the encoder in use, so that the count does not jump when the other encoder takes
    /// over.
    origin: i32,
    remote: i32,
    channels: [Option<bool>; 3],
}

/// Pin of a remote encoder, numbered as in [`Encoder`].
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) enum Channel {
    A,
    B,
    Index,
}

impl Encoder {
    /// Creates an encoder whose built-in part has this number of lines.
    pub(super) fn new(lines: u16) -> Self {
        Self { counts_per_rev: 4 * u32::from(lines), origin: 0, remote: 0, channels: [None; 3] }
    }

    /// Returns true if a remote encoder counts, not the built-in one.
    pub(super) fn is_remote(&self) -> bool {
        matches!(self.channels, [Some(_), ..] | [_, Some(_), _])
    }

    pub(super) fn count(&self, at: Instant, motor: &StepperMotor) -> i32 {
        let count = if self.is_remote() { self.remote } else { self.built_in(motor.angle_at(at)) as i32 };
        count.wrapping_add(self.origin)
    }

    /// Returns true if the encoder is on its index.
    pub(super) fn is_on_index(&self, at: Instant, motor: &StepperMotor) -> bool {
        match self.channels {
            [.., index] if self.is_remote() => index == Some(true),
            _ => self.turned(self.built_in(motor.angle_at(at))) == 0,
        }
    }

    /// Count of the built-in encoder at an angle.
    fn built_in(&self, angle: i64) -> i64 {
        ((i128::from(angle) * i128::from(self.counts_per_rev)) >> 32) as i64
    }

    /// Counts from the index below to this count.
    fn turned(&self, count: i64) -> i64 {
        count.checked_rem_euclid(self.counts_per_rev.into()).unwrap_or(0)
    }

    /// Next time at which the built-in encoder reaches or leaves its index; never if that is not before `until`, when
    /// the motion of the shaft changes.
    pub(super) fn index_changes(&self, at: Instant, motor: &StepperMotor, until: Instant) -> Instant {
        let kinematics = motor.kinematics();
        let way = if kinematics.half_speed == 0 {
            kinematics.half_acceleration.signum()
        } else {
            kinematics.half_speed.signum()
        };
        if way == 0 || self.is_remote() {
            return Instant::NEVER;
        }
        let now = self.built_in(motor.angle_at(at));
        let change = match (self.turned(now), way) {
            (0, way) => now + way,
            (turned, 1) => now - turned + i64::from(self.counts_per_rev),
            (turned, _) => now - turned,
        };
        self.passes(at, motor, until, change)
    }

    /// First tick after `at` at which the shaft has reached or passed `count`; never if that is not before `until`.
    fn passes(&self, at: Instant, motor: &StepperMotor, until: Instant, count: i64) -> Instant {
        let now = self.built_in(motor.angle_at(at));
        let is_there = |tick: u64| {
            let here = self.built_in(motor.angle_at(at + Duration::from_ticks(tick)));
            if count > now { here >= count } else { here <= count }
        };
        let (mut first, mut last) = (1, until.since(at).ticks());
        if count == now || !is_there(last) {
            return Instant::NEVER;
        }
        while first < last {
            let middle = first + (last - first) / 2;
            if is_there(middle) { last = middle } else { first = middle + 1 }
        }
        at + Duration::from_ticks(first)
    }

    /// Next time at which [`Self::count`] gives `count`, if the built-in encoder counts; never if that is not before
    /// `until`, when the motion of the shaft changes, or if a remote encoder counts.
    pub(super) fn reaches(&self, at: Instant, motor: &StepperMotor, until: Instant, count: i32) -> Instant {
        let kinematics = motor.kinematics();
        if self.is_remote() || kinematics.half_speed == 0 && kinematics.half_acceleration == 0 {
            return Instant::NEVER;
        }
        let way = count.wrapping_sub(self.count(at, motor));
        self.passes(at, motor, until, self.built_in(motor.angle_at(at)) + i64::from(way))
    }

    /// Sets the level of a channel of a remote encoder; `None` if nothing drives the pin any more.
    pub(super) fn channel(
        &mut self,
        at: Instant,
        motor: &StepperMotor,
        channel: Channel,
        level: Option<bool>,
    ) {
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

    /// Adds edges of a remote encoder that a board has counted. Its channels A and B have these levels now.
    pub(super) fn take_edges(&mut self, at: Instant, motor: &StepperMotor, edges: i32, [a, b]: [bool; 2]) {
        let [.., index] = self.channels;
        self.connect(at, motor, [Some(a), Some(b), index]);
        self.remote = self.remote.wrapping_add(edges);
    }

    /// Sets the levels of the channels. If the other encoder counts from now on, it continues from the
    /// present count.
    fn connect(&mut self, at: Instant, motor: &StepperMotor, channels: [Option<bool>; 3]) {
        let count = self.count(at, motor);
        self.channels = channels;
        self.origin = self.origin.wrapping_add(count.wrapping_sub(self.count(at, motor)));
    }

    /// Phase of the remote encoder in quarters of a cycle; `None` unless both channels are driven.
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
