//! Timers: one-shot and periodic.

use std::io;
use std::os::fd::OwnedFd;
use std::time::Duration;

use rustix::event::Timespec;
use rustix::time::{Itimerspec, TimerfdClockId, TimerfdFlags, TimerfdTimerFlags};

/// A stopped timer.
///
/// # Errors
/// The system gives no timer.
pub(super) fn new() -> io::Result<OwnedFd> {
    let flags = TimerfdFlags::NONBLOCK | TimerfdFlags::CLOEXEC;
    Ok(rustix::time::timerfd_create(TimerfdClockId::Monotonic, flags)?)
}

/// Starts a timer that expires after every `pause`.
pub(super) fn start(timer: &OwnedFd, pause: Duration) {
    set(timer, pause, pause);
}

/// Starts a timer that expires once, after `left`. If `left` is zero, the timer never expires.
pub(super) fn start_once(timer: &OwnedFd, left: Duration) {
    set(timer, left, Duration::ZERO);
}

/// Stops a timer.
pub(super) fn stop(timer: &OwnedFd) {
    set(timer, Duration::ZERO, Duration::ZERO);
}

/// Acknowledges an expiry, so that the timer's descriptor is no longer readable.
pub(super) fn acknowledge(timer: &OwnedFd) {
    // The read fails if the timer was stopped since its expiry.
    let _ = rustix::io::read(timer, &mut [0; 8]);
}

fn set(timer: &OwnedFd, first: Duration, pause: Duration) {
    let times = Itimerspec { it_interval: timespec(pause), it_value: timespec(first) };
    // The call fails only for invalid times.
    let _ = rustix::time::timerfd_settime(timer, TimerfdTimerFlags::empty(), &times);
}

fn timespec(span: Duration) -> Timespec {
    Timespec { tv_sec: span.as_secs().try_into().unwrap_or(i64::MAX), tv_nsec: span.subsec_nanos().into() }
}
