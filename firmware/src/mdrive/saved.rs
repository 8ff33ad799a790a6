//! Content of the non-volatile memory, apart from programs: variables and flags, set-ups of I/O, global user
//! variables (S, IP, FD).
//!
//! The variables come first, then the global user variables. Each part has a checksum. While a save runs,
//! both parts are invalid. So after a power failure the memory has either the old values or the new ones, or
//! fails its test (error 70).

use drivetwin_protocol::registers::Bank;

use super::drive::{Drive, Model};
use super::error::Error;
use super::io::Io;
use super::mcode::names::{self, Meaning, Names};
use super::mcode::program;
use super::registers::Reg;
use super::variables::{Registers, entry, is_number, words};
use crate::device::{Context, Duration, Instant, NullContext, PresetError};
use crate::memory::{self, Content, Save};

/// Size in bytes of the saved variables with their CRC, which are at the start of the memory.
pub(super) const VARIABLES: usize = memory::bytes(Reg::SAVED_WORDS) as usize;
/// Bytes of one global user variable: two for its name and four for its value.
const GLOBAL: usize = 6;
const GLOBAL_BYTES: usize = GLOBAL * names::MAX;
/// Size in bytes of all global user variables with their CRC. In the memory they follow the saved variables.
pub(super) const GLOBALS: usize = GLOBAL_BYTES + 2;
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

impl Drive {
    /// Loads variables, global user variables and the program when the drive starts. Returns true if the
    /// memory was good (error 70 if not). The factory's values replace bad parts.
    pub(super) fn load(&mut self, out: &dyn Context) -> bool {
        let saved = self.bank.load(out) && load_globals(&mut self.mcode.names, out);
        if !saved {
            self.bank.factory_reset();
            self.mcode.names = Names::new();
        }
        self.mcode.load_program(self.bank.variants(), out) && saved
    }

    /// IP: loads the variables and flags that were saved.
    ///
    /// # Errors
    /// Error 70 if the saved values are bad, 74 in motion.
    pub(super) fn initialize(&mut self, at: Instant, out: &mut dyn Context) -> Result<(), Error> {
        if self.reader(at).is_in_motion() {
            return Err(Error::ClearInMotion);
        }
        // A save in progress is finished first, because it was commanded before IP.
        self.saving.finish(at, out);
        let good = self.bank.load(out);
        self.apply_variables(at, out);
        if good { Ok(()) } else { Err(Error::Flash) }
    }

    /// Applies all variables to I/O and motion.
    pub(super) fn apply_variables(&mut self, at: Instant, out: &mut dyn Context) {
        self.set_filters(at, out);
        self.apply_set_ups(at, out);
        self.set_motion(at, out);
    }

    /// Applies the set-ups of all I/O points. A set-up that is not possible is replaced by the factory's.
    fn apply_set_ups(&mut self, at: Instant, out: &mut dyn Context) {
        self.io.begin_load();
        for reg in [Reg::S1, Reg::S2, Reg::S3, Reg::S4, Reg::S5, Reg::S7, Reg::S8, Reg::S13] {
            if self.bank.has(reg) && self.set_up(at, reg, self.bank.set_up_of(reg), out).is_err() {
                self.bank.set(reg, entry(reg).reset);
                let _ = self.set_up(at, reg, self.bank.set_up_of(reg), out);
            }
        }
        self.io.end_load(at, out);
    }

    /// Presets a variable before power-on, as if it had been saved.
    pub(super) fn preset(
        &mut self,
        at: Instant,
        reg: Reg,
        value: i64,
        out: &mut dyn Context,
    ) -> Result<(), PresetError> {
        if !self.bank.load(out) || !load_globals(&mut self.mcode.names, out) {
            return Err(PresetError::BadMemory);
        }
        match i32::try_from(value) {
            _ if !is_number(reg) => {
                // The I/O points decide whether the set-up is possible, so they are set up as a trial. They
                // are new again at power-on.
                self.apply_set_ups(at, &mut NullContext);
                let validated = self.set_up(at, reg, words(reg, value), &mut NullContext);
                self.io = Io::OPEN;
                validated.map_err(|_| PresetError::OutOfRange)?;
            }
            Ok(value) => {
                let validated = self.reader(at).validate(reg, value, &|other| self.bank.stored(other));
                validated.map_err(|_| PresetError::OutOfRange)?;
                self.bank.store(reg, value);
            }
            Err(_) => return Err(PresetError::OutOfRange),
        }
        self.saving.begin(at, &mut self.bank, &self.mcode.names, out);
        self.saving.finish(at, out);
        Ok(())
    }
}

/// Loads the global user variables. Returns false if the memory is bad.
fn load_globals(names: &mut Names, out: &dyn Context) -> bool {
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
