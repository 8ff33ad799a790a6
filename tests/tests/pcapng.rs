//! Captures of lines. Their bytes are compared with a file made by hand, which `tshark` reads in
//! `tests/foreign/test_pcap.py`. That test also reads the program's own files.
#![allow(missing_docs, reason = "a test")]

use drivetwin_firmware::device::{Instant, Port};
use drivetwin_firmware::md3::Md3;
use drivetwin_firmware::qsb::Qsb;
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::{Duration, Span};
use drivetwin_sim::bench::{Bench, Bus, DriveId, PowerAction, Settings, Setup};
use drivetwin_sim::export::pcapng::{self, Blocks, Packet, Pcapng, Protocol, Way};
use drivetwin_sim::record::capture::Source;
use drivetwin_sim::record::trace::Retention;
use proptest::prelude::*;

/// A packet read from a file.
#[derive(Clone, PartialEq, Eq, Debug)]
struct Found {
    interface: u32,
    nanos: u64,
    bytes: Vec<u8>,
    /// Name of Wireshark's dissector, which is the value of the packet's first tag.
    shown_by: String,
    flags: u32,
    lost: u64,
}

fn word(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap())
}

/// The packets of a file, without the tags before their bytes.
fn packets(mut file: &[u8]) -> Vec<Found> {
    let mut packets = Vec::new();
    while !file.is_empty() {
        let (block, rest) = file.split_at(word(file, 4) as usize);
        assert_eq!(word(block, block.len() - 4) as usize, block.len());
        if word(block, 0) == 6 {
            let length = word(block, 20) as usize;
            let tags = block[28..28 + length].windows(4).step_by(4).position(|tag| tag == [0; 4]).unwrap();
            let options = &block[28 + length.next_multiple_of(4)..];
            packets.push(Found {
                interface: word(block, 8),
                nanos: u64::from(word(block, 12)) << 32 | u64::from(word(block, 16)),
                bytes: block[28 + tags * 4 + 4..28 + length].to_vec(),
                shown_by: shown_by(&block[28..]),
                flags: word(options, 4),
                // The count of lost packets follows the eight bytes of the flags.
                lost: if word(options, 8) == 8 << 16 | 4 { word(options, 12).into() } else { 0 },
            });
        }
        file = rest;
    }
    packets
}

/// Text of a packet's first tag: its length in network order, then the text, padded with 0.
fn shown_by(tags: &[u8]) -> String {
    let length = u16::from_be_bytes([tags[2], tags[3]]).into();
    String::from_utf8(tags[4..][..length].to_vec()).unwrap().trim_end_matches('\0').to_owned()
}

fn bench(capture: Retention) -> Bench {
    Bench::with(Settings { capture, ..Settings::default() })
}

fn seat(bench: &mut Bench, name: &str) -> DriveId {
    let setup = Setup { boot_fast: true, ..Setup::default() };
    bench.add_with(name, Box::new(Md3::default()), setup).unwrap()
}

fn written(bench: &Bench) -> Vec<u8> {
    let mut file = Vec::new();
    pcapng::write(bench, &mut file).unwrap();
    file
}

#[test]
fn the_writer_makes_the_file_made_by_hand() {
    let mut made = Vec::new();
    let mut file = Blocks::new(&mut made).unwrap();
    let line = file.line("m.modbus").unwrap();
    let request = [0, 1, 0, 0, 0, 6, 1, 3, 0, 0x22, 0, 2];
    let reply = [0, 1, 0, 0, 0, 7, 1, 3, 4, 0x12, 0x34, 0, 2];
    let packet = |at: Instant, way, bytes| Packet {
        line,
        at,
        way,
        protocol: Protocol::Tcp,
        bytes,
        collided: false,
        comment: "",
        lost: 0,
    };
    // A tick is 62.5 ns.
    file.packet(&packet(Instant::from_ticks(16_000_001), Way::In, &request)).unwrap();
    file.packet(&packet(300.secs().into(), Way::Out, &reply)).unwrap();
    assert_eq!(made, include_bytes!("../captures/modbus-tcp.pcapng"));
}

/// Time at which `talk` ends.
const END: Duration = Duration::millis(1_500);

/// Two drives on a line, one on its own line, and a QSB that streams and answers commands.
/// At the instants in `stops` the file follows the bench.
fn talk(stops: &[Duration]) -> (Bench, Vec<u8>) {
    let mut bench = bench(Retention::All);
    let (x, y, z) = (seat(&mut bench, "x"), seat(&mut bench, "y"), seat(&mut bench, "z"));
    let qsb = bench.add_with("q", Box::new(Qsb::m()), Setup { boot_fast: true, ..Setup::default() }).unwrap();
    let shared = bench.share("line1", &[(x, Port(0)), (y, Port(0))]);
    let own = bench.bus(z, Port(0)).unwrap();
    let text = bench.bus(qsb, Port(0)).unwrap();
    let mut said: Vec<(Duration, Bus, Vec<u8>)> = Vec::new();
    for n in 0..20 {
        let at = 100.millis() + 61.millis() * n;
        said.push((at, shared, rtu::write(1, 0x1D, n as u16).to_vec()));
        said.push((at + 7.micros(), own, rtu::read(1, 0x12, 2).to_vec()));
        said.push((at + 13.millis(), text, b"R03\r\n".to_vec()));
        said.push((at + 14.millis(), text, b"R04\rR".to_vec()));
        said.push((at + 50.millis(), text, b"05\n".to_vec()));
    }
    said.push((90.millis(), text, b"W0C0\rS0E\r".to_vec()));
    said.sort();
    let clients = [shared, own, text].map(|bus| (bus, bench.connect(bus)));
    let client = |bus: Bus| clients.iter().find(|(other, _)| *other == bus).unwrap().1;

    let mut file = Vec::new();
    let mut pcapng = Pcapng::new(&bench, &mut file).unwrap();
    let mut stops: Vec<Duration> = stops.iter().copied().filter(|stop| *stop < END).collect();
    stops.sort_by(|a, b| b.cmp(a));
    for (at, bus, bytes) in said {
        while let Some(stop) = stops.pop_if(|stop| *stop < at) {
            bench.run_until(stop);
            pcapng.follow(&bench).unwrap();
        }
        bench.run_until(at);
        bench.send(client(bus), &bytes);
    }
    for stop in stops.into_iter().rev() {
        bench.run_until(stop);
        pcapng.follow(&bench).unwrap();
    }
    bench.run_until(END);
    pcapng.follow(&bench).unwrap();
    pcapng.finish(&bench).unwrap();
    (bench, file)
}

