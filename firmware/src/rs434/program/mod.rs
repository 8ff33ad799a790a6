//! The user program: the buffer for its transfer, the flash that stores it, and its state (6.6, 6.9).
//!
//! | file | contents |
//! |---|---|
//! | [`instruction`] | fields of a line, and the table of commands |
//! | `vm` | execution of a line |

pub mod instruction;
#[cfg(test)]
mod tests;
pub(super) mod vm;

use drivetwin_protocol::modbus::rtu::crc;

use self::vm::{Host, REGISTERS, Step, Vm};
use super::saved::SAVE;
use super::{LINES, SETTINGS};
use crate::device::{Context, Duration, Instant};
use crate::memory::{self, Content, PendingSave, Save};

/// Duration of a line. A DELAY takes longer (RS434-25).
const LINE: Duration = Duration::micros(100);

/// Bytes of all lines. They follow the settings in the flash. After them comes their CRC, high byte first.
const BYTES: usize = 4 * LINES;

/// The end of a drive's memory with a program: the lines, zeros up to the last possible line, and the CRC. Of
/// more than [`LINES`] lines only the first ones are used.
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

/// The lines of the program in the content of a drive's memory, up to the last line that is not 0; none if the memory is
/// erased or bad.
pub fn lines(memory: &[u8]) -> impl Iterator<Item = u32> {
    let image = memory.get(SETTINGS..).and_then(|image| image.split_last_chunk::<2>());
    let bytes =
        image.filter(|(bytes, sum)| crc(bytes).to_be_bytes() == **sum).map_or(&[][..], |(bytes, _)| bytes);
    let lines = bytes.as_chunks().0;
    let used = lines.iter().rposition(|line| *line != [0; 4]).map_or(0, |last| last + 1);
    lines.iter().take(used).copied().map(u32::from_le_bytes)
}

/// State of the program, as read in STATUS_USER_PROGRAM (6.3).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[repr(u16)]
pub(super) enum Status {
    /// Not started since power-on, or stopped by the bus.
    Stopped = 1,
    /// Started by the bus. The first line is executed after the duration of a line.
    StartedByBus = 2,
    /// Started by power-on. The first line is executed after the duration of a line.
    StartedByPower = 3,
    /// Running.
    Running = 4,
    /// Ended at CMD_STOP_PROGRAM.
    Ended = 5,
    /// Ended at CMD_FULL_STOP_PROGRAM.
    FullyEnded = 6,
    /// Ended at a line that cannot be executed.
    Failed = 7,
}

/// The buffer, the flash and the state of the program.
#[derive(Clone, Debug)]
pub(super) struct Program {
    /// Registers and stacks of the program.
    vm: Vm,
    status: Status,
    /// Time of the next line.
    line_due: Instant,
    /// State of the flash after the save in progress, if there is one.
    flash: Content,
    /// The save in progress.
    save: PendingSave,
    /// AX to JX at the start. CMD_FULL_STOP_PROGRAM restores them.
    before: [u16; REGISTERS],
    /// Lines in the form of the flash, low byte first.
    buffer: [[u8; 4]; LINES],
}

impl Program {
    // Inlined, so that the program is built in its final place: a copy takes 6 KB of a board's stack.
    #[inline(always)]
    pub(super) fn new() -> Self {
        Self {
            vm: Vm::new(),
            status: Status::Stopped,
            line_due: Instant::NEVER,
            flash: Content::New,
            save: PendingSave::NONE,
            before: [0; REGISTERS],
            buffer: [[0; 4]; LINES],
        }
    }

    /// Resets registers, stacks and the buffer at power-on. Returns true if the flash holds a program (the
    /// program of a new drive ends at once). If the result is false, the caller sets ERROR bit 7.
    pub(super) fn power_on(&mut self, out: &dyn Context) -> bool {
        // `new` is not used here, because its copy of the buffer would need a board's stack.
        self.vm = Vm::new();
        self.buffer.fill([0; 4]);
        (self.status, self.line_due, self.save) = (Status::Stopped, Instant::NEVER, PendingSave::NONE);
        self.check_flash(out)
    }

