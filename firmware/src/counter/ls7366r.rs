//! LSI/CSI LS7366R: a quadrature counter of up to 32 bits (data sheet of June 2014).
//!
//! What the data sheet leaves open:
//!
//! - A leading B counts up: A and B go 00, 10, 11, 01, 00. x4 counts every edge, x2 those of A, x1 those of A while B
//!   is low. Every edge of A or B sets U/D, whether or not it counts; in non-quadrature mode U/D follows B (QSB-21).
//! - The filter lets in a level that has lasted two of its clocks (t5), in whole ticks: its clock is 24 MHz.
//!   It looks at INDEX/ in the asynchronous mode, too (QSB-20).
//! - INDEX/ acts when it becomes active; in the synchronous mode, when it and A and B both high or both low
//!   come together, so twice a cycle while it stays low. Function 00 acts, too, but on IDX alone (QSB-19).
//! - Only edges act: what a write of MDR0 means for the present levels shows at the next one.
//! - A counter made narrower loses its upper bytes.
//! - S goes with BW and CY.

mod count;
mod spi;
#[cfg(test)]
mod tests;

use self::count::{Count, Cycle, Halt};
use super::{Channel, Filter};
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

/// Bits of MDR0: quadrature 1:0, count mode 3:2, index function 5:4.
mod mdr0 {
    pub(super) const SYNCHRONOUS: u8 = 1 << 6;
    pub(super) const HALF_FILTER_CLOCK: u8 = 1 << 7;
}

/// Bits of MDR1: bytes missing from four 1:0, flags 7:4 as in the status register.
mod mdr1 {
    pub(super) const MISSING_BYTES: u8 = 3;
    pub(super) const DISABLE: u8 = 1 << 2;
    pub(super) const FLAGS: u8 = 0xF0;
}

/// The filter's clock: fCKi in a QSB.
const FILTER_HZ: u64 = 24_000_000;

/// Levels of A and B, as in [`Ls7366r::levels`].
const A: u8 = 2;
const B: u8 = 1;

/// Edges that count up, of the eight: a bit each, of A and then of B, numbered by the levels after it.
const FORWARD: u8 = 0b1001_0110;

/// The counter.
#[derive(Clone, Debug)]
pub struct Ls7366r {
    filter: Filter,
    decoding: Decoding,
    count: Count,
    /// Levels of [`A`] and [`B`] behind the filter.
    levels: u8,
    /// INDEX/ is low.
    index_low: bool,
    /// INDEX/ is low, and A and B are as it wants them.
    gated: bool,
    reversed: bool,
    /// U/D.
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
    /// After power-up: all registers 0, A, B and INDEX/ at these levels.
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

    /// A pin has this level from `at` on, which is not before the last edge. Edges of one instant count in
    /// the order A, B, INDEX/; in non-quadrature mode A and B do in the order of the calls.
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

    /// Quarter cycles from a counter in hardware, positive with A leading B, after which A and B have these
    /// levels. The same as so many edges while INDEX/ keeps its level, but past the filter. Levels to which
    /// the steps do not lead are taken over uncounted.
    pub fn take_steps(&mut self, steps: i32, a: bool, b: bool) {
        self.filter.forget_a_and_b();
        let forward = steps > 0;
        let steps = steps.unsigned_abs();
        // All that whole cycles do besides counting is done once more by the last two.
        let cycles = steps.saturating_sub(8) / 4;
        if !self.reloads() {
            let edges = self.decoding.counts & if forward { FORWARD } else { !FORWARD };
            let clocks = cycles * edges.count_ones();
            let flags = self.count.clocks(clocks, edges & self.decoding.up != 0);
            self.raise(flags);
        }
        for _ in 0..steps - 4 * cycles {
            let even = self.levels == 0 || self.levels == A | B;
            self.change(if even == forward { Channel::A } else { Channel::B });
        }
        self.levels = levels(a, b);
        self.settle();
    }

    /// Time at which an edge that the filter holds back takes effect; [`Instant::NEVER`] if there is none. No edge is
    /// lost if no call comes then.
    #[must_use]
    pub fn deadline(&self) -> Instant {
        self.filter.deadline()
    }

    /// Lets in the edges that have lasted by `at`: before anything is read or written.
    #[inline]
    pub fn timeout(&mut self, at: Instant) {
        while let Some(channel) = self.filter.take(at, false) {
            self.change(channel);
        }
    }

