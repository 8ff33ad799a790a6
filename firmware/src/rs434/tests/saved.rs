//! Settings in the flash, presets (6.5).

use super::*;

#[test]
fn a_save_keeps_5000h_to_5020h() {
    let mut bed = Bed::ready();
    bed.write(0x500B, 2_500);
    bed.write(0x501F, 77);
    bed.write(0x5021, 88);
    bed.write(0x7000, 99);
    bed.write(0x5024, 0x37FA);
    assert_eq!(bed.read(0x5024), 0);
    bed.wait(10.millis());
    bed.cycle();
    assert_eq!((bed.get(Reg::SPEED), bed.get(Reg::TARGET_POSITION3)), (2_500, 77));
    assert_eq!((bed.get(Reg::TARGET_POSITION4), bed.get(Reg::AX_REG), bed.get(Reg::ERROR)), (0, 0, 0));
}

#[test]
fn power_lost_in_a_save_is_bit_9_and_the_factory() {
    let mut bed = Bed::ready();
    bed.write(0x500B, 2_500);
    let before = bed.now;
    bed.write(0x5024, 0x37FA);
    bed.run_until(before + 10.millis());
    bed.cycle();
    assert_eq!((bed.get(Reg::SPEED), bed.get(Reg::ERROR)), (1_000, 1 << 9));
    let memory = bed.world.memory.clone();
    assert!(!bed.light(RED), "it does not stop the motor");
    bed.write(0x5023, 0);
    assert_eq!(bed.get(Reg::ERROR), 1 << 9, "it stays until a restart");
    bed.cycle();
    assert_eq!((bed.world.memory.clone(), bed.get(Reg::ERROR)), (memory, 1 << 9));
    bed.write(0x5024, 0x37FA);
    bed.wait(10.millis());
    bed.cycle();
    assert_eq!(bed.get(Reg::ERROR), 0);
}

#[test]
fn a_save_is_two_stores_10_ms_apart() {
    let mut bed = Bed::ready();
    bed.set(Reg::FLAG_SAVE_INI, 0x37FA);
    bed.wait(1.secs());
    // 33 registers and their CRC.
    let begun = (Instant::ZERO, 0, 68);
    assert_eq!(bed.world.stores, [begun, (10.millis().into(), 66, 2)]);
}

#[test]
fn settings_of_the_other_model_become_those_of_the_factory() {
    let mut bed = Bed::new();
    bed.drive = rs434546();
    bed.set(Reg::REF_CURRENT, 30_000);
    bed.set(Reg::SPEED, 2_000);
    bed.cycle();
    assert_eq!((bed.get(Reg::REF_CURRENT), bed.get(Reg::SPEED)), (20_000, 2_000));
}

#[test]
fn presets_go_into_the_memory_of_a_drive_without_power() {
    let mut bed = Bed::new();
    assert_eq!(bed.try_set(Reg::TARGET_POSITION4, 1), Err(Refused::ReadOnly));
    assert_eq!(bed.try_set(Reg::SPEED, 29), Err(Refused::OutOfRange));
    bed.set(Reg::SPEED, 30);
    bed.world.memory[0] ^= 1;
    assert_eq!(bed.try_set(Reg::SPEED, 31), Err(Refused::BadMemory));
}

#[test]
fn presets_of_a_running_drive_act_as_the_bus_does() {
    let mut bed = Bed::ready();
    for reg in
        [Reg::IN1_bit, Reg::STATUS, Reg::CURRENT_POSITION, Reg::PC_REG, Reg::HW_MAJOR, Reg::TASK_COUNTER]
    {
        assert_eq!(bed.try_set(reg, 1), Err(Refused::ReadOnly), "{reg:?}");
    }
    bed.set(Reg::CMD_W, 0x1234_0004);
    bed.set(Reg::WRITE_CMD, 3);
    bed.set(Reg::READ_CMD, 3);
    assert_eq!(bed.get(Reg::CMD_R), 0x1234_0004);
    bed.set(Reg::CLR_POSITION_bit, 1);
    assert_eq!(bed.get(Reg::CLR_POSITION_bit), 0);
    bed.set(Reg::HX_REG, 8);
    assert_eq!(bed.read(0x7008), 8);
    assert_eq!(bed.drive.poke(bed.now, 1_000, 0, &mut bed.world), Err(Refused::NoSuchRegister));
}
