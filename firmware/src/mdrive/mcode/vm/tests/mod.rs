//! Programs of MC, and the time at which each line takes effect: the first one 210 µs after EX, the second
//! one 420 µs after EX.

mod anything;
mod examples;
mod flow;
mod oracle;
mod trips;

use core::ops::{Deref, DerefMut};
use std::string::String;
use std::vec;
use std::vec::Vec;

use drivetwin_protocol::time::Span;

use super::super::names::Meaning;
use crate::device::{Boot, Device, Duration, Input, Instant, Level, Link, Output, Pin};
use crate::mdrive::drive::Drive;
use crate::mdrive::error::Error;
use crate::mdrive::interpreter::Interpreter;
use crate::mdrive::registers::Reg;
use crate::mdrive::{A, ANALOG, B, CAPTURE, IO1, IO4, MCODE, MEMORY, Mdrive, STALL};
use crate::testing::{Fixture, Treatment};

/// Connection of the client.
const CONSOLE: Link = Link(0);

/// A drive that is ready, with a client on its console.
struct Dut {
    fixture: Fixture<Mdrive>,
}

impl Deref for Dut {
    type Target = Fixture<Mdrive>;

    fn deref(&self) -> &Self::Target {
        &self.fixture
    }
}

impl DerefMut for Dut {
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut self.fixture
    }
}

impl Dut {
    fn new(drive: Mdrive) -> Self {
        let fixture = Fixture::with_memory(drive, vec![0xFF; MEMORY]).ruled(|output| match output {
            Output::Message { port: MCODE, link: CONSOLE, bytes } if std::str::from_utf8(bytes).is_err() => {
                Treatment::Refuse
            }
            Output::Message { port: MCODE, link: CONSOLE, .. }
            | Output::Store { .. }
            | Output::Level { pin: CAPTURE, .. } => Treatment::Keep,
            _ => Treatment::Ignore,
        });
        let mut dut = Self { fixture };
        dut.power_on(Boot { fast: true, ..Boot::default() });
        dut.feed(Input::Opened { port: MCODE, link: CONSOLE });
        dut
    }

    /// Text that the drive has sent.
    fn said(&self) -> String {
        self.out.messages.iter().map(|(.., bytes)| std::str::from_utf8(bytes).unwrap()).collect()
    }

    /// Level changes of the trip output.
    fn trip_output(&self) -> Vec<(Instant, Level)> {
        self.out.levels.iter().map(|(at, _, level)| (*at, *level)).collect()
    }

    /// A drive with a program of these lines, from address 1 on.
    fn with(lines: &str) -> Self {
        let mut dut = Self::new(Mdrive::plus());
        dut.store(1, lines);
        dut
    }

    /// Stores lines from address `first` on. Semicolons or ends of lines separate them.
    fn store(&mut self, first: u16, lines: &str) {
        let lines = lines.split([';', '\n']).map(str::trim).filter(|line| !line.is_empty());
        for (address, line) in (first..).zip(lines) {
            let Fixture { drive: Mdrive { drive, .. }, out, now } = &mut self.fixture;
            let line = line.as_bytes();
            let statement = drive.reader(*now).parse(line).unwrap();
            drive.mcode.store_line(*now, address, line, &statement, out).unwrap();
        }
    }

    fn drive(&self) -> &Drive {
        &self.fixture.drive.drive
    }

    /// Waits for the time of `count` lines of a program.
    fn lines(&mut self, count: u64) {
        self.wait(210.micros() * count);
    }

    /// Sets the level of a pin.
    fn level(&mut self, pin: Pin, high: bool) {
        self.feed(Input::Edge { pin, high });
    }

    /// Executes a typed line.
    fn command(&mut self, line: &str) -> Result<(), Error> {
        let Fixture { drive: Mdrive { drive, .. }, out, now } = &mut self.fixture;
        let statement = drive.reader(*now).parse(line.as_bytes());
        let mut interpreter = Interpreter::new(drive, *now, out);
        let done = statement.and_then(|it| interpreter.execute(&it, false));
        if let Err(error) = done {
            drive.fail(*now, error);
        }
        drive.dispatch_events(*now, out);
        done
    }

    /// Executes typed lines, all of which must be accepted.
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
            if self.value(Reg::BY) == 0 {
                return;
            }
            self.wait(1.millis());
        }
        panic!("the program runs on");
    }

    fn value(&self, reg: Reg) -> i32 {
        self.drive().reader(self.now).read(reg)
    }

    /// Values of R1 to R4.
    fn r(&self) -> [i32; 4] {
        [Reg::R1, Reg::R2, Reg::R3, Reg::R4].map(|reg| self.value(reg))
    }

    /// Value of a user variable.
    fn user(&self, name: &[u8; 2]) -> Option<i32> {
        match self.drive().mcode.names.find(*name)? {
            Meaning::Global(value) | Meaning::Local(value) => Some(value),
            Meaning::Label(_) => None,
        }
    }
}
