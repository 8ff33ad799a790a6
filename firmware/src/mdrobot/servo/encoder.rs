//! An encoder: two channels with a quarter of a cycle between them, A before B while the motor turns forward.

use crate::counter::a_leads;

/// State of an encoder.
#[derive(Clone, Debug)]
pub(super) struct Encoder {
    /// Channels A and B: high until their first event, like their idle wires.
    levels: [bool; 2],
    /// True while the encoder's wires are broken.
    cut: bool,
}

impl Encoder {
    /// State before the first edge.
    pub(super) const NEW: Self = Self { levels: [true; 2], cut: false };

    /// Sets the level of channel A, or else B. If this is an edge, returns true for forward and false for
    /// backward.
    pub(super) fn edge(&mut self, a: bool, high: bool) -> Option<bool> {
        let [was_a, was_b] = self.levels;
        let was = if a { was_a } else { was_b };
        let levels @ [now_a, now_b] = if a { [high, was_b] } else { [was_a, high] };
        self.levels = levels;
        (was != high && !self.cut).then_some(a_leads(a, now_a, now_b))
    }

    /// The levels of channels A and B, even while the wires are broken.
    pub(super) fn levels(&self) -> [bool; 2] {
        self.levels
    }

    /// Breaks the wires, so that edges have no effect, or repairs them.
    pub(super) fn cut(&mut self, cut: bool) {
        self.cut = cut;
    }
}
