//! TCP ports: messages that arrive in arbitrary pieces, connections that are opened and closed.

use drivetwin_firmware::device::Link;
use drivetwin_protocol::modbus::tcp::Broken;

use super::*;
use crate::record::capture::{Frame, Medium, Source};
use crate::testing::echo_device::{MCODE, MODBUS};

/// A request for the maximum velocity of an MDrive (FB 4.2.4), with that transaction number.
pub(super) fn adu(transaction: u8) -> [u8; 12] {
    [0, transaction, 0, 0, 0, 6, 1, 3, 0x00, 0x8B, 0x00, 0x02]
}

/// A bench at 1 ms with an echo device.
pub(super) fn echo() -> (Bench, DriveId) {
    let mut bench = Bench::with(Settings { capture: Retention::All, ..Settings::default() });
    let drive = bench.add::<EchoDevice>("echo");
    bench.run_until(start());
    (bench, drive)
}

pub(super) fn connected(bench: &mut Bench, drive: DriveId, port: Port) -> Client {
    let client = bench.connect_to(drive, port).unwrap();
    bench.run_until_idle();
    if port == MCODE {
        assert_eq!(received_by(bench, client), b">");
    }
    client
}

/// Sends bytes, runs until the bench is idle, and returns the bytes that the client received.
pub(super) fn exchange(bench: &mut Bench, client: Client, bytes: &[u8]) -> Vec<u8> {
    bench.send(client, bytes);
    bench.run_until_idle();
    received_by(bench, client)
}

/// The inputs of all drives, without timestamps.
pub(super) fn input(bench: &Bench) -> Vec<String> {
    let trace = bench.trace();
    let input = trace.events().filter(|entry| matches!(entry.event, trace::Event::Input(_)));
    input.map(|entry| trace.words(entry)).collect()
}

pub(super) fn replays(bench: &Bench) {
    let trace = Trace::parse(&bench.trace().to_text(), &make).unwrap();
    assert_eq!(replay::run(&trace, &make), Ok(None), "{}", bench.trace().to_text());
}

#[test]
fn what_is_asked_at_one_instant_is_answered_at_it_and_in_order() {
    let (mut bench, drive) = echo();
    let client = connected(&mut bench, drive, MODBUS);
    let asked: Vec<u8> = (1..=5).flat_map(adu).collect();
    assert_eq!(exchange(&mut bench, client, &asked), asked);
    assert_eq!(bench.now(), start());
    let words = |transaction| format!("message 0 00 {transaction:02X} 00 00 00 06 01 03 00 8B 00 02");
    assert_eq!(input(&bench), [vec!["opened 0".to_owned()], (1..=5).map(words).collect()].concat());
    assert_eq!(stamps(&bench, "> message").iter().filter(|stamp| *stamp == "1.000000").count(), 5);
    let seen = Statistics { requests: 5, connections: 1, messages: 5, ..Statistics::default() };
    assert_eq!((bench.statistics(drive, MODBUS), bench.connections(drive, MODBUS)), (seen, 1));
    assert_eq!(bench.ask(drive, &adu(9)), adu(9));
    replays(&bench);
}

#[test]
fn a_message_is_delivered_at_its_last_byte() {
    let (mut bench, drive) = echo();
    let client = connected(&mut bench, drive, MODBUS);
    for (n, byte) in (1..).zip(adu(1)) {
        bench.run_until(n.millis());
        assert_eq!(received_by(&mut bench, client), [0; 0]);
        bench.send(client, &[byte]);
    }
    // Nothing is scheduled before the last byte; the complete message is then delivered at once.
    assert_eq!((bench.is_served(client), bench.next()), (false, bench.now()));
    bench.run_until(bench.now());
    assert_eq!((bench.is_served(client), received_by(&mut bench, client)), (true, adu(1).to_vec()));
    assert_eq!(bench.next(), Instant::NEVER);
    assert_eq!(stamps(&bench, "message 0"), ["12.000000", "12.000000"]);
}

#[test]
fn text_is_delivered_at_once_and_split_after_each_carriage_return() {
    let (mut bench, drive) = echo();
    let client = connected(&mut bench, drive, MCODE);
    assert_eq!(exchange(&mut bench, client, b"PR"), b"PR");
    assert_eq!(exchange(&mut bench, client, b" P\r\nPR V\rP"), b" P\r\nPR V\rP");
    let text =
        ["\"PR\"", "\" P\\r\"", "\"\\nPR V\\r\"", "\"P\""].map(|text| format!("message:mcode 0 {text}"));
    assert_eq!(input(&bench)[1..], text);
    assert_eq!(bench.now(), start());
    replays(&bench);
}

