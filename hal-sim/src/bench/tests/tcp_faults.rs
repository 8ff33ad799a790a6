//! Faults of TCP ports: what drives and clients receive of each message.

use drivetwin_protocol::modbus::tcp as mbtcp;

use super::tcp::{adu, connected, echo, exchange, input, replays};
use super::*;
use crate::line::faults::{Direction, FaultRule};
use crate::record::capture::Source;
use crate::testing::echo_device::{MCODE, MODBUS};

const QUIET: LineFaults = LineFaults::NONE;

fn faulty(faults: LineFaults) -> (Bench, DriveId, Client) {
    let (mut bench, drive) = echo();
    let client = connected(&mut bench, drive, MODBUS);
    set(&mut bench, drive, faults);
    (bench, drive, client)
}

fn set(bench: &mut Bench, drive: DriveId, faults: LineFaults) {
    assert_eq!(faults.check_for(&bench.spec(drive).ports[0]), Ok(()));
    bench.set_faults(Outlet::Tcp(drive, MODBUS), faults);
    assert_eq!(bench.faults(Outlet::Tcp(drive, MODBUS)), faults);
}

fn captured(bench: &Bench) -> Vec<(Source, Vec<u8>)> {
    bench.capture().since(0).map(|frame| (frame.from, frame.bytes.clone())).collect()
}

#[test]
fn a_port_says_nothing() {
    for (rule, requests) in
        [(FaultRule::ALL.direction(Direction::Request), 0), (FaultRule::ALL.direction(Direction::Reply), 2)]
    {
        let (mut bench, drive, client) = faulty(LineFaults { drop: rule, ..QUIET });
        assert_eq!(exchange(&mut bench, client, &[adu(1), adu(2)].concat()), [0; 0]);
        assert_eq!((bench.statistics(drive, MODBUS).requests, bench.ended(client)), (requests, None));
        assert!(bench.is_served(client));
        set(&mut bench, drive, QUIET);
        assert_eq!(exchange(&mut bench, client, &adu(3)), adu(3));
        replays(&bench);
    }
    let (mut bench, drive, client) = faulty(LineFaults { mute: FaultRule::next(1), ..QUIET });
    assert_eq!(exchange(&mut bench, client, &[adu(1), adu(2)].concat()), adu(2));
    assert_eq!(bench.faults(Outlet::Tcp(drive, MODBUS)).mute, FaultRule::next(0));
    // The requests and the one answer.
    assert_eq!(captured(&bench).len(), 3);
}

#[test]
fn a_request_that_comes_twice_is_answered_twice() {
    let twice = FaultRule::ALL.direction(Direction::Request);
    let (mut bench, drive, client) = faulty(LineFaults { duplicate: twice, ..QUIET });
    assert_eq!(exchange(&mut bench, client, &adu(1)), adu(1).repeat(2));
    set(&mut bench, drive, LineFaults { duplicate: FaultRule::ALL, ..QUIET });
    assert_eq!(exchange(&mut bench, client, &adu(1)), adu(1).repeat(4));
    replays(&bench);
}

#[test]
fn replies_have_another_unit_or_transaction() {
    let (mut bench, drive, client) = faulty(LineFaults { wrong_address: FaultRule::ALL, ..QUIET });
    let answer =
        |bench: &mut Bench| mbtcp::parse(&exchange(bench, client, &adu(1))).map(|(header, _)| header);
    assert_eq!(answer(&mut bench), Some(mbtcp::Header { transaction: 1, unit: 2 }));
    set(&mut bench, drive, LineFaults { wrong_transaction: FaultRule::ALL, ..QUIET });
    assert_eq!(answer(&mut bench), Some(mbtcp::Header { transaction: 2, unit: 1 }));
}

