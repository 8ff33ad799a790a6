//! Events of the ptys: programs open, close and write to them.
//!
//! The system reports these events in order, but not in relation to the bytes: the bytes of one program are
//! followed directly by those of the next. The system may merge two consecutive openings or closings into one
//! event. Therefore only the pty's master reports the last closing reliably.

use std::collections::BTreeMap;
use std::io;
use std::mem::MaybeUninit;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::Path;

use rustix::fs::inotify::{self, CreateFlags, ReadFlags, WatchFlags};

/// Events of the ptys that are not handled yet.
pub(super) struct Openings {
    inotify: OwnedFd,
    events: BTreeMap<i32, Vec<ReadFlags>>,
}

impl Openings {
    /// A list without events.
    ///
    /// # Errors
    /// The system gives no inotify instance.
    pub(super) fn new() -> io::Result<Self> {
        let inotify = inotify::init(CreateFlags::NONBLOCK | CreateFlags::CLOEXEC)?;
        Ok(Self { inotify, events: BTreeMap::new() })
    }

    /// Adds the pty at `path`. Returns the number of its watch.
    ///
    /// # Errors
    /// The system cannot watch the path.
    pub(super) fn watch(&self, path: &Path) -> io::Result<i32> {
        let events =
            WatchFlags::OPEN | WatchFlags::MODIFY | WatchFlags::CLOSE_WRITE | WatchFlags::CLOSE_NOWRITE;
        Ok(inotify::add_watch(&self.inotify, path, events)?)
    }

    /// A pty that has events to handle.
    pub(super) fn next(&self) -> Option<i32> {
        self.events.keys().next().copied()
    }

    /// Takes all events of a pty.
    pub(super) fn take(&mut self, watch: i32) -> Vec<ReadFlags> {
        self.read_events();
        self.events.remove(&watch).unwrap_or_default()
    }

    /// Reads the events of all ptys.
    pub(super) fn read_events(&mut self) {
        let mut buffer = [MaybeUninit::uninit(); 1024];
        let mut events = inotify::Reader::new(&self.inotify, &mut buffer);
        while let Ok(event) = events.next() {
            self.events.entry(event.wd()).or_default().push(event.events());
        }
    }
}

impl AsFd for Openings {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.inotify.as_fd()
    }
}

/// State of the programs that have a pty open, as far as the events show it.
#[derive(Default)]
pub(super) struct Openers {
    count: u32,
    /// True while bytes of these programs may still be unread.
    pub(super) wrote: bool,
    /// True if a program opened the pty after all others had left, and that is not handled yet.
    pub(super) changed: bool,
    /// True if another program opened and closed the pty since the last handled opening.
    pub(super) unseen: bool,
    /// True while bytes of programs that have left may still be unread.
    pub(super) left_wrote: bool,
    /// True if the event of the counted opening may still follow. It is then the next event of the pty.
    event_follows: bool,
}

impl Openers {
    pub(super) fn handle(&mut self, events: &[ReadFlags]) {
        for event in events {
            let is_counted = std::mem::take(&mut self.event_follows) && event.contains(ReadFlags::OPEN);
            if is_counted {
                continue;
            }
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

    /// Marks the last opening as handled.
    pub(super) fn note(&mut self) {
        (self.changed, self.unseen, self.left_wrote) = (false, false, false);
    }

    /// Sets whether a program has the pty open. It counts as a new program if `was_closed` (no known program
    /// had the pty open), or if a program with write access has closed the pty meanwhile. The events do not
    /// show which opening was that of this process. The pty is open a little before the event of that opening,
    /// so a new program without an event of its own may still cause one.
    pub(super) fn set_present(&mut self, is_open: bool, was_closed: bool, events: &[ReadFlags]) {
        let openings = events.iter().filter(|event| event.contains(ReadFlags::OPEN)).count();
        let closed = events.iter().rposition(|event| event.contains(ReadFlags::CLOSE_WRITE));
        let before = closed.and_then(|last| events.get(..last)).unwrap_or_default();
        let changed = is_open && (was_closed || closed.is_some());
        *self = Self {
            count: is_open.into(),
            wrote: is_open,
            changed,
            event_follows: changed && openings < 2,
            left_wrote: is_open && before.iter().any(|event| event.contains(ReadFlags::MODIFY)),
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

    /// Returns three flags after `events`: a new program has opened the pty; the new program has written; the
    /// program before it had written.
    fn state_after(events: &[ReadFlags]) -> (bool, bool, bool) {
        let mut openers = Openers::default();
        openers.handle(&[OPEN]);
        openers.note();
        openers.handle(events);
        (openers.changed, openers.wrote, openers.left_wrote)
    }

    #[test]
    fn who_comes_when_all_have_left_is_another_one() {
        assert_eq!(state_after(&[]), (false, false, false));
        assert_eq!(state_after(&[WRITE]), (false, true, false));
        assert_eq!(state_after(&[CLOSE, OPEN]), (true, false, false));
        assert_eq!(state_after(&[WRITE, CLOSE, OPEN]), (true, false, true));
        assert_eq!(state_after(&[CLOSE, OPEN, WRITE]), (true, true, false));
        assert_eq!(state_after(&[WRITE, CLOSE, OPEN, CLOSE, OPEN, WRITE]), (true, true, true));
        let mut openers = Openers::default();
        openers.handle(&[OPEN, CLOSE]);
        assert!(!openers.unseen);
        openers.handle(&[OPEN]);
        assert!(openers.changed && openers.unseen);
        // While this process opened and closed the other end, one program wrote and left, and another one
        // opened the pty.
        openers.set_present(true, false, &[OPEN, WRITE, CLOSE, OPEN, ReadFlags::CLOSE_NOWRITE, WRITE]);
        assert!(openers.changed && openers.left_wrote && openers.wrote);
        openers.set_present(true, false, &[OPEN, WRITE, ReadFlags::CLOSE_NOWRITE]);
        assert!(!openers.changed && !openers.left_wrote && openers.wrote);
        // The event of the new program's opening comes late.
        openers.set_present(true, true, &[OPEN, ReadFlags::CLOSE_NOWRITE]);
        openers.handle(&[OPEN]);
        openers.note();
        openers.handle(&[WRITE, CLOSE, OPEN]);
        assert!(openers.changed && openers.left_wrote && !openers.wrote);
        // The system has merged it with that of this process.
        openers.set_present(true, true, &[OPEN, ReadFlags::CLOSE_NOWRITE]);
        openers.note();
        openers.handle(&[WRITE, OPEN, CLOSE]);
        assert!(!openers.changed && openers.wrote);
        // Two programs that have the pty open at once, like a shell's `cat` and `echo`, count as one.
        assert_eq!(state_after(&[OPEN, WRITE, CLOSE]), (false, true, false));
    }
}
