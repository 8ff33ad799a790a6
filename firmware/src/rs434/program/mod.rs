//! The program of the user: the buffer through which it comes, the flash in which it lies, and its state (6.6,
//! 6.9).
//!
//! | file | what of it |
//! |---|---|
//! | `instruction` | fields of a line, the table of commands |
//! | `vm` | what a line does |

pub mod instruction;
pub(super) mod vm;

use super::LINES;
use crate::device::{Duration, Instant, Sink};

/// How long a line takes; that of a DELAY is longer.
pub(super) const LINE: Duration = Duration::micros(100);

/// How the program came to its state, as STATUS_USER_PROGRAM says (6.3).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[repr(u16)]
pub(super) enum Status {
    /// It has not run since power-on, or the bus stopped it.
    Stopped = 1,
    /// The bus has started it: its first line comes when a line's time is over.
    StartedByBus = 2,
    /// Power-on has started it, likewise.
    StartedByPower = 3,
    /// It runs.
    Running = 4,
    /// It came to CMD_STOP_PROGRAM.
    Ended = 5,
    /// It came to CMD_FULL_STOP_PROGRAM.
    FullyEnded = 6,
    /// It came to a line that cannot be carried out.
    Failed = 7,
}

/// The buffer, the flash and the state of the program.
#[derive(Clone, Debug)]
pub(super) struct Program {
    /// Lines, low byte first, as they go into the flash.
    buffer: [[u8; 4]; LINES],
    status: Status,
    /// When the next line is carried out, or a save is over.
    due: Instant,
    /// What the program works with.
    pub(super) vm: vm::Vm,
}

impl Program {
    pub(super) fn new() -> Self {
        Self { buffer: [[0; 4]; LINES], status: Status::Stopped, due: Instant::NEVER, vm: vm::Vm::new() }
    }

    /// Power comes: registers, stacks and the buffer are empty. Whether the flash holds a program, be it that of
    /// a new drive, which ends at once (ERROR bit 7 if not).
    pub(super) fn power_on(&mut self, _out: &dyn Sink) -> bool {
        true
    }

    pub(super) fn status(&self) -> Status {
        self.status
    }

    /// Whether lines are carried out, or will be.
    pub(super) fn is_running(&self) -> bool {
        matches!(self.status, Status::StartedByBus | Status::StartedByPower | Status::Running)
    }

    /// Starts at line 0, `status` being one of the two that say so; fails at once where the flash is bad.
    pub(super) fn start(&mut self, at: Instant, status: Status) {
        (self.status, self.due) = (status, at + LINE);
    }

    /// The bus stops it; also leaves the state of one that has ended.
    pub(super) fn stop(&mut self) {
        (self.status, self.due) = (Status::Stopped, Instant::NEVER);
    }

    /// WRITE_CMD.
    pub(super) fn write_line(&mut self, _address: u16, _line: u32) {}

    /// READ_CMD.
    pub(super) fn read_line(&self, _address: u16) -> u32 {
        0
    }

    /// Begins to store the buffer in the flash.
    pub(super) fn save(&mut self, _at: Instant, _out: &mut dyn Sink) {}

    /// Brings the flash into the buffer; whether it holds a program (ERROR bit 7 if not).
    pub(super) fn load(&mut self, _out: &dyn Sink) -> bool {
        true
    }

    /// When the next line is carried out.
    pub(super) fn due(&self) -> Instant {
        self.due
    }
}
