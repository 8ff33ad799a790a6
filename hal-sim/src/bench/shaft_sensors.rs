//! Sensors on the shafts of motors: encoders and switches.
//!
//! At each tick a sensor shows the position of the shaft. Only the next change of each sensor is predicted.

use std::ops::RangeInclusive;

use drivetwin_firmware::device::{Instant, Level, Pin};
use drivetwin_firmware::motor::{Kinematics, Plant};

use super::motors::{Motor, TURN};
use super::{Bench, DriveId, WireOutput};
use crate::signals::pin_waveform::level_of;

/// Range of the cycles of an encoder per revolution.
pub const CYCLES_PER_REV: RangeInclusive<u32> = 1..=100_000;

/// Largest distance of a switch point from the start position of the shaft, in revolutions, in either direction.
pub const FURTHEST_REV: f64 = 10_000_000.0;

/// Range in which a switch is closed: above one position of the shaft and below another, in revolutions from
/// the start position. With a single bound the range has no other end; without bounds the switch is always
/// closed.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Closed {
    /// Lower bound, within ±[`FURTHEST_REV`].
    pub above_rev: Option<f64>,
    /// Upper bound, within ±[`FURTHEST_REV`].
    pub below_rev: Option<f64>,
}

/// Up to three wires of a sensor, with their levels.
pub(super) type WireLevels = [Option<(u32, Level)>; 3];

/// The count within a revolution in which the index is high. A and B are low in this count, because US
/// Digital gates the index of its encoders ("to coincide with the low states of channels A and B ... ¼ of one
/// quadrature cycle wide").
const INDEX: i64 = 2;

/// A sensor on a shaft. Its state is a position index, which increases with the angle.
pub(super) struct Sensor {
    /// Target of the first wire; the sensors of a motor are sorted by it.
    pub(super) key: (String, Pin),
    kind: SensorKind,
    /// Angle of the shaft when the motor was attached.
    began: i64,
    position: i64,
    /// Levels of the wires; `None` before they are set for the first time.
    levels: Option<WireLevels>,
    /// Time of the next change of the position index; `to` is its value after the change.
    next: Instant,
    to: i64,
}

pub(super) enum SensorKind {
    /// An encoder with four counts per cycle.
    Encoder { counts: i64, wires: [Option<u32>; 3] },
    /// A switch, closed at position index 0: from the angle `from` up to the angle `to`. `None` means that
    /// there is no bound.
    Switch { from: Option<i64>, to: Option<i64>, wire: u32 },
}

impl SensorKind {
    /// The position index at an angle.
    fn position(&self, angle: i64) -> i64 {
        match *self {
            Self::Encoder { counts, .. } => {
                let part = angle & 0xFFFF_FFFF;
                // The start position is in the middle of a count, so that rounding causes no edge.
                (angle >> 32) * counts + ((part * counts + (1 << 31)) >> 32)
            }
            Self::Switch { from, .. } if from.is_some_and(|from| angle < from) => -1,
            Self::Switch { to, .. } => i64::from(to.is_some_and(|to| angle >= to)),
        }
    }

    /// Angle at which a count begins, in the forward direction.
    fn count_begins(counts: i64, count: i64) -> i64 {
        let (turn, part) = (count.div_euclid(counts), count.rem_euclid(counts));
        (turn << 32) - ((1 << 31) - (part << 32)).div_euclid(counts)
    }

    /// The next position index with a different output, and the angle at which it begins. Forward, the shaft
    /// has this position index from the angle on; backward, below the angle.
    fn next(&self, position: i64, forward: bool) -> Option<(i64, i64)> {
        match *self {
            Self::Encoder { counts, wires: [None, None, _] } => {
                // Only the index is wired: one count of a revolution differs from all others.
                let count = match ((position - INDEX).rem_euclid(counts), forward) {
                    (0, true) => position + 1,
                    (0, false) => position - 1,
                    (part, true) => position - part + counts,
                    (part, false) => position - part,
                };
                Some((count, Self::count_begins(counts, if forward { count } else { count + 1 })))
            }
            Self::Encoder { counts, .. } if forward => {
                Some((position + 1, Self::count_begins(counts, position + 1)))
            }
            Self::Encoder { counts, .. } => Some((position - 1, Self::count_begins(counts, position))),
            Self::Switch { from, to, .. } => match (position, forward) {
                (-1, true) => from.map(|from| (0, from)),
                (0, true) => to.map(|to| (1, to)),
                (0, false) => from.map(|from| (-1, from)),
                (1, false) => to.map(|to| (0, to)),
                _ => None,
            },
        }
    }

