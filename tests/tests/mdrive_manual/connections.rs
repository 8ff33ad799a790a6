//! Both ports (FB 1.2.1): several clients, pieces, and bytes that mean nothing.

use standin_protocol::time::{Duration, Span};
use standin_sim::bench::Client;

use crate::rig::{KINDS, MCODE, MODBUS, Rig, adu, request};

impl Rig {
    fn heard_by(&mut self, client: Client) -> Vec<u8> {
        self.bench.settle();
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
        // Another protocol; no unit; no function; longer than a PDU can be; longer still.
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
    // Half a request is left; the others go on.
    rig.bench.send(clients[0], &adu(1, 1, &request(3, 0, 2))[..9]);
    rig.bench.disconnect(clients[0]);
    rig.after(1.secs());
    assert_eq!(rig.long(0x005F), 7);
}

/// Line buffers are of a connection.
#[test]
fn two_terminals_do_not_mix_their_lines() {
    let mut rig = Rig::plus();
    let other = rig.bench.connect_to(rig.seat, MCODE).expect("room");
    rig.key(b"R1=");
    rig.bench.send(other, b"R2=22\r");
    rig.heard_by(other);
    rig.key(b"11\r");
    rig.assert_values(&[("R1", 11), ("R2", 22), ("ER", 0)]);
    // What is printed goes to who asked.
    rig.bench.send(other, b"PR R2\r");
    assert_eq!(rig.heard_by(other), b"22\r\n");
    assert_eq!(rig.heard(), "");
    // What programs print goes to all.
    rig.program("PG 1\nPR \"HERE\"\nE\nPG");
    assert_eq!(rig.say("EX 1"), "");
    rig.after(10.millis());
    assert_eq!(rig.heard(), "HERE\r\n");
    assert_eq!(rig.heard_by(other), b"HERE\r\n");
}

/// Whatever comes: error numbers, and afterwards the drive works.
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
            // No Ctrl-C and no Esc, which have their meaning.
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

/// 64 characters in a line; then CR LF and error 20 (MC 5-57).
#[test]
fn a_line_that_is_too_long_is_error_20() {
    let mut rig = Rig::plus();
    // 64 with their blanks are taken.
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