#[test]
fn an_exception_keeps_the_request_from_the_drive() {
    let exception = FaultRule::next(1).function(3);
    let (mut bench, drive, client) = faulty(LineFaults { exception, exception_code: 6, ..QUIET });
    assert_eq!(exchange(&mut bench, client, &adu(7)), [0, 7, 0, 0, 0, 3, 1, 0x83, 6]);
    assert_eq!(bench.statistics(drive, MODBUS).messages, 0);
    assert_eq!(exchange(&mut bench, client, &adu(8)), adu(8));
    let seen = captured(&bench);
    assert_eq!(seen[0], (Source::Client, adu(7).to_vec()));
    assert_eq!(seen[1], (Source::Drive(drive), vec![0, 7, 0, 0, 0, 3, 1, 0x83, 6]));
    replays(&bench);
}

#[test]
fn a_truncated_reply_leaves_the_stream_broken_and_open() {
    let truncate = FaultRule::next(1).direction(Direction::Reply);
    let (mut bench, _, client) = faulty(LineFaults { truncate, ..QUIET });
    let part = exchange(&mut bench, client, &adu(1));
    assert!(!part.is_empty() && part.len() < 12 && adu(1).starts_with(&part), "{part:?}");
    assert_eq!(bench.ended(client), None);
    // The next answer follows the part, as after a write that a real peer did not finish.
    assert_eq!(exchange(&mut bench, client, &adu(2)), adu(2));
}

#[test]
fn the_drive_reads_what_follows_a_truncated_request_as_its_end() {
    for seed in 0..20 {
        let mut bench = Bench::with(Settings { seed, ..Settings::default() });
        let drive = bench.add::<crate::testing::echo_device::EchoDevice>("echo");
        let client = connected(&mut bench, drive, MODBUS);
        set(&mut bench, drive, LineFaults { truncate: FaultRule::next(1), ..QUIET });
        assert_eq!(exchange(&mut bench, client, &adu(1)), [0; 0]);
        let answer = exchange(&mut bench, client, &adu(2));
        // The first bytes of the second request end the first one.
        let wire = |kept: usize| [&adu(1)[..kept], &adu(2)].concat();
        assert!((1..12).any(|kept| wire(kept).starts_with(&answer)), "{answer:?}");
        replays(&bench);
    }
}

#[test]
fn a_connection_is_closed_in_the_middle() {
    for (direction, requests) in [(Direction::Request, 0), (Direction::Reply, 1)] {
        let close = FaultRule::next(1).direction(direction);
        let (mut bench, drive, client) = faulty(LineFaults { close, ..QUIET });
        let part = exchange(&mut bench, client, &[adu(1), adu(2)].concat());
        assert_eq!(part.is_empty(), direction == Direction::Request);
        assert!(part.len() < 12 && adu(1).starts_with(&part));
        assert_eq!(bench.ended(client), Some(Ended::ByFault));
        assert_eq!(bench.connections(drive, MODBUS), 0);
        assert_eq!(bench.statistics(drive, MODBUS).requests, requests);
        assert_eq!(input(&bench).last().map(String::as_str), Some("closed 0"));
        bench.disconnect(client);
        let again = connected(&mut bench, drive, MODBUS);
        assert_eq!(exchange(&mut bench, again, &adu(3)), adu(3));
        replays(&bench);
    }
}

#[test]
fn junk_comes_before_a_reply() {
    let (mut bench, _, client) = faulty(LineFaults { noise: FaultRule::next(1), ..QUIET });
    let answer = exchange(&mut bench, client, &adu(1));
    assert!(answer.ends_with(&adu(1)) && (13..=20).contains(&answer.len()), "{answer:?}");
    assert_eq!(captured(&bench)[1].0, Source::Noise);
    assert_eq!(exchange(&mut bench, client, &adu(2)), adu(2));
}

#[test]
fn a_wrong_bit_is_in_the_request_or_in_the_reply() {
    let corrupt = FaultRule::next(1).direction(Direction::Reply);
    let (mut bench, _, client) = faulty(LineFaults { corrupt, ..QUIET });
    let answer = exchange(&mut bench, client, &adu(1));
    let turned: u32 = answer.iter().zip(adu(1)).map(|(a, b)| (a ^ b).count_ones()).sum();
    assert_eq!((answer.len(), turned), (12, 1));
}

