//! TCP listeners: for a serial line, with raw characters or with RFC 2217 like a serial device server, or for a TCP
//! port of a drive.

use std::cell::Cell;
use std::io;
use std::net::{SocketAddr, TcpListener, TcpStream, ToSocketAddrs};
use std::os::fd::{AsFd as _, BorrowedFd, OwnedFd};
use std::rc::Rc;
use std::time::Duration;

use drivetwin_firmware::device::Instant;
use drivetwin_sim::bench::{Bench, Bus, Client, ConnectError, Ended, MOST_CONNECTIONS, Outlet};
use drivetwin_sim::config::listen::Uri;
use rustix::event::epoll::EventFlags;
use rustix::net::{AddressFamily, SocketFlags, SocketType, sockopt};
use tracing::{info, warn};

use super::remote_port::{RemotePort, Warning};
use super::unread::{Unread, share_mib};
use super::web::{BrowserCheck, Verdict};
use super::{BACKLOG_BYTES, Endpoint, ROOM, ReadResult, interest, may_read, note_arrival, read_some};
use crate::clock::Clock;
use crate::milestones::Milestones;

/// Interval at which a connection is polled after its client has sent everything, until the client leaves.
const POLL_INTERVAL: Duration = Duration::from_secs(1);

/// Number of polls after which such a connection is closed. The time is twice the longest delay of a reply.
const LINGER_POLLS: u32 = 120;

/// Number of polls after which a connection is closed that the drive or the host has ended.
const LINGER_POLLS_CLOSED: u32 = 5;

/// Idle time of a client after which the system sends keep-alive probes.
const KEEPALIVE_IDLE: Duration = Duration::from_secs(10);

/// Number of keep-alive probes, and the time between two probes.
const KEEPALIVE_PROBES: u32 = 4;
const KEEPALIVE_INTERVAL: Duration = Duration::from_secs(5);

/// Time without any acknowledgement by a client, after which the system drops its connection.
const USER_TIMEOUT: Duration = Duration::from_secs(30);

/// Maximum number of reads that empty a connection before it is closed. With unread input the system would
/// discard output that is still in transit.
const LAST_READS: usize = 16;

/// A TCP port that is reserved but does not listen yet.
pub(crate) struct Bound(OwnedFd);

/// Reserves `HOST:PORT`.
///
/// # Errors
/// This machine has no such address, or another program uses it.
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
    // A port that another process has just closed can be reserved at once.
    sockopt::set_socket_reuseaddr(&socket, true)?;
    rustix::net::bind(&socket, &address)?;
    Ok(Bound(socket))
}

/// Enables the detection of a lost client that did not close its connection: a pulled cable, a sleeping machine.
fn watch_over(stream: &TcpStream, outlet: Outlet) -> io::Result<()> {
    sockopt::set_tcp_keepidle(stream, KEEPALIVE_IDLE)?;
    sockopt::set_tcp_keepintvl(stream, KEEPALIVE_INTERVAL)?;
    sockopt::set_tcp_keepcnt(stream, KEEPALIVE_PROBES)?;
    sockopt::set_socket_keepalive(stream, true)?;
    // While output is not acknowledged the system sends no probes, so a timeout is needed. The timeout also
    // drops a client that is alive but does not read; for the stream of a serial line that is allowed, so it
    // has no timeout.
    if matches!(outlet, Outlet::Tcp(..)) {
        sockopt::set_tcp_user_timeout(stream, USER_TIMEOUT.as_millis() as u32)?;
    }
    Ok(())
}

impl Bound {
    /// Starts to listen. `backlog` is the number of connections that may wait to be accepted; the system may have a
    /// smaller limit. A client that finds no place tries again only after a second.
    ///
    /// # Errors
    /// Another program listens at this address already.
    pub(crate) fn listen(self, backlog: i32) -> io::Result<TcpListener> {
        rustix::net::listen(&self.0, backlog)?;
        Ok(self.0.into())
    }
}

/// Connections to a port that may wait: a burst of clients must not wait for a second.
const BACKLOG: i32 = 4_096;

/// A listener for a line, or for a TCP port of a drive.
pub(super) struct Listener {
    socket: TcpListener,
    outlet: Outlet,
    /// The line, if its clients control a serial port (RFC 2217).
    com_port: Option<Bus>,
    /// A clone of this is in each connection, so that its count shows the number of connections.
    site: Rc<Site>,
    /// True while a connection waits because the system has no room for it.
    crowded: bool,
    /// Number of connections that were refused, and those that the log shows.
    refused: u64,
    refused_logged: Milestones,
}

