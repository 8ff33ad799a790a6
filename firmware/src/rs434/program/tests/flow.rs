//! Tests of the order of lines: jumps, subroutines, loops, delays, the two ends, and errors.

use super::*;

#[test]
fn a_line_takes_100_us_and_the_short_state_as_long() {
    let mut drive = Drive::running(&[set(AX, 7), set(BX, 8), STOP]);
    assert_eq!(drive.program.status(), Status::StartedByBus);
    assert_eq!(drive.program.line_due(), Instant::ZERO + 100.micros());
    assert_eq!(run(Instant::ZERO + 99.micros(), &mut drive), None, "nothing before it is due");
    assert_eq!((drive.program.status(), drive.registers()[0]), (Status::StartedByBus, 0));
    drive.step();
    assert_eq!((drive.program.status(), drive.registers()[..2].to_vec()), (Status::Running, vec![7, 0]));
    drive.step();
    assert_eq!((drive.now, drive.registers()[1]), (Instant::ZERO + 200.micros(), 8));
    drive.step();
    assert_eq!((drive.now, drive.program.status()), (Instant::ZERO + 300.micros(), Status::Ended));
    assert_eq!(drive.program.line_due(), Instant::NEVER);
}

#[test]
fn delay() {
    let mut drive = Drive::running(&[super::delay(5), super::delay(0), super::delay(65_535), STOP]);
    let at = |drive: &mut Drive| {
        drive.step();
        (drive.now, drive.program.vm.line)
    };
    assert_eq!(at(&mut drive), (Instant::ZERO + 100.micros(), 0));
    // PC_REG reads the line of the delay until the delay ends.
    assert_eq!(at(&mut drive), (Instant::ZERO + 5_100.micros(), 1));
    assert_eq!(at(&mut drive), (Instant::ZERO + 5_200.micros(), 2));
    assert_eq!(at(&mut drive), (Instant::ZERO + 65_540_200.micros(), 3));
}

#[test]
fn jumps() {
    // Columns: code, AX and BX or the pairs of GX and IX, and true if the jump is taken.
    let of_words = [
        (0x05, 0, 0, true),
        (0x06, 5, 5, true),
        (0x06, 5, 6, false),
        (0x07, 5, 5, false),
        (0x07, 5, 6, true),
        (0x08, 6, 5, true),
        (0x08, 5, 5, false),
        // Comparisons are unsigned: -1 is greater than 1.
        (0x08, 0xFFFF, 1, true),
        (0x09, 5, 6, true),
        (0x09, 5, 5, false),
        (0x09, 0xFFFF, 1, false),
    ];
    for (code, ax, bx, taken) in of_words {
        // The pairs are in the opposite order, if the values differ.
        let registers = [ax, bx, 0, 0, 0, 0, bx, bx, ax, ax];
        for (type_jmp, data) in [(0, 3), (1, 3)] {
            let lines = [line(code, type_jmp, 0xF, 0xF, data), STOP, STOP, STOP];
            let mut drive = Drive::running(&lines).with_registers(registers);
            assert_eq!(drive.path(2), [0, if taken { 3 } else { 1 }], "{code:#x} {ax} {bx}");
        }
    }
    let of_pairs = [
        (0x63, 0x1_0002, 0x1_0002, true),
        (0x63, 0x1_0002, 0x2_0002, false),
        (0x64, 0x1_0002, 0x2_0002, true),
        (0x64, 0x1_0002, 0x1_0002, false),
        (0x65, 0x2_0000, 0x1_FFFF, true),
        (0x65, 0xFFFF_FFFF, 1, true),
        (0x65, 7, 7, false),
        (0x66, 0x1_FFFF, 0x2_0000, true),
        (0x66, 7, 7, false),
    ];
    for (code, first, second, taken) in of_pairs {
        let [g, h, i, j] = [first, first >> 16, second, second >> 16].map(|word: u32| (word & 0xFFFF) as u16);
        let lines = [line(code, 0, 0, 0, 2), STOP, STOP];
        let mut drive = Drive::running(&lines).with_registers([1, 2, 0, 0, 0, 0, g, h, i, j]);
        assert_eq!(drive.path(2), [0, if taken { 2 } else { 1 }], "{code:#x} {first:#x} {second:#x}");
    }
}