    /// Wires of the sensor, and their levels at a position index.
    fn levels(&self, position: i64) -> WireLevels {
        match *self {
            Self::Encoder { counts, wires: [a, b, index] } => {
                let shows = |wire: Option<u32>, high: bool| wire.map(|wire| (wire, level_of(high)));
                let quarter = position & 3;
                [
                    shows(a, quarter == 0 || quarter == 3),
                    shows(b, quarter <= 1),
                    shows(index, position.rem_euclid(counts) == INDEX),
                ]
            }
            Self::Switch { wire, .. } => {
                [Some((wire, if position == 0 { Level::Low } else { Level::Float })), None, None]
            }
        }
    }
}

impl Sensor {
    /// A sensor whose levels are not set yet, on a shaft that started at `began`.
    pub(super) fn new(key: (String, Pin), kind: SensorKind, began: i64) -> Self {
        Self { key, kind, began, position: 0, levels: None, next: Instant::NEVER, to: 0 }
    }

    /// Predicted time of the next change.
    pub(super) fn next(&self) -> Instant {
        self.next
    }

    /// Predicts the next change from `from` on, for the present motion of the shaft.
    pub(super) fn predict(&mut self, plant: &dyn Plant, kinematics: &Kinematics, from: Instant) {
        if self.levels.is_none() {
            (self.next, self.to) = (from, self.position_at(plant, from));
            return;
        }
        self.next = Instant::NEVER;
        let turn = kinematics.turn as f64;
        let ways = if is_at_rest(kinematics) { [true, false].as_slice() } else { &[forward(kinematics)] };
        for &forward in ways {
            let Some((to, angle)) = self.kind.next(self.position, forward) else { continue };
            let at = crossing(plant, kinematics, turn, angle.wrapping_add(self.began), forward, from);
            if at < Instant::NEVER {
                (self.next, self.to) = (at, to);
                let is_slow = at > from && self.is_slow(kinematics, turn, at);
                if !is_slow && self.is_beyond(plant, at, forward) {
                    self.to = self.position_at(plant, at);
                }
                return;
            }
        }
    }

    /// Returns true if a count of the encoder surely takes more than the tick that ends at `at`. This is computed
    /// faster than [`is_beyond`](Self::is_beyond), and with a margin of a factor of 2.
    fn is_slow(&self, kinematics: &Kinematics, turn: f64, at: Instant) -> bool {
        let SensorKind::Encoder { counts, .. } = self.kind else { return false };
        let acceleration = kinematics.half_acceleration as f64;
        let ticks = at.since(kinematics.since).ticks().cast_signed() as f64;
        let half_speed = kinematics.half_speed as f64 + acceleration * ticks;
        4.0 * (half_speed.abs() + acceleration.abs()) * (counts as f64) < turn
    }

    /// Returns true if the shaft passes another change within the same tick.
    fn is_beyond(&self, plant: &dyn Plant, at: Instant, forward: bool) -> bool {
        let further = self.kind.next(self.to, forward);
        further.is_some_and(|(_, angle)| plant.is_at_least(at, angle.wrapping_add(self.began)) == forward)
    }

    fn position_at(&self, plant: &dyn Plant, at: Instant) -> i64 {
        self.kind.position(plant.angle_at(at).wrapping_sub(self.began))
    }

    /// Applies the predicted change. Returns the wires that change, in the order of their changes. The caller
    /// must then predict the next change. The index pulse lies within its count: it rises after A and B have
    /// changed, and falls before they change.
    pub(super) fn take_change(&mut self) -> WireLevels {
        self.position = self.to;
        let after = self.kind.levels(self.position);
        let before = self.levels.replace(after).unwrap_or_default();
        let mut changes = after;
        for (changes, before) in changes.iter_mut().zip(before) {
            *changes = changes.filter(|_| *changes != before);
        }
        if let [_, _, Some((_, Level::Low))] = changes {
            changes.rotate_right(1);
        }
        changes
    }
}

fn is_at_rest(kinematics: &Kinematics) -> bool {
    kinematics.half_speed == 0 && kinematics.half_acceleration == 0
}

fn forward(kinematics: &Kinematics) -> bool {
    kinematics.half_speed > 0 || (kinematics.half_speed == 0 && kinematics.half_acceleration > 0)
}

