//! The quadrature counter of J2 pins 9 (index), 10 (A) and 12 (B), sections 7.11 to 7.14.
//!
//! `QuadratureEncoderConfiguration` has, bit for bit, the fields of the quadrature unit in Microchip's
//! dsPIC30F and 33F. Where the guide is silent, the model follows that unit (MD3-33):
//!
//! - The count rises while A leads B, so that A and B pass through 00, 10, 11, 01, 00. x4 counts every edge,
//!   x2 only the edges of A; SWAP exchanges A and B before decoding. Every edge of A or B sets the direction,
//!   even if it is not counted.
//! - Modes 0 and 2 wrap between 0xFFFF and 0. If Enable Index is set, an index event loads 0 while counting
//!   up, and `MaxCount` while counting down. In modes 1 and 3 the count wraps between `MaxCount` and 0, and
//!   an index event clears nothing. A count written above `MaxCount` continues up to 0xFFFF and then 0, or
//!   down to `MaxCount` and further (MD3-35).
//! - An index event occurs when, for the first time in an index pulse, A and B are in the gated state (7.11).
//!   An edge of the index or an edge of A or B can cause the event; an edge of A or B is counted first. In
//!   all modes the event counts the index pulse in the direction of the last edge of A or B. Before the first
//!   such edge the direction is up. A pulse that ends before A and B reach the gated state is not counted.
//! - Edges of one instant are handled in the order of the calls. After the filter, a rising index is handled
//!   after A and B, and a falling index before A and B. So an index that is as wide as one state of A and B
//!   overlaps only that state (MD3-34).
//! - Only edges change a count. A new configuration takes effect on the present levels at the next edge.
//!   While pins 9, 10 and 12 are outputs (7.8), both counters keep their values, but the drive still tracks
//!   levels and direction.
//! - The noise filter delays a new level until the level has lasted three clock periods, for each pin
//!   separately. A shorter level is dropped. If the filter's setting changes while a level is delayed, that
//!   level still takes effect at its old time.

#[cfg(test)]
mod tests;

use crate::counter::{Channel, Filter, a_leads, next_is_a};
use drivetwin_protocol::time::{Duration, Instant, TICKS_PER_SECOND};

/// Bits of QuadratureEncoderConfiguration (7.11); gating is 5:4, the filter's frequency 8:6.
const ENABLE_INDEX: u16 = 1 << 0;
const BY_MAX_COUNT: u16 = 1 << 1;
const X4: u16 = 1 << 2;
const SWAP: u16 = 1 << 3;
const FILTER: u16 = 1 << 9;

/// Quadrature counter of J2 pins 9, 10, 12 (7.11 to 7.14).
#[derive(Clone, Debug)]
pub(super) struct Encoder {
    filter: Filter,
    decoding: Decoding,
    /// Levels of the pins after the filter.
    a: bool,
    b: bool,
    index: bool,
    /// The index is high, and A and B have not been in the gated state since it rose.
    awaiting_gate: bool,
    /// The last edge of A or B was in the direction that counts up, even if that edge was not counted.
    up: bool,
    count: u16,
    index_count: i32,
}

impl Encoder {
    /// State after power-on: both counts are 0, open pins are low. Until `configure` is called, the encoder
    /// only tracks levels.
    pub(super) fn new() -> Self {
        Self {
            filter: Filter::new(),
            decoding: Decoding::new(0, 0, false),
            a: false,
            b: false,
            index: false,
            awaiting_gate: false,
            up: true,
            count: 0,
            index_count: 0,
        }
    }

    /// The drive is ready. A level that the filter still delays was present before, so it causes no edge.
    pub(super) fn flush_filter(&mut self) {
        self.timeout(Instant::NEVER);
    }

    /// Applies these values of `QuadratureEncoderConfiguration` and `QuadratureEncoderMaxCount` from `at` on.
    /// `enabled` is bit 12 of `PinFunctionAndPolarity`, inverted. The counts do not change.
    pub(super) fn configure(&mut self, at: Instant, configuration: u16, max_count: u16, enabled: bool) {
        self.timeout(at);
        self.decoding = Decoding::new(configuration, max_count, enabled);
    }

