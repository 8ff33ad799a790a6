//! Commands to the user program (start, stop), and the access of the program to the drive (6.5, 6.9).

use core::slice;

use drivetwin_protocol::registers::{Register, Space};

use super::drive::{Drive, State};
use super::errors::error;
use super::program::vm::{CannotWrite, Host, Step, join};
use super::program::{self, Program, Status};
use super::reasons::Why;
use super::registers::{Reg, Word};
use crate::device::{Context, Instant};

impl Drive {
    /// Executes a written MODE_USER_PROGRAM. The value 3 is only stored (RS434-26).
    pub(super) fn command_program(&mut self, at: Instant, out: &mut dyn Context) {
        let done = match self.bank.word(Reg::MODE_USER_PROGRAM) {
            1 => {
                self.program.stop();
                Ok(())
            }
            2 => self.start_program(at, Status::StartedByBus, out),
            _ => Err(Why::StartOfProgram),
        };
        if let Err(why) = done {
            why.put(at, out);
        }
    }

    /// Starts the program, unless it already runs. Saves a copy of the registers, which the program's end may
    /// restore.
    ///
    /// # Errors
    /// The reason why no line of a saved program will be executed.
    pub(super) fn start_program(
        &mut self,
        at: Instant,
        status: Status,
        out: &mut dyn Context,
    ) -> Result<(), Why> {
        if self.state != State::Ready {
            return Ok(());
        }
        if self.program.status() == Status::Running {
            return Err(Why::ProgramRuns);
        }
        self.refresh(at, Reg::OFFSET);
        self.snapshot = self.bank.clone();
        self.errors.clear(error::PROGRAM);
        self.program.start(at, status);
        if self.program.status() == Status::Failed {
            self.program_failed(at, out);
            return Err(Why::BadProgram);
        }
        if self.program.is_new() { Err(Why::NoProgram) } else { Ok(()) }
    }

    /// Loads the program from the flash into the buffer.
    pub(super) fn load_program(&mut self, at: Instant, out: &mut dyn Context) {
        if !self.program.load(out) {
            Why::BadProgram.put(at, out);
            self.raise(at, error::PROGRAM_TEST, out);
        }
    }

    /// Executes the program line that is due, if there is one. Returns true if it had an effect beyond the
    /// registers that it wrote.
    pub(super) fn run_program(&mut self, at: Instant, out: &mut dyn Context) -> bool {
        match program::run(at, &mut ProgramHost { drive: self, at, out }) {
            None | Some(Step::Next | Step::Delay(_)) => return false,
            Some(Step::Acted | Step::End) => {}
            Some(Step::FullEnd) => self.program_fully_ended(at, out),
            Some(Step::Error) => self.program_failed(at, out),
        }
        true
    }

    /// Handles CMD_FULL_STOP_PROGRAM: restores the registers from before the start, and stops the motor
    /// (RS434-27).
    fn program_fully_ended(&mut self, at: Instant, out: &mut dyn Context) {
        let mode = self.bank.word(Reg::MODE_USER_PROGRAM);
        let offset = |reg: Reg| Reg::ENTRIES.offset(reg.row());
        // 5004h to 5022h, which are contiguous in the bank.
        let (first, end) = (offset(Reg::MODE_DEVICE), offset(Reg::ERROR));
        let words = self.bank.words_mut().iter_mut().zip(self.snapshot.words());
        for (word, before) in words.take(end).skip(first) {
            *word = *before;
        }
        self.bank.set(Reg::MODE_USER_PROGRAM, mode.into());
        self.set_servo(at, out);
        self.brake();
    }

    /// Handles a program line that cannot be executed, or a missing one (RS434-33).
    fn program_failed(&mut self, at: Instant, out: &mut dyn Context) {
        self.raise(at, error::PROGRAM, out);
        self.stop();
    }
}

/// The drive as the program uses it during a line.
struct ProgramHost<'a> {
    drive: &'a mut Drive,
    at: Instant,
    out: &'a mut dyn Context,
}

impl ProgramHost<'_> {
    /// Writes words of one or two registers, all or none. A single word of a two-word register is not
    /// checked. Returns true if a register has an immediate effect.
    fn write_all(&mut self, spans: &[(Word, &[u16])]) -> Result<bool, CannotWrite> {
        let entries = self.drive.model.entries();
        let mut is_permitted = true;
        for &(Word { reg, .. }, words) in spans {
            let entry = entries.list.get(reg.row()).ok_or(CannotWrite)?;
            if words.len() < usize::from(entry.shape.words()) {
                continue;
            }
            let value = entries.assemble(entry.shape, |n| words.get(n).copied().unwrap_or(0));
            if !entry.accepts(value) {
                self.drive.on_out_of_range();
                return Ok(false);
            }
            is_permitted &= self.drive.validate(reg, value).is_ok();
        }
        if !is_permitted {
            return Err(CannotWrite);
        }
        for &(Word { offset, .. }, words) in spans {
            for (offset, value) in (offset..).zip(words) {
                if let Some(word) = self.drive.bank.words_mut().get_mut(offset) {
                    *word = *value;
                }
            }
        }
        let mut acted = false;
        for &(Word { reg, .. }, _) in spans {
            acted |= self.drive.written(self.at, reg, self.out);
        }
        Ok(acted)
    }
}

impl Host for ProgramHost<'_> {
    fn program(&mut self) -> &mut Program {
        &mut self.drive.program
    }

    fn memory(&self) -> &[u8] {
        self.out.memory()
    }

    #[inline(never)]
    fn read(&mut self, space: Space, first: u16, wide: bool) -> Option<u32> {
        let mut read = |address| {
            let word = Word::at(space, address)?;
            if word.is_live() {
                return Some(word.of(self.drive.read(self.at, word.reg)));
            }
            self.drive.bank.words().get(word.offset).copied()
        };
        let low = read(first)?;
        let high = if wide { read(first.checked_add(1)?)? } else { 0 };
        Some(join(low, high))
    }

    fn write(&mut self, space: Space, first: u16, words: &[u16]) -> Result<bool, CannotWrite> {
        let at = |address| Word::at(space, address).filter(|word| word.is_writable()).ok_or(CannotWrite);
        let word = at(first)?;
        if let [low, high] = words {
            let next = at(first.checked_add(1).ok_or(CannotWrite)?)?;
            if next.reg != word.reg {
                return self.write_all(&[(word, slice::from_ref(low)), (next, slice::from_ref(high))]);
            }
        }
        self.write_all(&[(word, words)])
    }
}
