//! TCP connections to the ports of a board's drive, over smoltcp.

use drivetwin_firmware::device::{Device, Duration, Framing, Instant, Link, Port, Spec};
use drivetwin_firmware::shell::{LinkEvent, Links};
use drivetwin_protocol::modbus::tcp::{ADU_BYTES, Adu, Broken, Splitter};
use drivetwin_protocol::text::next_line;
use smoltcp::iface::{Config, Interface, PollIngressSingleResult, SocketHandle, SocketSet, SocketStorage};
use smoltcp::phy;
use smoltcp::socket::tcp::{Socket, SocketBuffer, State};
use smoltcp::time;
use smoltcp::wire::{EthernetAddress, HardwareAddress, IpAddress, IpCidr};

use crate::long::{Chain, Long};
pub use crate::long::{PIECES, Piece};

/// Number of bytes of the longest frame, without its check sequence. It contains the longest packet that
/// every host must accept (RFC 791). A host that respects the board's packet size sends no packet that is
/// longer.
pub const FRAME_BYTES: usize = 14 + 576;

/// Number of connections that each port accepts. A further one is refused.
pub const LINKS: usize = 4;
/// Number of TCP ports that a drive may have on a board. One of them is for Modbus; further ports accept no
/// connections.
pub const PORTS: usize = 2;
/// Number of connections of all ports.
pub const PLACES: usize = PORTS * LINKS;
/// Number of buffer bytes for all connections.
pub const BYTES: usize = PLACES * (UNHEARD + UNSENT);

/// Buffer of a connection for bytes that were received and not taken yet.
const UNHEARD: usize = 256;
/// Buffer of a connection for answers that are not sent yet. What does not fit is a long answer; all long
/// answers share one buffer.
const UNSENT: usize = 640;
/// Number of unsent bytes above which a connection is not read.
const ENOUGH: usize = UNSENT / 2;
const _: () = assert!(UNSENT - ENOUGH >= ADU_BYTES, "a Modbus reply always has room");

/// Maximum number of frames that are taken before the drive runs again.
const BURST: usize = 8;
/// Interval of the keep-alive probes, which check whether a silent client is still there.
const LOOK: time::Duration = time::Duration::from_secs(10);
/// Silence after which a client counts as gone.
const GONE: time::Duration = time::Duration::from_secs(30);
/// Longest time until a connection is established. It is long enough for the board's answer to be lost and
/// sent again.
const KNOCK: time::Duration = time::Duration::from_secs(3);
/// Longest time in which a client takes the last bytes before the connection is reset.
const FAREWELL: Duration = Duration::secs(10);

/// The factory address of an MDrive, 192.168.33.1, and its subnet mask, 255.255.0.0 (FB 6.3).
const ADDRESS: IpCidr = IpCidr::new(IpAddress::v4(192, 168, 33, 1), 16);

/// A network controller.
pub trait Frames: phy::Device {
    /// Returns whether a received frame waits.
    fn has_frame(&self) -> bool;

    /// Time at which the last frame was received.
    fn came(&self) -> Instant;
}

/// Memory of the connections. On a board with a network it is the largest part of RAM.
pub struct Places<'a> {
    /// The connections.
    pub sockets: &'a mut [SocketStorage<'a>; PLACES],
    /// Splitters of Modbus requests.
    pub splitters: &'a mut [Splitter; LINKS],
    /// Buffers of received and unsent bytes.
    pub bytes: &'a mut [u8; BYTES],
    /// Long answers.
    pub long: &'a mut [Piece; PIECES],
}

/// The network of a board.
pub struct Network<'a, F> {
    frames: F,
    interface: Interface,
    sockets: SocketSet<'a>,
    connections: heapless::Vec<Connection<'a>, PLACES>,
    long: Long<'a>,
    /// Index of the connection that is polled next.
    turn: usize,
    /// Time of the next poll.
    due: Instant,
    /// Timestamp of the events of the last poll.
    at: Instant,
}

