//! A host at the other end of the board's Ethernet cable, which connects to the ports of a drive. It uses the
//! board's time.

use std::collections::{BTreeMap, VecDeque};

use drivetwin_firmware::device::{Duration, Framing, Instant, Link, Port, Spec};
use smoltcp::iface::{Config, Interface, SocketHandle, SocketSet};
use smoltcp::phy::{Device, DeviceCapabilities, Medium, RxToken, TxToken};
use smoltcp::socket::tcp::{Socket, SocketBuffer};
use smoltcp::time;
use smoltcp::wire::{EthernetAddress, HardwareAddress, IpAddress, IpCidr};

/// A connection as traces identify it.
pub(crate) type Connection = (Port, Link);

/// The factory address of the drive, and another address in the same network (FB 6.3).
const DRIVE: IpAddress = IpAddress::v4(192, 168, 33, 1);
const HERE: IpCidr = IpCidr::new(IpAddress::v4(192, 168, 33, 2), 16);
/// An arbitrary, locally administered Ethernet address.
const ADDRESS: EthernetAddress = EthernetAddress([2, 0, 0, 0, 0, 2]);
/// Bytes of the longest frame that the host sends. It may be longer than the board accepts.
const FRAME: usize = 1_514;
/// The first local port of the host.
const OWN: u16 = 49_152;
/// Size of the buffers of a connection in bytes, for each direction.
const ROOM: usize = 65_535;

/// The host with its connections.
pub(crate) struct Host {
    spec: &'static Spec,
    cable: Cable,
    interface: Interface,
    sockets: SocketSet<'static>,
    connections: BTreeMap<Connection, SocketHandle>,
    /// The next local port.
    port: u16,
}

impl Host {
    /// A host without connections.
    pub(crate) fn new(spec: &'static Spec) -> Self {
        let mut cable = Cable::default();
        let config = Config::new(HardwareAddress::Ethernet(ADDRESS));
        let mut interface = Interface::new(config, &mut cable, time::Instant::ZERO);
        interface.update_ip_addrs(|addresses| addresses.push(HERE).expect("there is room for one"));
        let sockets = SocketSet::new(Vec::new());
        Self { spec, cable, interface, sockets, connections: BTreeMap::new(), port: OWN }
    }

    /// Forgets all connections, because the board has lost power.
    pub(crate) fn forget(&mut self) {
        *self = Self { port: self.port, ..Self::new(self.spec) };
    }

    /// Connects to a port of the drive.
    pub(crate) fn open(&mut self, connection: Connection) {
        let number = match self.spec.ports[usize::from(connection.0.0)].framing {
            // FB 6.3.
            Framing::Mbap => 502,
            Framing::Return => 503,
            ends => panic!("no host protocol for a port whose messages end with {ends:?}"),
        };
        let buffer = || SocketBuffer::new(vec![0; ROOM]);
        let mut socket = Socket::new(buffer(), buffer());
        // Data and acknowledgements are sent at once.
        socket.set_nagle_enabled(false);
        socket.set_ack_delay(None);
        socket.connect(self.interface.context(), (DRIVE, number), self.port).expect("it is closed");
        self.port += 1;
        self.connections.insert(connection, self.sockets.add(socket));
    }

    pub(crate) fn say(&mut self, connection: Connection, bytes: &[u8]) {
        assert_eq!(self.socket(connection).send_slice(bytes), Ok(bytes.len()), "{connection:?} is open");
    }

    /// Closes the host's side of a connection.
    pub(crate) fn close(&mut self, connection: Connection) {
        self.socket(connection).close();
    }

    /// Receives frames from the board and does what is due. Returns the frames to send to the board.
    pub(crate) fn poll(&mut self, now: Instant, came: impl Iterator<Item = Vec<u8>>) -> Vec<Vec<u8>> {
        self.cable.came.extend(came);
        let at = time::Instant::from_micros((now.ticks() / Duration::micros(1).ticks()) as i64);
        self.interface.poll(at, &mut self.cable, &mut self.sockets);
        std::mem::take(&mut self.cable.leaves)
    }

    /// Bytes received on each connection since the last call.
    pub(crate) fn heard(&mut self) -> Vec<(Connection, Vec<u8>)> {
        let connections: Vec<Connection> = self.connections.keys().copied().collect();
        let heard = connections.into_iter().map(|connection| {
            let mut bytes = vec![0; ROOM];
            let count = self.socket(connection).recv_slice(&mut bytes).unwrap_or(0);
            bytes.truncate(count);
            (connection, bytes)
        });
        heard.filter(|(_, bytes)| !bytes.is_empty()).collect()
    }

    fn socket(&mut self, connection: Connection) -> &mut Socket<'static> {
        let socket = self.connections.get(&connection);
        self.sockets.get_mut(*socket.unwrap_or_else(|| panic!("{connection:?} was never opened")))
    }
}

/// Frames in the bytes of a [`Jack`](crate::machine::Jack), each preceded by its length.
pub(crate) fn frames(mut said: &[u8]) -> impl Iterator<Item = Vec<u8>> {
    std::iter::from_fn(move || {
        let (length, rest) = said.split_first_chunk()?;
        let (frame, rest) = rest.split_at(u32::from_be_bytes(*length) as usize);
        said = rest;
        Some(frame.to_vec())
    })
}

/// The host's end of the cable.
#[derive(Default)]
struct Cable {
    came: VecDeque<Vec<u8>>,
    leaves: Vec<Vec<u8>>,
}

impl Device for Cable {
    type RxToken<'a> = Frame;
    type TxToken<'a> = Room<'a>;

    fn receive(&mut self, _now: time::Instant) -> Option<(Frame, Room<'_>)> {
        Some((Frame(self.came.pop_front()?), Room(&mut self.leaves)))
    }

    fn transmit(&mut self, _now: time::Instant) -> Option<Room<'_>> {
        Some(Room(&mut self.leaves))
    }

    fn capabilities(&self) -> DeviceCapabilities {
        let mut capabilities = DeviceCapabilities::default();
        capabilities.medium = Medium::Ethernet;
        capabilities.max_transmission_unit = FRAME;
        capabilities
    }
}

struct Frame(Vec<u8>);

impl RxToken for Frame {
    fn consume<R, F: FnOnce(&[u8]) -> R>(self, take: F) -> R {
        take(&self.0)
    }
}

struct Room<'a>(&'a mut Vec<Vec<u8>>);

impl TxToken for Room<'_> {
    fn consume<R, F: FnOnce(&mut [u8]) -> R>(self, length: usize, write: F) -> R {
        let mut frame = vec![0; length];
        let result = write(&mut frame);
        self.0.push(frame);
        result
    }
}