#[test]
fn late_replies_keep_their_order() {
    let (delay, delay_spread) = (Duration::millis(50), Duration::millis(200));
    let (mut bench, drive, client) = faulty(LineFaults { delay, delay_spread, ..QUIET });
    let asked: Vec<u8> = (1..=20).flat_map(adu).collect();
    bench.send(client, &asked);
    bench.run_until(start() + delay - Duration::TICK);
    assert_eq!((received_by(&mut bench, client), bench.is_served(client)), (vec![], false));
    bench.run_until_idle();
    assert_eq!(received_by(&mut bench, client), asked);
    assert!(bench.now() >= start() + delay && bench.now() <= start() + delay + delay_spread);
    assert!(bench.is_served(client));
    // Power fails while replies are under way: the connection ends at once, and they are lost.
    bench.send(client, &adu(1));
    bench.run_until(bench.now() + 10.millis());
    bench.power(drive, PowerAction::Off);
    bench.run_until_idle();
    assert_eq!((received_by(&mut bench, client), bench.ended(client)), (vec![], Some(Ended::NoPower)));
    bench.disconnect(client);
    bench.run_until_idle();
    replays(&bench);
}

#[test]
fn a_text_port_has_the_faults_that_make_sense() {
    let (bench, drive) = echo();
    let ports = bench.spec(drive).ports;
    let (modbus, mcode) = (&ports[0], &ports[1]);
    let all = FaultRule::ALL;
    for (faults, sentence) in [
        (
            LineFaults { wrong_address: all, ..QUIET },
            "wrong_address is for Modbus lines only, and mcode is not one",
        ),
        (LineFaults { exception: all, ..QUIET }, "exception is for Modbus lines only, and mcode is not one"),
        (
            LineFaults { wrong_transaction: all, ..QUIET },
            "wrong_transaction is for Modbus/TCP ports only, and mcode is not one",
        ),
        (
            LineFaults { drop: all.function(3), ..QUIET },
            "function of drop is for Modbus lines only, and mcode is not one",
        ),
        (LineFaults { baud: Some(9_600), ..QUIET }, "baud is for serial lines only, and mcode is a TCP port"),
        (
            LineFaults { noise: all.direction(Direction::Request), ..QUIET },
            "noise is for replies only on a TCP port, and mcode is one",
        ),
    ] {
        assert_eq!(faults.check_for(mcode), Err(sentence.to_owned()));
    }
    for faults in [
        LineFaults { drop: all, corrupt: all, duplicate: all, truncate: all, ..QUIET },
        LineFaults { noise: all, mute: all, close: all, delay: Duration::millis(1), ..QUIET },
    ] {
        assert_eq!((faults.check_for(mcode), faults.check_for(modbus)), (Ok(()), Ok(())));
    }
    let serial = &bench.spec(drive).ports[0];
    let rs485 = drivetwin_firmware::device::PortSpec {
        framing: drivetwin_firmware::device::Framing::Silence,
        name: "rs485",
        ..*serial
    };
    let error = LineFaults { close: all, ..QUIET }.check_for(&rs485).unwrap_err();
    assert_eq!(error, "close is for TCP ports only, and rs485 is a serial line");
}

