//! Tests of the settings in the flash, and of presets (6.5).

use super::*;

#[test]
fn a_save_keeps_5000h_to_5020h() {
    let mut dut = ready();
    dut.write(0x500B, 2_500);
    dut.write(0x501F, 77);
    dut.write(0x5021, 88);
    dut.write(0x7000, 99);
    dut.write(0x5024, 0x37FA);
    assert_eq!(dut.read(0x5024), 0);
    dut.wait(10.millis());
    dut.cycle();
    assert_eq!((dut.get(Reg::SPEED), dut.get(Reg::TARGET_POSITION3)), (2_500, 77));
    assert_eq!((dut.get(Reg::TARGET_POSITION4), dut.get(Reg::AX_REG), dut.get(Reg::ERROR)), (0, 0, 0));
}

#[test]
fn power_lost_in_a_save_is_bit_9_and_the_factory() {
    let mut dut = ready();
    dut.write(0x500B, 2_500);
    let before = dut.now;
    dut.write(0x5024, 0x37FA);
    dut.run_until(before + 10.millis());
    dut.cycle();
    assert_eq!((dut.get(Reg::SPEED), dut.get(Reg::ERROR)), (1_000, 1 << 9));
    let memory = dut.out.memory.clone();
    assert!(!dut.light(RED), "it does not stop the motor");
    dut.write(0x5023, 0);
    assert_eq!(dut.get(Reg::ERROR), 1 << 9, "it stays until a restart");
    dut.cycle();
    assert_eq!((dut.out.memory.clone(), dut.get(Reg::ERROR)), (memory, 1 << 9));
    dut.write(0x5024, 0x37FA);
    dut.wait(10.millis());
    dut.cycle();
    assert_eq!(dut.get(Reg::ERROR), 0);
}

#[test]
fn a_save_is_two_stores_10_ms_apart() {
    let mut dut = ready();
    dut.set(Reg::FLAG_SAVE_INI, 0x37FA);
    dut.wait(1.secs());
    // The save stores 33 registers and their CRC.
    let begun = (Instant::ZERO, 0, 68);
    assert_eq!(dut.out.stored(), [begun, (10.millis().into(), 66, 2)]);
}

#[test]
fn settings_of_the_other_model_become_those_of_the_factory() {
    let mut dut = without_power();
    dut.drive = Rs434::rs434546();
    dut.set(Reg::REF_CURRENT, 30_000);
    dut.set(Reg::SPEED, 2_000);
    dut.drive = Rs434::rs434544();
    dut.cycle();
    assert_eq!((dut.get(Reg::REF_CURRENT), dut.get(Reg::SPEED)), (20_000, 2_000));
}

#[test]
fn presets_go_into_the_memory_of_a_drive_without_power() {
    let mut dut = without_power();
    assert_eq!(dut.try_set(Reg::TARGET_POSITION4, 1), Err(PresetError::ReadOnly));
    assert_eq!(dut.try_set(Reg::SPEED, 29), Err(PresetError::OutOfRange));
    dut.set(Reg::SPEED, 30);
    dut.out.memory[0] ^= 1;
    assert_eq!(dut.try_set(Reg::SPEED, 31), Err(PresetError::BadMemory));
}

#[test]
fn presets_of_a_running_drive_act_as_the_bus_does() {
    let mut dut = ready();
    for reg in
        [Reg::IN1_bit, Reg::STATUS, Reg::CURRENT_POSITION, Reg::PC_REG, Reg::HW_MAJOR, Reg::TASK_COUNTER]
    {
        assert_eq!(dut.try_set(reg, 1), Err(PresetError::ReadOnly), "{reg:?}");
    }
    dut.set(Reg::CMD_W, 0x1234_0004);
    dut.set(Reg::WRITE_CMD, 3);
    dut.set(Reg::READ_CMD, 3);
    assert_eq!(dut.get(Reg::CMD_R), 0x1234_0004);
    dut.set(Reg::CLR_POSITION_bit, 1);
    assert_eq!(dut.get(Reg::CLR_POSITION_bit), 0);
    dut.set(Reg::HX_REG, 8);
    assert_eq!(dut.read(0x7008), 8);
    assert_eq!(dut.drive.poke(dut.now, 1_000, 0, &mut dut.out), Err(PresetError::NoSuchRegister));
}
