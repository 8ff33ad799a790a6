//! Loading, starting and stopping programs; jumps, subroutines and loops; the state after a program (6.5,
//! 6.6, 6.9).

use drivetwin_protocol::time::{Duration, Span};
use drivetwin_sim::bench::PowerAction;
use drivetwin_tests::rs434::{BOOT, LINE, Rig, SAVE, at, key};

use crate::oracle::status;

/// Instructions with zeros in their unused fields.
mod cmd {
    pub(super) const END: u32 = 0x00;
    pub(super) const ENDF: u32 = 0x0D;
    pub(super) const RETURN: u32 = 0x0B;

    pub(super) const fn fields(code: u16, system: u16, kind: u16, data: u16) -> u32 {
        (data as u32) << 16 | (kind << 12 | system << 8 | code) as u32
    }
    pub(super) const fn mov(system: u16, value: u16) -> u32 {
        fields(0x01, system, 0, value)
    }
    pub(super) const fn add(system: u16, value: u16) -> u32 {
        fields(0x19, system, 0, value)
    }
    /// Writes a Modbus register. The value is in the next line.
    pub(super) const fn put(kind: u16, address: u16) -> u32 {
        fields(0x0E, 0, kind, address)
    }
    pub(super) const fn get(system: u16, kind: u16, address: u16) -> u32 {
        fields(0x03, system, kind, address)
    }
    pub(super) const fn jump(target: u16) -> u32 {
        fields(0x05, 0, 0, target)
    }
    pub(super) const fn skip(by: i16) -> u32 {
        fields(0x85, 0, 0, by.cast_unsigned())
    }
    pub(super) const fn jump_unless_equal(target: u16) -> u32 {
        fields(0x07, 0, 0, target)
    }
    pub(super) const fn delay(ms: u16) -> u32 {
        fields(0x04, 0, 0, ms)
    }
    pub(super) const fn call(target: u16) -> u32 {
        fields(0x0A, 0, 0, target)
    }
    pub(super) const fn repeat(lines: u16, times: u16) -> u32 {
        fields(0x0C, 0, 0, lines << 8 | times)
    }
}
use cmd::{END, ENDF, RETURN, add, call, delay, get, jump, jump_unless_equal, mov, put, repeat, skip};

const BX: u16 = at::AX + 1;
const CX: u16 = at::AX + 2;

/// A drive that has run a program for a second.
fn ran(lines: &[u32]) -> Rig {
    let mut rig = Rig::default();
    rig.load(lines);
    rig.run();
    rig.after(1.secs());
    rig
}

#[track_caller]
fn assert_ended(rig: &mut Rig, status: u16, pc: u16) {
    let error = if status == status::ERROR { 0x0100 } else { 0 };
    let seen = [at::STATUS_USER_PROGRAM, at::PC, at::ERROR].map(|address| rig.read(address));
    assert_eq!(seen, [status, pc, error], "status, PC, ERROR");
}

// Section 6.6: the buffer.

/// A line is loaded through CMD_W and WRITE_CMD, and read back through READ_CMD and CMD_R. The low word is
/// the command, the high word is its data.
#[test]
fn section_6_6_the_buffer() {
    let mut rig = Rig::default();
    for (line, word) in [(0, 0x1234_5678), (1, 0xFFFF_FFFF), (1_023, 0x8000_0001_u32)] {
        rig.write_long(at::CMD_W, word.cast_signed());
        rig.write(at::WRITE_CMD, line);
    }
    for (line, word) in [(1_023, 0x8000_0001_u32), (0, 0x1234_5678), (2, 0), (1, 0xFFFF_FFFF), (1_022, 0)] {
        rig.write(at::READ_CMD, line);
        assert_eq!(rig.read_long(at::CMD_R).cast_unsigned(), word, "line {line}");
        assert_eq!(rig.try_words(3, at::READ_CMD, 3), Ok(vec![line, word as u16, (word >> 16) as u16]));
    }
    // RS434-2: WRITE_CMD and READ_CMD read the last line number.
    assert_eq!(rig.read(at::WRITE_CMD), 1_023);
    for port in [at::WRITE_CMD, at::READ_CMD] {
        assert_eq!(rig.try_write(port, 1_024), Err(3));
        assert_eq!(rig.read(at::ERROR), 0x2000);
        rig.write(at::ERROR, 0);
    }
}

