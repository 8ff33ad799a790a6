//! Endpoints of a bench for clients: ptys, TCP ports, remote and local serial ports, standard input and output.
//!
//! An endpoint belongs to a serial line, or to a TCP port of a drive.
//!
//! All descriptors are non-blocking and belong to the bench's thread. [`Ports::wait`] sleeps until input
//! arrives, [`Ports::take`] takes the input, [`Ports::deliver`] delivers the output of the drives. Each call
//! handles only the endpoints with work to do, so idle endpoints cost nothing. The bench never waits for a
//! client. A client that does not read for too long loses its connection (TCP) or characters (other
//! endpoints). A client that sends faster than its serial line is read at the speed of the line.

mod com_port;
mod poller;
mod pty;
mod pty_link;
mod pty_openings;
mod remote_port;
mod serial_device;
mod stdio;
mod tcp_listener;
mod telnet;
#[cfg(test)]
mod tests;
mod timer;
mod unread;
mod web;

use std::cell::RefCell;
use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::io;
use std::mem::MaybeUninit;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::PathBuf;
use std::rc::Rc;
use std::time::Duration;

use drivetwin_firmware::device::Instant;
use drivetwin_sim::bench::{Bench, Bus, Client, Outlet};
use rustix::event::epoll::EventFlags;
use tracing::error;

use crate::clock::Clock;
use poller::Poller;
pub(crate) use pty::PtyError;
pub(crate) use pty_link::check_link;
use pty_openings::Openings;
pub(crate) use serial_device::Device;
pub(crate) use tcp_listener::{Bound, bind};
use unread::Unread;

/// Most bytes that one read takes from a client.
const READ_BYTES: usize = 4096;

/// Reading from a client is suspended while at least this number of its bytes wait for the line, or while the
/// client has at least this number of bytes to read.
const BACKLOG_BYTES: usize = 4096;

/// Time between two attempts to accept connections while the system has no room for more.
const CROWDED: Duration = Duration::from_secs(1);

/// Notes the present time, because a client sent the bytes that were just read at this time at the latest.
fn note_arrival(bench: &mut Bench, clock: Option<&Clock>) {
    if let Some(clock) = clock {
        bench.set_arrived_by(clock.now());
    }
}

/// An endpoint of a line or TCP port, where a client can connect, send and receive.
trait Endpoint {
    /// The client, while one is connected.
    fn client(&self) -> Option<Client>;

    /// The descriptor, while the endpoint has one.
    fn fd(&self) -> Option<BorrowedFd<'_>>;

    /// Events to wait for. With `None` not even errors are reported.
    fn interest(&self, bench: &Bench) -> Option<EventFlags>;

    /// Takes input. Returns whether there was some. In manual time (no clock) the caller lets the input have its whole
    /// effect before more input is taken.
    fn take(&mut self, bench: &mut Bench, ready: EventFlags, clock: Option<&Clock>) -> bool;

    /// Delivers the output of the drives so far. A client that does not read its answers has its input held
    /// back. Returns true if such input now goes on to the drive.
    fn deliver(&mut self, bench: &mut Bench) -> bool;

    /// Time at which the endpoint is to be closed.
    fn expires(&self) -> Instant {
        Instant::NEVER
    }

    /// Returns whether [`Endpoint::deliver`] must be called whenever time has passed, even if the drives have
    /// sent nothing.
    fn follows_time(&self) -> bool {
        false
    }

    /// Interval at which [`Endpoint::poll`] is called, for changes that no event reports.
    fn poll_interval(&self) -> Option<Duration> {
        None
    }

    /// Checks for changes that no event reports.
    fn poll(&mut self, _bench: &mut Bench) {}

    /// Called when a program has opened, closed or written to the endpoint. Takes input, like
    /// [`Endpoint::take`].
    fn opened_or_closed(&mut self, _bench: &mut Bench, _clock: Option<&Clock>) -> bool {
        false
    }

    /// Called before the endpoint is dropped: disconnects the client.
    fn leave(&mut self, bench: &mut Bench);
}

/// A registered endpoint, and its state at the last event.
struct Registered {
    endpoint: Box<dyn Endpoint>,
    client: Option<Client>,
    /// Events that the poller waits for.
    interest: Option<EventFlags>,
    expires: Instant,
    poll_interval: Option<Duration>,
}