#[test]
fn relative_jumps_count_from_their_own_line() {
    let relative = |by: i16| line(0x05, 1, 0, 0, by.cast_unsigned().into());
    assert_eq!(Drive::running(&[jump(2), STOP, relative(-1)]).path(3), [0, 2, 1]);
    assert_eq!(Drive::running(&[relative(1), STOP]).path(2), [0, 1], "+1 is the next line");
    assert_eq!(Drive::running(&[set(AX, 1), relative(0)]).path(4), [0, 1, 1, 1], "0 is the line itself");
    assert_eq!(Drive::running(&[relative(1_023)]).path(2), [0, 1_023]);
    for beyond in [-1, 1_024, i16::MIN, i16::MAX] {
        assert_eq!(Drive::running(&[relative(beyond)]).step(), Step::Error, "{beyond}");
    }
}

#[test]
fn a_jump_behind_the_last_line_is_an_error_only_if_it_is_taken() {
    for target in [1_024, 0xFFFF] {
        let mut drive = Drive::running(&[set(AX, 1), jump(target)]);
        assert_eq!(drive.finish(), Status::Failed);
        assert_eq!(drive.program.vm.line, 1, "PC stays at the jump");
        let mut drive = Drive::running(&[set(AX, 1), line(0x06, 0, 0, 0, target), STOP]);
        assert_eq!(drive.finish(), Status::Ended);
        assert_eq!(Drive::running(&[call(target)]).finish(), Status::Failed);
    }
}

#[test]
fn falling_off_the_last_line_is_an_error() {
    let mut lines = vec![jump(LAST)];
    lines.resize(LAST as usize, 0);
    lines.push(set(AX, 9));
    let mut drive = Drive::running(&lines);
    assert_eq!(drive.path(2), [0, 1_023]);
    assert_eq!(drive.step(), Step::Error);
    assert_eq!((drive.program.vm.line, drive.registers()[0]), (1_023, 9));
}

#[test]
fn a_jump_to_a_constant_carries_it_out() {
    // The constant of DMOV_SYSREG_CONST in line 2 is a valid line: MOV_SYSREG_CONST AX, 1. The jump leads to
    // it.
    let lines = [jump(2), line(0x10, 0, CX, 0, 0), set(AX, 1), STOP];
    let mut drive = Drive::running(&lines);
    assert_eq!(drive.path(3), [0, 2, 3]);
    assert_eq!(drive.registers()[..4], [1, 0, 0, 0]);
    // Without the jump the constant is skipped.
    assert_eq!(Drive::running(&lines[1..]).path(2), [0, 2]);
}

#[test]
fn subroutines() {
    // A CALL does not use bTypeJmp: its address is always absolute.
    let lines = [line(0x0A, 1, 0, 0, 3), add(AX, 1), STOP, call(5), RETURN, add(BX, 1), RETURN];
    let mut drive = Drive::running(&lines);
    assert_eq!(drive.path(7), [0, 3, 5, 6, 4, 1, 2]);
}

#[test]
fn subroutines_nest_16_deep() {
    // The subroutine calls itself, and AX counts.
    let calls = |depth: u32| {
        // 1: AX += 1; 2: if AX = BX go to 4; 3: call 1; 4: stop.
        let lines = [set(BX, depth), add(AX, 1), line(0x06, 0, 0, 0, 4), call(1), STOP];
        Drive::running(&lines).finish()
    };
    assert_eq!(calls(17), Status::Ended, "sixteen calls");
    assert_eq!(calls(18), Status::Failed, "seventeen");
    assert_eq!(Drive::running(&[RETURN]).finish(), Status::Failed, "a return without a call");
}

#[test]
fn the_example_of_for_in_the_manual() {
    // "uData = 0x1705 - 0x17 = 23 commands executed in a loop, 0x05 = 5 - the number of repetitions."
    let mut lines = vec![line(0x0C, 0, 0, 0, 0x1705)];
    lines.extend([add(AX, 1); 23]);
    lines.extend([add(BX, 1), STOP]);
    let mut drive = Drive::running(&lines);
    assert_eq!(drive.finish(), Status::Ended);
    assert_eq!(drive.registers()[..2], [115, 1]);
    assert_eq!(drive.now, Instant::ZERO + (100 * (1 + 1 + 115 + 1)).micros());
}