/// RS434-1: one request can load a line, whatever CMD_W was before.
#[test]
fn section_6_6_a_line_in_one_request() {
    let mut rig = Rig::default();
    rig.write_long(at::CMD_W, -1);
    assert_eq!(rig.try_write_all(at::WRITE_CMD, &[7, 0x5678, 0x1234]), Ok(()));
    rig.write(at::READ_CMD, 7);
    assert_eq!(rig.read_long(at::CMD_R), 0x1234_5678);
    // One request for both: line 9 is written, then read.
    assert_eq!(rig.try_write_all(at::WRITE_CMD, &[9, 0xBEEF, 0xDEAD, 9]), Ok(()));
    assert_eq!(rig.read_long(at::CMD_R).cast_unsigned(), 0xDEAD_BEEF);
    // A line number out of range loads nothing, and nothing else changes (MODBUS-4).
    assert_eq!(rig.try_write_all(at::WRITE_CMD, &[1_024, 1, 2]), Err(3));
    assert_eq!(rig.read_long(at::CMD_W).cast_unsigned(), 0xDEAD_BEEF);
}

/// 8426h copies the buffer to the flash, 9346h the flash to the buffer. The drive runs the program in the
/// flash, not in the buffer (RS434-28).
#[test]
fn section_6_6_flash_and_buffer() {
    let mut rig = Rig::default();
    rig.load(&[mov(0, 7), END]);
    rig.restart();
    rig.write(at::READ_CMD, 0);
    assert_eq!(rig.read_long(at::CMD_R), 0, "a buffer does not survive a restart");
    rig.write(at::SAVE_PROGRAM, key::LOAD_PROGRAM);
    rig.after(SAVE);
    rig.write(at::READ_CMD, 0);
    assert_eq!(rig.read_long(at::CMD_R).cast_unsigned(), mov(0, 7));
    // A line that is only in the buffer does not run.
    assert_eq!(rig.try_write_all(at::WRITE_CMD, &[0, mov(0, 9) as u16, 9]), Ok(()));
    rig.run();
    rig.after(1.millis());
    assert_eq!(rig.read(at::AX), 7);
    assert_eq!(rig.read(at::SAVE_PROGRAM), 0);
    // Another key is refused (RS434-2).
    assert_eq!(rig.try_write(at::SAVE_PROGRAM, 0x8427), Err(3));
    assert_eq!(rig.read(at::ERROR), 0x2000);
}

/// "Rewriting the buffer while it runs must not corrupt the running program". RS434-28: while a program runs,
/// 8426h is refused and 9346h is not.
#[test]
fn section_6_6_the_buffer_while_a_program_runs() {
    let mut rig = Rig::default();
    rig.load(&[add(0, 1), jump(0)]);
    rig.run();
    for line in 0..4 {
        assert_eq!(rig.try_write_all(at::WRITE_CMD, &[line, 0x007F, 0]), Ok(()));
    }
    let before = rig.bench.memory(rig.seat).to_vec();
    assert_eq!(rig.try_write(at::SAVE_PROGRAM, key::SAVE_PROGRAM), Err(4));
    rig.after(10.millis());
    assert_eq!(rig.bench.memory(rig.seat), before);
    assert_eq!([at::STATUS_USER_PROGRAM, at::ERROR].map(|address| rig.read(address)), [status::RUNS, 0]);
    // 50 rounds are made in 10 ms.
    assert!((50..60).contains(&rig.read(at::AX)));
    rig.write(at::SAVE_PROGRAM, key::LOAD_PROGRAM);
    rig.after(SAVE);
    rig.write(at::READ_CMD, 0);
    assert_eq!(rig.read_long(at::CMD_R).cast_unsigned(), add(0, 1));
    assert_eq!(rig.read(at::STATUS_USER_PROGRAM), status::RUNS);
}

