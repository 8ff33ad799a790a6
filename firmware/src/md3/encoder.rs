//! The quadrature counter of J2 pins 9 (index), 10 (A) and 12 (B), sections 7.11 to 7.14.
//!
//! QuadratureEncoderConfiguration has, bit for bit, the fields of the quadrature unit in Microchip's
//! dsPIC30F and 33F, so that is what counts where the guide is silent (MD3-33):
//!
//! - A leading B counts up: A and B go 00, 10, 11, 01, 00. x4 counts every edge, x2 those of A; SWAP exchanges the two
//!   before decoding. Every edge of A or B sets the direction, whether or not it counts.
//! - Modes 0 and 2 count through 0xFFFF and 0. An index event loads 0 on the way up and MaxCount on the
//!   way down, if Enable Index is set. In modes 1 and 3 MaxCount is followed by 0 and 0 by MaxCount, and
//!   an index event clears nothing. A count written above MaxCount goes on up to 0xFFFF and then 0, or
//!   down to MaxCount and on (MD3-35).
//! - An index event is the first moment of an index pulse at which A and B are in the gated state (7.11);
//!   it may come with the edge of the index or with one of A or B, which is counted first. It counts index
//!   pulses in all modes, up or down as the last edge of A or B went; before the first one that is up. A
//!   pulse that is over before it met the gate was none.
//! - Edges of one instant are handled in the order of the calls; behind the filter a rising index comes after A and B
//!   and a falling one before them, so that an index as wide as a state of A and B meets that state only (MD3-34).
//! - Only edges do something. What a new configuration makes of the present levels shows with the next
//!   one. While pins 9, 10 and 12 are outputs (7.8), both counters stand still; levels and direction are
//!   followed.
//! - The noise filter holds a new level back until it has lasted three clock periods, each pin for
//!   itself, and forgets it if it does not. A level that is held back while the filter is changed comes
//!   when it was due.

#[cfg(test)]
mod tests;

use crate::counter::{Channel, Filter};
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
    /// Levels of the pins behind the filter.
    a: bool,
    b: bool,
    index: bool,
    /// The index is high, and A and B have not met the gate since it rose.
    awaiting_gate: bool,
    /// The last edge of A or B counted up, or would have.
    up: bool,
    count: u16,
    index_count: i32,
}

impl Encoder {
    /// After power-on: both counts are 0, open pins are low. Until it is configured, it only follows levels.
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

    /// The drive is ready: a level that the filter still holds back was there before, and is no edge.
    pub(super) fn flush_filter(&mut self) {
        self.timeout(Instant::NEVER);
    }

    /// From `at` on it obeys these values of QuadratureEncoderConfiguration and
    /// QuadratureEncoderMaxCount; `enabled` is bit 12 of PinFunctionAndPolarity, inverted. The counts
    /// stay.
    pub(super) fn configure(&mut self, at: Instant, configuration: u16, max_count: u16, enabled: bool) {
        self.timeout(at);
        self.decoding = Decoding::new(configuration, max_count, enabled);
    }

    /// A pin has this level from `at` on. Edges of one instant count in the order of the calls.
    pub(super) fn edge(&mut self, at: Instant, channel: Channel, high: bool) {
        self.timeout(at);
        let present = match channel {
            Channel::A => self.a,
            Channel::B => self.b,
            Channel::Index => self.index,
        };
        if self.filter.passes(at, channel, high != present, self.decoding.lasting) {
            self.change(channel);
        }
    }

    /// Time at which the first level that is held back will have lasted long enough; [`Instant::NEVER`] if none is.
    pub(super) fn deadline(&self) -> Instant {
        self.filter.deadline()
    }

    /// Lets in the levels that have lasted by `at`.
    pub(super) fn timeout(&mut self, at: Instant) {
        // An index that falls was high in the state that A and B leave at that instant.
        while let Some(channel) = self.filter.take(at, self.index) {
            self.change(channel);
        }
    }

    /// Takes what a counter in hardware saw since the last time: `steps` quarter cycles, positive with A leading B,
    /// after which A and B have these levels. The same as so many edges while the index keeps its level, but past the
    /// filter. Levels to which the steps do not lead are taken over uncounted.
    pub(super) fn add_counts(&mut self, steps: i32, a: bool, b: bool) {
        self.filter.forget_a_and_b();
        let forward = steps > 0;
        let steps = steps.unsigned_abs();
        // In one cycle A and B pass every state, so a waiting index pulse meets the gate in four edges.
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

    /// QuadratureEncoderCount (7.14).
    pub(super) fn count(&self) -> u16 {
        self.count
    }

    /// A write of QuadratureEncoderCount.
    pub(super) fn set_count(&mut self, count: u16) {
        self.count = count;
    }

    /// EncoderIndexCount (7.13); it wraps at 32 bits.
    pub(super) fn index_count(&self) -> i32 {
        self.index_count
    }

    /// A write of EncoderIndexCount.
    pub(super) fn set_index_count(&mut self, count: i32) {
        self.index_count = count;
    }

    /// The channel whose edge comes next if the shaft turns on, `forward` with A leading B.
    fn next(&self, forward: bool) -> Channel {
        if (self.a == self.b) == forward { Channel::A } else { Channel::B }
    }

    /// The other level of a channel takes effect.
    fn change(&mut self, channel: Channel) {
        match channel {
            Channel::A => {
                self.a = !self.a;
                self.count_edge(self.a != self.b, self.decoding.counts_a);
            }
            Channel::B => {
                self.b = !self.b;
                self.count_edge(self.a == self.b, self.decoding.counts_b);
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

    /// A quarter cycle, `forward` with A leading B at the pins.
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

    /// `edges` that count, in the direction of the last one: [`Encoder::count_edge`] so many times.
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

    /// The index pulse meets the gate.
    fn index_event(&mut self) {
        self.awaiting_gate = false;
        self.index_count = self.index_count.wrapping_add(if self.up { 1 } else { -1 });
        if self.decoding.clears {
            self.count = if self.up { 0 } else { self.decoding.max_count };
        }
    }
}

/// Settings of the registers, made ready for edges.
#[derive(Clone, Debug)]
struct Decoding {
    enabled: bool,
    x4: bool,
    swapped: bool,
    gating: u16,
    /// Time for which the filter wants a level to last; zero while it is off.
    lasting: Duration,
    /// Edges of pin A and of pin B count.
    counts_a: bool,
    counts_b: bool,
    /// An index event loads the counter.
    clears: bool,
    max_count: u16,
    /// The greatest count: 0 comes after it on the way up, and before it on the way down.
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

    /// Returns whether the index is valid at these levels of the pins (7.11, two tables).
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

/// Clocks of the noise filter, in the order of their codes (7.11).
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
