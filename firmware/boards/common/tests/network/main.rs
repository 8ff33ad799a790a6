//! The TCP ports of a board, with clients at the other end of a cable. The tests use virtual time only.

mod cable;
mod noise;

use std::collections::VecDeque;

use drivetwin_board::network::{LINKS, Network, PORTS};
use drivetwin_firmware::device::{Device as _, Duration, Framing, Link};
use drivetwin_firmware::shell::{LinkEvent, Links};
use drivetwin_protocol::modbus::tcp::Adu;
use smoltcp::iface::SocketHandle;
use smoltcp::socket::tcp::State;

use cable::{Cable, End, MCODE, MODBUS, Way, echo, request};

#[test]
fn whole_requests_however_they_are_cut() {
    let mut cable = Cable::new();
    let client = cable.connected(MODBUS, 0);
    let (one, two) = (request(1), request(2));
    cable.say(client, &one[..3]);
    assert_eq!(cable.pass(20), []);
    cable.say(client, &[&one[3..], &two[..], &one[..1]].concat());
    let message = |bytes: &[u8]| (MODBUS, Link(0), LinkEvent::Message, bytes.to_vec());
    assert_eq!(cable.pass_with(20, echo), [message(&one), message(&two)]);
    assert_eq!(cable.hear(client), [&one[..], &two[..]].concat());
    cable.say(client, &one[1..]);
    assert_eq!(cable.pass(20), [message(&one)]);
}

#[test]
fn mcode_comes_at_once_and_never_past_the_end_of_a_line() {
    let mut cable = Cable::new();
    let client = cable.connected(MCODE, 0);
    cable.say(client, b"PR V\rPR P\r\nVM");
    let message = |bytes: &[u8]| (MCODE, Link(0), LinkEvent::Message, bytes.to_vec());
    assert_eq!(cable.pass(20), [message(b"PR V\r"), message(b"PR P\r"), message(b"\nVM")]);
    cable.say(client, b"\nSL 0\nPS");
    assert_eq!(cable.pass(20), [message(b"\nSL 0\n"), message(b"PS")]);
}

/// Before the drive accepts connections, it gets none. Clients wait, and so do their messages.
#[test]
fn connections_wait_until_the_drive_accepts_them() {
    let mut cable = Cable::new();
    cable.drive.accepts = false;
    let (master, client) = (cable.call(MODBUS), cable.call(MCODE));
    assert_eq!(cable.pass(20), []);
    cable.say(master, &request(1));
    cable.say(client, b"PR V\r");
    assert_eq!(cable.pass(300), []);
    cable.drive.accepts = true;
    let told = |port, came, bytes: &[u8]| (port, Link(0), came, bytes.to_vec());
    assert_eq!(
        cable.pass(20),
        [
            told(MODBUS, LinkEvent::Opened, b""),
            told(MCODE, LinkEvent::Opened, b""),
            told(MODBUS, LinkEvent::Message, &request(1)),
            told(MCODE, LinkEvent::Message, b"PR V\r"),
        ]
    );
}

/// Messages for a port wait while the drive does not take them. The other port is served.
#[test]
fn while_the_drive_takes_nothing_its_connections_wait() {
    let mut cable = Cable::new();
    let (master, client, other) =
        (cable.connected(MODBUS, 0), cable.connected(MCODE, 0), cable.connected(MCODE, 1));
    cable.drive.takes = false;
    let line = [&[b'x'; 99][..], b"\r"].concat();
    // The client sends more bytes than a board buffers for a connection.
    cable.say(client, &line.repeat(10));
    cable.client(client).close();
    cable.say(other, b"PR V\r");
    cable.say(master, &request(1));
    let message = |port, link, bytes: &[u8]| (port, Link(link), LinkEvent::Message, bytes.to_vec());
    assert_eq!(cable.pass_with(100, echo), [message(MODBUS, 0, &request(1))]);
    cable.drive.takes = true;
    let told = cable.pass(2_000);
    let said = |link| told.iter().filter(move |told| told.1 == Link(link));
    let text = |link| said(link).flat_map(|told| told.3.clone()).collect::<Vec<_>>();
    assert_eq!((text(0), text(1)), (line.repeat(10), b"PR V\r".to_vec()));
    assert_eq!(said(0).next_back(), Some(&(MCODE, Link(0), LinkEvent::Closed, Vec::new())));
}

