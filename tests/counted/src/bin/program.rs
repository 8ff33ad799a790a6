//! Counts the instructions that a line of a user program of an RS 434544 takes.
#![no_std]
#![no_main]

#[path = "../../../benches/support/programs.rs"]
mod programs;

use core::ffi::CStr;

use cortex_m_rt::entry;
use counted::{count, done, group};
use drivetwin_firmware::device::{Boot, Context, Device, Duration, Instant, Output};
use drivetwin_firmware::motor::DriveWithMotor;
use drivetwin_firmware::rs434::{LINES, MEMORY, Reg, Rs434};
use programs::{BUS, JMP_1, MIXED, MOV_AX_0, Program, SYSTEM};

/// Number of rounds of a program's loop.
const ROUNDS: u32 = 100;

#[entry]
fn main() -> ! {
    lines(c"program: line", &MIXED, &const { Flash::with(MIXED.lines) });
    lines(c"program: line of system registers", &SYSTEM, &const { Flash::with(SYSTEM.lines) });
    lines(c"program: line of registers of the bus", &BUS, &const { Flash::with(BUS.lines) });
    done()
}

/// Runs a program. Not inlined, because RAM has room for one drive.
#[inline(never)]
fn lines(name: &CStr, program: &Program, flash: &'static Flash) {
    let mut drive = Rs434::rs434544();
    let out = &mut Hands(flash);
    drive.power_on(Instant::ZERO, Boot { seed: 1, fast: true, ..Boot::default() }, out);
    drive.timeout(Instant::ZERO, out);
    let started = drive.poke(Instant::from(Duration::secs(1)), Reg::MODE_USER_PROGRAM as usize, 2, out);
    assert!(started.is_ok());
    group(name);
    // The first line of the program is not in its loop, so it runs uncounted.
    carry_out(&mut drive, out);
    for _ in 0..ROUNDS * program.per_round {
        count(|| carry_out(&mut drive, out));
    }
    let read = |reg: Reg| drive.peek(drive.deadline(), reg as usize);
    assert!(read(Reg::STATUS_USER_PROGRAM) == 4 && read(Reg::AX_REG) == i64::from(ROUNDS));
    let at = program.lines.get(read(Reg::PC_REG) as usize);
    assert!(program.lines.first() == Some(&MOV_AX_0) && at == Some(&JMP_1));
}

/// Runs one line of the program, as the loop of a board does.
#[inline(never)]
fn carry_out(drive: &mut DriveWithMotor<Rs434>, out: &mut Hands) {
    drive.timeout(drive.deadline(), out);
}

/// The memory of a new drive with a program in it.
struct Flash([u8; MEMORY]);

impl Flash {
    const fn with(lines: &[u32]) -> Self {
        const PROGRAM: usize = MEMORY - 2 - 4 * LINES;
        let mut memory = [0xFF; MEMORY];
        let mut crc = 0xFFFF;
        let mut n = 0;
        while n < 4 * LINES {
            let byte = if n / 4 < lines.len() { lines[n / 4].to_le_bytes()[n % 4] } else { 0 };
            memory[PROGRAM + n] = byte;
            crc = crc_with(crc, byte);
            n += 1;
        }
        [memory[MEMORY - 2], memory[MEMORY - 1]] = crc.to_be_bytes();
        Self(memory)
    }
}

/// Adds a byte to a CRC-16 of Modbus.
const fn crc_with(mut crc: u16, byte: u8) -> u16 {
    crc ^= byte as u16;
    let mut bit = 0;
    while bit < 8 {
        crc = crc >> 1 ^ if crc & 1 != 0 { 0xA001 } else { 0 };
        bit += 1;
    }
    crc
}

/// A board that has only this memory.
struct Hands(&'static Flash);

impl Context for Hands {
    fn put(&mut self, _at: Instant, _output: Output<'_>) {}

    fn memory(&self) -> &[u8] {
        &self.0.0
    }
}
