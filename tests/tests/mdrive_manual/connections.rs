//! Both ports (FB 1.2.1): several clients, split messages, and bytes without a meaning.

use drivetwin_firmware::mdrive::Mdrive;
use drivetwin_protocol::time::{Duration, Span};
use drivetwin_sim::bench::{Bench, Client, ConnectError, PowerAction, Setup};

use crate::rig::{KINDS, MCODE, MODBUS, Rig, START, adu, request};

impl Rig {
    fn heard_by(&mut self, client: Client) -> Vec<u8> {
        self.bench.run_until_idle();
        self.after(Duration::TICK);
        let mut bytes = Vec::new();
        self.bench.receive(client, &mut bytes);
        bytes
    }
}

#[test]
fn every_unit_and_transaction_is_answered_with_its_own() {
    let mut rig = Rig::plus();
    for unit in [0, 1, 2, 247, 248, 255] {
        for transaction in [0, 1, 0x1234, 0xFFFF] {
            let client = rig.modbus;
            rig.bench.send(client, &adu(transaction, unit, &request(3, 0x0029, 1)));
            assert_eq!(rig.heard_by(client), adu(transaction, unit, &[3, 2, 0, 5]));
        }
    }
}

#[test]
fn requests_come_in_pieces_and_several_at_once() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        let client = rig.modbus;
        let stream: Vec<u8> = (0..5).flat_map(|n| adu(n, 1, &request(3, 0x0029, 1))).collect();
        let replies: Vec<u8> = (0..5).flat_map(|n| adu(n, 1, &[3, 2, 0, 5])).collect();
        rig.bench.send(client, &stream);
        assert_eq!(rig.heard_by(client), replies);
        for size in [1, 2, 5, 7, 11, 13] {
            let mut came = Vec::new();
            for piece in stream.chunks(size) {
                rig.bench.send(client, piece);
                rig.after(10.millis());
                came.extend(rig.heard_by(client));
            }
            assert_eq!(came, replies, "pieces of {size}");
        }
    }
}

#[test]
fn what_is_no_modbus_closes_its_connection_and_no_other() {
    let mut rig = Rig::plus();
    let good = request(3, 0x0029, 1);
    let bad: [&[u8]; 5] = [
        // Another protocol; no unit; no function; longer than a PDU can be; an HTTP request.
        &[0, 1, 0, 1, 0, 6, 1, 3, 0, 0x29, 0, 1],
        &[0, 1, 0, 0, 0, 0, 1, 3, 0, 0x29, 0, 1],
        &[0, 1, 0, 0, 0, 1, 1, 3, 0, 0x29, 0, 1],
        &[0, 1, 0, 0, 0, 255, 1, 3, 0, 0x29, 0, 1],
        b"GET / HTTP/1.1\r\n\r\n",
    ];
    for bytes in bad {
        let client = rig.bench.connect_to(rig.seat, MODBUS).expect("room");
        rig.bench.send(client, &adu(7, 1, &good));
        rig.bench.send(client, bytes);
        rig.bench.send(client, &adu(8, 1, &good));
        assert_eq!(rig.heard_by(client), adu(7, 1, &[3, 2, 0, 5]), "{bytes:02X?}");
        assert!(rig.bench.ended(client).is_some(), "{bytes:02X?}");
        rig.bench.disconnect(client);
        assert_eq!(rig.word(0x0029), 5, "another connection");
    }
}

#[test]
fn clients_come_and_go_and_see_one_drive() {
    let mut rig = Rig::plus();
    let clients: Vec<Client> =
        (0..8).map(|_| rig.bench.connect_to(rig.seat, MODBUS).expect("room")).collect();
    for (n, &client) in (0_u8..).zip(&clients) {
        let pdu = [16, 0, 0x5F, 0, 2, 4, 0, 0, 0, n];
        rig.bench.send(client, &adu(u16::from(n), n, &pdu));
        assert_eq!(rig.heard_by(client), adu(u16::from(n), n, &request(16, 0x005F, 2)));
        assert_eq!(rig.long(0x005F), i32::from(n));
        assert_eq!(rig.value("R1"), i64::from(n));
    }
    // One client disconnects in the middle of a request; the others continue.
    rig.bench.send(clients[0], &adu(1, 1, &request(3, 0, 2))[..9]);
    rig.bench.disconnect(clients[0]);
    rig.after(1.secs());
    assert_eq!(rig.long(0x005F), 7);
}

