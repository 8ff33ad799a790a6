//! Non-volatile memory kept in a file (`--nv`).
//!
//! Every byte is written when the drive stores it, so a killed process loses nothing; one `fsync` at exit guards
//! against a power failure of the machine. The content of the file is not changed before the drive's first store.

use std::fs::{File, Metadata, OpenOptions};
use std::io;
use std::os::unix::fs::FileExt;
use std::path::Path;

use rustix::fs::FlockOperation;
use rustix::io::Errno;

/// The file that stores a drive's memory.
pub(crate) struct Nv<D = File> {
    file: D,
    /// The memory as the drive sees it.
    memory: Vec<u8>,
    /// True if the file has the same content as `memory`. False while the file has another size, or after a
    /// failed write.
    whole: bool,
    /// True if the file is longer than the memory.
    longer: bool,
    /// True if the drive has stored anything.
    stored: bool,
}

/// Operations of the file, which may fail.
trait Disk {
    /// Writes all of `bytes` at `offset`.
    fn write_all_at(&self, bytes: &[u8], offset: u64) -> io::Result<()>;
    /// Truncates or extends the file to `length`.
    fn set_len(&self, length: u64) -> io::Result<()>;
    /// Waits until all data is on the disk.
    fn sync_all(&self) -> io::Result<()>;
}

impl Disk for File {
    fn write_all_at(&self, bytes: &[u8], offset: u64) -> io::Result<()> {
        FileExt::write_all_at(self, bytes, offset)
    }

    fn set_len(&self, length: u64) -> io::Result<()> {
        Self::set_len(self, length)
    }

    fn sync_all(&self) -> io::Result<()> {
        Self::sync_all(self)
    }
}

impl Nv {
    /// Opens `path` as a memory of `size` bytes, creating an empty file if there is none. Returns the content for the
    /// drive.
    ///
    /// A file that is too short is extended with erased bytes, so an empty file means a new drive. A file
    /// that is too long belongs to another drive: this drive gets bytes without a valid checksum (HOST-7).
    ///
    /// # Errors
    /// The file cannot be created, read or written, is not a regular file, or another drive uses it.
    pub(crate) fn open(path: &Path, size: usize) -> io::Result<(Vec<u8>, Self)> {
        let file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path)?;
        if !file.metadata()?.is_file() {
            return Err(io::Error::new(io::ErrorKind::InvalidInput, "not a regular file"));
        }
        // Not every file system supports locks. Only a lock that another process holds is an error.
        if let Err(Errno::WOULDBLOCK) = rustix::fs::flock(&file, FlockOperation::NonBlockingLockExclusive) {
            return Err(io::Error::new(io::ErrorKind::ResourceBusy, "another drive keeps its memory there"));
        }
        let length = file.metadata()?.len();
        let mut memory = vec![0xFF; size];
        let there = usize::try_from(length).unwrap_or(usize::MAX).min(size);
        file.read_exact_at(&mut memory[..there], 0)?;
        let nv = Self::holding(file, memory, length);
        Ok((nv.memory.clone(), nv))
    }

    /// Metadata of the file.
    ///
    /// # Errors
    /// The file system returns an error.
    pub(crate) fn metadata(&self) -> io::Result<Metadata> {
        self.file.metadata()
    }
}

#[expect(private_bounds, reason = "code outside of tests uses files only")]
impl<D: Disk> Nv<D> {
    /// The memory for a file of `length` bytes whose first bytes are `memory`.
    fn holding(file: D, mut memory: Vec<u8>, length: u64) -> Self {
        let size = memory.len() as u64;
        let longer = length > size;
        if longer {
            spoil(&mut memory);
        }
        Self { file, memory, whole: length == size, longer, stored: false }
    }

    /// Returns whether the file is longer than the memory, and therefore belongs to another drive.
    pub(crate) fn is_longer(&self) -> bool {
        self.longer
    }

