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

use poller::Watch;
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
trait End {
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
    fn ends(&self) -> Instant {
        Instant::NEVER
    }

    /// Whether [`End::deliver`] is wanted whenever time has gone on, though the drives may have sent nothing.
    fn goes_with_time(&self) -> bool {
        false
    }

    /// How long after each other it wants to be looked at, because of what nothing tells.
    fn pause(&self) -> Option<Duration> {
        None
    }

    /// Looks at what nothing tells.
    fn look(&mut self, _bench: &mut Bench) {}

    /// Called when a program has opened, left or written to it. Takes what has come, as [`End::take`] does.
    fn opened_or_closed(&mut self, _bench: &mut Bench, _manual: bool) -> bool {
        false
    }

    /// It is of no use any more: who talks there leaves.
    fn leave(&mut self, bench: &mut Bench);
}

/// An end of a line, and what is known of it.
struct Place {
    end: Box<dyn End>,
    client: Option<Client>,
    /// What the system was told to wait for.
    interest: Option<EventFlags>,
    ends: Instant,
    pause: Option<Duration>,
}

/// Who is looked at again and again.
struct Round {
    timer: OwnedFd,
    number: u64,
    places: BTreeSet<u64>,
}

/// All ports of a bench.
pub(crate) struct Ports {
    watch: Watch,
    /// What has come, and is still to be taken.
    ready: VecDeque<(u64, EventFlags)>,
    listeners: BTreeMap<u64, tcp_listener::Listener>,
    /// Those where somebody knocks whose drive boots.
    booting: BTreeSet<u64>,
    places: BTreeMap<u64, Place>,
    /// The place of each client.
    clients: BTreeMap<Client, u64>,
    /// Those for which it matters that time goes on: it may make room for more of those that are not read.
    going: BTreeSet<u64>,
    /// Those that end, and when.
    ending: BTreeSet<(Instant, u64)>,
    rounds: BTreeMap<Duration, Round>,
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
            watch: Watch::new()?,
            ready: VecDeque::new(),
            listeners: BTreeMap::new(),
            booting: BTreeSet::new(),
            places: BTreeMap::new(),
            clients: BTreeMap::new(),
            going: BTreeSet::new(),
            ending: BTreeSet::new(),
            rounds: BTreeMap::new(),
            openings,
            ptys: BTreeMap::new(),
            stdio: None,
            last: 0,
        };
        let number = ports.number();
        ports.watch.add(number, &*ports.openings.borrow(), EventFlags::IN)?;
        Ok(ports)
    }

    /// Reaches `outlet` by a TCP port, from now on; returns its URI.
    ///
    /// # Errors
    /// The system refuses to listen, or gives no timer.
    pub(crate) fn add_tcp(&mut self, outlet: Outlet, bound: Bound) -> io::Result<String> {
        let listener = tcp_listener::Listener::new(outlet, bound)?;
        // Later there may be no descriptor left for its timer.
        self.round(CROWDED)?;
        let uri = format!("tcp:{}", listener.address());
        let number = self.number();
        self.watch.add(number, listener.socket(), EventFlags::IN)?;
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
        let number = self.place(Box::new(pty));
        self.ptys.insert(watch, number);
        self.note(bench, number);
        Ok(path)
    }

    /// Reaches `bus` by a serial port of this machine; returns its URI.
    pub(crate) fn add_serial(&mut self, bench: &mut Bench, bus: Bus, device: Device) -> String {
        let uri = device.uri();
        let number = self.place(Box::new(serial_device::Serial::new(bench, bus, device)));
        self.note(bench, number);
        uri
    }

    /// Reaches `bus` by standard input and output, with which the bench ends.
    ///
    /// # Errors
    /// The system gives no sockets or threads.
    pub(crate) fn add_stdio(&mut self, bench: &mut Bench, bus: Bus) -> io::Result<()> {
        let number = self.place(Box::new(stdio::Stdio::new(bench, bus)?));
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
        self.watch.add(number, fd, EventFlags::IN)?;
        Ok(number)
    }

    /// [`wait`](Self::wait) ends when `left`, which is not zero, has passed, and not when it was to before; `None`: not
    /// before something comes.
    pub(crate) fn set_alarm(&self, left: Option<Duration>) {
        self.watch.set_alarm(left);
    }

    /// Sleeps until something comes, or the alarm rings; if it `looks` only, it does not sleep.
    ///
    /// # Errors
    /// The system does not let it wait.
    pub(crate) fn wait(&mut self, looks: bool) -> io::Result<()> {
        self.watch.wait(looks)?;
        // Who is ready after those that are left over is so next time, too.
        if self.ready.is_empty() {
            self.ready.extend(self.watch.ready());
            // Who leaves makes room for who comes.
            let listeners = &self.listeners;
            self.ready.make_contiguous().sort_by_key(|(number, _)| listeners.contains_key(number));
        }
        Ok(())
    }

    /// Whether that woke it.
    pub(crate) fn is_ready(&self, number: u64) -> bool {
        self.watch.ready().any(|(ready, _)| ready == number)
    }

    /// When a port wants to be looked at though nothing comes.
    pub(crate) fn deadline(&self) -> Instant {
        self.ending.first().map_or(Instant::NEVER, |&(at, _)| at)
    }

    /// Whether the bench is of no use any more, because standard input has ended and all is answered.
    pub(crate) fn are_over(&self) -> bool {
        self.stdio.is_some_and(|stdio| !self.places.contains_key(&stdio))
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
            if let Some(place) = self.places.get_mut(&number) {
                let said = place.end.take(bench, flags, manual);
                let goes_on = flags.contains(EventFlags::OUT) && place.end.deliver(bench);
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
                self.go_round(bench, number);
            }
        }
    }

    /// Hands out what the drives have sent by now. Whether a drive is to hear something because of that: more of who
    /// has said more than he read, or that somebody has left.
    pub(crate) fn deliver(&mut self, bench: &mut Bench) -> bool {
        let audible = bench.audible().filter_map(|client| self.clients.get(&client).copied());
        let mut numbers: Vec<u64> = audible.chain(self.going.iter().copied()).collect();
        numbers.sort_unstable();
        numbers.dedup();
        let mut heard = false;
        for number in numbers {
            if let Some(place) = self.places.get_mut(&number) {
                heard |= place.end.deliver(bench);
                self.note(bench, number);
            }
        }
        self.listen_again(bench);
        while let Some(&(at, number)) = self.ending.first()
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

    fn place(&mut self, end: Box<dyn End>) -> u64 {
        let number = self.number();
        let place = Place { end, client: None, interest: None, ends: Instant::NEVER, pause: None };
        self.places.insert(number, place);
        number
    }

    /// Notes what has become of an end.
    fn note(&mut self, bench: &Bench, number: u64) {
        let Some(place) = self.places.get_mut(&number) else { return };
        let Place { end, client, interest, ends, pause } = place;
        if end.client() != *client {
            if let Some(gone) = std::mem::replace(client, end.client()) {
                self.clients.remove(&gone);
            }
            if let Some(client) = *client {
                self.clients.insert(client, number);
            }
        }
        let wanted = end.interest(bench);
        if wanted != *interest
            && let Some(fd) = end.fd()
        {
            let told = match (*interest, wanted) {
                (None, Some(wanted)) => self.watch.add(number, fd, wanted),
                (Some(_), Some(wanted)) => self.watch.change(number, fd, wanted),
                (_, None) => self.watch.remove(fd),
            };
            if let Err(error) = told {
                error!("a port cannot be waited for: {error}");
            }
        }
        *interest = wanted;
        if end.ends() != *ends {
            self.ending.remove(&(*ends, number));
            *ends = end.ends();
            self.ending.insert((*ends, number));
        }
        let reads = wanted.is_some_and(|wanted| wanted.contains(EventFlags::IN));
        let held_back = client.is_some() && !reads && *ends == Instant::NEVER;
        if held_back || end.goes_with_time() {
            self.going.insert(number);
        } else {
            self.going.remove(&number);
        }
        if end.pause() != *pause {
            let (old, new) = (std::mem::replace(pause, end.pause()), end.pause());
            self.look_every(number, old, new);
        }
    }

    /// An end is looked at in other rounds than before.
    fn look_every(&mut self, number: u64, old: Option<Duration>, new: Option<Duration>) {
        if let Some(round) = old.and_then(|pause| self.rounds.get_mut(&pause)) {
            round.places.remove(&number);
            if round.places.is_empty() {
                timer::stop(&round.timer);
            }
        }
        let Some(pause) = new else { return };
        let round = match self.round(pause) {
            Ok(round) => round,
            Err(error) => return error!("a port cannot be looked at again: {error}"),
        };
        if round.places.is_empty() {
            timer::start(&round.timer, pause);
        }
        round.places.insert(number);
    }

    /// Those that are looked at so long after each other.
    fn round(&mut self, pause: Duration) -> io::Result<&mut Round> {
        match self.rounds.entry(pause) {
            Entry::Occupied(round) => Ok(round.into_mut()),
            Entry::Vacant(vacant) => {
                let timer = timer::new()?;
                self.last += 1;
                self.watch.add(self.last, &timer, EventFlags::IN)?;
                Ok(vacant.insert(Round { timer, number: self.last, places: BTreeSet::new() }))
            }
        }
    }

    /// Looks at the ends of a round whose timer has told so, and listens again where nobody was let in.
    fn go_round(&mut self, bench: &mut Bench, timer: u64) {
        let Some(round) = self.rounds.values().find(|round| round.number == timer) else { return };
        timer::hear(&round.timer);
        for number in round.places.iter().copied().collect::<Vec<_>>() {
            if let Some(place) = self.places.get_mut(&number) {
                place.end.look(bench);
                self.note(bench, number);
            } else if let Some(listener) = self.listeners.get(&number) {
                if let Err(error) = self.watch.add(number, listener.socket(), EventFlags::IN) {
                    error!("tcp:{} lets nobody in any more: {error}", listener.address());
                }
                self.look_every(number, Some(CROWDED), None);
            }
        }
    }

    /// Listens again where a drive has booted by now.
    fn listen_again(&mut self, bench: &Bench) {
        let Self { booting, listeners, watch, .. } = self;
        booting.retain(|number| {
            let Some(listener) = listeners.get(number) else { return false };
            if !listener.is_open(bench) {
                return true;
            }
            if let Err(error) = watch.add(*number, listener.socket(), EventFlags::IN) {
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
                let _ = self.watch.remove(listener.socket());
                self.booting.insert(number);
                break;
            }
            match listener.accept(bench) {
                Ok(Some(connection)) => {
                    came |= connection.is_told();
                    let number = self.place(Box::new(connection));
                    self.note(bench, number);
                }
                Ok(None) => break,
                Err(_) => {
                    // Who is not let in knocks without end.
                    let _ = self.watch.remove(listener.socket());
                    self.look_every(number, None, Some(CROWDED));
                    break;
                }
            }
        }
        came
    }

    /// An end is of no use any more.
    fn remove(&mut self, bench: &mut Bench, number: u64) {
        let Some(mut place) = self.places.remove(&number) else { return };
        if let Some(fd) = place.end.fd() {
            // One that nothing is waited for is not there.
            let _ = self.watch.remove(fd);
        }
        place.end.leave(bench);
        if let Some(client) = place.client {
            self.clients.remove(&client);
        }
        self.ending.remove(&(place.ends, number));
        self.going.remove(&number);
        self.look_every(number, place.pause, None);
    }

    /// Tells each pty that somebody opened or left it, or wrote there, up to the first where something is said. Whether
    /// there is such.
    fn note_openings(&mut self, bench: &mut Bench, manual: bool) -> bool {
        loop {
            let Some(watch) = self.openings.borrow().next() else { return false };
            let place =
                self.ptys.get(&watch).and_then(|&number| Some((number, self.places.get_mut(&number)?)));
            let Some((number, place)) = place else {
                self.openings.borrow_mut().of(watch);
                continue;
            };
            let said = place.end.opened_or_closed(bench, manual);
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
enum Came<'a> {
    /// These bytes.
    Bytes(&'a [u8]),
    /// Nothing for now.
    Nothing,
    /// The other end is gone.
    End,
}

/// Reads what is there.
fn read_some(from: impl AsFd, room: &mut [MaybeUninit<u8>]) -> Came<'_> {
    match rustix::io::read(from, room) {
        Ok(([], _)) => Came::End,
        Ok((bytes, _)) => Came::Bytes(bytes),
        Err(rustix::io::Errno::AGAIN | rustix::io::Errno::INTR) => Came::Nothing,
        // Of a pty that nobody has open, or of a broken connection.
        Err(_) => Came::End,
    }
}
