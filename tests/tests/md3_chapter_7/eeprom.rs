//! Sections 7.20 to 7.24: EEPROM, product, serial port, user register, serial number.

use drivetwin_firmware::device::{Line, Port};
use drivetwin_protocol::line::Parity;
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::{Duration, Span};
use drivetwin_sim::bench::{Bench, DriveId, PowerAction, Setup};
use drivetwin_sim::line::Sender;

use crate::rig::{GREEN, RED, Rig, at, bit, words};

/// Registers with values that differ from those of a new drive. They cause no motion and change neither the
/// line nor the address. A save does not store the counters.
const OTHERS: [(u16, u16); 26] = [
    (0x01, 0x0114),
    (0x02, 0x0a05),
    (0x03, 0x0001),
    (0x04, 0x00f0),
    (0x05, 0x1111),
    (0x06, 0x2222),
    (0x07, 0x3333),
    (0x08, 0x4444),
    (0x09, 0x00f0),
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

/// True for 0x0e to 0x10, the counters, which are not saved (MD3-12).
fn is_counter(address: u16) -> bool {
    (0x0e..=0x10).contains(&address)
}

#[test]
fn section_7_20_what_a_save_keeps() {
    let mut rig = Rig::restarted(&OTHERS);
    rig.after(2_511.millis()); // 2.5 s and StartupDelay 1
    for (address, value) in OTHERS {
        let kept = if is_counter(address) { 0 } else { value };
        assert_eq!(rig.read(address), kept, "register {address:#04x}");
    }
    assert_eq!(rig.read(at::EEPROM), 0x9a00); // after power-up
}

#[test]
fn section_7_20_what_was_not_saved_is_forgotten() {
    let mut rig = Rig::ready();
    rig.write(at::USER, 7);
    rig.power_cycle();
    rig.after(2_501.millis());
    assert_eq!(rig.read(at::USER), 0);
}

/// MD3-12: a save takes 20 ms, during which bit 0 reads 1; then the register reads 0x0000. The drive may
/// answer commands during the save.
#[test]
fn section_7_20_a_save_takes_its_time() {
    let mut rig = Rig::ready();
    assert_eq!(rig.read(at::EEPROM), 0x9a00);
    rig.write(at::EEPROM, 1);
    rig.after(20.millis() - Duration::TICK * 8);
    assert_eq!(rig.read(at::EEPROM) & 1, 1);
    rig.write(at::USER, 5);
    rig.after(Duration::TICK * 8);
    assert_eq!(rig.read(at::EEPROM), 0x0000);
}

/// A save stores the values that the registers had when the save began.
#[test]
fn section_7_20_a_write_during_a_save_comes_too_late() {
    let mut rig = Rig::ready();
    rig.write(at::USER, 1);
    rig.write(at::EEPROM, 1);
    rig.write(at::USER, 2);
    rig.after(20.millis());
    rig.write(at::EEPROM, 2);
    assert_eq!(rig.read(at::USER), 1);
}

/// MD3-12: a second save during a save is ignored; the first one still ends after 20 ms.
#[test]
fn section_7_20_a_save_while_one_runs() {
    let mut rig = Rig::ready();
    rig.write(at::EEPROM, 1);
    rig.after(10.millis());
    rig.write(at::USER, 9);
    rig.write(at::EEPROM, 1);
    rig.after(11.millis());
    assert_eq!(rig.read(at::EEPROM), 0);
    rig.after(20.millis());
    rig.write(at::EEPROM, 2);
    assert_eq!(rig.read(at::USER), 0);
}

/// MD3-12: a read from the EEPROM restores the saved values at once and sets the CRC status to 0x9a. Writes
/// cannot change the CRC status.
#[test]
fn section_7_20_read_registers_from_eeprom() {
    let mut rig = Rig::ready();
    rig.write(at::USER, 0x1111);
    rig.save();
    rig.write(at::USER, 0x2222);
    rig.write(at::EEPROM, 0x7700); // no bit is set: nothing happens, and the CRC status stays
    assert_eq!((rig.read(at::EEPROM), rig.read(at::USER)), (0x0000, 0x2222));
    rig.write(at::EEPROM, 2);
    assert_eq!((rig.read(at::EEPROM), rig.read(at::USER)), (0x9a00, 0x1111));
}

/// MD3-12: a read from the EEPROM acts as if a master had written all registers: current, pins, Disable,
/// address, line. The reply still comes from the old address (MODBUS-5).
#[test]
fn section_7_20_a_read_acts() {
    let mut rig = Rig::ready();
    rig.write(at::CURRENT_AND_MICROSTEPPING, 0x0314);
    rig.write(at::IO_PORT, 0x80);
    rig.write(at::SERIAL_PORT, 0x22);
    rig.write(at::DEVICE_ADDRESS, 7);
    let written = rtu::write(7, at::EEPROM, 1);
    assert_eq!(rig.ask(&written), written[..]);
    rig.after(20.millis());
    for (address, value) in
        [(at::CURRENT_AND_MICROSTEPPING, 0x030a), (at::IO_PORT, 0), (at::SERIAL_PORT, 0x21)]
    {
        rig.ask(&rtu::write(7, address, value));
    }
    rig.ask(&rtu::write(7, at::DEVICE_ADDRESS, 1));
    assert_eq!(rig.current(), 1_000);
    let request = rtu::write(1, at::EEPROM, 2);
    assert_eq!(rig.ask(&request), request[..]);
    assert_eq!(words(&rig.ask(&rtu::read(7, at::DEVICE_ADDRESS, 1))), [7]);
    assert_eq!(rig.current(), 2_000);
    assert_eq!(rig.level("J3.8"), drivetwin_firmware::device::Level::Low);
    rig.after(20.millis()); // by then the last reply has been sent
    let bus = rig.bench.bus(rig.seat, Port(0)).expect("a line");
    assert_eq!(rig.bench.line(bus), Line::new(19_200, 8, Parity::Even, 1));
}

/// MD3-12: a read restores pin functions as well. They were saved with pin 4 open, so the motor was at rest.
/// The read with pin 4 low starts a jog.
#[test]
fn section_7_20_a_read_changes_pin_modes() {
    let mut rig = Rig::ready();
    rig.write(at::PINS, 0b0110 << 4);
    rig.save();
    rig.write(at::PINS, 0b1111 << 4);
    rig.low("J2.4");
    rig.write(at::EEPROM, 2);
    assert_eq!(rig.motion_control(), bit::JOG);
    rig.after(1.secs());
    rig.assert_on_its_way(3_750, 5_000.0);
}

/// MD3-12: a read restores Disable, set or cleared, during any motion.
#[test]
fn section_7_20_a_read_disables_and_enables() {
    let mut rig = Rig::ready();
    rig.command(bit::DISABLE);
    rig.save();
    rig.command(bit::JOG);
    rig.after(1.secs());
    rig.write(at::EEPROM, 2);
    assert_eq!((rig.motion_control(), rig.current(), rig.speed()), (bit::DISABLE, 0, 0.0));
    let mut rig = Rig::ready();
    rig.save();
    rig.command(bit::DISABLE);
    rig.write(at::EEPROM, 2);
    assert_eq!((rig.motion_control(), rig.current()), (0, 1_000));
}

/// MD3-12: a read in a motion acts like writes: the acceleration stops a move (7.17), the speed changes a
/// jog.
#[test]
fn section_7_20_a_read_in_a_motion() {
    let mut rig = Rig::ready();
    rig.save();
    rig.command(bit::MOVE);
    rig.after(1.secs());
    rig.write(at::EEPROM, 2);
    assert_eq!((rig.motion_control(), rig.speed()), (0, 0.0));
    rig.write(at::SPEED + 1, 1_000);
    rig.command(bit::JOG);
    rig.after(1.secs());
    assert_eq!(rig.speed(), 1_000.0);
    rig.write(at::EEPROM, 2);
    rig.after(1.secs());
    assert_eq!((rig.speed(), rig.motion_control()), (5_000.0, bit::JOG));
}

/// MD3-12: bits 0 and 1 together mean a save.
#[test]
fn section_7_20_both_bits_save() {
    let mut rig = Rig::ready();
    rig.write(at::USER, 3);
    rig.write(at::EEPROM, 3);
    rig.after(20.millis());
    assert_eq!((rig.read(at::EEPROM), rig.read(at::USER)), (0, 3));
    rig.write(at::USER, 4);
    rig.write(at::EEPROM, 2);
    assert_eq!(rig.read(at::USER), 3);
}

/// MD3-12: Disable is saved, so the motor has no current after power-up.
#[test]
fn section_7_20_disable_is_saved() {
    let mut rig = Rig::restarted(&[(at::MOTION, bit::DISABLE)]);
    rig.after(3.secs());
    assert_eq!((rig.motion_control(), rig.current()), (bit::DISABLE, 0));
    // Only Disable of 0x11 is saved.
    let mut rig = Rig::restarted(&[(at::MOTION, bit::JOG)]);
    rig.after(3.secs());
    assert_eq!((rig.motion_control(), rig.position()), (0, 0));
}

/// A drive that lost power during its first save and was then powered on again.
fn with_bad_memory() -> Rig {
    let mut rig = Rig::ready();
    rig.write(at::USER, 0x55aa);
    rig.write(at::EEPROM, 1);
    rig.after(10.millis());
    rig.bench.power(rig.seat, PowerAction::Off);
    rig.after(1.secs());
    rig.bench.power(rig.seat, PowerAction::On);
    rig.after(Duration::TICK);
    rig
}

/// MD3-12: if power is lost during a save, the memory is bad. The status is 0xf1, and the drive uses the
/// defaults without saving them.
#[test]
fn section_7_20_bad_memory() {
    let mut rig = with_bad_memory();
    let memory = rig.bench.memory(rig.seat).to_vec();
    rig.after(7_501.millis());
    assert_eq!((rig.read(at::EEPROM), rig.read(at::USER)), (0xf100, 0));
    assert_eq!(rig.bench.memory(rig.seat), memory);
    // A read from bad memory changes only the status.
    rig.write(at::USER, 1);
    rig.write(at::EEPROM, 2);
    assert_eq!((rig.read(at::EEPROM), rig.read(at::USER)), (0xf100, 1));
    // "<bit0> has to be used to update the EEPROM."
    rig.save();
    rig.power_cycle();
    rig.after(2_501.millis());
    assert_eq!((rig.read(at::EEPROM), rig.read(at::USER)), (0x9a00, 1));
}

/// MD3-13: red flashes ten times in five seconds, then the 2.5 s follow; the first reply comes after 7.5 s.
#[test]
fn section_7_20_bad_memory_at_power_up() {
    let mut rig = with_bad_memory();
    let (mut flashes, mut before) = (0, false);
    for _ in 0..499 {
        rig.after(10.millis());
        flashes += u32::from(rig.lit(RED) && !before);
        before = rig.lit(RED);
        assert!(!rig.lit(GREEN));
    }
    assert_eq!(flashes, 10);
    rig.after(10.millis());
    rig.after(2_499.millis());
    assert!(rig.ask(&rtu::read(1, 0, 1)).is_empty());
    rig.after(2.millis());
    assert_eq!(rig.read(at::USER), 0);
}

/// A second power-up loads the same bad content.
#[test]
fn section_7_20_bad_memory_stays_bad() {
    let mut rig = with_bad_memory();
    rig.after(8.secs());
    rig.power_cycle();
    rig.after(7_499.millis());
    assert!(rig.ask(&rtu::read(1, 0, 1)).is_empty());
    rig.after(2.millis());
    assert_eq!(rig.read(at::EEPROM), 0xf100);
}

/// A change of any byte of the memory makes the memory bad.
#[test]
fn section_7_20_the_crc_covers_every_byte() {
    let mut rig = Rig::ready();
    rig.save();
    let memory = rig.bench.memory(rig.seat).to_vec();
    for place in 0..memory.len() {
        let mut memory = memory.clone();
        memory[place] ^= 0x10;
        let mut rig = Rig::new("md3", Setup { memory: Some(memory), boot_fast: true, ..Setup::default() });
        assert_eq!(rig.read(at::EEPROM), 0xf100, "byte {place}");
    }
}

/// A drive with an empty memory is a new drive (PROJECT-5).
#[test]
fn section_7_20_a_new_drive() {
    let mut rig = Rig::new("md3", Setup { memory: Some(Vec::new()), ..Setup::default() });
    rig.after(2_501.millis());
    assert_eq!(rig.read(at::EEPROM), 0x9a00);
}

/// MD3-16: the product register depends on the version and cannot be written.
#[test]
fn section_7_21_product_information() {
    for (kind, product) in [("md3", 0xbd01), ("md3-low", 0x3d01)] {
        let mut rig = Rig::ready_kind(kind);
        assert_eq!(rig.read(at::PRODUCT), product);
        for value in [0, product, 0xFFFF] {
            assert!(!rig.accepts(at::PRODUCT, value));
        }
        assert_eq!(rig.read(at::PRODUCT), product);
    }
}

/// An MD3 on a line with real character times.
fn timed() -> (Bench, DriveId) {
    let mut bench = Bench::new();
    let seat = bench.add::<drivetwin_firmware::md3::Md3>("x");
    bench.run_until(3.secs());
    (bench, seat)
}

/// Writes `value` to 0x1c and returns the line settings after the reply.
fn line_after(value: u16) -> (Bench, DriveId, Line) {
    let (mut bench, seat) = timed();
    let request = rtu::write(1, at::SERIAL_PORT, value);
    assert_eq!(bench.ask(seat, &request), request[..], "the reply leaves with the old line");
    let line = bench.line(bench.bus(seat, Port(0)).expect("a line"));
    (bench, seat, line)
}

/// MD3-9: parity and stop bits are independent; parity code 3 means none. Unused bits are kept (MD3-2).
#[test]
fn section_7_22_serial_port_configuration() {
    let bauds = [4_800, 9_600, 19_200, 38_400, 57_600, 115_200, 230_400, 460_800];
    let parities = [Parity::None, Parity::Odd, Parity::Even, Parity::None];
    for (code, baud) in (0..).zip(bauds) {
        for (parity_code, parity) in (0..).zip(parities) {
            for stop in [0, 1] {
                let value = 0xFFC0 | parity_code << 4 | stop << 3 | code;
                let (mut bench, seat, line) = line_after(value);
                assert_eq!(line, Line::new(baud, 8, parity, stop as u8 + 1));
                assert_eq!(words(&bench.ask(seat, &rtu::read(1, at::SERIAL_PORT, 1))), [value]);
            }
        }
    }
}

/// A character has 1 + 8 + parity + stop bits: 8N1 10, 8E1 11, 8E2 and 8O2 12 bits. A request has 8
/// characters and a reply 7, with the drive's silences between them.
#[test]
fn section_7_22_characters_last_as_long_as_their_bits() {
    for (value, bits) in [(0x01, 10_u64), (0x21, 11), (0x29, 12), (0x19, 12), (0x09, 11)] {
        let (mut bench, seat, line) = line_after(value);
        bench.run_until(bench.now() + 1.secs());
        let start = bench.now();
        bench.ask(seat, &rtu::read(1, at::USER, 1));
        let took = bench.now().since(start);
        let character = (bits * 16_000_000 + 4_800) / 9_600;
        assert_eq!(line.character().ticks(), character);
        // 8 characters of request, 3.5 of silence and 1 to detect it, 7 of reply.
        let expected = Duration::from_ticks(character * 8 + character * 9 / 2 + character * 7);
        assert!(took >= expected && took <= expected + 2.millis(), "{value:#04x}: {took:?}");
    }
}

/// Requests of a master with other settings are not received.
#[test]
fn section_7_22_frames_with_other_settings_are_not_received() {
    let (mut bench, seat, _) = line_after(0x25); // 115,200 8E1
    let bus = bench.bus(seat, Port(0)).expect("a line");
    let client = bench.connect(bus);
    let mut reply = Vec::new();
    for (baud, answers) in [(9_600, false), (115_200, true)] {
        let sender = Sender { baud: Some(baud), ..Sender::default() };
        bench.send_from(client, &rtu::read(1, at::USER, 1), sender);
        bench.run_until(bench.now() + 1.secs());
        assert_eq!(bench.receive(client, &mut reply) > 0, answers, "{baud}");
    }
}

/// MODBUS-3 and MODBUS-5: all drives execute a broadcast of 0x1c, and it applies from the next frame.
#[test]
fn section_7_22_broadcast() {
    let (mut bench, seat) = timed();
    assert!(bench.ask(seat, &rtu::write(0, at::SERIAL_PORT, 0x25)).is_empty());
    let bus = bench.bus(seat, Port(0)).expect("a line");
    assert_eq!(bench.line(bus), Line::new(115_200, 8, Parity::Even, 1));
    assert_eq!(words(&bench.ask(seat, &rtu::read(1, at::SERIAL_PORT, 1))), [0x25]);
}

#[test]
fn section_7_23_user_register() {
    let mut rig = Rig::ready();
    for value in [0, 1, 0x8000, 0xFFFF] {
        rig.write(at::USER, value);
        assert_eq!(rig.read(at::USER), value);
    }
}

/// MD3-16: the serial number comes from a preset, else it is 1. It is read-only.
#[test]
fn section_7_24_serial_number() {
    let mut rig = Rig::ready();
    assert_eq!(rig.read_long(at::SERIAL_NUMBER), 1);
    for address in [at::SERIAL_NUMBER, at::SERIAL_NUMBER + 1] {
        assert!(!rig.accepts(address, 5));
    }
    let row = rig.bench.spec(rig.seat).registers.find("SerialNumber").expect("a row").row;
    let mut rig = Rig::new("md3", Setup { presets: vec![(row, 0x0012_3456)], ..Setup::default() });
    rig.after(2_501.millis());
    assert_eq!(rig.words(at::SERIAL_NUMBER, 2), [0x0012, 0x3456]);
    rig.save();
    rig.power_cycle();
    rig.after(2_501.millis());
    assert_eq!(rig.words(at::SERIAL_NUMBER, 2), [0x0012, 0x3456]);
}