#[test]
fn a_client_with_4_kib_of_unread_answers_waits_until_it_reads() {
    // A line feed ends a line, too.
    for lines in [b"f\rf\rf\rf\r", b"f\nf\nf\nf\n"] {
        let (mut bench, drive) = echo();
        let [client, other] = [(); 2].map(|()| connected(&mut bench, drive, MCODE));
        bench.send(client, lines);
        for received in 1..=4 {
            assert_eq!(exchange(&mut bench, other, b"a"), b"a");
            assert_eq!(bench.statistics(drive, MCODE).messages, 2 * received);
            assert_eq!(received_by(&mut bench, client).len(), (1 << 20) + 1);
        }
        bench.run_until_idle();
        assert!(bench.is_served(client) && received_by(&mut bench, client).is_empty());
        replays(&bench);
    }
    // 4,096 bytes are 341 replies and a third of one.
    let (mut bench, drive) = echo();
    let client = connected(&mut bench, drive, MODBUS);
    let asked = adu(1).repeat(700);
    assert_eq!(exchange(&mut bench, client, &asked).len(), 342 * 12);
    assert_eq!((bench.backlog(client), bench.is_served(client)), (12 * (700 - 343), false));
    bench.run_until_idle();
    assert_eq!(received_by(&mut bench, client).len(), 342 * 12);
    bench.run_until_idle();
    assert_eq!((received_by(&mut bench, client).len(), bench.is_served(client)), (16 * 12, true));
}

#[test]
fn a_client_that_is_held_back_waits_though_it_receives() {
    let (mut bench, drive) = echo();
    let client = connected(&mut bench, drive, MODBUS);
    bench.hold_back(client, true);
    assert_eq!(exchange(&mut bench, client, &adu(1)), [0; 0]);
    bench.hold_back(client, false);
    bench.run_until_idle();
    assert_eq!(received_by(&mut bench, client), adu(1));
}

#[test]
fn who_leaves_without_reading_takes_along_what_waits_for_that() {
    let (mut bench, drive) = echo();
    let client = connected(&mut bench, drive, MCODE);
    bench.send(client, b"f\ra\rb\r");
    bench.run_until_idle();
    bench.disconnect(client);
    bench.run_until_idle();
    assert_eq!(input(&bench), ["opened:mcode 0", "message:mcode 0 \"f\\r\"", "closed:mcode 0"]);
    // Messages that wait only for their turn are delivered.
    let client = connected(&mut bench, drive, MCODE);
    bench.send(client, b"a\rb\r");
    bench.disconnect(client);
    bench.run_until_idle();
    let command =
        ["opened:mcode 0", "message:mcode 0 \"a\\r\"", "message:mcode 0 \"b\\r\"", "closed:mcode 0"];
    assert_eq!(input(&bench)[3..], command);
}

#[test]
fn a_wrong_header_ends_its_connection_when_all_before_it_is_answered() {
    for (wrong, why) in [([0, 9, 0, 1, 0, 6], Broken::Protocol), ([0, 9, 0, 0, 1, 6], Broken::Length)] {
        let (mut bench, drive) = echo();
        let [client, other] = [(); 2].map(|()| connected(&mut bench, drive, MODBUS));
        bench.send(client, &[&adu(1)[..], &wrong[..], &adu(2)[..]].concat());
        bench.send(client, &adu(3));
        bench.run_until_idle();
        assert_eq!(bench.ended(client), Some(Ended::Broken(why)));
        assert_eq!(received_by(&mut bench, client), adu(1));
        assert_eq!(input(&bench)[2..], ["message 0 00 01 00 00 00 06 01 03 00 8B 00 02", "closed 0"]);
        // Other clients are not affected, and the number of the connection is free again.
        assert_eq!(exchange(&mut bench, other, &adu(4)), adu(4));
        assert_eq!((bench.ended(other), bench.connections(drive, MODBUS)), (None, 1));
        assert_eq!(bench.statistics(drive, MODBUS).broken, 1);
        bench.disconnect(client);
        connected(&mut bench, drive, MODBUS);
        assert_eq!(input(&bench).last().unwrap(), "opened 0");
        replays(&bench);
    }
}