/// RS434-11: if power fails during a save, ERROR bit 7 is set, and a start gives status 7. A save repairs the
/// memory.
#[test]
fn section_6_6_power_lost_in_a_save() {
    let mut rig = Rig::default();
    rig.load(&[mov(0, 7), END]);
    assert_eq!(rig.try_write_all(at::WRITE_CMD, &[0, mov(0, 8) as u16, 8]), Ok(()));
    rig.write(at::SAVE_PROGRAM, key::SAVE_PROGRAM);
    rig.after(1.millis());
    rig.bench.power(rig.seat, PowerAction::Off);
    rig.after(1.secs());
    rig.bench.power(rig.seat, PowerAction::On);
    rig.after(BOOT + 1.millis());
    assert_eq!(rig.read(at::ERROR), 1 << 7);
    rig.run();
    rig.after(1.millis());
    assert_eq!(rig.read(at::STATUS_USER_PROGRAM), status::ERROR);
    assert_eq!(rig.read(at::ERROR), 1 << 7 | 1 << 8);
    rig.write(at::ERROR, 0);
    assert_eq!(rig.read(at::ERROR), 1 << 7, "it stays until a restart");
    rig.load(&[mov(0, 9), END]);
    rig.restart();
    assert_eq!(rig.read(at::ERROR), 0);
    rig.run();
    rig.after(1.millis());
    assert_eq!((rig.read(at::AX), rig.read(at::STATUS_USER_PROGRAM)), (9, status::END));
}

// Sections 6.3, 6.5: start and stop.

/// Status 2 is "a short period only": 100 µs. Then line 0 runs.
#[test]
fn section_6_3_status_of_a_program() {
    let mut rig = Rig::default();
    assert_eq!(rig.read(at::STATUS_USER_PROGRAM), 1);
    rig.load(&[mov(0, 1), mov(0, 2), END]);
    rig.write(at::MODE_USER_PROGRAM, 2);
    let mut seen = Vec::new();
    for _ in 0..5 {
        seen.push([at::STATUS_USER_PROGRAM, at::AX, at::PC].map(|address| rig.read(address)));
        rig.after(LINE);
    }
    assert_eq!(seen, [[2, 0, 0], [4, 1, 0], [4, 2, 1], [5, 2, 2], [5, 2, 2]]);
    assert_eq!(rig.read(at::MODE_USER_PROGRAM), 2, "RS434-26");
    // RS434-26 and RS434-27: the program starts again at line 0, and AX keeps its value.
    rig.write(at::MODE_USER_PROGRAM, 2);
    assert_eq!([at::STATUS_USER_PROGRAM, at::AX, at::PC].map(|address| rig.read(address)), [2, 2, 0]);
}

/// An instruction takes 100 µs (RS434-25), so 10,000 run per second.
#[test]
fn section_6_9_an_instruction_takes_100_us() {
    let mut rig = Rig::default();
    rig.load(&[add(0, 1), skip(-1)]);
    rig.run();
    assert_eq!(rig.read(at::AX), 1);
    rig.after(1.secs());
    assert_eq!(rig.read(at::AX), 5_001);
}

/// RS434-26: MODE_USER_PROGRAM 1 stops the program with status 1, and registers keep their values. Writing 2
/// has no effect on a running program. Writing 3 is only stored.
#[test]
fn section_6_5_mode_user_program() {
    let mut rig = Rig::default();
    rig.load(&[add(0, 1), jump(0)]);
    rig.write(at::MODE_USER_PROGRAM, 3);
    rig.after(1.millis());
    assert_eq!([at::MODE_USER_PROGRAM, at::STATUS_USER_PROGRAM].map(|address| rig.read(address)), [3, 1]);
    rig.run();
    rig.after(10.millis());
    let before = rig.read(at::AX);
    for mode in [2, 3] {
        rig.write(at::MODE_USER_PROGRAM, mode);
        assert_eq!(rig.read(at::STATUS_USER_PROGRAM), status::RUNS);
        assert_eq!(rig.read(at::MODE_USER_PROGRAM), mode);
    }
    rig.after(1.millis());
    assert_eq!(rig.read(at::AX), before + 5);
    rig.write(at::SPEED, 500);
    rig.write(at::MODE_USER_PROGRAM, 1);
    assert_eq!([at::STATUS_USER_PROGRAM, at::MODE_USER_PROGRAM].map(|address| rig.read(address)), [1, 1]);
    rig.after(10.millis());
    assert_eq!((rig.read(at::AX), rig.read(at::SPEED)), (before + 5, 500));
}

