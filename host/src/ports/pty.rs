//! A serial line that programs reach through a pseudo terminal, which they use like a serial port.
//!
//! A pty never has parity. Some C libraries (for example Debian's) report `EINVAL` if a program requested
//! parity and no other setting has changed. That happens when an unmodified pty is opened for the second
//! time, or when a program configures its port in two steps. Therefore two flags are kept set that serial
//! programs clear and that have no effect on raw characters: `ECHOE` and `IEXTEN`. They are set while no
//! program has the pty open, and again shortly after a program has cleared them. A third flag (`ECHOK`) is
//! toggled with them, because the C library compares the settings before and after. A program that takes its
//! second step earlier still gets `EINVAL` (HOST-2).
//!
//! A program may open a pty before the bench notices that the previous program closed it. The bytes of both
//! are then in one queue. Therefore nothing of that queue is dropped: it is read to its end, and [`Openings`]
//! determine the sender of each byte.

use std::cell::RefCell;
use std::ffi::OsStr;
use std::fmt;
use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::time::Duration;

use drivetwin_firmware::device::Line;
use drivetwin_protocol::line::Parity;
use drivetwin_protocol::modbus::{Expect, Scan, ascii, rtu};
use drivetwin_sim::bench::{Bench, Bus, Client};
use drivetwin_sim::line::{PortParity, Sender};
use rustix::event::epoll::EventFlags;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::OFlags;
use rustix::pty::{OpenptFlags, ioctl_tiocgptpeer};
use rustix::termios::{
    Action, ControlModes, InputModes, LocalModes, OptionalActions, OutputModes, QueueSelector, tcflow,
    tcflush, tcgetattr, tcsetattr,
};
use tracing::{error, info, warn};

use super::pty_link::Link;
use super::pty_openings::{Openers, Openings};
use super::unread::{MOST_MIB, Unread};
use super::{Endpoint, READ_BYTES, ROOM, ReadResult, interest, may_read, note_arrival, read_some};
use crate::clock::Clock;

/// A pty connected to a line.
pub(super) struct Pty {
    master: OwnedFd,
    path: PathBuf,
    link: Option<Link>,
    openings: Rc<RefCell<Openings>>,
    /// The inotify watch of the pty.
    watch: i32,
    bus: Bus,
    /// Baud rate of the drive at the last update of the pty.
    baud: u32,
    /// The client, while a program has the pty open.
    client: Option<Client>,
    openers: Openers,
    /// The present value of the toggled flag [`OTHER`].
    other: bool,
    /// Characters that the drives sent and that no program has read.
    unread: Unread,
    /// The settings of the last warning. Many programs open a port for each request, and would be warned each
    /// time.
    warned: Option<Sender>,
}

/// Flags that are kept set.
const WAITING: LocalModes = LocalModes::ECHOE.union(LocalModes::IEXTEN);

/// The flag that is toggled whenever the flags of [`WAITING`] are set.
const OTHER: LocalModes = LocalModes::ECHOK;

/// Flags for line editing and special keys of a terminal. A serial port has no such functions.
const COOKED: LocalModes = LocalModes::ECHO.union(LocalModes::ICANON).union(LocalModes::ISIG);

/// Flags that change, drop or delay characters of a drive.
const CHANGING: InputModes = InputModes::ICRNL
    .union(InputModes::INLCR)
    .union(InputModes::IGNCR)
    .union(InputModes::ISTRIP)
    .union(InputModes::IXON);

/// More bytes than the system can buffer from programs that have closed the pty.
const ALL: usize = 128 << 10;

/// Poll interval of the settings of an open pty. The system does not report when they change.
const POLL_INTERVAL: Duration = Duration::from_millis(10);

/// Reason why there is no pty.
#[derive(Debug)]
pub(crate) enum PtyError {
    /// The system gives no pty.
    None(io::Error),
    /// The link at this path cannot be created.
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
    /// A new pty for `bus`, with a symbolic link at `link` and the baud rate of the drive.
    ///
    /// # Errors
    /// The system gives no pty, or the link cannot be made.
    pub(super) fn new(
        bench: &Bench,
        bus: Bus,
        link: Option<PathBuf>,
        openings: Rc<RefCell<Openings>>,
    ) -> Result<Self, PtyError> {
        let (master, path) = open().map_err(PtyError::None)?;
        let mut pty = Self {
            master,
            path,
            link: None,
            openings,
            watch: 0,
            bus,
            baud: 0,
            client: None,
            openers: Openers::default(),
            other: false,
            unread: Unread::default(),
            warned: None,
        };
        pty.reset().and_then(|()| pty.follow(bench)).map_err(PtyError::None)?;
        pty.watch = pty.openings.borrow().watch(&pty.path).map_err(PtyError::None)?;
        let link =
            link.map(|link| Link::new(link.clone(), &pty.path).map_err(|error| PtyError::Link(link, error)));
        pty.link = link.transpose()?;
        Ok(pty)
    }

