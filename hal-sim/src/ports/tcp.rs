//! A line reached by TCP: raw characters, as serial device servers carry them.

use std::io;
use std::net::{SocketAddr, TcpListener, TcpStream, ToSocketAddrs};
use std::os::fd::{AsFd as _, BorrowedFd, OwnedFd};
use std::rc::Rc;

use rustix::event::epoll::EventFlags;
use rustix::net::{AddressFamily, SocketFlags, SocketType, sockopt};
use standin_firmware::device::{Duration, Instant};
use standin_sim::bench::{Bench, Bus, Client};
use tracing::{info, warn};

use super::{Came, End, READ_BYTES, UNREAD_BYTES, interest, may_read, over, read_some, write_some};

/// Connections that a port takes at once; the next one is closed.
const MAX_CLIENTS: usize = 64;

/// How long somebody who has said all he has to say may still listen, in time of the bench.
const LAST_WORDS: Duration = Duration::secs(1);

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
    /// Where it is. Each connection has it, too, so they are counted by it.
    address: Rc<SocketAddr>,
}

/// One client.
pub(super) struct Connection {
    stream: TcpStream,
    peer: SocketAddr,
    address: Rc<SocketAddr>,
    client: Client,
    /// What the drives sent and it has not taken.
    unread: Vec<u8>,
    /// When it ends: it sends no more, or is of no use any more.
    ends: Instant,
}

impl Listener {
    /// A port of `bus` that listens from now on.
    ///
    /// # Errors
    /// The system refuses.
    pub(super) fn new(bus: Bus, bound: Bound) -> io::Result<Self> {
        let socket = bound.listen()?;
        let address = Rc::new(socket.local_addr()?);
        Ok(Self { socket, bus, address })
    }

    /// Where it listens.
    pub(super) fn address(&self) -> SocketAddr {
        *self.address
    }

    /// What tells that somebody knocks.
    pub(super) fn socket(&self) -> &TcpListener {
        &self.socket
    }

    /// The next one who knocks and can be served.
    ///
    /// # Errors
    /// The system has no room for one more.
    pub(super) fn accept(&self, bench: &mut Bench) -> io::Result<Option<Connection>> {
        loop {
            let (stream, peer) = match self.socket.accept() {
                Ok(accepted) => accepted,
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(None),
                // Who has left again before he was let in.
                Err(error) if error.kind() == io::ErrorKind::ConnectionAborted => continue,
                Err(error) => return Err(error),
            };
            if Rc::strong_count(&self.address) > MAX_CLIENTS {
                warn!("{peer} is turned away from tcp:{}: {MAX_CLIENTS} are there", self.address);
                continue;
            }
            if let Err(error) = stream.set_nonblocking(true).and_then(|()| stream.set_nodelay(true)) {
                warn!("{peer} cannot be served: {error}");
                continue;
            }
            info!("{peer} comes to tcp:{}", self.address);
            return Ok(Some(Connection {
                stream,
                peer,
                address: Rc::clone(&self.address),
                client: bench.connect(self.bus),
                unread: Vec::new(),
                ends: Instant::NEVER,
            }));
        }
    }
}

impl Connection {
    /// Whether it has said all that it has to say.
    fn is_leaving(&self) -> bool {
        self.ends < Instant::NEVER
    }

    /// It is of no use any more.
    fn broken(&mut self) {
        self.ends = Instant::ZERO;
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

    fn take(&mut self, bench: &mut Bench, ready: EventFlags, manual: bool) {
        if ready.contains(EventFlags::ERR) || (ready.contains(EventFlags::HUP) && self.is_leaving()) {
            self.broken();
        } else if !self.is_leaving() && ready.intersects(EventFlags::IN | EventFlags::HUP) {
            let mut buffer = [0; READ_BYTES];
            match read_some(&self.stream, &mut buffer) {
                Came::Bytes(count) => {
                    // Else a client without `TCP_NODELAY` is kept from its next request for up to 40 ms
                    // where the drive does not answer this one. It holds until the next read.
                    let _ = sockopt::set_tcp_quickack(&self.stream, true);
                    bench.send(self.client, &buffer[..count]);
                    over(bench, manual);
                }
                // It may have closed one direction only and wait for a reply; in manual time there is
                // none to wait for.
                Came::End => self.ends = if manual { bench.now() } else { bench.now() + LAST_WORDS },
                Came::Nothing => {}
            }
        }
    }

    fn deliver(&mut self, bench: &mut Bench) {
        bench.receive(self.client, &mut self.unread);
        if write_some(&self.stream, &mut self.unread).is_err() {
            self.broken();
        } else if self.unread.len() > UNREAD_BYTES {
            warn!("{} does not read and is disconnected", self.peer);
            self.broken();
        }
    }

    fn ends(&self) -> Instant {
        self.ends
    }

    fn leave(&mut self, bench: &mut Bench) {
        info!("{} leaves tcp:{}", self.peer, self.address);
        bench.disconnect(self.client);
    }
}
