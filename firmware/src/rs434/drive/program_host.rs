//! The drive as its user program uses it during a line (6.9).

use core::slice;

use drivetwin_protocol::registers::{Register, Space};

use super::Drive;
use crate::device::{Context, Instant};
use crate::rs434::errors::Error;
use crate::rs434::program::vm::{CannotWrite, Host, Step, join};
use crate::rs434::program::{self, Program};
use crate::rs434::registers::Word;

/// Executes the program line that is due, if there is one. Returns true if it had an effect beyond the
/// registers that it wrote.
pub(in crate::rs434) fn run_program(drive: &mut Drive, at: Instant, out: &mut dyn Context) -> bool {
    match program::run(at, &mut ProgramHost { drive, at, out }) {
        None | Some(Step::Next | Step::Delay(_)) => return false,
        Some(Step::Acted | Step::End) => {}
        Some(Step::FullEnd) => drive.program_fully_ended(at, out),
        Some(Step::Error) => drive.program_failed(at, out),
    }
    true
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
                self.drive.errors.warn(Error::OutOfRange);
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
