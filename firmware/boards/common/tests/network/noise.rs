//! A network with noise, floods, and malicious hosts.

use drivetwin_board::network::{FRAME_BYTES, LINKS};
use drivetwin_firmware::device::Link;
use drivetwin_firmware::shell::{LinkEvent, Links};
use drivetwin_protocol::modbus::tcp::Adu;
use smoltcp::socket::tcp::State;

use crate::cable::{Cable, MCODE, MODBUS, echo, request};

/// Invalid frames of all lengths: filled with 0xFF, or with the start of a packet to the board.
fn noise() -> impl Iterator<Item = Vec<u8>> {
    let packet = |kind: u16, n: usize| {
        let mut frame = [&[2, 0, 0, 0, 0, 1, 2, 0, 0, 0, 0, 3][..], &kind.to_be_bytes(), &[0x45, 0]].concat();
        frame.resize(n.max(16), n as u8);
        frame.truncate(n);
        frame
    };
    let empty = (0..80).chain([FRAME_BYTES, 1_514, 2_040]).map(|length| vec![0xFF; length]);
    empty.chain((0..80).chain([FRAME_BYTES]).flat_map(move |n| [packet(0x0800, n), packet(0x0806, n)]))
}

#[test]
fn noise_is_dropped_and_clients_are_served() {
    let mut cable = Cable::new();
    let client = cable.connected(MODBUS, 0);
    for n in 0..100 {
        cable.here.to.borrow_mut().extend(noise());
        cable.say(client, &request(n));
        let told = cable.pass_with(20, echo);
        assert_eq!(told, [(MODBUS, Link(0), LinkEvent::Message, request(n).to_vec())]);
        assert_eq!(cable.hear(client), request(n)[..]);
    }
}

#[test]
fn the_drive_has_its_turn_within_a_flood() {
    let mut cable = Cable::new();
    cable.connected(MODBUS, 0);
    cable.here.to.borrow_mut().extend(noise());
    let flood = cable.here.to.borrow().len();
    assert!(flood > 100);
    let again = cable.board.next(cable.now, &cable.drive, &mut Adu::new());
    assert_eq!(again, Err(cable.now), "there is more");
    let taken = flood - cable.here.to.borrow().len();
    assert!((1..=8).contains(&taken), "{taken} frames are taken at once");
}

#[test]
fn spoiled_packets_are_sent_again() {
    let mut cable = Cable::new();
    let client = cable.connected(MODBUS, 0);
    cable.say(client, &request(1));
    cable.machine_speaks();
    for frame in cable.here.to.borrow_mut().iter_mut() {
        *frame.last_mut().expect("a frame has bytes") ^= 1;
    }
    // The checksum of the packet is wrong. The client sends it again after at most a second.
    assert_eq!(cable.pass(1), []);
    assert_eq!(cable.pass(2_000), [(MODBUS, Link(0), LinkEvent::Message, request(1).to_vec())]);
}

#[test]
fn a_half_open_connection_keeps_its_place_for_three_seconds() {
    let mut cable = Cable::new();
    let served = cable.connected(MCODE, 0);
    for _ in 1..LINKS {
        cable.knock(MCODE);
    }
    assert_eq!(cable.pass(20), [], "no client is connected yet");
    let refused = cable.call(MCODE);
    assert_eq!(cable.pass(2_500), [], "all places are taken");
    assert_eq!(cable.client(refused).state(), State::Closed);
    cable.say(served, b"PR V\r");
    assert_eq!(cable.pass(20), [(MCODE, Link(0), LinkEvent::Message, b"PR V\r".to_vec())]);
    cable.pass(1_000);
    for link in 1..LINKS {
        cable.connected(MCODE, link as u8);
    }
}
