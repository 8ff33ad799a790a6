//! The eight functions (RS434-1), and refused requests.

use drivetwin_firmware::device::Port;
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::Span;
use drivetwin_sim::bench::Bench;
use drivetwin_tests::rs434::{BOOT, Rig, SILENCE, at, make, request};

/// The bytes of a read of SPEED, 1,000. The CRCs are computed by hand from the polynomial in the
/// specification.
#[test]
fn section_6_a_frame() {
    let mut rig = Rig::default();
    let request = [0x01, 0x03, 0x50, 0x0B, 0x00, 0x01, 0xE4, 0xC8];
    let reply = [0x01, 0x03, 0x02, 0x03, 0xE8, 0xB8, 0xFA];
    assert_eq!(rig.bench.ask(rig.seat, &request), reply);
}

#[test]
fn section_6_blocks() {
    let mut rig = Rig::default();
    assert_eq!(rig.try_bits(2, 0x1000, 3), Ok(vec![false, false, true]));
    assert_eq!(rig.try_bits(1, 0x2000, 4), Ok(vec![false; 4]));
    for (function, first, count) in
        [(4, 0x3000, 10), (3, 0x5000, 0x27), (3, 0x6000, 6), (3, 0x7000, 11), (4, 0x8001, 4)]
    {
        let words = rig.try_words(function, first, count).expect("a block");
        for (address, word) in (first..).zip(words) {
            if address != at::TASK_COUNTER {
                assert_eq!(rig.read(address), word, "{address:04X}h");
            }
        }
        let over = rig.try_words(function, first, count + 1);
        assert_eq!(over, Err(2), "one register beyond {first:04X}h");
    }
    assert_eq!(rig.try_bits(2, 0x1000, 4), Err(2));
    assert_eq!(rig.try_bits(1, 0x2001, 4), Err(2));
}

#[test]
fn section_6_other_functions() {
    let mut rig = Rig::default();
    for function in (0..=0x7F_u8).filter(|function| ![1, 2, 3, 4, 5, 6, 15, 16].contains(function)) {
        let reply = rig.ask(&[function, 0x50, 0x0B, 0, 1]);
        assert_eq!(reply, [function | 0x80, 1], "function {function:02X}h");
    }
    assert_eq!(rig.read(at::ERROR), 0);
}

/// MODBUS-4: a drive checks the structure before the address. Limits (application 6): read 2,000 bits or 125
/// words, write 1,968 bits or 123 words, and FF00h or 0000h for a coil.
#[test]
fn section_6_structure() {
    let mut rig = Rig::default();
    for (function, most) in [(1, 2_000), (2, 2_000), (3, 125), (4, 125)] {
        for count in [0, most + 1, 0xFFFF] {
            assert_eq!(rig.ask(&request(function, 0, count)), [function | 0x80, 3], "{function}: {count}");
        }
        assert_eq!(rig.ask(&request(function, 0, most)), [function | 0x80, 2], "{function}");
    }
    assert_eq!(rig.ask(&request(5, 0x2000, 1)), [0x85, 3]);
    assert_eq!(rig.ask(&request(5, 0x2000, 0xFF01)), [0x85, 3]);
    assert_eq!(rig.ask(&[16, 0x50, 0x0B, 0, 1, 4, 1, 0, 1, 0]), [0x90, 3]);
    assert_eq!(rig.ask(&[16, 0x50, 0x0B, 0, 0, 0]), [0x90, 3]);
    assert_eq!(rig.ask(&[15, 0x20, 0x00, 0, 4, 2, 1, 0]), [0x8F, 3]);
    assert_eq!(rig.read(at::ERROR), 0, "bit 13 is for values of registers");
    assert_eq!((rig.read(at::SPEED), rig.read(at::STATUS)), (1_000, 0));
}

/// A write takes effect completely or not at all (MODBUS-4).
#[test]
fn section_6_all_or_nothing() {
    let mut rig = Rig::default();
    // SPEED, ACC, DEC: DEC is out of range.
    assert_eq!(rig.try_write_all(at::SPEED, &[500, 50, 9]), Err(3));
    assert_eq!(rig.try_words(3, at::SPEED, 3), Ok(vec![1_000, 100, 100]));
    assert_eq!(rig.read(at::ERROR), 0x2000);
    rig.write(at::ERROR, 0);
    // The block has FX and PC, and PC cannot be written.
    assert_eq!(rig.try_write_all(0x7005, &[1, 0, 3]), Err(2));
    assert_eq!(rig.try_words(3, 0x7005, 3), Ok(vec![0, 0, 0]));
    assert_eq!(rig.try_write_coils(at::CLR_POSITION, &[true, true]), Err(2));
    assert_eq!(rig.try_write_all(at::SPEED, &[500, 50, 60]), Ok(()));
    assert_eq!(rig.try_words(3, at::SPEED, 3), Ok(vec![500, 50, 60]));
    assert_eq!(rig.read(at::ERROR), 0);
}

