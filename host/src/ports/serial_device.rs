//! A serial line that is connected to a serial port of this machine (HOST-16).
//!
//! The port is the drive's end of a cable, so it has the serial settings of the drive. The port times
//! characters itself, so replies are written whole. Before settings change, the port must have sent its
//! buffer. That takes seconds at 300 baud, and never ends with an adapter that hangs; so a thread waits for
//! it. A character with a parity error is read as 0, which makes its frame invalid. The port is opened
//! exclusively. An unplugged port is polled until it is plugged in again; meanwhile no client is connected.
//! The modem lines of the port are not read: a drive that is reset by DTR is reset when the port appears, and
//! not when a program at the other end opens its own port.

use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::thread::{Builder, JoinHandle};
use std::time::Duration;

use drivetwin_firmware::device::Line;
use drivetwin_protocol::line::Parity;
use drivetwin_sim::bench::{Bench, Bus, Client};
use drivetwin_sim::config::listen::Uri;
use rustix::event::epoll::EventFlags;
use rustix::fs::{Mode, OFlags};
use rustix::termios::{
    ControlModes, InputModes, OptionalActions, QueueSelector, ioctl_tiocexcl, isatty, tcflush, tcgetattr,
    tcsetattr,
};
use tracing::{info, warn};

use super::unread::{MOST_MIB, Unread};
use super::{Endpoint, ROOM, ReadResult, interest, may_read, read_some};
use crate::clock::Clock;

/// Time between two attempts to open an unplugged port.
const RETRY: Duration = Duration::from_secs(1);

/// Poll interval while a thread waits to change the settings.
const POLL_INTERVAL: Duration = Duration::from_millis(1);

/// A serial port that is open.
pub(crate) struct Device {
    path: PathBuf,
    fd: OwnedFd,
}

impl Device {
    /// Opens the serial port `path`.
    ///
    /// # Errors
    /// The path is not a serial port, does not exist, or another program uses it.
    pub(crate) fn open(path: &Path) -> io::Result<Self> {
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let fd = rustix::fs::open(path, flags, Mode::empty())?;
        if !isatty(&fd) {
            return Err(io::Error::new(io::ErrorKind::InvalidInput, "not a serial port"));
        }
        ioctl_tiocexcl(&fd)?;
        Ok(Self { path: path.into(), fd })
    }

    /// Descriptor of the device as a port for bytes of any kind. It is non-blocking.
    ///
    /// # Errors
    /// The device does not take the settings.
    pub(crate) fn into_raw(self) -> io::Result<OwnedFd> {
        try_set(&self.fd, Line::new(115_200, 8, Parity::None, 1), OptionalActions::Now)?;
        Ok(self.fd)
    }

    /// URI of the device.
    pub(super) fn uri(&self) -> String {
        Uri::Serial(self.path.clone()).to_string()
    }
}

/// A serial port that is connected to a line.
pub(super) struct Serial {
    path: PathBuf,
    /// `None` while the port is unplugged.
    fd: Option<OwnedFd>,
    /// Serial settings that the port has, or is about to have.
    line: Line,
    /// The thread that changes the settings. Nothing is written while it runs.
    setter: Option<JoinHandle<()>>,
    bus: Bus,
    client: Option<Client>,
    /// Characters that the drives sent and that the device has not taken.
    unread: Unread,
}

impl Serial {
    /// A serial port for `bus`.
    pub(super) fn new(bench: &mut Bench, bus: Bus, device: Device) -> Self {
        let Device { path, fd } = device;
        let line = bench.line(bus);
        let unread = Unread::default();
        let mut serial = Self { path, fd: None, line, setter: None, bus, client: None, unread };
        serial.come(bench, fd);
        serial
    }

    /// Connects the port, which has just been opened, as a client of the line.
    fn come(&mut self, bench: &mut Bench, fd: OwnedFd) {
        // Characters from before the opening are not for the new client.
        let _ = tcflush(&fd, QueueSelector::IOFlush);
        self.line = bench.line(self.bus);
        set(&fd, &self.path, self.line, OptionalActions::Now);
        self.fd = Some(fd);
        let client = bench.connect(self.bus);
        bench.set_self_paced(client);
        bench.attach(self.bus, true);
        self.client = Some(client);
    }

