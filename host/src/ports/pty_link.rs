//! A link to a pty, under a name that stays.

use std::io;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};

use rustix::fs::Access;

/// A link that is gone when it is dropped.
pub(super) struct Link {
    place: PathBuf,
    target: PathBuf,
}

impl Link {
    /// A link at `place` to `target`, instead of one to a pty that is gone.
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

/// Folder of all ptys.
const PTYS: &str = "/dev/pts";

/// Returns whether a link can be made at `place`: nothing is there, or a link to a pty that is gone.
///
/// # Errors
/// The place has another file, or a link to a pty that a program has open, or cannot have a link.
pub(crate) fn check_link(place: &Path) -> io::Result<()> {
    match place.symlink_metadata() {
        Ok(there) if there.is_symlink() => {
            let target = std::fs::read_link(place)?;
            let refused = |why: &str| {
                let sentence = format!("a link to {} is there, {why}", target.display());
                Err(io::Error::new(io::ErrorKind::AlreadyExists, sentence))
            };
            if !target.starts_with(PTYS) {
                return refused("which is no pty");
            }
            // A number that was given to another pty since is younger than the link.
            let made = |of: &std::fs::Metadata| (of.ctime(), of.ctime_nsec());
            let lives = target.metadata().is_ok_and(|pty| made(&pty) <= made(&there));
            if lives { refused("and a program has it open") } else { Ok(()) }
        }
        Ok(_) => Err(io::Error::new(io::ErrorKind::AlreadyExists, "something else than a link is there")),
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            let folder = place.parent().filter(|folder| !folder.as_os_str().is_empty());
            rustix::fs::access(folder.unwrap_or(Path::new(".")), Access::WRITE_OK)?;
            Ok(())
        }
        Err(error) => Err(error),
    }
}
