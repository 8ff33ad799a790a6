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

#[cfg(test)]
mod tests {
    use super::*;

    /// The range of positions is −2147483648 to 2147483647 (RS434-16).
    #[test]
    fn a_position_wraps_at_32_bits() {
        let mut counter = Counter::new(Instant::ZERO);
        let at = Instant::from_ticks(1 << 40);
        counter.count = i64::from(i32::MAX) - 1;
        // Both sensors are known to be high.
        counter.halls = [Some(true); 2];
        let positions = [(true, false), (false, false), (true, true), (false, true)].map(|(a, high)| {
            assert_eq!(counter.edge(at, a, high, 2, true), Ok(Some(true)));
            counter.position()
        });
        assert_eq!(positions, [2_147_483_647, -2_147_483_648, -2_147_483_647, -2_147_483_646]);
    }
}
