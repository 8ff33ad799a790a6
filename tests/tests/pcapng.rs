//! Captures of lines. Their bytes are checked against a file made by hand, which `tshark` reads in
//! `tests/foreign/test_pcap.py`; that one also reads what the program writes.
#![allow(missing_docs, reason = "a test")]

use standin_firmware::device::{Instant, Port};
use standin_firmware::md3::Md3;
use standin_firmware::qsb::Qsb;
use standin_protocol::modbus::rtu;
use standin_protocol::time::{Duration, Span};
use standin_sim::bench::{Bench, PowerAction, Seat, Settings, Setup};
use standin_sim::capture::From;
use standin_sim::pcapng::{self, File, Packet, Pcapng, Protocol, Way};
use standin_sim::trace::TraceKeep;

/// A packet as it is found in a file.
#[derive(Clone, PartialEq, Eq, Debug)]
struct Found {
    interface: u32,
    nanos: u64,
    bytes: Vec<u8>,
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
                // Behind the eight bytes of the flags.
                lost: if word(options, 8) == 8 << 16 | 4 { word(options, 12).into() } else { 0 },
            });
        }
        file = rest;
    }
    packets
}

fn bench(capture: TraceKeep) -> Bench {
    Bench::with(Settings { capture, ..Settings::default() })
}

fn seat(bench: &mut Bench, name: &str) -> Seat {
    let setup = Setup { boot_fast: true, ..Setup::default() };
    bench.seat(name, Box::new(Md3::default()), setup).unwrap()
}

fn written(bench: &Bench) -> Vec<u8> {
    let mut file = Vec::new();
    pcapng::write(bench, &mut file).unwrap();
    file
}

#[test]
fn the_writer_makes_the_file_made_by_hand() {
    let mut made = Vec::new();
    let mut file = File::new(&mut made).unwrap();
    let line = file.line("m.modbus").unwrap();
    let request = [0, 1, 0, 0, 0, 6, 1, 3, 0, 0x22, 0, 2];
    let reply = [0, 1, 0, 0, 0, 7, 1, 3, 4, 0x12, 0x34, 0, 2];
    let packet = |at: Instant, way, bytes| Packet { line, at, way, protocol: Protocol::Tcp, bytes, lost: 0 };
    // A tick is 62.5 ns.
    file.packet(&packet(Instant::from_ticks(16_000_001), Way::In, &request)).unwrap();
    file.packet(&packet(300.secs().into(), Way::Out, &reply)).unwrap();
    assert_eq!(made, include_bytes!("../captures/modbus-tcp.pcapng"));
}

/// Two drives on a line, one on its own, and a QSB that is asked in lines with both ends.
fn busy_bench() -> (Bench, Vec<standin_sim::bench::Client>) {
    let mut bench = bench(TraceKeep::All);
    let (x, y, z) = (seat(&mut bench, "x"), seat(&mut bench, "y"), seat(&mut bench, "z"));
    let qsb = bench.add::<Qsb>("q");
    let shared = bench.share("line1", &[(x, Port(0)), (y, Port(0))]);
    let own = bench.bus(z, Port(0)).unwrap();
    let text = bench.bus(qsb, Port(0)).unwrap();
    bench.attach(text, true);
    let clients = [shared, own, text].map(|bus| bench.connect(bus)).to_vec();
    (bench, clients)
}