impl<'a, F: Frames> Network<'a, F> {
    /// The ports of a drive, at this Ethernet address. `seed` makes the sequence numbers of a connection hard
    /// to guess. The stack that this needs is free again when it returns.
    #[inline(never)]
    pub fn new(spec: &Spec, mut frames: F, address: [u8; 6], seed: u64, places: Places<'a>) -> Self {
        let mut config = Config::new(HardwareAddress::Ethernet(EthernetAddress(address)));
        config.random_seed = seed;
        let mut interface = Interface::new(config, &mut frames, time::Instant::ZERO);
        interface.update_ip_addrs(|addresses| {
            let _ = addresses.push(ADDRESS);
        });
        let mut sockets = SocketSet::new(&mut places.sockets[..]);
        let mut connections = heapless::Vec::new();
        let mut splitters = places.splitters.iter_mut();
        let mut bytes = &mut places.bytes[..];
        let ports = (0..).map(Port).zip(spec.ports).flat_map(|(port, of)| [(port, of.framing); LINKS]);
        for ((port, ends), link) in ports.zip((0..LINKS as u8).cycle().map(Link)) {
            let Some(framing) = Framer::of(ends, &mut splitters) else { continue };
            let Some((heard, rest)) = bytes.split_at_mut_checked(UNHEARD) else { break };
            let Some((said, rest)) = rest.split_at_mut_checked(UNSENT) else { break };
            bytes = rest;
            let mut socket = Socket::new(SocketBuffer::new(heard), SocketBuffer::new(said));
            // Without Nagle's algorithm an answer is sent at once.
            socket.set_nagle_enabled(false);
            socket.set_keep_alive(Some(LOOK));
            let socket = sockets.add(socket);
            let (long, stage) = (Chain::default(), Stage::Free);
            let _ = connections.push(Connection { port, link, socket, framing, long, stage });
        }
        let long = Long::new(places.long);
        Self { frames, interface, sockets, connections, long, turn: 0, due: Instant::ZERO, at: Instant::ZERO }
    }

    /// Polls the connections in turn until one has an event for the drive.
    fn ask(
        &mut self,
        now: Instant,
        device: &dyn Device,
        message: &mut Adu,
    ) -> Option<(Instant, Port, Link, LinkEvent)> {
        for connection in self.connections.iter_mut().skip(self.turn) {
            self.turn += 1;
            let socket = self.sockets.get_mut::<Socket<'_>>(connection.socket);
            // If the connection has ended, the remaining bytes are dropped.
            let send = |rest: &[u8]| socket.send_slice(rest).unwrap_or(rest.len());
            if self.long.leave(&mut connection.long, send) {
                self.due = now;
            }
            if let Some(came) = connection.next(socket, now, device, message) {
                // An early poll announces the larger window, or the end of the connection.
                self.due = now;
                return Some((self.at, connection.port, connection.link, came));
            }
        }
        self.turn = 0;
        None
    }

    /// Receives frames and sends some.
    fn poll(&mut self, now: Instant) {
        self.at = if self.frames.has_frame() { self.frames.came().min(now) } else { now };
        let at = time::Instant::from_micros((now.ticks() >> 4) as i64);
        let Self { frames, interface, sockets, .. } = self;
        for _ in 0..BURST {
            if interface.poll_ingress_single(at, frames, sockets) == PollIngressSingleResult::None {
                break;
            }
        }
        interface.poll_egress(at, frames, sockets);
        let due =
            interface.poll_at(at, sockets).map(|due| Instant::from_ticks((due.total_micros() as u64) << 4));
        let leaves = self.connections.iter().filter_map(|connection| match connection.stage {
            Stage::Leaves(until) => until,
            _ => None,
        });
        self.due = leaves.chain(due).min().unwrap_or(Instant::NEVER);
    }
}

impl<F: Frames> Links for Network<'_, F> {
    fn next(
        &mut self,
        now: Instant,
        device: &dyn Device,
        message: &mut Adu,
    ) -> Result<(Instant, Port, Link, LinkEvent), Instant> {
        if let Some(came) = self.ask(now, device, message) {
            return Ok(came);
        }
        if self.due <= now || self.frames.has_frame() {
            self.poll(now);
            if let Some(came) = self.ask(now, device, message) {
                return Ok(came);
            }
        }
        Err(if self.frames.has_frame() { now } else { self.due })
    }

    fn send(&mut self, port: Port, link: Link, bytes: &[u8]) -> bool {
        self.due = Instant::ZERO;
        let is = |of: &&mut Connection<'_>| of.is_open(port, link);
        let Some(connection) = self.connections.iter_mut().find(is) else { return true };
        let socket = self.sockets.get_mut::<Socket<'_>>(connection.socket);
        if !socket.may_send() {
            return true;
        }
        let room = socket.send_capacity().saturating_sub(socket.send_queue());
        let fits = if connection.long.is_empty() && bytes.len() <= room {
            socket.send_slice(bytes).is_ok()
        } else {
            self.long.put(&mut connection.long, bytes)
        };
        if !fits {
            socket.abort();
        }
        fits
    }

    fn close(&mut self, port: Port, link: Link) {
        self.due = Instant::ZERO;
        if let Some(connection) = self.connections.iter_mut().find(|of| of.is_open(port, link)) {
            connection.stage = Stage::Leaves(None);
        }
    }
}

