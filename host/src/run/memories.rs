//! The non-volatile memories of the drives, and the files that keep them.

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

/// A drive's memory before it is seated, and the file that keeps it, if there is one.
pub(super) struct Memory {
    content: Option<Vec<u8>>,
    file: Option<Kept>,
}

/// The file of a memory.
#[derive(Clone)]
struct Kept {
    path: PathBuf,
    nv: Rc<RefCell<Nv>>,
}

impl Memory {
    /// The memory of the drive at `place` of the layout, with its user program, if it has one. Its file stays as it is.
    ///
    /// # Errors
    /// One sentence: its file cannot be one.
    pub(super) fn open(
        configuration: &Configuration,
        place: usize,
        program: Option<&Image>,
    ) -> Result<Self, String> {
        let drive = &configuration.layout.drives[place];
        let spec = catalog::make(drive.kind)?.spec();
        let size = usize::from(spec.memory);
        let mut memory = Self { content: None, file: None };
        if let Some(path) = &drive.nv {
            let wrong = |error: &dyn std::fmt::Display| {
                configuration.of(place, "nv", &format!("{}: {error}", path.display()))
            };
            let (content, nv) = Nv::open(path, size).map_err(|error| wrong(&error))?;
            let length = nv.metadata().map_err(|error| wrong(&error))?.len();
            if program.is_some() && length > u64::from(spec.memory) {
                let longer = format!("{} is longer than the memory of {}", path.display(), spec.kind);
                return Err(configuration.of(place, "program", &longer));
            }
            memory.content = Some(content);
            memory.file = Some(Kept { path: path.clone(), nv: Rc::new(RefCell::new(nv)) });
        }
        if let Some(program) = program {
            program.put_into(memory.content.get_or_insert_with(|| vec![0xFF; size]));
        }
        Ok(memory)
    }

    /// Content that the drive finds there; `None` if the memory is new.
    pub(super) fn content(&self) -> Option<Vec<u8>> {
        self.content.clone()
    }

    /// The file has that program from now on, too.
    ///
    /// # Errors
    /// One sentence: it cannot be written.
    pub(super) fn hold(&self, program: &Image) -> Result<(), String> {
        let Some(Kept { path, nv }) = &self.file else { return Ok(()) };
        let stored = nv.borrow_mut().store(program.offset, &program.bytes);
        stored.map_err(|error| format!("{}: {error}", path.display()))
    }

    /// A function that writes to the file what the drive stores.
    pub(super) fn keeper(&self) -> Option<PersistFn> {
        let Kept { path, nv } = self.file.clone()?;
        Some(Box::new(move |offset, bytes| {
            if let Err(error) = nv.borrow_mut().store(offset, bytes) {
                error!("{} does not keep what the drive stores: {error}", path.display());
            }
        }))
    }

    /// Warns of a file that is another drive's.
    pub(super) fn warn(&self) {
        let Some(Kept { path, nv }) = &self.file else { return };
        if nv.borrow().is_longer() {
            let path = path.display();
            warn!(
                "{path} is longer than the memory of its drive, so it is another one's; the first save replaces it"
            );
        }
    }

    /// Returns whether the memory is in that file.
    pub(super) fn is_in(&self, file: &Metadata) -> io::Result<bool> {
        let Some(Kept { nv, .. }) = &self.file else { return Ok(false) };
        let own = nv.borrow().metadata()?;
        Ok((own.dev(), own.ino()) == (file.dev(), file.ino()))
    }

    /// Waits until the disk has it all.
    ///
    /// # Errors
    /// One sentence: the file does not have what the drive stored.
    pub(super) fn sync(&self) -> Result<(), String> {
        let Some(Kept { path, nv }) = &self.file else { return Ok(()) };
        let synced = nv.borrow_mut().sync();
        synced.map_err(|error| format!("{} does not keep what the drive stored: {error}", path.display()))
    }
}
