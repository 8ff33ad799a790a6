//! Waiting for many descriptors at once, and for a timer, the alarm.
//!
//! The system keeps the list of descriptors, so a wake-up costs time only for the descriptors that are ready.
//! The alarm is a descriptor, too, because a timer has a resolution of nanoseconds, which `epoll_wait` does
//! not have everywhere. An alarm that does not change needs no system call (HOST-1).

use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::time::Duration;

use rustix::event::Timespec;
use rustix::event::epoll::{self, CreateFlags, Event, EventData, EventFlags};
use rustix::io::Errno;

use super::timer;

/// Maximum number of ready descriptors per wait. Further ones are reported by the next wait.
const READY: usize = 256;

/// Number of the alarm. No descriptor has this number.
const ALARM: u64 = 0;

/// Descriptors to wait for, each identified by a number, and the alarm, a timer that ends the wait.
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
        // Edge-triggered: an expiry is reported once, and the timer need not be read.
        poller.add(ALARM, &poller.alarm, EventFlags::IN | EventFlags::ET)?;
        Ok(poller)
    }

    /// Adds `fd` and waits for the events `interest`; errors and hang-ups are always reported.
    ///
    /// # Errors
    /// The system cannot wait for this descriptor.
    pub(super) fn add(&self, number: u64, fd: impl AsFd, interest: EventFlags) -> io::Result<()> {
        Ok(epoll::add(&self.epoll, fd, EventData::new_u64(number), interest)?)
    }

    /// Changes the events of `fd`.
    ///
    /// # Errors
    /// The system cannot wait for this descriptor.
    pub(super) fn change(&self, number: u64, fd: impl AsFd, interest: EventFlags) -> io::Result<()> {
        Ok(epoll::modify(&self.epoll, fd, EventData::new_u64(number), interest)?)
    }

    /// Removes `fd`.
    ///
    /// # Errors
    /// The descriptor was not added.
    pub(super) fn remove(&self, fd: impl AsFd) -> io::Result<()> {
        Ok(epoll::delete(&self.epoll, fd)?)
    }

    /// Sets the alarm to expire after `left`, which must not be zero; `None` disables the alarm.
    pub(super) fn set_alarm(&self, left: Option<Duration>) {
        timer::start_once(&self.alarm, left.unwrap_or_default());
    }

    /// Sleeps until a descriptor is ready or the alarm expires. With `at_once` it does not sleep.
    ///
    /// # Errors
    /// The system cannot wait for events.
    pub(super) fn wait(&mut self, at_once: bool) -> io::Result<()> {
        const AT_ONCE: Timespec = Timespec { tv_sec: 0, tv_nsec: 0 };
        self.ready.clear();
        let room = rustix::buffer::spare_capacity(&mut self.ready);
        match epoll::wait(&self.epoll, room, at_once.then_some(&AT_ONCE)) {
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
