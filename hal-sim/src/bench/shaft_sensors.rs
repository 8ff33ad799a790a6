//! Sensors on the shafts of motors: encoders and switches.
//!
//! A sensor shows at each tick where the shaft is. Its next change is predicted, one ahead.

use std::ops::RangeInclusive;

use drivetwin_firmware::device::{Instant, Level, Pin};
use drivetwin_firmware::motor::{Kinematics, Rotor};

use super::motors::{Motor, TURN};
use super::{Bench, DriveId};
use crate::signals::pin_waveform::level_of;

/// Cycles that an encoder may have in a turn.
pub const CYCLES_PER_REV: RangeInclusive<u32> = 1..=100_000;

/// Largest distance of a switch from where its shaft began, in turns, either way.
pub const FURTHEST_REV: f64 = 10_000_000.0;

/// Range in which a switch is closed: above one position of the shaft and below another, in turns from where it began.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Closed {
    /// Above that, within ±[`FURTHEST_REV`].
    pub above_rev: Option<f64>,
    /// And below that, within ±[`FURTHEST_REV`].
    pub below_rev: Option<f64>,
}

/// Wires, and what is on them.
pub(super) type WireLevels = [Option<(u32, Level)>; 3];

/// The count of a turn in which the index is high: A and B are low there, as US Digital gates the index of its
/// encoders ("to coincide with the low states of channels A and B ... ¼ of one quadrature cycle wide").
const INDEX: i64 = 2;

/// A sensor on a shaft. It is at one of many places, in the order of angles.
pub(super) struct Sensor {
    /// Target of its first wire: the order of a motor's sensors.
    pub(super) key: (String, Pin),
    sees: SensorKind,
    /// Angle at which the shaft began.
    began: i64,
    place: i64,
    /// Levels of its wires; `None` before the first.
    shows: Option<WireLevels>,
    /// Time of the next change of place, and that place.
    next: Instant,
    to: i64,
}

pub(super) enum SensorKind {
    /// Counts, four to a cycle.
    Encoder { counts: i64, wires: [Option<u32>; 3] },
    /// Place 0 from one angle on and up to another is where it is closed, if there are such.
    Switch { from: Option<i64>, to: Option<i64>, wire: u32 },
}

impl SensorKind {
    /// The place of an angle.
    fn place(&self, angle: i64) -> i64 {
        match *self {
            Self::Encoder { counts, .. } => {
                let part = angle & 0xFFFF_FFFF;
                // A shaft begins in the middle of a count, where nothing trembles.
                (angle >> 32) * counts + ((part * counts + (1 << 31)) >> 32)
            }
            Self::Switch { from, .. } if from.is_some_and(|from| angle < from) => -1,
            Self::Switch { to, .. } => i64::from(to.is_some_and(|to| angle >= to)),
        }
    }

    /// Angle at which a count begins.
    fn count_begins(counts: i64, count: i64) -> i64 {
        let (turn, part) = (count.div_euclid(counts), count.rem_euclid(counts));
        (turn << 32) - ((1 << 31) - (part << 32)).div_euclid(counts)
    }

    /// The next place to be seen from another one, and the angle from which on, or below which, the shaft is
    /// there.
    fn next(&self, place: i64, forward: bool) -> Option<(i64, i64)> {
        match *self {
            Self::Encoder { counts, wires: [None, None, _] } => {
                // Only the index is seen: one count of a turn, and the others.
                let count = match ((place - INDEX).rem_euclid(counts), forward) {
                    (0, true) => place + 1,
                    (0, false) => place - 1,
                    (part, true) => place - part + counts,
                    (part, false) => place - part,
                };
                Some((count, Self::count_begins(counts, if forward { count } else { count + 1 })))
            }
            Self::Encoder { counts, .. } if forward => {
                Some((place + 1, Self::count_begins(counts, place + 1)))
            }
            Self::Encoder { counts, .. } => Some((place - 1, Self::count_begins(counts, place))),
            Self::Switch { from, to, .. } => match (place, forward) {
                (-1, true) => from.map(|from| (0, from)),
                (0, true) => to.map(|to| (1, to)),
                (0, false) => from.map(|from| (-1, from)),
                (1, false) => to.map(|to| (0, to)),
                _ => None,
            },
        }
    }

    /// Wires of the sensor, and their levels at a place.
    fn shows(&self, place: i64) -> WireLevels {
        match *self {
            Self::Encoder { counts, wires: [a, b, index] } => {
                let shows = |wire: Option<u32>, high: bool| wire.map(|wire| (wire, level_of(high)));
                let quarter = place & 3;
                [
                    shows(a, quarter == 0 || quarter == 3),
                    shows(b, quarter <= 1),
                    shows(index, place.rem_euclid(counts) == INDEX),
                ]
            }
            Self::Switch { wire, .. } => {
                [Some((wire, if place == 0 { Level::Low } else { Level::Float })), None, None]
            }
        }
    }
}

impl Sensor {
    /// A sensor that has shown nothing so far, on a shaft that began at an angle.
    pub(super) fn new(key: (String, Pin), sees: SensorKind, began: i64) -> Self {
        Self { key, sees, began, place: 0, shows: None, next: Instant::NEVER, to: 0 }
    }

    /// Time of the next change, as predicted.
    pub(super) fn next(&self) -> Instant {
        self.next
    }

