//! A line reached by TCP: raw characters, as serial device servers carry them.

use std::cell::Cell;
use std::io;
use std::net::{SocketAddr, TcpListener, TcpStream, ToSocketAddrs};
use std::os::fd::{AsFd as _, BorrowedFd, OwnedFd};
use std::rc::Rc;
use std::time::Duration;

use rustix::event::epoll::EventFlags;
use rustix::net::{AddressFamily, SocketFlags, SocketType, sockopt};
use standin_firmware::device::Instant;
use standin_sim::bench::{Bench, Bus, Client};
use tracing::{info, warn};

use super::unread::{MOST_MIB, Unread};
use super::{Came, End, READ_BYTES, interest, may_read, read_some};

/// Connections that a port takes at once; the next one is closed.
const MAX_CLIENTS: usize = 64;

/// Time between two looks at somebody who has said all that he has to say.
const LOOK: Duration = Duration::from_secs(1);

/// Looks after which he has to leave, whatever he still waits for: twice as long as a line may hold up an answer.
const LAST_WORDS: u32 = 120;

/// A TCP port that is reserved, and does not listen yet.
pub(crate) struct Bound(OwnedFd);

/// Reserves `HOST:PORT`.
///
/// # Errors
/// There is no such address here, or somebody has it.
pub(crate) fn bind(address: &str) -> io::Result<Bound> {
    let mut last = io::Error::new(io::ErrorKind::NotFound, "no such host");
    for address in address.to_socket_addrs()? {
        match bind_at(address) {
            Ok(bound) => return Ok(bound),
            Err(error) => last = error,
        }
    }
    Err(last)
}

fn bind_at(address: SocketAddr) -> io::Result<Bound> {
    let family = if address.is_ipv4() { AddressFamily::INET } else { AddressFamily::INET6 };
    let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
    let socket = rustix::net::socket_with(family, SocketType::STREAM, flags, None)?;
    // A port left a moment ago is free.
    sockopt::set_socket_reuseaddr(&socket, true)?;
    rustix::net::bind(&socket, &address)?;
    Ok(Bound(socket))
}

impl Bound {
    /// Listens from now on.
    ///
    /// # Errors
    /// Somebody else listens there already.
    pub(crate) fn listen(self) -> io::Result<TcpListener> {
        rustix::net::listen(&self.0, 128)?;
        Ok(self.0.into())
    }
}

/// A TCP port of a line.
pub(super) struct Listener {
    socket: TcpListener,
    bus: Bus,
    address: SocketAddr,
    /// How many are there.
    clients: Rc<Cell<usize>>,
    /// Whether somebody knocks for whom the system has no room.
    crowded: bool,
}

/// One client.
pub(super) struct Connection {
    stream: TcpStream,
    peer: SocketAddr,
    address: SocketAddr,
    /// How many are at its port.
    clients: Rc<Cell<usize>>,
    bus: Bus,
    client: Client,
    /// What the drives sent and it has not taken.
    unread: Unread,
    /// Looks that are left to somebody who has said all that he has to say.
    last_words: Option<u32>,
    /// Whether it is of no use any more.
    over: bool,
}

impl Listener {
    /// A port of `bus` that listens from now on.
    ///
    /// # Errors
    /// The system refuses.
    pub(super) fn new(bus: Bus, bound: Bound) -> io::Result<Self> {
        let socket = bound.listen()?;
        let address = socket.local_addr()?;
        Ok(Self { socket, bus, address, clients: Rc::default(), crowded: false })
    }

    /// Where it listens.
    pub(super) fn address(&self) -> SocketAddr {
        self.address
    }

    /// What tells that somebody knocks.
    pub(super) fn socket(&self) -> &TcpListener {
        &self.socket
    }

