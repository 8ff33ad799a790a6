//! Timers: one-shot and periodic.

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
    set(timer, pause, pause);
}

/// Tells once that `left` has passed; never if it is zero.
pub(super) fn ring_after(timer: &OwnedFd, left: Duration) {
    set(timer, left, Duration::ZERO);
}

/// Tells nothing more.
pub(super) fn stop(timer: &OwnedFd) {
    set(timer, Duration::ZERO, Duration::ZERO);
}

/// Clears an expiry, after which the timer's descriptor is not readable.
pub(super) fn hear(timer: &OwnedFd) {
    // There is nothing to be read if it was stopped in between.
    let _ = rustix::io::read(timer, &mut [0; 8]);
}

fn set(timer: &OwnedFd, first: Duration, pause: Duration) {
    let times = Itimerspec { it_interval: timespec(pause), it_value: timespec(first) };
    // It fails for times that are none.
    let _ = rustix::time::timerfd_settime(timer, TimerfdTimerFlags::empty(), &times);
}

fn timespec(span: Duration) -> Timespec {
    Timespec { tv_sec: span.as_secs().try_into().unwrap_or(i64::MAX), tv_nsec: span.subsec_nanos().into() }
}