/// Each connection has its own line buffer.
#[test]
fn two_terminals_do_not_mix_their_lines() {
    let mut rig = Rig::plus();
    let other = rig.bench.connect_to(rig.seat, MCODE).expect("room");
    rig.key(b"R1=");
    rig.bench.send(other, b"R2=22\r");
    rig.heard_by(other);
    rig.key(b"11\r");
    rig.assert_values(&[("R1", 11), ("R2", 22), ("ER", 0)]);
    // Printed text is sent to the client that sent the line.
    rig.bench.send(other, b"PR R2\r");
    assert_eq!(rig.heard_by(other), b"22\r\n");
    assert_eq!(rig.heard(), "");
    // Output of programs is sent to all clients.
    rig.program("PG 1\nPR \"HERE\"\nE\nPG");
    assert_eq!(rig.say("EX 1"), "");
    rig.after(10.millis());
    assert_eq!(rig.heard(), "HERE\r\n");
    assert_eq!(rig.heard_by(other), b"HERE\r\n");
}

/// Random bytes cause errors at most, and afterwards the drive works.
#[test]
fn bytes_that_mean_nothing_do_no_harm() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        let mut seed = 1_u32;
        let mut next = || {
            seed ^= seed << 13;
            seed ^= seed >> 17;
            seed ^= seed << 5;
            seed
        };
        for _ in 0..200 {
            // Ctrl-C, Ctrl-E and Esc are left out, because the drive would act on them.
            let bytes: Vec<u8> =
                (0..next() % 90).map(|_| next() as u8).filter(|b| ![3, 5, 27].contains(b)).collect();
            let client = rig.bench.connect_to(rig.seat, MCODE).expect("room");
            rig.bench.send(client, &bytes);
            rig.bench.send(client, b"\r");
            rig.heard_by(client);
            rig.bench.disconnect(client);
            let client = rig.bench.connect_to(rig.seat, MODBUS).expect("room");
            rig.bench.send(client, &bytes);
            rig.heard_by(client);
            rig.bench.disconnect(client);
        }
        rig.say("");
        rig.say("ER=0");
        rig.say("R1=4711");
        assert_eq!(rig.value("R1"), 4_711);
        assert_eq!(rig.long(0x005F), 4_711);
    }
}

/// A line has at most 64 characters; a longer one gives CR LF and error 20 (MC 5-57).
#[test]
fn a_line_that_is_too_long_is_error_20() {
    let mut rig = Rig::plus();
    // A line of 64 characters, blanks included, is accepted.
    let most = format!("R1=5{}", " ".repeat(60));
    rig.say(&most);
    rig.assert_values(&[("R1", 5), ("ER", 0)]);
    for length in [65, 66, 100, 1_000, 10_000] {
        let line = format!("R1=6{}", " ".repeat(length - 4));
        rig.say(&line);
        let shown = rig.say("PR ER");
        assert!(shown.ends_with("20\r\n"), "{length}: {shown:?}");
        rig.assert_values(&[("R1", 5), ("ER", 0)]);
    }
}

#[test]
fn lines_end_with_cr_lf_or_both() {
    let mut rig = Rig::plus();
    for (n, end) in ["\r", "\n", "\r\n"].into_iter().enumerate() {
        rig.key(format!("R1={n}{end}IC R1{end}").as_bytes());
        assert_eq!(rig.value("R1"), n as i64 + 1, "{end:?}");
        assert_eq!(rig.value("ER"), 0, "{end:?}");
    }
}

