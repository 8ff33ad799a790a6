//! Programs as MC has them, and when each of their lines acts: the first one 210 µs after EX, and so on.

mod anything;
mod examples;
mod flow;
mod oracle;
mod trips;

use std::string::String;
use std::vec;
use std::vec::Vec;

use drivetwin_protocol::time::Span;

use super::super::names::Meaning;
use crate::device::{Boot, Device, Duration, Input, Instant, Level, Link, Output, Pin, Sink, advance};
use crate::mdrive::drive::Drive;
use crate::mdrive::error::Error;
use crate::mdrive::registers::Reg;
use crate::mdrive::{A, ANALOG, B, CAPTURE, IO1, IO4, MCODE, MEMORY, Mdrive, STALL};

/// Whose lines these are.
const CONSOLE: Link = Link(0);

/// What the drive has said, and what it keeps.
struct World {
    memory: Vec<u8>,
    said: String,
    /// Levels of the trip output.
    trip_output: Vec<(Instant, Level)>,
}

impl Sink for World {
    fn put(&mut self, at: Instant, output: Output<'_>) {
        match output {
            Output::Message { port: MCODE, link: CONSOLE, bytes } => {
                self.said.push_str(std::str::from_utf8(bytes).unwrap());
            }
            Output::Store { offset, bytes } => {
                self.memory[usize::from(offset)..][..bytes.len()].copy_from_slice(bytes);
            }
            Output::Level { pin: CAPTURE, level } => self.trip_output.push((at, level)),
            _ => {}
        }
    }

    fn memory(&self) -> &[u8] {
        &self.memory
    }
}

/// A drive that is ready, what is around it, and what time it is.
struct Bed {
    mdrive: Mdrive,
    world: World,
    now: Instant,
}

impl Bed {
    fn new(mut mdrive: Mdrive) -> Self {
        let mut world = World { memory: vec![0xFF; MEMORY], said: String::new(), trip_output: Vec::new() };
        mdrive.power_on(Instant::ZERO, Boot { fast: true, ..Boot::default() }, &mut world);
        let mut bed = Self { mdrive, world, now: Instant::ZERO };
        bed.input(Input::Opened { port: MCODE, link: CONSOLE });
        bed
    }

    /// With lines in its program, from address 1 on.
    fn with(lines: &str) -> Self {
        let mut bed = Self::new(Mdrive::plus());
        bed.store(1, lines);
        bed
    }

    /// Stores lines, which semicolons or ends of lines separate.
    fn store(&mut self, first: u16, lines: &str) {
        let lines = lines.split([';', '\n']).map(str::trim).filter(|line| !line.is_empty());
        for (address, line) in (first..).zip(lines) {
            let (drive, line) = (&mut self.mdrive.drive, line.as_bytes());
            let statement = drive.parse(line).unwrap();
            drive.store_line(self.now, address, line, &statement, &mut self.world).unwrap();
        }
    }

    fn drive(&self) -> &Drive {
        &self.mdrive.drive
    }

    fn wait(&mut self, span: Duration) {
        self.now += span;
        advance(&mut self.mdrive, self.now, std::iter::empty(), &mut self.world);
    }

    /// As many lines of a program.
    fn lines(&mut self, count: u64) {
        self.wait(210.micros() * count);
    }

    fn input(&mut self, input: Input<'_>) {
        advance(&mut self.mdrive, self.now, std::iter::once((self.now, input)), &mut self.world);
    }

    /// A level at a pin.
    fn level(&mut self, pin: Pin, high: bool) {
        self.input(Input::Edge { pin, high });
    }

    /// An immediate command.
    fn command(&mut self, line: &str) -> Result<(), Error> {
        let drive = &mut self.mdrive.drive;
        let done =
            drive.parse(line.as_bytes()).and_then(|it| drive.execute(self.now, &it, false, &mut self.world));
        if let Err(error) = done {
            drive.fail(self.now, error, &mut self.world);
        }
        drive.settle(self.now, &mut self.world);
        done
    }

    /// Immediate commands that are taken.
    fn commands(&mut self, lines: &str) {
        for line in lines.split([';', '\n']).map(str::trim).filter(|line| !line.is_empty()) {
            self.command(line).unwrap_or_else(|error| panic!("{line}: {error:?}"));
        }
    }

    /// Runs the program at 1 until it ends, for a minute at most.
    fn run(&mut self) {
        self.commands("EX 1");
        self.run_to_end();
    }

    fn run_to_end(&mut self) {
        for _ in 0..60_000 {
            if self.get(Reg::BY) == 0 {
                return;
            }
            self.wait(1.millis());
        }
        panic!("the program runs on");
    }

    fn get(&self, reg: Reg) -> i32 {
        self.drive().read(self.now, reg)
    }

    /// R1 to R4.
    fn r(&self) -> [i32; 4] {
        [Reg::R1, Reg::R2, Reg::R3, Reg::R4].map(|reg| self.get(reg))
    }

    /// A user variable.
    fn user(&self, name: &[u8; 2]) -> Option<i32> {
        match self.drive().mcode.names.find(*name)? {
            Meaning::Global(value) | Meaning::Local(value) => Some(value),
            Meaning::Label(_) => None,
        }
    }
}
