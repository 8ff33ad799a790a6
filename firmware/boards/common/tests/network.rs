//! The TCP ports of a board, with clients on the other end of a cable. Nothing here takes the time of the machine.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;

use smoltcp::iface::{Config, Interface, SocketHandle, SocketSet, SocketStorage};
use smoltcp::phy::{Device, DeviceCapabilities, RxToken, TxToken};
use smoltcp::socket::tcp::{Socket, SocketBuffer, State};
use smoltcp::time;
use smoltcp::wire::{EthernetAddress, HardwareAddress, IpAddress, IpCidr};
use standin_board::network::{BYTES, FRAME_BYTES, Frames, LINKS, LONG, Network, PLACES, Places};
use standin_firmware::device::{Duration, Ends, Instant, Link, Port, PortSpec, Spec};
use standin_firmware::shell::{Came, Links};
use standin_protocol::modbus::tcp::{Adu, Header, Splitter, read};

static SPEC: Spec = Spec {
    ports: &[
        PortSpec { name: "modbus", ends: Ends::Mbap, line: None },
        PortSpec { name: "mcode", ends: Ends::Return, line: None },
    ],
    ..Spec::BARE
};
const MODBUS: Port = Port(0);
const MCODE: Port = Port(1);

/// The numbers of the ports on the network (FB 6.3).
const NUMBERS: [u16; 2] = [502, 503];

/// Frames on their way.
type Way = Rc<RefCell<VecDeque<Vec<u8>>>>;

/// One end of a cable.
struct End {
    from: Way,
    to: Way,
}

