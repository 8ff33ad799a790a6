//! Three Hall sensors, a third of a period apart: their count, and impossible codes.

use crate::debounce::Debounce;
use crate::device::Instant;
use crate::motor::SETTLE;

/// Codes of HU, HV and HW, with HU as the highest bit, in the order of a period while the motor turns
/// forward.
const FORWARD: [u8; 6] = [0b101, 0b100, 0b110, 0b010, 0b011, 0b001];

/// Three Hall sensors.
#[derive(Clone, Debug)]
pub(super) struct Halls {
    /// HU, HV and HW: high until their first event, like their idle wires.
    levels: [bool; 3],
    /// Time of the first level after power-on. Levels shortly after it are initial levels and no edges.
    first_level_at: Option<Instant>,
    /// True while the wire of HU is broken.
    cut: bool,
    /// Index in [`FORWARD`] of the last possible code.
    place: Option<i8>,
    /// True if an impossible code, all sensors high or all low, has lasted too long.
    broken: Debounce,
    /// Count of edges: forward edges minus backward edges.
    count: i64,
}

impl Halls {
    /// State before the first level.
    pub(super) const NEW: Self = Self {
        levels: [true; 3],
        first_level_at: None,
        cut: false,
        place: None,
        broken: Debounce::new(false),
        count: 0,
    };

    /// Sets the level of a sensor. Returns the counts made, positive forward.
    pub(super) fn edge(&mut self, at: Instant, sensor: u8, high: bool) -> i8 {
        if let Some(level) = self.levels.get_mut(usize::from(sensor)) {
            *level = high;
        }
        self.first_level_at.get_or_insert(at);
        self.read(at)
    }

    /// Breaks the wire of HU, which then reads high, or repairs it. Returns the counts made, positive
    /// forward.
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
            self.broken.has_lasted(at, true, SETTLE);
            return 0;
        };
        self.broken = Debounce::new(false);
        let place = place as i8;
        let before = self.place.replace(place).unwrap_or(place);
        if self.first_level_at.is_none_or(|first_level_at| at.since(first_level_at) <= SETTLE) {
            return 0;
        }
        let made = match (place - before).rem_euclid(6) {
            // Half a period has no direction.
            3 => 0,
            made @ 0..3 => made,
            made => made - 6,
        };
        self.count = self.count.wrapping_add(made.into());
        made
    }

    /// Time at which an impossible code will have lasted too long; [`Instant::NEVER`] if there is no such
    /// code, or if its time has passed.
    pub(super) fn deadline(&self) -> Instant {
        self.broken.due()
    }

    /// Marks the sensors as broken if an impossible code has lasted too long.
    pub(super) fn check_code(&mut self, at: Instant) {
        self.broken.timeout(at);
    }

    /// Returns true if an impossible code has lasted too long.
    pub(super) fn are_broken(&self) -> bool {
        self.broken.level()
    }

    /// Count of edges: forward edges minus backward edges.
    pub(super) fn count(&self) -> i64 {
        self.count
    }
}
