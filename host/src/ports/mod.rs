//! Where the lines of a bench, and the TCP ports of its drives, are reached from outside: ptys, TCP ports, serial
//! ports, standard input and output.
//!
//! All descriptors are non-blocking and belong to the bench's thread. [`Ports::wait`] sleeps until something
//! comes, [`Ports::take`] takes it, [`Ports::deliver`] hands out what the drives sent. Each touches only the
//! ends of lines where something is to be done, so those where nothing is cost nothing.
//! Nobody is waited for: a client that does not read for too long loses its connection (TCP) or its characters
//! (elsewhere), and one that sends faster than its line is read only as fast as the line.

mod poller;
mod pty;
mod pty_link;
mod pty_openings;
mod serial_device;
mod stdio;
mod tcp_listener;
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

use poller::Poller;
pub(crate) use pty::PtyError;
pub(crate) use pty_link::check_link;
use pty_openings::Openings;
pub(crate) use serial_device::Device;
pub(crate) use tcp_listener::{Bound, bind};
use unread::Unread;

/// Bytes read from a client at once.
const READ_BYTES: usize = 4096;

/// Bytes of a client that may wait for the line, and bytes that may wait for it to read them, before it is read no
/// further.
const BACKLOG_BYTES: usize = 4096;

/// Time between two looks whether there is room again for those who knock.
const CROWDED: Duration = Duration::from_secs(1);

/// The end of a line where somebody from outside talks and listens, or may come to.
trait Endpoint {
    /// Who talks there, while somebody does.
    fn client(&self) -> Option<Client>;

    /// Its descriptor, while it has one.
    fn fd(&self) -> Option<BorrowedFd<'_>>;

    /// What is waited for; not even for errors if `None`.
    fn interest(&self, bench: &Bench) -> Option<EventFlags>;

    /// Takes what has come. Whether somebody has said something. In manual time it has its whole effect before
    /// any end is asked again.
    fn take(&mut self, bench: &mut Bench, ready: EventFlags, manual: bool) -> bool;

    /// Hands out what the drives have sent by now. Whether a drive is to hear more of who talks there, because he reads
    /// what it answers.
    fn deliver(&mut self, bench: &mut Bench) -> bool;

    /// When it is of no use any more.
    fn expires(&self) -> Instant {
        Instant::NEVER
    }

    /// Whether [`Endpoint::deliver`] is wanted whenever time has gone on, though the drives may have sent nothing.
    fn follows_time(&self) -> bool {
        false
    }

    /// How long after each other it wants to be looked at, because of what nothing tells.
    fn poll_interval(&self) -> Option<Duration> {
        None
    }

    /// Looks at what nothing tells.
    fn poll(&mut self, _bench: &mut Bench) {}

    /// Called when a program has opened, left or written to it. Takes what has come, as [`Endpoint::take`] does.
    fn opened_or_closed(&mut self, _bench: &mut Bench, _manual: bool) -> bool {
        false
    }

    /// It is of no use any more: who talks there leaves.
    fn leave(&mut self, bench: &mut Bench);
}

/// An end of a line, and what is known of it.
struct Registered {
    endpoint: Box<dyn Endpoint>,
    client: Option<Client>,
    /// What the system was told to wait for.
    interest: Option<EventFlags>,
    expires: Instant,
    poll_interval: Option<Duration>,
}

/// Who is looked at again and again.
struct PollGroup {
    timer: OwnedFd,
    number: u64,
    endpoints: BTreeSet<u64>,
}

/// All ports of a bench.
pub(crate) struct Ports {
    poller: Poller,
    /// What has come, and is still to be taken.
    ready: VecDeque<(u64, EventFlags)>,
    listeners: BTreeMap<u64, tcp_listener::Listener>,
    /// Those where somebody knocks whose drive boots.
    booting: BTreeSet<u64>,
    endpoints: BTreeMap<u64, Registered>,
    /// The place of each client.
    clients: BTreeMap<Client, u64>,
    /// Those for which it matters that time goes on: it may make room for more of those that are not read.
    time_driven: BTreeSet<u64>,
    /// Those that end, and when.
    expiring: BTreeSet<(Instant, u64)>,
    poll_groups: BTreeMap<Duration, PollGroup>,
    /// Tells who opens a pty.
    openings: Rc<RefCell<Openings>>,
    /// The ptys by their watches among the openings.
    ptys: BTreeMap<i32, u64>,
    /// The place of standard input and output.
    stdio: Option<u64>,
    /// The last number given.
    last: u64,
}

impl Ports {
    /// No port yet.
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

    /// Reaches `outlet` by a TCP port, from now on; returns its URI.
    ///
    /// # Errors
    /// The system refuses to listen, or gives no timer.
    pub(crate) fn add_tcp(&mut self, outlet: Outlet, bound: Bound) -> io::Result<String> {
        let listener = tcp_listener::Listener::new(outlet, bound)?;
        // Later there may be no descriptor left for its timer.
        self.poll_group(CROWDED)?;
        let uri = format!("tcp:{}", listener.address());
        let number = self.number();
        self.poller.add(number, listener.socket(), EventFlags::IN)?;
        self.listeners.insert(number, listener);
        Ok(uri)
    }

