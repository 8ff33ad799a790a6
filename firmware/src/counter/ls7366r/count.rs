//! CNTR and its counting.

use super::status::{BW, CMP, CY};

/// Behaviour of CNTR at the ends of its range (MDR0 bits 3:2).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Cycle {
    /// Wraps to the other end.
    Free,
    /// As [`Cycle::Free`], but stops after the wrap.
    Single,
    /// Stays between 0 and DTR.
    Range,
    /// Wraps from DTR to 0 while counting up, and from 0 to DTR while counting down.
    Modulo,
}

/// A reason for not counting.
#[derive(Clone, Copy, Debug)]
pub(super) struct Halt(u8);

impl Halt {
    /// CNT_EN is low.
    pub(super) const PIN: Self = Self(1);
    /// Bit 2 of MDR1 is set.
    pub(super) const MDR1: Self = Self(2);
    /// A single cycle has ended.
    const CYCLE: Self = Self(4);
}

/// CNTR, and the registers that control how it counts. Limits are compared for equality, so a count beyond
/// DTR continues to the end of the counter's range (QSB-18).
#[derive(Clone, Debug)]
pub(super) struct Count {
    /// CNTR.
    value: u32,
    /// DTR.
    limit: u32,
    /// The greatest value of the counter's width.
    top: u32,
    cycle: Cycle,
    /// Bits of all present [`Halt`]s.
    halts: u8,
}

impl Count {
    pub(super) const fn new() -> Self {
        Self { value: 0, limit: 0, top: u32::MAX, cycle: Cycle::Free, halts: 0 }
    }

    pub(super) fn value(&self) -> u32 {
        self.value
    }

    /// Loads or resets CNTR. If a single cycle has ended, counting starts again.
    pub(super) fn load(&mut self, value: u32) {
        self.value = value;
        self.set_halt(Halt::CYCLE, false);
    }

    pub(super) fn limit(&self) -> u32 {
        self.limit
    }

    pub(super) fn set_limit(&mut self, limit: u32) {
        self.limit = limit & self.top;
    }

    pub(super) fn top(&self) -> u32 {
        self.top
    }

    pub(super) fn set_top(&mut self, top: u32) {
        self.top = top;
        self.value &= top;
        self.limit &= top;
    }

    pub(super) fn set_cycle(&mut self, cycle: Cycle) {
        self.cycle = cycle;
        if cycle != Cycle::Single {
            self.set_halt(Halt::CYCLE, false);
        }
    }

    pub(super) fn set_halt(&mut self, halt: Halt, is: bool) {
        self.halts = if is { self.halts | halt.0 } else { self.halts & !halt.0 };
    }

    pub(super) fn is_halted(&self) -> bool {
        self.halts != 0
    }

    /// Counts once, up or down. Returns the flags of this count (figures 8 to 11; QSB-17).
    #[inline]
    pub(super) fn clock(&mut self, up: bool) -> u8 {
        if self.is_halted() {
            0
        } else if up {
            self.up()
        } else {
            self.down()
        }
    }

    #[inline]
    fn up(&mut self) -> u8 {
        let before = self.value;
        self.value = match self.cycle {
            Cycle::Range if before == self.limit => before,
            Cycle::Modulo if before == self.limit => 0,
            _ => before.wrapping_add(1) & self.top,
        };
        let mut flags = if self.value == self.limit { CMP } else { 0 };
        if matches!(self.cycle, Cycle::Free | Cycle::Single) {
            if before == self.top || self.value == self.top {
                flags |= CY;
            }
            if self.cycle == Cycle::Single && before == self.top {
                self.set_halt(Halt::CYCLE, true);
            }
        }
        flags
    }

    #[inline]
    fn down(&mut self) -> u8 {
        let before = self.value;
        self.value = match self.cycle {
            Cycle::Range if before == 0 => before,
            Cycle::Modulo if before == 0 => self.limit,
            _ => before.wrapping_sub(1) & self.top,
        };
        if self.cycle == Cycle::Single && before == 0 {
            self.set_halt(Halt::CYCLE, true);
        }
        if before == 0 || self.value == 0 { BW } else { 0 }
    }

    /// Same as `clocks` calls of [`Count::clock`], in constant time. Returns the flags of all calls.
    pub(super) fn clocks(&mut self, clocks: u32, up: bool) -> u8 {
        if self.is_halted() || clocks == 0 {
            0
        } else if up {
            self.many_up(clocks)
        } else {
            self.many_down(clocks)
        }
    }

    fn many_up(&mut self, clocks: u32) -> u8 {
        let to_top = self.top - self.value;
        let to_limit = self.limit.wrapping_sub(self.value) & self.top;
        match self.cycle {
            Cycle::Free | Cycle::Single => {
                let over = self.cycle == Cycle::Single && clocks > to_top;
                let clocks = if over { to_top + 1 } else { clocks };
                self.set_halt(Halt::CYCLE, over);
                self.value = self.value.wrapping_add(clocks) & self.top;
                let carries = clocks >= to_top;
                // If CNTR equals DTR, the next match is the whole range of the counter away.
                let compares = clocks > to_limit.wrapping_sub(1) & self.top;
                (if carries { CY } else { 0 }) | (if compares { CMP } else { 0 })
            }
            Cycle::Range => {
                self.value = self.value.wrapping_add(clocks.min(to_limit)) & self.top;
                if clocks >= to_limit { CMP } else { 0 }
            }
            Cycle::Modulo => match clocks.checked_sub(to_limit) {
                None => {
                    self.value = self.value.wrapping_add(clocks) & self.top;
                    0
                }
                Some(0) => {
                    self.value = self.limit;
                    CMP
                }
                Some(beyond) => {
                    let from_0 = beyond - 1;
                    self.value = self.modulo(from_0);
                    if to_limit > 0 || from_0 >= self.limit { CMP } else { 0 }
                }
            },
        }
    }

    fn many_down(&mut self, clocks: u32) -> u8 {
        let flags = if clocks >= self.value { BW } else { 0 };
        self.value = match (self.cycle, clocks.checked_sub(self.value)) {
            (Cycle::Range, Some(_)) => 0,
            (Cycle::Single, Some(beyond)) if beyond > 0 => {
                self.set_halt(Halt::CYCLE, true);
                self.top
            }
            (Cycle::Modulo, Some(beyond)) if beyond > 0 => self.limit - self.modulo(beyond - 1),
            _ => self.value.wrapping_sub(clocks) & self.top,
        };
        flags
    }

    /// `n` modulo DTR + 1.
    fn modulo(&self, n: u32) -> u32 {
        self.limit.checked_add(1).and_then(|values| n.checked_rem(values)).unwrap_or(n)
    }
}
