//! Three Hall sensors, a third of a period apart: what they count, and states that they cannot have.

use crate::device::Instant;
use crate::motor::SETTLE;

/// HU, HV and HW, the highest bit first, forward through a period, as the motor's wheel shows them.
const FORWARD: [u8; 6] = [0b101, 0b100, 0b110, 0b010, 0b011, 0b001];

/// State of an impossible code.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum InvalidCode {
    None,
    /// Present since then.
    Since(Instant),
    /// Present for too long.
    Broken,
}

/// Three Hall sensors.
#[derive(Clone, Debug)]
pub(super) struct Halls {
    /// HU, HV and HW: high until their first event, like their idle wires.
    levels: [bool; 3],
    /// Time of the first level at power-on: the others follow, and are no edges.
    first_level_at: Option<Instant>,
    /// The wire of HU is broken.
    cut: bool,
    /// Place in a period of the last possible code.
    place: Option<i8>,
    invalid: InvalidCode,
    /// Edges, forward less backward.
    count: i64,
}

impl Halls {
    /// State before the first level.
    pub(super) const NEW: Self = Self {
        levels: [true; 3],
        first_level_at: None,
        cut: false,
        place: None,
        invalid: InvalidCode::None,
        count: 0,
    };

    /// A level of a sensor. Returns the counts forward.
    pub(super) fn edge(&mut self, at: Instant, sensor: u8, high: bool) -> i8 {
        if let Some(level) = self.levels.get_mut(usize::from(sensor)) {
            *level = high;
        }
        self.first_level_at.get_or_insert(at);
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
            if self.invalid == InvalidCode::None {
                self.invalid = InvalidCode::Since(at);
            }
            return 0;
        };
        self.invalid = InvalidCode::None;
        let place = place as i8;
        let before = self.place.replace(place).unwrap_or(place);
        if self.first_level_at.is_none_or(|first_level_at| at.since(first_level_at) <= SETTLE) {
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
        match self.invalid {
            InvalidCode::Since(since) => since + SETTLE,
            InvalidCode::None | InvalidCode::Broken => Instant::NEVER,
        }
    }

    /// Looks whether it has.
    pub(super) fn check_code(&mut self, at: Instant) {
        if self.deadline() <= at {
            self.invalid = InvalidCode::Broken;
        }
    }

    /// Returns whether they have had an impossible code for too long.
    pub(super) fn are_broken(&self) -> bool {
        self.invalid == InvalidCode::Broken
    }

    /// Edges, forward less backward.
    pub(super) fn count(&self) -> i64 {
        self.count
    }
}