    pub(super) fn status(&self) -> Status {
        self.status
    }

    /// Returns true if lines are executed now or will be.
    pub(super) fn is_running(&self) -> bool {
        matches!(self.status, Status::StartedByBus | Status::StartedByPower | Status::Running)
    }

    /// Number of the line that is executed next, if lines are executed.
    pub(super) fn next_line(&self) -> Option<u16> {
        self.is_running().then_some(self.vm.line)
    }

    /// The line in execution: PC_REG.
    pub(super) fn line(&self) -> u16 {
        self.vm.line
    }

    /// Value of a system register, AX to JX, by its number.
    pub(super) fn register(&self, number: usize) -> Option<u16> {
        self.vm.registers.get(number).copied()
    }

    pub(super) fn register_mut(&mut self, number: usize) -> Option<&mut u16> {
        self.vm.registers.get_mut(number)
    }

    /// Starts at line 0. `status` is one of the two started states. Fails at once if the flash is bad. Does
    /// nothing while the status is [`Status::Running`]. The system registers keep their values.
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

    /// Stops the program by order of the bus. A program that has ended also becomes stopped.
    pub(super) fn stop(&mut self) {
        self.end(Status::Stopped);
    }

    /// Executes WRITE_CMD: stores a line in the buffer.
    pub(super) fn write_line(&mut self, address: u16, line: u32) {
        if let Some(place) = self.buffer.get_mut(usize::from(address)) {
            *place = line.to_le_bytes();
        }
    }

    /// Executes READ_CMD: returns a line of the buffer.
    pub(super) fn read_line(&self, address: u16) -> u32 {
        self.buffer.get(usize::from(address)).map_or(0, |&line| u32::from_le_bytes(line))
    }

    /// Starts to store the buffer in the flash: a wrong CRC, the lines, and after the duration of a save the
    /// right CRC. Must not be called while the program runs.
    pub(super) fn save(&mut self, at: Instant, out: &mut dyn Context) {
        let save = Save::of_bytes(self.buffer.as_flattened(), SETTINGS as u16, at, SAVE, out);
        self.save.begin(save);
        self.flash = Content::Good;
    }

    /// Time at which the save in progress is complete.
    pub(super) fn save_due(&self) -> Instant {
        self.save.due()
    }

    /// Finishes a save that is due.
    pub(super) fn save_timeout(&mut self, at: Instant, out: &mut dyn Context) {
        self.save.timeout(at, out);
    }

    /// Finishes the save in progress, before a restart.
    pub(super) fn finish_save(&mut self, at: Instant, out: &mut dyn Context) {
        self.save.finish(at, out);
    }

    /// Copies the flash into the buffer. Returns true if the flash holds a program; otherwise the caller sets
    /// ERROR bit 7.
    pub(super) fn load(&mut self, out: &dyn Context) -> bool {
        // During a save the lines are already in the flash.
        if !self.save.is_running() {
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

    /// Time of the next line, for [`run`].
    pub(super) fn line_due(&self) -> Instant {
        self.line_due
    }

    /// Checks the flash. Returns true if it is not bad.
    fn check_flash(&mut self, out: &dyn Context) -> bool {
        self.flash = memory::content(out.memory().get(SETTINGS..).unwrap_or(&[]), BYTES / 2);
        self.flash != Content::Bad
    }

    /// Returns true if no program was ever saved. Then execution ends at the first line.
    pub(super) fn is_new(&self) -> bool {
        self.flash == Content::New
    }

    /// Ends the execution of lines.
    fn end(&mut self, status: Status) {
        (self.status, self.line_due) = (status, Instant::NEVER);
    }
}

/// Executes the line that is due, if there is one. The drive does the rest. At [`Step::FullEnd`] the drive
/// restores its registers from before the start and stops the motor; AX to JX are restored here. At
/// [`Step::Error`] the drive sets ERROR bit 8 and stops the motor.
pub(super) fn run(at: Instant, host: &mut impl Host) -> Option<Step> {
    let program = host.program();
    if program.line_due > at {
        return None;
    }
    // Status and time are set before the execution, because the line may stop its own program or restart the
    // drive.
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
