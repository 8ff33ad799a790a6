//! Timers that wake whoever waits, again and again.

use std::io;
use std::os::fd::OwnedFd;
use std::time::Duration;

use rustix::event::Timespec;
use rustix::time::{Itimerspec, TimerfdClockId, TimerfdFlags, TimerfdTimerFlags};

/// A timer that stands.
///
/// # Errors
/// The system gives none.
pub(super) fn new() -> io::Result<OwnedFd> {
    let flags = TimerfdFlags::NONBLOCK | TimerfdFlags::CLOEXEC;
    Ok(rustix::time::timerfd_create(TimerfdClockId::Monotonic, flags)?)
}

/// Tells from now on whenever `pause` has passed.
pub(super) fn start(timer: &OwnedFd, pause: Duration) {
    set(timer, pause);
}

/// Tells nothing more.
pub(super) fn stop(timer: &OwnedFd) {
    set(timer, Duration::ZERO);
}

/// What it has told is heard.
pub(super) fn hear(timer: &OwnedFd) {
    // There is nothing to be read if it was stopped in between.
    let _ = rustix::io::read(timer, &mut [0; 8]);
}

fn set(timer: &OwnedFd, pause: Duration) {
    let pause = Timespec {
        tv_sec: pause.as_secs().try_into().unwrap_or(i64::MAX),
        tv_nsec: pause.subsec_nanos().into(),
    };
    let every = Itimerspec { it_interval: pause, it_value: pause };
    // It fails for times that are none.
    let _ = rustix::time::timerfd_settime(timer, TimerfdTimerFlags::empty(), &every);
}
