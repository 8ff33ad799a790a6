//! LSI/CSI LS7366R: a quadrature counter of up to 32 bits (data sheet of June 2014).

use crate::device::Instant;

/// Bits of the status register, and of what [`Ls7366r::take_events`] tells.
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

/// An input of the counter.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Channel {
    /// Pin A.
    A,
    /// Pin B.
    B,
    /// Pin INDEX/, active low.
    Index,
}

/// The counter.
#[derive(Clone, Debug)]
pub struct Ls7366r {}

#[expect(unused_variables, reason = "a sketch")]
#[allow(
    missing_docs,
    clippy::must_use_candidate,
    clippy::unused_self,
    clippy::needless_pass_by_ref_mut,
    reason = "a sketch"
)]
impl Ls7366r {
    /// After power-up: all registers 0, A, B and INDEX/ at these levels.
    pub fn new(a: bool, b: bool, index: bool) -> Self {
        Self {}
    }

    /// A pin has this level from `at` on. Edges of one instant count in the order A, B, INDEX/.
    pub fn edge(&mut self, at: Instant, channel: Channel, high: bool) {}

    /// Quarter cycles from a counter in hardware, positive with A leading B, after which A and B have these levels.
    pub fn take_steps(&mut self, steps: i32, a: bool, b: bool) {}

    /// When an edge that the filter holds back will take effect; nothing is lost if nobody comes then.
    pub fn deadline(&self) -> Instant {
        Instant::NEVER
    }

    /// Lets in the edges that have lasted by `at`: before anything is read or written.
    pub fn timeout(&mut self, at: Instant) {}

    /// What has happened since the last call: CY, BW, CMP, IDX of [`status`].
    pub fn take_events(&mut self) -> u8 {
        0
    }

    /// CNTR when the index acted last, before it acted.
    pub fn at_index(&self) -> u32 {
        0
    }

    /// Counts of quadrature go the other way (not in the chip; the QSB has it).
    pub fn set_reversed(&mut self, reversed: bool) {}
    /// CNT_EN.
    pub fn set_enabled(&mut self, enabled: bool) {}

    pub fn mdr0(&self) -> u8 {
        0
    }
    pub fn set_mdr0(&mut self, value: u8) {}
    pub fn mdr1(&self) -> u8 {
        0
    }
    pub fn set_mdr1(&mut self, value: u8) {}
    pub fn dtr(&self) -> u32 {
        0
    }
    pub fn set_dtr(&mut self, value: u32) {}
    pub fn cntr(&self) -> u32 {
        0
    }
    pub fn otr(&self) -> u32 {
        0
    }
    pub fn status(&self) -> u8 {
        0
    }
    /// DTR to CNTR.
    pub fn load_cntr(&mut self) {}
    /// CNTR to OTR.
    pub fn load_otr(&mut self) {}
    pub fn clear_cntr(&mut self) {}
    pub fn clear_status(&mut self) {}
    /// Whether LFLAG/ is low: a flag that MDR1 selects is latched.
    pub fn lflag(&self) -> bool {
        false
    }
}
