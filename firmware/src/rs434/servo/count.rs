//! Counts of the edges of the Hall sensors.

use crate::device::Instant;
use crate::motor::SETTLE;

/// An edge of a Hall sensor to the level that it had: one was missed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct NoEdge;

/// Counts the edges.
#[derive(Clone, Debug)]
pub(super) struct Counter {
    /// Sensors A and B, as far as they are known: one that reports no level after power is high, as its wire rests.
    halls: [Option<bool>; 2],
    /// Instant at which power came.
    since: Instant,
    /// Edges since power came, forward less backward.
    count: i64,
    /// The count at which CURRENT_POSITION is 0.
    zero: i64,
}

impl Counter {
    /// Power comes: nothing counted, nothing known.
    pub(super) const fn new(since: Instant) -> Self {
        Self { halls: [None; 2], since, count: 0, zero: 0 }
    }

    /// A sensor changed: A, or else B. Returns the direction in which it was counted, if at all. With less than two
    /// `sensors` in use that is the direction in which the motor is, or was, driven.
    pub(super) fn edge(
        &mut self,
        at: Instant,
        a: bool,
        high: bool,
        sensors: u16,
        driven_forward: bool,
    ) -> Result<Option<bool>, NoEdge> {
        let [known_a, known_b] = self.halls;
        let (known, other) = if a { (known_a, known_b) } else { (known_b, known_a) };
        self.halls = if a { [Some(high), known_b] } else { [known_a, Some(high)] };
        if known == Some(high) {
            return Err(NoEdge);
        }
        if known.is_none() && (high || at.since(self.since) <= SETTLE) {
            return Ok(None);
        }
        let forward = match sensors {
            0 => return Ok(None),
            1 if !a => return Ok(None),
            1 => driven_forward,
            _ => (high == other.unwrap_or(true)) != a,
        };
        self.count += if forward { 1 } else { -1 };
        Ok(Some(forward))
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
}
