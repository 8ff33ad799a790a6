//! A link to a pty, under a name that stays.

use std::io;
use std::path::{Path, PathBuf};

use rustix::fs::Access;

/// A link that is gone when it is dropped.
pub(super) struct Link {
    place: PathBuf,
    target: PathBuf,
}

impl Link {
    /// A link at `place` to `target`, instead of an old link that may be there.
    ///
    /// # Errors
    /// Something else is there, or nothing can be.
    pub(super) fn new(place: PathBuf, target: &Path) -> io::Result<Self> {
        check_link(&place)?;
        if place.is_symlink() {
            std::fs::remove_file(&place)?;
        }
        std::os::unix::fs::symlink(target, &place)?;
        Ok(Self { place, target: target.to_owned() })
    }
}

/// Unless it leads elsewhere by now.
impl Drop for Link {
    fn drop(&mut self) {
        if std::fs::read_link(&self.place).is_ok_and(|target| target == self.target) {
            let _ = std::fs::remove_file(&self.place);
        }
    }
}

/// Whether a link can be made at `place`: nothing is there, or an old link.
///
/// # Errors
/// Something else is there, or nothing can be.
pub(crate) fn check_link(place: &Path) -> io::Result<()> {
    match place.symlink_metadata() {
        Ok(there) if there.is_symlink() => Ok(()),
        Ok(_) => Err(io::Error::new(io::ErrorKind::AlreadyExists, "something else than a link is there")),
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            let folder = place.parent().filter(|folder| !folder.as_os_str().is_empty());
            rustix::fs::access(folder.unwrap_or(Path::new(".")), Access::WRITE_OK)?;
            Ok(())
        }
        Err(error) => Err(error),
    }
}
