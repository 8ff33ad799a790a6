//! LSI/CSI LS7366R: a quadrature counter of up to 32 bits (data sheet of June 2014).
//!
//! Where the data sheet is silent, the model behaves as follows:
//!
//! - The count rises while A leads B, so that A and B pass through 00, 10, 11, 01, 00. x4 counts every edge,
//!   x2 the edges of A, x1 the edges of A while B is low. Every edge of A or B sets U/D, even if it is not
//!   counted; in non-quadrature mode U/D follows B (QSB-21).
//! - The filter passes a level that has lasted two periods of its clock (t5), rounded up to whole ticks. The
//!   clock is 24 MHz. INDEX/ is filtered in the asynchronous mode, too (QSB-20).
//! - INDEX/ acts when it becomes active. In the synchronous mode it acts whenever INDEX/ low and A and B both
//!   high or both low come together; this is twice per cycle while INDEX/ stays low. With function 00 INDEX/
//!   only sets IDX (QSB-19).
//! - Only edges act: a write of MDR0 takes effect on the present levels at the next edge.
//! - A counter that is made narrower loses its upper bytes.
//! - BW sets S, CY clears S.

mod count;
mod spi;
#[cfg(test)]
mod tests;

use self::count::{Count, Cycle, Halt};
use super::{Channel, Filter, next_is_a};
use crate::device::{Duration, Instant};
use drivetwin_protocol::time::TICKS_PER_SECOND;
pub use spi::Transmission;

/// Bits of the status register and of [`Ls7366r::take_events`].
pub mod status {
    /// Carry: the counter overflowed.
    pub const CY: u8 = 1 << 7;
    /// Borrow: the counter underflowed.
    pub const BW: u8 = 1 << 6;
    /// The counter equalled DTR.
    pub const CMP: u8 = 1 << 5;
    /// The index acted.
    pub const IDX: u8 = 1 << 4;
    /// Counting is enabled.
    pub const CEN: u8 = 1 << 3;
    /// Power was lost.
    pub const PLS: u8 = 1 << 2;
    /// The last count was up.
    pub const UP: u8 = 1 << 1;
    /// The sign.
    pub const S: u8 = 1 << 0;
}

/// Bits of MDR0: 1:0 quadrature mode, 3:2 count mode, 5:4 index function.
mod mdr0 {
    pub(super) const SYNCHRONOUS: u8 = 1 << 6;
    pub(super) const HALF_FILTER_CLOCK: u8 = 1 << 7;
}

/// Bits of MDR1: 1:0 number of bytes less than four, 7:4 flags as in the status register.
mod mdr1 {
    pub(super) const MISSING_BYTES: u8 = 3;
    pub(super) const DISABLE: u8 = 1 << 2;
    pub(super) const FLAGS: u8 = 0xF0;
}

/// Frequency of the filter's clock: fCKi in a QSB.
const FILTER_HZ: u64 = 24_000_000;

/// Levels of A and B, as in [`Ls7366r::levels`].
const A: u8 = 2;
const B: u8 = 1;

/// Mask of the edges that count up. Bits 0 to 3 are edges of A, bits 4 to 7 edges of B. Among these four bits
/// an edge is numbered by the levels after it.
const FORWARD: u8 = 0b1001_0110;

/// The counter.
#[derive(Clone, Debug)]
pub struct Ls7366r {
    filter: Filter,
    decoding: Decoding,
    count: Count,
    /// Levels of [`A`] and [`B`] after the filter.
    levels: u8,
    /// True while INDEX/ is low.
    index_low: bool,
    /// True while INDEX/ is low and A and B have the levels at which it acts.
    gated: bool,
    reversed: bool,
    /// The bit U/D.
    up: bool,
    /// The latched bits of the status register.
    latched: u8,
    events: u8,
    mdr0: u8,
    mdr1: u8,
    otr: u32,
    at_index: u32,
}

impl Ls7366r {
    /// State after power-up: all registers are 0, and A, B and INDEX/ have these levels.
    #[must_use]
    pub fn new(a: bool, b: bool, index: bool) -> Self {
        let mut counter = Self {
            filter: Filter::new(),
            decoding: Decoding::new(0, false),
            count: Count::new(),
            levels: levels(a, b),
            index_low: !index,
            gated: false,
            reversed: false,
            up: false,
            latched: status::PLS,
            events: 0,
            mdr0: 0,
            mdr1: 0,
            otr: 0,
            at_index: 0,
        };
        counter.settle();
        counter
    }

    /// Sets the level of a pin from `at` on; `at` is not before the last edge. Edges of one instant are
    /// counted in the order A, B, INDEX/, but in non-quadrature mode A and B in the order of the calls.
    #[inline]
    pub fn edge(&mut self, at: Instant, channel: Channel, high: bool) {
        self.timeout(at);
        let (present, lasting) = match channel {
            Channel::A => (self.levels & A != 0, self.decoding.lasting),
            Channel::B => (self.levels & B != 0, self.decoding.lasting),
            Channel::Index => (!self.index_low, self.decoding.index_lasting),
        };
        if self.filter.passes(at, channel, high != present, lasting) {
            self.change(channel);
        }
    }