#[test]
fn text_is_disturbed_line_by_line() {
    let (mut bench, drive) = echo();
    let client = connected(&mut bench, drive, MCODE);
    let port = Outlet::Tcp(drive, MCODE);
    let requests = |rule: FaultRule| rule.direction(Direction::Request);
    bench.set_faults(port, LineFaults { drop: requests(FaultRule::next(1)), ..QUIET });
    assert_eq!(exchange(&mut bench, client, b"PR A\rPR V\r"), b"PR V\r");
    bench.set_faults(port, LineFaults { duplicate: requests(FaultRule::next(1)), ..QUIET });
    assert_eq!(exchange(&mut bench, client, b"PR A\r"), b"PR A\rPR A\r");
    bench.set_faults(port, LineFaults { truncate: requests(FaultRule::next(1)), ..QUIET });
    let part = exchange(&mut bench, client, b"PR A\r");
    assert!(b"PR A".starts_with(&part[..]) && !part.is_empty(), "{part:?}");
    bench.set_faults(port, LineFaults { delay: Duration::millis(5), ..QUIET });
    assert_eq!(exchange(&mut bench, client, b"x"), [0; 0]);
    assert_eq!(bench.ended(client), Some(Ended::ByDrive));
    replays(&bench);
}

proptest! {
    /// With any faults, everything ends: the bench becomes idle, and the trace replays.
    #[test]
    fn nothing_waits_for_ever(
        seed: u64,
        faults in super::faults::any_faults(),
        close in 0..4_u32,
        sent in prop::collection::vec((any::<bool>(), 1..9_u8), 1..20),
    ) {
        let settings = Settings { seed, trace: Retention::All, ..Settings::default() };
        let mut bench = Bench::with(settings);
        let drive = bench.add::<crate::testing::echo_device::EchoDevice>("echo");
        bench.run_until(start());
        let faults = LineFaults { baud: None, close: FaultRule::next(close), ..faults };
        for port in [MODBUS, MCODE] {
            bench.set_faults(Outlet::Tcp(drive, port), faults);
        }
        let mut clients = [MODBUS, MCODE].map(|port| (port, bench.connect_to(drive, port).unwrap()));
        for (text, count) in sent {
            let (port, client) = &mut clients[usize::from(text)];
            if bench.ended(*client).is_some() {
                bench.disconnect(*client);
                *client = bench.connect_to(drive, *port).unwrap();
            }
            for n in 0..count {
                if text { bench.send(*client, b"PR A\r") } else { bench.send(*client, &adu(n)) }
            }
            bench.run_until_idle();
            let _ = received_by(&mut bench, *client);
        }
        let end = bench.now() + 200.secs();
        bench.run_until_idle();
        prop_assert!(bench.now() < end);
        for (_, client) in clients {
            bench.disconnect(client);
        }
        bench.run_until_idle();
        replays(&bench);
    }
}

/// A wrong bit in the header may break the stream: then the fault is to blame, and not the client.
#[test]
fn a_header_that_a_fault_broke_is_not_blamed_on_the_client() {
    let corrupt = FaultRule::next(1).direction(Direction::Request);
    let mut broken = 0;
    for seed in 0..200 {
        let mut bench = Bench::with(Settings { seed, ..Settings::default() });
        let drive = bench.add::<EchoDevice>("echo");
        let client = connected(&mut bench, drive, MODBUS);
        set(&mut bench, drive, LineFaults { corrupt, ..QUIET });
        exchange(&mut bench, client, &adu(1));
        if let Some(ended) = bench.ended(client) {
            broken += 1;
            assert!(matches!(ended, Ended::BrokenByFault(_)), "{ended}");
            assert!(ended.to_string().starts_with("a fault has turned a request into a header "), "{ended}");
            let entries: Vec<String> =
                bench.received(drive).messages().map(|entry| entry.to_string()).collect();
            // A shorter length makes two messages of the request.
            assert!(entries.iter().all(|entry| entry.ends_with("by a fault, the request was corrupted")));
            assert!(entries[0].ends_with("lost; by a fault, the request was corrupted"), "{entries:?}");
        }
    }
    // Of 12 bytes, 2 are the protocol, and the higher byte of the length breaks the stream, too.
    assert!((30..70).contains(&broken), "{broken}");
    let (mut bench, _, client) = faulty(LineFaults { delay: Duration::millis(1), ..QUIET });
    exchange(&mut bench, client, &[0, 1, 0, 9, 0, 6, 1, 3, 0, 0, 0, 1]);
    assert_eq!(bench.ended(client), Some(Ended::Broken(drivetwin_protocol::modbus::tcp::Broken::Protocol)));
}

