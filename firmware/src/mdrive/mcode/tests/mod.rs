//! Sessions as somebody types them, with what comes back.

mod console;
mod parse;
mod print;
mod program;
mod serial;

use std::borrow::Cow;
use std::string::String;
use std::vec;
use std::vec::Vec;

use super::super::{MCODE, MEMORY, Mdrive, Reg};
use crate::device::{Boot, Device, Input, Instant, Link, Note, Output, Port, Sink, advance};
use drivetwin_protocol::registers::Register;
use drivetwin_protocol::text::next_line;

/// What a drive did.
#[derive(Default)]
struct World {
    memory: Vec<u8>,
    said: Vec<(Link, String)>,
    bytes: Vec<u8>,
    closed: Vec<Link>,
    notes: Vec<Note>,
    /// Bytes that are stored before power is lost; all of them if nobody cares.
    bytes_left: Option<usize>,
    /// What is said may be no text.
    raw: bool,
}

impl Sink for World {
    fn put(&mut self, _at: Instant, output: Output<'_>) {
        match output {
            Output::Message { port: MCODE, link, bytes } => {
                assert!(!bytes.is_empty());
                self.bytes.extend(bytes);
                let text = String::from_utf8_lossy(bytes);
                assert!(self.raw || matches!(text, Cow::Borrowed(_)));
                self.said.push((link, text.into_owned()));
            }
            Output::Close { port: MCODE, link } => self.closed.push(link),
            Output::Note(note) => self.notes.push(note),
            Output::Store { offset, bytes } => {
                let stored = bytes.len().min(self.bytes_left.unwrap_or(usize::MAX));
                let place = usize::from(offset);
                self.memory[place..place + stored].copy_from_slice(&bytes[..stored]);
                if let Some(left) = &mut self.bytes_left {
                    *left -= stored;
                }
            }
            _ => {}
        }
    }

    fn memory(&self) -> &[u8] {
        &self.memory
    }
}

/// A drive, its world, and what time it is.
struct Bed {
    drive: Mdrive,
    world: World,
    now: Instant,
}

const HERE: Link = Link(0);

impl Bed {
    /// A drive that is ready, with somebody on connection 0, in this echo mode.
    fn ready(drive: Mdrive, echo: i64) -> Self {
        let world = World { memory: vec![0xFF; MEMORY], ..World::default() };
        let mut bed = Self { drive, world, now: Instant::ZERO };
        bed.power_on();
        bed.poke(Reg::EM, echo);
        bed
    }

    fn plus() -> Self {
        Self::ready(Mdrive::plus(), 0)
    }

    /// One that says nothing but what is printed.
    fn quiet() -> Self {
        Self::ready(Mdrive::plus(), 2)
    }

    fn power_on(&mut self) {
        self.drive.power_on(self.now, Boot { fast: true, ..Boot::default() }, &mut self.world);
        self.run_until(self.now);
        self.input(Input::Opened { port: MCODE, link: HERE });
        self.world.said.clear();
    }

    /// Power goes and comes.
    fn cycle(&mut self) {
        self.world.bytes_left = None;
        self.power_on();
    }

    fn run_until(&mut self, at: Instant) {
        self.now = at;
        advance(&mut self.drive, at, core::iter::empty(), &mut self.world);
    }

    fn input(&mut self, input: Input<'_>) {
        advance(&mut self.drive, self.now, core::iter::once((self.now, input)), &mut self.world);
    }

    fn poke(&mut self, reg: Reg, value: i64) {
        self.drive.poke(self.now, reg.row(), value, &mut self.world).unwrap();
    }

    fn peek(&self, reg: Reg) -> i64 {
        self.drive.peek(self.now, reg.row())
    }

    /// Gives the drive bytes on a connection as fast as it takes them, until it has executed all of their lines.
    fn send(&mut self, link: Link, mut bytes: &[u8]) {
        while let Some(bytes) = next_line(&mut bytes) {
            self.input(Input::Message { port: MCODE, link, bytes });
            while !self.drive.takes(MCODE) {
                self.run_until(self.drive.deadline());
            }
        }
    }

    /// Types `text` on a connection, and returns what comes back there.
    fn types_on(&mut self, link: Link, text: &str) -> String {
        let before = self.world.said.len();
        self.send(link, text.as_bytes());
        let said = &self.world.said[before..];
        said.iter().filter(|(to, _)| *to == link).map(|(_, text)| &**text).collect()
    }

    fn types(&mut self, text: &str) -> String {
        self.types_on(HERE, text)
    }

    /// Types lines, one after the other, each of which is accepted.
    fn types_lines(&mut self, lines: &str) {
        for line in lines.lines() {
            self.types(line);
            self.types("\r");
            assert_eq!(self.peek(Reg::ER), 0, "{line}");
        }
    }

    /// The error of a line that is refused; it is cleared by that.
    fn error_of(&mut self, line: &str) -> i64 {
        self.types(line);
        self.types("\r");
        let error = self.peek(Reg::ER);
        self.drive.drive.errors.clear();
        error
    }
}