#[test]
fn every_tcp_port_of_every_drive_has_places() {
    macro_rules! specs {
        ($($make:expr),* $(,)?) => { [$(($make)().spec()),*] };
    }
    for spec in drivetwin_firmware::devices!(specs) {
        let ports = || spec.ports.iter().filter(|port| port.is_tcp());
        assert!(ports().count() <= PORTS, "{}", spec.kind);
        assert!(ports().filter(|port| port.framing == Framing::Mbap).count() <= 1, "{}", spec.kind);
    }
}

#[test]
fn a_connection_has_the_lowest_free_number_and_the_fifth_is_refused() {
    let mut cable = Cable::new();
    let clients: Vec<_> = (0..LINKS as u8).map(|link| cable.connected(MCODE, link)).collect();
    let fifth = cable.call(MCODE);
    assert_eq!(cable.pass(20), []);
    assert_eq!(cable.client(fifth).state(), State::Closed);
    // The other port has connections of its own.
    cable.connected(MODBUS, 0);
    for link in [2, 1] {
        cable.client(clients[link]).close();
        assert_eq!(cable.pass(20), [(MCODE, Link(link as u8), LinkEvent::Closed, Vec::new())]);
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
    assert_eq!(told, [(Link(0), LinkEvent::Message), (Link(0), LinkEvent::Closed)]);
    assert_eq!(cable.hear(wrong), request(1)[..]);
    assert!(!cable.client(wrong).may_recv(), "there comes no more");
    cable.say(right, &request(3));
    cable.pass_with(20, echo);
    assert_eq!(cable.hear(right), request(3)[..]);
}

#[test]
fn a_client_that_closed_its_sending_side_gets_its_answers() {
    let mut cable = Cable::new();
    let client = cable.connected(MODBUS, 0);
    cable.say(client, &request(1));
    cable.client(client).close();
    let told = cable.pass_with(20, echo);
    assert_eq!(told.last(), Some(&(MODBUS, Link(0), LinkEvent::Closed, Vec::new())));
    assert_eq!(cable.hear(client), request(1)[..]);
    cable.connected(MODBUS, 0);
}

#[test]
fn a_client_that_does_not_read_its_answers_is_not_read() {
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
    assert!(!all.is_empty(), "all requests were read");
    cable.say(other, &request(7));
    cable.pass_with(20, echo);
    assert_eq!(cable.hear(other), request(7)[..], "others are served");
    // In the end every answer has arrived.
    let mut heard = Vec::new();
    for _ in 0..2_000 {
        heard.extend(cable.hear(deaf));
        say_more(&mut cable, &mut all);
        cable.pass_with(20, echo);
    }
    let expected: Vec<u8> = (0..REQUESTS).flat_map(|n| request(n).to_vec()).collect();
    assert_eq!(heard, expected);
}

/// Number of bytes in the listing of the longest program: its stored size, and a little more.
const LISTING: usize = 13 * 1_024;

/// Text line `n` of a listing.
fn line(n: usize) -> [u8; 64] {
    [b'a' + (n % 26) as u8; 64]
}

/// Sends `bytes` bytes of a listing. Returns whether there was room for all of them.
fn list(board: &mut Network<'static, End>, link: u8, bytes: usize) -> bool {
    (0..bytes / 64).all(|n| board.send(MCODE, Link(link), &line(n)))
}

/// Asserts that a client that reads every 10 ms gets `bytes` bytes of a listing and no more.
fn reads(cable: &mut Cable, client: SocketHandle, bytes: usize) {
    let mut heard = Vec::new();
    for _ in 0..1_000 {
        heard.extend(cable.hear(client));
        cable.pass(10);
    }
    assert_eq!(heard, (0..bytes / 64).flat_map(line).collect::<Vec<u8>>());
}

#[test]
fn the_longest_answer_has_room_again_and_again() {
    let mut cable = Cable::new();
    let client = cable.connected(MCODE, 0);
    for _ in 0..3 {
        assert!(list(&mut cable.board, 0, LISTING), "it has room");
        reads(&mut cable, client, LISTING);
    }
}

#[test]
fn long_answers_share_their_room() {
    let mut cable = Cable::new();
    let clients: Vec<_> = (0..LINKS as u8).map(|link| cable.connected(MCODE, link)).collect();
    for link in 0..LINKS as u8 {
        assert!(list(&mut cable.board, link, LISTING / 4), "it has room");
    }
    for client in &clients {
        reads(&mut cable, *client, LISTING / 4);
    }
    // There is no room for two of the longest listings. Only the later client loses its connection.
    assert!(list(&mut cable.board, 0, LISTING), "it has room");
    assert!(!list(&mut cable.board, 1, LISTING), "there is no room");
    assert_eq!(cable.pass(20), [(MCODE, Link(1), LinkEvent::Closed, Vec::new())]);
    assert_eq!(cable.client(clients[1]).state(), State::Closed);
    reads(&mut cable, clients[0], LISTING);
    // The pieces of the closed connection are free again.
    assert!(list(&mut cable.board, 2, LISTING), "it has room");
    reads(&mut cable, clients[2], LISTING);
}

#[test]
fn the_drive_closes_after_its_unsent_bytes() {
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
        assert_eq!(cable.pass(1), [], "the drive gets no event for its own close");
    }
    assert_eq!(heard, 6_400);
    assert_eq!(cable.client(client).state(), State::CloseWait);
    // A client that does not close its connection is reset after 10 s.
    cable.pass(10_000);
    cable.connected(MCODE, 0);
    assert_eq!(cable.client(client).state(), State::Closed);
}