#[test]
fn each_line_has_its_packets() {
    let (bench, file) = talk(&[]);
    assert_eq!(file, written(&bench));
    let packets = packets(&file);
    // Lines are ordered by the names of their first drives.
    let names: Vec<&str> = bench.buses().into_iter().map(|bus| bench.bus_name(bus)).collect();
    let on = |line: &str| {
        let interface = names.iter().position(|name| *name == line).unwrap() as u32;
        packets.iter().filter(move |packet| packet.interface == interface)
    };
    // 20 writes to two drives with the same address. Both answer, and both replies are on the line.
    assert!(on("line1").count() >= 40);
    let own: Vec<&Found> =
        on(bench.bus_name(bench.bus(bench.find_drive("z").unwrap(), Port(0)).unwrap())).collect();
    assert_eq!(own.len(), 40);
    for (n, pair) in (0_u64..).zip(own.chunks(2)) {
        assert_eq!(pair[0].bytes, rtu::read(1, 0x12, 2)[..]);
        assert_eq!(pair[0].nanos, 100_007_000 + 61_000_000 * n);
        assert_eq!(pair[1].bytes, rtu::frame(1, &[3, 4, 0, 0, 0x27, 0x10])[..]);
    }
    let text: Vec<&[u8]> = on(bench.bus_name(bench.bus(bench.find_drive("q").unwrap(), Port(0)).unwrap()))
        .map(|packet| packet.bytes.as_slice())
        .collect();
    let count = |line: &[u8]| text.iter().filter(|text| **text == line).count();
    assert_eq!((count(b"R03\r\n"), count(b"R04\r"), count(b"R05\n")), (20, 20, 20));
    assert_eq!((count(b"W0C0\r"), count(b"S0E\r")), (1, 1));
    assert!(text.len() > 500, "it streams: {}", text.len());
    assert!(text.iter().all(|text| matches!(text.last(), Some(b'\r' | b'\n'))));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    /// The number of times that a file follows a bench does not change the file.
    #[test]
    fn following_does_not_change_a_file(stops in proptest::collection::vec(0..END.ticks(), 0..200)) {
        let stops: Vec<Duration> = stops.into_iter().map(Duration::from_ticks).collect();
        prop_assert_eq!(talk(&stops).1, talk(&[]).1);
    }
}

#[test]
fn packets_dropped_by_a_ring_are_counted() {
    let mut bench = bench(Retention::Ring(2_000));
    let md3 = seat(&mut bench, "x");
    for _ in 0..50 {
        bench.ask(md3, &rtu::read(1, 0x12, 2));
    }
    let packets = packets(&written(&bench));
    assert!(packets.len() < 100);
    assert_eq!(packets[0].lost, 100 - packets.len() as u64);
    assert!(packets[1..].iter().all(|packet| packet.lost == 0));
}

/// Collided bytes are not shown as Modbus, although each sender's checksum is right. Their flag is bit 24
/// (4.3.1).
#[test]
fn collided_frames_are_shown_as_data() {
    let mut bench = bench(Retention::All);
    let seats = ["x", "y"].map(|name| (seat(&mut bench, name), Port(0)));
    let line = bench.share("line1", &seats);
    bench.set_collisions(line, true);
    let client = bench.connect(line);
    bench.run_until(1.millis());
    bench.send(client, &rtu::read(1, 0x12, 2));
    bench.run_until(1.secs());
    let shown: Vec<(String, u32)> =
        packets(&written(&bench)).into_iter().map(|packet| (packet.shown_by, packet.flags)).collect();
    let answer = ("data".to_owned(), 1 << 24 | 2);
    assert_eq!(shown, [("mbrtu".to_owned(), 1), answer.clone(), answer]);
}

#[test]
fn a_power_failure_cuts_the_output_of_a_drive() {
    let mut bench = bench(Retention::All);
    let md3 = seat(&mut bench, "x");
    let client = bench.connect(bench.bus(md3, Port(0)).unwrap());
    bench.send(client, &rtu::read(1, 0x12, 2));
    bench.run_until(1.millis());
    let reply = loop {
        bench.run_until(bench.now() + 100.micros());
        if let Some(frame) = bench.capture().since(1).next() {
            break frame.clone();
        }
    };
    assert_eq!((reply.from, reply.bytes.len()), (Source::Drive(md3), 9));
    // Power fails within the fourth character.
    let character = Duration::of_bits(11, 9_600);
    bench.run_until(reply.at + character * 3 + 100.micros());
    bench.power(md3, PowerAction::Off);
    bench.run_until(1.secs());
    let mut heard = Vec::new();
    bench.receive(client, &mut heard);
    assert_eq!(heard, reply.bytes[..3]);
    let packets = packets(&written(&bench));
    assert_eq!(packets.len(), 2);
    assert_eq!(packets[1].bytes, heard);
}