    /// Writes the bytes that the drive stores, and all bytes that an earlier call failed to write.
    ///
    /// # Errors
    /// Errors of the file system.
    pub(crate) fn store(&mut self, offset: u16, bytes: &[u8]) -> io::Result<()> {
        self.stored = true;
        if let Some(target) =
            self.memory.get_mut(usize::from(offset)..).and_then(|it| it.get_mut(..bytes.len()))
        {
            target.copy_from_slice(bytes);
        }
        if !self.whole {
            return self.write_all();
        }
        let written = self.file.write_all_at(bytes, u64::from(offset));
        self.whole = written.is_ok();
        written
    }

    /// Writes the whole memory to the file.
    fn write_all(&mut self) -> io::Result<()> {
        // A longer file is truncated first, because after a partial write its old beginning could still be
        // valid.
        if self.longer {
            self.file.set_len(0)?;
            self.longer = false;
        }
        self.file.write_all_at(&self.memory, 0)?;
        self.whole = true;
        Ok(())
    }

    /// Waits until everything that the drive stored is on the disk.
    ///
    /// # Errors
    /// Errors of the file system.
    pub(crate) fn sync(&mut self) -> io::Result<()> {
        if self.stored && !self.whole {
            self.write_all()?;
        }
        self.file.sync_all()
    }
}