    /// Reaches `bus` by a new pty, linked at `link`; returns its path.
    ///
    /// # Errors
    /// There is no pty to be had, or no link to be made.
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

    /// Reaches `bus` by a serial port of this machine; returns its URI.
    pub(crate) fn add_serial(&mut self, bench: &mut Bench, bus: Bus, device: Device) -> String {
        let uri = device.uri();
        let number = self.register(Box::new(serial_device::Serial::new(bench, bus, device)));
        self.note(bench, number);
        uri
    }

    /// Reaches `bus` by standard input and output, with which the bench ends.
    ///
    /// # Errors
    /// The system gives no sockets or threads.
    pub(crate) fn add_stdio(&mut self, bench: &mut Bench, bus: Bus) -> io::Result<()> {
        let number = self.register(Box::new(stdio::Stdio::new(bench, bus)?));
        self.stdio = Some(number);
        self.note(bench, number);
        Ok(())
    }

    /// Wakes for somebody else, too, whose descriptor gets the number that is returned.
    ///
    /// # Errors
    /// The system cannot wait for that.
    pub(crate) fn wake_for(&mut self, fd: impl AsFd) -> io::Result<u64> {
        let number = self.number();
        self.poller.add(number, fd, EventFlags::IN)?;
        Ok(number)
    }

    /// [`wait`](Self::wait) ends when `left`, which is not zero, has passed, and not when it was to before; `None`: not
    /// before something comes.
    pub(crate) fn set_alarm(&self, left: Option<Duration>) {
        self.poller.set_alarm(left);
    }

    /// Sleeps until something comes, or the alarm rings; if it `looks` only, it does not sleep.
    ///
    /// # Errors
    /// The system does not let it wait.
    pub(crate) fn wait(&mut self, looks: bool) -> io::Result<()> {
        self.poller.wait(looks)?;
        // Who is ready after those that are left over is so next time, too.
        if self.ready.is_empty() {
            self.ready.extend(self.poller.ready());
            // Who leaves makes room for who comes.
            let listeners = &self.listeners;
            self.ready.make_contiguous().sort_by_key(|(number, _)| listeners.contains_key(number));
        }
        Ok(())
    }

    /// Whether that woke it.
    pub(crate) fn is_ready(&self, number: u64) -> bool {
        self.poller.ready().any(|(ready, _)| ready == number)
    }

    /// When a port wants to be looked at though nothing comes.
    pub(crate) fn deadline(&self) -> Instant {
        self.expiring.first().map_or(Instant::NEVER, |&(at, _)| at)
    }

    /// Whether the bench is of no use any more, because standard input has ended and all is answered.
    pub(crate) fn are_over(&self) -> bool {
        self.stdio.is_some_and(|stdio| !self.endpoints.contains_key(&stdio))
    }

    /// Takes what has come, up to what is to have its effect before more is taken: in manual time its whole effect.
    /// Whether there is such.
    pub(crate) fn take(&mut self, bench: &mut Bench, manual: bool) -> bool {
        // What somebody sent who came a moment ago is his, not his predecessor's.
        if !self.ready.is_empty() && !self.ptys.is_empty() {
            self.openings.borrow_mut().hear();
        }
        loop {
            if self.note_openings(bench, manual) {
                return true;
            }
            let Some((number, flags)) = self.ready.pop_front() else { return false };
            if let Some(registered) = self.endpoints.get_mut(&number) {
                let said = registered.endpoint.take(bench, flags, manual);
                let goes_on = flags.contains(EventFlags::OUT) && registered.endpoint.deliver(bench);
                self.note(bench, number);
                if said || goes_on {
                    return true;
                }
            } else if self.listeners.contains_key(&number) {
                let goes_on = self.deliver(bench);
                if self.accept(bench, number) || goes_on {
                    return true;
                }
            } else {
                self.poll_endpoints(bench, number);
            }
        }
    }

    /// Hands out what the drives have sent by now. Whether a drive is to hear something because of that: more of who
    /// has said more than he read, or that somebody has left.
    pub(crate) fn deliver(&mut self, bench: &mut Bench) -> bool {
        let audible = bench.audible().filter_map(|client| self.clients.get(&client).copied());
        let mut numbers: Vec<u64> = audible.chain(self.time_driven.iter().copied()).collect();
        numbers.sort_unstable();
        numbers.dedup();
        let mut heard = false;
        for number in numbers {
            if let Some(registered) = self.endpoints.get_mut(&number) {
                heard |= registered.endpoint.deliver(bench);
                self.note(bench, number);
            }
        }
        self.listen_again(bench);
        while let Some(&(at, number)) = self.expiring.first()
            && at <= bench.now()
        {
            self.remove(bench, number);
            heard = true;
        }
        heard
    }

    /// A number for something new.
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