/// Endpoints that are polled at the same interval.
struct PollGroup {
    timer: OwnedFd,
    number: u64,
    endpoints: BTreeSet<u64>,
}

/// All ports of a bench.
pub(crate) struct Ports {
    poller: Poller,
    /// Events that are not handled yet.
    ready: VecDeque<(u64, EventFlags)>,
    listeners: BTreeMap<u64, tcp_listener::Listener>,
    /// Suspended listeners: a connection waits while the drive is starting.
    booting: BTreeSet<u64>,
    endpoints: BTreeMap<u64, Registered>,
    /// The endpoint of each client.
    clients: BTreeMap<Client, u64>,
    /// Endpoints to which output is delivered whenever time has passed. Some follow time; for the others
    /// reading is suspended, and may resume when time has passed.
    time_driven: BTreeSet<u64>,
    /// Endpoints that expire, ordered by time.
    expiring: BTreeSet<(Instant, u64)>,
    poll_groups: BTreeMap<Duration, PollGroup>,
    /// Events of the ptys: openings, closings and writes.
    openings: Rc<RefCell<Openings>>,
    /// Number of the endpoint of each pty, by the pty's inotify watch.
    ptys: BTreeMap<i32, u64>,
    /// The endpoint of standard input and output.
    stdio: Option<u64>,
    /// The number that was assigned last.
    last: u64,
}

impl Ports {
    /// A set without any port.
    ///
    /// # Errors
    /// The system gives no epoll or inotify instance, or no timer.
    pub(crate) fn new() -> io::Result<Self> {
        let openings = Rc::new(RefCell::new(Openings::new()?));
        let mut ports = Self {
            poller: Poller::new()?,
            ready: VecDeque::new(),
            listeners: BTreeMap::new(),
            booting: BTreeSet::new(),
            endpoints: BTreeMap::new(),
            clients: BTreeMap::new(),
            time_driven: BTreeSet::new(),
            expiring: BTreeSet::new(),
            poll_groups: BTreeMap::new(),
            openings,
            ptys: BTreeMap::new(),
            stdio: None,
            last: 0,
        };
        let number = ports.number();
        ports.poller.add(number, &*ports.openings.borrow(), EventFlags::IN)?;
        Ok(ports)
    }

    /// Opens a TCP port for `outlet`. Returns its URI.
    ///
    /// # Errors
    /// The system refuses to listen, or gives no timer.
    pub(crate) fn add_tcp(&mut self, outlet: Outlet, bound: Bound) -> io::Result<String> {
        self.add_listener(tcp_listener::Listener::new(outlet, bound)?)
    }

    /// Opens a TCP port for `bus` that remote masters use like a serial port (RFC 2217). Returns its URI.
    ///
    /// # Errors
    /// The system refuses to listen, or gives no timer.
    pub(crate) fn add_rfc2217(&mut self, bus: Bus, bound: Bound) -> io::Result<String> {
        self.add_listener(tcp_listener::Listener::with_com_port(bus, bound)?)
    }

    fn add_listener(&mut self, listener: tcp_listener::Listener) -> io::Result<String> {
        // The timer of this group is made now, because later there may be no descriptor left for it.
        self.poll_group(CROWDED)?;
        let uri = listener.uri().to_owned();
        let number = self.number();
        self.poller.add(number, listener.socket(), EventFlags::IN)?;
        self.listeners.insert(number, listener);
        Ok(uri)
    }

    /// Opens a new pty for `bus`, with a symbolic link at `link`. Returns the path of the pty.
    ///
    /// # Errors
    /// The system gives no pty, or the link cannot be created.
    pub(crate) fn add_pty(
        &mut self,
        bench: &Bench,
        bus: Bus,
        link: Option<PathBuf>,
    ) -> Result<PathBuf, PtyError> {
        let pty = pty::Pty::new(bench, bus, link, Rc::clone(&self.openings))?;
        let (path, watch) = (pty.path().to_owned(), pty.watch());
        let number = self.register(Box::new(pty));
        self.ptys.insert(watch, number);
        self.note(bench, number);
        Ok(path)
    }

    /// Connects the serial port `device` of this machine to `bus`. Returns its URI.
    pub(crate) fn add_serial(&mut self, bench: &mut Bench, bus: Bus, device: Device) -> String {
        let uri = device.uri();
        let number = self.register(Box::new(serial_device::Serial::new(bench, bus, device)));
        self.note(bench, number);
        uri
    }