#[test]
fn a_port_takes_64_and_turns_the_next_one_away() {
    let (mut bench, drive) = echo();
    let clients: Vec<Client> = (0..64).map(|_| connected(&mut bench, drive, MODBUS)).collect();
    assert_eq!(bench.connect_to(drive, MODBUS), Err(ConnectError::Full));
    assert_eq!(bench.connections(drive, MODBUS), 64);
    for (transaction, &client) in (0..).zip(&clients) {
        assert_eq!(exchange(&mut bench, client, &adu(transaction)), adu(transaction));
    }
    // The other port has its own maximum.
    connected(&mut bench, drive, MCODE);
    bench.disconnect(clients[7]);
    assert_eq!(bench.connections(drive, MODBUS), 63);
    let client = connected(&mut bench, drive, MODBUS);
    assert_eq!(input(&bench).last().unwrap(), "opened 7");
    assert_eq!(exchange(&mut bench, client, &adu(64)), adu(64));
}

#[test]
fn a_reused_connection_number_carries_nothing_of_its_previous_client() {
    let (mut bench, drive) = echo();
    let [first, _] = [(); 2].map(|()| connected(&mut bench, drive, MODBUS));
    bench.send(first, &adu(1));
    bench.disconnect(first);
    // The drive has received neither the request nor the end of the connection.
    let third = bench.connect_to(drive, MODBUS).unwrap();
    bench.run_until_idle();
    assert_eq!(received_by(&mut bench, third), [0; 0]);
    assert_eq!(input(&bench)[2..], ["message 0 00 01 00 00 00 06 01 03 00 8B 00 02", "closed 0", "opened 0"]);
    assert_eq!(exchange(&mut bench, third, &adu(2)), adu(2));
    // A connection is reported even if its client left before the opening was reported.
    let fourth = bench.connect_to(drive, MODBUS).unwrap();
    bench.send(fourth, &adu(3));
    bench.disconnect(fourth);
    bench.run_until_idle();
    assert_eq!(input(&bench)[6..], ["opened 2", "message 2 00 03 00 00 00 06 01 03 00 8B 00 02", "closed 2"]);
    replays(&bench);
}

#[test]
fn a_drive_receives_nothing_after_it_closes_a_connection() {
    let (mut bench, drive) = echo();
    let client = connected(&mut bench, drive, MCODE);
    bench.send(client, b"ax\rbc\r");
    bench.run_until_idle();
    assert_eq!(received_by(&mut bench, client), b"a\r"[..1]);
    assert_eq!(bench.ended(client), Some(Ended::ByDrive));
    assert!(bench.is_served(client));
    bench.send(client, b"d");
    bench.disconnect(client);
    bench.run_until_idle();
    assert_eq!(input(&bench), ["opened:mcode 0", "message:mcode 0 \"ax\\r\""]);
    assert_eq!(bench.trace().to_text().matches("close:mcode 0").count(), 1);
    // The next client has the same number, and receives none of the earlier messages.
    let next = connected(&mut bench, drive, MCODE);
    assert_eq!((input(&bench).last().unwrap().as_str(), bench.ended(next)), ("opened:mcode 0", None));
    replays(&bench);
}

#[test]
fn what_is_under_way_when_a_drive_closes_is_not_for_the_next_one() {
    let (mut bench, drive) = echo();
    let client = connected(&mut bench, drive, MCODE);
    bench.send(client, b"x\r");
    bench.send(client, b"old\r");
    bench.run_until(bench.now());
    let next = bench.connect_to(drive, MCODE).unwrap();
    bench.run_until_idle();
    assert_eq!(received_by(&mut bench, next), b">");
    assert_eq!(input(&bench)[1..], ["message:mcode 0 \"x\\r\"", "opened:mcode 0"]);
}

#[test]
fn a_drive_may_take_fewer() {
    let (mut bench, drive) = echo();
    for _ in 0..4 {
        connected(&mut bench, drive, MCODE);
    }
    let fifth = bench.connect_to(drive, MCODE).unwrap();
    assert_eq!(bench.ended(fifth), None);
    bench.run_until_idle();
    assert_eq!((bench.ended(fifth), received_by(&mut bench, fifth)), (Some(Ended::ByDrive), Vec::new()));
    assert_eq!(bench.connections(drive, MCODE), 4);
    replays(&bench);
}

