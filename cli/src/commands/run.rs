//! `drivetwin run` and `drivetwin attach`: run a drive, a bench of several drives, or a board until a signal ends it.

use std::fs;
use std::io::{self, Write as _};
use std::os::unix::net::UnixStream;

use drivetwin_host::Configuration;
use rustix::event::{PollFd, PollFlags, poll};
use rustix::io::retry_on_intr;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use signal_hook::consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM};

use crate::args::{Attach, Run};
use crate::log;

/// Runs a drive or a bench of several drives until a signal ends it.
///
/// # Errors
/// One sentence that names the option or file, and the error.
pub(crate) fn run(arguments: Run) -> Result<(), String> {
    raise_limit_of_descriptors();
    let (json, view) = (arguments.json, arguments.view);
    let configuration = Configuration::read(arguments.into())?;
    if json && configuration.uses_stdio() {
        return Err("--json and stdio: cannot share stdout; use one of them".into());
    }
    if view && configuration.uses_stdio() {
        return Err("--view and stdio: cannot share the terminal; use one of them".into());
    }
    let uses_stdio = configuration.uses_stdio();
    let prepared = configuration.prepare()?;
    // Caught from here on, because clients may connect as soon as the ports are open.
    let stop = signals().map_err(|error| format!("signals cannot be caught: {error}"))?;
    let running = prepared.open()?;
    if view {
        return super::view::serve(running, stop);
    }
    let banner = if json { running.json()? } else { running.text() };
    if uses_stdio {
        // A serial line uses stdout.
        log::write_line(banner.as_bytes());
    } else {
        print(banner, &stop).map_err(|error| format!("stdout cannot be written: {error}"))?;
    }
    running.serve(&stop)
}

/// Attaches a board until a signal ends it.
///
/// # Errors
/// One sentence that names the place, the option or the file, and the error.
pub(crate) fn attach(arguments: Attach) -> Result<(), String> {
    let json = arguments.json;
    let stop = signals().map_err(|error| format!("signals cannot be caught: {error}"))?;
    let running = drivetwin_host::attach(arguments.into())?;
    let banner = if json { running.json()? } else { running.text() };
    print(banner, &stop).map_err(|error| format!("stdout cannot be written: {error}"))?;
    running.serve(&stop)
}

/// Prints the banner. Returns when the banner is written or a signal arrives, whichever is first.
fn print(text: String, stop: &UnixStream) -> io::Result<()> {
    let (written, writes) = UnixStream::pair()?;
    let writer = std::thread::spawn(move || {
        let mut stdout = io::stdout();
        let result = stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush());
        // Closing this end wakes the thread that polls the other end.
        drop(writes);
        result
    });
    let mut both = [PollFd::new(&written, PollFlags::IN), PollFd::new(stop, PollFlags::IN)];
    retry_on_intr(|| poll(&mut both, None))?;
    if both[0].revents().is_empty() { Ok(()) } else { writer.join().unwrap_or(Ok(())) }
}

/// Raises the limit of file descriptors: a bench may have thousands of ports, and the usual limit is 1,024.
fn raise_limit_of_descriptors() {
    let Rlimit { maximum, .. } = getrlimit(Resource::Nofile);
    // An error is ignored here: a later lack of descriptors is reported where it occurs.
    let _ = setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum });
}

/// A stream that becomes readable when a signal ends the program: Ctrl-C, SIGTERM, a closed terminal, or
/// Ctrl-\. SIGHUP and SIGQUIT stay ignored if the parent process ignores them (`nohup`, a shell).
pub(super) fn signals() -> io::Result<UnixStream> {
    let (stop, caught) = UnixStream::pair()?;
    let ignored = ignored();
    for signal in [SIGINT, SIGTERM, SIGHUP, SIGQUIT] {
        let is_ignored = [SIGHUP, SIGQUIT].contains(&signal) && ignored >> (signal - 1) & 1 == 1;
        if !is_ignored {
            signal_hook::low_level::pipe::register(signal, caught.try_clone()?)?;
        }
    }
    Ok(stop)
}

/// Signals that were ignored at the start of the program, with signal 1 in bit 0; 0 if the system does not
/// report them.
fn ignored() -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0)
}
