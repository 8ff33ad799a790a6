//! Chapter 7 of the MD3 User Guide V1.7 over the bus: every row, with what the guide prints typed by
//! hand.
#![allow(missing_docs, reason = "a test")]

use standin_firmware::md3::Md3;
use standin_protocol::modbus::{Frame, rtu};
use standin_protocol::time::Span;
use standin_sim::bench::{Bench, Seat};

/// An MD3 that is ready.
fn md3() -> (Bench, Seat) {
    let mut bench = Bench::new();
    let md3 = bench.add::<Md3>("md3");
    bench.run_until(2_500.millis());
    (bench, md3)
}

fn words(reply: &[u8]) -> Vec<u16> {
    let body = rtu::checked(reply).expect("a reply has a CRC that holds");
    assert_eq!(usize::from(body[2]), body.len() - 3);
    body[3..].chunks(2).map(|word| u16::from_be_bytes([word[0], word[1]])).collect()
}

fn read(bench: &mut Bench, seat: Seat, address: u16) -> u16 {
    words(&bench.ask(seat, &rtu::read(1, address, 1)))[0]
}

fn accepted(bench: &mut Bench, seat: Seat, address: u16, value: u16) -> bool {
    let request = rtu::write(1, address, value);
    let reply = bench.ask(seat, &request);
    let refusal: Frame = rtu::frame(1, &[0x86, 0x02]);
    assert!(reply == request[..] || reply == refusal[..], "{reply:02x?}");
    reply == request[..]
}

/// The table at the head of chapter 7; the serial number is the stand-in's.
const DEFAULTS: [u16; 32] = [
    0x0001, 0x030a, 0x0000, 0x0000, // DeviceAddress … StartupDelay
    0x0000, 0x0000, 0x0000, 0x0000, // HomingConfiguration … HomeOffsetHigh
    0x0000, 0x0000, 0x000f, 0x0000, // HomeOffsetLow … Reserved
    0x0005, 0x0f9f, 0x0000, 0x0000, // QuadratureEncoderConfiguration … EncoderIndexCountLow
    0x0000, 0x0000, 0x0000, 0x2710, // QuadratureEncoderCount … MoveStepsLow
    0x0000, 0x1388, 0x0000, 0x09c4, // SpeedHigh … AlternateSpeedLow
    0x0000, 0x2710, 0x9a00, 0xbd01, // AccelDecelHigh … ProductInformation
    0x0021, 0x0000, 0x0000, 0x0001, // SerialPortConfiguration … SerialNumberLow
];

#[test]
fn all_32_registers_in_one_read_have_their_initial_values() {
    let (mut bench, md3) = md3();
    assert_eq!(words(&bench.ask(md3, &rtu::read(1, 0x00, 32))), DEFAULTS);
}

#[test]
fn each_register_alone_has_its_initial_value() {
    let (mut bench, md3) = md3();
    for (address, default) in (0..).zip(DEFAULTS) {
        assert_eq!(read(&mut bench, md3, address), default, "register {address:#04x}");
    }
}

#[test]
fn all_registers_can_be_written_but_four() {
    for address in 0x00..0x20 {
        let (mut bench, md3) = md3();
        // 7.10 reserved, 7.21 product, 7.24 serial number.
        let read_only = [0x0b, 0x1b, 0x1e, 0x1f].contains(&address);
        assert_eq!(accepted(&mut bench, md3, address, 0x0001), !read_only, "register {address:#04x}");
        assert!(bench.ask(md3, &rtu::read(1, address, 1)).len() == 7);
    }
}

#[test]
fn values_that_can_be_kept_read_back_as_written() {
    let (mut bench, md3) = md3();
    // Not 0x00 (1 to 247), 0x0a (shows pins), 0x11 and 0x1a (commands), 0x1c (changes the line), and
    // the four that are read only.
    for address in (0x01..=0x09).chain(0x0c..=0x10).chain(0x12..=0x19).chain([0x1d]) {
        for value in [0xFFFF, 0x0000, 0xA5C3] {
            assert!(accepted(&mut bench, md3, address, value));
            assert_eq!(read(&mut bench, md3, address), value, "register {address:#04x}");
        }
    }
}