    /// Foresees what it shows next, from `from` on, at a shaft that turns like that.
    pub(super) fn foresee(&mut self, rotor: &dyn Rotor, pace: &Kinematics, from: Instant) {
        if self.shows.is_none() {
            (self.next, self.to) = (from, self.place_at(rotor, from));
            return;
        }
        self.next = Instant::NEVER;
        let ways = if stands(pace) { [true, false].as_slice() } else { &[forward(pace)] };
        for &forward in ways {
            let Some((to, angle)) = self.sees.next(self.place, forward) else { continue };
            let at = crossing(rotor, pace, angle.wrapping_add(self.began), forward, from);
            if at < Instant::NEVER {
                (self.next, self.to) = (at, to);
                if self.is_beyond(rotor, at, forward) {
                    self.to = self.place_at(rotor, at);
                }
                return;
            }
        }
    }

    /// Returns whether the shaft passes the next place within the same tick.
    fn is_beyond(&self, rotor: &dyn Rotor, at: Instant, forward: bool) -> bool {
        let further = self.sees.next(self.to, forward);
        further.is_some_and(|(_, angle)| rotor.is_at_least(at, angle.wrapping_add(self.began)) == forward)
    }

    fn place_at(&self, rotor: &dyn Rotor, at: Instant) -> i64 {
        self.sees.place(rotor.angle_at(at).wrapping_sub(self.began))
    }

    /// Carries out the predicted change. Returns the wires that change, in the order in which they change; what
    /// comes next is to be foreseen then. An index is inside the count that it marks: it rises after A and B, and falls
    /// before them.
    pub(super) fn seen(&mut self) -> WireLevels {
        self.place = self.to;
        let after = self.sees.shows(self.place);
        let before = self.shows.replace(after).unwrap_or_default();
        let mut news = after;
        for (news, before) in news.iter_mut().zip(before) {
            *news = news.filter(|_| *news != before);
        }
        if let [_, _, Some((_, Level::Low))] = news {
            news.rotate_right(1);
        }
        news
    }
}

fn stands(pace: &Kinematics) -> bool {
    pace.half_speed == 0 && pace.half_acceleration == 0
}

fn forward(pace: &Kinematics) -> bool {
    pace.half_speed > 0 || (pace.half_speed == 0 && pace.half_acceleration > 0)
}

/// The first tick from `from` on, and before the shaft begins to turn otherwise, at which it is at an angle or
/// forward of it, or, going backward, before it.
///
/// Floating point only guesses where to look, as a rule to the tick; the shaft itself tells on which side of the angle
/// it is, and the search goes on from the guess until it is between two ticks. So the result is exact.
fn crossing(rotor: &dyn Rotor, pace: &Kinematics, angle: i64, forward: bool, from: Instant) -> Instant {
    let there = |tick: u64| rotor.is_at_least(Instant::from_ticks(tick), angle) == forward;
    let first = from.ticks();
    let Some(last) = rotor.until().ticks().checked_sub(1).filter(|last| *last >= first) else {
        // It begins to turn otherwise now, and is looked at again then.
        return Instant::NEVER;
    };
    if stands(pace) {
        return if there(first) { from } else { Instant::NEVER };
    }
    let way = angle.wrapping_sub(pace.angle) as f64 / TURN * pace.turn as f64;
    let (h, a) = (pace.half_speed as f64, pace.half_acceleration as f64);
    let root = (h * h + a * way).max(0.0).sqrt();
    // At standstill and at the angle this is 0/0, which becomes no ticks at all.
    let ticks = (way / if forward { h + root } else { h - root }).ceil() as u64;
    let guess = pace.since.ticks().saturating_add(ticks).clamp(first, last);

    // From `low` to `high` it comes there; it is searched for in steps that double.
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
    /// Puts an encoder on a motor's shaft, of so many cycles a turn (within [`CYCLES_PER_REV`]; what is beyond acts as
    /// the limit), and wires its channels A and B and its index. It begins in the middle of a count, with A and B
    /// high; A is a quarter of a cycle before B while the motor turns forward. The index is high in the third quarter
    /// of the first cycle of every turn, where A and B are low.
    ///
    /// At each tick it shows where the shaft is. So where a shaft makes more than a count in a tick (100,000 cycles at
    /// 2,400 rpm are one) counts are left out, as many as it takes: it never lags, and each channel has one edge a tick
    /// at most.
    ///
    /// # Panics
    /// If a pin is not there.
    pub fn encode(&mut self, motor: Motor, cycles_per_rev: u32, to: [Option<(DriveId, Pin)>; 3]) {
        let cycles = cycles_per_rev.clamp(*CYCLES_PER_REV.start(), *CYCLES_PER_REV.end());
        let wires = to.map(|to| to.map(|to| self.end_of_wire(to)));
        if let Some(to) = to.into_iter().flatten().next() {
            self.put_sensor(motor, to, SensorKind::Encoder { counts: 4 * i64::from(cycles), wires });
        }
    }

    /// Puts a switch beside a motor's shaft that pulls a pin to ground while it is closed (BENCH-8). A bound beyond
    /// [`FURTHEST_REV`] acts as that; one that is not a number is none.
    ///
    /// # Panics
    /// If the pin is not there.
    pub fn switch(&mut self, motor: Motor, closed: Closed, to: (DriveId, Pin)) {
        let (wire, pin) = (self.end_of_wire(to), to);
        let angle = |rev: f64| (!rev.is_nan()).then(|| rev.clamp(-FURTHEST_REV, FURTHEST_REV) * TURN);
        // Above and below, and not there.
        let from = closed.above_rev.and_then(angle).map(|angle| angle.floor() as i64 + 1);
        let to = closed.below_rev.and_then(angle).map(|angle| angle.ceil() as i64);
        // One that is never closed is so at no angle.
        let to = if let (Some(from), Some(to)) = (from, to) { Some(to.max(from)) } else { to };
        self.put_sensor(motor, pin, SensorKind::Switch { from, to, wire });
    }
}
