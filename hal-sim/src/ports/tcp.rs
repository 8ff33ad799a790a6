//! A line reached by TCP: raw characters, as serial device servers carry them.

use std::io;
use std::net::{SocketAddr, TcpListener, TcpStream, ToSocketAddrs};
use std::os::fd::OwnedFd;

use rustix::event::{PollFd, PollFlags};
use rustix::net::{AddressFamily, SocketFlags, SocketType, sockopt};
use standin_firmware::device::{Duration, Instant};
use standin_sim::bench::{Bench, Bus, Client};
use tracing::{info, warn};

use super::{Came, READ_BYTES, UNREAD_BYTES, may_read, over, read_some, write_some};

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

/// A TCP port of a line, and who is connected.
pub(super) struct Listener {
    socket: TcpListener,
    address: SocketAddr,
    bus: Bus,
    clients: Vec<Connection>,
}

/// One client.
struct Connection {
    stream: TcpStream,
    peer: SocketAddr,
    client: Client,
    /// What the drives sent and it has not taken.
    unread: Vec<u8>,
    /// It sends no more, and is let go then.
    leaves: Option<Instant>,
    /// The connection is of no use any more.
    broken: bool,
}

impl Listener {
    /// A port of `bus` that listens from now on.
    ///
    /// # Errors
    /// The system refuses.
    pub(super) fn new(bus: Bus, bound: Bound) -> io::Result<Self> {
        let socket = bound.listen()?;
        let address = socket.local_addr()?;
        Ok(Self { socket, address, bus, clients: Vec::new() })
    }

    /// Where it listens.
    pub(super) fn address(&self) -> SocketAddr {
        self.address
    }

    /// When the next client is to be let go.
    pub(super) fn deadline(&self) -> Instant {
        self.clients.iter().filter_map(|client| client.leaves).min().unwrap_or(Instant::NEVER)
    }

    pub(super) fn watch<'a>(&'a self, bench: &Bench, fds: &mut Vec<PollFd<'a>>) {
        fds.push(PollFd::new(&self.socket, PollFlags::IN));
        for client in &self.clients {
            fds.push(PollFd::new(&client.stream, client.interest(bench)));
        }
    }

    pub(super) fn take(
        &mut self,
        bench: &mut Bench,
        ready: &mut impl Iterator<Item = PollFlags>,
        manual: bool,
    ) {
        let called = ready.next().is_some_and(|ready| !ready.is_empty());
        for client in &mut self.clients {
            client.take(bench, ready.next().unwrap_or(PollFlags::empty()), manual);
        }
        if called {
            self.accept(bench);
        }
    }

    pub(super) fn deliver(&mut self, bench: &mut Bench) {
        for client in &mut self.clients {
            client.deliver(bench);
        }
        let now = bench.now();
        self.clients.retain(|client| {
            let stays = !client.broken && client.leaves.is_none_or(|leaves| now < leaves);
            if !stays {
                info!("{} leaves tcp:{}", client.peer, self.address);
                bench.disconnect(client.client);
            }
            stays
        });
    }

    fn accept(&mut self, bench: &mut Bench) {
        while let Ok((stream, peer)) = self.socket.accept() {
            if self.clients.len() >= MAX_CLIENTS {
                warn!("{peer} is turned away from tcp:{}: {MAX_CLIENTS} are there", self.address);
                continue;
            }
            if let Err(error) = stream.set_nonblocking(true).and_then(|()| stream.set_nodelay(true)) {
                warn!("{peer} cannot be served: {error}");
                continue;
            }
            info!("{peer} comes to tcp:{}", self.address);
            let client = bench.connect(self.bus);
            self.clients.push(Connection {
                stream,
                peer,
                client,
                unread: Vec::new(),
                leaves: None,
                broken: false,
            });
        }
    }
}

impl Connection {
    fn interest(&self, bench: &Bench) -> PollFlags {
        let mut interest = PollFlags::empty();
        interest.set(PollFlags::IN, self.leaves.is_none() && may_read(bench, self.client, &self.unread));
        interest.set(PollFlags::OUT, !self.unread.is_empty());
        interest
    }

    fn take(&mut self, bench: &mut Bench, ready: PollFlags, manual: bool) {
        if ready.contains(PollFlags::ERR) || (ready.contains(PollFlags::HUP) && self.leaves.is_some()) {
            self.broken = true;
        } else if self.leaves.is_none() && ready.intersects(PollFlags::IN | PollFlags::HUP) {
            let mut buffer = [0; READ_BYTES];
            match read_some(&self.stream, &mut buffer) {
                Came::Bytes(count) => {
                    bench.send(self.client, &buffer[..count]);
                    over(bench, manual);
                }
                // It may have closed one direction only and wait for a reply; in manual time there is
                // none to wait for.
                Came::End => {
                    self.leaves = Some(if manual { bench.now() } else { bench.now() + LAST_WORDS });
                }
                Came::Nothing => {}
            }
        }
    }

    fn deliver(&mut self, bench: &mut Bench) {
        bench.receive(self.client, &mut self.unread);
        if write_some(&self.stream, &mut self.unread).is_err() {
            self.broken = true;
        } else if self.unread.len() > UNREAD_BYTES {
            warn!("{} does not read and is disconnected", self.peer);
            self.broken = true;
        }
    }
}