#[test]
fn section_7_1_the_address_is_1_to_247() {
    let (mut bench, md3) = md3();
    for (value, legal) in [(0, false), (248, false), (256, false), (0xFFFF, false), (1, true)] {
        assert_eq!(accepted(&mut bench, md3, 0x00, value), legal, "address {value}");
    }
    assert!(accepted(&mut bench, md3, 0x00, 247));
    assert!(bench.ask(md3, &rtu::read(1, 0x00, 1)).is_empty());
    assert_eq!(words(&bench.ask(md3, &rtu::read(247, 0x00, 1))), [247]);
}

#[test]
fn section_7_20_what_a_save_keeps() {
    let (mut bench, md3) = md3();
    let before: [(u16, u16); 26] = [
        (0x01, 0x0114),
        (0x02, 0x0a05),
        (0x03, 0x0001),
        (0x04, 0x00f0),
        (0x05, 0x1111),
        (0x06, 0x2222),
        (0x07, 0x3333),
        (0x08, 0x4444),
        (0x09, 0x0000),
        (0x0a, 0x008f),
        (0x0c, 0x0007),
        (0x0d, 0x0123),
        (0x0e, 0x0001),
        (0x0f, 0x0002),
        (0x10, 0x0003),
        (0x11, 0x0020),
        (0x12, 0x0001),
        (0x13, 0x0002),
        (0x14, 0x0000),
        (0x15, 0x0100),
        (0x16, 0x0000),
        (0x17, 0x0200),
        (0x18, 0x0000),
        (0x19, 0x0300),
        (0x1c, 0x0021),
        (0x1d, 0xbeef),
    ];
    for (address, value) in before {
        assert!(accepted(&mut bench, md3, address, value));
    }
    assert!(accepted(&mut bench, md3, 0x1a, 0x0001));
    bench.run_until(bench.now() + 20.millis());
    assert_eq!(read(&mut bench, md3, 0x1a), 0x0000);
    bench.power(md3, standin_sim::bench::PowerAction::Cycle);
    bench.run_until(bench.now() + 3.secs());
    for (address, value) in before {
        let counter = [0x0e, 0x0f, 0x10].contains(&address);
        let kept = if counter { 0 } else { value };
        assert_eq!(read(&mut bench, md3, address), kept, "register {address:#04x}");
    }
    assert_eq!(read(&mut bench, md3, 0x1a), 0x9a00);
}

/// Frames of chapter 6 and their parts: "0x0001 to read one register, 0x000a to read 10".
#[test]
fn section_6_1_read_holding_register() {
    let (mut bench, md3) = md3();
    let request = [0x01, 0x03, 0x00, 0x03, 0x00, 0x01, 0x74, 0x0A];
    assert_eq!(bench.ask(md3, &request), [0x01, 0x03, 0x02, 0x00, 0x00, 0xB8, 0x44]);
    let five = bench.ask(md3, &rtu::read(1, 0x0c, 5));
    assert_eq!((five[2], five.len()), (0x0a, 15));
    assert_eq!(bench.ask(md3, &rtu::frame(1, &[0x04, 0, 0, 0, 1])), rtu::frame(1, &[0x84, 0x01])[..]);
    assert_eq!(bench.ask(md3, &rtu::read(1, 0x20, 1)), rtu::frame(1, &[0x83, 0x02])[..]);
}

#[test]
fn section_6_2_write_single_register() {
    let (mut bench, md3) = md3();
    let request = [0x01, 0x06, 0x00, 0x03, 0x00, 0xFA, 0xF9, 0x89]; // StartupDelay 250
    assert_eq!(bench.ask(md3, &request), request);
    // "two commands in any order" for a 32-bit value
    assert!(accepted(&mut bench, md3, 0x13, 0x0064));
    assert!(accepted(&mut bench, md3, 0x12, 0x0000));
    assert_eq!(words(&bench.ask(md3, &rtu::read(1, 0x12, 2))), [0x0000, 0x0064]);
}