#[test]
fn power_off_closes_all_connections_and_refuses_new_ones() {
    let (mut bench, drive) = echo();
    let clients = [MODBUS, MCODE].map(|port| connected(&mut bench, drive, port));
    assert_eq!(exchange(&mut bench, clients[1], b"a"), b"a");
    bench.run_until(2.millis());
    bench.power(drive, PowerAction::Off);
    // At one instant the change of power comes first.
    bench.send(clients[0], &adu(1));
    bench.run_until_idle();
    let command = input(&bench).len();
    assert_eq!(clients.map(|client| bench.ended(client)), [Some(Ended::NoPower); 2]);
    assert_eq!(received_by(&mut bench, clients[0]), [0; 0]);
    assert_eq!(bench.connect_to(drive, MODBUS), Err(ConnectError::NoPower));
    bench.send(clients[0], &adu(2));
    bench.disconnect(clients[1]);
    bench.run_until_idle();
    assert_eq!((input(&bench).len(), input(&bench).last().unwrap().as_str()), (command, "power off"));
    bench.power(drive, PowerAction::On);
    bench.run_until_idle();
    let client = connected(&mut bench, drive, MODBUS);
    assert_eq!(input(&bench)[command..], ["power on", "opened 0"]);
    bench.power(drive, PowerAction::Cycle);
    bench.run_until_idle();
    assert_eq!((bench.ended(client), bench.powered(drive)), (Some(Ended::NoPower), true));
    assert_eq!(bench.connections(drive, MODBUS), 0);
    connected(&mut bench, drive, MODBUS);
    assert_eq!(input(&bench).last().unwrap(), "opened 0");
    replays(&bench);
}

#[test]
fn input_after_the_deadlines_of_an_instant_is_delivered_a_tick_later() {
    let (mut bench, drive) = echo();
    let client = connected(&mut bench, drive, MCODE);
    assert_eq!(exchange(&mut bench, client, b"t"), b"T");
    assert_eq!(bench.now(), start());
    assert_eq!(exchange(&mut bench, client, b"a"), b"a");
    assert_eq!(bench.now(), start() + Duration::TICK);
    bench.run_until(start() + Duration::secs(1));
    assert_eq!(received_by(&mut bench, client), b"T");
    replays(&bench);
}

#[test]
fn a_connection_to_a_serial_port_is_one_to_its_line() {
    let (mut bench, drive, _) = alone(LineMode::Timed);
    let bus = bench.bus(drive, RS485).unwrap();
    assert_eq!((bench.outlet(drive, RS485), bench.outlets()), (Outlet::Line(bus), vec![Outlet::Line(bus)]));
    let client = bench.connect_to(drive, RS485).unwrap();
    assert_eq!(exchange(&mut bench, client, &rtu::read(1, 0, 1)), [1, 3, 2, 0, 1, 0x79, 0x84]);
    assert_eq!((bench.ended(client), bench.connections(drive, RS485)), (None, 0));
}

#[test]
fn tcp_ports_have_names() {
    let (mut bench, drive) = echo();
    assert_eq!((bench.bus(drive, MODBUS), bench.buses()), (None, vec![]));
    let names = |bench: &Bench| -> Vec<String> {
        bench.outlets().into_iter().map(|outlet| bench.outlet_name(outlet)).collect()
    };
    assert_eq!(names(&bench), ["modbus", "mcode"]);
    bench.add::<EchoDevice>("a");
    assert_eq!(names(&bench), ["a.modbus", "a.mcode", "echo.modbus", "echo.mcode"]);
    let found = |bench: &Bench, name: &str| bench.find_outlet(name);
    assert_eq!(found(&bench, "mcode"), None, "two ports have this name");
    assert_eq!(found(&bench, "echo.mcode"), Some(Outlet::Tcp(drive, MCODE)));
    assert_eq!((found(&bench, "b.mcode"), found(&bench, "usb")), (None, None));
    let (bench, drive) = echo();
    assert_eq!(found(&bench, "mcode"), Some(Outlet::Tcp(drive, MCODE)));
}

#[test]
fn a_capture_has_messages_whole_and_the_end_of_each_connection() {
    let (mut bench, drive) = echo();
    let client = connected(&mut bench, drive, MODBUS);
    exchange(&mut bench, client, &[adu(1), adu(2)].concat());
    bench.disconnect(client);
    bench.run_until_idle();
    let frames: Vec<&Frame> = bench.capture().since(0).collect();
    let seen: Vec<_> = frames.iter().map(|frame| (frame.from, &frame.bytes[..])).collect();
    let (request, reply) = (Source::Client, Source::Drive(drive));
    let (one, two) = (adu(1), adu(2));
    assert_eq!(seen, [(request, &one[..]), (reply, &one), (request, &two), (reply, &two), (request, &[])]);
    let on = Medium::Tcp(drive, MODBUS, Link(0));
    assert!(frames.iter().all(|frame| (frame.on, frame.at, frame.line) == (on, start(), None)));
}

