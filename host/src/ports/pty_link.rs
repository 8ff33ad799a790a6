//! Symbolic link to a pty, which gives it a fixed name.

use std::io;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};

use rustix::fs::Access;

/// A link that is removed when this value is dropped.
pub(super) struct Link {
    path: PathBuf,
    target: PathBuf,
}

impl Link {
    /// Creates a link at `path` to `target`. A link to a closed pty is replaced.
    ///
    /// # Errors
    /// Another file has that path, or the link cannot be created.
    pub(super) fn new(path: PathBuf, target: &Path) -> io::Result<Self> {
        check_link(&path)?;
        if path.is_symlink() {
            std::fs::remove_file(&path)?;
        }
        std::os::unix::fs::symlink(target, &path)?;
        Ok(Self { path, target: target.to_owned() })
    }
}

/// Removes the link, unless it has been changed to another target.
impl Drop for Link {
    fn drop(&mut self) {
        if std::fs::read_link(&self.path).is_ok_and(|target| target == self.target) {
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// Directory of all ptys.
const PTYS: &str = "/dev/pts";

/// Checks that a link can be created at `path`: no file is there, or only a link to a closed pty.
///
/// # Errors
/// Another file or a link to an open pty has that path, or a link cannot be created there.
pub(crate) fn check_link(path: &Path) -> io::Result<()> {
    match path.symlink_metadata() {
        Ok(there) if there.is_symlink() => {
            let target = std::fs::read_link(path)?;
            let refused = |why: &str| {
                let sentence = format!("a link to {} is there, {why}", target.display());
                Err(io::Error::new(io::ErrorKind::AlreadyExists, sentence))
            };
            if !target.starts_with(PTYS) {
                return refused("which is not a pty; choose another name");
            }
            // A pty that is younger than the link has reused the number of a closed pty.
            let made = |of: &std::fs::Metadata| (of.ctime(), of.ctime_nsec());
            let lives = target.metadata().is_ok_and(|pty| made(&pty) <= made(&there));
            if lives {
                refused("and a program has it open: end that program, or choose another name")
            } else {
                Ok(())
            }
        }
        Ok(_) => Err(io::Error::new(io::ErrorKind::AlreadyExists, "something else than a link is there")),
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
            rustix::fs::access(folder.unwrap_or(Path::new(".")), Access::WRITE_OK)?;
            Ok(())
        }
        Err(error) => Err(error),
    }
}