    /// Connects standard input and output to `bus`. The bench ends when standard input ends.
    ///
    /// # Errors
    /// The system gives no sockets or threads.
    pub(crate) fn add_stdio(&mut self, bench: &mut Bench, bus: Bus) -> io::Result<()> {
        let number = self.register(Box::new(stdio::Stdio::new(bench, bus)?));
        self.stdio = Some(number);
        self.note(bench, number);
        Ok(())
    }

    /// Adds a descriptor that ends the wait when it becomes readable. Returns its number.
    ///
    /// # Errors
    /// The system cannot wait for this descriptor.
    pub(crate) fn wake_for(&mut self, fd: impl AsFd) -> io::Result<u64> {
        let number = self.number();
        self.poller.add(number, fd, EventFlags::IN)?;
        Ok(number)
    }

    /// Sets the time after which [`wait`](Self::wait) ends, which must not be zero. With `None` only input
    /// ends it.
    pub(crate) fn set_alarm(&self, left: Option<Duration>) {
        self.poller.set_alarm(left);
    }

    /// Sleeps until input arrives or the alarm expires. With `at_once` it does not sleep.
    ///
    /// # Errors
    /// The system cannot wait for events.
    pub(crate) fn wait(&mut self, at_once: bool) -> io::Result<()> {
        self.poller.wait(at_once)?;
        // Events are level-triggered: the next wait reports again what is not taken now.
        if self.ready.is_empty() {
            self.ready.extend(self.poller.ready());
            // Existing connections come before listeners, so that a client that leaves makes room for a new
            // one.
            let listeners = &self.listeners;
            self.ready.make_contiguous().sort_by_key(|(number, _)| listeners.contains_key(number));
        }
        Ok(())
    }

    /// Returns whether the descriptor with this number ended the wait.
    pub(crate) fn is_ready(&self, number: u64) -> bool {
        self.poller.ready().any(|(ready, _)| ready == number)
    }

    /// Time at which the next endpoint expires.
    pub(crate) fn deadline(&self) -> Instant {
        self.expiring.first().map_or(Instant::NEVER, |&(at, _)| at)
    }

    /// Returns true if standard input has ended and all its requests are answered; the bench then ends.
    pub(crate) fn are_over(&self) -> bool {
        self.stdio.is_some_and(|stdio| !self.endpoints.contains_key(&stdio))
    }

    /// Takes the input of one endpoint. The caller must let this input have its effect (in manual time its
    /// whole effect) before it takes more. Returns whether there was input.
    pub(crate) fn take(&mut self, bench: &mut Bench, clock: Option<&Clock>) -> bool {
        // Openings are read before bytes: the bytes of a program that has just opened a pty are not its
        // predecessor's.
        if !self.ready.is_empty() && !self.ptys.is_empty() {
            self.openings.borrow_mut().read_events();
        }
        loop {
            if self.note_openings(bench, clock) {
                return true;
            }
            let Some((number, flags)) = self.ready.pop_front() else { return false };
            if let Some(registered) = self.endpoints.get_mut(&number) {
                let took_input = registered.endpoint.take(bench, flags, clock);
                let resumes = flags.contains(EventFlags::OUT) && registered.endpoint.deliver(bench);
                self.note(bench, number);
                if took_input || resumes {
                    return true;
                }
            } else if self.listeners.contains_key(&number) {
                let resumes = self.deliver(bench);
                if self.accept(bench, number) || resumes {
                    return true;
                }
            } else {
                self.poll_endpoints(bench, number);
            }
        }
    }

    /// Delivers the output of the drives so far. Returns whether the drives have new input because of that:
    /// input of a client is no longer held back, or a client has left.
    pub(crate) fn deliver(&mut self, bench: &mut Bench) -> bool {
        let readable = bench.readable().filter_map(|client| self.clients.get(&client).copied());
        let mut numbers: Vec<u64> = readable.chain(self.time_driven.iter().copied()).collect();
        numbers.sort_unstable();
        numbers.dedup();
        let mut has_input = false;
        for number in numbers {
            if let Some(registered) = self.endpoints.get_mut(&number) {
                has_input |= registered.endpoint.deliver(bench);
                self.note(bench, number);
            }
        }
        self.listen_again(bench);
        while let Some(&(at, number)) = self.expiring.first()
            && at <= bench.now()
        {
            self.remove(bench, number);
            has_input = true;
        }
        has_input
    }

