//! The program of the user: the buffer through which it comes, the flash in which it lies, and its state (6.6,
//! 6.9).
//!
//! | file | what of it |
//! |---|---|
//! | [`instruction`] | fields of a line, the table of commands |
//! | `vm` | what a line does |

pub mod instruction;
#[cfg(test)]
mod tests;
pub(super) mod vm;

use drivetwin_protocol::modbus::rtu::crc;

use self::vm::{Host, REGISTERS, Step, Vm};
use super::saved::SAVE;
use super::{LINES, SETTINGS};
use crate::device::{Context, Duration, Instant};
use crate::memory::{self, Content, Save};

/// Time of a line; that of a DELAY is longer (RS434-25).
pub(super) const LINE: Duration = Duration::micros(100);

/// Bytes of all lines, which lie behind the settings. Their CRC lies behind them, high byte first.
const BYTES: usize = 4 * LINES;

/// The last bytes of a drive's memory with a program in it: its lines, followed by zeros up to the last one. Of more
/// than [`LINES`] the first ones count.
#[must_use]
pub fn image(lines: impl IntoIterator<Item = u32>) -> [u8; BYTES + 2] {
    let mut image = [0; BYTES + 2];
    if let Some((bytes, sum)) = image.split_last_chunk_mut::<2>() {
        for (bytes, line) in bytes.as_chunks_mut().0.iter_mut().zip(lines) {
            *bytes = line.to_le_bytes();
        }
        *sum = crc(bytes).to_be_bytes();
    }
    image
}

/// State of the program, as STATUS_USER_PROGRAM shows it (6.3).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[repr(u16)]
pub(super) enum Status {
    /// Not run since power-on, or stopped by the bus.
    Stopped = 1,
    /// The bus has started it: its first line comes when a line's time is over.
    StartedByBus = 2,
    /// Power-on has started it, likewise.
    StartedByPower = 3,
    /// Running.
    Running = 4,
    /// Ended at CMD_STOP_PROGRAM.
    Ended = 5,
    /// Ended at CMD_FULL_STOP_PROGRAM.
    FullyEnded = 6,
    /// Ended at a line that cannot be carried out.
    Failed = 7,
}

/// The buffer, the flash and the state of the program.
#[derive(Clone, Debug)]
pub(super) struct Program {
    /// Registers of the program.
    pub(super) vm: Vm,
    status: Status,
    /// Time of the next line.
    line_due: Instant,
    /// Content of the flash, once a save that runs is over.
    flash: Content,
    save: Option<Save>,
    /// AX to JX at the start, to which CMD_FULL_STOP_PROGRAM returns.
    before: [u16; REGISTERS],
    /// Lines, low byte first, as they go into the flash.
    buffer: [[u8; 4]; LINES],
}

impl Program {
    // Where it will be: a copy takes 6 KB of a board's stack.
    #[inline(always)]
    pub(super) fn new() -> Self {
        Self {
            vm: Vm::new(),
            status: Status::Stopped,
            line_due: Instant::NEVER,
            flash: Content::New,
            save: None,
            before: [0; REGISTERS],
            buffer: [[0; 4]; LINES],
        }
    }

    /// Power comes: registers, stacks and the buffer are empty. Whether the flash holds a program, be it that of
    /// a new drive, which ends at once (ERROR bit 7 if not).
    pub(super) fn power_on(&mut self, out: &dyn Context) -> bool {
        // Not by way of `new`, which would need the stack of a board for the buffer.
        self.vm = Vm::new();
        self.buffer.fill([0; 4]);
        (self.status, self.line_due, self.save) = (Status::Stopped, Instant::NEVER, None);
        self.check_flash(out)
    }

    pub(super) fn status(&self) -> Status {
        self.status
    }

    /// Returns whether lines are carried out, or will be.
    pub(super) fn is_running(&self) -> bool {
        matches!(self.status, Status::StartedByBus | Status::StartedByPower | Status::Running)
    }

