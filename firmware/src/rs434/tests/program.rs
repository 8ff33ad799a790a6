//! Tests of the user program in the drive (6.5, 6.6, 6.9).

use super::*;

/// A line: code, bTypeJmp, system register, space, data (Fig. 9).
fn line(code: u32, relative: u32, register: u32, space: u32, data: u16) -> u32 {
    code | relative << 7 | register << 8 | space << 12 | u32::from(data) << 16
}

const END: u32 = 0x00;
const FULL_END: u32 = 0x0D;
const HOLDING: u32 = 3;
const COIL: u32 = 1;

/// A line that sets a system register (0 is AX) to a constant.
fn set(register: u32, constant: u16) -> u32 {
    line(0x01, 0, register, 0, constant)
}

/// A line that copies a system register (0 is AX) to a register of the bus.
fn put(space: u32, address: u16, register: u32) -> u32 {
    line(0x02, 0, register, space, address)
}

fn delay(ms: u16) -> u32 {
    line(0x04, 0, 0, 0, ms)
}

/// A line that jumps to itself forever.
const STAY: u32 = 0x05 | 1 << 7;

impl Fixture<DriveWithMotor<Rs434>> {
    /// Writes a program over the bus and saves it.
    fn load(&mut self, lines: &[u32]) {
        for (n, line) in (0..).zip(lines) {
            let reply = self.try_write_all(0x6000, &[n, *line as u16, (*line >> 16) as u16]);
            assert_eq!(reply[0], 16);
        }
        self.write(0x5025, 0x8426);
        self.wait(10.millis());
    }

    fn start(&mut self) {
        self.set(Reg::MODE_USER_PROGRAM, 2);
    }

    fn status(&self) -> i64 {
        self.get(Reg::STATUS_USER_PROGRAM)
    }
}

#[test]
fn it_starts_runs_and_ends() {
    let mut dut = ready();
    dut.load(&[set(0, 7), put(HOLDING, 0x500B, 0), set(0, 3_000), put(HOLDING, 0x500B, 0), END]);
    assert_eq!(dut.status(), 1);
    dut.start();
    let start = dut.now;
    dut.run_until(start + 100.micros() - Duration::TICK);
    assert_eq!((dut.status(), dut.get(Reg::PC_REG), dut.get(Reg::AX_REG)), (2, 0, 0));
    dut.run_until(start + 100.micros());
    assert_eq!((dut.status(), dut.get(Reg::PC_REG), dut.get(Reg::AX_REG)), (4, 0, 7));
    dut.run_until(start + 200.micros());
    // 7 rpm is out of range. This is a warning, and the program continues.
    assert_eq!((dut.status(), dut.get(Reg::ERROR), dut.get(Reg::SPEED)), (4, 1 << 13, 1_000));
    dut.run_until(start + 400.micros());
    assert_eq!((dut.get(Reg::SPEED), dut.get(Reg::PC_REG), dut.status()), (3_000, 3, 4));
    dut.run_until(start + 500.micros());
    assert_eq!((dut.get(Reg::PC_REG), dut.status(), dut.get(Reg::SPEED)), (4, 5, 3_000));
    assert_eq!(dut.read(0x5005), 2, "what was last written");
}

#[test]
fn a_full_stop_brings_the_registers_back() {
    let mut dut = ready();
    dut.load(&[set(0, 3_000), put(HOLDING, 0x500B, 0), put(HOLDING, 0x6001, 0), delay(10), FULL_END]);
    dut.set(Reg::AX_REG, 5);
    dut.set(Reg::TARGET_POSITION4, 44);
    dut.start();
    dut.wait(5.millis());
    assert_eq!((dut.get(Reg::SPEED), dut.get(Reg::AX_REG)), (3_000, 3_000));
    // A value that the master writes during the program is restored, too. The bus settings, ERROR and the
    // buffer are not restored.
    dut.set(Reg::TARGET_POSITION4, 45);
    dut.set(Reg::TIMEOUT_BROADCAST_MODBUS, 6);
    assert_eq!(dut.try_set(Reg::SPEED, 1), Err(PresetError::OutOfRange));
    dut.try_write(0x500B, 1);
    dut.wait(10.millis());
    assert_eq!((dut.status(), dut.get(Reg::PC_REG)), (6, 0));
    assert_eq!((dut.get(Reg::SPEED), dut.get(Reg::AX_REG), dut.get(Reg::TARGET_POSITION4)), (1_000, 5, 44));
    assert_eq!((dut.get(Reg::TIMEOUT_BROADCAST_MODBUS), dut.get(Reg::CMD_W) & 0xFFFF), (6, 3_000));
    assert_eq!((dut.get(Reg::ERROR), dut.get(Reg::MODE_USER_PROGRAM)), (1 << 13, 2));
}