    /// Path of the end that programs open.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// The inotify watch of the pty.
    pub(super) fn watch(&self) -> i32 {
        self.watch
    }

    /// Returns whether reading from the connected program is suspended.
    fn is_full(&self, bench: &Bench) -> bool {
        self.client.is_some_and(|client| !may_read(bench, client, &self.unread))
    }

    fn connect(&mut self, bench: &mut Bench) {
        info!("{} is opened", self.path.display());
        self.client = Some(bench.connect(self.bus));
        bench.attach(self.bus, true);
    }

    /// Handles new events of openings and closings.
    fn read_openings(&mut self) {
        let events_seen = self.openings.borrow_mut().take(self.watch);
        self.openers.handle(&events_seen);
    }

    /// Reads available bytes until there are at least `most`. Returns whether no program has the pty open.
    fn read(&mut self, bytes: &mut Vec<u8>, most: usize) -> bool {
        while bytes.len() < most {
            let mut room = ROOM;
            match read_some(&self.master, &mut room) {
                ReadResult::Bytes(came) => bytes.extend_from_slice(came),
                ReadResult::Nothing => return false,
                ReadResult::Closed => return true,
            }
        }
        // There may be more bytes than were read.
        self.openers.wrote = true;
        false
    }

    /// Sends new bytes to the bench, and handles openings and closings. `hung_up` is true if the system has
    /// reported that no program has the pty open. Returns whether there was input.
    fn process(&mut self, bench: &mut Bench, hung_up: bool, clock: Option<&Clock>) -> bool {
        self.read_openings();
        if self.client.is_none() {
            if self.openers.changed && self.openers.unseen && !self.openers.left_wrote {
                self.prepare_for_next(true);
            }
            if !self.openers.changed {
                return false;
            }
            self.connect(bench);
            if !self.openers.left_wrote {
                self.openers.note();
            }
        }
        self.poll(bench);
        let full = self.is_full(bench);
        if full && !hung_up && !self.openers.changed {
            return false;
        }
        let (mut bytes, mut was_closed) = (Vec::new(), false);
        loop {
            let changed = self.openers.changed;
            // Writes that are reported by now are read here, unless another program made them.
            let wrote = !changed && std::mem::take(&mut self.openers.wrote);
            was_closed |= self.read(&mut bytes, if hung_up || changed { ALL } else { READ_BYTES });
            self.read_openings();
            if self.openers.changed == changed {
                break;
            }
            self.openers.left_wrote |= wrote;
        }
        let changed = self.openers.changed;
        let (own, next) =
            bytes.split_at(if changed { self.predecessors_bytes(bench, &bytes) } else { bytes.len() });
        // From a program that has left, no more bytes are taken than would have been read while it was
        // connected.
        let most = match (hung_up || changed, full) {
            (true, true) if clock.is_some() => 0,
            (true, false) if clock.is_some() => READ_BYTES,
            _ => own.len(),
        };
        note_arrival(bench, clock);
        self.send(bench, &own[..most.min(own.len())]);
        let left = changed || was_closed;
        if left {
            self.leave(bench);
            self.openers.note();
            self.prepare_for_next(!changed);
        }
        if changed {
            self.connect(bench);
            self.send(bench, next);
        }
        // Another program may have opened the pty since then. What it has written by now is read now, so that
        // it is not taken for bytes of the program before when that one leaves.
        let may_go_on = left && (self.openers.changed || self.openers.wrote);
        (may_go_on && self.process(bench, false, clock)) || !bytes.is_empty()
    }

    /// Number of bytes that belong to the programs that have left, after another program has opened the pty.
    /// If both sides wrote, all bytes before the last message belong to the earlier programs.
    fn predecessors_bytes(&self, bench: &Bench, bytes: &[u8]) -> usize {
        match (self.openers.left_wrote, self.openers.wrote) {
            (false, _) => 0,
            (true, false) => bytes.len(),
            (true, true) => last_message(bench.line(self.bus), bytes),
        }
    }

    fn send(&mut self, bench: &mut Bench, bytes: &[u8]) {
        let Some(client) = self.client.filter(|_| !bytes.is_empty()) else { return };
        let sender = self.sender(bench);
        bench.send_from(client, bytes, sender);
    }

