//! Tests of sections 6.6 and 6.9 of the manual. The expected values are typed from the manual.

mod calculation;
mod flash;
mod flow;

use std::vec;
use std::vec::Vec;

use drivetwin_protocol::registers::Space;
use drivetwin_protocol::time::Span;

use super::vm::{CannotWrite, Host, Step};
use super::{Program, Status, image, run};
use crate::device::Instant;
use crate::rs434::{LINES, MEMORY};
use crate::testing::Recorder;

const AX: u32 = 0;
const BX: u32 = 1;
const CX: u32 = 2;
const GX: u32 = 6;
const IX: u32 = 8;
const JX: u32 = 9;

const DISCRETE: u32 = 0;
const COIL: u32 = 1;
const INPUT: u32 = 2;
const HOLDING: u32 = 3;

/// A line with these fields, from the lowest bits up: uCmd, bTypeJmp, uAdrSysReg, uTypeModbusReg, uData (fig.
/// 9).
fn line(command: u32, type_jmp: u32, register: u32, space: u32, data: u32) -> u32 {
    command | type_jmp << 7 | register << 8 | space << 12 | data << 16
}

const STOP: u32 = 0x00;
const FULL_STOP: u32 = 0x0D;

fn delay(ms: u32) -> u32 {
    line(0x04, 0, 0, 0, ms)
}

fn jump(target: u32) -> u32 {
    line(0x05, 0, 0, 0, target)
}

fn call(target: u32) -> u32 {
    line(0x0A, 0, 0, 0, target)
}

const RETURN: u32 = 0x0B;

fn repeat(lines: u32, times: u32) -> u32 {
    line(0x0C, 0, 0, 0, lines << 8 | times)
}

/// MOV_SYSREG_CONST.
fn set(register: u32, value: u32) -> u32 {
    line(0x01, 0, register, 0, value)
}

/// ADD_SYSREG_CONST.
fn add(register: u32, value: u32) -> u32 {
    line(0x19, 0, register, 0, value)
}

/// A recorder with a new memory.
fn new_memory() -> Recorder {
    Recorder::new(MEMORY)
}

/// A recorder whose memory holds a program.
fn memory_with(lines: &[u32]) -> Recorder {
    let mut out = new_memory();
    let image = image(lines.iter().copied());
    out.memory[MEMORY - image.len()..].copy_from_slice(&image);
    out
}

/// A drive that consists of a few registers and a program.
struct Drive {
    now: Instant,
    program: Program,
    out: Recorder,
    /// Space, address and value of each register.
    bus: Vec<(Space, u16, u16)>,
    /// Writes to the registers, in sequence.
    written: Vec<(Space, u16, Vec<u16>)>,
    /// A holding register that stops the program when it is written, like MODE_USER_PROGRAM.
    stops: Option<u16>,
}

impl Host for Drive {
    fn program(&mut self) -> &mut Program {
        &mut self.program
    }

    fn memory(&self) -> &[u8] {
        &self.out.memory
    }

    fn read(&mut self, space: Space, first: u16, wide: bool) -> Option<u32> {
        let read = |address| {
            self.bus
                .iter()
                .find(|&&(s, a, _)| (s, a) == (space, address))
                .map(|&(.., value)| u32::from(value))
        };
        let high = if wide { read(first.checked_add(1)?)? } else { 0 };
        Some(read(first)? | high << 16)
    }

    fn write(&mut self, space: Space, first: u16, words: &[u16]) -> Result<bool, CannotWrite> {
        if matches!(space, Space::Discrete | Space::Input) {
            return Err(CannotWrite);
        }
        let places: Vec<_> = (u32::from(first)..).take(words.len()).collect();
        let place = |address: &u32| {
            self.bus.iter().position(|&(s, a, _)| s == space && u32::from(a) == *address).ok_or(CannotWrite)
        };
        let places = places.iter().map(place).collect::<Result<Vec<_>, _>>()?;
        for (place, word) in places.into_iter().zip(words) {
            self.bus[place].2 = *word;
        }
        self.written.push((space, first, words.to_vec()));
        if self.stops == Some(first) {
            self.program.stop();
        }
        Ok(self.stops == Some(first))
    }
}

impl Drive {
    /// A drive with a program in its flash, started at time 0.
    fn running(lines: &[u32]) -> Self {
        let mut drive = Self::off(memory_with(lines));
        assert!(drive.program.power_on(&drive.out), "the image passes");
        drive.program.start(drive.now, Status::StartedByBus);
        drive
    }

    fn off(out: Recorder) -> Self {
        let (now, program) = (Instant::ZERO, Program::new());
        Self { now, program, out, bus: Vec::new(), written: Vec::new(), stops: None }
    }

    fn with_registers(mut self, registers: [u16; 10]) -> Self {
        self.program.vm.registers = registers;
        self
    }

    fn with_bus(mut self, space: Space, first: u16, values: &[u16]) -> Self {
        self.bus.extend(values.iter().enumerate().map(|(n, &value)| (space, first + n as u16, value)));
        self
    }

    /// Goes to the time of the next line and executes the line.
    fn step(&mut self) -> Step {
        self.now = self.program.line_due();
        assert_ne!(self.now, Instant::NEVER, "nothing is due: {:?}", self.program.status());
        let now = self.now;
        run(now, self).unwrap()
    }

    /// Executes lines until the program ends, at most 5,000.
    fn finish(&mut self) -> Status {
        for _ in 0..5_000 {
            if !self.program.is_running() {
                return self.program.status();
            }
            self.step();
        }
        panic!("the program does not end");
    }

    /// Numbers of the next lines that are executed, from PC_REG.
    fn path(&mut self, lines: usize) -> Vec<u16> {
        let mut path = Vec::new();
        for _ in 0..lines {
            self.step();
            path.push(self.program.vm.line);
        }
        path
    }

    fn registers(&self) -> [u16; 10] {
        self.program.vm.registers
    }

    fn word(&mut self, space: Space, address: u16) -> u16 {
        self.read(space, address, false).unwrap() as u16
    }
}

/// The last possible line of a program.
const LAST: u32 = LINES as u32 - 1;