/// What a listener and its connections share.
pub(super) struct Site {
    uri: String,
    /// The last warning about a serial port. Many programs open a port for each request, and would be warned each time.
    warned: Cell<Option<Warning>>,
}

impl Site {
    /// The site of a listener with that URI.
    pub(super) fn new(uri: String) -> Self {
        Self { uri, warned: Cell::new(None) }
    }

    /// URI of the listener.
    pub(super) fn uri(&self) -> &str {
        &self.uri
    }

    /// Returns true if the last warning was another one.
    pub(super) fn is_new(&self, warning: Warning) -> bool {
        self.warned.replace(Some(warning)) != Some(warning)
    }
}

/// Connection to a client.
pub(super) struct Connection {
    stream: TcpStream,
    peer: SocketAddr,
    /// Clone of the listener's `site`, which counts the clients of the port.
    site: Rc<Site>,
    outlet: Outlet,
    client: Client,
    /// Check of the first bytes of the connection; `None` when it is complete.
    check: Option<BrowserCheck>,
    /// The serial port that the client controls, if the listener offers that.
    com_port: Option<RemotePort>,
    /// Bytes that the drives sent and the client has not taken.
    unread: Unread,
    /// True while the last bytes of the client may not be acknowledged yet.
    unacknowledged: bool,
    /// Number of polls that are left, after the client has sent everything or the connection has ended.
    linger_polls: Option<u32>,
    /// True when the connection is to be dropped.
    over: bool,
}

impl Listener {
    /// A listener for `outlet`, which listens from now on.
    ///
    /// # Errors
    /// The system does not let the port listen.
    pub(super) fn new(outlet: Outlet, bound: Bound) -> io::Result<Self> {
        Self::at(outlet, None, bound)
    }

    /// A listener for a line, whose clients control a serial port (RFC 2217).
    ///
    /// # Errors
    /// The system does not let the port listen.
    pub(super) fn with_com_port(bus: Bus, bound: Bound) -> io::Result<Self> {
        Self::at(Outlet::Line(bus), Some(bus), bound)
    }

    fn at(outlet: Outlet, com_port: Option<Bus>, bound: Bound) -> io::Result<Self> {
        let socket = bound.listen(BACKLOG)?;
        let address = socket.local_addr()?.to_string();
        let uri = if com_port.is_some() { Uri::Rfc2217(address) } else { Uri::Tcp(address) }.to_string();
        let site = Rc::new(Site::new(uri));
        let (refused, refused_logged) = (0, Milestones::default());
        Ok(Self { socket, outlet, com_port, site, crowded: false, refused, refused_logged })
    }

    /// URI of the listener.
    pub(super) fn uri(&self) -> &str {
        self.site.uri()
    }

    /// Returns whether the next connection can be accepted or refused now. Otherwise it waits.
    pub(super) fn is_open(&self, bench: &Bench) -> bool {
        bench.accepts(self.outlet)
    }

    /// The socket that is ready when a connection waits.
    pub(super) fn socket(&self) -> &TcpListener {
        &self.socket
    }

    /// Accepts the next connection that can be served.
    ///
    /// # Errors
    /// The system has no room for a further connection. This is logged once, until a connection is accepted
    /// again.
    pub(super) fn accept(&mut self, bench: &mut Bench) -> io::Result<Option<Connection>> {
        loop {
            let (stream, peer) = match self.socket.accept() {
                Ok(accepted) => accepted,
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(None),
                // The client left before its connection was accepted.
                Err(error) if error.kind() == io::ErrorKind::ConnectionAborted => continue,
                Err(error) => {
                    if !std::mem::replace(&mut self.crowded, true) {
                        warn!("{} cannot accept connections until the system has room: {error}", self.uri());
                    }
                    return Err(error);
                }
            };
            self.crowded = false;
            if Rc::strong_count(&self.site) > MOST_CONNECTIONS {
                self.log_refusal(peer, ConnectError::Full);
                continue;
            }
            let prepared = stream.set_nonblocking(true).and_then(|()| stream.set_nodelay(true));
            if let Err(error) = prepared.and_then(|()| watch_over(&stream, self.outlet)) {
                warn!("{peer} cannot be served: {error}");
                continue;
            }
            let client = match bench.join(self.outlet) {
                Ok(client) => client,
                Err(why) => {
                    self.log_refusal(peer, why);
                    continue;
                }
            };
            info!("{peer} connects to {}", self.uri());
            return Ok(Some(Connection {
                stream,
                peer,
                site: Rc::clone(&self.site),
                outlet: self.outlet,
                client,
                check: Some(BrowserCheck::new(matches!(self.outlet, Outlet::Line(_)))),
                com_port: self.com_port.map(|bus| RemotePort::new(bus, client, peer)),
                unread: Unread::default(),
                unacknowledged: false,
                linger_polls: None,
                over: false,
            }));
        }
    }

