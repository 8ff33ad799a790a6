//! Non-volatile memories of the drives, and the files that store them.

use std::cell::RefCell;
use std::fs::Metadata;
use std::io;
use std::os::unix::fs::MetadataExt as _;
use std::path::PathBuf;
use std::rc::Rc;

use drivetwin_sim::bench::PersistFn;
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
    nv: Rc<RefCell<Nv>>,
}

impl Memory {
    /// Opens the memory of the drive with index `index` in the layout. A user program is put into the
    /// returned memory but not yet into the file, which stays unchanged.
    ///
    /// # Errors
    /// One sentence that says what is wrong: the file cannot be used.
    pub(super) fn open(
        configuration: &Configuration,
        index: usize,
        program: Option<&Image>,
    ) -> Result<Self, String> {
        let drive = &configuration.layout.drives[index];
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
            memory.file = Some(MemoryFile { path: path.clone(), nv: Rc::new(RefCell::new(nv)) });
        }
        if let Some(program) = program {
            program.put_into(memory.content.get_or_insert_with(|| vec![0xFF; size]));
        }
        Ok(memory)
    }

    /// Initial content; `None` for erased memory.
    pub(super) fn content(&self) -> Option<Vec<u8>> {
        self.content.clone()
    }

    /// Writes a user program to the file. The program is already in the memory.
    ///
    /// # Errors
    /// One sentence that says what is wrong: the file cannot be written.
    pub(super) fn store_program(&self, program: &Image) -> Result<(), String> {
        let Some(MemoryFile { path, nv }) = &self.file else { return Ok(()) };
        let stored = nv.borrow_mut().store(program.offset, &program.bytes);
        stored.map_err(|error| format!("{}: {error}", path.display()))
    }

    /// A function that writes to the file what the drive stores.
    pub(super) fn persist_fn(&self) -> Option<PersistFn> {
        let MemoryFile { path, nv } = self.file.clone()?;
        Some(Box::new(move |offset, bytes| {
            if let Err(error) = nv.borrow_mut().store(offset, bytes) {
                error!("{} does not keep what the drive stores: {error}", path.display());
            }
        }))
    }

    /// Logs a warning if the file belongs to another drive.
    pub(super) fn warn(&self) {
        let Some(MemoryFile { path, nv }) = &self.file else { return };
        if nv.borrow().is_longer() {
            let path = path.display();
            warn!(
                "{path} is longer than the memory of its drive, so it belongs to another drive; the first save replaces it"
            );
        }
    }

    /// Returns whether this memory is stored in `file`.
    pub(super) fn is_in(&self, file: &Metadata) -> io::Result<bool> {
        let Some(MemoryFile { nv, .. }) = &self.file else { return Ok(false) };
        let own = nv.borrow().metadata()?;
        Ok((own.dev(), own.ino()) == (file.dev(), file.ino()))
    }

    /// Waits until the file is on the disk.
    ///
    /// # Errors
    /// One sentence that says what is wrong: the file does not contain everything that the drive stored.
    pub(super) fn sync(&self) -> Result<(), String> {
        let Some(MemoryFile { path, nv }) = &self.file else { return Ok(()) };
        let synced = nv.borrow_mut().sync();
        synced.map_err(|error| format!("{} does not keep what the drive stored: {error}", path.display()))
    }
}
