//! Output files that options name.

use std::fs::{File, Metadata};
use std::io;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};

/// An output file.
pub(crate) struct OutputFile {
    option: &'static str,
    path: PathBuf,
    file: File,
}

impl OutputFile {
    /// Opens the file of an option without changing its content; [`begin`](Self::begin) clears it when the
    /// drives are ready.
    pub(crate) fn open(option: &'static str, path: &Path) -> Result<Self, String> {
        let opened = File::options().write(true).create(true).truncate(false).open(path);
        let file = opened.map_err(|error| sentence(option, path, &error))?;
        Ok(Self { option, path: path.into(), file })
    }

    /// Removes the content of an earlier run.
    pub(crate) fn begin(&self) -> Result<(), String> {
        self.fails(self.file.metadata().and_then(|there| {
            // Devices and pipes have no content to remove.
            if there.is_file() { self.file.set_len(0) } else { Ok(()) }
        }))
    }

    /// Returns whether both options name the same regular file.
    pub(crate) fn is(&self, other: &Self) -> Result<bool, String> {
        let (own, other) = (self.metadata()?, other.metadata()?);
        Ok(own.is_file() && (own.dev(), own.ino()) == (other.dev(), other.ino()))
    }

    pub(crate) fn metadata(&self) -> Result<Metadata, String> {
        self.fails(self.file.metadata())
    }

    /// Converts an error of the file to a sentence.
    pub(crate) fn fails<T>(&self, result: io::Result<T>) -> Result<T, String> {
        result.map_err(|error| sentence(self.option, &self.path, &error))
    }

    pub(crate) fn option(&self) -> &'static str {
        self.option
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    pub(crate) fn file(&self) -> &File {
        &self.file
    }
}

fn sentence(option: &str, path: &Path, error: &io::Error) -> String {
    format!("{option} {}: {error}", path.display())
}