    /// Adds quarter cycles from a hardware counter, positive if A leads B, and the levels of A and B after
    /// them. The effect is the same as of that many edges while INDEX/ keeps its level, but without the
    /// filter. If the steps do not lead to these levels, the levels are set without counting.
    pub fn take_steps(&mut self, steps: i32, a: bool, b: bool) {
        self.filter.forget_a_and_b();
        let forward = steps > 0;
        let steps = steps.unsigned_abs();
        // Besides the count and its flags, all effects of the whole cycles are repeated by the last two
        // cycles.
        let cycles = steps.saturating_sub(8) / 4;
        if !self.reloads() {
            let edges = self.decoding.counts & if forward { FORWARD } else { !FORWARD };
            let clocks = cycles * edges.count_ones();
            let flags = self.count.clocks(clocks, edges & self.decoding.up != 0);
            self.raise(flags);
        }
        for _ in 0..steps - 4 * cycles {
            let next_is_a = next_is_a(forward, self.levels & A != 0, self.levels & B != 0);
            self.change(if next_is_a { Channel::A } else { Channel::B });
        }
        self.levels = levels(a, b);
        self.settle();
    }

    /// Time at which the first delayed edge takes effect; [`Instant::NEVER`] if no edge is delayed. No edge
    /// is lost if nothing calls the counter at that time.
    #[must_use]
    pub fn deadline(&self) -> Instant {
        self.filter.deadline()
    }

    /// Applies the edges that have passed the filter by `at`. Call it before any read or write.
    #[inline]
    pub fn timeout(&mut self, at: Instant) {
        while let Some(channel) = self.filter.take(at, false) {
            self.change(channel);
        }
    }

    /// Events since the last call: CY, BW, CMP, IDX of [`status`]. The events that MDR1 selects also pulse
    /// DFLAG/.
    pub fn take_events(&mut self) -> u8 {
        core::mem::take(&mut self.events)
    }

    /// The value of CNTR when the index acted last, before its effect.
    #[must_use]
    pub fn at_index(&self) -> u32 {
        self.at_index
    }

    /// Reverses the direction of quadrature counts from the next edge on (not in the chip; the QSB has it).
    pub fn set_reversed(&mut self, reversed: bool) {
        self.reversed = reversed;
        self.decoding = Decoding::new(self.mdr0, reversed);
    }

    /// Sets the level of CNT_EN, which is high when nothing is connected.
    pub fn set_enabled(&mut self, enabled: bool) {
        self.count.set_halt(Halt::PIN, !enabled);
    }

    /// The value of MDR0.
    #[must_use]
    pub fn mdr0(&self) -> u8 {
        self.mdr0
    }

    /// Writes MDR0. A delayed edge still takes effect at its old time.
    pub fn set_mdr0(&mut self, value: u8) {
        self.mdr0 = value;
        self.decoding = Decoding::new(value, self.reversed);
        self.count.set_cycle(match value >> 2 & 3 {
            0 => Cycle::Free,
            1 => Cycle::Single,
            2 => Cycle::Range,
            _ => Cycle::Modulo,
        });
        self.settle();
    }

    /// The value of MDR1.
    #[must_use]
    pub fn mdr1(&self) -> u8 {
        self.mdr1
    }

    /// Writes MDR1. A narrower counter loses its upper bytes.
    pub fn set_mdr1(&mut self, value: u8) {
        self.mdr1 = value;
        self.count.set_halt(Halt::MDR1, value & mdr1::DISABLE != 0);
        self.count.set_top(u32::MAX >> (8 * u32::from(value & mdr1::MISSING_BYTES)));
        self.otr &= self.count.top();
    }

    /// The value of DTR.
    #[must_use]
    pub fn dtr(&self) -> u32 {
        self.count.limit()
    }

    /// Writes DTR, without the bytes beyond the counter's width.
    pub fn set_dtr(&mut self, value: u32) {
        self.count.set_limit(value);
    }

    /// The value of CNTR.
    #[must_use]
    pub fn cntr(&self) -> u32 {
        self.count.value()
    }

    /// The value of OTR.
    #[must_use]
    pub fn otr(&self) -> u32 {
        self.otr
    }

    /// The value of STR.
    #[must_use]
    pub fn status(&self) -> u8 {
        let enabled = if self.count.is_halted() { 0 } else { status::CEN };
        let up = if self.up { status::UP } else { 0 };
        self.latched | enabled | up
    }

    /// Copies DTR to CNTR.
    pub fn load_cntr(&mut self) {
        self.count.load(self.count.limit());
    }

    /// Copies CNTR to OTR.
    pub fn load_otr(&mut self) {
        self.otr = self.count.value();
    }

    /// Sets CNTR to 0.
    pub fn clear_cntr(&mut self) {
        self.count.load(0);
    }

