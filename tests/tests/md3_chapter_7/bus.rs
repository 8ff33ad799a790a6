//! Sections 5 and 6: the serial line, and the two functions.

use drivetwin_firmware::device::{Axis, Line, Port};
use drivetwin_firmware::md3::Md3;
use drivetwin_protocol::line::Parity;
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::Span;
use drivetwin_sim::bench::Bench;

use crate::rig::{Rig, at, bit, words};

/// The default parameters (5.1).
#[test]
fn section_5_1_default_line() {
    let rig = Rig::ready();
    let bus = rig.bench.bus(rig.seat, Port(0)).expect("a line");
    assert_eq!(rig.bench.line(bus), Line::new(9_600, 8, Parity::Even, 1));
}

/// Two drives on one line, with addresses 1 and 2. "All MD3 units on the bus will perform the register write
/// command, but no reply is sent". A broadcast read does nothing. A drive ignores replies of the other drive.
#[test]
fn section_5_1_several_drives() {
    let mut bench = Bench::new();
    let drives = ["one", "two"].map(|name| bench.add::<Md3>(name));
    let [one, two] = drives;
    bench.run_until(3.secs());
    bench.ask(two, &rtu::write(1, at::DEVICE_ADDRESS, 2));
    bench.share("line", &[(one, Port(0)), (two, Port(0))]);
    assert!(bench.ask(one, &rtu::write(0, at::USER, 0x55)).is_empty());
    assert!(bench.ask(one, &rtu::read(0, at::USER, 1)).is_empty());
    for unit in [1, 2, 1, 2, 2, 1] {
        assert_eq!(words(&bench.ask(one, &rtu::read(unit, at::USER, 1))), [0x55]);
        assert_eq!(words(&bench.ask(one, &rtu::read(unit, at::DEVICE_ADDRESS, 1))), [u16::from(unit)]);
    }
    // A write to one of the drives leaves the other unchanged.
    bench.ask(one, &rtu::write(2, at::USER, 0x66));
    assert_eq!(words(&bench.ask(one, &rtu::read(1, at::USER, 1))), [0x55]);
    assert_eq!(words(&bench.ask(one, &rtu::read(2, at::USER, 1))), [0x66]);
    assert!(bench.ask(one, &rtu::read(3, at::USER, 1)).is_empty());
}

/// A broadcast starts the moves of all drives at the same instant.
#[test]
fn section_5_1_a_broadcast_move() {
    let mut bench = Bench::new();
    let drives = ["one", "two"].map(|name| bench.add::<Md3>(name));
    bench.share("line", &drives.map(|drive| (drive, Port(0))));
    bench.run_until(3.secs());
    assert!(bench.ask(drives[0], &rtu::write(0, at::MOTION, bit::MOVE)).is_empty());
    bench.run_until(bench.now() + 1.secs());
    let motions = drives.map(|drive| bench.motion(drive, Axis(0)));
    assert_eq!(motions[0], motions[1]);
    assert!(motions[0].moving && motions[0].position > 3_000);
    bench.run_until(bench.now() + 2.secs());
    assert_eq!(drives.map(|drive| bench.motion(drive, Axis(0)).position), [10_000, 10_000]);
}

/// Request and reply with their CRC: reads StartupDelay of address 1, "0x0003 is sent 0x00 first".
#[test]
fn section_6_1_read_holding_register() {
    let mut rig = Rig::ready();
    let request = [0x01, 0x03, 0x00, 0x03, 0x00, 0x01, 0x74, 0x0A];
    assert_eq!(rig.ask(&request), [0x01, 0x03, 0x02, 0x00, 0x00, 0xB8, 0x44]);
    // Byte count "0x0a if 5 registers are read".
    let five = rig.ask(&rtu::read(1, 0x0c, 5));
    assert_eq!((five[2], five.len()), (0x0a, 15));
}

/// MD3-1: a quantity of 0, over 32, or past 0x1f gives exception 02; the reply has the function with its high
/// bit set.
#[test]
fn section_6_1_what_cannot_be_read() {
    let mut rig = Rig::ready();
    let refused = [0x01, 0x83, 0x02, 0xC0, 0xF1];
    assert_eq!(rtu::frame(1, &[0x83, 0x02])[..], refused);
    for (first, count) in [(0, 0), (0, 33), (0x20, 1), (0x1f, 2), (0x10, 17), (0xFFFF, 1), (0xFFFF, 2)] {
        assert_eq!(rig.ask(&rtu::read(1, first, count)), refused, "{count} from {first:#06x}");
    }
    for (first, count) in [(0, 32), (0x1f, 1), (0x10, 16)] {
        assert_eq!(rig.words(first, count).len(), usize::from(count));
    }
}

/// "If the CRC of the command is invalid, no action is taken." The next good frame is answered.
#[test]
fn section_6_2_a_bad_crc() {
    let mut rig = Rig::ready();
    let mut request = rtu::write(1, at::USER, 7);
    if let Some(last) = request.last_mut() {
        *last ^= 1;
    }
    assert!(rig.ask(&request).is_empty());
    assert_eq!(rig.read(at::USER), 0);
}

#[test]
fn section_6_2_write_single_register() {
    let mut rig = Rig::ready();
    let request = [0x01, 0x06, 0x00, 0x03, 0x00, 0xFA, 0xF9, 0x89]; // StartupDelay 250
    assert_eq!(rig.ask(&request), request);
    assert_eq!(rig.read(at::STARTUP_DELAY), 250);
}

/// MD3-1: writes to read-only and missing registers give exception 02.
#[test]
fn section_6_2_what_cannot_be_written() {
    let mut rig = Rig::ready();
    for address in [0x0b, 0x1b, 0x1e, 0x1f, 0x20, 0x1234, 0xFFFF] {
        assert!(!rig.accepts(address, 1), "{address:#06x}");
    }
    assert_eq!(rtu::frame(1, &[0x86, 0x02])[..], [0x01, 0x86, 0x02, 0xC3, 0xA1]);
}

/// MD3-1 and MODBUS-2: every other function gives exception 01. This includes the functions of modern Modbus
/// and those that a reset or a firmware update might use.
#[test]
fn section_6_other_functions() {
    let mut rig = Rig::ready();
    for function in (1..=0x7f).filter(|function| ![3, 6].contains(function)) {
        let reply = rig.ask(&rtu::frame(1, &[function, 0, 0, 0, 1]));
        assert_eq!(reply, rtu::frame(1, &[function | 0x80, 0x01])[..], "function {function:#04x}");
    }
    let write_registers = [0x10, 0, 0x12, 0, 2, 4, 0, 0, 0, 1];
    assert_eq!(rig.ask(&rtu::frame(1, &write_registers)), rtu::frame(1, &[0x90, 0x01])[..]);
    assert_eq!(rig.read_long(at::MOVE_STEPS), 10_000);
}