/// Both ports belong to one Ethernet controller. It starts with the drive's power, and does not restart with
/// Ctrl-C.
#[test]
fn connections_are_accepted_once_the_drive_has_booted() {
    let mut bench = Bench::new();
    let seat =
        bench.add_with("x", Box::new(Mdrive::plus()), Setup::default()).expect("a drive that can be seated");
    for _ in 0..2 {
        // The power is on within a tick.
        let booted = bench.now() + 300.millis();
        bench.run_until(booted - Duration::TICK * 2);
        for port in [MODBUS, MCODE] {
            assert_eq!(bench.connect_to(seat, port), Err(ConnectError::Booting));
        }
        bench.run_until(booted + Duration::TICK);
        let client = bench.connect_to(seat, MCODE).expect("it has booted");
        bench.send(client, b"\x03");
        bench.run_until_idle();
        for port in [MODBUS, MCODE] {
            bench.connect_to(seat, port).expect("the Ethernet controller goes on");
        }
        bench.run_until(bench.now() + START);
        bench.power(seat, PowerAction::Off);
        bench.run_until(bench.now() + START);
        assert_eq!(bench.connect_to(seat, MCODE), Err(ConnectError::NoPower));
        bench.power(seat, PowerAction::On);
        bench.run_until(bench.now() + Duration::TICK);
    }
}

/// MC 7.1: `PR R1` takes 2 ms. Nothing that is typed in that time is lost, and port 502 is served all the
/// time.
#[test]
fn lines_of_several_clients_wait_for_each_other() {
    let mut rig = Rig::plus();
    let clients = [rig.mcode, rig.bench.connect_to(rig.seat, MCODE).expect("there is room")];
    rig.after(Duration::TICK);
    let start = rig.now();
    for client in clients {
        rig.bench.send(client, "R1=7\rPR R1\r\n".repeat(50).as_bytes());
    }
    rig.after(100.millis());
    let client = rig.modbus;
    rig.bench.send(client, &adu(1, 1, &request(3, 0x0029, 1)));
    rig.after(Duration::TICK);
    let mut came = Vec::new();
    rig.bench.receive(client, &mut came);
    assert_eq!(came, adu(1, 1, &[3, 2, 0, 5]));
    // Neither client waits until the other has finished.
    let early = clients.map(|client| {
        let mut early = Vec::new();
        rig.bench.receive(client, &mut early);
        early
    });
    for (client, mut said) in clients.into_iter().zip(early) {
        assert!((10..=15).contains(&(said.len() / 3)), "{}", said.len());
        said.extend(rig.heard_by(client));
        assert_eq!(said, "7\r\n".repeat(50).as_bytes());
    }
    let took = rig.now().since(start);
    assert!((400.millis()..401.millis()).contains(&took), "{took:?}");
}

#[test]
fn lines_of_a_disconnected_client_are_executed() {
    let mut rig = Rig::plus();
    let client = rig.bench.connect_to(rig.seat, MCODE).expect("there is room");
    rig.bench.send(client, b"R1=1\rR2=2\r\nR3=3\rMR 1000\rnever ended");
    rig.bench.disconnect(client);
    rig.bench.run_until_idle();
    rig.assert_now(&[("R1", 1), ("R2", 2), ("R3", 3), ("MR", 1000), ("ER", 0)]);
    assert_eq!(rig.bench.connections(rig.seat, MCODE), 1);
    // If the drive loses power meanwhile, the connection ends.
    let client = rig.bench.connect_to(rig.seat, MCODE).expect("there is room");
    rig.bench.send(client, b"R1=7\rS\r");
    rig.bench.disconnect(client);
    rig.bench.power(rig.seat, PowerAction::Cycle);
    rig.after(START);
    rig.connect();
    rig.bench.run_until_idle();
    rig.heard();
    assert_eq!((rig.peek("R1"), rig.bench.connections(rig.seat, MCODE)), (0, 1));
}

#[test]
fn how_time_is_cut_changes_nothing() {
    let trace = |slice: Duration| {
        let mut rig = Rig::loud(crate::rig::Kind::Plus);
        let other = rig.bench.connect_to(rig.seat, MCODE).expect("there is room");
        let end = rig.now() + 100.millis();
        rig.bench.send(rig.mcode, "MR 100\rPR P,V,MV\rHELLO\r\n\x1bPR ER\r".repeat(3).as_bytes());
        rig.bench.send(other, "R1=5\n\nL\rPR AL\rR".repeat(2).as_bytes());
        rig.bench.disconnect(other);
        while rig.now() < end {
            rig.after(slice);
        }
        rig.bench.trace().to_text()
    };
    let whole = trace(100.millis());
    assert!(whole.len() > 1_000);
    for slice in [Duration::micros(125), 1.millis(), 10.millis()] {
        assert_eq!(trace(slice), whole);
    }
}