    /// Clears the latched bits of STR: all bits but CEN and U/D.
    pub fn clear_status(&mut self) {
        self.latched = 0;
    }

    /// Returns true if LFLAG/ is low: a flag that MDR1 selects is latched.
    #[must_use]
    pub fn lflag(&self) -> bool {
        self.latched & self.mdr1 & mdr1::FLAGS != 0
    }

    /// Number of bytes in each of CNTR, DTR and OTR.
    fn width(&self) -> u8 {
        4 - (self.mdr1 & mdr1::MISSING_BYTES)
    }

    /// Inverts the level of an input after the filter, and applies the edge.
    #[inline]
    fn change(&mut self, channel: Channel) {
        match channel {
            Channel::A => self.turn(A, 0),
            Channel::B => self.turn(B, 4),
            Channel::Index => self.index_low = !self.index_low,
        }
        let gated = self.gate();
        if gated && !self.gated {
            self.index_acts();
        }
        self.gated = gated;
    }

    /// Handles an edge of A or B. `first` is the number of the channel's first bit in [`FORWARD`].
    #[inline]
    fn turn(&mut self, channel: u8, first: u8) {
        self.levels ^= channel;
        let edge = 1 << (first + self.levels);
        self.up = self.decoding.up & edge != 0;
        if self.decoding.counts & edge != 0 {
            let flags = self.count.clock(self.up);
            if flags != 0 {
                self.raise(flags);
            }
        }
    }

    fn raise(&mut self, flags: u8) {
        if flags & status::CY != 0 {
            self.latched &= !status::S;
        }
        if flags & status::BW != 0 {
            self.latched |= status::S;
        }
        self.latched |= flags;
        self.events |= flags;
    }

    fn index_acts(&mut self) {
        self.at_index = self.count.value();
        match self.decoding.function {
            Function::None => {}
            Function::LoadCntr => self.load_cntr(),
            Function::ResetCntr => self.clear_cntr(),
            Function::LoadOtr => self.load_otr(),
        }
        self.raise(status::IDX);
    }

    fn gate(&self) -> bool {
        self.index_low && self.decoding.gate >> self.levels & 1 != 0
    }

    /// Returns true if the index changes CNTR twice a cycle while A and B turn.
    fn reloads(&self) -> bool {
        self.index_low
            && self.decoding.gate == BOTH_ALIKE
            && matches!(self.decoding.function, Function::LoadCntr | Function::ResetCntr)
    }

    /// Applies the present levels without counting an edge.
    fn settle(&mut self) {
        self.gated = self.gate();
        if !self.decoding.quadrature {
            self.up = self.levels & B != 0;
        }
    }
}

fn levels(a: bool, b: bool) -> u8 {
    u8::from(a) * A + u8::from(b) * B
}

/// Function of INDEX/, besides setting IDX.
#[derive(Clone, Copy, Debug)]
enum Function {
    None,
    LoadCntr,
    ResetCntr,
    LoadOtr,
}

/// Masks of the levels of A and B at which INDEX/ acts. The first one is for the synchronous mode.
const BOTH_ALIKE: u8 = 0b1001;
const ANY: u8 = 0b1111;

/// Settings from MDR0, decoded for fast handling of edges.
#[derive(Clone, Debug)]
struct Decoding {
    quadrature: bool,
    /// Edges that count, and edges that count up, as masks like [`FORWARD`].
    counts: u8,
    up: u8,
    gate: u8,
    function: Function,
    /// Time for which a level must last: of A and B, and of INDEX/.
    lasting: Duration,
    index_lasting: Duration,
}

impl Decoding {
    fn new(mdr0: u8, reversed: bool) -> Self {
        let quadrature = mdr0 & 3 != 0;
        let clocks = if mdr0 & mdr0::HALF_FILTER_CLOCK != 0 { 4 } else { 2 };
        let filtered = Duration::from_ticks((clocks * TICKS_PER_SECOND).div_ceil(FILTER_HZ));
        Self {
            quadrature,
            counts: match mdr0 & 3 {
                0 => 0b0000_1100, // A rises
                1 => 0b0000_0101, // A, while B is low
                2 => 0b0000_1111, // A
                _ => 0b1111_1111, // A and B
            },
            up: match (quadrature, reversed) {
                (false, _) => 0b1010_1010,
                (true, false) => FORWARD,
                (true, true) => !FORWARD,
            },
            gate: if quadrature && mdr0 & mdr0::SYNCHRONOUS != 0 { BOTH_ALIKE } else { ANY },
            function: match mdr0 >> 4 & 3 {
                0 => Function::None,
                1 => Function::LoadCntr,
                2 => Function::ResetCntr,
                _ => Function::LoadOtr,
            },
            lasting: if quadrature { filtered } else { Duration::ZERO },
            // INDEX/ is delayed by a tick, so that it acts after A and B of the same instant.
            index_lasting: if quadrature { filtered } else { Duration::TICK },
        }
    }
}