impl Frames for End {
    fn has_frame(&self) -> bool {
        !self.from.borrow().is_empty()
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

struct Frame(Vec<u8>);

impl RxToken for Frame {
    fn consume<R, F: FnOnce(&[u8]) -> R>(self, f: F) -> R {
        f(&self.0)
    }
}

struct Room(Way);

impl TxToken for Room {
    fn consume<R, F: FnOnce(&mut [u8]) -> R>(self, length: usize, f: F) -> R {
        let mut frame = vec![0; length];
        let result = f(&mut frame);
        self.0.borrow_mut().push_back(frame);
        result
    }
}

/// What the drive was told: where, and a message.
type Told = (Port, Link, Came, Vec<u8>);

/// A board, and a machine with clients.
struct Cable {
    board: Network<'static, End>,
    here: End,
    machine: Interface,
    clients: SocketSet<'static>,
    now: Instant,
    told: Vec<Told>,
    /// The next free port of the machine.
    next: u16,
}

impl Cable {
    fn new() -> Self {
        let [there, back] = [Way::default(), Way::default()];
        let places = Places {
            sockets: Box::leak(Box::new([SocketStorage::EMPTY; PLACES])),
            splitters: Box::leak(Box::new([const { Splitter::new() }; LINKS])),
            bytes: Box::leak(Box::new([0; BYTES])),
            long: Box::leak(Box::new([0; LONG])),
        };
        let end = End { from: there.clone(), to: back.clone() };
        let board = Network::new(&SPEC, end, [2, 0, 0, 0, 0, 1], 1, places);
        let mut here = End { from: back, to: there };
        let config = Config::new(HardwareAddress::Ethernet(EthernetAddress([2, 0, 0, 0, 0, 2])));
        let mut machine = Interface::new(config, &mut here, time::Instant::ZERO);
        machine.update_ip_addrs(|addresses| {
            addresses.push(IpCidr::new(IpAddress::v4(192, 168, 33, 2), 16)).expect("there is room for one");
        });
        let clients = SocketSet::new(Vec::new());
        Self { board, here, machine, clients, now: Instant::ZERO, told: Vec::new(), next: 50_000 }
    }

    /// Somebody connects to a port of the board.
    fn call(&mut self, port: Port) -> SocketHandle {
        let buffer = || SocketBuffer::new(vec![0; 2_000]);
        let mut socket = Socket::new(buffer(), buffer());
        let to = (IpAddress::v4(192, 168, 33, 1), NUMBERS[usize::from(port.0)]);
        socket.connect(self.machine.context(), to, self.next).expect("it is closed");
        self.next += 1;
        self.clients.add(socket)
    }

    fn client(&mut self, client: SocketHandle) -> &mut Socket<'static> {
        self.clients.get_mut(client)
    }

    fn say(&mut self, client: SocketHandle, bytes: &[u8]) {
        assert_eq!(self.client(client).send_slice(bytes), Ok(bytes.len()));
    }

    /// What came to a client and it takes now.
    fn hear(&mut self, client: SocketHandle) -> Vec<u8> {
        let mut heard = vec![0; 100_000];
        let count = self.client(client).recv_slice(&mut heard).unwrap_or(0);
        heard.truncate(count);
        heard
    }

    /// Lets so many ms pass; the drive answers what it is told by `answer`. Returns what it was told.
    fn pass_with(&mut self, ms: u64, mut answer: impl FnMut(&mut Network<'static, End>, &Told)) -> Vec<Told> {
        for _ in 0..ms {
            let at = time::Instant::from_micros((self.now.ticks() / 16) as i64);
            self.machine.poll(at, &mut self.here, &mut self.clients);
            self.turn(&mut answer);
            self.now += Duration::millis(1);
        }
        std::mem::take(&mut self.told)
    }

    fn pass(&mut self, ms: u64) -> Vec<Told> {
        self.pass_with(ms, |_, _| {})
    }

    /// What the board's loop does.
    fn turn(&mut self, mut answer: impl FnMut(&mut Network<'static, End>, &Told)) {
        let mut message = Adu::new();
        loop {
            match self.board.next(self.now, &mut message) {
                Ok((port, link, came)) => {
                    let bytes = if came == Came::Message { message.to_vec() } else { Vec::new() };
                    let told = (port, link, came, bytes);
                    answer(&mut self.board, &told);
                    self.told.push(told);
                }
                Err(again) if again > self.now => break,
                Err(_) => {}
            }
        }
    }

    /// Somebody who is connected, as that link.
    fn connected(&mut self, port: Port, link: u8) -> SocketHandle {
        let client = self.call(port);
        assert_eq!(self.pass(20), [(port, Link(link), Came::Opened, Vec::new())]);
        client
    }
}

fn request(transaction: u16) -> Adu {
    read(Header { transaction, unit: 1 }, 0x8B, 2)
}

/// The drive says what it hears.
fn echo(board: &mut Network<'static, End>, (port, link, came, bytes): &Told) {
    if *came == Came::Message {
        assert!(board.send(*port, *link, bytes), "there is room");
    }
}

#[test]
fn whole_requests_however_they_are_cut() {
    let mut cable = Cable::new();
    let client = cable.connected(MODBUS, 0);
    let (one, two) = (request(1), request(2));
    cable.say(client, &one[..3]);
    assert_eq!(cable.pass(20), []);
    cable.say(client, &[&one[3..], &two[..], &one[..1]].concat());
    let message = |bytes: &[u8]| (MODBUS, Link(0), Came::Message, bytes.to_vec());
    assert_eq!(cable.pass_with(20, echo), [message(&one), message(&two)]);
    assert_eq!(cable.hear(client), [&one[..], &two[..]].concat());
    cable.say(client, &one[1..]);
    assert_eq!(cable.pass(20), [message(&one)]);
}

#[test]
fn mcode_comes_at_once_and_never_past_a_return() {
    let mut cable = Cable::new();
    let client = cable.connected(MCODE, 0);
    cable.say(client, b"PR V\rPR P\r\nVM");
    let message = |bytes: &[u8]| (MCODE, Link(0), Came::Message, bytes.to_vec());
    assert_eq!(cable.pass(20), [message(b"PR V\r"), message(b"PR P\r"), message(b"\nVM")]);
}

#[test]
fn a_connection_has_the_lowest_free_number_and_the_fifth_is_refused() {
    let mut cable = Cable::new();
    let clients: Vec<_> = (0..LINKS as u8).map(|link| cable.connected(MCODE, link)).collect();
    let fifth = cable.call(MCODE);
    assert_eq!(cable.pass(20), []);
    assert_eq!(cable.client(fifth).state(), State::Closed);
    // The other port has its own.
    cable.connected(MODBUS, 0);
    for link in [2, 1] {
        cable.client(clients[link]).close();
        assert_eq!(cable.pass(20), [(MCODE, Link(link as u8), Came::Closed, Vec::new())]);
    }
    cable.connected(MCODE, 1);
    cable.connected(MCODE, 2);
}

#[test]
fn a_wrong_header_closes_its_connection_behind_what_was_answered() {
    let mut cable = Cable::new();
    let [wrong, right] = [0, 1].map(|link| cable.connected(MODBUS, link));
    cable.say(wrong, &[&request(1)[..], &[0, 2, 0, 7]].concat());
    let told = cable.pass_with(20, echo);
    let told: Vec<_> = told.iter().map(|(_, link, came, _)| (*link, *came)).collect();
    assert_eq!(told, [(Link(0), Came::Message), (Link(0), Came::Closed)]);
    assert_eq!(cable.hear(wrong), request(1)[..]);
    assert!(!cable.client(wrong).may_recv(), "there comes no more");
    cable.say(right, &request(3));
    cable.pass_with(20, echo);
    assert_eq!(cable.hear(right), request(3)[..]);
}

#[test]
fn who_has_said_all_hears_what_is_due_before_he_is_closed() {
    let mut cable = Cable::new();
    let client = cable.connected(MODBUS, 0);
    cable.say(client, &request(1));
    cable.client(client).close();
    let told = cable.pass_with(20, echo);
    assert_eq!(told.last(), Some(&(MODBUS, Link(0), Came::Closed, Vec::new())));
    assert_eq!(cable.hear(client), request(1)[..]);
    cable.connected(MODBUS, 0);
}

#[test]
fn nothing_is_taken_from_who_does_not_take_his_answers() {
    const REQUESTS: u16 = 2_000;
    let mut cable = Cable::new();
    let [deaf, other] = [0, 1].map(|link| cable.connected(MODBUS, link));
    let mut all: VecDeque<u8> = (0..REQUESTS).flat_map(|n| request(n).to_vec()).collect();
    let say_more = |cable: &mut Cable, all: &mut VecDeque<u8>| {
        let said = cable.client(deaf).send_slice(all.make_contiguous()).expect("it is open");
        all.drain(..said);
    };
    for _ in 0..100 {
        say_more(&mut cable, &mut all);
        cable.pass_with(20, echo);
    }
    assert!(!all.is_empty(), "nobody takes more");
    cable.say(other, &request(7));
    cable.pass_with(20, echo);
    assert_eq!(cable.hear(other), request(7)[..], "others are served");
    // In the end not one answer is missing.
    let mut heard = Vec::new();
    for _ in 0..2_000 {
        heard.extend(cable.hear(deaf));
        say_more(&mut cable, &mut all);
        cable.pass_with(20, echo);
    }
    let expected: Vec<u8> = (0..REQUESTS).flat_map(|n| request(n).to_vec()).collect();
    assert_eq!(heard, expected);
}

#[test]
fn one_long_answer_has_room_and_another_one_meanwhile_closes() {
    let mut cable = Cable::new();
    let [one, two] = [0, 1].map(|link| cable.connected(MCODE, link));
    let line = |n: usize| [b'a' + (n % 26) as u8; 64];
    let list =
        |board: &mut Network<'static, End>, link| (0..LONG / 64).all(|n| board.send(MCODE, link, &line(n)));
    assert!(list(&mut cable.board, Link(0)), "it has room");
    assert!(!list(&mut cable.board, Link(1)), "there is no room for two");
    assert_eq!(cable.pass(20), [(MCODE, Link(1), Came::Closed, Vec::new())]);
    assert_eq!(cable.client(two).state(), State::Closed);
    let mut heard = Vec::new();
    for _ in 0..1_000 {
        heard.extend(cable.hear(one));
        cable.pass(10);
    }
    assert_eq!(heard, (0..LONG / 64).flat_map(line).collect::<Vec<u8>>());
    // The room is free again.
    assert!(list(&mut cable.board, Link(0)), "it has room");
}

#[test]
fn the_drive_closes_behind_what_it_has_said() {
    let mut cable = Cable::new();
    let client = cable.connected(MCODE, 0);
    for _ in 0..100 {
        assert!(cable.board.send(MCODE, Link(0), &[b'.'; 64]));
    }
    cable.board.close(MCODE, Link(0));
    assert!(cable.board.send(MCODE, Link(0), b"into the void"));
    let mut heard = 0;
    for _ in 0..1_000 {
        heard += cable.hear(client).len();
        assert_eq!(cable.pass(1), [], "the drive knows that it closed");
    }
    assert_eq!(heard, 6_400);
    assert_eq!(cable.client(client).state(), State::CloseWait);
    // Whoever does not leave is thrown out after 10 s.
    cable.pass(10_000);
    cable.connected(MCODE, 0);
    assert_eq!(cable.client(client).state(), State::Closed);
}

#[test]
fn who_is_there_stays_and_who_is_gone_is_forgotten() {
    let mut cable = Cable::new();
    cable.connected(MODBUS, 0);
    assert_eq!(cable.pass(100_000), [], "he is there");
    // The cable is cut.
    cable.here = End { from: Way::default(), to: Way::default() };
    assert_eq!(cable.pass(60_000), [(MODBUS, Link(0), Came::Closed, Vec::new())]);
}

#[test]
fn a_reset_closes() {
    let mut cable = Cable::new();
    let client = cable.connected(MODBUS, 0);
    cable.client(client).abort();
    assert_eq!(cable.pass(20), [(MODBUS, Link(0), Came::Closed, Vec::new())]);
    cable.connected(MODBUS, 0);
}

#[test]
fn a_network_on_which_nothing_is_due_lets_the_board_sleep() {
    let mut cable = Cable::new();
    cable.connected(MODBUS, 0);
    cable.pass(1_000);
    let again = cable.board.next(cable.now, &mut Adu::new()).expect_err("nothing comes");
    assert!(again > cable.now + Duration::secs(1), "{again:?}");
}
