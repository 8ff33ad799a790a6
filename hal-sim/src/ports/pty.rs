//! A line reached by a pseudo terminal, which programs take for a serial port.
//!
//! A pty never has parity. Some C libraries (Debian's is one) report `EINVAL` when parity was asked
//! for and nothing else has changed: when a plain pty is opened for the second time, or when a program
//! sets its port in two steps. So two flags without any effect on raw characters, which serial programs
//! clear, wait there to be changed: `ECHOE` and `IEXTEN`. They are set when nobody has the pty open,
//! and again a moment after somebody has cleared them, together with the other value of a third one
//! (`ECHOK`), because the C library compares what was before with what it finds after that. A program
//! that takes its second step within that moment still gets `EINVAL`.

use std::ffi::OsStr;
use std::fmt;
use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use rustix::event::epoll::EventFlags;
use rustix::fs::{OFlags, inotify};
use rustix::pty::OpenptFlags;
use rustix::termios::{
    ControlModes, LocalModes, OptionalActions, OutputModes, QueueSelector, tcflush, tcgetattr, tcsetattr,
};
use standin_sim::bench::{Bench, Bus, Client};
use standin_sim::bus::Sender;
use tracing::{info, warn};

use super::link::Link;
use super::unread::{MOST_MIB, Unread};
use super::{Came, End, ROOM, interest, may_read, read_some};

/// A pty of a line.
pub(super) struct Pty {
    master: OwnedFd,
    path: PathBuf,
    _link: Option<Link>,
    /// Its watch among the openings.
    watch: i32,
    bus: Bus,
    /// Who talks there, while somebody has it open.
    client: Option<Client>,
    /// How many have it open, as far as is known.
    openers: u32,
    /// The present value of [`OTHER`].
    other: bool,
    /// What the drives sent and nobody has taken.
    unread: Unread,
    /// The settings that were last warned of; many programs open a port for each request.
    warned: Option<Sender>,
}

/// The flags that wait to be changed.
const WAITING: LocalModes = LocalModes::ECHOE.union(LocalModes::IEXTEN);

/// The flag that makes them different each time.
const OTHER: LocalModes = LocalModes::ECHOK;

/// Time between two looks at the settings of an open pty, which does not tell when they change.
const LOOK: Duration = Duration::from_millis(10);

/// Why there is no pty.
#[derive(Debug)]
pub(crate) enum PtyError {
    /// The system gives none.
    None(io::Error),
    /// Its link cannot be made.
    Link(PathBuf, io::Error),
}

impl fmt::Display for PtyError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::None(error) => write!(f, "the system gives no pty: {error}"),
            Self::Link(path, error) => write!(f, "pty: cannot be linked at {}: {error}", path.display()),
        }
    }
}

impl Pty {
    /// A new pty of `bus`, linked at `link`, whose openings `openings` tells.
    ///
    /// # Errors
    /// There is none to be had, or no link to be made.
    pub(super) fn new(bus: Bus, link: Option<PathBuf>, openings: &OwnedFd) -> Result<Self, PtyError> {
        let (master, path) = open().map_err(PtyError::None)?;
        let watch = inotify::add_watch(
            openings,
            &path,
            inotify::WatchFlags::OPEN | inotify::WatchFlags::CLOSE_WRITE | inotify::WatchFlags::CLOSE_NOWRITE,
        );
        let watch = watch.map_err(|error| PtyError::None(error.into()))?;
        let link =
            link.map(|link| Link::new(link.clone(), &path).map_err(|error| PtyError::Link(link, error)));
        let link = link.transpose()?;
        let pty = Self {
            master,
            path,
            _link: link,
            watch,
            bus,
            client: None,
            openers: 0,
            other: false,
            unread: Unread::default(),
            warned: None,
        };
        pty.reset().map_err(PtyError::None)?;
        Ok(pty)
    }

    /// The name of the other end.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Its watch among the openings.
    pub(super) fn watch(&self) -> i32 {
        self.watch
    }

    /// Whether somebody is there of whom no more is read.
    fn is_full(&self, bench: &Bench) -> bool {
        self.client.is_some_and(|client| !may_read(bench, client, &self.unread))
    }

    /// The last one has left, and nobody inherits what he left behind.
    fn clear(&mut self, bench: &mut Bench) {
        self.leave(bench);
        if let Err(error) = self.reset() {
            warn!("{} cannot be made ready again: {error}", self.path.display());
        }
    }

    fn arrive(&mut self, bench: &mut Bench) {
        info!("{} is opened", self.path.display());
        self.client = Some(bench.connect(self.bus));
        bench.attach(self.bus, true);
    }

    /// Sets the flags that wait to be changed, if somebody has cleared them.
    fn keep_waiting(&mut self) -> io::Result<()> {
        let mut settings = tcgetattr(&self.master)?;
        if !settings.local_modes.contains(WAITING) {
            self.other = !self.other;
            settings.local_modes.insert(WAITING);
            settings.local_modes.set(OTHER, self.other);
            tcsetattr(&self.master, OptionalActions::Now, &settings)?;
        }
        Ok(())
    }