    /// Starts at line 0; `status` is one of the two started states. Fails at once if the flash is bad. Without effect
    /// while it is [`Status::Running`]. The system registers stay as they are.
    pub(super) fn start(&mut self, at: Instant, status: Status) {
        if self.status == Status::Running {
            return;
        }
        self.vm.rewind();
        self.before = self.vm.registers;
        (self.status, self.line_due) = match self.flash {
            Content::Bad => (Status::Failed, Instant::NEVER),
            Content::New | Content::Good => (status, at + LINE),
        };
    }

    /// The bus stops it; also leaves the state of one that has ended.
    pub(super) fn stop(&mut self) {
        self.end(Status::Stopped);
    }

    /// WRITE_CMD.
    pub(super) fn write_line(&mut self, address: u16, line: u32) {
        if let Some(place) = self.buffer.get_mut(usize::from(address)) {
            *place = line.to_le_bytes();
        }
    }

    /// READ_CMD.
    pub(super) fn read_line(&self, address: u16) -> u32 {
        self.buffer.get(usize::from(address)).map_or(0, |&line| u32::from_le_bytes(line))
    }

    /// Begins to store the buffer in the flash: a CRC that is certainly wrong, the lines, and when the time of a
    /// save is over the right one. Not while lines are carried out.
    pub(super) fn save(&mut self, at: Instant, out: &mut dyn Context) {
        let save = Save::of_bytes(self.buffer.as_flattened(), SETTINGS as u16, at, SAVE, out);
        (self.flash, self.save) = (Content::Good, Some(save));
    }

    /// Ends a save that runs: its time is over, or a restart waits for it.
    pub(super) fn finish_save(&mut self, at: Instant, out: &mut dyn Context) {
        if let Some(save) = self.save.take() {
            save.finish(at, out);
        }
    }

    /// Brings the flash into the buffer; whether it holds a program (ERROR bit 7 if not).
    pub(super) fn load(&mut self, out: &dyn Context) -> bool {
        // The lines of a save that runs are there already.
        if self.save.is_none() {
            self.check_flash(out);
        }
        match self.flash {
            Content::New => self.buffer.fill([0; 4]),
            Content::Good => {
                let lines = out.memory().get(SETTINGS..).unwrap_or(&[]).as_chunks().0;
                for (line, stored) in self.buffer.iter_mut().zip(lines) {
                    *line = *stored;
                }
            }
            Content::Bad => return false,
        }
        true
    }

    /// Time of the next line: see [`run`].
    pub(super) fn line_due(&self) -> Instant {
        self.line_due
    }

    /// End of a save: see [`finish_save`](Self::finish_save).
    pub(super) fn save_due(&self) -> Instant {
        self.save.map_or(Instant::NEVER, Save::due)
    }

    /// Looks at the flash; whether it passes.
    fn check_flash(&mut self, out: &dyn Context) -> bool {
        self.flash = memory::content(out.memory().get(SETTINGS..).unwrap_or(&[]), BYTES / 2);
        self.flash != Content::Bad
    }

    /// Returns whether there was never a save.
    fn is_new(&self) -> bool {
        self.flash == Content::New
    }

    /// No line is carried out any more.
    fn end(&mut self, status: Status) {
        (self.status, self.line_due) = (status, Instant::NEVER);
    }
}

/// Carries out the line that is due, if one is. The drive does the rest: at [`Step::FullEnd`] it restores its registers
/// from before the start and stops the motor, AX to JX are restored here; at [`Step::Error`] it sets ERROR bit 8 and
/// stops the motor.
pub(super) fn run(at: Instant, host: &mut impl Host) -> Option<Step> {
    let program = host.program();
    if program.line_due > at {
        return None;
    }
    // Before the line: it may stop its own program, or restart the drive.
    (program.status, program.line_due) = (Status::Running, at + LINE);
    let step = vm::step(host);
    let program = host.program();
    match step {
        Step::Next | Step::Acted => {}
        Step::Delay(ms) => program.line_due = at + Duration::millis(ms.into()).max(LINE),
        Step::End => program.end(Status::Ended),
        Step::FullEnd => {
            program.end(Status::FullyEnded);
            (program.vm.registers, program.vm.line) = (program.before, 0);
        }
        Step::Error => program.end(Status::Failed),
    }
    Some(step)
}