    /// Assigns a new number.
    fn number(&mut self) -> u64 {
        self.last += 1;
        self.last
    }

    fn register(&mut self, endpoint: Box<dyn Endpoint>) -> u64 {
        let number = self.number();
        let registered = Registered {
            endpoint,
            client: None,
            interest: None,
            expires: Instant::NEVER,
            poll_interval: None,
        };
        self.endpoints.insert(number, registered);
        number
    }

    /// Updates the registered state of an endpoint after a change.
    fn note(&mut self, bench: &Bench, number: u64) {
        let Some(registered) = self.endpoints.get_mut(&number) else { return };
        let Registered { endpoint, client, interest, expires, poll_interval } = registered;
        if endpoint.client() != *client {
            if let Some(gone) = std::mem::replace(client, endpoint.client()) {
                self.clients.remove(&gone);
            }
            if let Some(client) = *client {
                self.clients.insert(client, number);
            }
        }
        let wanted = endpoint.interest(bench);
        if wanted != *interest
            && let Some(fd) = endpoint.fd()
        {
            let registered_interest = match (*interest, wanted) {
                (None, Some(wanted)) => self.poller.add(number, fd, wanted),
                (Some(_), Some(wanted)) => self.poller.change(number, fd, wanted),
                (_, None) => self.poller.remove(fd),
            };
            if let Err(error) = registered_interest {
                error!("a port cannot be waited for: {error}");
            }
        }
        *interest = wanted;
        if endpoint.expires() != *expires {
            self.expiring.remove(&(*expires, number));
            *expires = endpoint.expires();
            self.expiring.insert((*expires, number));
        }
        let reads = wanted.is_some_and(|wanted| wanted.contains(EventFlags::IN));
        let held_back = client.is_some() && !reads && *expires == Instant::NEVER;
        if held_back || endpoint.follows_time() {
            self.time_driven.insert(number);
        } else {
            self.time_driven.remove(&number);
        }
        if endpoint.poll_interval() != *poll_interval {
            let (old, new) =
                (std::mem::replace(poll_interval, endpoint.poll_interval()), endpoint.poll_interval());
            self.poll_every(number, old, new);
        }
    }

    /// Changes the poll interval of an endpoint.
    fn poll_every(&mut self, number: u64, old: Option<Duration>, new: Option<Duration>) {
        if let Some(group) = old.and_then(|interval| self.poll_groups.get_mut(&interval)) {
            group.endpoints.remove(&number);
            if group.endpoints.is_empty() {
                timer::stop(&group.timer);
            }
        }
        let Some(interval) = new else { return };
        let group = match self.poll_group(interval) {
            Ok(group) => group,
            Err(error) => return error!("a port cannot be polled: {error}"),
        };
        if group.endpoints.is_empty() {
            timer::start(&group.timer, interval);
        }
        group.endpoints.insert(number);
    }

    /// The group of endpoints that are polled at this interval; creates it if necessary.
    fn poll_group(&mut self, interval: Duration) -> io::Result<&mut PollGroup> {
        match self.poll_groups.entry(interval) {
            Entry::Occupied(group) => Ok(group.into_mut()),
            Entry::Vacant(vacant) => {
                let timer = timer::new()?;
                self.last += 1;
                self.poller.add(self.last, &timer, EventFlags::IN)?;
                Ok(vacant.insert(PollGroup { timer, number: self.last, endpoints: BTreeSet::new() }))
            }
        }
    }

    /// Polls the endpoints whose timer has expired, and resumes listeners for which the system had no room.
    fn poll_endpoints(&mut self, bench: &mut Bench, timer: u64) {
        let Some(group) = self.poll_groups.values().find(|group| group.number == timer) else { return };
        timer::acknowledge(&group.timer);
        for number in group.endpoints.iter().copied().collect::<Vec<_>>() {
            if let Some(registered) = self.endpoints.get_mut(&number) {
                registered.endpoint.poll(bench);
                self.note(bench, number);
            } else if let Some(listener) = self.listeners.get(&number) {
                if let Err(error) = self.poller.add(number, listener.socket(), EventFlags::IN) {
                    error!("{} cannot accept connections any more: {error}", listener.uri());
                }
                self.poll_every(number, Some(CROWDED), None);
            }
        }
    }