#[test]
fn a_line_that_cannot_be_carried_out_is_bit_8() {
    let bad = [
        line(0x67, 0, 0, 0, 0),            // no such command
        put(HOLDING, 0x7006, 0),           // PC_REG
        put(2, 0x3000, 0),                 // input register
        put(HOLDING, 0x5027, 0),           // no register
        line(0x13, 0, 0, HOLDING, 0x5026), // no second register
        line(0x03, 0, 0, HOLDING, 0x1000), // no such register
        line(0x05, 0, 0, 0, 1_024),        // after the last line
    ];
    for line in bad {
        let mut dut = ready();
        dut.load(&[set(9, 1), line, END]);
        dut.start();
        dut.wait(1.millis());
        assert_eq!((dut.status(), dut.get(Reg::ERROR), dut.get(Reg::PC_REG)), (7, 1 << 8, 1), "{line:08X}");
        assert!(!dut.light(RED), "no error that stays");
        dut.start();
        assert_eq!((dut.status(), dut.get(Reg::ERROR)), (2, 0), "a start clears it");
    }
}

#[test]
fn it_reads_what_the_bus_reads() {
    let mut dut = ready();
    dut.load(&[
        line(0x03, 0, 0, 0, 0x1002),       // AX = IN_HARD_STOP_bit
        line(0x03, 0, 1, 2, 0x3009),       // BX = STATUS_USER_PROGRAM
        line(0x03, 0, 2, HOLDING, 0x7006), // CX = PC_REG
        line(0x03, 0, 3, 2, 0x8001),       // DX = HW_MAJOR
        line(0x11, 0, 4, HOLDING, 0x501B), // EX, FX = TARGET_POSITION1
        line(0x13, 0, 4, HOLDING, 0x501D), // TARGET_POSITION2 = EX, FX
        line(0x13, 0, 0, HOLDING, 0x7007), // GX, HX = AX, BX
        put(HOLDING, 0x5023, 0),           // ERROR = 1
        END,
    ]);
    dut.set(Reg::TARGET_POSITION1, -3);
    dut.start();
    dut.wait(10.millis());
    assert_eq!(dut.status(), 5);
    let registers = [Reg::AX_REG, Reg::BX_REG, Reg::CX_REG, Reg::DX_REG, Reg::EX_REG, Reg::FX_REG];
    assert_eq!(registers.map(|reg| dut.get(reg)), [1, 4, 2, 1_001, 0xFFFD, 0xFFFF]);
    assert_eq!((dut.get(Reg::TARGET_POSITION2), dut.get(Reg::GX_REG), dut.get(Reg::HX_REG)), (-3, 1, 4));
}

#[test]
fn a_wide_write_needs_both_registers_whatever_the_value() {
    let mut dut = ready();
    // POSITION_N = 9 is out of range, REF_CURRENT = 2,000 is not. Neither is written, and the program
    // continues.
    dut.load(&[set(0, 9), set(1, 2_000), line(0x13, 0, 0, HOLDING, 0x5008), END]);
    dut.start();
    dut.wait(1.millis());
    assert_eq!((dut.status(), dut.get(Reg::ERROR)), (5, 1 << 13));
    assert_eq!((dut.get(Reg::POSITION_N), dut.get(Reg::REF_CURRENT)), (1, 20_000));
    // 5026h = 9 is a wrong key, but 5027h does not exist.
    dut.load(&[set(0, 9), line(0x13, 0, 0, HOLDING, 0x5026), END]);
    dut.start();
    dut.wait(1.millis());
    assert_eq!((dut.status(), dut.get(Reg::ERROR)), (7, 1 << 13 | 1 << 8));
}

#[test]
fn the_bus_stops_it_and_what_runs_cannot_be_changed() {
    let mut dut = ready();
    dut.load(&[set(0, 1), STAY]);
    dut.start();
    dut.wait(1.millis());
    assert_eq!((dut.status(), dut.read(0x7006)), (4, 1));
    // A write to the buffer does not change the running program.
    let reply = dut.try_write_all(0x6000, &[1, 0, 0]);
    assert_eq!(reply[0], 16);
    let stores = dut.out.stores.clone();
    assert_eq!(dut.try_write(0x5025, 0x8426), [0x86, 4]);
    assert_eq!(dut.out.stores, stores);
    dut.wait(1.millis());
    assert_eq!((dut.status(), dut.get(Reg::ERROR)), (4, 0));
    dut.write(0x5025, 0x9346);
    dut.write(0x6003, 1);
    assert_eq!(dut.get(Reg::CMD_R), i64::from(STAY), "the flash came back into the buffer");
    dut.write(0x5005, 1);
    assert_eq!((dut.status(), dut.get(Reg::AX_REG)), (1, 1));
    dut.wait(1.secs());
    assert_eq!(dut.status(), 1);
}