/// The first tick from `from` on at which the shaft has reached or passed an angle (forward), or is below it
/// (backward); [`Instant::NEVER`] if the motion changes first. `turn` is that of `kinematics`.
///
/// Floating point gives a first guess, usually exact to the tick. From there a search compares exact
/// positions until the crossing lies between two ticks, so the result is exact.
fn crossing(
    plant: &dyn Plant,
    kinematics: &Kinematics,
    turn: f64,
    angle: i64,
    forward: bool,
    from: Instant,
) -> Instant {
    let there = |tick: u64| plant.is_at_least(Instant::from_ticks(tick), angle) == forward;
    let first = from.ticks();
    let Some(last) = plant.until().ticks().checked_sub(1).filter(|last| *last >= first) else {
        // The motion changes now, and the prediction is repeated then.
        return Instant::NEVER;
    };
    if is_at_rest(kinematics) {
        return if there(first) { from } else { Instant::NEVER };
    }
    let way = angle.wrapping_sub(kinematics.angle) as f64 / TURN * turn;
    let (h, a) = (kinematics.half_speed as f64, kinematics.half_acceleration as f64);
    let root = (h * h + a * way).max(0.0).sqrt();
    // At standstill at the angle this is 0/0, which converts to 0 ticks.
    let ticks = (way / if forward { h + root } else { h - root }).ceil() as u64;
    let guess = kinematics.since.ticks().saturating_add(ticks).clamp(first, last);

    // The crossing lies between `low` and `high`. Steps of doubling size find these two.
    let (mut low, mut high, mut step) = (guess, guess, 1);
    if there(guess) {
        loop {
            if high == first {
                return from;
            }
            low = high.saturating_sub(step).max(first);
            if !there(low) {
                break;
            }
            (high, step) = (low, 2 * step);
        }
    } else {
        loop {
            if low == last {
                return Instant::NEVER;
            }
            high = low.saturating_add(step).min(last);
            if there(high) {
                break;
            }
            (low, step) = (high, step.saturating_mul(2));
        }
    }
    while high - low > 1 {
        let middle = low + (high - low) / 2;
        if there(middle) { high = middle } else { low = middle }
    }
    Instant::from_ticks(high)
}

/// Encoders and switches.
impl Bench {
    /// Adds an encoder to a motor's shaft and wires its channels A and B and its index to input pins.
    /// `cycles_per_rev` is clamped to [`CYCLES_PER_REV`]. The encoder starts in the middle of a count, with A
    /// and B high. A leads B by a quarter of a cycle while the motor turns forward. The index is high in the
    /// third quarter of the first cycle of each revolution, where A and B are low.
    ///
    /// The levels follow the shaft at each tick. If the shaft moves more than one count per tick (100,000
    /// cycles at 2,400 rpm), counts are skipped: the encoder never lags, and each channel has at most one
    /// edge per tick.
    ///
    /// # Panics
    /// If one of the drives has no such pin.
    pub fn encode(&mut self, motor: Motor, cycles_per_rev: u32, to: [Option<(DriveId, Pin)>; 3]) {
        let cycles = cycles_per_rev.clamp(*CYCLES_PER_REV.start(), *CYCLES_PER_REV.end());
        let wires = to.map(|to| to.map(|to| self.end_of_wire(to)));
        if let Some(to) = to.into_iter().flatten().next() {
            self.add_sensor(motor, to, SensorKind::Encoder { counts: 4 * i64::from(cycles), wires });
        }
    }

    /// Wires from Hall sensors, encoders and switches on the shafts of motors.
    pub(super) fn shaft_wires(&self) -> impl Iterator<Item = (WireOutput, u32)> {
        self.motors().zip(&self.motors).flat_map(|(motor, slot)| {
            let halls = slot.halls.iter().map(move |&wire| (WireOutput::Hall(motor), wire));
            halls.chain(slot.sensors.iter().flat_map(move |sensor| {
                let wires = match sensor.kind {
                    SensorKind::Encoder { wires, .. } => wires,
                    SensorKind::Switch { wire, .. } => [Some(wire), None, None],
                };
                let is_switch = matches!(sensor.kind, SensorKind::Switch { .. });
                (0..).zip(wires).filter_map(move |(n, wire)| {
                    let from =
                        if is_switch { WireOutput::Switch(motor) } else { WireOutput::Encoder(motor, n) };
                    Some((from, wire?))
                })
            }))
        })
    }

    /// Adds a switch to a motor's shaft that pulls a pin to ground while it is closed. Bounds are clamped to
    /// ±[`FURTHEST_REV`]; a bound that is NaN is ignored (BENCH-8).
    ///
    /// # Panics
    /// If the drive has no such pin.
    pub fn switch(&mut self, motor: Motor, closed: Closed, to: (DriveId, Pin)) {
        let (wire, pin) = (self.end_of_wire(to), to);
        let angle = |rev: f64| (!rev.is_nan()).then(|| rev.clamp(-FURTHEST_REV, FURTHEST_REV) * TURN);
        // The range does not include the bounds themselves.
        let from = closed.above_rev.and_then(angle).map(|angle| angle.floor() as i64 + 1);
        let to = closed.below_rev.and_then(angle).map(|angle| angle.ceil() as i64);
        // A switch with an empty range is never closed.
        let to = if let (Some(from), Some(to)) = (from, to) { Some(to.max(from)) } else { to };
        self.add_sensor(motor, pin, SensorKind::Switch { from, to, wire });
    }
}
