//! Content of the non-volatile memory, apart from programs: variables and flags, set-ups of I/O, global user
//! variables (S, IP, FD).
//!
//! The variables come first, then the global user variables. Each part has a checksum. While a save runs,
//! both parts are invalid. So after a power failure the memory has either the old values or the new ones, or
//! fails its test (error 70).

use drivetwin_protocol::registers::Bank;

use super::mcode::names::{self, Meaning, Names};
use super::mcode::program;
use super::registers::{Model, Reg};
use super::variables::Registers;
use crate::device::{Context, Duration, Instant};
use crate::memory::{self, Content, Save};

/// Size in bytes of the saved variables with their CRC, which are at the start of the memory.
const VARIABLES: usize = memory::bytes(Reg::SAVED_WORDS) as usize;
/// Bytes of one global user variable: two for its name and four for its value.
const GLOBAL: usize = 6;
const GLOBAL_BYTES: usize = GLOBAL * names::MAX;
/// Size in bytes of all global user variables with their CRC. In the memory they follow the saved variables.
const GLOBALS: usize = GLOBAL_BYTES + 2;
/// Offset of the log that stores the program.
pub(super) const PROGRAM: usize = VARIABLES + GLOBALS;
/// Size of the non-volatile memory, in bytes.
pub(super) const MEMORY: usize = PROGRAM + program::BYTES;

/// Time of a save; the manuals do not give it (MDRIVE-12).
pub(super) const SAVE: Duration = Duration::millis(10);

/// The save in progress, if any.
#[derive(Clone, Debug)]
pub(super) struct Saving(Option<Parts>);

#[derive(Clone, Copy, Debug)]
struct Parts {
    variables: Save,
    globals: Save,
}

impl Saving {
    pub(super) const NONE: Self = Self(None);

    /// Begins a save. A save in progress starts again from its beginning.
    pub(super) fn begin(
        &mut self,
        at: Instant,
        registers: &mut Registers,
        names: &Names,
        out: &mut dyn Context,
    ) {
        let mut image = [u8::MAX; GLOBAL_BYTES];
        let globals = names.iter().filter_map(|(name, meaning)| match meaning {
            Meaning::Global(value) => Some((name, value)),
            Meaning::Label(_) | Meaning::Local(_) => None,
        });
        for (target, ([first, second], value)) in image.as_chunks_mut::<GLOBAL>().0.iter_mut().zip(globals) {
            let [a, b, c, d] = value.to_be_bytes();
            *target = [first, second, a, b, c, d];
        }
        // From here until the save ends, the globals fail their test, and so does the whole memory.
        let globals = Save::of_bytes(&image, VARIABLES as u16, at, SAVE, out);
        let mode = registers.get(Reg::CA);
        // The second value of CA is stored in the high byte of CA. Older memories, without a second value,
        // have 0 there.
        registers.set(Reg::CA, mode | registers.get(Reg::CalibrationMethod) << 8);
        let (entries, words) = (registers.model().entries(), registers.words());
        let variables = Save::of_rows::<VARIABLES>(entries, words, at, SAVE, out);
        registers.set(Reg::CA, mode);
        self.0 = Some(Parts { variables, globals });
    }

    /// Resets LK in the memory: "this will clear the program and reset LK to 0" (MC 5-42). Other saved values
    /// stay.
    pub(super) fn save_unlocked(&mut self, at: Instant, model: Model, out: &mut dyn Context) {
        self.finish(at, out);
        if memory::content(out.memory(), Reg::SAVED_WORDS) != Content::Good {
            return;
        }
        let entries = model.entries();
        let mut saved = Bank::<Reg, { Reg::WORDS }>::of(entries);
        memory::load(entries, out.memory(), saved.words_mut());
        if saved.word(Reg::LK) != 0 {
            saved.set(Reg::LK, 0);
            Save::of_rows::<VARIABLES>(entries, saved.words(), at, SAVE, out).finish(at, out);
        }
    }

    /// End of the save in progress.
    pub(super) fn deadline(&self) -> Instant {
        self.0.map_or(Instant::NEVER, |parts| parts.variables.due())
    }

    /// Finishes the save in progress if it is due.
    pub(super) fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        if self.deadline() <= at {
            self.finish(at, out);
        }
    }

    /// Finishes the save in progress, if any.
    pub(super) fn finish(&mut self, at: Instant, out: &mut dyn Context) {
        if let Some(parts) = self.0.take() {
            parts.globals.finish(at, out);
            parts.variables.finish(at, out);
        }
    }
}

/// Loads the global user variables. Returns false if the memory is bad.
pub(super) fn load_globals(names: &mut Names, out: &dyn Context) -> bool {
    *names = Names::new();
    let memory = out.memory().get(VARIABLES..PROGRAM).unwrap_or(&[]);
    let content = memory::content(memory, GLOBAL_BYTES / 2);
    if content == Content::Good {
        for &[first, second, a, b, c, d] in memory.as_chunks::<GLOBAL>().0 {
            if first != u8::MAX {
                let value = Meaning::Global(i32::from_be_bytes([a, b, c, d]));
                let _ = names.add([first, second], value);
            }
        }
    }
    content != Content::Bad
}