/// An MDrive whose MCode port has these faults, and a client there. The sign-on has been read.
fn mcode(seed: u64, faults: LineFaults) -> (Bench, DriveId, Client) {
    let mut bench = Bench::with(Settings { seed, ..Settings::default() });
    let drive = bench.add_with("d", crate::catalog::make("mdrive").unwrap(), Setup::default()).unwrap();
    bench.run_until(5.secs());
    let port = bench.find_outlet("mcode").unwrap();
    let client = bench.join(port).unwrap();
    bench.run_until_idle();
    received_by(&mut bench, client);
    bench.set_faults(port, faults);
    (bench, drive, client)
}

/// Echo, answer and prompt of a line are one reply.
#[test]
fn a_reply_of_mcode_is_all_that_a_line_causes() {
    const USUAL: &[u8] = b"PR VM\r\n768000\r\n>";
    let reply = FaultRule::next(1).direction(Direction::Reply);
    let delay = Duration::millis(5);
    for (faults, effect) in [
        (LineFaults { drop: reply, ..QUIET }, "was dropped"),
        (LineFaults { mute: reply, ..QUIET }, "was not delivered"),
        (LineFaults { corrupt: reply, ..QUIET }, "was corrupted"),
        (LineFaults { truncate: reply, ..QUIET }, "was truncated"),
        (LineFaults { duplicate: reply, ..QUIET }, "was sent twice"),
        (LineFaults { noise: reply, ..QUIET }, "had noise beside it"),
        (LineFaults { delay, delayed: reply, ..QUIET }, "was delayed"),
        (LineFaults { close: reply, ..QUIET }, "was cut off by the end of the connection"),
    ] {
        for seed in 0..20 {
            let (mut bench, drive, client) = mcode(seed, faults);
            let begin = bench.now();
            bench.send(client, b"PR VM\r");
            bench.run_until(begin + 4.millis());
            let soon = received_by(&mut bench, client);
            bench.run_until(begin + 1.secs());
            let late = received_by(&mut bench, client);
            let all = [&soon[..], &late].concat();
            match effect {
                "was dropped" | "was not delivered" => assert_eq!(all, [0; 0]),
                "was corrupted" => {
                    let turned: u32 = all.iter().zip(USUAL).map(|(a, b)| (a ^ b).count_ones()).sum();
                    assert_eq!((all.len(), turned), (USUAL.len(), 1));
                }
                "was truncated" | "was cut off by the end of the connection" => {
                    assert!(USUAL.starts_with(&all) && !all.is_empty() && all.len() < USUAL.len(), "{all:?}");
                }
                "was sent twice" => assert_eq!(all, USUAL.repeat(2)),
                "had noise beside it" => {
                    assert!(all.ends_with(USUAL) && (1..=8).contains(&(all.len() - USUAL.len())), "{all:?}");
                }
                _ => assert_eq!((soon, late.as_slice()), (vec![], USUAL)),
            }
            let entries: Vec<String> =
                bench.received(drive).messages().map(|entry| entry.to_string()).collect();
            assert_eq!(entries, [format!("mcode <- PR VM -> 768000; by a fault, the reply {effect}")]);
            if bench.ended(client).is_none() {
                assert_eq!(exchange(&mut bench, client, b"PR VM\r"), USUAL);
                let last = bench.received(drive).messages().last().unwrap().to_string();
                assert_eq!(last, "mcode <- PR VM -> 768000");
            }
        }
    }
}

