//! The port of the bus (BOARD-14).

use drivetwin_board::CablePort;
use drivetwin_control::{Answer, Call, Statistics};
use drivetwin_firmware::device::{Duration, Instant, Line};
use drivetwin_protocol::line::Parity;
use drivetwin_protocol::modbus::rtu;
use drivetwin_tests::at_cable::Rig;

/// Ticks of a character of 9,600 8E1: 11 bits.
const CHARACTER: u64 = 18_333;

fn statistics(rig: &mut Rig) -> Statistics {
    match rig.call(Call::Statistics) {
        Ok(Answer::Statistics(statistics)) => statistics,
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_request_is_answered_after_exactly_3_5_characters_of_silence() {
    let mut rig = Rig::new("md3", true);
    rig.run_until(Instant::from_ticks(1_000_000));
    let request = rtu::read(1, 0x00, 1);
    rig.write(CablePort::Bus, &request);
    rig.run_for(Duration::millis(100));
    // Eight characters, 3.5 characters of silence, and one more: a character that begins before that ends then.
    let start = 1_000_000 + 8 * CHARACTER + 64_166 + CHARACTER;
    let reply = rtu::frame(1, &[3, 2, 0, 1]);
    let sent: Vec<(Instant, u8)> = rig.sent();
    let bytes: Vec<u8> = sent.iter().map(|(_, byte)| *byte).collect();
    assert_eq!(bytes, reply.as_slice());
    assert_eq!(sent[0].0, Instant::from_ticks(start));
    assert_eq!(rig.read_bus(), reply.as_slice());
    assert_eq!(statistics(&mut rig).requests, 1);
}

#[test]
fn other_settings_are_characters_with_an_error() {
    let line = Line::new(9_600, 8, Parity::Even, 1);
    let wrong = [
        Line { baud: 19_200, ..line },
        Line { parity: Parity::Odd, ..line },
        Line { stop: 2, ..line },
        Line { data: 7, ..line },
    ];
    for wrong in wrong {
        let mut rig = Rig::new("md3", true);
        rig.set_line(Some(wrong));
        rig.write(CablePort::Bus, &rtu::read(1, 0x00, 1));
        rig.run_for(Duration::millis(100));
        assert_eq!((rig.sent(), rig.read_bus()), (vec![], vec![]), "{wrong}");
        assert_eq!(statistics(&mut rig).spoiled, 1, "{wrong}");
        rig.set_line(Some(line));
        rig.write(CablePort::Bus, &rtu::read(1, 0x00, 1));
        rig.run_for(Duration::millis(100));
        assert_eq!(rig.read_bus(), rtu::frame(1, &[3, 2, 0, 1]).as_slice(), "{wrong}");
    }
}

#[test]
fn a_frame_in_pieces_has_the_gaps_of_its_pieces() {
    let request = rtu::read(1, 0x00, 1);
    // A gap of 1.5 characters is 27,500 ticks. A longer one spoils a frame of an MD3; the pieces come at once.
    for (gap, answered) in [(27_400, true), (27_600, false)] {
        let mut rig = Rig::new("md3", true);
        rig.run_until(Instant::from_ticks(1_000_000));
        rig.write(CablePort::Bus, &request[..3]);
        rig.run_until(Instant::from_ticks(1_000_000 + 3 * CHARACTER + gap));
        rig.write(CablePort::Bus, &request[3..]);
        rig.run_for(Duration::millis(100));
        assert_eq!(rig.read_bus().is_empty(), !answered, "{gap}");
        assert_eq!(statistics(&mut rig).gap, u32::from(!answered), "{gap}");
    }
}

#[test]
fn more_characters_than_fit_wait_in_the_cable() {
    let mut rig = Rig::new("md3", true);
    // 16 registers in one request of 41 characters, and many such requests, all at once.
    let (values, count) = ([0_u16; 2], 30);
    let request =
        rtu::frame(1, &[&[16, 0, 0x14, 0, 2, 4][..], &values.map(u16::to_be_bytes).concat()].concat());
    rig.write(CablePort::Bus, &request.repeat(1));
    rig.run_for(Duration::millis(1));
    assert_eq!(rig.untaken(CablePort::Bus), 0);
    rig.write(CablePort::Bus, &vec![0x55; 20 * count]);
    rig.run_for(Duration::millis(1));
    let left = rig.untaken(CablePort::Bus);
    assert!(left > 500, "{left} wait");
    // Each character takes its time: none is lost.
    rig.run_for(Duration::from_ticks(CHARACTER * 20 * count as u64 + 16_000));
    assert_eq!(rig.untaken(CablePort::Bus), 0);
}

#[test]
fn a_half_duplex_drive_hears_nothing_while_it_sends() {
    let mut rig = Rig::new("md3", true);
    let request = rtu::read(1, 0x00, 1);
    rig.write(CablePort::Bus, &request);
    // The reply of 7 characters begins after 13.2 ms.
    rig.run_for(Duration::millis(15));
    rig.write(CablePort::Bus, &request[..3]);
    rig.run_for(Duration::millis(100));
    assert_eq!(rig.read_bus(), rtu::frame(1, &[3, 2, 0, 1]).as_slice());
    let counted = statistics(&mut rig);
    assert_eq!((counted.requests, counted.crc, counted.length), (1, 0, 0));
    // A full-duplex one does.
    let mut rig = Rig::new("qsb-m", true);
    rig.run_for(Duration::millis(200));
    rig.read_bus();
    rig.write(CablePort::Bus, b"R0E\rR03\rR04\r");
    rig.run_for(Duration::millis(200));
    let replies = rig.read_bus();
    assert_eq!(replies.split(|byte| *byte == b'\n').filter(|line| !line.is_empty()).count(), 3);
}

#[test]
fn a_master_that_asks_again_at_once_is_heard() {
    let mut rig = Rig::new("md3", true);
    let (request, reply) = (rtu::read(1, 0x00, 1), rtu::frame(1, &[3, 2, 0, 1]));
    for n in 1..=20 {
        rig.write(CablePort::Bus, &request);
        let mut read = Vec::new();
        while read.len() < reply.len() {
            rig.run_for(Duration::micros(20));
            read.extend(rig.read_bus());
            assert!(rig.now() < Instant::from(Duration::millis(40 * n)), "no reply to request {n}");
        }
        assert_eq!(read, reply.as_slice(), "{n}");
        // The last character has left.
        let (start, _) = rig.sent()[reply.len() * n as usize - 1];
        let end = start + Duration::from_ticks(CHARACTER);
        assert!((end..end + Duration::micros(40)).contains(&rig.now()), "request {n}");
    }
}

#[test]
fn dtr_resets_a_qsb_and_nothing_else() {
    let mut rig = Rig::new("qsb-m", true);
    rig.run_for(Duration::millis(200));
    let banner = b"QSB-M  0E!\r\n";
    assert!(rig.read_bus().ends_with(banner));
    rig.open(CablePort::Bus, false);
    rig.run_for(Duration::millis(200));
    rig.open(CablePort::Bus, true);
    rig.run_for(Duration::millis(200));
    assert_eq!(rig.read_bus(), banner);
    // With DTR at its wire, too, the host is there all the time.
    rig.catch(drivetwin_firmware::shell::BoardEvent::HostPresence(drivetwin_firmware::device::Port(0), true));
    rig.run_for(Duration::millis(200));
    rig.open(CablePort::Bus, false);
    rig.run_for(Duration::millis(200));
    rig.open(CablePort::Bus, true);
    rig.run_for(Duration::millis(200));
    assert_eq!(rig.read_bus(), [0; 0]);
}

#[test]
fn characters_that_nobody_reads_are_counted_and_the_drive_goes_on() {
    let mut rig = Rig::new("qsb-m", true);
    rig.run_for(Duration::millis(200));
    // A stream of the encoder's value: 17 characters each 1/512 s, 10 s long. The computer does not read.
    for line in [&b"W0C0001\r"[..], b"S0E\r"] {
        rig.write(CablePort::Bus, line);
        rig.run_for(Duration::millis(100));
    }
    rig.run_for(Duration::secs(10));
    let (sent, unread) = (rig.sent().len() as u32, rig.unread(CablePort::Bus) as u32);
    let lost = statistics(&mut rig).lost_characters;
    assert!(lost > 1_000, "{lost} of {sent}");
    // In the tap are 256, and 63 in a packet.
    assert_eq!(lost + unread + 256 + 63, sent);
    // A closed port is a line that nobody listens to.
    rig.open(CablePort::Bus, false);
    rig.run_for(Duration::secs(1));
    assert_eq!(statistics(&mut rig).lost_characters - lost, 0);
}

#[test]
fn a_computer_that_takes_few_packets_gets_all_characters() {
    let mut rig = Rig::new("qsb-m", true);
    rig.run_for(Duration::millis(200));
    rig.read_bus();
    rig.take_slowly(CablePort::Bus);
    let (begin, mut read) = (rig.sent().len(), Vec::new());
    // A stream of 17 characters each 1/512 s. The computer takes one packet in a millisecond.
    rig.write(CablePort::Bus, b"W0C0001\rS0E\r");
    for _ in 0..600 {
        rig.run_for(Duration::millis(1));
        read.extend(rig.read_bus());
    }
    assert!(read.len() > 4_000, "{}", read.len());
    assert_eq!(statistics(&mut rig).lost_characters, 0);
    let sent: Vec<u8> = rig.sent().into_iter().skip(begin).map(|(_, byte)| byte).collect();
    assert!(sent.starts_with(&read));
}

#[test]
fn a_port_without_settings_is_silent() {
    let mut rig = Rig::new("md3", true);
    rig.set_line(None);
    rig.write(CablePort::Bus, &rtu::read(1, 0x00, 1));
    rig.run_for(Duration::millis(100));
    assert_eq!((rig.untaken(CablePort::Bus), rig.sent()), (0, vec![]));
    assert_eq!(statistics(&mut rig).spoiled, 0);
}

#[test]
fn the_bus_of_the_uart_and_the_one_of_the_cable_are_one() {
    use drivetwin_firmware::device::Port;
    use drivetwin_firmware::shell::BoardEvent;
    let mut rig = Rig::new("md3", true);
    rig.run_until(Instant::from_ticks(1_000_000));
    // The first half of a request comes from the cable, the second half from the UART.
    let request = rtu::read(1, 0x00, 1);
    rig.write(CablePort::Bus, &request[..4]);
    for (n, byte) in (5..).zip(&request[4..]) {
        rig.run_until(Instant::from_ticks(1_000_000 + n * CHARACTER));
        rig.catch(BoardEvent::Byte(Port(0), *byte));
    }
    rig.run_for(Duration::millis(100));
    assert_eq!(rig.read_bus(), rtu::frame(1, &[3, 2, 0, 1]).as_slice());
    let start = rig.sent()[0].0;
    assert_eq!(start, Instant::from_ticks(1_000_000 + 8 * CHARACTER + 64_166 + CHARACTER));
}