    /// Sets the level of a pin from `at` on. Edges of one instant are handled in the order of the calls.
    pub(super) fn edge(&mut self, at: Instant, channel: Channel, high: bool) {
        // Asked here because a call at each edge costs more than the question.
        if self.deadline() <= at {
            self.timeout(at);
        }
        let present = match channel {
            Channel::A => self.a,
            Channel::B => self.b,
            Channel::Index => self.index,
        };
        if self.filter.passes(at, channel, high != present, self.decoding.lasting) {
            self.change(channel);
        }
    }

    /// Time at which the first delayed level will pass the filter; [`Instant::NEVER`] if no level is delayed.
    pub(super) fn deadline(&self) -> Instant {
        self.filter.deadline()
    }

    /// Applies the levels that have passed the filter by `at`.
    pub(super) fn timeout(&mut self, at: Instant) {
        // A falling index was high together with the state that A and B leave at the same instant.
        while let Some(channel) = self.filter.take(at, self.index) {
            self.change(channel);
        }
    }

    /// Adds what a hardware counter has seen since the last call: `steps` quarter cycles, positive if A leads
    /// B, and the levels of A and B after them. The effect is the same as of that many edges while the index
    /// keeps its level, but without the filter. If the steps do not lead to the levels `a` and `b`, the
    /// levels are set without counting.
    pub(super) fn add_counts(&mut self, steps: i32, a: bool, b: bool) {
        self.filter.forget_a_and_b();
        let forward = steps > 0;
        let steps = steps.unsigned_abs();
        // A and B pass through every state within one cycle, so a pending index pulse meets the gated state
        // within four edges.
        for _ in 0..steps.min(4) {
            self.change(self.next(forward));
        }
        let rest = steps.saturating_sub(4);
        let (odd, even) = match self.next(forward) {
            Channel::A => (self.decoding.counts_a, self.decoding.counts_b),
            _ => (self.decoding.counts_b, self.decoding.counts_a),
        };
        self.add(rest.div_ceil(2) * u32::from(odd) + rest / 2 * u32::from(even));
        (self.a, self.b) = (a, b);
    }

    /// The value of `QuadratureEncoderCount` (7.14).
    pub(super) fn count(&self) -> u16 {
        self.count
    }

    /// Applies a write of `QuadratureEncoderCount`.
    pub(super) fn set_count(&mut self, count: u16) {
        self.count = count;
    }

    /// The value of `EncoderIndexCount` (7.13); it wraps at 32 bits.
    pub(super) fn index_count(&self) -> i32 {
        self.index_count
    }

    /// Applies a write of `EncoderIndexCount`.
    pub(super) fn set_index_count(&mut self, count: i32) {
        self.index_count = count;
    }

    /// The channel with the next edge if the shaft turns further; `forward` means that A leads B.
    fn next(&self, forward: bool) -> Channel {
        if next_is_a(forward, self.a, self.b) { Channel::A } else { Channel::B }
    }

    /// Inverts the level of a channel after the filter, and counts the edge.
    fn change(&mut self, channel: Channel) {
        match channel {
            Channel::A => {
                self.a = !self.a;
                self.count_edge(a_leads(true, self.a, self.b), self.decoding.counts_a);
            }
            Channel::B => {
                self.b = !self.b;
                self.count_edge(a_leads(false, self.a, self.b), self.decoding.counts_b);
            }
            Channel::Index => {
                self.index = !self.index;
                self.awaiting_gate = self.index;
            }
        }
        if self.awaiting_gate && self.decoding.gate(self.a, self.b) {
            self.index_event();
        }
    }

