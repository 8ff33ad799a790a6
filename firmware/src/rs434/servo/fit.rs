//! Whether the way that the current tells is the one that the Hall sensors count.
//!
//! How fast the motor turns is for its sensors to say. Where back-EMF and edges come out of step, a count is worth
//! another voltage than was believed.

use fixed::types::I40F24;

use super::seen::ratio;

/// In counts: less is no mistake, but rounding, and a motor that did not speed up evenly between two looks.
const MISTAKE: I40F24 = I40F24::lit("0.0625");
/// In edges: after so many without a mistake it begins anew, or rounding would add up to one.
const MOST: i64 = 32;
/// The bounds of what is learnt at once.
const LEAST_RATIO: I40F24 = I40F24::lit("0.25");
const MOST_RATIO: I40F24 = I40F24::lit("4");

/// Compares way and edges, from one edge on to a later one.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fit {
    /// Which way the edges go.
    forward: bool,
    /// Edges since the last look.
    fresh: i64,
    /// Edges up to it.
    edges: i64,
    /// The way since the edge that it began with.
    way: I40F24,
    /// It did begin with an edge, and the current told all of the way.
    whole: bool,
}

impl Fit {
    /// Nothing compared so far.
    pub(super) const NEW: Self = Self { forward: true, fresh: 0, edges: 0, way: I40F24::ZERO, whole: false };

    /// An edge came. Between two of different directions there is no whole count.
    pub(super) fn edge(&mut self, forward: bool) {
        if forward != self.forward {
            *self = Self { forward, ..Self::NEW };
        }
        self.fresh += 1;
    }

    /// Since the last look it went `before` up to the last edge and `after` from there, if the current `tells`. How
    /// many times the way that was believed it was, if that was a mistake.
    pub(super) fn looked(&mut self, before: I40F24, after: I40F24, tells: bool) -> Option<I40F24> {
        let fresh = core::mem::take(&mut self.fresh);
        (self.whole, self.way, self.edges) = (self.whole && tells, self.way + before, self.edges + fresh);
        let mut learnt = None;
        if fresh > 0 {
            let (edges, way) = (I40F24::from_num(self.edges), self.way.abs());
            if self.whole && (edges - way).abs() > MISTAKE {
                let times = ratio(edges, way);
                learnt = Some(times.clamp(LEAST_RATIO, MOST_RATIO));
            }
            if learnt.is_some() || !self.whole || self.edges >= MOST {
                (self.edges, self.way, self.whole) = (0, I40F24::ZERO, tells && learnt.is_none());
            }
        }
        self.way = self.way.saturating_add(after);
        learnt
    }
}