    /// Resumes listeners whose drives have finished starting.
    fn listen_again(&mut self, bench: &Bench) {
        let Self { booting, listeners, poller, .. } = self;
        booting.retain(|number| {
            let Some(listener) = listeners.get(number) else { return false };
            if !listener.is_open(bench) {
                return true;
            }
            if let Err(error) = poller.add(*number, listener.socket(), EventFlags::IN) {
                error!("{} cannot accept connections any more: {error}", listener.uri());
            }
            false
        });
    }

    /// Accepts the waiting connections of a TCP port. Returns whether a drive is notified of one of them.
    fn accept(&mut self, bench: &mut Bench, number: u64) -> bool {
        let mut came = false;
        while let Some(listener) = self.listeners.get_mut(&number) {
            if !listener.is_open(bench) {
                // The listener is suspended, because the poller would report the waiting connection again and
                // again.
                let _ = self.poller.remove(listener.socket());
                self.booting.insert(number);
                break;
            }
            match listener.accept(bench) {
                Ok(Some(connection)) => {
                    came |= connection.is_reported();
                    let number = self.register(Box::new(connection));
                    self.note(bench, number);
                }
                Ok(None) => break,
                Err(_) => {
                    // The listener is suspended, because the poller would report the waiting connection again
                    // and again.
                    let _ = self.poller.remove(listener.socket());
                    self.poll_every(number, None, Some(CROWDED));
                    break;
                }
            }
        }
        came
    }

    /// Removes an endpoint.
    fn remove(&mut self, bench: &mut Bench, number: u64) {
        let Some(mut registered) = self.endpoints.remove(&number) else { return };
        if let Some(fd) = registered.endpoint.fd() {
            // An endpoint without interest is not registered with the poller.
            let _ = self.poller.remove(fd);
        }
        registered.endpoint.leave(bench);
        if let Some(client) = registered.client {
            self.clients.remove(&client);
        }
        self.expiring.remove(&(registered.expires, number));
        self.time_driven.remove(&number);
        self.poll_every(number, registered.poll_interval, None);
    }

    /// Handles openings, closings and writes of the ptys until one of them brings input. Returns whether
    /// there was input.
    fn note_openings(&mut self, bench: &mut Bench, clock: Option<&Clock>) -> bool {
        loop {
            let Some(watch) = self.openings.borrow().next() else { return false };
            let registered =
                self.ptys.get(&watch).and_then(|&number| Some((number, self.endpoints.get_mut(&number)?)));
            let Some((number, registered)) = registered else {
                self.openings.borrow_mut().take(watch);
                continue;
            };
            let took_input = registered.endpoint.opened_or_closed(bench, clock);
            self.note(bench, number);
            if took_input {
                return true;
            }
        }
    }
}

/// Events to wait for at the descriptor of a client: input if `reads`, and room for output if some is unread.
fn interest(reads: bool, unread: &Unread) -> EventFlags {
    let mut interest = EventFlags::empty();
    interest.set(EventFlags::IN, reads);
    interest.set(EventFlags::OUT, !unread.is_empty());
    interest
}

/// Returns whether the client may be read now, because neither its input nor its unread output is too long.
fn may_read(bench: &Bench, client: Client, unread: &Unread) -> bool {
    bench.backlog(client) < BACKLOG_BYTES && unread.len() < BACKLOG_BYTES
}

/// Buffer for one read from a client.
const ROOM: [MaybeUninit<u8>; READ_BYTES] = [MaybeUninit::uninit(); READ_BYTES];

/// Result of a read from a client.
enum ReadResult<'a> {
    /// The bytes that were read.
    Bytes(&'a [u8]),
    /// No bytes for now.
    Nothing,
    /// The other end is closed.
    Closed,
}

/// Reads the bytes that are available.
fn read_some(from: impl AsFd, room: &mut [MaybeUninit<u8>]) -> ReadResult<'_> {
    match rustix::io::read(from, room) {
        Ok(([], _)) => ReadResult::Closed,
        Ok((bytes, _)) => ReadResult::Bytes(bytes),
        Err(rustix::io::Errno::AGAIN | rustix::io::Errno::INTR) => ReadResult::Nothing,
        // A pty that no program has open reports an error, and so does a broken connection.
        Err(_) => ReadResult::Closed,
    }
}
