//! Depth of the stack, measured by painting its memory.

use crate::image::Image;
use crate::machine::Machine;

/// The memory of the stack, painted before the start.
pub(crate) struct Stack {
    begin: u32,
    end: u32,
}

impl Stack {
    const PAINT: u8 = 0xA5;
    /// Bytes that must stay free for an interrupt at the deepest point.
    const SPARE: u32 = 256;

    /// Paints the memory before the board starts.
    pub(crate) fn paint(machine: &mut Machine, image: &Image) -> Self {
        let (begin, end) = (image.symbol("_stack_end"), image.symbol("_stack_start"));
        machine.memory().put(begin, &vec![Self::PAINT; (end - begin) as usize]);
        Self { begin, end }
    }

    /// Number of bytes of the stack that were used.
    ///
    /// # Panics
    /// If fewer than [`SPARE`](Self::SPARE) bytes are unused.
    pub(crate) fn used(&self, machine: &mut Machine) -> u32 {
        let painted = machine.memory().bytes(self.begin, (self.end - self.begin) as usize);
        let untouched = painted.iter().take_while(|byte| **byte == Self::PAINT).count() as u32;
        assert!(untouched >= Self::SPARE, "{untouched} bytes of the stack are left");
        self.end - self.begin - untouched
    }
}