/// If MODE_USER_PROGRAM was saved as 3, the program starts at power-on. Its status is first 3, then 4.
/// RS434-26: the register still reads 3.
#[test]
fn section_6_5_start_at_power_on() {
    let mut rig = Rig::default();
    rig.load(&[add(0, 1), jump(0)]);
    rig.write(at::AX, 100);
    rig.write(at::MODE_USER_PROGRAM, 3);
    rig.save();
    assert_eq!(rig.read(at::STATUS_USER_PROGRAM), 1);
    rig.bench.power(rig.seat, PowerAction::Off);
    rig.after(1.secs());
    rig.bench.power(rig.seat, PowerAction::On);
    rig.after(Duration::TICK * 2);
    let row = rig.bench.spec(rig.seat).find("STATUS_USER_PROGRAM").expect("a register").row;
    let mut seen = vec![rig.bench.peek(rig.seat, row)];
    while *seen.last().expect("one") != 4 {
        rig.after(25.micros());
        assert!(rig.now().ticks() < 4 * 16_000_000, "never status 4: {seen:?}");
        let status = rig.bench.peek(rig.seat, row);
        if status != seen[seen.len() - 1] {
            seen.push(status);
        }
    }
    assert!(seen.ends_with(&[3, 4]), "{seen:?}");
    rig.after(1.secs());
    assert_eq!(rig.read(at::MODE_USER_PROGRAM), 3);
    // RS434-9: AX is 0 after power-on.
    assert!((5_000..10_000).contains(&rig.read(at::AX)));
}

/// RS434-26: if MODE_USER_PROGRAM was saved as 2, the program does not start at power-on.
#[test]
fn section_6_5_a_saved_start() {
    let mut rig = Rig::default();
    rig.load(&[mov(0, 1), END]);
    rig.write(at::MODE_USER_PROGRAM, 2);
    rig.after(1.millis());
    rig.save();
    rig.power_cycle();
    rig.after(1.secs());
    assert_eq!([at::STATUS_USER_PROGRAM, at::AX].map(|address| rig.read(address)), [1, 0]);
}

/// The program of a new drive has only ENDs (RS434-28).
#[test]
fn section_6_6_a_new_drive() {
    let mut rig = Rig::default();
    rig.run();
    rig.after(1.millis());
    assert_ended(&mut rig, status::END, 0);
}

/// RS434-27: a start clears only bit 8, empties the stacks, and keeps AX to JX.
#[test]
fn section_6_5_a_start_after_an_error() {
    let mut rig = Rig::default();
    // A CALL and a FOR are open when the program fails.
    rig.load(&[call(1), repeat(9, 9), add(0, 1), 0x7F]);
    for starts in 1..=20 {
        rig.run();
        rig.after(1.millis());
        assert_eq!(rig.read(at::AX), starts);
        assert_ended(&mut rig, status::ERROR, 3);
    }
    assert_eq!(rig.try_write(at::SPEED, 1), Err(3));
    assert_eq!(rig.read(at::ERROR), 0x2100);
    rig.write(at::MODE_USER_PROGRAM, 2);
    assert_eq!(rig.read(at::ERROR), 0x2000);
}

/// Section 6.7 has AX to JX on the bus: a master can pass parameters to a running program, and read its
/// results.
#[test]
fn section_6_7_a_master_and_a_program() {
    // The program waits until AX = BX, then sets CX to 1.
    let mut rig = Rig::default();
    rig.load(&[jump_unless_equal(0), mov(2, 1), END]);
    rig.write(at::AX, 5);
    rig.run();
    rig.after(1.secs());
    assert_eq!([at::STATUS_USER_PROGRAM, at::PC, CX].map(|address| rig.read(address)), [4, 0, 0]);
    assert_eq!(rig.try_write(at::PC, 1), Err(2), "RS434-2");
    rig.write(BX, 5);
    rig.after(1.millis());
    assert_eq!(rig.read(CX), 1);
    assert_ended(&mut rig, status::END, 2);
}

/// A program that reads STATUS_USER_PROGRAM and PC gets its own status and line.
#[test]
fn section_6_9_a_program_sees_itself() {
    let mut rig = ran(&[get(0, 2, 0x3009), get(1, 3, 0x7006), get(2, 3, 0x7006), END]);
    assert_eq!(rig.try_words(3, at::AX, 3), Ok(vec![4, 1, 2]));
}

// DELAY.

