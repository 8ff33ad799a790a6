//! Three Hall sensors, a third of a period apart: what they count, and states that they cannot have.

use crate::device::Instant;
use crate::motor::SETTLE;

/// HU, HV and HW, the highest bit first, forward through a period, as the motor's wheel shows them.
const FORWARD: [u8; 6] = [0b101, 0b100, 0b110, 0b010, 0b011, 0b001];

/// State of an impossible code.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Doubt {
    None,
    /// Present since then.
    Since(Instant),
    /// Present for too long.
    Broken,
}

/// Three Hall sensors.
#[derive(Clone, Debug)]
pub(super) struct Halls {
    /// HU, HV and HW: high unless told otherwise, as their wires rest.
    levels: [bool; 3],
    /// Time of the first level at power-on: the others follow, and are no edges.
    told: Option<Instant>,
    /// The wire of HU is broken.
    cut: bool,
    /// Place in a period of the last possible code.
    place: Option<i8>,
    doubt: Doubt,
    /// Edges, forward less backward.
    count: i64,
}

impl Halls {
    /// State before the first level.
    pub(super) const NEW: Self =
        Self { levels: [true; 3], told: None, cut: false, place: None, doubt: Doubt::None, count: 0 };

    /// A sensor changed, or tells its level. How many counts forward that is.
    pub(super) fn edge(&mut self, at: Instant, sensor: u8, high: bool) -> i8 {
        if let Some(level) = self.levels.get_mut(usize::from(sensor)) {
            *level = high;
        }
        self.told.get_or_insert(at);
        self.read(at)
    }

    /// The wire of HU breaks, and reads high, or is whole again. How many counts forward that is.
    pub(super) fn cut(&mut self, at: Instant, cut: bool) -> i8 {
        if cut == self.cut {
            return 0;
        }
        self.cut = cut;
        self.read(at)
    }

    fn read(&mut self, at: Instant) -> i8 {
        let [u, v, w] = self.levels;
        let state = u8::from(u || self.cut) << 2 | u8::from(v) << 1 | u8::from(w);
        let Some(place) = FORWARD.iter().position(|forward| *forward == state) else {
            if self.doubt == Doubt::None {
                self.doubt = Doubt::Since(at);
            }
            return 0;
        };
        self.doubt = Doubt::None;
        let place = place as i8;
        let before = self.place.replace(place).unwrap_or(place);
        if self.told.is_none_or(|told| at.since(told) <= SETTLE) {
            return 0;
        }
        let made = match (place - before).rem_euclid(6) {
            // Half a period is as far forward as backward.
            3 => 0,
            made @ 0..3 => made,
            made => made - 6,
        };
        self.count = self.count.wrapping_add(made.into());
        made
    }

    /// Time at which an impossible code will have lasted too long; never if there is none, or it has.
    pub(super) fn deadline(&self) -> Instant {
        match self.doubt {
            Doubt::Since(since) => since + SETTLE,
            Doubt::None | Doubt::Broken => Instant::NEVER,
        }
    }

    /// Looks whether it has.
    pub(super) fn settle(&mut self, at: Instant) {
        if self.deadline() <= at {
            self.doubt = Doubt::Broken;
        }
    }

    /// Returns whether they have had an impossible code for too long.
    pub(super) fn are_broken(&self) -> bool {
        self.doubt == Doubt::Broken
    }

    /// Edges, forward less backward.
    pub(super) fn count(&self) -> i64 {
        self.count
    }
}
