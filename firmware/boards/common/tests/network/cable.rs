//! A cable with a board's network at one end and a machine with clients at the other.

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::rc::Rc;

use drivetwin_board::network::{BYTES, FRAME_BYTES, Frames, LINKS, Network, PIECES, PLACES, Piece, Places};
use drivetwin_firmware::device::{
    Boot, Context, Duration, Framing, Input, Instant, Link, Port, PortSpec, PresetError, Spec,
};
use drivetwin_firmware::shell::{LinkEvent, Links};
use drivetwin_protocol::modbus::tcp::{Adu, Header, Splitter, read};
use smoltcp::iface::{Config, Interface, SocketHandle, SocketSet, SocketStorage};
use smoltcp::phy::{Device, DeviceCapabilities, RxToken, TxToken};
use smoltcp::socket::tcp::{Socket, SocketBuffer};
use smoltcp::time;
use smoltcp::wire::{EthernetAddress, HardwareAddress, IpAddress, IpCidr};

pub(crate) static SPEC: Spec = Spec {
    ports: &[
        PortSpec { name: "modbus", framing: Framing::Mbap, line: None },
        PortSpec { name: "mcode", framing: Framing::Return, line: None },
    ],
    ..Spec::EMPTY
};
pub(crate) const MODBUS: Port = Port(0);
pub(crate) const MCODE: Port = Port(1);

/// Numbers of the TCP ports (FB 6.3).
pub(crate) const NUMBERS: [u16; 2] = [502, 503];

/// Frames on the cable, in one direction.
pub(crate) type Way = Rc<RefCell<VecDeque<Vec<u8>>>>;

/// An end of a cable.
pub(crate) struct End {
    pub(crate) from: Way,
    pub(crate) to: Way,
    pub(crate) came: Rc<Cell<Instant>>,
}

impl Frames for End {
    fn has_frame(&self) -> bool {
        !self.from.borrow().is_empty()
    }

    fn came(&self) -> Instant {
        self.came.get()
    }
}

impl Device for End {
    type RxToken<'a> = Frame;
    type TxToken<'a> = Room;

    fn receive(&mut self, _now: time::Instant) -> Option<(Frame, Room)> {
        let frame = self.from.borrow_mut().pop_front()?;
        Some((Frame(frame), Room(self.to.clone())))
    }

    fn transmit(&mut self, _now: time::Instant) -> Option<Room> {
        Some(Room(self.to.clone()))
    }

    fn capabilities(&self) -> DeviceCapabilities {
        let mut capabilities = DeviceCapabilities::default();
        capabilities.max_transmission_unit = FRAME_BYTES;
        capabilities
    }
}

pub(crate) struct Frame(Vec<u8>);

impl RxToken for Frame {
    fn consume<R, F: FnOnce(&[u8]) -> R>(self, f: F) -> R {
        f(&self.0)
    }
}

pub(crate) struct Room(Way);

impl TxToken for Room {
    fn consume<R, F: FnOnce(&mut [u8]) -> R>(self, length: usize, f: F) -> R {
        let mut frame = vec![0; length];
        let result = f(&mut frame);
        self.0.borrow_mut().push_back(frame);
        result
    }
}

/// The state of the drive that its network asks for.
pub(crate) struct Drive {
    pub(crate) accepts: bool,
    /// True if the drive takes messages at its MCode port.
    pub(crate) takes: bool,
}

impl drivetwin_firmware::device::Device for Drive {
    fn spec(&self) -> &'static Spec {
        &SPEC
    }

    fn power_on(&mut self, _at: Instant, _boot: Boot, _out: &mut dyn Context) {}

    fn input(&mut self, _at: Instant, _input: Input<'_>, _out: &mut dyn Context) {}

    fn accepts(&self, _port: Port) -> bool {
        self.accepts
    }

    fn takes(&self, port: Port) -> bool {
        port != MCODE || self.takes
    }

    fn deadline(&self) -> Instant {
        Instant::NEVER
    }

    fn timeout(&mut self, _at: Instant, _out: &mut dyn Context) {}

    fn peek(&self, _at: Instant, _row: usize) -> i64 {
        0
    }

    fn poke(&mut self, _at: Instant, _row: usize, _: i64, _out: &mut dyn Context) -> Result<(), PresetError> {
        Err(PresetError::NoSuchRegister)
    }
}

/// An event that the drive gets: port, connection, kind, and message.
pub(crate) type Told = (Port, Link, LinkEvent, Vec<u8>);

/// A board and a machine with clients, which are connected.
pub(crate) struct Cable {
    pub(crate) board: Network<'static, End>,
    pub(crate) drive: Drive,
    pub(crate) here: End,
    pub(crate) machine: Interface,
    pub(crate) clients: SocketSet<'static>,
    pub(crate) now: Instant,
    pub(crate) told: Vec<Told>,
    /// The next free port of the machine.
    pub(crate) next: u16,
    /// Ports of the machine that drop all frames that they get, so that they never answer.
    pub(crate) silent: Vec<u16>,
    /// Time of the last frame.
    pub(crate) came: Rc<Cell<Instant>>,
}