    /// Handles a quarter cycle; `forward` means that A leads B at the pins.
    fn count_edge(&mut self, forward: bool, counts: bool) {
        self.up = forward != self.decoding.swapped;
        if counts {
            self.count = match (self.up, self.count) {
                (true, count) if count == self.decoding.top => 0,
                (true, count) => count.wrapping_add(1),
                (false, 0) => self.decoding.top,
                (false, count) => count.wrapping_sub(1),
            };
        }
    }

    /// Counts `edges` edges in the direction of the last edge, like that many calls of
    /// [`Encoder::count_edge`] with `counts` set.
    fn add(&mut self, edges: u32) {
        let (count, top) = (u32::from(self.count), u32::from(self.decoding.top));
        let before_wrap = match self.up {
            true if count > top => 0xFFFF - count,
            true => top - count,
            false => count,
        };
        let count = match (edges.checked_sub(before_wrap + 1), self.up) {
            (None, true) => count + edges,
            (None, false) => count - edges,
            (Some(beyond), true) => beyond % (top + 1),
            (Some(beyond), false) => top - beyond % (top + 1),
        };
        self.count = count as u16;
    }

    /// Counts an index pulse at which A and B are in the gated state.
    fn index_event(&mut self) {
        self.awaiting_gate = false;
        self.index_count = self.index_count.wrapping_add(if self.up { 1 } else { -1 });
        if self.decoding.clears {
            self.count = if self.up { 0 } else { self.decoding.max_count };
        }
    }
}

/// Settings from the registers, decoded for fast handling of edges.
#[derive(Clone, Debug)]
struct Decoding {
    enabled: bool,
    x4: bool,
    swapped: bool,
    gating: u16,
    /// Time for which a level must last to pass the filter; zero while the filter is off.
    lasting: Duration,
    /// True if edges of pin A, and edges of pin B, are counted.
    counts_a: bool,
    counts_b: bool,
    /// An index event loads the counter.
    clears: bool,
    max_count: u16,
    /// The greatest count before the counter wraps. Counting up, the next count is 0; counting down, this
    /// count follows 0.
    top: u16,
}

impl Decoding {
    fn new(configuration: u16, max_count: u16, enabled: bool) -> Self {
        let is = |bit| configuration & bit != 0;
        Self {
            enabled,
            x4: is(X4),
            swapped: is(SWAP),
            gating: configuration >> 4 & 3,
            lasting: lasting(configuration),
            counts_a: enabled && (is(X4) || !is(SWAP)),
            counts_b: enabled && (is(X4) || is(SWAP)),
            clears: is(ENABLE_INDEX) && !is(BY_MAX_COUNT),
            max_count,
            top: if is(BY_MAX_COUNT) { max_count } else { 0xFFFF },
        }
    }

    /// Returns true if the index is valid at these levels of the pins (7.11, two tables).
    fn gate(&self, pin_a: bool, pin_b: bool) -> bool {
        let (a, b) = if self.swapped { (pin_b, pin_a) } else { (pin_a, pin_b) };
        self.enabled
            && match (self.x4, self.gating) {
                (true, 0) => !b && !a,
                (true, 1) => !b && a,
                (true, 2) => b && !a,
                (true, _) => b && a,
                (false, 0) => !a,
                (false, 1) => a,
                (false, 2) => !b,
                (false, _) => b,
            }
    }
}

/// Clock frequencies of the noise filter in Hz, in the order of their codes (7.11).
const FILTER_HZ: [u32; 8] =
    [40_000_000, 20_000_000, 10_000_000, 2_500_000, 1_250_000, 625_000, 312_500, 156_250];

/// Three clock periods of the filter, in whole ticks, rounded up; zero if it is disabled (7.11; MD3-40).
fn lasting(configuration: u16) -> Duration {
    if configuration & FILTER == 0 {
        return Duration::ZERO;
    }
    let hz = FILTER_HZ.get(usize::from(configuration >> 6 & 7));
    let ticks = hz.and_then(|hz| (3 * TICKS_PER_SECOND as u32 + hz - 1).checked_div(*hz));
    Duration::from_ticks(ticks.unwrap_or(0).into())
}