/// A client that types gets an echo for each character, so that a client that waits for it goes on.
#[test]
fn a_typed_character_has_a_reply_of_its_own() {
    let reply = FaultRule::next(1).direction(Direction::Reply);
    for (faults, first, last, effect) in [
        (LineFaults { drop: reply, ..QUIET }, &b""[..], &b"\r\n768000\r\n>"[..], "was dropped"),
        // A reply of one character has no end that could be missing.
        (LineFaults { truncate: reply, ..QUIET }, b"P", b"", "was truncated"),
        (LineFaults { duplicate: reply, ..QUIET }, b"PP", b"\r\n768000\r\n>", "was sent twice"),
    ] {
        let (mut bench, drive, client) = mcode(1, faults);
        assert_eq!(exchange(&mut bench, client, b"P"), first, "{effect}");
        for character in [b"R", b" ", b"V", b"M"] {
            assert_eq!(exchange(&mut bench, client, character), character);
        }
        let end = exchange(&mut bench, client, b"\r");
        if effect == "was truncated" {
            assert!(b"\r\n768000\r\n>".starts_with(&end[..]) && end.len() < 11, "{end:?}");
        } else {
            assert_eq!(end, last, "{effect}");
        }
        let entries: Vec<String> = bench.received(drive).messages().map(|entry| entry.to_string()).collect();
        assert_eq!(entries, [format!("mcode <- PR VM -> 768000; by a fault, the reply {effect}")]);
    }
}

/// The numbers of an undisturbed reply do not depend on how the drive sends it.
#[test]
fn a_quiet_reply_of_mcode_takes_the_numbers_of_one_reply() {
    let rate = LineFaults { drop: FaultRule::rate(0.3).direction(Direction::Reply), ..QUIET };
    let lost = |from: usize| {
        let (mut bench, _, client) = mcode(7, QUIET);
        let port = bench.find_outlet("mcode").unwrap();
        let mut lost = Vec::new();
        for n in 0..60 {
            if n == from {
                bench.set_faults(port, rate);
            }
            if exchange(&mut bench, client, b"PR VM\r").is_empty() {
                lost.push(n);
            }
        }
        lost
    };
    let all = lost(0);
    assert!(all.len() > 8, "{all:?}");
    assert_eq!(lost(30), all.into_iter().filter(|&n| n >= 30).collect::<Vec<_>>());
}

#[test]
fn a_retry_on_tcp_repeats_a_request_without_an_answer() {
    let (mut bench, drive, mut client) = faulty(QUIET);
    let port = Outlet::Tcp(drive, MODBUS);
    let mut transaction = 0;
    let mut retries = |bench: &mut Bench, client: Client, faults: LineFaults| {
        bench.set_faults(port, faults);
        transaction += 1;
        exchange(bench, client, &adu(transaction));
        bench.request_statistics(port).retries
    };
    let all = FaultRule::ALL;
    assert_eq!(retries(&mut bench, client, QUIET), 0);
    assert_eq!(
        retries(&mut bench, client, LineFaults { mute: all, ..QUIET }),
        0,
        "the one before had an answer"
    );
    for (faults, count) in [
        (LineFaults { drop: all, ..QUIET }, 1),
        (LineFaults { wrong_transaction: all, ..QUIET }, 2),
        (LineFaults { wrong_address: all, ..QUIET }, 3),
        (LineFaults { truncate: all.direction(Direction::Reply), ..QUIET }, 4),
        (LineFaults { exception: all, ..QUIET }, 5),
        (LineFaults { close: all.direction(Direction::Reply), ..QUIET }, 5),
    ] {
        assert_eq!(retries(&mut bench, client, faults), count, "{faults:?}");
    }
    // The master connects anew and repeats its request.
    bench.disconnect(client);
    client = connected(&mut bench, drive, MODBUS);
    assert_eq!(retries(&mut bench, client, LineFaults { mute: all, ..QUIET }), 6);
    // Another client asks the same, which is no retry.
    let other = connected(&mut bench, drive, MODBUS);
    assert_eq!(retries(&mut bench, other, QUIET), 6);
    assert_eq!(bench.request_statistics(port).requests, 10);
}