    /// Warns of the first refusal, and again at each power of ten, because many clients try again and again.
    fn log_refusal(&mut self, peer: SocketAddr, why: ConnectError) {
        if let Some(times) = self.count_refusal() {
            warn!("{peer} is refused at {}: {why}{times}", self.uri());
        }
    }

    /// Counts a refusal. If the log shows it, returns what the log says about the count.
    fn count_refusal(&mut self) -> Option<String> {
        self.refused += 1;
        let times = || match self.refused {
            1 => String::new(),
            count => format!(", {count} times so far"),
        };
        self.refused_logged.is_reached(self.refused).then(times)
    }
}

impl Connection {
    /// Returns whether the drive is notified of this connection.
    pub(super) fn is_reported(&self) -> bool {
        matches!(self.outlet, Outlet::Tcp(..))
    }

    /// Passes received bytes to the drive, unless the connection begins like that of a browser. Returns
    /// whether bytes were passed.
    fn pass(&mut self, bench: &mut Bench, bytes: &[u8]) -> bool {
        let Some(check) = &mut self.check else {
            return self.send(bench, bytes);
        };
        match check.inspect(bytes) {
            Verdict::Unclear => false,
            Verdict::Ordinary(bytes) => {
                self.check = None;
                self.send(bench, &bytes)
            }
            Verdict::Web => {
                warn!(
                    "{} is disconnected from {}: it sent an HTTP request or a TLS handshake, as browsers do; this is the port of a drive",
                    self.peer,
                    self.site.uri()
                );
                self.over = true;
                false
            }
        }
    }

    /// Sends received bytes to the drive. Returns whether this has an effect on the drive.
    fn send(&mut self, bench: &mut Bench, bytes: &[u8]) -> bool {
        match &mut self.com_port {
            Some(com_port) => com_port.take(bench, bytes, &self.site, &mut self.unread),
            None => {
                bench.send(self.client, bytes);
                true
            }
        }
    }

    /// Maximum unread output of this client in MiB. The listener and each of its clients have a clone of `site`.
    fn most_mib(&self) -> usize {
        share_mib(Rc::strong_count(&self.site) - 1)
    }

    /// Number of bytes that the client has not taken.
    fn unread(&self) -> usize {
        self.unread.len() + self.com_port.as_ref().map_or(0, RemotePort::held)
    }

    /// Returns whether the connection is about to be closed, and no more input is read.
    fn is_leaving(&self) -> bool {
        self.linger_polls.is_some()
    }
}

impl Endpoint for Connection {
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

    fn take(&mut self, bench: &mut Bench, ready: EventFlags, clock: Option<&Clock>) -> bool {
        if ready.contains(EventFlags::ERR) || (ready.contains(EventFlags::HUP) && self.is_leaving()) {
            self.over = true;
        } else if !self.is_leaving() && ready.intersects(EventFlags::IN | EventFlags::HUP) {
            let mut room = ROOM;
            match read_some(&self.stream, &mut room) {
                ReadResult::Bytes(bytes) => {
                    self.unacknowledged = true;
                    note_arrival(bench, clock);
                    return self.pass(bench, bytes);
                }
                // The client may have closed one direction only, and still wait for a reply.
                ReadResult::Closed => {
                    self.linger_polls = Some(LINGER_POLLS);
                    let held = self.check.take().map(|mut check| check.release()).unwrap_or_default();
                    let mut has_effect = !held.is_empty() && self.send(bench, &held);
                    if let Some(com_port) = &mut self.com_port {
                        has_effect |= com_port.end(bench);
                    }
                    return has_effect;
                }
                ReadResult::Nothing => {}
            }
        }
        false
    }

