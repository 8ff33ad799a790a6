//! A slow LS7366R as the QSB wires it: the data sheet and QSB-17 to QSB-21 in words, one edge at a time.
//! Shares no code with the drive.

/// The order of (A, B) while A leads B, which counts up (data sheet, Figure 7).
const CYCLE: [(bool, bool); 4] = [(false, false), (true, false), (true, true), (false, true)];

/// The counter and the pins before it.
#[derive(Clone, Debug)]
pub(crate) struct Slow {
    pub(crate) a: bool,
    pub(crate) b: bool,
    pub(crate) i: bool,
    pub(crate) cntr: u32,
    pub(crate) dtr: u32,
    pub(crate) mdr0: u8,
    /// Nine bits, the lowest two dead.
    pub(crate) mdr1: u16,
    pub(crate) capture: u32,
    carry: bool,
    borrow: bool,
    compare: bool,
    index: bool,
    sign: bool,
    /// Single-cycle has ended.
    stopped: bool,
    /// The index takes effect.
    gate: bool,
    /// Direction of the last edge, unless a write has made it uncertain.
    up: Option<bool>,
}

impl Slow {
    /// A new QSB with nothing at its inputs: A and B pulled up, I low.
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

    /// A goes to the other level.
    pub(crate) fn toggle_a(&mut self) {
        self.edge(!self.a, self.b);
    }

    /// B goes to the other level.
    pub(crate) fn toggle_b(&mut self) {
        self.edge(self.a, !self.b);
    }

    /// The next edge of an encoder that turns forward, A leading, or back.
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
        // Counted or not, the edge sets the direction (QSB-21).
        self.up = Some(up);
        self.look_at_index();
    }

    fn clock(&mut self, up: bool) {
        let from = self.cntr;
        let to = match (self.mode(), up) {
            // Range-limit refuses.
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

    /// I takes a level.
    pub(crate) fn set_i(&mut self, i: bool) {
        self.i = i;
        self.look_at_index();
    }

    /// Returns whether the index is active, and A and B enable it.
    fn is_gated(&self) -> bool {
        let inverted = self.mdr1 >> 3 & 1 == 1;
        let synchronous = self.mdr0 >> 6 & 1 == 1 && self.quadrature() != 0;
        self.i != inverted && (!synchronous || self.a == self.b)
    }

    /// The index acts once, when its gated level becomes active (QSB-19).
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
                // Masked, or OTR, which cannot be seen.
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
        // A write opens the gate without effect (QSB-19).
        self.gate = self.is_gated();
    }

    pub(crate) fn set_mdr1(&mut self, value: u16) {
        if (value ^ self.mdr1) >> 8 & 1 == 1 {
            self.up = None;
        }
        self.mdr1 = value & 0x1FC;
        // Another polarity is an edge at INDEX/.
        self.look_at_index();
    }

    /// LOAD REG 0.
    pub(crate) fn load(&mut self) {
        self.cntr = self.dtr;
        self.stopped = false;
    }

    /// CLEAR REG 2.
    pub(crate) fn reset(&mut self) {
        self.cntr = 0;
        self.stopped = false;
    }

    /// CLEAR REG 3.
    pub(crate) fn clear_str(&mut self) {
        (self.carry, self.borrow, self.compare, self.index, self.sign) = (false, false, false, false, false);
    }

    /// STR, and which of its bits are beyond doubt.
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