    /// The next one who knocks and can be served.
    ///
    /// # Errors
    /// The system has no room for one more; so it is told once, until somebody is let in again.
    pub(super) fn accept(&mut self, bench: &mut Bench) -> io::Result<Option<Connection>> {
        loop {
            let (stream, peer) = match self.socket.accept() {
                Ok(accepted) => accepted,
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(None),
                // Who has left again before he was let in.
                Err(error) if error.kind() == io::ErrorKind::ConnectionAborted => continue,
                Err(error) => {
                    if !std::mem::replace(&mut self.crowded, true) {
                        warn!("tcp:{} lets nobody in until there is room: {error}", self.address);
                    }
                    return Err(error);
                }
            };
            self.crowded = false;
            if self.clients.get() == MAX_CLIENTS {
                warn!("{peer} is turned away from tcp:{}: {MAX_CLIENTS} are there", self.address);
                continue;
            }
            if let Err(error) = stream.set_nonblocking(true).and_then(|()| stream.set_nodelay(true)) {
                warn!("{peer} cannot be served: {error}");
                continue;
            }
            info!("{peer} comes to tcp:{}", self.address);
            self.clients.set(self.clients.get() + 1);
            return Ok(Some(Connection {
                stream,
                peer,
                address: self.address,
                clients: Rc::clone(&self.clients),
                bus: self.bus,
                client: bench.connect(self.bus),
                unread: Unread::default(),
                last_words: None,
                over: false,
            }));
        }
    }
}

impl Connection {
    /// Whether it has said all that it has to say.
    fn is_leaving(&self) -> bool {
        self.last_words.is_some()
    }
}

impl End for Connection {
    fn client(&self) -> Option<Client> {
        Some(self.client)
    }

    fn fd(&self) -> Option<BorrowedFd<'_>> {
        Some(self.stream.as_fd())
    }

    fn interest(&self, bench: &Bench) -> Option<EventFlags> {
        let reads = !self.is_leaving() && may_read(bench, self.client, &self.unread);
        Some(interest(reads, &self.unread))
    }

    fn take(&mut self, bench: &mut Bench, ready: EventFlags, _manual: bool) -> bool {
        if ready.contains(EventFlags::ERR) || (ready.contains(EventFlags::HUP) && self.is_leaving()) {
            self.over = true;
        } else if !self.is_leaving() && ready.intersects(EventFlags::IN | EventFlags::HUP) {
            let mut buffer = [0; READ_BYTES];
            match read_some(&self.stream, &mut buffer) {
                Came::Bytes(count) => {
                    // Else a client without `TCP_NODELAY` is kept from its next request for up to 40 ms
                    // where the drive does not answer this one. It holds until the next read.
                    let _ = sockopt::set_tcp_quickack(&self.stream, true);
                    bench.send(self.client, &buffer[..count]);
                    return true;
                }
                // It may have closed one direction only, and wait for a reply.
                Came::End => self.last_words = Some(LAST_WORDS),
                Came::Nothing => {}
            }
        }
        false
    }

    fn deliver(&mut self, bench: &mut Bench) {
        self.unread.receive(bench, self.client);
        if self.unread.write(&self.stream).is_err() {
            self.over = true;
        } else if self.unread.is_too_much() {
            warn!("{} is disconnected: it has left more than {MOST_MIB} MiB unread", self.peer);
            self.over = true;
        }
        self.over |= self.is_leaving() && self.unread.is_empty() && bench.is_free(self.bus);
    }

    fn ends(&self) -> Instant {
        if self.over { Instant::ZERO } else { Instant::NEVER }
    }

    fn pause(&self) -> Option<Duration> {
        self.last_words.map(|_| LOOK)
    }

    fn look(&mut self, _bench: &mut Bench) {
        self.last_words = self.last_words.map(|left| left.saturating_sub(1));
        self.over |= self.last_words == Some(0);
    }

    fn leave(&mut self, bench: &mut Bench) {
        self.clients.set(self.clients.get() - 1);
        info!("{} leaves tcp:{}", self.peer, self.address);
        bench.disconnect(self.client);
    }
}