#[test]
fn nothing_saves_the_program_while_it_runs() {
    let mut dut = ready();
    dut.load(&[set(0, 0x8426), put(HOLDING, 0x5025, 0), STAY]);
    let stores = dut.out.stores.clone();
    dut.start();
    assert_eq!(dut.try_set(Reg::FLAG_SAVE_USER_PROGRAM, 0x8426), Err(PresetError::Busy));
    dut.wait(1.millis());
    assert_eq!((dut.status(), dut.get(Reg::PC_REG), dut.get(Reg::ERROR)), (7, 1, 1 << 8));
    assert_eq!(dut.out.stores, stores);
    dut.set(Reg::FLAG_SAVE_USER_PROGRAM, 0x8426);
    assert_eq!(dut.out.stores.len(), stores.len() + 2, "it has ended");
}

#[test]
fn a_saved_3_starts_with_the_power() {
    let mut dut = ready();
    dut.load(&[set(0, 1), STAY]);
    dut.write(0x5005, 3);
    dut.wait(1.millis());
    assert_eq!(dut.status(), 1);
    dut.write(0x5024, 0x37FA);
    dut.wait(10.millis());
    dut.cycle();
    assert_eq!((dut.status(), dut.read(0x5005)), (3, 3));
    dut.wait(1.millis());
    assert_eq!((dut.status(), dut.get(Reg::AX_REG)), (4, 1));
    // A saved 2 does not start the program.
    dut.write(0x5005, 2);
    dut.write(0x5024, 0x37FA);
    dut.wait(10.millis());
    dut.cycle();
    dut.wait(1.millis());
    assert_eq!((dut.status(), dut.read(0x5005)), (1, 2));
}

#[test]
fn a_new_drive_ends_at_once() {
    let mut dut = ready();
    dut.start();
    dut.wait(1.millis());
    assert_eq!((dut.status(), dut.get(Reg::PC_REG), dut.get(Reg::ERROR)), (5, 0, 0));
}

#[test]
fn a_bad_flash_is_bit_7_and_starts_nothing() {
    let mut dut = ready();
    dut.load(&[STAY]);
    dut.out.memory[SETTINGS] ^= 1;
    dut.cycle();
    assert_eq!((dut.get(Reg::ERROR), dut.light(RED)), (1 << 7, false));
    dut.start();
    assert_eq!((dut.status(), dut.get(Reg::ERROR)), (7, 1 << 7 | 1 << 8));
    dut.write(0x5025, 0x9346);
    dut.write(0x5023, 0);
    assert_eq!(dut.get(Reg::ERROR), 1 << 7);
    dut.load(&[STAY]);
    dut.start();
    dut.wait(1.millis());
    assert_eq!(dut.status(), 4, "a save mends it");
}

#[test]
fn it_may_stop_save_and_restart_its_own_drive() {
    // Writes 5005h = 1.
    let mut dut = ready();
    dut.load(&[set(0, 1), put(HOLDING, 0x5005, 0), set(1, 1), STAY]);
    dut.start();
    dut.wait(1.secs());
    assert_eq!((dut.status(), dut.get(Reg::BX_REG)), (1, 0));
    assert_eq!((dut.get(Reg::PC_REG), dut.get(Reg::AX_REG)), (1, 1), "they stay as they were");
    dut.start();
    assert_eq!((dut.status(), dut.get(Reg::PC_REG)), (2, 0));
    // Writes 5004h = 1 and 5005h = 1 with one line.
    dut.write(0x5005, 1);
    dut.load(&[set(0, 1), set(1, 1), line(0x13, 0, 0, HOLDING, 0x5004), set(1, 2), STAY]);
    dut.start();
    dut.wait(1.secs());
    assert_eq!((dut.status(), dut.get(Reg::PC_REG), dut.get(Reg::BX_REG)), (1, 2, 1));
    // Writes 5024h = 37FAh, then 5026h = 95AFh.
    let mut dut = ready();
    dut.load(&[set(0, 0x37FA), put(HOLDING, 0x5024, 0), set(0, 0x95AF), put(HOLDING, 0x5026, 0), STAY]);
    dut.set(Reg::SPEED, 2_000);
    dut.start();
    dut.wait(399.micros());
    assert_eq!(dut.status(), 4);
    dut.wait(1.micros());
    assert_eq!((dut.status(), dut.get(Reg::AX_REG), dut.get(Reg::SPEED)), (1, 0, 2_000));
    assert_eq!(dut.get(Reg::ERROR), 0, "the restart finished the save");
}

#[test]
fn coils_reset_themselves_for_a_program_too() {
    let mut dut = ready();
    dut.load(&[set(0, 1), put(COIL, 0x2001, 0), line(0x03, 0, 1, COIL, 0x2001), END]);
    dut.set(Reg::BX_REG, 9);
    dut.start();
    dut.wait(1.millis());
    assert_eq!((dut.status(), dut.get(Reg::BX_REG)), (5, 0));
}
