//! How fast a user program of an RS 434544 runs. As users run it, through `dyn Device` and `dyn Sink`, a deadline
//! at a time, with the motor that stands.
//!
//! Time is the least of many runs. Instructions are counted by valgrind.

#[path = "support/count.rs"]
mod count;
#[path = "support/mod.rs"]
mod support;

use std::hint::black_box;

use standin_firmware::device::{Boot, Device, Duration, Instant, Output, Sink};
use standin_firmware::rs434::program::image;
use standin_firmware::rs434::{MEMORY, rs434544};

use support::{line, took};

const AX: u32 = 0;
const BX: u32 = 1;
const CX: u32 = 2;
const DX: u32 = 3;
const EX: u32 = 4;
const GX: u32 = 6;

const INPUT: u32 = 2;
const HOLDING: u32 = 3;

const STATUS: u32 = 0x3000;
const CURRENT_POSITION: u32 = 0x3003;
const SPEED: u32 = 0x500B;

/// A line of a program with these fields, from its low end on: uCmd, bTypeJmp, uAdrSysReg, uTypeModbusReg, uData.
const fn code(command: u32, type_jmp: u32, register: u32, space: u32, data: u32) -> u32 {
    command | type_jmp << 7 | register << 8 | space << 12 | data << 16
}

/// What is measured: a program of which every line but the first one is carried out again and again. AX counts
/// the rounds.
struct Work {
    name: &'static str,
    program: &'static [u32],
    /// Lines that are carried out in a round.
    lines: u32,
}

const ADD_AX_1: u32 = code(0x19, 0, AX, 0, 1);
const JMP_1: u32 = code(0x05, 0, 0, 0, 1);
const MOV_SYSREG_CONST: u32 = code(0x01, 0, AX, 0, 0);

const WORKS: [Work; 3] = [
    Work {
        name: "mixed",
        program: &[
            MOV_SYSREG_CONST,
            ADD_AX_1,
            // 2: MOV_SYSREG_SYSREG from AX to BX, MUL_SYSREG_CONST.
            code(0x0F, 0, AX, 0, BX),
            code(0x1C, 0, BX, 0, 3),
            // 4: MOV_SYSREG_MODBUS.
            code(0x03, 0, CX, INPUT, STATUS),
            // 5: JMP_AX_NOPARI_BX to the next line.
            code(0x07, 1, 0, 0, 1),
            // 6: FOR three lines, twice: DADD_SYSREG_CONST, XOR_SYSREG_SYSREG.
            code(0x0C, 0, 0, 0, 0x0302),
            code(0x3E, 0, GX, 0, 0),
            5,
            code(0x3D, 0, DX, 0, AX),
            // 10: CALL, DMOV_SYSREG_MODBUS, MOV_MODBUS_CONST.
            code(0x0A, 0, 0, 0, 15),
            code(0x11, 0, EX, INPUT, CURRENT_POSITION),
            code(0x0E, 0, 0, HOLDING, SPEED),
            1_000,
            JMP_1,
            // 15: SH_SYSREG_CONST, RETURN.
            code(0x20, 0, BX, 0, 1),
            0x0B,
        ],
        lines: 16,
    },
    Work {
        name: "system registers",
        program: &[
            MOV_SYSREG_CONST,
            ADD_AX_1,
            // XOR_SYSREG_SYSREG, DADD_SYSREG_SYSREG, OR_SYSREG_CONST, DSH_SYSREG_CONST.
            code(0x3D, 0, DX, 0, AX),
            code(0x5C, 0, GX, 0, CX),
            code(0x1E, 0, BX, 0, 0x55),
            code(0x45, 1, GX, 0, 1),
            // JMP_AX_LESS_BX to the next line.
            code(0x09, 1, 0, 0, 1),
            JMP_1,
        ],
        lines: 7,
    },
    Work {
        name: "registers of the bus",
        program: &[
            MOV_SYSREG_CONST,
            ADD_AX_1,
            // MOV_SYSREG_MODBUS, DMOV_SYSREG_MODBUS, MOV_MODBUS_CONST, MOV_MODBUS_SYSREG to DX_REG at 7003h.
            code(0x03, 0, CX, HOLDING, SPEED),
            code(0x11, 0, EX, INPUT, CURRENT_POSITION),
            code(0x0E, 0, 0, HOLDING, SPEED),
            1_000,
            code(0x02, 0, AX, HOLDING, 0x7003),
            JMP_1,
        ],
        lines: 6,
    },
];

/// A flash, and nothing else.
struct World {
    memory: Vec<u8>,
}

impl Sink for World {
    fn put(&mut self, _at: Instant, _output: Output<'_>) {}

    fn memory(&self) -> &[u8] {
        &self.memory
    }
}

/// A drive of which the compiler knows nothing here, with a program that has been started.
fn start(work: &Work) -> (Box<dyn Device>, World) {
    let image = image(work.program.iter().copied());
    let mut world = World { memory: vec![0xFF; MEMORY] };
    world.memory[MEMORY - image.len()..].copy_from_slice(&image);
    let mut drive: Box<dyn Device> = black_box(Box::new(rs434544()));
    drive.power_on(Instant::ZERO, Boot { seed: 1, fast: true }, &mut world);
    drive.timeout(Instant::ZERO, &mut world);
    let at = Instant::from(Duration::secs(1));
    let row = row(&*drive, "MODE_USER_PROGRAM");
    drive.poke(at, row, 2, &mut world).expect("the program starts");
    (drive, world)
}

fn row(drive: &dyn Device, register: &str) -> usize {
    drive.spec().find(register).expect("a register of the drive").row
}

/// So many rounds, checked.
fn run(work: &Work, rounds: u64) {
    let (mut drive, mut world) = start(work);
    let out: &mut dyn Sink = black_box(&mut world);
    for _ in 0..1 + rounds * u64::from(work.lines) {
        drive.timeout(drive.deadline(), out);
    }
    let at = drive.deadline();
    let read = |register| drive.peek(at, row(&*drive, register));
    assert_eq!(read("STATUS_USER_PROGRAM"), 4, "{}", work.name);
    assert_eq!(read("AX_REG").cast_unsigned(), rounds % 0x1_0000, "{}", work.name);
    assert_eq!(work.program[read("PC_REG") as usize], if rounds == 0 { MOV_SYSREG_CONST } else { JMP_1 });
    assert_eq!(read("ERROR"), 0, "{}", work.name);
}

fn main() {
    if let Some((name, rounds)) = count::wanted() {
        let work = WORKS.iter().find(|work| work.name == name).expect("a work of this benchmark");
        run(work, rounds);
        return;
    }
    println!("lines of a user program of an RS 434544");
    let mut all_counted = true;
    for work in &WORKS {
        const ROUNDS: u32 = 10_000;
        let least = (0..200).map(|_| took(|| run(work, ROUNDS.into()))).min().unwrap_or_default();
        let lines = f64::from(work.lines);
        let ns = least.as_nanos() as f64 / f64::from(ROUNDS) / lines;
        let instructions = count::instructions(work.name, 1_000, 11_000);
        all_counted &= instructions.is_some();
        let counted = count::counted(instructions.map(|all| all / lines));
        line(work.name, &format!("{:.1} million/s, {ns:.1} ns, {counted}", 1_000.0 / ns));
    }
    count::warn_unless(all_counted);
}