/// Changes every byte in a different way, so that no checksum stays valid.
fn spoil(memory: &mut [u8]) {
    for (n, byte) in memory.iter_mut().enumerate() {
        *byte ^= (n as u8).wrapping_mul(2) | 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::{Cell, RefCell};
    use std::path::PathBuf;

    /// A file that is removed when the test ends.
    struct Scratch(PathBuf);

    impl Scratch {
        fn new(name: &str, content: Option<&[u8]>) -> Self {
            let path = std::env::temp_dir().join(format!("drivetwin-nv-{}-{name}", std::process::id()));
            let _ = std::fs::remove_file(&path);
            if let Some(content) = content {
                std::fs::write(&path, content).unwrap();
            }
            Self(path)
        }

        fn content(&self) -> Vec<u8> {
            std::fs::read(&self.0).unwrap()
        }
    }

    impl Drop for Scratch {
        fn drop(&mut self) {
            let _ = std::fs::remove_file(&self.0);
        }
    }

    #[test]
    fn a_missing_file_is_a_new_drive_and_gets_content_with_the_first_store() {
        let file = Scratch::new("missing", None);
        let (memory, mut nv) = Nv::open(&file.0, 4).unwrap();
        assert_eq!(memory, [0xFF; 4]);
        assert!(file.content().is_empty());
        nv.store(1, &[7]).unwrap();
        assert_eq!(file.content(), [0xFF, 7, 0xFF, 0xFF]);
    }

    #[test]
    fn a_short_file_ends_in_erased_bytes_and_stays_short_until_a_store() {
        let file = Scratch::new("short", Some(&[1, 2]));
        let (memory, mut nv) = Nv::open(&file.0, 4).unwrap();
        assert_eq!(memory, [1, 2, 0xFF, 0xFF]);
        assert_eq!(file.content(), [1, 2]);
        nv.store(3, &[9]).unwrap();
        assert_eq!(file.content(), [1, 2, 0xFF, 9]);
    }

    #[test]
    fn a_long_file_is_spoiled_for_the_drive_and_stays_until_a_store() {
        let file = Scratch::new("long", Some(&[1, 2, 3, 4, 5]));
        let (memory, mut nv) = Nv::open(&file.0, 4).unwrap();
        assert!(memory.iter().zip([1, 2, 3, 4]).all(|(&got, was)| got != was));
        assert_eq!(file.content(), [1, 2, 3, 4, 5]);
        nv.store(0, &[8]).unwrap();
        assert_eq!(file.content(), [8, memory[1], memory[2], memory[3]]);
    }

    #[test]
    fn a_file_of_the_right_size_is_read_and_written_in_place() {
        let file = Scratch::new("right", Some(&[1, 2, 3, 4]));
        let (memory, mut nv) = Nv::open(&file.0, 4).unwrap();
        assert_eq!(memory, [1, 2, 3, 4]);
        nv.store(2, &[8, 9]).unwrap();
        nv.sync().unwrap();
        assert_eq!(file.content(), [1, 2, 8, 9]);
    }

    #[test]
    fn after_a_store_that_failed_the_next_one_writes_all() {
        for content in [None, Some(&[1_u8, 2, 3, 4, 5, 6][..])] {
            let file = Scratch::new("full", content);
            let (memory, mut nv) = Nv::open(&file.0, 6).unwrap();
            // A file that is open for reading only makes each write fail, like a full disk.
            let writable = std::mem::replace(&mut nv.file, File::open(&file.0).unwrap());
            assert!(nv.store(0, &[10, 11]).is_err());
            assert!(nv.sync().is_err());
            assert_eq!(file.content(), content.unwrap_or(&[]));
            nv.file = writable;
            nv.store(4, &[14]).unwrap();
            assert_eq!(file.content(), [10, 11, memory[2], memory[3], 14, memory[5]]);
        }
    }

    #[test]
    fn a_last_store_that_failed_is_made_up_for_at_the_end() {
        let file = Scratch::new("end", None);
        let (_, mut nv) = Nv::open(&file.0, 3).unwrap();
        let writable = std::mem::replace(&mut nv.file, File::open(&file.0).unwrap());
        assert!(nv.store(1, &[7]).is_err());
        nv.file = writable;
        nv.sync().unwrap();
        assert_eq!(file.content(), [0xFF, 7, 0xFF]);
    }

    /// The way in which a disk fails that accepts no more bytes.
    #[derive(Clone, Copy, PartialEq, Debug)]
    enum Failure {
        /// A part of the failing write is accepted (`ENOSPC`).
        Full,
        /// No part of the failing write is accepted (`EIO`).
        Broken,
    }

    /// A disk in memory that fails after `takes` bytes. A change of the length counts as one byte.
    struct FailingDisk {
        content: RefCell<Vec<u8>>,
        takes: Cell<usize>,
        failure: Failure,
    }

    impl FailingDisk {
        fn new(content: &[u8], takes: usize, failure: Failure) -> Self {
            Self { content: RefCell::new(content.to_vec()), takes: Cell::new(takes), failure }
        }

        /// Accepts `count` bytes or a part of them. Returns the number of accepted bytes, and the error.
        fn take(&self, count: usize) -> (usize, io::Result<()>) {
            let takes = self.takes.get();
            if count <= takes {
                self.takes.set(takes - count);
                return (count, Ok(()));
            }
            self.takes.set(0);
            match self.failure {
                Failure::Full => (takes, Err(Errno::NOSPC.into())),
                Failure::Broken => (0, Err(Errno::IO.into())),
            }
        }
    }

    impl Disk for FailingDisk {
        fn write_all_at(&self, bytes: &[u8], offset: u64) -> io::Result<()> {
            let (count, result) = self.take(bytes.len());
            let (mut content, offset) = (self.content.borrow_mut(), offset as usize);
            let length = content.len().max(offset + count);
            // Fills a hole with zeros, as a file system does.
            content.resize(length, 0);
            content[offset..offset + count].copy_from_slice(&bytes[..count]);
            result
        }

        fn set_len(&self, length: u64) -> io::Result<()> {
            let (count, result) = self.take(1);
            if count == 1 {
                self.content.borrow_mut().resize(length as usize, 0);
            }
            result
        }

        fn sync_all(&self) -> io::Result<()> {
            if self.failure == Failure::Broken && self.takes.get() == 0 {
                Err(Errno::IO.into())
            } else {
                Ok(())
            }
        }
    }

    const SIZE: usize = 8;
    const STORES: [(u16, &[u8]); 3] = [(2, &[20, 21, 22]), (0, &[10, 11]), (5, &[30, 31, 32])];

    /// The memory that a drive gets from a file with this content.
    fn found(content: &[u8]) -> Vec<u8> {
        let mut memory = vec![0xFF; SIZE];
        let there = content.len().min(SIZE);
        memory[..there].copy_from_slice(&content[..there]);
        Nv::holding(FailingDisk::new(content, 0, Failure::Full), memory, content.len() as u64).memory
    }

    /// All states of the memory, one after each byte of [`STORES`]: what a power failure of the drive can
    /// leave.
    fn states(content: &[u8]) -> Vec<Vec<u8>> {
        let mut states = vec![found(content)];
        for (offset, bytes) in STORES {
            for (index, byte) in (usize::from(offset)..).zip(bytes) {
                let mut next = states.last().unwrap().clone();
                next[index] = *byte;
                states.push(next);
            }
        }
        states
    }

    fn stores(nv: &mut Nv<FailingDisk>) -> [bool; 3] {
        STORES.map(|(offset, bytes)| nv.store(offset, bytes).is_ok())
    }

    #[test]
    fn a_file_whose_process_is_killed_in_any_write_is_a_memory_whose_power_failed() {
        for content in [&[][..], &[1, 2, 3], &[1, 2, 3, 4, 5, 6, 7, 8]] {
            let states = states(content);
            let mut last = 0;
            for takes in 0..=SIZE + 8 {
                // After an incomplete write a killed process writes nothing more.
                let disk = FailingDisk::new(content, takes, Failure::Full);
                let mut nv = Nv::holding(disk, states[0].clone(), content.len() as u64);
                for (offset, bytes) in STORES {
                    if nv.store(offset, bytes).is_err() {
                        break;
                    }
                }
                let left = found(&nv.file.content.borrow());
                let state = states.iter().position(|state| *state == left);
                last = state.unwrap_or_else(|| panic!("{left:?} after {takes} bytes over {content:?}"));
            }
            assert_eq!(last, states.len() - 1, "all is stored at last");
        }
    }

    #[test]
    fn a_longer_file_whose_process_is_killed_in_any_write_never_comes_back() {
        let content = [1, 2, 3, 4, 5, 6, 7, 8, 9];
        for takes in 0..=SIZE + 8 {
            let disk = FailingDisk::new(&content, takes, Failure::Full);
            let mut nv = Nv::holding(disk, content[..SIZE].to_vec(), content.len() as u64);
            let _ = nv.store(7, &[80]);
            let left = found(&nv.file.content.borrow());
            assert!(left.iter().zip(content).all(|(&left, was)| left != was), "{left:?} after {takes} bytes");
        }
    }

    #[test]
    fn a_disk_that_recovers_gets_all_that_it_missed() {
        for content in [&[][..], &[1, 2, 3], &[1, 2, 3, 4, 5, 6, 7, 8], &[1, 2, 3, 4, 5, 6, 7, 8, 9]] {
            let mut whole = states(content).pop().unwrap();
            for (takes, failure) in (0..SIZE).flat_map(|n| [(n, Failure::Full), (n, Failure::Broken)]) {
                let mut memory = vec![0xFF; SIZE];
                let there = content.len().min(SIZE);
                memory[..there].copy_from_slice(&content[..there]);
                let disk = FailingDisk::new(content, takes, failure);
                let mut nv = Nv::holding(disk, memory, content.len() as u64);
                assert!(stores(&mut nv).contains(&false), "{takes} bytes are too few for all of it");
                nv.file.takes.set(100);
                if takes % 2 == 0 {
                    nv.sync().unwrap();
                    assert_eq!(found(&nv.file.content.borrow()), whole, "{failure:?} after {takes} bytes");
                }
                nv.store(6, &[60]).unwrap();
                whole[6] = 60;
                assert_eq!(*nv.file.content.borrow(), whole, "{failure:?} after {takes} bytes");
                whole[6] = 31;
            }
        }
    }

    #[test]
    fn a_failed_sync_is_reported_and_retried() {
        let content = [1, 2, 3, 4, 5, 6, 7, 8];
        let mut nv = Nv::holding(FailingDisk::new(&content, 2, Failure::Broken), content.to_vec(), 8);
        nv.store(0, &[10, 11]).unwrap();
        assert_eq!(nv.sync().map_err(|error| error.raw_os_error()), Err(Some(Errno::IO.raw_os_error())));
        nv.file.takes.set(1);
        nv.sync().unwrap();
        assert_eq!(*nv.file.content.borrow(), [10, 11, 3, 4, 5, 6, 7, 8]);
    }

    #[test]
    fn a_directory_is_an_error() {
        assert!(Nv::open(&std::env::temp_dir(), 4).is_err());
    }
}