    /// Notes what has become of an end.
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
            let told = match (*interest, wanted) {
                (None, Some(wanted)) => self.poller.add(number, fd, wanted),
                (Some(_), Some(wanted)) => self.poller.change(number, fd, wanted),
                (_, None) => self.poller.remove(fd),
            };
            if let Err(error) = told {
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

    /// An end is looked at in other rounds than before.
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
            Err(error) => return error!("a port cannot be looked at again: {error}"),
        };
        if group.endpoints.is_empty() {
            timer::start(&group.timer, interval);
        }
        group.endpoints.insert(number);
    }

    /// Those that are looked at so long after each other.
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

    /// Looks at the ends of a round whose timer has told so, and listens again where nobody was let in.
    fn poll_endpoints(&mut self, bench: &mut Bench, timer: u64) {
        let Some(group) = self.poll_groups.values().find(|group| group.number == timer) else { return };
        timer::hear(&group.timer);
        for number in group.endpoints.iter().copied().collect::<Vec<_>>() {
            if let Some(registered) = self.endpoints.get_mut(&number) {
                registered.endpoint.poll(bench);
                self.note(bench, number);
            } else if let Some(listener) = self.listeners.get(&number) {
                if let Err(error) = self.poller.add(number, listener.socket(), EventFlags::IN) {
                    error!("tcp:{} lets nobody in any more: {error}", listener.address());
                }
                self.poll_every(number, Some(CROWDED), None);
            }
        }
    }

    /// Listens again where a drive has booted by now.
    fn listen_again(&mut self, bench: &Bench) {
        let Self { booting, listeners, poller, .. } = self;
        booting.retain(|number| {
            let Some(listener) = listeners.get(number) else { return false };
            if !listener.is_open(bench) {
                return true;
            }
            if let Err(error) = poller.add(*number, listener.socket(), EventFlags::IN) {
                error!("tcp:{} lets nobody in any more: {error}", listener.address());
            }
            false
        });
    }

    /// Lets in who knocks at a TCP port. Whether somebody has come of whom a drive is to hear.
    fn accept(&mut self, bench: &mut Bench, number: u64) -> bool {
        let mut came = false;
        while let Some(listener) = self.listeners.get_mut(&number) {
            if !listener.is_open(bench) {
                // Who is not let in knocks without end.
                let _ = self.poller.remove(listener.socket());
                self.booting.insert(number);
                break;
            }
            match listener.accept(bench) {
                Ok(Some(connection)) => {
                    came |= connection.is_told();
                    let number = self.register(Box::new(connection));
                    self.note(bench, number);
                }
                Ok(None) => break,
                Err(_) => {
                    // Who is not let in knocks without end.
                    let _ = self.poller.remove(listener.socket());
                    self.poll_every(number, None, Some(CROWDED));
                    break;
                }
            }
        }
        came
    }

    /// An end is of no use any more.
    fn remove(&mut self, bench: &mut Bench, number: u64) {
        let Some(mut registered) = self.endpoints.remove(&number) else { return };
        if let Some(fd) = registered.endpoint.fd() {
            // One that nothing is waited for is not there.
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

    /// Tells each pty that somebody opened or left it, or wrote there, up to the first where something is said. Whether
    /// there is such.
    fn note_openings(&mut self, bench: &mut Bench, manual: bool) -> bool {
        loop {
            let Some(watch) = self.openings.borrow().next() else { return false };
            let registered =
                self.ptys.get(&watch).and_then(|&number| Some((number, self.endpoints.get_mut(&number)?)));
            let Some((number, registered)) = registered else {
                self.openings.borrow_mut().of(watch);
                continue;
            };
            let said = registered.endpoint.opened_or_closed(bench, manual);
            self.note(bench, number);
            if said {
                return true;
            }
        }
    }
}

/// What to wait for of somebody who talks and listens.
fn interest(reads: bool, unread: &Unread) -> EventFlags {
    let mut interest = EventFlags::empty();
    interest.set(EventFlags::IN, reads);
    interest.set(EventFlags::OUT, !unread.is_empty());
    interest
}

/// Whether a client may be read further.
fn may_read(bench: &Bench, client: Client, unread: &Unread) -> bool {
    bench.backlog(client) < BACKLOG_BYTES && unread.len() < BACKLOG_BYTES
}

/// Room for what is read from a client at once.
const ROOM: [MaybeUninit<u8>; READ_BYTES] = [MaybeUninit::uninit(); READ_BYTES];

/// What a read from a client brought.
enum ReadResult<'a> {
    /// These bytes.
    Bytes(&'a [u8]),
    /// Nothing for now.
    Nothing,
    /// The other end is closed.
    Closed,
}

/// Reads what is there.
fn read_some(from: impl AsFd, room: &mut [MaybeUninit<u8>]) -> ReadResult<'_> {
    match rustix::io::read(from, room) {
        Ok(([], _)) => ReadResult::Closed,
        Ok((bytes, _)) => ReadResult::Bytes(bytes),
        Err(rustix::io::Errno::AGAIN | rustix::io::Errno::INTR) => ReadResult::Nothing,
        // Of a pty that nobody has open, or of a broken connection.
        Err(_) => ReadResult::Closed,
    }
}