/// DELAY lasts exactly its time in ms. PC stays at its line (RS434-25).
#[test]
fn section_6_9_delay() {
    for (ms, lasts) in [(1, 1.millis()), (0, LINE), (250, 250.millis()), (65_535, 65_535.millis())] {
        let mut rig = Rig::default();
        rig.load(&[mov(0, 1), delay(ms), mov(0, 2), END]);
        let [ax, pc] = ["AX_REG", "PC_REG"].map(|name| rig.bench.spec(rig.seat).find(name).expect("it").row);
        let peek = |rig: &Rig| (rig.bench.peek(rig.seat, ax), rig.bench.peek(rig.seat, pc));
        rig.write(at::MODE_USER_PROGRAM, 2);
        while peek(&rig) != (1, 0) {
            rig.after(Duration::TICK);
        }
        rig.after(LINE);
        assert_eq!(peek(&rig), (1, 1), "{ms} ms");
        rig.after(lasts - Duration::TICK);
        assert_eq!(peek(&rig), (1, 1), "{ms} ms");
        rig.after(Duration::TICK);
        assert_eq!(peek(&rig), (2, 2), "{ms} ms");
    }
}

/// Stopping a program that waits takes effect at once.
#[test]
fn section_6_9_a_stop_ends_a_delay() {
    let mut rig = Rig::default();
    rig.load(&[delay(60_000), mov(0, 1)]);
    rig.run();
    rig.after(1.secs());
    rig.write(at::MODE_USER_PROGRAM, 1);
    rig.after(100.secs());
    assert_eq!([at::STATUS_USER_PROGRAM, at::AX].map(|address| rig.read(address)), [1, 0]);
}

// Jumps.

/// RS434-29: a relative jump counts from its own line, also backward. A target before line 0 is an error.
#[test]
fn section_6_9_relative_jumps() {
    let mut rig = ran(&[jump(3), mov(0, 1), END, skip(-2), END]);
    assert_eq!(rig.read(at::AX), 1);
    assert_ended(&mut rig, status::END, 2);
    assert_ended(&mut ran(&[delay(0), skip(-2)]), status::ERROR, 1);
    // A jump by 0 goes to itself: it never ends, and the drive still answers.
    let mut rig = ran(&[skip(0)]);
    assert_ended(&mut rig, status::RUNS, 0);
    assert_ended(&mut ran(&[jump(1_000)]), status::END, 1_000);
}

/// RS434-31: a jump to the line of a constant executes that line.
#[test]
fn section_6_9_a_jump_onto_a_constant() {
    let mut rig = ran(&[jump(2), put(3, at::SPEED), mov(0, 9), END]);
    assert_eq!((rig.read(at::AX), rig.read(at::SPEED)), (9, 1_000));
    assert_ended(&mut rig, status::END, 3);
}

/// RS434-29: a program that continues past line 1,023 fails, also if only the constant of its last
/// instruction would be there.
#[test]
fn section_6_9_past_the_last_line() {
    for last in
        [delay(0), mov(0, 1), put(3, at::SPEED), cmd::fields(0x10, 0, 0, 0), repeat(1, 1), repeat(3, 0)]
    {
        let mut rig = Rig::default();
        rig.load(&[jump(1_023)]);
        assert_eq!(rig.try_write_all(at::WRITE_CMD, &[1_023, last as u16, (last >> 16) as u16]), Ok(()));
        rig.write(at::SAVE_PROGRAM, key::SAVE_PROGRAM);
        rig.after(SAVE);
        rig.run();
        rig.after(1.millis());
        assert_ended(&mut rig, status::ERROR, 1_023);
        assert_eq!(rig.read(at::SPEED), 1_000);
    }
}

// CALL, RETURN, FOR.

#[test]
fn section_6_9_call_and_return() {
    let mut rig = ran(&[call(4), add(0, 1), END, END, add(0, 0x10), call(7), RETURN, add(0, 0x100), RETURN]);
    assert_eq!(rig.read(at::AX), 0x111);
    assert_ended(&mut rig, status::END, 2);
}

/// Calls nest 16 deep (RS434-30), and the 17th fails. AX counts them.
#[test]
fn section_6_9_calls_nest_16_deep() {
    let mut rig = ran(&[add(0, 1), call(0)]);
    assert_eq!(rig.read(at::AX), 17);
    assert_ended(&mut rig, status::ERROR, 1);
    let mut sixteen: Vec<u32> = (1..=16).map(call).collect();
    sixteen.push(RETURN);
    let mut rig = Rig::default();
    // Each line calls the next one, so all 16 levels are open when line 16 runs. A RETURN would go to the
    // line after its CALL.
    sixteen.insert(16, mov(1, 1));
    rig.load(&sixteen);
    rig.run();
    rig.after(LINE * 16);
    assert_eq!([BX, at::PC, at::STATUS_USER_PROGRAM].map(|address| rig.read(address)), [1, 16, 4]);
}

