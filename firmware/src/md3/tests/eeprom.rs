//! Saves and loads (7.20).

use super::*;

#[test]
fn a_save_takes_20_ms_and_shows_it() {
    let mut dut = ready();
    dut.write(0x1d, 0xBEEF);
    let before = dut.out.memory.clone();
    let end = dut.hear(&rtu::write(1, 0x1a, 1));
    let begun = end + JUDGEMENT;
    dut.run_until(begun);
    assert_ne!(dut.out.memory, before);
    assert_eq!(dut.drive.peek(dut.now, Reg::EEPROMControl.row()), 0x9a01);
    dut.run_until(begun + 20.millis() - Duration::TICK);
    assert_eq!(dut.out.stores.len(), 1);
    dut.run_until(begun + 20.millis());
    assert_eq!(dut.out.stores.len(), 2);
    assert_eq!(dut.drive.peek(dut.now, Reg::EEPROMControl.row()), 0x0000);
}

#[test]
fn power_lost_anywhere_in_a_save_leaves_the_old_the_new_or_a_bad_memory() {
    let mut dut = ready();
    dut.write(0x1d, 0x1111);
    dut.write(0x1a, 1);
    dut.run_until(dut.now + 20.millis());
    let old = dut.out.memory.clone();
    dut.write(0x1d, 0x2222);
    dut.out.stores.clear();
    dut.write(0x1a, 1);
    dut.run_until(dut.now + 20.millis());
    let stores: Vec<_> = dut.out.stores.clone();
    let total: usize = stores.iter().map(|(_, _, bytes)| bytes.len()).sum();
    let mut seen = [0; 3];
    for cut in 0..=total {
        let mut memory = old.clone();
        let bytes = stores.iter().flat_map(|(_, offset, bytes)| {
            bytes.iter().enumerate().map(move |(n, byte)| (usize::from(*offset) + n, *byte))
        });
        for (place, byte) in bytes.take(cut) {
            memory[place] = byte;
        }
        let mut dut = off(memory);
        dut.power_on(Boot { fast: true, ..Boot::default() });
        match (dut.read(0x1a), dut.read(0x1d)) {
            (0x9a00, 0x1111) => seen[0] += 1,
            (0xf100, 0x0000) => seen[1] += 1,
            (0x9a00, 0x2222) => seen[2] += 1,
            other => panic!("{other:x?} after {cut} bytes"),
        }
    }
    // The memory is the old one until a changed byte is written, and the new one only after the last byte.
    assert!(seen[0] > 1 && seen[1] > 1 && seen[2] == 1, "{seen:?}");
}

#[test]
fn a_read_brings_the_saved_registers_back() {
    let mut dut = ready();
    dut.write(0x1d, 0x1111);
    dut.write(0x1a, 1);
    dut.run_until(dut.now + 20.millis());
    assert_eq!(dut.read(0x1a), 0x0000);
    dut.write(0x1d, 0x2222);
    dut.write(0x00, 9);
    let frame = rtu::write(9, 0x1a, 2);
    assert_eq!(dut.ask(&frame), frame, "the reply has the old address");
    assert_eq!(dut.read(0x1d), 0x1111);
    assert_eq!(dut.read(0x1a), 0x9a00);
    dut.out.memory[5] ^= 0xFF;
    dut.write(0x1d, 0x3333);
    dut.write(0x1a, 2);
    assert_eq!((dut.read(0x1a), dut.read(0x1d)), (0xf100, 0x3333));
}

#[test]
fn not_saved_are_counters_and_motion() {
    let mut dut = ready();
    for (address, value) in [(0x0e, 1), (0x0f, 2), (0x10, 3), (0x11, 0x21), (0x0a, 0x80), (0x0c, 0xFFFF)] {
        dut.write(address, value);
    }
    dut.write(0x1a, 1);
    dut.run_until(dut.now + 20.millis());
    let mut dut = off(dut.out.memory);
    dut.power_on(Boot { fast: true, ..Boot::default() });
    for (address, value) in [(0x0e, 0), (0x0f, 0), (0x10, 0), (0x11, 0x20), (0x0a, 0x8f), (0x0c, 0xFFFF)] {
        assert_eq!(dut.read(address), value, "register {address:#04x}");
    }
    assert_eq!(dut.level("J3.8"), Level::Low);
    assert_eq!(dut.out.currents, [(Instant::ZERO, AXIS, 0)], "still disabled");
}

#[test]
fn presets_before_power_are_as_if_saved() {
    let mut dut = off(vec![0xFF; MEMORY]);
    let mut poke = |reg: Reg, value| dut.try_set(reg, value);
    assert_eq!(poke(Reg::DeviceAddress, 12), Ok(()));
    assert_eq!(poke(Reg::SerialNumber, 123_456), Ok(()));
    assert_eq!(poke(Reg::DeviceAddress, 248), Err(PresetError::OutOfRange));
    assert_eq!(poke(Reg::ProductInformation, 0), Err(PresetError::OutOfRange));
    assert_eq!(poke(Reg::ProductInformation, 0xbd02), Err(PresetError::ReadOnly), "it is not in the EEPROM");
    dut.power_on(Boot { fast: true, ..Boot::default() });
    let reply = dut.ask(&rtu::read(12, 0x1e, 2));
    assert_eq!(reply, rtu::frame(12, &[3, 4, 0x00, 0x01, 0xE2, 0x40]));
    let mut dut = off(vec![0; MEMORY]);
    let refused = dut.try_set(Reg::DeviceAddress, 12);
    assert_eq!(refused, Err(PresetError::BadMemory));
}

#[test]
fn a_read_while_a_save_runs_is_ignored() {
    let mut dut = ready();
    dut.preset(Reg::EEPROMControl, 1);
    dut.wait(1.millis());
    dut.preset(Reg::EEPROMControl, 2);
    assert_eq!(dut.get(Reg::EEPROMControl), 0x9a01);
    dut.wait(20.millis());
    assert_eq!(dut.get(Reg::EEPROMControl), 0x0000);
}
