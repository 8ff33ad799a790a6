//! Waiting for many descriptors at once, and for an alarm.
//!
//! The system keeps the list of what is waited for, so a wake-up costs what is ready and not what is
//! there. The alarm is one of them, because a timer counts in nanoseconds, which `epoll_wait` does not
//! everywhere, and needs no word while it stays (HOST-1).

use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::time::Duration;

use rustix::event::Timespec;
use rustix::event::epoll::{self, CreateFlags, Event, EventData, EventFlags};
use rustix::io::Errno;

use super::timer;

/// Descriptors that may be ready at once; the others come next time.
const READY: usize = 256;

/// Number of the alarm; no descriptor has it.
const ALARM: u64 = 0;

/// Descriptors that are waited for, each by a number.
pub(super) struct Poller {
    epoll: OwnedFd,
    alarm: OwnedFd,
    ready: Vec<Event>,
}

impl Poller {
    /// A poller without descriptors.
    ///
    /// # Errors
    /// The system gives no epoll instance or timer.
    pub(super) fn new() -> io::Result<Self> {
        let poller = Self {
            epoll: epoll::create(CreateFlags::CLOEXEC)?,
            alarm: timer::new()?,
            ready: Vec::with_capacity(READY),
        };
        // Edge-triggered: it is reported once and needs no read.
        poller.add(ALARM, &poller.alarm, EventFlags::IN | EventFlags::ET)?;
        Ok(poller)
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

    /// The alarm rings when `left`, which is not zero, has passed, and not when it was to before; never if `None`.
    pub(super) fn set_alarm(&self, left: Option<Duration>) {
        timer::ring_after(&self.alarm, left.unwrap_or_default());
    }

    /// Sleeps until something is ready, or the alarm rings; not at all if it `looks` only.
    ///
    /// # Errors
    /// The system does not let it wait.
    pub(super) fn wait(&mut self, looks: bool) -> io::Result<()> {
        const AT_ONCE: Timespec = Timespec { tv_sec: 0, tv_nsec: 0 };
        self.ready.clear();
        let room = rustix::buffer::spare_capacity(&mut self.ready);
        match epoll::wait(&self.epoll, room, looks.then_some(&AT_ONCE)) {
            Ok(_) | Err(Errno::INTR) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }

    /// Descriptors that became ready in the last wait, and their events.
    pub(super) fn ready(&self) -> impl Iterator<Item = (u64, EventFlags)> {
        let ready = self.ready.iter().map(|event| {
            let (data, flags) = (event.data, event.flags);
            (data.u64(), flags)
        });
        ready.filter(|&(number, _)| number != ALARM)
    }
}