/// MODBUS-4: a drive checks the address before the value. The block runs past 5026h and has a value out of
/// range, too.
#[test]
fn section_6_address_before_value() {
    let mut rig = Rig::default();
    let values = [0, 0, 0x1111, 0, 0];
    assert_eq!(rig.try_write_all(at::ERROR - 1, &values[..3]), Err(3));
    assert_eq!(rig.read(at::ERROR), 0x2000);
    rig.write(at::ERROR, 0);
    assert_eq!(rig.try_write_all(at::ERROR, &values), Err(2));
    assert_eq!(rig.read(at::ERROR), 0);
}

/// "After which the register is reset to 0": coils always read 0. Writing 0 has no effect.
#[test]
fn section_6_2_coils_read_0() {
    let mut rig = Rig::default();
    rig.write(at::START, 0);
    rig.after(1.secs());
    assert_eq!(rig.read(at::STATUS), 0);
    rig.write(at::START, 1);
    assert_eq!(rig.try_bits(1, at::START, 4), Ok(vec![false; 4]));
    rig.after(1.secs());
    assert_eq!((rig.read(at::STATUS), rig.read(at::START)), (1, 0));
    rig.write(at::STOP, 0);
    rig.write(at::HARD_STOP, 0);
    rig.after(1.secs());
    assert_eq!(rig.read(at::STATUS), 1);
}

/// RS434-6: of several coils HARD_STOP takes precedence, then STOP, then START. CLR_POSITION takes effect
/// with any of them.
#[test]
fn section_6_2_several_coils_at_once() {
    for (coils, status) in [
        ([true, false, false, false], 1),
        ([true, true, false, false], 0),
        ([true, false, true, false], 0),
        ([true, false, false, true], 1),
    ] {
        let mut rig = Rig::default();
        assert_eq!(rig.try_write_coils(at::START, &coils), Ok(()));
        rig.after(1.secs());
        assert_eq!(rig.read(at::STATUS), status, "{coils:?}");
    }
}

/// Section 6.4: "0 - broadcast address, no reply message". The drive executes a broadcast write. It ignores a
/// broadcast read, a foreign address and a bad CRC (MODBUS-3).
#[test]
fn section_6_4_broadcasts_and_others() {
    let mut rig = Rig::default();
    let silent = |rig: &mut Rig, frame: &[u8]| assert_eq!(rig.bench.ask(rig.seat, frame), SILENCE);
    silent(&mut rig, &rtu::write(0, at::SPEED, 500));
    assert_eq!(rig.read(at::SPEED), 500);
    silent(&mut rig, &rtu::read(0, at::SPEED, 1));
    silent(&mut rig, &rtu::write(2, at::SPEED, 600));
    silent(&mut rig, &rtu::write(0, at::SPEED, 1));
    // The bad broadcast write gets no reply, but it sets bit 13.
    assert_eq!((rig.read(at::SPEED), rig.read(at::ERROR)), (500, 0x2000));
    rig.write(at::ERROR, 0);
    let mut bad = rtu::write(1, at::SPEED, 700).to_vec();
    bad[7] ^= 1;
    silent(&mut rig, &bad);
    assert_eq!((rig.read(at::SPEED), rig.read(at::ERROR)), (500, 0), "RS434-5: a bad CRC sets nothing");
}

/// Both models on one line, with the addresses 1 and 2.
#[test]
fn section_6_4_several_drives() {
    let mut bench = Bench::new();
    let drives = ["rs434544", "rs434546"].map(|kind| {
        bench.add_with(kind, make(kind), Default::default()).expect("a drive that can be seated")
    });
    let [one, two] = drives;
    bench.run_until(BOOT + 1.millis());
    for frame in [rtu::write(1, at::SLAVE_ADDRESS, 2), rtu::write(1, at::SAVE_INI, 0x37FA)] {
        assert_eq!(bench.ask(two, &frame), frame[..]);
        bench.run_until(bench.now() + 20.millis());
    }
    // The new address is valid after a restart (6.4).
    let restart = rtu::write(1, at::RESTART, 0x95AF);
    assert_eq!(bench.ask(two, &restart), restart[..]);
    bench.run_until(bench.now() + BOOT + 10.millis());
    bench.share("line", &[(one, Port(0)), (two, Port(0))]);
    for (unit, current) in [(1, 20_000_u16), (2, 40_000), (2, 40_000), (1, 20_000)] {
        let [high, low] = current.to_be_bytes();
        let reply = bench.ask(one, &rtu::read(unit, at::REF_CURRENT, 1));
        assert_eq!(reply, rtu::frame(unit, &[3, 2, high, low])[..]);
    }
    assert_eq!(bench.ask(one, &rtu::read(3, at::SPEED, 1)), SILENCE);
}