/// "0x17 = 23 commands executed in a loop, 0x05 = 5 - the number of repetitions": the loop runs 5 times in
/// all.
#[test]
fn section_6_9_the_manuals_loop() {
    let mut lines = vec![0x1705_000C];
    lines.extend([add(0, 1); 23]);
    lines.push(END);
    let mut rig = ran(&lines);
    assert_eq!(rig.read(at::AX), 5 * 23);
    assert_ended(&mut rig, status::END, 24);
}

/// Asserts how often lines of a program run. Each of these lines adds 1 to its own register.
#[track_caller]
fn assert_counts(lines: &[u32], counts: [u16; 3], pc: u16) {
    let mut rig = ran(lines);
    assert_eq!(rig.try_words(3, at::AX, 3), Ok(counts.to_vec()), "{lines:08X?}");
    assert_ended(&mut rig, status::END, pc);
}

/// Loops as in RS434-30.
#[test]
fn section_6_9_loops() {
    let [a, b, c] = [0, 1, 2].map(|register| add(register, 1));
    // The body runs 0, 1 or 255 times. An empty body is allowed.
    assert_counts(&[repeat(1, 0), a, b, END], [0, 1, 0], 3);
    assert_counts(&[repeat(1, 1), a, b, END], [1, 1, 0], 3);
    assert_counts(&[repeat(1, 255), a, b, END], [255, 1, 0], 3);
    assert_counts(&[repeat(0, 255), a, b, END], [1, 1, 0], 3);
    // Nested loops, also with the same end.
    assert_counts(&[repeat(3, 3), repeat(1, 4), a, b, c, END], [12, 3, 1], 5);
    assert_counts(&[repeat(2, 3), repeat(1, 4), a, b, END], [12, 1, 0], 4);
    assert_counts(&[repeat(3, 2), repeat(2, 2), repeat(1, 2), a, b, END], [8, 1, 0], 5);
    // A jump to the line after the body ends a round.
    assert_counts(&[repeat(3, 3), a, skip(2), b, c, END], [3, 0, 1], 5);
    // A jump out of the body ends the loop. A jump inside it does not.
    assert_counts(&[repeat(2, 3), a, jump(4), b, c, END], [1, 0, 1], 5);
    assert_counts(&[repeat(4, 3), skip(2), b, a, skip(1), c, END], [3, 0, 1], 6);
    // A jump out of the inner loop ends only that loop.
    assert_counts(&[repeat(4, 2), repeat(2, 5), a, skip(2), b, c, END], [2, 0, 1], 6);
    assert_counts(&[repeat(5, 2), repeat(2, 5), a, skip(2), b, b, c, END], [2, 2, 1], 7);
    // A loop of 0 rounds, at the end of another loop's body.
    assert_counts(&[repeat(2, 3), a, repeat(0, 0), b, END], [3, 1, 0], 4);
    // Constants count as lines (RS434-30).
    assert_counts(&[repeat(2, 3), cmd::fields(0x3E, 0, 0, 0), 1, b, END], [3, 1, 0], 4);
}

/// A loop belongs to its CALL level (RS434-30). So a subroutine may lie anywhere, also in the body or
/// directly after it.
#[test]
fn section_6_9_loops_and_subroutines() {
    let [a, b, c] = [0, 1, 2].map(|register| add(register, 1));
    assert_counts(&[repeat(1, 3), call(4), b, END, a, RETURN], [3, 1, 0], 3);
    assert_counts(&[repeat(2, 3), call(5), c, b, END, a, RETURN], [3, 1, 3], 4);
    // The subroutine is the line after the body. Calling it does not end a round.
    let mut rig = ran(&[repeat(1, 3), call(2), a, RETURN]);
    assert_eq!(rig.read(at::AX), 4);
    assert_ended(&mut rig, status::ERROR, 3);
}

