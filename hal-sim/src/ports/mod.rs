//! Where the lines of a bench are reached from outside: ptys and TCP ports.
//!
//! All descriptors are non-blocking and belong to the bench's thread. [`Ports::watch`] says what to
//! wait for, [`Ports::take`] takes what has come, [`Ports::deliver`] hands out what the drives sent.
//! Nobody is waited for: a client that does not read loses its connection (TCP) or its characters
//! (pty), and one that sends faster than its line is read only as fast as the line.

mod link;
mod pty;
mod tcp;

use std::io;
use std::os::fd::OwnedFd;
use std::path::PathBuf;
use std::time::Duration;

use rustix::event::{PollFd, PollFlags};
use rustix::fs::inotify;
use standin_firmware::device::Instant;
use standin_sim::bench::{Bench, Bus, Client};

pub(crate) use link::check_link;
pub(crate) use pty::PtyError;
pub(crate) use tcp::{Bound, bind};

/// Bytes read from a client at once.
const READ_BYTES: usize = 4096;

/// Bytes of a client that may wait for the line before it is read no further.
const BACKLOG_BYTES: usize = 4096;

/// Bytes that may wait for a client that does not read.
const UNREAD_BYTES: usize = 64 << 10;

/// All ports of a bench.
pub(crate) struct Ports {
    tcp: Vec<tcp::Listener>,
    ptys: Vec<pty::Pty>,
    /// Tells who opens a pty.
    openings: OwnedFd,
}

impl Ports {
    /// No port yet.
    ///
    /// # Errors
    /// The system gives no inotify instance.
    pub(crate) fn new() -> io::Result<Self> {
        let openings = inotify::init(inotify::CreateFlags::NONBLOCK | inotify::CreateFlags::CLOEXEC)?;
        Ok(Self { tcp: Vec::new(), ptys: Vec::new(), openings })
    }

    /// Reaches `bus` by a TCP port, from now on; returns its URI.
    ///
    /// # Errors
    /// The system refuses to listen.
    pub(crate) fn add_tcp(&mut self, bus: Bus, bound: Bound) -> io::Result<String> {
        let listener = tcp::Listener::new(bus, bound)?;
        let uri = format!("tcp:{}", listener.address());
        self.tcp.push(listener);
        Ok(uri)
    }

    /// Reaches `bus` by a new pty, linked at `link`; returns its path.
    ///
    /// # Errors
    /// There is no pty to be had, or no link to be made.
    pub(crate) fn add_pty(&mut self, bus: Bus, link: Option<PathBuf>) -> Result<PathBuf, PtyError> {
        let pty = pty::Pty::new(bus, link, &self.openings)?;
        let path = pty.path().to_owned();
        self.ptys.push(pty);
        Ok(path)
    }

    /// What to wait for. [`take`](Self::take) gets the answers in the same order.
    pub(crate) fn watch<'a>(&'a self, bench: &Bench, fds: &mut Vec<PollFd<'a>>) {
        fds.push(PollFd::new(&self.openings, PollFlags::IN));
        for pty in &self.ptys {
            pty.watch(bench, fds);
        }
        for listener in &self.tcp {
            listener.watch(bench, fds);
        }
    }

    /// When a port wants to be looked at though nothing comes.
    pub(crate) fn deadline(&self) -> Instant {
        self.tcp.iter().map(tcp::Listener::deadline).min().unwrap_or(Instant::NEVER)
    }

    /// How soon a port wants to be looked at in any case, as the wall clock counts.
    pub(crate) fn next_look(&self) -> Option<Duration> {
        self.ptys.iter().filter_map(pty::Pty::next_look).min()
    }

    /// Takes what has come. In manual time one request is over before the next one is looked at.
    pub(crate) fn take(&mut self, bench: &mut Bench, ready: &[PollFlags], manual: bool) {
        let mut ready = ready.iter().copied();
        let opened = ready.next().is_some_and(|ready| !ready.is_empty());
        let mut of_pty = |pty: &pty::Pty| if pty.is_open() { ready.next() } else { None };
        let of_ptys: Vec<_> = self.ptys.iter().map(|pty| of_pty(pty).unwrap_or(PollFlags::empty())).collect();
        // What somebody sent who came a moment ago is his, not his predecessor's.
        if opened {
            self.note_openings(bench);
        }
        for (pty, ready) in self.ptys.iter_mut().zip(of_ptys) {
            pty.take(bench, ready, manual);
        }
        for listener in &mut self.tcp {
            listener.take(bench, &mut ready, manual);
        }
    }

    /// Hands out what the drives have sent by now.
    pub(crate) fn deliver(&mut self, bench: &mut Bench) {
        for pty in &mut self.ptys {
            pty.deliver(bench);
        }
        for listener in &mut self.tcp {
            listener.deliver(bench);
        }
    }

    /// Tells each pty who opened or left it.
    fn note_openings(&mut self, bench: &mut Bench) {
        let mut buffer = [std::mem::MaybeUninit::uninit(); 1024];
        let mut events = inotify::Reader::new(&self.openings, &mut buffer);
        while let Ok(event) = events.next() {
            if let Some(pty) = self.ptys.iter_mut().find(|pty| pty.is_watched_by(event.wd())) {
                pty.opened_or_closed(bench, event.events());
            }
        }
    }
}

/// Whether a client may be read further.
fn may_read(bench: &Bench, client: Client, unread: &[u8]) -> bool {
    bench.backlog(client) < BACKLOG_BYTES && unread.len() < BACKLOG_BYTES
}

/// What has come is taken: in manual time it has its whole effect now.
fn over(bench: &mut Bench, manual: bool) {
    if manual {
        bench.settle();
    }
}

/// Writes as much of `bytes` as the other end takes now, and removes it.
fn write_some(to: impl std::os::fd::AsFd, bytes: &mut Vec<u8>) -> io::Result<()> {
    while !bytes.is_empty() {
        match rustix::io::write(&to, bytes) {
            Ok(written) => drop(bytes.drain(..written)),
            Err(rustix::io::Errno::AGAIN) => break,
            Err(rustix::io::Errno::INTR) => {}
            Err(error) => return Err(error.into()),
        }
    }
    Ok(())
}

/// What a read from a client brought.
enum Came {
    /// So many bytes.
    Bytes(usize),
    /// Nothing for now.
    Nothing,
    /// The other end is gone.
    End,
}

/// Reads what is there.
fn read_some(from: impl std::os::fd::AsFd, buffer: &mut [u8]) -> Came {
    match rustix::io::read(from, buffer) {
        Ok(0) => Came::End,
        Ok(count) => Came::Bytes(count),
        Err(rustix::io::Errno::AGAIN | rustix::io::Errno::INTR) => Came::Nothing,
        // Of a pty that nobody has open, or of a broken connection.
        Err(_) => Came::End,
    }
}
