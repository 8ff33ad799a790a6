//! Waiting for many descriptors at once.
//!
//! The system keeps the list of what is waited for, so a wake-up costs what is ready and not what is
//! there. `ppoll` sleeps, because it counts in nanoseconds everywhere; `epoll_wait` then tells who is ready.

use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::time::Duration;

use rustix::event::epoll::{self, CreateFlags, Event, EventData, EventFlags};
use rustix::event::{PollFd, PollFlags, Timespec};
use rustix::io::Errno;

/// How many may be ready at once; the others are next time.
const READY: usize = 256;

/// Descriptors that are waited for, each by a number.
pub(super) struct Watch {
    epoll: OwnedFd,
    ready: Vec<Event>,
}

impl Watch {
    /// Nothing to wait for yet.
    ///
    /// # Errors
    /// The system gives no epoll instance.
    pub(super) fn new() -> io::Result<Self> {
        Ok(Self { epoll: epoll::create(CreateFlags::CLOEXEC)?, ready: Vec::with_capacity(READY) })
    }

    /// Waits for `interest` of `fd`, too; errors and the end of the other side are told unasked.
    ///
    /// # Errors
    /// The system cannot wait for that.
    pub(super) fn add(&self, number: u64, fd: impl AsFd, interest: EventFlags) -> io::Result<()> {
        Ok(epoll::add(&self.epoll, fd, EventData::new_u64(number), interest)?)
    }

    /// Waits for something else of `fd` from now on.
    ///
    /// # Errors
    /// The system cannot wait for that.
    pub(super) fn change(&self, number: u64, fd: impl AsFd, interest: EventFlags) -> io::Result<()> {
        Ok(epoll::modify(&self.epoll, fd, EventData::new_u64(number), interest)?)
    }

    /// Does not wait for `fd` any more.
    ///
    /// # Errors
    /// The system did not.
    pub(super) fn remove(&self, fd: impl AsFd) -> io::Result<()> {
        Ok(epoll::delete(&self.epoll, fd)?)
    }

    /// Sleeps until something is ready, or for `timeout`.
    ///
    /// # Errors
    /// The system does not let it wait.
    pub(super) fn wait(&mut self, timeout: Option<Duration>) -> io::Result<()> {
        self.ready.clear();
        let timeout = timeout.map(|left| Timespec {
            tv_sec: left.as_secs().try_into().unwrap_or(i64::MAX),
            tv_nsec: left.subsec_nanos().into(),
        });
        let mut fds = [PollFd::new(&self.epoll, PollFlags::IN)];
        match rustix::event::poll(&mut fds, timeout.as_ref()) {
            Ok(0) | Err(Errno::INTR) => return Ok(()),
            Ok(_) => {}
            Err(error) => return Err(error.into()),
        }
        let at_once = Timespec { tv_sec: 0, tv_nsec: 0 };
        match epoll::wait(&self.epoll, rustix::buffer::spare_capacity(&mut self.ready), Some(&at_once)) {
            Ok(_) | Err(Errno::INTR) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }

    /// Who is ready since the last time, and what for.
    pub(super) fn ready(&self) -> impl Iterator<Item = (u64, EventFlags)> {
        self.ready.iter().map(|event| {
            let (data, flags) = (event.data, event.flags);
            (data.u64(), flags)
        })
    }
}