/// RETURN ends the loops of its subroutine (RS434-30).
#[test]
fn section_6_9_return_ends_loops() {
    let [a, b, _] = [0, 1, 2].map(|register| add(register, 1));
    assert_counts(&[repeat(1, 2), call(4), b, END, repeat(9, 9), a, RETURN], [2, 1, 0], 3);
    // If RETURN left the two loops open, the fourth call would exceed the eight levels.
    assert_counts(&[repeat(1, 20), call(4), b, END, repeat(9, 9), repeat(7, 7), a, RETURN], [20, 1, 0], 3);
}

/// Loops nest 8 deep (RS434-30), and the ninth fails.
#[test]
fn section_6_9_loops_nest_8_deep() {
    let mut lines: Vec<u32> = (1..=8).rev().map(|left| repeat(left, 2)).collect();
    lines.extend([add(0, 1), END]);
    let mut rig = ran(&lines);
    assert_eq!(rig.read(at::AX), 256);
    assert_ended(&mut rig, status::END, 9);
    let mut lines: Vec<u32> = (1..=9).rev().map(|left| repeat(left, 2)).collect();
    lines.extend([add(0, 1), END]);
    let mut rig = ran(&lines);
    assert_eq!(rig.read(at::AX), 0);
    assert_ended(&mut rig, status::ERROR, 8);
}

// Effects of a program on the motor and the settings.

/// A program's write of a coil acts like one from the bus. END leaves the motor turning (6.9), and coil 2001h
/// stops it.
#[test]
fn section_6_9_end_leaves_the_motor_turning() {
    let mut rig = ran(&[put(1, at::START), 1, END]);
    assert_ended(&mut rig, status::END, 2);
    assert_eq!(rig.read(at::STATUS), 1);
    rig.write(at::STOP, 1);
    rig.after(1.secs());
    assert_eq!(rig.read(at::STATUS), 0);
}

/// Ways to write a 1 to START: NOT of the 0 that START reads, adding or subtracting a constant, a pair with 0
/// for STOP, a register, OR with a register (RS434-32: any value other than 0 is 1).
#[test]
fn section_6_9_ways_to_start() {
    let starts: [&[u32]; 6] = [
        &[cmd::fields(0x16, 0, 1, at::START)],
        &[cmd::fields(0x28, 0, 1, at::START), 0x100],
        &[cmd::fields(0x29, 0, 1, at::START), 0x1],
        &[cmd::fields(0x12, 0, 1, at::START), 0x0000_8000],
        &[mov(0, 2), cmd::fields(0x02, 0, 1, at::START)],
        &[mov(0, 2), cmd::fields(0x35, 0, 1, at::START)],
    ];
    for start in starts {
        let mut rig = ran(&[start, &[END]].concat());
        assert_eq!(rig.read(at::STATUS), 1, "{start:08X?}");
    }
    // Writing 0 has no effect. If START and STOP are written together, STOP counts (RS434-6).
    let idles: [&[u32]; 4] = [
        &[put(1, at::START), 0],
        &[cmd::fields(0x2F, 0, 1, at::START), 1],
        &[cmd::fields(0x18, 0, 1, at::START)],
        &[cmd::fields(0x12, 0, 1, at::START), 0x0001_0001],
    ];
    for idle in idles {
        let mut rig = ran(&[idle, &[END]].concat());
        assert_eq!(rig.read(at::STATUS), 0, "{idle:08X?}");
        assert_ended(&mut rig, status::END, idle.len() as u16);
    }
}

/// Stopping a program over the bus leaves the motor turning (RS434-27).
#[test]
fn section_6_5_a_stop_by_the_bus_leaves_the_motor_turning() {
    let mut rig = ran(&[put(1, at::START), 1, skip(0)]);
    rig.write(at::MODE_USER_PROGRAM, 1);
    rig.after(1.secs());
    assert_eq!((rig.read(at::STATUS), rig.read(at::STATUS_USER_PROGRAM)), (1, 1));
}

