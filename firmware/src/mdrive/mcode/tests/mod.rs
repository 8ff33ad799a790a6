//! Sessions on connections: typed input and its output.

mod console;
mod parse;
mod print;
mod program;
mod serial;

use core::ops::{Deref, DerefMut};
use std::string::String;
use std::vec;
use std::vec::Vec;

use super::super::{MCODE, MEMORY, Mdrive, Reg};
use crate::device::{Boot, Device, Input, Link, LogEvent, Output, Port, advance};
use crate::testing::{Fixture, Rule, Treatment};
use drivetwin_protocol::text::next_line;

/// Rule for outputs: messages must be text.
const TEXT: Rule = |output| match output {
    Output::Message { port: MCODE, bytes, .. } if std::str::from_utf8(bytes).is_err() => Treatment::Refuse,
    _ => NO_TEXT(output),
};

/// Rule for outputs: messages need not be text.
const NO_TEXT: Rule = |output| match output {
    Output::Message { port: MCODE, bytes: [], .. } => Treatment::Refuse,
    Output::Message { port: MCODE, .. }
    | Output::Close { port: MCODE, .. }
    | Output::Log(_)
    | Output::Store { .. } => Treatment::Keep,
    _ => Treatment::Ignore,
};

/// A drive with a client on connection 0.
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

const HERE: Link = Link(0);

impl Dut {
    /// A drive that is ready, with a client on connection 0, in this echo mode.
    fn ready(drive: Mdrive, echo: i64) -> Self {
        let fixture = Fixture::with_memory(drive, vec![0xFF; MEMORY]).ruled(TEXT);
        let mut dut = Self { fixture };
        dut.power_on();
        dut.set(Reg::EM, echo);
        dut
    }

    fn plus() -> Self {
        Self::ready(Mdrive::plus(), 0)
    }

    /// A drive without echo: it sends only printed text.
    fn quiet() -> Self {
        Self::ready(Mdrive::plus(), 2)
    }

    fn power_on(&mut self) {
        self.power_on_fast();
        self.feed(Input::Opened { port: MCODE, link: HERE });
        self.out.messages.clear();
    }

    /// Switches power off and on.
    fn cycle(&mut self) {
        self.out.bytes_left = usize::MAX;
        self.power_on();
    }

    /// Texts that the drive has sent, each with its connection.
    fn said(&self) -> Vec<(Link, String)> {
        let said = self.out.messages.iter();
        said.map(|(_, _, link, bytes)| (*link, String::from_utf8_lossy(bytes).into_owned())).collect()
    }

    /// Bytes that the drive has sent on all connections.
    fn bytes(&self) -> Vec<u8> {
        self.out.messages.iter().flat_map(|(.., bytes)| bytes.clone()).collect()
    }

    /// Sends bytes on a connection as fast as the drive takes them, and runs until all their lines are
    /// executed.
    fn send(&mut self, link: Link, mut bytes: &[u8]) {
        while let Some(bytes) = next_line(&mut bytes) {
            self.feed(Input::Message { port: MCODE, link, bytes });
            while !self.drive.takes(MCODE) {
                let due = self.drive.deadline();
                self.run_until(due);
            }
        }
    }

    /// Types `text` on a connection, and returns the output there.
    fn types_on(&mut self, link: Link, text: &str) -> String {
        let before = self.out.messages.len();
        self.send(link, text.as_bytes());
        self.said()[before..].iter().filter(|(to, _)| *to == link).map(|(_, text)| &**text).collect()
    }

    fn types(&mut self, text: &str) -> String {
        self.types_on(HERE, text)
    }

    /// Types lines, one after the other. Each must be accepted.
    fn types_lines(&mut self, lines: &str) {
        for line in lines.lines() {
            self.types(line);
            self.types("\r");
            assert_eq!(self.get(Reg::ER), 0, "{line}");
        }
    }

    /// Types a line, and returns its error, which is cleared.
    fn error_of(&mut self, line: &str) -> i64 {
        self.types(line);
        self.types("\r");
        let error = self.get(Reg::ER);
        self.drive.drive.mcode.errors.clear();
        error
    }
}