    /// Empties both queues and puts the flags that no opener is to care for into the state that the
    /// next one needs. All others are his, and he may be there already.
    fn reset(&self) -> io::Result<()> {
        tcflush(&self.master, QueueSelector::IOFlush)?;
        let mut settings = tcgetattr(&self.master)?;
        settings.local_modes.remove(LocalModes::ECHO | LocalModes::ICANON);
        settings.local_modes.insert(WAITING);
        settings.local_modes.set(OTHER, self.other);
        settings.output_modes.remove(OutputModes::OPOST);
        // Only so the replies go that have reached the other end.
        tcsetattr(&self.master, OptionalActions::Flush, &settings)?;
        Ok(())
    }

    /// The settings of the other end. Whether there is parity at all, and 7 data bits, a pty does
    /// not tell.
    fn sender(&mut self, bench: &Bench) -> Sender {
        let Ok(settings) = tcgetattr(&self.master) else { return Sender::default() };
        let control = settings.control_modes;
        let sender = Sender {
            baud: Some(settings.output_speed()),
            stop: Some(if control.contains(ControlModes::CSTOPB) { 2 } else { 1 }),
            odd: Some(control.contains(ControlModes::PARODD)),
        };
        let line = bench.line(self.bus);
        if !sender.fits(line) && self.warned != Some(sender) {
            self.warned = Some(sender);
            warn!(
                "{} is open with {} baud, {} stop bits, odd parity {}; the drive's line is {line}",
                self.path.display(),
                settings.output_speed(),
                sender.stop.unwrap_or(1),
                if sender.odd == Some(true) { "on" } else { "off" },
            );
        }
        sender
    }
}

impl End for Pty {
    fn client(&self) -> Option<Client> {
        self.client
    }

    fn fd(&self) -> Option<BorrowedFd<'_>> {
        Some(self.master.as_fd())
    }

    /// A pty that nobody has open is always "ready", so it is left to the openings then.
    fn interest(&self, bench: &Bench) -> Option<EventFlags> {
        self.client.map(|client| interest(may_read(bench, client, &self.unread), &self.unread))
    }

    fn take(&mut self, bench: &mut Bench, ready: EventFlags, manual: bool) -> bool {
        let Some(client) = self.client else { return false };
        self.look(bench);
        if !ready.intersects(EventFlags::IN | EventFlags::HUP | EventFlags::ERR) {
            return false;
        }
        let gone = ready.contains(EventFlags::HUP);
        let mut said = false;
        // Of somebody who is gone all is taken at once, lest the next one adds to it.
        loop {
            // Where time waits the line can take it all.
            if self.is_full(bench) && !(manual && said) {
                // `HUP` is told unasked: he sent more than the line can take.
                self.clear(bench);
                return said;
            }
            let mut room = ROOM;
            match read_some(&self.master, &mut room) {
                Came::Bytes(bytes) => {
                    let sender = self.sender(bench);
                    bench.send_from(client, bytes, sender);
                    said = true;
                    if !gone {
                        return said;
                    }
                }
                Came::End => {
                    self.clear(bench);
                    return said;
                }
                Came::Nothing => return said,
            }
        }
    }

    fn deliver(&mut self, bench: &mut Bench) -> bool {
        let Some(client) = self.client else { return false };
        self.unread.receive(bench, client);
        // A failure here is the other end going away, which the next read tells.
        let _ = self.unread.write(&self.master);
        // As on a real port, what is not read in time is lost.
        if self.unread.lose() {
            warn!(
                "{} is left with more than {MOST_MIB} MiB unread; what follows is lost",
                self.path.display()
            );
        }
        false
    }

    /// An open pty does not tell when its settings change; while nobody is there nobody changes them.
    fn pause(&self) -> Option<Duration> {
        self.client.map(|_| LOOK)
    }

    fn look(&mut self, _bench: &mut Bench) {
        if let Err(error) = self.keep_waiting() {
            warn!("the settings of {} cannot be kept: {error}", self.path.display());
        }
    }

    /// Whether anybody is there at all the next read tells for certain; what is seen here only is
    /// somebody who leaves and comes back between two looks.
    fn opened_or_closed(&mut self, bench: &mut Bench, events: inotify::ReadFlags) {
        if events.contains(inotify::ReadFlags::OPEN) {
            if self.openers == 0 {
                if self.is_full(bench) {
                    self.clear(bench);
                }
                self.leave(bench);
            }
            if self.client.is_none() {
                self.arrive(bench);
            }
            self.openers += 1;
        } else if events.intersects(inotify::ReadFlags::CLOSE_WRITE | inotify::ReadFlags::CLOSE_NOWRITE) {
            self.openers = self.openers.saturating_sub(1);
        }
    }

    fn leave(&mut self, bench: &mut Bench) {
        if let Some(client) = self.client.take() {
            info!("{} is left", self.path.display());
            bench.disconnect(client);
            bench.attach(self.bus, false);
        }
        self.openers = 0;
        self.unread.clear();
    }
}

/// A new pty: its master, and the name of the other end.
fn open() -> io::Result<(OwnedFd, PathBuf)> {
    let flags = OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC;
    let master = rustix::pty::openpt(flags)?;
    rustix::pty::grantpt(&master)?;
    rustix::pty::unlockpt(&master)?;
    set_nonblocking(&master)?;
    let path = rustix::pty::ptsname(&master, Vec::new())?;
    Ok((master, PathBuf::from(OsStr::from_bytes(path.as_bytes()))))
}

fn set_nonblocking(fd: impl AsFd) -> io::Result<()> {
    let flags = rustix::fs::fcntl_getfl(&fd)?;
    Ok(rustix::fs::fcntl_setfl(&fd, flags | OFlags::NONBLOCK)?)
}