/// A connection, or a free slot for one.
struct Connection<'a> {
    port: Port,
    link: Link,
    socket: SocketHandle,
    framing: Framer<'a>,
    /// The part of a long answer that is not in the socket's buffer yet.
    long: Chain,
    stage: Stage,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Stage {
    /// No client of the drive is connected.
    Free,
    /// The drive has a client.
    Open,
    /// Closed for the drive. Bytes already written are still sent, until this instant at the latest.
    Leaves(Option<Instant>),
}

impl Connection<'_> {
    /// Returns whether this is the drive's open connection `link` at `port`.
    fn is_open(&self, port: Port, link: Link) -> bool {
        self.port == port && self.link == link && self.stage == Stage::Open
    }

    /// The next event of the connection for the drive.
    fn next(
        &mut self,
        socket: &mut Socket<'_>,
        now: Instant,
        device: &dyn Device,
        message: &mut Adu,
    ) -> Option<LinkEvent> {
        let waits = !self.long.is_empty();
        match self.stage {
            // The message waits in the TCP window.
            Stage::Open if !device.takes(self.port) => None,
            Stage::Open if !socket.is_active() => {
                self.stage = Stage::Free;
                Some(LinkEvent::Closed)
            }
            Stage::Open if waits || socket.send_queue() > ENOUGH => None,
            Stage::Open => {
                while socket.can_recv() {
                    match self.framing.take(socket, message) {
                        Ok(true) => return Some(LinkEvent::Message),
                        Ok(false) => {}
                        Err(Broken::Protocol | Broken::Length) => {
                            self.stage = Stage::Leaves(None);
                            return Some(LinkEvent::Closed);
                        }
                    }
                }
                if socket.state() != State::CloseWait {
                    return None;
                }
                // The client has sent all its data.
                self.stage = Stage::Leaves(None);
                Some(LinkEvent::Closed)
            }
            // A client that connects before the drive accepts connections waits, as in the backlog of a host.
            Stage::Free if socket.may_send() && device.accepts(self.port) => {
                self.stage = Stage::Open;
                socket.set_timeout(Some(GONE));
                self.framing.begin();
                Some(LinkEvent::Opened)
            }
            Stage::Free => {
                self.listen(socket);
                None
            }
            Stage::Leaves(until) => {
                let until = until.unwrap_or(now + FAREWELL);
                self.stage = Stage::Leaves(Some(until));
                let _ = socket.recv(|unheard| (unheard.len(), ()));
                if now >= until {
                    socket.abort();
                } else if !waits {
                    socket.close();
                }
                if !socket.is_active() {
                    self.stage = Stage::Free;
                    self.listen(socket);
                }
                None
            }
        }
    }

    /// Listens for another client, unless a reset is still to be sent.
    fn listen(&self, socket: &mut Socket<'_>) {
        if socket.state() == State::TimeWait || socket.remote_endpoint().is_none() {
            socket.set_timeout(Some(KNOCK));
            let _ = socket.listen(self.framing.port());
        }
    }
}

/// Splits received bytes into messages.
enum Framer<'a> {
    /// By the length in the header of a message: Modbus/TCP.
    Mbap(&'a mut Splitter),
    /// By the end of a text line: MCode.
    Return,
}

impl<'a> Framer<'a> {
    /// Framer for this framing; `None` if the port is not a TCP port.
    fn of(framing: Framing, splitters: &mut impl Iterator<Item = &'a mut Splitter>) -> Option<Self> {
        match framing {
            Framing::Mbap => splitters.next().map(Self::Mbap),
            Framing::Return => Some(Self::Return),
            Framing::Silence | Framing::Character => None,
        }
    }

    /// Number of the TCP port (FB 6.3).
    fn port(&self) -> u16 {
        match self {
            Self::Mbap(_) => 502,
            Self::Return => 503,
        }
    }

    /// Prepares for a new connection.
    fn begin(&mut self) {
        if let Self::Mbap(splitter) = self {
            **splitter = Splitter::new();
        }
    }

    /// Takes received bytes. Returns whether they complete a message.
    fn take(&mut self, socket: &mut Socket<'_>, message: &mut Adu) -> Result<bool, Broken> {
        let taken = socket.recv(|came| match self {
            Self::Mbap(splitter) => {
                let mut rest = &*came;
                let whole = splitter.next(&mut rest).map(|adu| match adu {
                    Some(adu) => {
                        message.clear();
                        message.extend_from_slice(adu).is_ok()
                    }
                    None => false,
                });
                (came.len().saturating_sub(rest.len()), whole)
            }
            Self::Return => {
                message.clear();
                let mut rest = came.get(..message.capacity()).unwrap_or(came);
                let _ = message.extend_from_slice(next_line(&mut rest).unwrap_or_default());
                (message.len(), Ok(!message.is_empty()))
            }
        });
        taken.unwrap_or(Ok(false))
    }
}
