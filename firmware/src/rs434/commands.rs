//! What starts and stops the user program, and what of the drive it reaches (6.5, 6.9).

use standin_protocol::registers::{Register, Space};

use super::drive::{Drive, State};
use super::errors::error;
use super::program::vm::{CannotWrite, Step, World};
use super::program::{self, Program, Status};
use super::registers::{Reg, Word};
use crate::device::{Instant, Sink};

impl Drive {
    /// MODE_USER_PROGRAM was written: 3 is only kept.
    pub(super) fn command_program(&mut self, at: Instant, out: &mut dyn Sink) {
        match self.bank.word(Reg::MODE_USER_PROGRAM) {
            1 => self.program.stop(),
            2 => self.start_program(at, Status::StartedByBus, out),
            _ => {}
        }
    }

    /// Starts the program, unless it runs, and remembers the registers that its end may bring back.
    pub(super) fn start_program(&mut self, at: Instant, status: Status, out: &mut dyn Sink) {
        if self.program.status() == Status::Running || self.state != State::Ready {
            return;
        }
        self.refresh(at, Reg::OFFSET);
        self.remembered = self.bank.clone();
        self.errors.clear(error::PROGRAM);
        self.program.start(at, status);
        if self.program.status() == Status::Failed {
            self.program_failed(at, out);
        }
    }

    /// Brings the program from the flash into the buffer.
    pub(super) fn load_program(&mut self, at: Instant, out: &mut dyn Sink) {
        if !self.program.load(out) {
            self.raise(at, error::PROGRAM_TEST, out);
        }
    }

    /// The line of the program that is due, if one is. Whether it did more than to reckon.
    pub(super) fn run_program(&mut self, at: Instant, out: &mut dyn Sink) -> bool {
        let mut reach = Reach { drive: self, at, out, wrote: false };
        match program::run(at, &mut reach) {
            None => return false,
            Some(Step::Next | Step::Delay(_)) => return reach.wrote,
            Some(Step::End) => {}
            Some(Step::FullEnd) => self.program_fully_ended(at, out),
            Some(Step::Error) => self.program_failed(at, out),
        }
        true
    }

    /// CMD_FULL_STOP_PROGRAM: the registers are what they were before the start, and the motor stops.
    fn program_fully_ended(&mut self, at: Instant, out: &mut dyn Sink) {
        let mode = self.bank.word(Reg::MODE_USER_PROGRAM);
        let place = |reg: Reg| Reg::ENTRIES.place(reg.row());
        // 5004h to 5022h, which lie side by side in the bank.
        let (first, end) = (place(Reg::MODE_DEVICE), place(Reg::ERROR));
        let words = self.bank.words_mut().iter_mut().zip(self.remembered.words());
        for (word, before) in words.take(end).skip(first) {
            *word = *before;
        }
        self.bank.set(Reg::MODE_USER_PROGRAM, mode.into());
        self.set_servo(at, out);
        self.brake();
    }

    /// It came to a line that cannot be carried out, or there is none.
    fn program_failed(&mut self, at: Instant, out: &mut dyn Sink) {
        self.raise(at, error::PROGRAM, out);
        self.stop();
    }
}

/// The drive as its program sees it during a line.
struct Reach<'a> {
    drive: &'a mut Drive,
    at: Instant,
    out: &'a mut dyn Sink,
    /// A register of the drive was written.
    wrote: bool,
}

impl Reach<'_> {
    /// What `words` begin with, as the value of a register: a half of one is not judged.
    fn value(&self, word: Word, words: &[u16]) -> Option<i64> {
        let entries = self.drive.model.entries();
        let shape = entries.list.get(word.reg.row())?.shape;
        let whole = word.index() == 0 && words.len() >= usize::from(shape.words());
        whole.then(|| entries.assemble(shape, |n| words.get(n).copied().unwrap_or(0)))
    }
}

impl World for Reach<'_> {
    fn program(&mut self) -> &mut Program {
        &mut self.drive.program
    }

    fn memory(&self) -> &[u8] {
        self.out.memory()
    }

    fn read(&mut self, space: Space, address: u16) -> Option<u16> {
        let word = Word::at(space, address)?;
        if word.is_live() {
            self.drive.refresh(self.at, word.reg);
        }
        self.drive.bank.words().get(word.place).copied()
    }

    fn write(&mut self, space: Space, first: u16, words: &[u16]) -> Result<(), CannotWrite> {
        let mut there = [None; 2];
        for (n, place) in (0..).zip(&mut there).take(words.len()) {
            let word = first.checked_add(n).and_then(|address| Word::at(space, address));
            *place = Some(word.filter(|word| word.is_writable()).ok_or(CannotWrite)?);
        }
        let there = || there.into_iter().flatten();
        self.wrote = true;
        let mut permitted = true;
        for (n, word) in there().enumerate() {
            let Some(value) = self.value(word, words.get(n..).unwrap_or(&[])) else { continue };
            if !self.drive.model.accepts(word.reg, value) {
                self.drive.out_of_range();
                return Ok(());
            }
            permitted &= self.drive.permits(word.reg, value).is_ok();
        }
        if !permitted {
            return Err(CannotWrite);
        }
        for (word, value) in there().zip(words) {
            if let Some(place) = self.drive.bank.words_mut().get_mut(word.place) {
                *place = *value;
            }
        }
        let mut last = None;
        for Word { reg, .. } in there() {
            // Of two words of a register it was written once.
            if last.replace(reg) != Some(reg) {
                self.drive.written(self.at, reg, self.out);
            }
        }
        Ok(())
    }
}
