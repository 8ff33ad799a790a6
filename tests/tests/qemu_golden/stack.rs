//! Depth of the stack.

use crate::image::Image;
use crate::machine::Machine;

/// The memory below the stack, painted before the start.
pub(crate) struct Stack {
    begin: u32,
    end: u32,
}

impl Stack {
    const PAINT: u8 = 0xA5;
    /// Bytes that must stay free: for an interrupt that might come at the deepest place.
    const SPARE: u32 = 256;

    /// Paints it, before the board starts.
    pub(crate) fn paint(machine: &mut Machine, image: &Image) -> Self {
        let (begin, end) = (image.symbol("_stack_end"), image.symbol("_stack_start"));
        machine.memory().put(begin, &vec![Self::PAINT; (end - begin) as usize]);
        Self { begin, end }
    }

    /// Bytes of the stack that were ever used.
    ///
    /// # Panics
    /// If hardly any are left.
    pub(crate) fn used(&self, machine: &mut Machine) -> u32 {
        let painted = machine.memory().bytes(self.begin, (self.end - self.begin) as usize);
        let untouched = painted.iter().take_while(|byte| **byte == Self::PAINT).count() as u32;
        assert!(untouched >= Self::SPARE, "{untouched} bytes of the stack are left");
        self.end - self.begin - untouched
    }
}