    /// Clears what the last program left: unread replies, stopped output, unsuitable settings. If
    /// `was_closed`, no known program has the pty open, so a program that has it open now is a new one.
    fn prepare_for_next(&mut self, was_closed: bool) {
        let made_ready = self.reset();
        let path = self.path.display();
        match made_ready {
            Err(error) if error.kind() == io::ErrorKind::ResourceBusy => {
                error!(
                    "{path} was left exclusive (TIOCEXCL), so only root can open it; start drivetwin again"
                );
            }
            Err(error) => warn!("{path} cannot be made ready again: {error}"),
            Ok(()) => {}
        }
        // The events include the opening by this process. Therefore the state of the master decides whether a
        // program is connected.
        let mut events = Vec::new();
        loop {
            let is_open = !self.is_left();
            let events_seen = self.openings.borrow_mut().take(self.watch);
            if events_seen.is_empty() {
                return self.openers.set_present(is_open, was_closed, &events);
            }
            events.extend(events_seen);
        }
    }

    /// Returns whether no program has the pty open.
    fn is_left(&self) -> bool {
        let mut master = [PollFd::new(&self.master, PollFlags::empty())];
        let polled = poll(&mut master, Some(&Timespec::default()));
        polled.is_ok() && master[0].revents().contains(PollFlags::HUP)
    }

    /// Drops unread output, resumes stopped output, and restores the flags that the next program relies on. All other
    /// settings belong to the next program, which may be connected already.
    fn reset(&mut self) -> io::Result<()> {
        tcflush(&self.master, QueueSelector::OFlush)?;
        let far = ioctl_tiocgptpeer(&self.master, OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
        tcflow(&far, Action::OOn)?;
        tcflush(&far, QueueSelector::IFlush)?;
        drop(far);
        let settings = tcgetattr(&self.master)?;
        let unfit = settings.local_modes.intersects(COOKED)
            || settings.output_modes.contains(OutputModes::OPOST)
            || settings.input_modes.intersects(CHANGING);
        if unfit {
            let mut settings = settings;
            settings.local_modes.remove(COOKED);
            settings.output_modes.remove(OutputModes::OPOST);
            // Removing IXON resumes output that Ctrl-S has stopped.
            settings.input_modes.remove(CHANGING);
            tcsetattr(&self.master, OptionalActions::Now, &settings)?;
        }
        self.keep_waiting()
    }

    /// Sets the flags of [`WAITING`] again, if a program has cleared them.
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

    /// Sets the pty to the baud rate of the drive, if that has changed.
    fn follow(&mut self, bench: &Bench) -> io::Result<()> {
        let baud = bench.line(self.bus).baud;
        if std::mem::replace(&mut self.baud, baud) != baud {
            let mut settings = tcgetattr(&self.master)?;
            settings.set_speed(baud)?;
            tcsetattr(&self.master, OptionalActions::Now, &settings)?;
        }
        Ok(())
    }

    /// Serial settings of the program. A pty reports neither whether there is parity nor 7 data bits.
    fn sender(&mut self, bench: &Bench) -> Sender {
        let Ok(settings) = tcgetattr(&self.master) else { return Sender::default() };
        let control = settings.control_modes;
        let is_odd = control.contains(ControlModes::PARODD);
        let sender = Sender {
            baud: Some(settings.output_speed()),
            data: None,
            parity: if is_odd { PortParity::Known(Parity::Odd) } else { PortParity::NotOdd },
            stop: Some(if control.contains(ControlModes::CSTOPB) { 2 } else { 1 }),
        };
        let line = bench.line(self.bus);
        if !sender.fits(line) && self.warned != Some(sender) {
            self.warned = Some(sender);
            warn!(
                "{} is open with {} baud, {} stop bits, odd parity {}; the drive's line is {line}",
                self.path.display(),
                settings.output_speed(),
                sender.stop.unwrap_or(1),
                if is_odd { "on" } else { "off" },
            );
        }
        sender
    }
}

impl Endpoint for Pty {
    fn client(&self) -> Option<Client> {
        self.client
    }

    fn fd(&self) -> Option<BorrowedFd<'_>> {
        Some(self.master.as_fd())
    }

    /// Events to wait for, or `None` if no program has the pty open. The system would then always report the
    /// pty as ready; instead the events of [`Openings`] report the next opening.
    fn interest(&self, bench: &Bench) -> Option<EventFlags> {
        self.client.map(|client| interest(may_read(bench, client, &self.unread), &self.unread))
    }