/// "All registers and the state of the motor return to their original values, and the motor stops."
/// RS434-27 says which registers.
#[test]
fn section_6_9_full_stop() {
    let mut rig = Rig::default();
    let position_4 = at::TARGET_POSITION4;
    rig.load(&[
        mov(0, 77),
        put(3, at::SPEED),
        600,
        put(3, at::TIMEOUT),
        1,
        put(3, position_4),
        55,
        put(3, at::SPEED), // out of range: bit 13
        1,
        put(1, at::START),
        1,
        delay(500),
        ENDF,
    ]);
    rig.write(at::AX, 5);
    rig.write(at::SPEED, 700);
    rig.write(position_4, 44);
    rig.run();
    rig.after(400.millis());
    assert_eq!(
        [at::AX, at::SPEED, position_4, at::STATUS].map(|address| rig.read(address)),
        [77, 600, 55, 1]
    );
    // What a master writes meanwhile is lost, too, except in the registers of the buffer.
    rig.write(BX, 9);
    rig.write(at::DEC, 50);
    rig.write(at::CMD_W, 0x1234);
    rig.after(1.secs());
    assert_eq!([at::STATUS_USER_PROGRAM, at::PC].map(|address| rig.read(address)), [status::ENDF, 0]);
    assert_eq!([at::AX, BX, at::SPEED, position_4].map(|address| rig.read(address)), [5, 0, 700, 44]);
    assert_eq!([at::DEC, at::STATUS].map(|address| rig.read(address)), [100, 0]);
    assert_eq!([at::ERROR, at::TIMEOUT, at::CMD_W].map(|address| rig.read(address)), [0x2000, 1, 0x1234]);
    assert_eq!(rig.read(at::MODE_USER_PROGRAM), 2);
}

/// The motor stops with the DEC from before the program, even if its move started with another DEC
/// (RS434-27).
#[test]
fn section_6_9_full_stop_in_a_move() {
    let mut rig = Rig::default();
    let program = [put(3, at::DEC), 10, put(3, at::MODE_ROTATION), 2, put(1, at::START), 1, delay(500), ENDF];
    rig.load(&program);
    rig.write(at::SPEED, 2_400);
    rig.write_long(at::OFFSET, 30_000);
    rig.run();
    rig.after(500.millis());
    assert_eq!([at::STATUS, at::DEC].map(|address| rig.read(address)), [1, 10]);
    // From 40 turns/s a stop takes 73 ms with DEC 100 (545 rps²), and 400 ms with DEC 10 (100 rps²).
    rig.after(200.millis());
    let registers = [at::STATUS_USER_PROGRAM, at::DEC, at::STATUS].map(|address| rig.read(address));
    assert_eq!(registers, [status::ENDF, 100, 0]);
}

/// An error stops the motor (RS434-33).
#[test]
fn section_6_9_an_error_stops_the_motor() {
    let mut rig = Rig::default();
    rig.load(&[put(1, at::START), 1, delay(500), RETURN]);
    rig.run();
    rig.after(400.millis());
    assert_eq!(rig.read(at::STATUS), 1);
    rig.after(1.secs());
    assert_ended(&mut rig, status::ERROR, 3);
    assert_eq!(rig.read(at::STATUS), 0);
    // Bit 8 is a warning, so the bus can start the motor (RS434-23).
    rig.write(at::START, 1);
    rig.after(1.secs());
    assert_eq!(rig.read(at::STATUS), 1);
    rig.write(at::ERROR, 0);
    assert_eq!(rig.read(at::ERROR), 0);
}

/// A program cannot overwrite itself: writing 8426h is an error (RS434-28), and the flash does not change.
#[test]
fn section_6_9_a_program_that_saves_programs() {
    let mut rig = Rig::default();
    rig.load(&[mov(0, 1), put(3, at::SAVE_PROGRAM), key::SAVE_PROGRAM.into(), mov(0, 2), END]);
    // The buffer has a program that ends at once.
    assert_eq!(rig.try_write_all(at::WRITE_CMD, &[0, 0, 0]), Ok(()));
    rig.run();
    rig.after(1.millis());
    assert_ended(&mut rig, status::ERROR, 1);
    assert_eq!(rig.read(at::AX), 1);
    rig.write(at::AX, 0);
    rig.run();
    rig.after(1.millis());
    assert_eq!(rig.read(at::AX), 1);
}

/// A program may restart the drive, and save its settings.
#[test]
fn section_6_9_keys_in_a_program() {
    let mut rig = Rig::default();
    rig.load(&[add(0, 1), put(3, at::RESTART), 0x95AF, skip(0)]);
    rig.run();
    rig.after(2.secs());
    assert_eq!([at::AX, at::STATUS_USER_PROGRAM].map(|address| rig.read(address)), [0, 1]);
    rig.load(&[put(3, at::SPEED), 800, put(3, at::SAVE_INI), 0x37FA, END]);
    rig.run();
    rig.after(1.secs());
    rig.restart();
    assert_eq!(rig.read(at::SPEED), 800);
}
