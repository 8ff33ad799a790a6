//! Speed of a user program of an RS 434544. It runs as for users: through `dyn Device` and `dyn Context`, one
//! deadline at a time, with the motor at rest.
//!
//! The time is the shortest of many runs. valgrind counts the instructions.

#[path = "support/count.rs"]
mod count;
#[path = "support/programs.rs"]
mod programs;
#[path = "support/mod.rs"]
mod support;

use std::hint::black_box;

use drivetwin_firmware::device::{Boot, Context, Device, Duration, Instant, Output};
use drivetwin_firmware::rs434::program::image;
use drivetwin_firmware::rs434::{MEMORY, Rs434};

use programs::{JMP_1, MOV_AX_0, Program};
use support::{line, took};

/// A measured program.
struct Work {
    name: &'static str,
    program: Program,
}

const WORKS: [Work; 3] = [
    Work { name: "mixed", program: programs::MIXED },
    Work { name: "system registers", program: programs::SYSTEM },
    Work { name: "registers of the bus", program: programs::BUS },
];

/// A context with a flash and nothing else.
struct World {
    memory: Vec<u8>,
}

impl Context for World {
    fn put(&mut self, _at: Instant, _output: Output<'_>) {}

    fn memory(&self) -> &[u8] {
        &self.memory
    }
}

/// A drive that the compiler cannot see through, with a started program.
fn start(work: &Work) -> (Box<dyn Device>, World) {
    let image = image(work.program.lines.iter().copied());
    let mut world = World { memory: vec![0xFF; MEMORY] };
    world.memory[MEMORY - image.len()..].copy_from_slice(&image);
    let mut drive: Box<dyn Device> = black_box(Box::new(Rs434::rs434544()));
    drive.power_on(Instant::ZERO, Boot { seed: 1, fast: true, ..Boot::default() }, &mut world);
    drive.timeout(Instant::ZERO, &mut world);
    let at = Instant::from(Duration::secs(1));
    let row = row(&*drive, "MODE_USER_PROGRAM");
    drive.poke(at, row, 2, &mut world).expect("the program starts");
    (drive, world)
}

fn row(drive: &dyn Device, register: &str) -> usize {
    drive.spec().find(register).expect("a register of the drive").row
}

/// Runs `rounds` rounds and checks the result.
fn run(work: &Work, rounds: u64) {
    let (mut drive, mut world) = start(work);
    let out: &mut dyn Context = black_box(&mut world);
    for _ in 0..1 + rounds * u64::from(work.program.per_round) {
        drive.timeout(drive.deadline(), out);
    }
    let at = drive.deadline();
    let read = |register| drive.peek(at, row(&*drive, register));
    assert_eq!(read("STATUS_USER_PROGRAM"), 4, "{}", work.name);
    assert_eq!(read("AX_REG").cast_unsigned(), rounds % 0x1_0000, "{}", work.name);
    assert_eq!(work.program.lines[read("PC_REG") as usize], if rounds == 0 { MOV_AX_0 } else { JMP_1 });
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
        let lines = f64::from(work.program.per_round);
        let ns = least.as_nanos() as f64 / f64::from(ROUNDS) / lines;
        let instructions = count::instructions(work.name, 1_000, 11_000);
        all_counted &= instructions.is_some();
        let counted = count::counted(instructions.map(|all| all / lines));
        line(work.name, &format!("{:.1} million/s, {ns:.1} ns, {counted}", 1_000.0 / ns));
    }
    count::warn_unless(all_counted);
}
