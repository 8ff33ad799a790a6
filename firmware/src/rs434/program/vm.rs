//! What a line of the program does (6.9).

use standin_protocol::registers::Space;

/// The system registers, AX to JX.
pub(in crate::rs434) const REGISTERS: usize = 10;

/// What a program works with, besides the drive's registers.
#[derive(Clone, Debug)]
pub(in crate::rs434) struct Vm {
    /// AX, BX … JX.
    pub(in crate::rs434) registers: [u16; REGISTERS],
    /// The line that is being carried out: PC_REG.
    pub(in crate::rs434) line: u16,
}

/// What a program can reach: the drive, with itself in it.
pub(in crate::rs434) trait World {
    /// Its registers and stacks.
    fn vm(&mut self) -> &mut Vm;

    /// A line of the flash; 0 in a new one.
    fn line(&self, address: u16) -> u32;

    /// A register of the bus; `None` if there is none to read.
    fn read(&mut self, space: Space, address: u16) -> Option<u16>;

    /// Writes registers of the bus, as the bus would: one or two. A value out of range is a warning of the drive's
    /// (ERROR bit 13) and no error.
    ///
    /// # Errors
    /// One of them cannot be written; nothing was.
    fn write(&mut self, space: Space, first: u16, words: &[u16]) -> Result<(), NotThere>;
}

/// There is no such register, or it cannot be written.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::rs434) struct NotThere;

/// What follows from a line.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::rs434) enum Step {
    /// The next line, in a line's time.
    Next,
    /// The next line, in so many ms.
    Delay(u16),
    /// CMD_STOP_PROGRAM.
    End,
    /// CMD_FULL_STOP_PROGRAM.
    FullEnd,
    /// It cannot be carried out.
    Error,
}

impl Vm {
    pub(in crate::rs434) fn new() -> Self {
        Self { registers: [0; REGISTERS], line: 0 }
    }
}

/// Carries out the next line.
pub(in crate::rs434) fn step(_world: &mut impl World) -> Step {
    Step::End
}