    fn take(&mut self, bench: &mut Bench, ready: EventFlags, clock: Option<&Clock>) -> bool {
        ready.intersects(EventFlags::IN | EventFlags::HUP | EventFlags::ERR)
            && self.process(bench, ready.contains(EventFlags::HUP), clock)
    }

    fn deliver(&mut self, bench: &mut Bench) -> bool {
        let Some(client) = self.client else {
            if let Err(error) = self.follow(bench) {
                warn!("{} cannot have {} baud: {error}", self.path.display(), self.baud);
            }
            return false;
        };
        self.unread.receive(bench, client);
        // If the write fails, the program has left, and the next read reports that.
        let _ = self.unread.write(&self.master);
        // As on a real port, output that is not read in time is lost.
        if self.unread.lose() {
            warn!(
                "{} has more than {MOST_MIB} MiB that no program has read; further output is lost",
                self.path.display()
            );
        }
        false
    }

    /// Returns true while no program has the pty open, because the drive may change its baud rate at any
    /// time.
    fn follows_time(&self) -> bool {
        self.client.is_none()
    }

    /// Interval for checking the settings of an open pty, whose changes the system does not report.
    fn poll_interval(&self) -> Option<Duration> {
        self.client.map(|_| POLL_INTERVAL)
    }

    fn poll(&mut self, _bench: &mut Bench) {
        if let Err(error) = self.keep_waiting() {
            warn!("the settings of {} cannot be kept: {error}", self.path.display());
        }
    }

    fn opened_or_closed(&mut self, bench: &mut Bench, clock: Option<&Clock>) -> bool {
        self.process(bench, false, clock)
    }

    fn leave(&mut self, bench: &mut Bench) {
        if let Some(client) = self.client.take() {
            info!("{} is left", self.path.display());
            bench.disconnect(client);
            bench.attach(self.bus, false);
        }
        self.unread.clear();
    }
}

/// Offset of the last request of Modbus RTU or ASCII; 0 if there is none.
fn last_message(line: Line, bytes: &[u8]) -> usize {
    if ascii::is_on(line) {
        return bytes.iter().rposition(|&byte| byte == b':').unwrap_or(0);
    }
    let is_message = |from: &usize| match bytes.get(*from..) {
        Some(rest) => rtu::scan(rest, Expect::Requests) == Scan::Complete(rest.len()),
        None => false,
    };
    (0..bytes.len()).find(is_message).unwrap_or(0)
}

/// A new pty: its master, and the path of the end that programs open.
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

#[cfg(test)]
mod tests {
    use super::*;
    use drivetwin_firmware::device::{Duration, Instant, Port};
    use drivetwin_firmware::md3::Md3;

    const USER_REGISTER: u16 = 0x1D;

    #[test]
    fn the_last_of_several_messages() {
        let line = Line::new(9_600, 8, Parity::Even, 1);
        let (first, second) = (rtu::write(1, USER_REGISTER, 1), rtu::read(1, 0, 32));
        assert_eq!(last_message(line, &first), 0);
        assert_eq!(last_message(line, &[&first[..], &second].concat()), 8);
        assert_eq!(last_message(line, &[&first[3..], &first, &second].concat()), 13);
        assert_eq!(last_message(line, b"junk"), 0);
        let ascii = Line { data: 7, ..line };
        assert_eq!(last_message(ascii, b":010300000001FB\r\n:010300000002FA\r\n"), 17);
        assert_eq!(last_message(ascii, b""), 0);
    }

    #[test]
    fn what_the_next_one_wrote_before_the_last_one_is_seen_to_leave_is_answered() {
        let mut bench = Bench::new();
        let md3 = bench.add::<Md3>("md3");
        bench.run_until(Instant::ZERO + Duration::secs(3));
        let bus = bench.bus(md3, Port(0)).unwrap();
        let openings = Rc::new(RefCell::new(Openings::new().unwrap()));
        let mut pty = Pty::new(&bench, bus, None, openings).unwrap();
        let open = || {
            let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC | OFlags::NONBLOCK;
            rustix::fs::open(pty.path(), flags, rustix::fs::Mode::empty()).unwrap()
        };
        drop(open());
        let next = open();
        let request = rtu::write(1, USER_REGISTER, 7);
        assert_eq!(rustix::io::write(&next, &request), Ok(8));
        pty.prepare_for_next(true);
        assert!(pty.process(&mut bench, false, None), "the request is not read");
        bench.run_until_idle();
        pty.deliver(&mut bench);
        let mut came = [0; 64];
        let count = rustix::io::read(&next, &mut came).unwrap();
        assert_eq!(came[..count], request[..]);
    }
}
