//! A slow LS7366R as wired in the QSB. It follows the data sheet and QSB-17 to QSB-21 literally, one edge at
//! a time, and shares no code with the drive.

/// Successive levels of (A, B) while A leads B, which counts up (data sheet, Figure 7).
const CYCLE: [(bool, bool); 4] = [(false, false), (true, false), (true, true), (false, true)];

/// The counter and the levels of its pins.
#[derive(Clone, Debug)]
pub(crate) struct Slow {
    pub(crate) a: bool,
    pub(crate) b: bool,
    pub(crate) i: bool,
    pub(crate) cntr: u32,
    pub(crate) dtr: u32,
    pub(crate) mdr0: u8,
    /// Nine bits. The lowest two have no effect.
    pub(crate) mdr1: u16,
    pub(crate) capture: u32,
    carry: bool,
    borrow: bool,
    compare: bool,
    index: bool,
    sign: bool,
    /// True if single-cycle mode has stopped the counter.
    stopped: bool,
    /// True if the index is active and enabled.
    gate: bool,
    /// Direction of the last edge, or `None` after a write that makes it uncertain.
    up: Option<bool>,
}

impl Slow {
    /// A new QSB with unconnected inputs: A and B are pulled up, I is low.
    pub(crate) fn new() -> Self {
        Self {
            a: true,
            b: true,
            i: false,
            cntr: 0,
            dtr: 499,
            mdr0: 0x4F,
            mdr1: 0,
            capture: 0,
            carry: false,
            borrow: false,
            compare: false,
            index: false,
            sign: false,
            stopped: false,
            gate: false,
            up: Some(true),
        }
    }

    fn quadrature(&self) -> u8 {
        self.mdr0 & 0b11
    }

    fn mode(&self) -> u8 {
        self.mdr0 >> 2 & 0b11
    }

    pub(crate) fn counts(&self) -> bool {
        self.mdr1 & 0b100 == 0 && !self.stopped
    }

    /// Inverts the level of A.
    pub(crate) fn toggle_a(&mut self) {
        self.edge(!self.a, self.b);
    }

    /// Inverts the level of B.
    pub(crate) fn toggle_b(&mut self) {
        self.edge(self.a, !self.b);
    }

    /// Makes the next edge of an encoder that turns forward, with A leading, or backward.
    pub(crate) fn turn(&mut self, forward: bool) {
        let place = self.place(self.a, self.b);
        let (a, b) = CYCLE[(place + if forward { 1 } else { 3 }) % 4];
        self.edge(a, b);
    }

    fn place(&self, a: bool, b: bool) -> usize {
        CYCLE.iter().position(|&pair| pair == (a, b)).expect("all four are there")
    }

    fn edge(&mut self, a: bool, b: bool) {
        let forward = (self.place(self.a, self.b) + 1) % 4 == self.place(a, b);
        let changed = a != self.a;
        let rises = a && !self.a;
        (self.a, self.b) = (a, b);
        let reversed = self.mdr1 >> 8 & 1 == 1;
        let counted = match self.quadrature() {
            0 => rises,
            1 => changed && !b,
            2 => changed,
            _ => true,
        };
        let up = if self.quadrature() == 0 { b } else { forward != reversed };
        if counted && self.counts() {
            self.clock(up);
        }
        // Every edge sets the direction, even one that does not count (QSB-21).
        self.up = Some(up);
        self.look_at_index();
    }

    fn clock(&mut self, up: bool) {
        let from = self.cntr;
        let to = match (self.mode(), up) {
            // Range-limit stops at its limits.
            (2, true) if from == self.dtr => from,
            (2, false) if from == 0 => 0,
            (3, true) if from == self.dtr => 0,
            (3, false) if from == 0 => self.dtr,
            (_, true) => from.wrapping_add(1),
            (_, false) => from.wrapping_sub(1),
        };
        let free_or_single = self.mode() < 2;
        if up && free_or_single && (from == u32::MAX || to == u32::MAX) {
            self.carry = true;
            self.sign = false;
        }
        if !up && (from == 0 || to == 0) {
            self.borrow = true;
            self.sign = true;
        }
        if up && to == self.dtr {
            self.compare = true;
        }
        if self.mode() == 1 && ((up && from == u32::MAX) || (!up && from == 0)) {
            self.stopped = true;
        }
        self.cntr = to;
    }

    /// Sets the level of I.
    pub(crate) fn set_i(&mut self, i: bool) {
        self.i = i;
        self.look_at_index();
    }

    /// Returns true if the index is active, and A and B enable it.
    fn is_gated(&self) -> bool {
        let inverted = self.mdr1 >> 3 & 1 == 1;
        let synchronous = self.mdr0 >> 6 & 1 == 1 && self.quadrature() != 0;
        self.i != inverted && (!synchronous || self.a == self.b)
    }

    /// The index takes effect once, when it becomes active and enabled (QSB-19).
    fn look_at_index(&mut self) {
        let gate = self.is_gated();
        if gate && !self.gate {
            self.index = true;
            if self.mdr1 >> 4 & 1 == 1 {
                self.capture = self.cntr;
            }
            match self.mdr0 >> 4 & 0b11 {
                1 => self.load(),
                2 => self.reset(),
                // Masked, or transferred to OTR, which the bus does not show.
                _ => {}
            }
        }
        self.gate = gate;
    }

    pub(crate) fn set_mdr0(&mut self, value: u8) {
        let before = self.mdr0;
        self.mdr0 = value;
        if value & 0b11 != before & 0b11 {
            self.up = None;
        }
        if self.mode() != 1 {
            self.stopped = false;
        }
        // A write of MDR0 never triggers the index (QSB-19).
        self.gate = self.is_gated();
    }

    pub(crate) fn set_mdr1(&mut self, value: u16) {
        if (value ^ self.mdr1) >> 8 & 1 == 1 {
            self.up = None;
        }
        self.mdr1 = value & 0x1FC;
        // A change of polarity is an edge of INDEX/.
        self.look_at_index();
    }

    /// Command LOAD REG 0: copies DTR to CNTR.
    pub(crate) fn load(&mut self) {
        self.cntr = self.dtr;
        self.stopped = false;
    }

    /// Command CLEAR REG 2: clears CNTR.
    pub(crate) fn reset(&mut self) {
        self.cntr = 0;
        self.stopped = false;
    }

    /// Command CLEAR REG 3: clears the flags of STR.
    pub(crate) fn clear_str(&mut self) {
        (self.carry, self.borrow, self.compare, self.index, self.sign) = (false, false, false, false, false);
    }

    /// STR, and a mask of the bits of STR that the model knows for certain.
    pub(crate) fn str(&self) -> (u32, u32) {
        let up = if self.quadrature() == 0 { Some(self.b) } else { self.up };
        let bits = [
            (7, self.carry),
            (6, self.borrow),
            (5, self.compare),
            (4, self.index),
            (3, self.counts()),
            (1, up == Some(true)),
            (0, self.sign),
        ];
        let value = bits.iter().map(|&(bit, set)| u32::from(set) << bit).sum();
        (value, if up.is_some() { 0xFF } else { 0xFD })
    }
}