impl Cable {
    pub(crate) fn new() -> Self {
        let [there, back] = [Way::default(), Way::default()];
        let places = Places {
            sockets: Box::leak(Box::new([SocketStorage::EMPTY; PLACES])),
            splitters: Box::leak(Box::new([const { Splitter::new() }; LINKS])),
            bytes: Box::leak(Box::new([0; BYTES])),
            long: Box::leak(Box::new([const { Piece::EMPTY }; PIECES])),
        };
        let came = Rc::new(Cell::new(Instant::ZERO));
        let end = End { from: there.clone(), to: back.clone(), came: came.clone() };
        let board = Network::new(&SPEC, end, [2, 0, 0, 0, 0, 1], 1, places);
        let mut here = End { from: back, to: there, came: came.clone() };
        let config = Config::new(HardwareAddress::Ethernet(EthernetAddress([2, 0, 0, 0, 0, 2])));
        let mut machine = Interface::new(config, &mut here, time::Instant::ZERO);
        machine.update_ip_addrs(|addresses| {
            addresses.push(IpCidr::new(IpAddress::v4(192, 168, 33, 2), 16)).expect("there is room for one");
        });
        let clients = SocketSet::new(Vec::new());
        Self {
            board,
            drive: Drive { accepts: true, takes: true },
            here,
            machine,
            clients,
            now: Instant::ZERO,
            told: Vec::new(),
            next: 50_000,
            silent: Vec::new(),
            came,
        }
    }

    /// Starts a connection to a port of the board.
    pub(crate) fn call(&mut self, port: Port) -> SocketHandle {
        let buffer = || SocketBuffer::new(vec![0; 2_000]);
        let mut socket = Socket::new(buffer(), buffer());
        let to = (IpAddress::v4(192, 168, 33, 1), NUMBERS[usize::from(port.0)]);
        socket.connect(self.machine.context(), to, self.next).expect("it is closed");
        self.next += 1;
        self.clients.add(socket)
    }

    pub(crate) fn client(&mut self, client: SocketHandle) -> &mut Socket<'static> {
        self.clients.get_mut(client)
    }

    pub(crate) fn say(&mut self, client: SocketHandle, bytes: &[u8]) {
        assert_eq!(self.client(client).send_slice(bytes), Ok(bytes.len()));
    }

    /// Takes the bytes that a client has received.
    pub(crate) fn hear(&mut self, client: SocketHandle) -> Vec<u8> {
        let mut heard = vec![0; 100_000];
        let count = self.client(client).recv_slice(&mut heard).unwrap_or(0);
        heard.truncate(count);
        heard
    }

    /// The machine receives the board's frames and sends its own.
    pub(crate) fn machine_speaks(&mut self) {
        /// Location of the destination port in a TCP packet.
        const PORT: std::ops::Range<usize> = 36..38;
        let is_heard = |frame: &Vec<u8>| {
            let port = frame.get(PORT).map(|port| u16::from_be_bytes([port[0], port[1]]));
            !port.is_some_and(|port| self.silent.contains(&port))
        };
        self.here.from.borrow_mut().retain(is_heard);
        let at = time::Instant::from_micros((self.now.ticks() / 16) as i64);
        self.machine.poll(at, &mut self.here, &mut self.clients);
    }

    /// Starts a connection, but sends nothing after the first packet.
    pub(crate) fn knock(&mut self, port: Port) {
        self.silent.push(self.next);
        let client = self.call(port);
        self.machine_speaks();
        self.clients.remove(client);
    }

    /// Advances the time by `ms`; `answer` handles the events at the drive. Returns these events.
    pub(crate) fn pass_with(
        &mut self,
        ms: u64,
        mut answer: impl FnMut(&mut Network<'static, End>, &Told),
    ) -> Vec<Told> {
        for _ in 0..ms {
            self.machine_speaks();
            self.came.set(self.now);
            self.turn(&mut answer);
            self.now += Duration::millis(1);
        }
        std::mem::take(&mut self.told)
    }

    pub(crate) fn pass(&mut self, ms: u64) -> Vec<Told> {
        self.pass_with(ms, |_, _| {})
    }

    /// Runs the board's loop once.
    pub(crate) fn turn(&mut self, mut answer: impl FnMut(&mut Network<'static, End>, &Told)) {
        let mut message = Adu::new();
        loop {
            match self.board.next(self.now, &self.drive, &mut message) {
                Ok((_, port, link, came)) => {
                    let bytes = if came == LinkEvent::Message { message.to_vec() } else { Vec::new() };
                    let told = (port, link, came, bytes);
                    answer(&mut self.board, &told);
                    self.told.push(told);
                }
                Err(again) if again > self.now => break,
                Err(_) => {}
            }
        }
    }

    /// Connects a client, and checks that the drive gets it as connection `link`.
    pub(crate) fn connected(&mut self, port: Port, link: u8) -> SocketHandle {
        let client = self.call(port);
        assert_eq!(self.pass(20), [(port, Link(link), LinkEvent::Opened, Vec::new())]);
        client
    }
}

pub(crate) fn request(transaction: u16) -> Adu {
    read(Header { transaction, unit: 1 }, 0x8B, 2)
}

/// Sends a message back to its client.
pub(crate) fn echo(board: &mut Network<'static, End>, (port, link, came, bytes): &Told) {
    if *came == LinkEvent::Message {
        assert!(board.send(*port, *link, bytes), "there is room");
    }
}
