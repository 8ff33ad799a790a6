//! Scripts with times: what the list says happens, and when.

mod capture;
mod commands;
mod encoder;
mod registers;
mod reset;
mod saved;
mod stream;

use std::string::{String, ToString};
use std::vec;
use std::vec::Vec;

use drivetwin_protocol::registers::Register;
use drivetwin_protocol::time::Span;

use super::{A, B, DIO0, DIO1, DIO2, DIO3, I, MEMORY, Qsb, Reg, USB};
use crate::device::{
    Boot, Device, Duration, Encoder, Input, Instant, Level, Line, Note, Output, Pin, Refused, Sink, Why,
    advance,
};

/// 1/512 s.
const TICK: Duration = Duration::from_ticks(31_250);

/// What an adapter did.
#[derive(Default)]
struct World {
    memory: Vec<u8>,
    /// Texts with the instants at which they begin to leave.
    sent: Vec<(Instant, String)>,
    levels: Vec<(Instant, Pin, Level)>,
    lines: Vec<(Instant, Line)>,
    notes: Vec<Note>,
    stores: Vec<Instant>,
    plans: usize,
}

impl Sink for World {
    fn put(&mut self, at: Instant, output: Output<'_>) {
        match output {
            Output::Bytes { port: USB, bytes } => {
                self.sent.push((at, String::from_utf8(bytes.to_vec()).unwrap()));
            }
            Output::Level { pin, level } => self.levels.push((at, pin, level)),
            Output::Line { port: USB, line } => self.lines.push((at, line)),
            Output::Note(note) => self.notes.push(note),
            Output::Plan { .. } => self.plans += 1,
            Output::Store { offset, bytes } => {
                self.stores.push(at);
                let offset = usize::from(offset);
                self.memory[offset..offset + bytes.len()].copy_from_slice(bytes);
            }
            other => panic!("a QSB does not {other:?}"),
        }
    }

    fn memory(&self) -> &[u8] {
        &self.memory
    }
}

/// An adapter, its world, and what time it is.
struct Bed {
    drive: Qsb,
    world: World,
    now: Instant,
    /// Time of a character of the host.
    character: Duration,
    /// Texts that a test has seen.
    seen: usize,
}

impl Bed {
    /// A new adapter without power.
    fn off(drive: Qsb) -> Self {
        let world = World { memory: vec![0xFF; MEMORY], ..World::default() };
        // 10 bits at 230,400: 694.4 ticks.
        let character = Duration::from_ticks(694);
        Self { drive, world, now: Instant::ZERO, character, seen: 0 }
    }

    /// A new adapter that is ready at 0; its banner has not left yet.
    fn ready(drive: Qsb) -> Self {
        let mut bed = Self::off(drive);
        bed.power_on(Boot { fast: true, ..Boot::default() });
        bed
    }

    fn power_on(&mut self, boot: Boot) {
        self.drive.power_on(self.now, boot, &mut self.world);
        self.run_until(self.now);
        self.seen = self.world.sent.len();
    }

    fn run_until(&mut self, at: impl Into<Instant>) {
        self.now = at.into();
        advance(&mut self.drive, self.now, core::iter::empty(), &mut self.world);
    }

    fn wait(&mut self, span: Duration) {
        self.run_until(self.now + span);
    }

    fn input(&mut self, at: Instant, input: Input<'_>) {
        self.now = at;
        advance(&mut self.drive, at, core::iter::once((at, input)), &mut self.world);
    }

    /// Types characters from now on.
    fn hear(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.input(self.now + self.character, Input::Bytes { port: USB, bytes: &[*byte] });
        }
    }

    /// Types a command so that its CR ends at `at`.
    fn command_at(&mut self, at: impl Into<Instant>, command: &str) {
        let at = at.into();
        let start = at - self.character * (command.len() as u64 + 1);
        assert!(start >= self.now, "there is no time to type {command}");
        self.run_until(start);
        self.hear(command.as_bytes());
        self.hear(b"\r");
    }

    /// Types a command, and returns its answer without CR LF when that has left.
    fn ask(&mut self, command: &str) -> String {
        self.seen = self.world.sent.len();
        self.hear(command.as_bytes());
        self.hear(b"\r");
        let (at, text) = self.world.sent[self.seen].clone();
        assert_eq!(self.world.sent.len(), self.seen + 1, "{command} has one answer");
        self.seen += 1;
        let end = at + self.character * text.len() as u64;
        self.run_until(end.max(self.now));
        text.strip_suffix("\r\n").unwrap().to_string()
    }

    /// A write that is taken.
    fn write(&mut self, command: &str) {
        let answer = self.ask(command);
        assert!(answer.starts_with("w "), "{command}: {answer}");
    }

    /// The texts that have left since the last look, without CR LF.
    fn texts(&mut self) -> Vec<(Instant, String)> {
        let texts = self.world.sent[self.seen..].iter();
        let texts = texts.map(|(at, text)| (*at, text.trim_end().to_string())).collect();
        self.seen = self.world.sent.len();
        texts
    }

    /// A level at a pin, now.
    fn pin(&mut self, pin: Pin, high: bool) {
        self.input(self.now, Input::Edge { pin, high });
    }

    /// A voltage at a pin, now.
    fn volts(&mut self, pin: Pin, mv: i32) {
        self.input(self.now, Input::Millivolts { pin, mv });
    }

    /// Quarter cycles of a quadrature encoder, 1 µs each, from A and B both high; a multiple of four, or
    /// the levels are others afterwards. Positive: A leads.
    fn turn(&mut self, quarters: i32) {
        let (first, second) = if quarters > 0 { (A, B) } else { (B, A) };
        for n in 0..quarters.unsigned_abs() {
            let pin = if n % 2 == 0 { first } else { second };
            self.wait(1.micros());
            self.pin(pin, n % 4 >= 2);
        }
        self.wait(1.micros());
    }

    fn level(&self, pin: Pin) -> Level {
        self.world.levels.iter().rfind(|(_, of, _)| *of == pin).unwrap().2
    }

    /// Levels that a pin took from the place `from` in all levels on.
    fn levels(&self, pin: Pin, from: usize) -> Vec<(Instant, Level)> {
        let levels = self.world.levels[from..].iter();
        levels.filter(|(_, of, _)| *of == pin).map(|(at, _, level)| (*at, *level)).collect()
    }

    fn peek(&self, reg: Reg) -> i64 {
        self.drive.peek(self.now, reg.row())
    }

    fn poke(&mut self, reg: Reg, value: i64) -> Result<(), Refused> {
        self.drive.poke(self.now, reg.row(), value, &mut self.world)
    }
}

/// The instant of a tick of an adapter that got power at 0.
fn tick(n: u64) -> Instant {
    Instant::ZERO + TICK * n
}