#[test]
fn for_none_skips_and_of_no_lines_does_nothing() {
    assert_eq!(Drive::running(&[repeat(2, 0), STOP, STOP, STOP]).path(2), [0, 3]);
    assert_eq!(Drive::running(&[repeat(0, 5), STOP]).path(2), [0, 1]);
    assert_eq!(Drive::running(&[repeat(0, 0), STOP]).path(2), [0, 1]);
    assert_eq!(Drive::running(&[repeat(1, 1), add(AX, 1), STOP]).path(3), [0, 1, 2]);
}

#[test]
fn loops_that_end_together_all_count() {
    // Three rounds of: BX += 1, then two rounds of AX += 1.
    let mut drive = Drive::running(&[repeat(3, 3), add(BX, 1), repeat(1, 2), add(AX, 1), STOP]);
    assert_eq!(drive.finish(), Status::Ended);
    assert_eq!(drive.registers()[..2], [6, 3]);
}

#[test]
fn a_round_may_end_by_a_jump_to_the_line_behind_it() {
    // Line 2 jumps over line 3 to line 4, which is directly after the body of lines 1 to 3.
    let mut drive = Drive::running(&[repeat(3, 3), add(AX, 1), jump(4), add(BX, 1), STOP]);
    assert_eq!(drive.finish(), Status::Ended);
    assert_eq!(drive.registers()[..2], [3, 0]);
    // A jump inside the body does not affect the loop.
    let mut drive = Drive::running(&[repeat(3, 2), jump(3), add(BX, 1), add(AX, 1), STOP]);
    assert_eq!(drive.finish(), Status::Ended);
    assert_eq!(drive.registers()[..2], [2, 0]);
}

#[test]
fn a_jump_out_of_the_body_ends_the_loop() {
    // Jumps from line 1 to 4 and back to 2, which no longer belongs to a loop.
    let lines = [repeat(2, 3), jump(4), add(AX, 1), STOP, add(BX, 1), jump(2)];
    assert_eq!(Drive::running(&lines).path(6), [0, 1, 4, 5, 2, 3]);
    // Jumps to the FOR itself, which starts a new loop. If the old loop did not end, the ninth start would be
    // an error.
    let mut drive = Drive::running(&[repeat(2, 3), add(AX, 1), jump(0)]);
    assert_eq!(drive.path(99), [0, 1, 2].repeat(33));
}

#[test]
fn a_subroutine_is_no_jump_out_of_the_body() {
    // Two rounds of a call in the last line of the body. The subroutine has a loop of its own, which the
    // return ends.
    let lines = [repeat(1, 2), call(3), STOP, repeat(5, 9), add(AX, 1), RETURN];
    let mut drive = Drive::running(&lines);
    assert_eq!(drive.path(10), [0, 1, 3, 4, 5, 1, 3, 4, 5, 2]);
    assert_eq!(drive.program.status(), Status::Ended);
    // A line of the body that is executed in a subroutine does not end a round of the caller's loop.
    let lines = [repeat(2, 2), call(5), add(AX, 1), STOP, STOP, jump(2)];
    assert_eq!(Drive::running(&lines).path(5), [0, 1, 5, 2, 3], "line 3 is reached in the subroutine");
}

#[test]
fn loops_nest_8_deep() {
    let nested = |depth: u32| {
        // A FOR in each line, whose body is all lines up to the last one.
        let mut lines: Vec<u32> = (0..depth).map(|n| repeat(depth - n, 2)).collect();
        lines.extend([add(AX, 1), STOP]);
        let mut drive = Drive::running(&lines);
        (drive.finish(), drive.registers()[0])
    };
    assert_eq!(nested(8), (Status::Ended, 256));
    assert_eq!(nested(9).0, Status::Failed);
}