/// Actions on two drives with TCP ports.
#[derive(Clone, Debug)]
enum Act {
    Connect(bool, bool),
    Send(usize, Vec<u8>),
    Leave(usize),
    Power(bool, PowerAction),
    Wait(u64),
}

fn act() -> impl Strategy<Value = Act> {
    let text =
        proptest::collection::vec(prop_oneof![Just(b'x'), Just(b't'), Just(b'\r'), any::<u8>()], 1..20);
    let text = text.prop_map(|text| text.into_iter().filter(|&byte| byte != b'f').collect());
    let whole =
        (any::<u8>(), 1_usize..30).prop_map(|(n, cut)| [adu(n), adu(n)].concat()[..cut.min(24)].to_vec());
    let power = prop_oneof![Just(PowerAction::Off), Just(PowerAction::On), Just(PowerAction::Cycle)];
    prop_oneof![
        3 => (any::<bool>(), any::<bool>()).prop_map(|(drive, port)| Act::Connect(drive, port)),
        6 => (any::<usize>(), prop_oneof![text, whole]).prop_map(|(client, bytes)| Act::Send(client, bytes)),
        2 => any::<usize>().prop_map(Act::Leave),
        1 => (any::<bool>(), power).prop_map(|(drive, action)| Act::Power(drive, action)),
        3 => (0_u64..3).prop_map(Act::Wait),
    ]
}

/// The trace of `acts` on two drives that are added in one order or the other, and the bytes that each client
/// received. Each wait is run in that many slices.
fn happened(acts: &[Act], swapped: bool, slices: u64) -> (String, Vec<Vec<u8>>) {
    let mut bench = Bench::new();
    let mut names = ["a", "b"];
    if swapped {
        names.reverse();
    }
    let mut slots = names.map(|name| bench.add::<EchoDevice>(name));
    if swapped {
        slots.reverse();
    }
    let mut clients: Vec<(Client, Vec<u8>)> = Vec::new();
    for act in acts {
        match act {
            &Act::Connect(drive, port) => {
                let port = if port { MODBUS } else { MCODE };
                let client = bench.connect_to(slots[usize::from(drive)], port);
                clients.extend(client.ok().map(|client| (client, Vec::new())));
            }
            Act::Send(client, bytes) if !clients.is_empty() => {
                bench.send(clients[client % clients.len()].0, bytes);
            }
            Act::Leave(client) if !clients.is_empty() => {
                bench.disconnect(clients[client % clients.len()].0);
            }
            &Act::Power(drive, action) => bench.power(slots[usize::from(drive)], action),
            &Act::Wait(ticks) => {
                let end = bench.now() + Duration::TICK * ticks;
                for slice in (0..slices).rev() {
                    bench.run_until(end - Duration::TICK * (ticks * slice / slices));
                }
            }
            Act::Send(..) | Act::Leave(_) => {}
        }
        for (client, received) in &mut clients {
            bench.receive(*client, received);
        }
    }
    bench.run_until(3.secs());
    for (client, received) in &mut clients {
        bench.receive(*client, received);
    }
    (bench.trace().to_text(), clients.into_iter().map(|(_, received)| received).collect())
}

proptest! {
    #[test]
    fn however_segments_are_cut_the_same_is_heard(
        transactions in proptest::collection::vec(any::<u8>(), 1..20),
        cuts in proptest::collection::vec(1_usize..40, 0..30),
    ) {
        let (mut bench, drive) = echo();
        let client = connected(&mut bench, drive, MODBUS);
        let asked: Vec<u8> = transactions.iter().copied().flat_map(adu).collect();
        let mut rest = asked.as_slice();
        for cut in cuts {
            let (segment, more) = rest.split_at(cut.min(rest.len()));
            bench.send(client, segment);
            rest = more;
        }
        bench.send(client, rest);
        bench.run_until_idle();
        prop_assert_eq!(received_by(&mut bench, client), asked);
        prop_assert_eq!(bench.statistics(drive, MODBUS).messages, transactions.len() as u64);
    }

    #[test]
    fn whatever_clients_do_replays_exactly_and_depends_on_no_order_of_seats(
        acts in proptest::collection::vec(act(), 0..60),
    ) {
        let (text, received) = happened(&acts, false, 1);
        prop_assert_eq!(&happened(&acts, true, 3), &(text.clone(), received));
        let trace = Trace::parse(&text, &make).unwrap();
        prop_assert_eq!(replay::run(&trace, &make), Ok(None), "{}", text);
    }
}
