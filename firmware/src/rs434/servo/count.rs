//! Counter of the edges of the Hall sensors.

use crate::counter::a_leads;
use crate::device::Instant;
use crate::motor::SETTLE;

/// An edge to the level that the sensor already had. An edge was missed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct NoEdge;

/// Counter of the edges.
#[derive(Clone, Debug)]
pub(super) struct Counter {
    /// Levels of sensors A and B, as far as known. A sensor that reports no level after power-on is high,
    /// like its open wire.
    halls: [Option<bool>; 2],
    /// Time of power-on.
    since: Instant,
    /// Edges since power-on, forward minus backward.
    count: i64,
    /// The count at which CURRENT_POSITION is 0.
    zero: i64,
}

impl Counter {
    /// State at power-on: no counts, and no known levels.
    pub(super) const fn new(since: Instant) -> Self {
        Self { halls: [None; 2], since, count: 0, zero: 0 }
    }

    /// Handles a change of sensor A (`a`) or B. Returns the direction in which the edge was counted, if it
    /// was counted. With fewer than two `sensors` in use this is the direction in which the motor is or was
    /// driven.
    pub(super) fn edge(
        &mut self,
        at: Instant,
        a: bool,
        high: bool,
        sensors: u16,
        driven_forward: bool,
    ) -> Result<Option<bool>, NoEdge> {
        let [known_a, known_b] = self.halls;
        let known = if a { known_a } else { known_b };
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
            _ => {
                let [level_a, level_b] = self.halls.map(|level| level.unwrap_or(true));
                a_leads(a, level_a, level_b)
            }
        };
        self.count += if forward { 1 } else { -1 };
        Ok(Some(forward))
    }

    /// Counts since power-on.
    pub(super) fn count(&self) -> i64 {
        self.count
    }

    /// Value of CURRENT_POSITION, which wraps.
    pub(super) fn position(&self) -> i32 {
        (self.count - self.zero) as i32
    }

    /// Makes CURRENT_POSITION 0 at the present count.
    pub(super) fn clear_position(&mut self) {
        self.zero = self.count;
    }
}
