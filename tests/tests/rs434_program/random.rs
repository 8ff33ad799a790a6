//! Random programs run on the drive and on the [`Oracle`], and are compared after each line.

use std::fmt::Write as _;

use drivetwin_protocol::modbus::rtu::crc;
use drivetwin_protocol::time::{Duration, Instant};
use drivetwin_sim::bench::{PinStimulus, Setup};
use drivetwin_sim::line::LineMode;
use drivetwin_tests::rs434::{LINE, Rig};

use crate::oracle::{LINES, Oracle, status};

const PROGRAMS: u64 = 10_000;

/// Most lines of a program that are compared. Most programs end long before.
const FOLLOWED: usize = 160;

/// SplitMix64, so that the programs are the same on every machine.
struct Rng(u64);

impl Rng {
    fn roll(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut word = self.0;
        word = (word ^ word >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        word = (word ^ word >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
        word ^ word >> 31
    }

    fn below(&mut self, sides: u64) -> u64 {
        self.roll() % sides
    }

    fn one_in(&mut self, n: u64) -> bool {
        self.below(n) == 0
    }

    fn pick<T: Copy>(&mut self, from: &[T]) -> T {
        from[self.below(from.len() as u64) as usize]
    }

    fn word(&mut self) -> u16 {
        match self.below(4) {
            0 => self.pick(&[0, 1, 2, 0x7FFF, 0x8000, 0xFFFF]),
            1 => self.below(16) as u16,
            2 => self.below(2_000) as u16,
            _ => self.roll() as u16,
        }
    }
}

/// Encodes a line from its fields.
fn line(code: u16, jump: u16, system: u16, kind: u16, data: u16) -> u32 {
    u32::from(data) << 16 | u32::from(kind << 12 | system << 8 | jump << 7 | code)
}

/// Replaces TASK_COUNTER, which no oracle can predict, and keys whose effects the oracle does not implement.
fn tame(line: u32) -> u32 {
    match line >> 16 {
        0x3007 | 0x3008 | 0x8426 | 0x9346 | 0x95AF => line & 0xFFFF | 0x3009 << 16,
        _ => line,
    }
}

/// Codes of one-line instructions that neither compare nor jump.
const PLAIN: [u16; 62] = [
    0x01, 0x02, 0x03, 0x0F, 0x11, 0x13, 0x14, 0x15, 0x16, 0x17, 0x18, 0x19, 0x1A, 0x1B, 0x1C, 0x1D, 0x1E,
    0x1F, 0x20, 0x21, 0x22, 0x23, 0x24, 0x25, 0x26, 0x27, 0x30, 0x31, 0x32, 0x33, 0x34, 0x35, 0x36, 0x37,
    0x38, 0x39, 0x3A, 0x3B, 0x3C, 0x3D, 0x45, 0x46, 0x47, 0x48, 0x49, 0x4A, 0x4B, 0x4C, 0x55, 0x56, 0x57,
    0x58, 0x59, 0x5A, 0x5B, 0x5C, 0x5D, 0x5E, 0x5F, 0x60, 0x61, 0x62,
];

/// Codes of instructions whose constant is in the next line.
const DOUBLE: [u16; 25] = [
    0x0E, 0x10, 0x12, 0x28, 0x29, 0x2A, 0x2B, 0x2C, 0x2D, 0x2E, 0x2F, 0x3E, 0x3F, 0x40, 0x41, 0x42, 0x43,
    0x44, 0x4D, 0x4E, 0x4F, 0x50, 0x51, 0x52, 0x53,
];

const JUMPS: [u16; 9] = [0x05, 0x06, 0x07, 0x08, 0x09, 0x63, 0x64, 0x65, 0x66];

/// A Modbus register as kind and address. Nearly all exist, and can be written if `written` is true.
fn register(dice: &mut Rng, written: bool) -> (u16, u16) {
    if dice.one_in(120) {
        let missing = [0x4FFF, 0x5027, 0x5FFF, 0x6006, 0x6FFF, 0x7006, 0x700B, 0xFFFF, 0x0000];
        let (missing, space) = (dice.pick(&missing), dice.below(16) as u16);
        return dice.pick(&[(3, missing), (space, 0x5015)]);
    }
    if !written && dice.one_in(8) {
        let (contact, input) = (dice.below(2) as u16, dice.pick(&[0x3000, 0x3003, 0x3005, 0x8001, 0x8002]));
        return dice.pick(&[(0, 0x1000 + contact), (2, input), (3, 0x7006)]);
    }
    match dice.below(60) {
        0 => (3, 0x5005),
        1..6 => (1, 0x2000 + dice.below(3) as u16),
        6..20 => (3, 0x7000 + dice.pick(&[0, 1, 2, 3, 4, 7, 8, 9])),
        20..28 => (3, 0x6000 + dice.below(5) as u16),
        28..32 => (3, 0x5023),
        32..46 => (3, 0x5006 + dice.below(13) as u16),
        46..50 => (3, 0x5000 + dice.below(4) as u16),
        50 => (3, 0x5024 + dice.below(2) as u16),
        _ => (3, 0x5012 + dice.below(17) as u16),
    }
}

fn system(dice: &mut Rng) -> u16 {
    if dice.one_in(200) { dice.below(16) as u16 } else { dice.below(9) as u16 }
}

/// Adds an instruction of one or two lines that does not jump. Unused fields have random values.
fn plain(dice: &mut Rng, program: &mut Vec<u32>) {
    let jump = dice.below(2) as u16;
    if dice.one_in(3) {
        let (kind, address) = register(dice, true);
        let code = if dice.one_in(20) { 0x54 } else { dice.pick(&DOUBLE) };
        program.push(line(code, jump, system(dice), kind, address));
        program.push(u32::from(dice.word()) << 16 | u32::from(dice.word()));
        return;
    }
    let code = dice.pick(&PLAIN);
    let only_read = matches!(code, 0x03 | 0x11 | 0x21..=0x27 | 0x46..=0x4C);
    let (kind, address) = register(dice, !only_read);
    let data = match code {
        0x0F | 0x14 | 0x37..=0x3D | 0x5C..=0x62 => system(dice),
        0x20 | 0x45 => dice.below(36) as u16,
        0x01 | 0x15 | 0x17 | 0x19..=0x1F => dice.word(),
        _ => address,
    };
    program.push(line(code, jump, system(dice), kind, data));
}

/// Adds an instruction that may continue at another line.
fn flow(dice: &mut Rng, program: &mut Vec<u32>, length: u64, subroutines: &[u16]) {
    let noise = dice.word();
    let (system, kind) = (noise & 15, noise >> 4 & 15);
    let jump = dice.below(2) as u16;
    let word = match dice.below(10) {
        0..4 => {
            let code = if dice.one_in(4) { 0x05 } else { dice.pick(&JUMPS) };
            let near = dice.below(12) as i16 - if dice.one_in(3) { 8 } else { 0 };
            let target = if jump == 1 { near.cast_unsigned() } else { dice.below(length) as u16 };
            line(code, jump, system, kind, target)
        }
        4..7 => line(0x0C, jump, system, kind, (dice.below(7) << 8 | dice.below(5)) as u16),
        7..9 => line(0x0A, jump, system, kind, dice.pick(subroutines)),
        // The program stops itself.
        _ if dice.one_in(5) => line(0x0E, jump, system, 3, 0x5005),
        _ => line(0x04, jump, system, kind, dice.below(4) as u16),
    };
    program.push(word);
    if word & 0x7F == 0x0E {
        program.push(1);
    }
}

/// A program with a main part, followed by subroutines.
fn structured(dice: &mut Rng) -> Vec<u32> {
    let main = 12 + dice.below(30);
    let parts = 1 + dice.below(3);
    let length = main + 10 * parts;
    let mut program = Vec::new();
    // Sets system registers to initial values.
    for register in 0..dice.below(10) as u16 {
        program.push(line(0x01, 0, register, 0, dice.word()));
    }
    let subroutines: Vec<u16> = (0..parts).map(|part| (main + 2 + 10 * part) as u16).collect();
    while (program.len() as u64) < main {
        if dice.one_in(4) {
            flow(dice, &mut program, length, &subroutines);
        } else {
            plain(dice, &mut program);
        }
    }
    program.resize(main as usize, 0);
    program.push(line(dice.pick(&[0x00, 0x05, 0x05, 0x0D]), 0, 3, 7, 0));
    for &start in &subroutines {
        program.resize(usize::from(start), 0);
        for _ in 0..dice.below(6) {
            if dice.one_in(5) {
                flow(dice, &mut program, length, &subroutines);
            } else {
                plain(dice, &mut program);
            }
        }
        program.push(line(0x0B, 1, 5, 9, dice.word()));
    }
    program
}

/// A program of random instructions without a structure.
fn soup(dice: &mut Rng) -> Vec<u32> {
    let mut program = Vec::new();
    while program.len() < 60 {
        match dice.below(12) {
            0..7 => plain(dice, &mut program),
            7..11 => flow(dice, &mut program, 60, &[3, 17, 40, 1_023]),
            _ => program.push(line(dice.pick(&[0x0B, 0x00, 0x0D, 0x67, 0x7F]), 1, 9, 2, dice.word())),
        }
    }
    program
}

fn noise(dice: &mut Rng) -> Vec<u32> {
    (0..LINES).map(|_| dice.roll() as u32).collect()
}

/// A program that finally runs to line 1,024, which does not exist.
fn at_the_end(dice: &mut Rng) -> Vec<u32> {
    let mut program = vec![line(0x05, 0, 0, 0, 1_000)];
    program.resize(1_000, 0);
    while program.len() < LINES {
        if dice.one_in(8) {
            program.push(line(0x0C, 0, 0, 0, (dice.below(12) << 8 | dice.below(3)) as u16));
        } else {
            program.push(line(0x19, 0, dice.below(10) as u16, 0, dice.word()));
        }
    }
    if dice.one_in(2) {
        program[LINES - 1] = line(0x10, 0, 0, 0, 5);
    }
    program
}

fn program(dice: &mut Rng) -> Vec<u32> {
    let mut program = match dice.below(20) {
        0..13 => structured(dice),
        13..16 => soup(dice),
        16..18 => noise(dice),
        18 => at_the_end(dice),
        _ => {
            let mut mixed = structured(dice);
            for _ in 0..3 {
                let place = dice.below(mixed.len() as u64) as usize;
                mixed[place] = dice.roll() as u32;
            }
            mixed
        }
    };
    program.resize(LINES, 0);
    program.into_iter().map(tame).collect()
}

/// Contents of the flash: no settings, the lines with the low byte first, and their CRC.
fn flash(program: &[u32]) -> Vec<u8> {
    // Size of the settings: 5000h to 5020h, and a CRC.
    let settings = [0xFF; 2 * 0x21 + 2];
    let lines: Vec<u8> = program.iter().flat_map(|line| line.to_le_bytes()).collect();
    let sum = crc(&lines).to_be_bytes();
    [&settings[..], &lines, &sum].concat()
}

/// Indices of the registers that are compared with the oracle.
struct View {
    /// AX to JX, PC, STATUS_USER_PROGRAM and ERROR.
    quick: Vec<usize>,
    /// 5000h to 5022h and 6000h to 6005h, with their numbers of words.
    others: Vec<(usize, u16)>,
    start: usize,
    versions: Vec<usize>,
}

impl View {
    fn of(rig: &Rig) -> Self {
        let spec = rig.bench.spec(rig.seat);
        let row = |name: &str| spec.find(name).unwrap_or_else(|| panic!("there is no {name}")).row;
        let quick = [
            "AX_REG",
            "BX_REG",
            "CX_REG",
            "DX_REG",
            "EX_REG",
            "FX_REG",
            "GX_REG",
            "HX_REG",
            "IX_REG",
            "JX_REG",
            "PC_REG",
            "STATUS_USER_PROGRAM",
            "ERROR",
        ];
        let words = [
            "SLAVE_ADDRESS_MODBUS",
            "TYPE_MODBUS",
            "BITRATE_MODBUS",
            "TIMEOUT_BROADCAST_MODBUS",
            "MODE_DEVICE",
            "MODE_USER_PROGRAM",
            "MODE_ROTATION",
            "MODE_EXT_IN",
            "POSITION_N",
            "REF_CURRENT",
            "RATED_SPEED",
            "SPEED",
            "ACC",
            "DEC",
            "DIRECTION",
            "PULSES_PER_REVOLUTION",
            "USE_HALL",
            "MODE_COIL",
            "OFFSET_COMPENSATION",
            "PRESSED_INPUTS_EXTERN",
            "WAITED_INPUTS_EXTERN",
        ];
        let longs = [
            "OFFSET",
            "OFFSET_CONST",
            "TARGET_POSITION",
            "TARGET_POSITION1",
            "TARGET_POSITION2",
            "TARGET_POSITION3",
            "TARGET_POSITION4",
        ];
        let port = [("WRITE_CMD", 1), ("CMD_W", 2), ("READ_CMD", 1), ("CMD_R", 2)];
        let others = words.map(|name| (name, 1)).into_iter().chain(longs.map(|name| (name, 2))).chain(port);
        Self {
            quick: quick.map(row).to_vec(),
            others: others.map(|(name, words)| (row(name), words)).collect(),
            start: row("MODE_USER_PROGRAM"),
            versions: ["HW_MINOR", "FW_MAJOR", "FW_MINOR"].map(row).to_vec(),
        }
    }

    fn peek(rig: &Rig, row: usize) -> i64 {
        rig.bench.peek(rig.seat, row)
    }

    fn quick(&self, rig: &Rig) -> Vec<u16> {
        self.quick.iter().map(|&row| Self::peek(rig, row) as u16).collect()
    }

    fn others(&self, rig: &Rig) -> Vec<u16> {
        let value = |&(row, words): &(usize, u16)| {
            let value = Self::peek(rig, row);
            [value as u16, (value >> 16) as u16].into_iter().take(usize::from(words))
        };
        self.others.iter().flat_map(value).collect()
    }
}

fn quick(oracle: &Oracle) -> Vec<u16> {
    let last = [oracle.pc as u16, oracle.status, oracle.error];
    oracle.system.into_iter().chain(last).collect()
}

fn others(oracle: &Oracle) -> Vec<u16> {
    oracle.settings.into_iter().chain(oracle.port).collect()
}

/// Runs a program on the drive and on the oracle. Returns the final status and the number of lines, or the
/// first difference.
fn compare(seed: u64) -> Result<(u16, usize), String> {
    let mut dice = Rng(seed);
    let program = program(&mut dice);
    let setup = Setup { boot_fast: true, memory: Some(flash(&program)), ..Setup::default() };
    let mut rig = Rig::new("rs434544", LineMode::Fast, setup);
    let view = View::of(&rig);
    rig.drive("HARD_STOP", PinStimulus::High);
    rig.after(Duration::millis(5));
    let mut system = [0; 10];
    for (register, &row) in system.iter_mut().zip(&view.quick) {
        *register = dice.word();
        rig.bench.poke(rig.seat, row, i64::from(*register)).expect("AX..JX can be preset");
    }
    let versions = [0, 1, 2].map(|n| View::peek(&rig, view.versions[n]) as u16);
    rig.bench.poke(rig.seat, view.start, 2).expect("a program can be started");
    let mut oracle = Oracle::new(program, system, versions);
    let mut at: Instant = rig.now() + LINE;
    let mut trail = Vec::new();
    for step in 0..FOLLOWED {
        trail.push((oracle.pc, oracle.program[oracle.pc as usize], quick(&oracle)));
        let next = oracle.step();
        rig.bench.run_until(at);
        let differ = |what: &str, seen: &[u16], expected: &[u16], trail: &[_]| {
            let mut text =
                format!("seed {seed}, step {step}: {what}\n  seen {seen:04X?}\n  not  {expected:04X?}");
            for (pc, line, before) in trail.iter().rev().take(12).rev() {
                let _ = write!(text, "\n  {pc:4} {line:08X} from {before:04X?}");
            }
            Err(text)
        };
        let (seen, expected) = (view.quick(&rig), quick(&oracle));
        if seen != expected {
            return differ("AX..JX PC STATUS ERROR", &seen, &expected, &trail);
        }
        if step % 8 == 0 || next.is_none() {
            let (seen, expected) = (view.others(&rig), others(&oracle));
            if seen != expected {
                return differ("5000h.. 6000h..", &seen, &expected, &trail);
            }
        }
        let Some((lasts, line)) = next else {
            rig.after(LINE * 5);
            let seen = view.quick(&rig);
            if seen != expected {
                return differ("it does not stay", &seen, &expected, &trail);
            }
            return Ok((oracle.status, step + 1));
        };
        at += LINE * lasts;
        rig.bench.run_until(at - Duration::TICK);
        let seen = view.quick(&rig);
        if seen != expected {
            return differ("before the next line", &seen, &expected, &trail);
        }
        oracle.begin(line);
        if oracle.status != status::RUNS {
            rig.bench.run_until(at);
            let (seen, expected) = (view.quick(&rig), quick(&oracle));
            if seen != expected {
                return differ("past line 1,023", &seen, &expected, &trail);
            }
            return Ok((oracle.status, step + 1));
        }
    }
    Ok((oracle.status, FOLLOWED))
}

#[test]
fn section_6_9_random_programs_do_what_the_manual_says() {
    let workers = 4;
    let results = std::thread::scope(|scope| {
        let run = |worker| move || (worker..PROGRAMS).step_by(workers).map(compare).collect::<Vec<_>>();
        let running: Vec<_> = (0..workers as u64).map(|worker| scope.spawn(run(worker))).collect();
        running.into_iter().flat_map(|one| one.join().expect("no panic")).collect::<Vec<_>>()
    });
    let wrong: Vec<&String> = results.iter().filter_map(|result| result.as_ref().err()).collect();
    let first: Vec<&str> = wrong.iter().take(5).map(|text| text.as_str()).collect();
    assert!(wrong.is_empty(), "{} of {PROGRAMS} differ; the first:\n{}", wrong.len(), first.join("\n"));
    // The test is worth something only if programs run for a while and end in every possible way.
    let ended = |status| results.iter().flatten().filter(|(how, _)| *how == status).count() as u64;
    let ways = [status::STOPPED, status::RUNS, status::END, status::ENDF, status::ERROR].map(ended);
    assert!(ways.iter().all(|&count| count > PROGRAMS / 200), "{ways:?}");
    let lines: usize = results.iter().flatten().map(|(_, lines)| lines).sum();
    assert!(lines as u64 > 25 * PROGRAMS, "{lines} lines");
}
