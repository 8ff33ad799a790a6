//! What the edges of the Hall sensors tell: where the motor is, and how fast it turns.

use standin_protocol::time::TICKS_PER_SECOND;

use crate::device::{Duration, Instant};

/// An edge of a Hall sensor to the level that it had: one was missed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct NoEdge;

/// The last edge of a Hall sensor.
#[derive(Clone, Copy, Debug)]
struct Edge {
    at: Instant,
    forward: bool,
    /// Since the one before, if that was in the same direction.
    period: Option<Duration>,
}

/// Counts the edges.
#[derive(Clone, Debug)]
pub(super) struct Counter {
    /// Sensors A and B, as far as they are known.
    halls: [Option<bool>; 2],
    /// Of the present motion.
    last: Option<Edge>,
    /// Edges since power came, forward less backward.
    count: i64,
    /// The count at which CURRENT_POSITION is 0.
    zero: i64,
}

impl Counter {
    /// Nothing counted, nothing known.
    pub(super) const NEW: Self = Self { halls: [None; 2], last: None, count: 0, zero: 0 };

    /// A sensor changed: A, or else B. Which way it was counted, if at all. Of `sensors` in use less than two
    /// do not tell the direction: it is the one that is `driven`, forward or not.
    pub(super) fn edge(
        &mut self,
        at: Instant,
        a: bool,
        high: bool,
        sensors: u16,
        driven: Driven,
    ) -> Result<Option<bool>, NoEdge> {
        let [known_a, known_b] = self.halls;
        let (known, other) = if a { (known_a, known_b) } else { (known_b, known_a) };
        self.halls = if a { [Some(high), known_b] } else { [known_a, Some(high)] };
        if known == Some(high) {
            return Err(NoEdge);
        }
        // The first that is heard of a sensor is what it shows when power comes, unless the motor is driven.
        if known.is_none() && !driven.now {
            return Ok(None);
        }
        let forward = match (sensors, other) {
            (0, _) => return Ok(None),
            (1, _) if !a => return Ok(None),
            (2.., Some(other)) => (high == other) != a,
            _ => driven.forward,
        };
        self.count += if forward { 1 } else { -1 };
        let before = self.last.filter(|last| last.forward == forward);
        self.last = Some(Edge { at, forward, period: before.map(|before| at.since(before.at)) });
        Ok(Some(forward))
    }

    /// The next edge begins another motion.
    pub(super) fn forget_speed(&mut self) {
        self.last = None;
    }

    /// Counts since power came.
    pub(super) fn count(&self) -> i64 {
        self.count
    }

    /// CURRENT_POSITION, which wraps.
    pub(super) fn position(&self) -> i32 {
        (self.count - self.zero) as i32
    }

    /// CURRENT_POSITION is 0 here.
    pub(super) fn clear_position(&mut self) {
        self.zero = self.count;
    }

    /// How fast it turns, in rpm, with so many counts in a turn: by the last two edges, and no faster than
    /// would already have brought the next one.
    pub(super) fn rpm(&self, at: Instant, counts: i64) -> u16 {
        let Some(Edge { at: last, period: Some(period), .. }) = self.last else { return 0 };
        let turn = period.max(at.since(last)) * counts.cast_unsigned();
        let half = turn.ticks() / 2;
        let rpm = (60 * TICKS_PER_SECOND + half).checked_div(turn.ticks()).unwrap_or(0);
        rpm.min(u16::MAX.into()) as u16
    }
}

/// What the drive does to the motor.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Driven {
    /// It moves it, or brakes it.
    pub(super) now: bool,
    /// Forward, or was that before.
    pub(super) forward: bool,
}
