//! Tests that run an adapter in virtual time and compare its behaviour and its times with the list of
//! commands.

mod capture;
mod commands;
mod encoder;
mod reasons;
mod registers;
mod reset;
mod saved;
mod stream;

use core::ops::{Deref, DerefMut};
use std::string::{String, ToString};
use std::vec;
use std::vec::Vec;

use drivetwin_protocol::time::Span;

use super::{A, B, DIO0, DIO1, DIO2, DIO3, I, MEMORY, Qsb, Reg, USB};
use crate::device::{
    Boot, Device, DropReason, Duration, Encoder, Input, Instant, Level, LogEvent, Output, Pin, PresetError,
    advance,
};
use crate::testing::{Fixture, Treatment};

/// Period of the adapter's clock, 1/512 s.
const TICK: Duration = Duration::from_ticks(31_250);

/// An adapter, and a host that types commands.
struct Dut {
    fixture: Fixture<Qsb>,
    /// Time of a character of the host.
    character: Duration,
    /// Number of texts that the test has read.
    seen: usize,
}

impl Deref for Dut {
    type Target = Fixture<Qsb>;

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
    /// A new adapter without power.
    fn off(drive: Qsb) -> Self {
        let fixture = Fixture::with_memory(drive, vec![0xFF; MEMORY]).ruled(|output| match output {
            Output::Bytes { port: USB, .. }
            | Output::Level { .. }
            | Output::Line { port: USB, .. }
            | Output::Log(_)
            | Output::Plan { .. }
            | Output::Store { .. } => Treatment::Keep,
            _ => Treatment::Refuse,
        });
        // A character of 10 bits at 230,400 baud takes 694.4 ticks.
        Self { fixture, character: Duration::from_ticks(694), seen: 0 }
    }

    /// A new adapter that is ready at 0. It is still sending its banner.
    fn ready(drive: Qsb) -> Self {
        let mut dut = Self::off(drive);
        dut.power_on(Boot { fast: true, ..Boot::default() });
        dut
    }

    fn power_on(&mut self, boot: Boot) {
        self.fixture.power_on(boot);
        let now = self.now;
        self.run_until(now);
        self.seen = self.out.bytes.len();
    }

    /// All texts sent, with the times of their first characters.
    fn sent(&self) -> Vec<(Instant, String)> {
        let sent = self.out.bytes.iter();
        sent.map(|(at, _, bytes)| (*at, String::from_utf8(bytes.clone()).unwrap())).collect()
    }

    /// Types characters from now on.
    fn hear(&mut self, bytes: &[u8]) {
        for byte in bytes {
            let at = self.now + self.character;
            self.input(at, Input::Bytes { port: USB, bytes: &[*byte] });
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

    /// Types a command, waits until the response has been sent, and returns it without CR LF.
    fn ask(&mut self, command: &str) -> String {
        self.seen = self.out.bytes.len();
        self.hear(command.as_bytes());
        self.hear(b"\r");
        let (at, text) = self.sent()[self.seen].clone();
        assert_eq!(self.out.bytes.len(), self.seen + 1, "{command} has one answer");
        self.seen += 1;
        let end = at + self.character * text.len() as u64;
        let end = end.max(self.now);
        self.run_until(end);
        text.strip_suffix("\r\n").unwrap().to_string()
    }

    /// Types a write that the adapter must accept.
    fn write(&mut self, command: &str) {
        let answer = self.ask(command);
        assert!(answer.starts_with("w "), "{command}: {answer}");
    }

    /// The texts sent since the last call, without CR LF.
    fn texts(&mut self) -> Vec<(Instant, String)> {
        let texts = self.sent();
        let texts = texts[self.seen..].iter().map(|(at, text)| (*at, text.trim_end().to_string())).collect();
        self.seen = self.out.bytes.len();
        texts
    }

    /// Sets a level at a pin, now.
    fn pin(&mut self, pin: Pin, high: bool) {
        self.edge(pin, high);
    }

    /// Puts a voltage at a pin, now.
    fn volts(&mut self, pin: Pin, mv: i32) {
        self.feed(Input::Millivolts { pin, mv });
    }

    /// Makes quarter cycles of a quadrature encoder, 1 µs each, starting with A and B both high. Positive
    /// means that A leads. After a multiple of four quarters both are high again.
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
        self.out.level(pin).unwrap()
    }

    /// Levels that a pin took, beginning with index `from` of all recorded levels.
    fn levels(&self, pin: Pin, from: usize) -> Vec<(Instant, Level)> {
        let levels = self.out.levels[from..].iter();
        levels.filter(|(_, of, _)| *of == pin).map(|(at, _, level)| (*at, *level)).collect()
    }
}

/// The instant of tick `n` of an adapter that was powered on at 0.
fn tick(n: u64) -> Instant {
    Instant::ZERO + TICK * n
}