    fn deliver(&mut self, bench: &mut Bench) -> bool {
        match &mut self.com_port {
            Some(com_port) => com_port.receive(bench, &mut self.unread),
            None => self.unread.receive(bench, self.client),
        }
        let waits = self.unread.len();
        let written = self.unread.write(&self.stream);
        if self.unacknowledged && self.unread.len() == waits {
            // The drive has not answered, so the acknowledgement is sent now. Otherwise a client without
            // `TCP_NODELAY` could not send its next request for up to 40 ms. An answer carries the
            // acknowledgement.
            let _ = sockopt::set_tcp_quickack(&self.stream, true);
        }
        self.unacknowledged = false;
        bench.hold_back(self.client, self.unread.len() >= BACKLOG_BYTES);
        if written.is_err() {
            self.over = true;
        } else if self.unread() > self.most_mib() << 20 {
            warn!("{} is disconnected: it has left more than {} MiB unread", self.peer, self.most_mib());
            self.over = true;
        }
        if self.linger_polls.is_none()
            && let Some(ended) = bench.ended(self.client)
        {
            self.linger_polls = Some(LINGER_POLLS_CLOSED);
            match ended {
                Ended::Broken(_) => {
                    warn!("{} is disconnected from {}: {ended}", self.peer, self.site.uri());
                }
                Ended::ByDrive | Ended::NoPower | Ended::ByFault | Ended::BrokenByFault(_) => {
                    info!("{}, {}: {ended}", self.peer, self.site.uri());
                }
            }
        }
        self.over |= self.is_leaving() && self.unread() == 0 && bench.is_served(self.client);
        bench.is_under_way(self.client)
    }

    fn expires(&self) -> Instant {
        if self.over { Instant::ZERO } else { Instant::NEVER }
    }

    fn follows_time(&self) -> bool {
        self.unacknowledged
    }

    fn poll_interval(&self) -> Option<Duration> {
        self.linger_polls.map(|_| POLL_INTERVAL)
    }

    fn poll(&mut self, _bench: &mut Bench) {
        self.linger_polls = self.linger_polls.map(|left| left.saturating_sub(1));
        self.over |= self.linger_polls == Some(0);
    }

    fn leave(&mut self, bench: &mut Bench) {
        let mut room = ROOM;
        for _ in 0..LAST_READS {
            let ReadResult::Bytes(_) = read_some(&self.stream, &mut room) else { break };
        }
        info!("{} disconnects from {}", self.peer, self.site.uri());
        bench.disconnect(self.client);
        if let Some(com_port) = &mut self.com_port {
            com_port.hang_up(bench);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivetwin_firmware::device::Port;
    use drivetwin_sim::testing::echo_device::{EchoDevice, MCODE, MODBUS};

    /// A listener for a port of an echo device, with a client: both ends of its connection.
    fn connected(port: Port) -> (Bench, Listener, Connection, TcpStream) {
        let mut bench = Bench::new();
        let drive = bench.add::<EchoDevice>("echo");
        let mut listener = Listener::new(bench.outlet(drive, port), bind("127.0.0.1:0").unwrap()).unwrap();
        let far = TcpStream::connect(listener.uri().strip_prefix("tcp:").unwrap()).unwrap();
        loop {
            if let Some(connection) = listener.accept(&mut bench).unwrap() {
                return (bench, listener, connection, far);
            }
        }
    }

    #[test]
    fn a_client_that_never_reads_is_disconnected_after_its_share_of_the_port() {
        let (mut bench, listener, mut connection, _far) = connected(MCODE);
        // The answers have 12 MiB. The system buffers a part of them.
        bench.send(connection.client, &[b'f'; 12]);
        bench.run_until(Instant::ZERO);
        connection.deliver(&mut bench);
        // A client alone may leave 16 MiB unread; each of 64 clients 1 MiB (HOST-15).
        assert!(connection.unread.len() > 2 << 20, "{} bytes", connection.unread.len());
        assert!(!connection.over);
        let _others: Vec<Rc<Site>> = (1..64).map(|_| Rc::clone(&listener.site)).collect();
        connection.deliver(&mut bench);
        assert!(connection.over);
    }

    #[test]
    fn a_client_that_tries_again_and_again_is_logged_at_powers_of_ten() {
        let (mut bench, mut listener, connection, _far) = connected(MODBUS);
        let shown: Vec<String> = (0..20)
            .filter_map(|_| {
                // A connection that is accepted between two refusals changes nothing.
                let _far = TcpStream::connect(connection.stream.local_addr().unwrap()).unwrap();
                while listener.accept(&mut bench).unwrap().is_none() {}
                listener.count_refusal()
            })
            .collect();
        assert_eq!(shown, ["", ", 10 times so far"]);
    }

    #[test]
    fn who_is_silent_for_10_s_is_asked_and_after_30_s_is_gone() {
        let (_bench, _listener, Connection { stream, .. }, _far) = connected(MODBUS);
        assert!(sockopt::socket_keepalive(&stream).unwrap());
        let asks = sockopt::tcp_keepidle(&stream).unwrap();
        let again = sockopt::tcp_keepintvl(&stream).unwrap() * sockopt::tcp_keepcnt(&stream).unwrap();
        assert_eq!((asks.as_secs(), (asks + again).as_secs()), (10, 30));
        assert_eq!(sockopt::tcp_user_timeout(&stream).unwrap(), 30_000);
    }
}
