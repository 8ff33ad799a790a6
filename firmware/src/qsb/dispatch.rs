//! Execution of commands, and their responses.

use drivetwin_protocol::registers::{Entry, Register, Shape, Space};
use drivetwin_protocol::text::TextLine;

use super::USB;
use super::adapter::Adapter;
use super::command::{self, Command, LINE_CHARACTERS, Response, Verb};
use super::registers::Reg;
use crate::device::{Context, Instant, LogEvent, Output};

impl Adapter {
    /// Executes the command of a received line, and sends the response.
    pub(super) fn execute(&mut self, at: Instant, line: &TextLine<LINE_CHARACTERS>, out: &mut dyn Context) {
        self.catch_up(at, out);
        let response = match command::parse(line) {
            Ok(command) => self.dispatch(at, command, out),
            Err(register) => unsupported(register),
        };
        let function = line.text.first().copied().unwrap_or(0);
        out.put(
            at,
            Output::Log(match response.letter {
                code @ (b'e' | b'x') => LogEvent::Refused { port: USB, function, code },
                _ => LogEvent::Request { port: USB, unit: 0, function },
            }),
        );
        self.respond(at, response, out);
        self.serial.set_rate(at, self.rate(), out);
        self.note_changes(at);
    }

    fn dispatch(&mut self, at: Instant, command: Command, out: &mut dyn Context) -> Response {
        let Command { verb, register } = command;
        let Some((reg, row)) = self.find(command) else { return unsupported(register) };
        let (letter, data) = match verb {
            Verb::Read => {
                self.streams.end_of(reg);
                (b'r', self.value(at, reg) as u32)
            }
            Verb::Stream => {
                if let Err(why) = self.begin_stream(at, reg) {
                    why.put(at, out);
                }
                (b's', self.value(at, reg) as u32)
            }
            Verb::Write(data) => {
                let value = if row.shape == Shape::I32 { data.cast_signed().into() } else { data.into() };
                let accepted = row.accepts(value) && self.write(at, reg, value, out);
                (if accepted { b'w' } else { b'e' }, data)
            }
        };
        Response { letter, register, data }
    }

    /// The register of a command, if this variant has it and the letter is allowed with it.
    fn find(&self, command: Command) -> Option<(Reg, &'static Entry)> {
        let (index, _) = Reg::ENTRIES.at(Space::Holding, u16::from(command.register))?;
        let row = Reg::ENTRIES.list.get(index)?;
        let allowed = match command.verb {
            Verb::Read => row.access.reads(),
            Verb::Write(_) => row.access.writes(),
            Verb::Stream => row.streams,
        };
        Reg::from_row(index).filter(|_| allowed && self.has(row)).map(|reg| (reg, row))
    }

    /// Sends the present value of a register, in a response that begins with `letter`.
    pub(super) fn send_value(&mut self, at: Instant, letter: u8, reg: Reg, out: &mut dyn Context) {
        let register = Reg::ENTRIES.list.get(reg.row()).map_or(0, |row| row.address as u8);
        let data = self.value(at, reg) as u32;
        self.respond(at, Response { letter, register, data }, out);
    }

    fn respond(&mut self, at: Instant, response: Response, out: &mut dyn Context) {
        let text = response.text(self.bank.word(Reg::Eor), self.clock.timestamp(at));
        self.serial.send(at, text.as_bytes(), out);
    }

    /// The code of the baud rate, as command A sets it.
    pub(super) fn rate(&self) -> u8 {
        self.bank.word(Reg::BaudRate) as u8
    }
}

/// The response to an unknown command (QSB-2).
fn unsupported(register: u8) -> Response {
    Response { letter: b'x', register, data: 0 }
}