#[test]
fn both_ends() {
    let registers = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10];
    let lines = |end| [set(AX, 100), set(JX, 200), end];
    let mut drive = Drive::off(memory_with(&lines(STOP))).with_registers(registers);
    drive.program.power_on(&drive.out);
    assert_eq!(drive.registers(), [0; 10], "a boot empties them");

    // 0x00: registers and PC keep their values.
    let mut drive = Drive::off(memory_with(&lines(STOP)));
    drive.program.power_on(&drive.out);
    drive = drive.with_registers(registers);
    drive.program.start(drive.now, Status::StartedByPower);
    assert_eq!(drive.program.status(), Status::StartedByPower);
    assert_eq!(drive.finish(), Status::Ended);
    assert_eq!((drive.registers(), drive.program.vm.line), ([100, 2, 3, 4, 5, 6, 7, 8, 9, 200], 2));

    // 0x0D: the registers are restored from before the start.
    let mut drive = Drive::off(memory_with(&lines(FULL_STOP)));
    drive.program.power_on(&drive.out);
    drive = drive.with_registers(registers);
    drive.program.start(drive.now, Status::StartedByBus);
    assert_eq!(drive.path(2), [0, 1]);
    assert_eq!(drive.step(), Step::FullEnd);
    assert_eq!(drive.program.status(), Status::FullyEnded);
    assert_eq!((drive.registers(), drive.program.vm.line), (registers, 0));
}

#[test]
fn a_start_begins_at_line_0_in_any_state_but_running() {
    // A start while the program is in a subroutine and in a loop.
    let mut drive = Drive::running(&[call(2), STOP, repeat(2, 3), add(AX, 1), STOP]);
    drive.path(2);
    drive.program.start(drive.now, Status::StartedByBus);
    assert_eq!((drive.program.status(), drive.path(2)), (Status::Running, vec![3, 4]), "it ran on");
    drive.program.start(drive.now, Status::StartedByBus);
    assert_eq!((drive.program.status(), drive.program.vm.line), (Status::StartedByBus, 0));
    assert_eq!((drive.path(4), drive.registers()[0]), (vec![0, 2, 3, 4], 2), "AX has been kept");
    // A start empties the stacks: seventeen starts make seventeen calls.
    for _ in 0..17 {
        drive.program.start(drive.now, Status::StartedByBus);
        assert_eq!(drive.finish(), Status::Ended);
    }
}

#[test]
fn the_bus_stops_it_and_so_does_the_program_itself() {
    let mut drive = Drive::running(&[set(AX, 1), jump(0)]);
    drive.path(2);
    drive.program.stop();
    assert_eq!((drive.program.status(), drive.program.line_due()), (Status::Stopped, Instant::NEVER));
    assert_eq!((drive.registers()[0], drive.program.vm.line), (1, 1));
    // MOV_MODBUS_CONST, as a program writes MODE_USER_PROGRAM.
    let lines = [line(0x0E, 0, 0, HOLDING, 0x5005), 1, set(AX, 1), STOP];
    let mut drive = Drive::running(&lines).with_bus(Space::Holding, 0x5005, &[2]);
    drive.stops = Some(0x5005);
    assert_eq!(drive.finish(), Status::Stopped);
    assert_eq!((drive.program.line_due(), drive.registers()[0]), (Instant::NEVER, 0));
}

#[test]
fn any_lines_end_or_go_on_but_do_not_hang() {
    let mut seed = 1_u64;
    let mut random = || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 32) as u32
    };
    let (mut failed, mut over) = (0, 0);
    for _ in 0..200 {
        // Commands 0 to 1Fh. They include all forms.
        let lines: Vec<u32> = (0..LINES).map(|_| random() & !0x60).collect();
        let mut drive = Drive::running(&lines).with_bus(Space::Holding, 0, &[5; 64]);
        for _ in 0..2_000 {
            if !drive.program.is_running() {
                break;
            }
            let before = drive.now;
            drive.step();
            assert!(drive.now >= before + 100.micros(), "a line takes its time");
            assert!(drive.program.vm.line < 1_024);
        }
        failed += u32::from(drive.program.status() == Status::Failed);
        over += u32::from(!drive.program.is_running());
    }
    assert!(failed > 50 && over > failed, "{failed} {over}");
}