#[test]
fn silent_clients_stay_and_lost_clients_are_closed() {
    let mut cable = Cable::new();
    cable.connected(MODBUS, 0);
    assert_eq!(cable.pass(100_000), [], "the client is still connected");
    // The cable is cut.
    cable.here = End { from: Way::default(), to: Way::default(), came: cable.came.clone() };
    assert_eq!(cable.pass(60_000), [(MODBUS, Link(0), LinkEvent::Closed, Vec::new())]);
}

#[test]
fn a_reset_closes() {
    let mut cable = Cable::new();
    let client = cable.connected(MODBUS, 0);
    cable.client(client).abort();
    assert_eq!(cable.pass(20), [(MODBUS, Link(0), LinkEvent::Closed, Vec::new())]);
    cable.connected(MODBUS, 0);
}

#[test]
fn a_network_on_which_nothing_is_due_lets_the_board_sleep() {
    let mut cable = Cable::new();
    cable.connected(MODBUS, 0);
    cable.pass(1_000);
    let again = cable.board.next(cable.now, &cable.drive, &mut Adu::new()).expect_err("nothing comes");
    assert!(again > cable.now + Duration::secs(1), "{again:?}");
}

#[test]
fn messages_have_the_stamp_of_their_frame() {
    let mut cable = Cable::new();
    let client = cable.connected(MODBUS, 0);
    cable.say(client, &request(1));
    cable.machine_speaks();
    let came = cable.now;
    cable.came.set(came);
    // The loop is late.
    cable.now += Duration::millis(5);
    let next = cable.board.next(cable.now, &cable.drive, &mut Adu::new());
    assert_eq!(next, Ok((came, MODBUS, Link(0), LinkEvent::Message)));
}
