//! Openings, closings and writes of the programs at the ptys.
//!
//! The system tells it in order, but apart from the bytes: those of one program lie beside those of the next. It may
//! tell two openings, or two closings, one right behind the other, as one; so the last closing is told for certain by
//! the pty's master only.

use std::collections::BTreeMap;
use std::io;
use std::mem::MaybeUninit;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::Path;

use rustix::fs::inotify::{self, CreateFlags, ReadFlags, WatchFlags};

/// All openings of ptys that are still to be noted.
pub(super) struct Openings {
    inotify: OwnedFd,
    told: BTreeMap<i32, Vec<ReadFlags>>,
}

impl Openings {
    /// None yet.
    ///
    /// # Errors
    /// The system gives no inotify instance.
    pub(super) fn new() -> io::Result<Self> {
        let inotify = inotify::init(CreateFlags::NONBLOCK | CreateFlags::CLOEXEC)?;
        Ok(Self { inotify, told: BTreeMap::new() })
    }

    /// Tells of the pty at `path`, too, by the number that is returned.
    ///
    /// # Errors
    /// The system cannot tell of it.
    pub(super) fn watch(&self, path: &Path) -> io::Result<i32> {
        let events =
            WatchFlags::OPEN | WatchFlags::MODIFY | WatchFlags::CLOSE_WRITE | WatchFlags::CLOSE_NOWRITE;
        Ok(inotify::add_watch(&self.inotify, path, events)?)
    }

    /// A pty of which something is told that it has not noted yet.
    pub(super) fn next(&self) -> Option<i32> {
        self.told.keys().next().copied()
    }

    /// Lets a pty note what is told of it.
    pub(super) fn of(&mut self, watch: i32) -> Vec<ReadFlags> {
        self.hear();
        self.told.remove(&watch).unwrap_or_default()
    }

    /// Hears what is told of all ptys by now.
    pub(super) fn hear(&mut self) {
        let mut buffer = [MaybeUninit::uninit(); 1024];
        let mut events = inotify::Reader::new(&self.inotify, &mut buffer);
        while let Ok(event) = events.next() {
            self.told.entry(event.wd()).or_default().push(event.events());
        }
    }
}

impl AsFd for Openings {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.inotify.as_fd()
    }
}

/// The programs that have a pty open, as far as openings tell.
#[derive(Default)]
pub(super) struct Openers {
    count: u32,
    /// True while some of their bytes may still be unread.
    pub(super) wrote: bool,
    /// True if a program opened it after all others had left, and is not noted yet.
    pub(super) changed: bool,
    /// True if another one came and left since the last one was noted.
    pub(super) unseen: bool,
    /// True while bytes of those who left then may still be unread.
    pub(super) left_wrote: bool,
}

impl Openers {
    pub(super) fn hear(&mut self, events: &[ReadFlags]) {
        for event in events {
            if event.contains(ReadFlags::MODIFY) {
                self.wrote = true;
            } else if event.contains(ReadFlags::OPEN) {
                if self.count == 0 {
                    self.unseen |= std::mem::replace(&mut self.changed, true);
                    self.left_wrote |= std::mem::take(&mut self.wrote);
                }
                self.count += 1;
            } else if is_closing(*event) {
                self.count = self.count.saturating_sub(1);
            }
        }
    }

    /// Notes who came last.
    pub(super) fn note(&mut self) {
        (self.changed, self.unseen, self.left_wrote) = (false, false, false);
    }

    /// Notes for certain whether a program is there. It is another one if `nobody` was there before, or if one that can
    /// write has closed the pty meanwhile; the events do not tell which of the openings was our own.
    pub(super) fn are(&mut self, here: bool, nobody: bool, events: &[ReadFlags]) {
        let closed = events.iter().rposition(|event| event.contains(ReadFlags::CLOSE_WRITE));
        let before = closed.and_then(|last| events.get(..last)).unwrap_or_default();
        *self = Self {
            count: here.into(),
            wrote: here,
            changed: here && (nobody || closed.is_some()),
            left_wrote: here && before.iter().any(|event| event.contains(ReadFlags::MODIFY)),
            ..Self::default()
        };
    }
}

fn is_closing(event: ReadFlags) -> bool {
    event.intersects(ReadFlags::CLOSE_WRITE | ReadFlags::CLOSE_NOWRITE)
}

#[cfg(test)]
mod tests {
    use super::*;

    const OPEN: ReadFlags = ReadFlags::OPEN;
    const WRITE: ReadFlags = ReadFlags::MODIFY;
    const CLOSE: ReadFlags = ReadFlags::CLOSE_WRITE;

    /// New program there; it wrote; the one before wrote.
    fn told(events: &[ReadFlags]) -> (bool, bool, bool) {
        let mut openers = Openers::default();
        openers.hear(&[OPEN]);
        openers.note();
        openers.hear(events);
        (openers.changed, openers.wrote, openers.left_wrote)
    }

    #[test]
    fn who_comes_when_all_have_left_is_another_one() {
        assert_eq!(told(&[]), (false, false, false));
        assert_eq!(told(&[WRITE]), (false, true, false));
        assert_eq!(told(&[CLOSE, OPEN]), (true, false, false));
        assert_eq!(told(&[WRITE, CLOSE, OPEN]), (true, false, true));
        assert_eq!(told(&[CLOSE, OPEN, WRITE]), (true, true, false));
        assert_eq!(told(&[WRITE, CLOSE, OPEN, CLOSE, OPEN, WRITE]), (true, true, true));
        let mut openers = Openers::default();
        openers.hear(&[OPEN, CLOSE]);
        assert!(!openers.unseen);
        openers.hear(&[OPEN]);
        assert!(openers.changed && openers.unseen);
        // One wrote and left, and another one came, while the other end was opened and closed here.
        openers.are(true, false, &[OPEN, WRITE, CLOSE, OPEN, ReadFlags::CLOSE_NOWRITE, WRITE]);
        assert!(openers.changed && openers.left_wrote && openers.wrote);
        openers.are(true, false, &[OPEN, WRITE, ReadFlags::CLOSE_NOWRITE]);
        assert!(!openers.changed && !openers.left_wrote && openers.wrote);
        // Two programs at once, as a shell's `cat` and `echo`, are one opener.
        assert_eq!(told(&[OPEN, WRITE, CLOSE]), (false, true, false));
    }
}