    /// Events since the last call: CY, BW, CMP, IDX of [`status`]. Those that MDR1 selects have pulsed DFLAG/.
    pub fn take_events(&mut self) -> u8 {
        core::mem::take(&mut self.events)
    }

    /// CNTR when the index acted last, before it acted.
    #[must_use]
    pub fn at_index(&self) -> u32 {
        self.at_index
    }

    /// Counts of quadrature go the other way from the next edge on (not in the chip; the QSB has it).
    pub fn set_reversed(&mut self, reversed: bool) {
        self.reversed = reversed;
        self.decoding = Decoding::new(self.mdr0, reversed);
    }

    /// Sets CNT_EN; it is high when nothing is connected.
    pub fn set_enabled(&mut self, enabled: bool) {
        self.count.set_halt(Halt::PIN, !enabled);
    }

    /// MDR0.
    #[must_use]
    pub fn mdr0(&self) -> u8 {
        self.mdr0
    }

    /// A write of MDR0. An edge that was held back comes when it was due.
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

    /// MDR1.
    #[must_use]
    pub fn mdr1(&self) -> u8 {
        self.mdr1
    }

    /// A write of MDR1; a narrower counter loses its upper bytes.
    pub fn set_mdr1(&mut self, value: u8) {
        self.mdr1 = value;
        self.count.set_halt(Halt::MDR1, value & mdr1::DISABLE != 0);
        self.count.set_top(u32::MAX >> (8 * u32::from(value & mdr1::MISSING_BYTES)));
        self.otr &= self.count.top();
    }

    /// DTR.
    #[must_use]
    pub fn dtr(&self) -> u32 {
        self.count.limit()
    }

    /// A write of DTR, cut to the counter's width.
    pub fn set_dtr(&mut self, value: u32) {
        self.count.set_limit(value);
    }

    /// CNTR.
    #[must_use]
    pub fn cntr(&self) -> u32 {
        self.count.value()
    }

    /// OTR.
    #[must_use]
    pub fn otr(&self) -> u32 {
        self.otr
    }

    /// STR.
    #[must_use]
    pub fn status(&self) -> u8 {
        let enabled = if self.count.is_halted() { 0 } else { status::CEN };
        let up = if self.up { status::UP } else { 0 };
        self.latched | enabled | up
    }

    /// DTR to CNTR.
    pub fn load_cntr(&mut self) {
        self.count.load(self.count.limit());
    }

    /// CNTR to OTR.
    pub fn load_otr(&mut self) {
        self.otr = self.count.value();
    }

    /// CNTR becomes 0.
    pub fn clear_cntr(&mut self) {
        self.count.load(0);
    }

    /// The latched bits of STR become 0: all but CEN and U/D.
    pub fn clear_status(&mut self) {
        self.latched = 0;
    }

    /// Returns whether LFLAG/ is low: a flag that MDR1 selects is latched.
    #[must_use]
    pub fn lflag(&self) -> bool {
        self.latched & self.mdr1 & mdr1::FLAGS != 0
    }

    /// Bytes of CNTR, DTR and OTR.
    fn width(&self) -> u8 {
        4 - (self.mdr1 & mdr1::MISSING_BYTES)
    }

    /// The other level of an input takes effect.
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

    /// An edge of A or B, whose edges have the places from `first` on in [`FORWARD`].
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

    /// While A and B turn, the index changes CNTR twice a cycle.
    fn reloads(&self) -> bool {
        self.index_low
            && self.decoding.gate == BOTH_ALIKE
            && matches!(self.decoding.function, Function::LoadCntr | Function::ResetCntr)
    }

    /// Takes over the levels without counting an edge.
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

/// Function of INDEX/ besides setting IDX.
#[derive(Clone, Copy, Debug)]
enum Function {
    None,
    LoadCntr,
    ResetCntr,
    LoadOtr,
}

/// Levels of A and B at which INDEX/ acts, a bit each: in the synchronous mode, and otherwise.
const BOTH_ALIKE: u8 = 0b1001;
const ANY: u8 = 0b1111;

/// Settings of MDR0, made ready for edges.
#[derive(Clone, Debug)]
struct Decoding {
    quadrature: bool,
    /// Edges that count, and edges that count up: bits as in [`FORWARD`].
    counts: u8,
    up: u8,
    gate: u8,
    function: Function,
    /// Time for which levels of A and B must last, and of INDEX/.
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
            // Held back a tick, INDEX/ acts after A and B of the same instant.
            index_lasting: if quadrature { filtered } else { Duration::TICK },
        }
    }
}
