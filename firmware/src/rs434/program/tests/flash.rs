//! Tests of the buffer and of the flash (6.6).

use super::*;
use crate::rs434::SETTINGS;

/// Offset of the CRC of the lines.
const CRC: u16 = (SETTINGS + 4 * 1_024) as u16;

#[test]
fn lines_go_to_the_buffer_and_come_back() {
    let mut drive = Drive::off(new_memory());
    assert!(drive.program.power_on(&drive.out));
    assert_eq!(drive.program.read_line(0), 0, "it is empty");
    drive.program.write_line(0, 0x1234_5678);
    drive.program.write_line(1_023, 0xFFFF_FFFF);
    drive.program.write_line(1_024, 1);
    let read = |address| drive.program.read_line(address);
    assert_eq!([0, 1, 1_023, 1_024].map(read), [0x1234_5678, 0, 0xFFFF_FFFF, 0]);
}

#[test]
fn a_new_drive_has_a_program_that_ends_at_once() {
    let mut drive = Drive::off(new_memory());
    assert!(drive.program.power_on(&drive.out), "that is no error");
    drive.program.start(drive.now, Status::StartedByBus);
    assert_eq!((drive.step(), drive.program.status()), (Step::End, Status::Ended));
    drive.program.write_line(3, 7);
    assert!(drive.program.load(&drive.out));
    assert_eq!(drive.program.read_line(3), 0, "its flash holds zeros");
}

#[test]
fn a_save_takes_10_ms_and_lasts() {
    let mut drive = Drive::off(new_memory());
    drive.program.power_on(&drive.out);
    drive.program.write_line(0, set(AX, 0x1234));
    drive.program.save(drive.now, &mut drive.out);
    let right = drive.now + 10.millis();
    assert_eq!(drive.program.save.due(), right);
    let places: Vec<_> = drive.out.stores.iter().map(|(_, offset, bytes)| (*offset, bytes.len())).collect();
    assert_eq!(places, [(CRC, 2), (SETTINGS as u16, 4_096)], "a CRC that is wrong, then the lines");
    assert_eq!(drive.out.memory[SETTINGS..][..5], [0x01, 0x00, 0x34, 0x12, 0x00], "the low byte first");
    drive.program.save.finish(right, &mut drive.out);
    assert_eq!(drive.program.save.due(), Instant::NEVER);
    assert_eq!(drive.out.stores.len(), 3);
    assert_eq!(drive.out.memory, memory_with(&[set(AX, 0x1234)]).memory);

    // The saved program runs, and can be loaded into an empty buffer.
    assert!(drive.program.power_on(&drive.out));
    assert_eq!(drive.program.read_line(0), 0, "power empties the buffer");
    assert!(drive.program.load(&drive.out));
    assert_eq!(drive.program.read_line(0), set(AX, 0x1234));
    drive.program.start(drive.now, Status::StartedByBus);
    assert_eq!((drive.finish(), drive.registers()[0]), (Status::Ended, 0x1234));
}

#[test]
fn what_runs_is_the_flash_and_not_the_buffer() {
    let mut drive = Drive::running(&[set(AX, 1), set(AX, 2), STOP]);
    drive.step();
    for address in 0..1_024 {
        drive.program.write_line(address, set(AX, 99));
    }
    assert_eq!((drive.finish(), drive.registers()[0]), (Status::Ended, 2));
}

#[test]
fn it_runs_and_comes_back_while_its_save_is_not_over() {
    let mut drive = Drive::off(new_memory());
    drive.program.power_on(&drive.out);
    drive.program.write_line(0, set(AX, 3));
    drive.program.save(drive.now, &mut drive.out);
    drive.program.start(drive.now, Status::StartedByBus);
    assert_eq!((drive.finish(), drive.registers()[0]), (Status::Ended, 3));
    drive.program.write_line(0, 0);
    assert!(drive.program.load(&drive.out));
    assert_eq!(drive.program.read_line(0), set(AX, 3));
    // A restart finishes the save early.
    drive.program.save.finish(drive.now, &mut drive.out);
    assert!(drive.program.power_on(&drive.out));
}

#[test]
fn power_lost_inside_a_save_leaves_a_bad_flash_or_one_of_both_programs() {
    let [old, new] = [[set(AX, 1), STOP], [set(AX, 2), STOP]].map(|lines| memory_with(&lines).memory);
    let mut drive = Drive::running(&[set(AX, 1), STOP]);
    drive.finish();
    drive.program.write_line(0, set(AX, 2));
    drive.program.save(drive.now, &mut drive.out);
    drive.program.save.finish(drive.now + 10.millis(), &mut drive.out);
    assert_eq!(drive.out.memory, new);
    let stores = drive.out.stores.split_off(0);
    let stored: Vec<(usize, u8)> =
        stores.iter().flat_map(|(_, offset, bytes)| (usize::from(*offset)..).zip(bytes.clone())).collect();
    assert_eq!(stored.len(), 4_096 + 4);
    let mut cut = Drive::off(Recorder::with_memory(old.clone()));
    for (place, byte) in stored {
        cut.out.memory[place] = byte;
        let passes = cut.program.power_on(&cut.out);
        assert_eq!(passes, cut.out.memory == old || cut.out.memory == new);
    }
    assert!(cut.program.power_on(&cut.out), "all of it was stored");
}

#[test]
fn a_bad_flash_starts_nothing_and_leaves_the_buffer_alone() {
    let mut out = memory_with(&[set(AX, 1), STOP]);
    out.memory[SETTINGS + 40] ^= 1;
    let mut drive = Drive::off(out);
    assert!(!drive.program.power_on(&drive.out));
    drive.program.start(drive.now, Status::StartedByBus);
    assert_eq!((drive.program.status(), drive.program.line_due()), (Status::Failed, Instant::NEVER));
    drive.program.write_line(0, 5);
    assert!(!drive.program.load(&drive.out));
    assert_eq!(drive.program.read_line(0), 5);
    // A new save repairs the flash.
    drive.program.write_line(0, STOP);
    drive.program.save(drive.now, &mut drive.out);
    drive.program.start(drive.now, Status::StartedByBus);
    assert_eq!(drive.program.status(), Status::StartedByBus);
    assert_eq!((drive.step(), drive.program.status()), (Step::End, Status::Ended));
}

#[test]
fn an_image_ends_with_the_crc_of_its_lines() {
    let image = image([0x0403_0201]);
    assert_eq!(image.len(), 4_098);
    assert_eq!(image[..5], [1, 2, 3, 4, 0]);
    // Computes CRC-16/MODBUS bit by bit.
    let mut crc = 0xFFFF_u16;
    for byte in &image[..4_096] {
        crc ^= u16::from(*byte);
        for _ in 0..8 {
            crc = if crc & 1 != 0 { crc >> 1 ^ 0xA001 } else { crc >> 1 };
        }
    }
    assert_eq!(image[4_096..], crc.to_be_bytes());
}
