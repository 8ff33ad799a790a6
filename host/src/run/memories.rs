//! Non-volatile memories of the drives, and the files that store them.

use std::fs::Metadata;
use std::io;
use std::os::unix::fs::MetadataExt as _;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use drivetwin_sim::bench::{PersistFn, Setup};
use drivetwin_sim::catalog;
use drivetwin_sim::rsasm::Image;
use tracing::{error, warn};

use super::Configuration;
use crate::nv_file::Nv;

/// Memory content of a drive, and the file that stores it, if there is one.
pub(super) struct Memory {
    content: Option<Vec<u8>>,
    file: Option<MemoryFile>,
}

/// The file of a memory.
#[derive(Clone)]
struct MemoryFile {
    path: PathBuf,
    nv: Arc<Mutex<Nv>>,
}

impl MemoryFile {
    fn lock(&self) -> MutexGuard<'_, Nv> {
        // A store that panicked has written a part of the file, as a power cut does.
        self.nv.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Configuration {
    /// Opens the memory of each drive. `programs` has the user program of each drive.
    ///
    /// # Errors
    /// One sentence: a file cannot be used.
    pub(super) fn memories(&self, programs: &[Option<Image>]) -> Result<Vec<Memory>, String> {
        let open = |(index, program): (usize, &Option<Image>)| Memory::open(self, index, program.as_ref());
        programs.iter().enumerate().map(open).collect()
    }
}

/// Writes user programs to the files of their drives.
///
/// # Errors
/// One sentence: a file cannot be written.
pub(super) fn store_programs(memories: &[Memory], programs: &[Option<Image>]) -> Result<(), String> {
    let mut with =
        memories.iter().zip(programs).filter_map(|(memory, program)| Some((memory, program.as_ref()?)));
    with.try_for_each(|(memory, program)| memory.store_program(program))
}

impl Memory {
    /// Opens the memory of the drive with index `index` in the layout. A user program is put into the
    /// returned memory but not yet into the file, which stays unchanged.
    ///
    /// # Errors
    /// One sentence that says what is wrong: the file cannot be used.
    fn open(configuration: &Configuration, index: usize, program: Option<&Image>) -> Result<Self, String> {
        let drive = &configuration.layout.drives[index];
        if drive.board.is_some() {
            return Ok(Self { content: None, file: None });
        }
        let spec = catalog::make(drive.kind)?.spec();
        let size = usize::from(spec.memory);
        let mut memory = Self { content: None, file: None };
        if let Some(path) = &drive.nv {
            let wrong = |error: &dyn std::fmt::Display| {
                configuration.of(index, "nv", &format!("{}: {error}", path.display()))
            };
            let (content, nv) = Nv::open(path, size).map_err(|error| wrong(&error))?;
            let length = nv.metadata().map_err(|error| wrong(&error))?.len();
            if program.is_some() && length > u64::from(spec.memory) {
                let longer = format!("{} is longer than the memory of {}", path.display(), spec.kind);
                return Err(configuration.of(index, "program", &longer));
            }
            memory.content = Some(content);
            memory.file = Some(MemoryFile { path: path.clone(), nv: Arc::new(Mutex::new(nv)) });
        }
        if let Some(program) = program {
            program.put_into(memory.content.get_or_insert_with(|| vec![0xFF; size]));
        }
        Ok(memory)
    }

    /// Initial content, and a function that writes to the file what the drive stores.
    pub(super) fn setup(&self) -> Setup {
        Setup { memory: self.content.clone(), persist: self.persist_fn(), ..Setup::default() }
    }

    /// Writes a user program to the file. The program is already in the memory.
    ///
    /// # Errors
    /// One sentence that says what is wrong: the file cannot be written.
    fn store_program(&self, program: &Image) -> Result<(), String> {
        let Some(file) = &self.file else { return Ok(()) };
        let stored = file.lock().store(program.offset, &program.bytes);
        stored.map_err(|error| format!("{}: {error}", file.path.display()))
    }

    fn persist_fn(&self) -> Option<PersistFn> {
        let file = self.file.clone()?;
        Some(Box::new(move |offset, bytes| {
            if let Err(error) = file.lock().store(offset, bytes) {
                error!("{} does not keep what the drive stores: {error}", file.path.display());
            }
        }))
    }

    /// Logs a warning if the file belongs to another drive.
    pub(super) fn warn(&self) {
        let Some(file) = &self.file else { return };
        if file.lock().is_longer() {
            let path = file.path.display();
            warn!(
                "{path} is longer than the memory of its drive, so it belongs to another drive; the first save replaces it"
            );
        }
    }

    /// Returns whether this memory is stored in `file`.
    pub(super) fn is_in(&self, file: &Metadata) -> io::Result<bool> {
        let Some(of) = &self.file else { return Ok(false) };
        let own = of.lock().metadata()?;
        Ok((own.dev(), own.ino()) == (file.dev(), file.ino()))
    }

    /// Waits until the file is on the disk.
    ///
    /// # Errors
    /// One sentence that says what is wrong: the file does not contain everything that the drive stored.
    pub(super) fn sync(&self) -> Result<(), String> {
        let Some(file) = &self.file else { return Ok(()) };
        let synced = file.lock().sync();
        synced
            .map_err(|error| format!("{} does not keep what the drive stored: {error}", file.path.display()))
    }
}