    /// Sets the port to the settings of the line, if they differ.
    fn follow(&mut self, bench: &Bench) {
        let line = bench.line(self.bus);
        if self.line == line {
            return;
        }
        let Some(fd) = &self.fd else { return };
        // The change is attempted only once, whether it succeeds or not.
        self.line = line;
        let path = self.path.clone();
        let setter = fd.try_clone().and_then(|fd| {
            let thread = Builder::new().name("serial".into());
            thread.spawn(move || set(&fd, &path, line, OptionalActions::Drain))
        });
        match setter {
            Ok(setter) => self.setter = Some(setter),
            Err(error) => warn!("serial:{} cannot be {line}: {error}", self.path.display()),
        }
    }
}

impl Endpoint for Serial {
    fn client(&self) -> Option<Client> {
        self.client
    }

    fn fd(&self) -> Option<BorrowedFd<'_>> {
        self.fd.as_ref().map(AsFd::as_fd)
    }

    fn interest(&self, bench: &Bench) -> Option<EventFlags> {
        let reads = |client| may_read(bench, client, &self.unread);
        let mut interest = self.client.map(|client| interest(reads(client), &self.unread))?;
        interest.set(EventFlags::OUT, interest.contains(EventFlags::OUT) && self.setter.is_none());
        Some(interest)
    }

    fn take(&mut self, bench: &mut Bench, ready: EventFlags, _clock: Option<&Clock>) -> bool {
        let (Some(client), Some(fd)) = (self.client, &self.fd) else { return false };
        if !ready.intersects(EventFlags::IN | EventFlags::HUP | EventFlags::ERR) {
            return false;
        }
        let mut room = ROOM;
        match read_some(fd, &mut room) {
            ReadResult::Bytes(bytes) => {
                bench.send(client, bytes);
                return true;
            }
            ReadResult::Closed => {
                warn!("serial:{} is gone; it is opened again when it is back", self.path.display());
                self.leave(bench);
            }
            ReadResult::Nothing => {}
        }
        false
    }

    fn deliver(&mut self, bench: &mut Bench) -> bool {
        let (Some(client), Some(fd)) = (self.client, &self.fd) else { return false };
        self.unread.receive(bench, client);
        if self.setter.is_none() {
            // If the write fails, the port is unplugged, and the next read reports that.
            let _ = self.unread.write(fd);
            if self.unread.is_empty() {
                self.follow(bench);
            }
        }
        if self.unread.lose() {
            let path = self.path.display();
            warn!("serial:{path} has left more than {MOST_MIB} MiB unsent; what follows is lost");
        }
        false
    }

    /// Returns true while the port is connected, because the drive may change its settings at any time.
    fn follows_time(&self) -> bool {
        self.client.is_some()
    }

    fn poll_interval(&self) -> Option<Duration> {
        match self.fd {
            None => Some(RETRY),
            Some(_) => self.setter.as_ref().map(|_| POLL_INTERVAL),
        }
    }

    fn poll(&mut self, bench: &mut Bench) {
        if self.fd.is_none()
            && let Ok(Device { fd, .. }) = Device::open(&self.path)
        {
            warn!("serial:{} is back", self.path.display());
            self.come(bench, fd);
        }
        if self.setter.take_if(|setter| setter.is_finished()).is_some() {
            self.deliver(bench);
        }
    }

    fn leave(&mut self, bench: &mut Bench) {
        (self.fd, self.setter) = (None, None);
        self.unread.clear();
        if let Some(client) = self.client.take() {
            bench.disconnect(client);
            bench.attach(self.bus, false);
        }
    }
}

/// Sets a port to the settings of a line.
fn set(fd: &OwnedFd, path: &Path, line: Line, when: OptionalActions) {
    match try_set(fd, line, when) {
        Ok(()) => info!("serial:{} is {line}", path.display()),
        Err(error) => warn!("serial:{} cannot be {line}: {error}", path.display()),
    }
}

fn try_set(fd: &OwnedFd, line: Line, when: OptionalActions) -> io::Result<()> {
    let mut settings = tcgetattr(fd)?;
    settings.make_raw();
    settings.set_speed(line.baud)?;
    let control = &mut settings.control_modes;
    control.insert(ControlModes::CLOCAL | ControlModes::CREAD);
    control.remove(ControlModes::CSIZE | ControlModes::CRTSCTS);
    control.insert(if line.data == 7 { ControlModes::CS7 } else { ControlModes::CS8 });
    control.set(ControlModes::CSTOPB, line.stop == 2);
    control.set(ControlModes::PARENB, line.parity != Parity::None);
    control.set(ControlModes::PARODD, line.parity == Parity::Odd);
    settings.input_modes.set(InputModes::INPCK, line.parity != Parity::None);
    Ok(tcsetattr(fd, when, &settings)?)
}
