//! Connections for MCode, four at most: echo, end of lines, keys (MC 3.4.4, 7.1.1).
//!
//! Each connection has its own line and its own program mode; both end with the connection. Echo mode belongs
//! to the drive. A connection receives nothing before it has sent something, except text for all connections.
//! The drive executes one line at a time, from any connection, and takes no other input from its connections
//! meanwhile (MDRIVE-35).

mod line;
mod time;

use core::mem;

use heapless::Vec;

use self::line::Console;
pub(in crate::mdrive) use self::line::{Consoles, MAX_CONNECTIONS};
use super::super::MCODE;
use super::super::drive::Drive;
use super::super::error::{Error, Errors};
use super::super::reasons::{Why, report};
use super::super::registers::Reg;
use super::super::variables::Registers;
use super::parse::begins_number;
use super::print::CR_LF;
use super::serial::{ACK, NAK, Party, PartyAddress, is_checked};
use super::statement::{Place, Statement};
use crate::device::{Context, DropReason, Instant, Link, LogEvent, Output};

const CTRL_C: u8 = 0x03;
const CTRL_E: u8 = 0x05;
const BACKSPACE: u8 = 0x08;
const ESCAPE: u8 = 0x1B;
const DELETE: u8 = 0x7F;

/// Echo of a typed line, by EM (MC 7.1.1).
mod echo {
    /// Each character, and a prompt.
    pub(super) const FULL: u16 = 0;
    /// CR LF when the line is accepted.
    pub(super) const HALF: u16 = 1;
    /// Nothing; only printed text is sent.
    pub(super) const NONE: u16 = 2;
    /// The whole line, after its end.
    pub(super) const AFTERWARDS: u16 = 3;
}

impl Drive {
    pub(in crate::mdrive) fn console_closed(&mut self, at: Instant, link: Link, out: &mut dyn Context) {
        self.mcode.consoles.close(link);
        self.process_waiting(at, out);
    }

    /// Handles characters, which may contain several lines. A line may change the state for the next one, so
    /// the next one waits for it.
    pub(in crate::mdrive) fn console_received(
        &mut self,
        at: Instant,
        link: Link,
        bytes: &[u8],
        out: &mut dyn Context,
    ) {
        for character in bytes {
            if self.mcode.consoles.takes() {
                self.on_character(at, link, *character, out);
            } else {
                self.mcode.consoles.wait(link, *character);
            }
        }
    }

    /// Executes the line whose execution time has ended, then handles the characters received meanwhile.
    pub(in crate::mdrive) fn console_timeout(&mut self, at: Instant, out: &mut dyn Context) {
        if let Some(link) = self.mcode.consoles.executed(at) {
            self.execute_line(at, link, out);
            self.dispatch_events(at, out);
            self.process_waiting(at, out);
        }
    }

    fn process_waiting(&mut self, at: Instant, out: &mut dyn Context) {
        while let Some((link, character)) = self.mcode.consoles.waited() {
            self.on_character(at, link, character, out);
        }
    }

    fn on_character(&mut self, at: Instant, link: Link, character: u8, out: &mut dyn Context) {
        // An earlier Ctrl-C may have restarted the drive.
        if self.is_started() {
            self.console_character(at, link, character, out);
            // A key takes effect at once.
            if character.is_ascii_control() {
                self.dispatch_events(at, out);
            }
        } else {
            note_lost_input(at, out);
        }
    }

    /// Sends the drive's name to every connection, because a move that announces its end has ended (MC 5-45).
    pub(in crate::mdrive) fn send_name(&mut self, at: Instant, out: &mut dyn Context) {
        let name = (self.bank.word(Reg::DN) & 0x7F) as u8;
        self.mcode.consoles.send_to_all(at, &[name, b'\r', b'\n'], out);
    }

    fn console_character(&mut self, at: Instant, link: Link, character: u8, out: &mut dyn Context) {
        let party = self.bank.is_party();
        if party && !self.mcode.consoles.is_for_me(at, link, character, &self.bank, out) {
            return;
        }
        let echoes = self.bank.echo_mode() == echo::FULL;
        let (steps, escape) = (self.mcode.vm.is_stepping(), self.bank.escape());
        let Some(console) = self.mcode.consoles.find(link) else { return };
        let returned = mem::replace(&mut console.returned, character == b'\r');
        let is_blank = console.line.trim_ascii().is_empty() && !console.refused;
        match character {
            b'\n' if returned && !party => {}
            b'\r' if party => {}
            b'\r' | b'\n' => {
                if steps && is_blank {
                    self.mcode.vm.step(at, false);
                }
                self.end_line(at, link);
            }
            CTRL_C if self.bank.word(Reg::CE) != 0 => {
                note_key(at, character, out);
                // The sign-on begins on a new line.
                let is_open = echoes && !console.line.is_empty();
                self.mcode.consoles.answer(at, link, if is_open { CR_LF } else { b"" }, &self.bank, out);
                self.restart(at, out);
            }
            _ if character == escape => {
                note_key(at, character, out);
                self.abort(at, link, out);
            }
            CTRL_C | CTRL_E | ESCAPE => {
                report(Err(Why::KeyIsOff), at, out);
                note_key(at, character, out);
            }
            b' ' if steps && is_blank => self.mcode.vm.step(at, true),
            BACKSPACE | DELETE => {
                let taken = console.line.pop().is_some();
                let erasure: &[u8] = if taken && echoes { b"\x08 \x08" } else { b"" };
                self.mcode.consoles.answer(at, link, erasure, &self.bank, out);
            }
            b'\t' | b' '.. if !console.refused => {
                if console.line.push(character).is_err() {
                    self.refuse_line(at, link, out);
                } else if echoes {
                    self.mcode.consoles.answer(at, link, &[character], &self.bank, out);
                }
            }
            // Ignored: the rest of a line that was too long, or a key that the drive does not have.
            _ => {}
        }
    }

    /// Handles the end of a line: its execution begins, unless the line was refused before.
    fn end_line(&mut self, at: Instant, link: Link) {
        let next = self.mcode.consoles.first_called();
        let Some(console) = self.mcode.consoles.find(link) else { return };
        if mem::take(&mut console.refused) {
            console.line.clear();
            console.address_state = next;
            return;
        }
        let (line, programming) = (console.line.clone(), console.programming.is_some());
        let takes = self.execution_time(&line, programming);
        self.mcode.consoles.execute(at, link, takes);
    }

    /// Executes a line, between the end of its echo and a prompt.
    fn execute_line(&mut self, at: Instant, link: Link, out: &mut dyn Context) {
        let Some(console) = self.mcode.consoles.find(link) else { return };
        let (mut line, name) = (mem::take(&mut console.line), console.address_state.name());
        let stores = console.programming.is_some();
        // Hardware sends no CR LF before printed text while a program runs; table 7.1 makes no such
        // difference (MDRIVE-39).
        let is_half = self.bank.echo_mode() == echo::HALF;
        let prints_alone = is_half && self.mcode.vm.is_running() && !stores && self.prints(&line);
        if !prints_alone {
            self.mcode.consoles.end_echo(at, link, &line, &self.bank, out);
        }
        let sums = self.bank.check_sums();
        let spoiled = sums != 0 && !is_checked(name, &line);
        if sums != 0 {
            line.pop();
        }
        let outcome = if spoiled { Ok(Answer::RxError) } else { self.run_statement(at, link, &line, out) };
        if prints_alone && outcome.is_err() {
            self.mcode.consoles.end_echo(at, link, &line, &self.bank, out);
        }
        self.conclude(at, link, &line, sums, outcome, out);
        let next = self.mcode.consoles.first_called();
        self.mcode.consoles.call(link, next);
    }

    /// Returns true if a line prints something.
    fn prints(&self, line: &[u8]) -> bool {
        matches!(self.parse(line), Ok(Statement::Print(_) | Statement::ListProgram(_)))
    }

    /// Refuses a line that is too long (MC 5-57). The reply is sent before the line has ended.
    fn refuse_line(&mut self, at: Instant, link: Link, out: &mut dyn Context) {
        let Some(console) = self.mcode.consoles.find(link) else { return };
        let line = mem::take(&mut console.line);
        console.refused = true;
        self.mcode.consoles.end_echo(at, link, &line, &self.bank, out);
        self.conclude(at, link, &line, self.bank.check_sums(), Err(Error::Unknown), out);
    }

    /// Handles Esc or Ctrl-E: motion stops without a ramp, and the program ends (MC 3.4.4).
    fn abort(&mut self, at: Instant, link: Link, out: &mut dyn Context) {
        if self.mcode.consoles.drop_line(link) {
            self.end_program();
            self.motion.halt(at, out);
            self.mcode.consoles.answer_abort(at, link, prompt(&self.bank, self.errors), &self.bank, out);
        }
    }

    /// Ends a line: reports its error, and sends an acknowledgement and a prompt. `sums` is CK when the line
    /// was executed.
    fn conclude(
        &mut self,
        at: Instant,
        link: Link,
        line: &[u8],
        sums: u16,
        outcome: Result<Answer, Error>,
        out: &mut dyn Context,
    ) {
        let function = line.first().copied().unwrap_or(b'\r');
        out.put(
            at,
            Output::Log(match outcome {
                Ok(Answer::RxError) => LogEvent::Dropped { port: MCODE, why: DropReason::Crc },
                Ok(_) => LogEvent::Request { port: MCODE, unit: 0, function },
                Err(error) => LogEvent::Refused { port: MCODE, function, code: error as u8 },
            }),
        );
        if let Err(error) = outcome {
            self.fail(at, error, out);
        }
        // "The response will be the sign on message" (MC 5-26).
        let is_greeting = outcome == Ok(Answer::Greeting);
        if sums != 0 && self.bank.echo_mode() != echo::NONE && !is_greeting {
            let good = outcome == Ok(Answer::Prompt);
            // "ACK is not echoed if a program is running" (MC 5-12).
            let acknowledged: &[u8] = match good {
                true if sums == 2 && self.mcode.vm.is_running() => &[],
                true => &[ACK],
                false => &[NAK],
            };
            self.mcode.consoles.answer(at, link, acknowledged, &self.bank, out);
        }
        if !is_greeting {
            self.mcode.consoles.answer(at, link, prompt(&self.bank, self.errors), &self.bank, out);
        }
    }

    /// Executes the statement of a line.
    ///
    /// # Errors
    /// The line is wrong, or the drive's state forbids it.
    fn run_statement(
        &mut self,
        at: Instant,
        link: Link,
        line: &[u8],
        out: &mut dyn Context,
    ) -> Result<Answer, Error> {
        let programming = self.mcode.consoles.find(link).and_then(|console| console.programming);
        let statement = self.parse(line);
        if statement.is_err() && programming.is_none() && begins_number(line) {
            // "IF will be cleared to zero with a carriage return" (MC 5-36). This includes an invalid number.
            self.mcode.vm.set_input_pending(false);
        }
        let statement = statement?;
        if let Some(address) = programming {
            match statement {
                Statement::Empty => {}
                Statement::Program(place) => self.enter_program_mode(link, place)?,
                _ => {
                    self.mcode.store_line(at, address, line, &statement, out)?;
                    self.mcode.consoles.program_from(link, Some(address + 1));
                    // These statements are usually typed, not stored in a program.
                    let is_unusual = matches!(
                        statement,
                        Statement::Execute(..)
                            | Statement::ListProgram(_)
                            | Statement::Clear(_)
                            | Statement::Defaults
                    );
                    report(Err(if is_unusual { Why::StoresLine } else { Why::Stored }), at, out);
                }
            }
            return Ok(Answer::Prompt);
        }
        match statement {
            Statement::Print(items) => {
                self.print_on(at, self.mcode.consoles.recipients(link, &self.bank), items, out)?;
            }
            Statement::ListProgram(place) => {
                self.list_program(at, self.mcode.consoles.recipients(link, &self.bank), place, out)?;
            }
            Statement::Program(place) => self.enter_program_mode(link, place)?,
            Statement::Defaults => {
                self.restore(at, out)?;
                return Ok(Answer::Greeting);
            }
            _ => self.execute(at, &statement, false, out)?,
        }
        Ok(Answer::Prompt)
    }

    /// PG: begins program mode at a place, or continues there. Without a place program mode ends.
    ///
    /// # Errors
    /// Error 30 or 42; 44 if the program is locked. Nothing has happened then.
    fn enter_program_mode(&mut self, link: Link, place: Option<Place>) -> Result<(), Error> {
        let address = match place {
            Some(place) => {
                self.bank.needs_unlocked()?;
                Some(self.mcode.address(place)?)
            }
            None => None,
        };
        self.mcode.consoles.program_from(link, address);
        Ok(())
    }
}

impl Consoles {
    /// Opens a connection; a fifth one is closed (MDRIVE-8).
    pub(in crate::mdrive) fn opened(&mut self, at: Instant, link: Link, out: &mut dyn Context) {
        self.close(link);
        if self.open(link).is_err() {
            out.put(at, Output::Close { port: MCODE, link });
        }
    }

    /// Returns true if, in party mode, a character belongs to a line for this drive. A name before a line
    /// does not belong to it. Some keys are for all drives (MC 5-11, 5-23).
    fn is_for_me(
        &mut self,
        at: Instant,
        link: Link,
        character: u8,
        registers: &Registers,
        out: &mut dyn Context,
    ) -> bool {
        let active = self.party == Party::Active;
        let address_state = self.find(link).map_or(PartyAddress::Others, |console| console.address_state);
        match (address_state, character) {
            (PartyAddress::Me(_) | PartyAddress::All, _) => true,
            (_, CTRL_C) => registers.word(Reg::CE) == 1,
            (_, ESCAPE | CTRL_E) => registers.word(Reg::ES) <= 1,
            (_, b'\n') => {
                self.party = Party::Active;
                self.call(link, PartyAddress::Next);
                false
            }
            (PartyAddress::Next, name) if active => {
                self.call(link, registers.addressee(name));
                // Table 7.2 shows no echo of the name, but hardware sends it (MDRIVE-40).
                if registers.echo_mode() == echo::FULL {
                    self.answer(at, link, &[name], registers, out);
                }
                false
            }
            (PartyAddress::Plain | PartyAddress::Next | PartyAddress::Others, _) => false,
        }
    }

    fn call(&mut self, link: Link, address_state: PartyAddress) {
        if let Some(console) = self.find(link) {
            console.address_state = address_state;
        }
    }

    /// Sends the end of a line's echo. With checksums an acknowledgement is sent instead of CR LF.
    fn end_echo(&self, at: Instant, link: Link, line: &[u8], registers: &Registers, out: &mut dyn Context) {
        let mode = registers.echo_mode();
        if mode == echo::AFTERWARDS {
            self.answer(at, link, line, registers, out);
        }
        if mode != echo::NONE && registers.check_sums() == 0 {
            self.answer(at, link, CR_LF, registers, out);
        }
    }

    /// Sets the address from which typed lines are stored; `None` ends program mode.
    fn program_from(&mut self, link: Link, address: Option<u16>) {
        if let Some(console) = self.find(link) {
            console.programming = address;
        }
    }

    /// Sends an answer on a connection, if this drive is to answer.
    fn answer(&self, at: Instant, link: Link, bytes: &[u8], registers: &Registers, out: &mut dyn Context) {
        for link in &self.recipients(link, registers) {
            send(at, *link, bytes, out);
        }
    }

    /// Connections that get the answer to a line: its own, or none if this drive is not to answer.
    pub(super) fn recipients(&self, link: Link, registers: &Registers) -> Vec<Link, MAX_CONNECTIONS> {
        let mut links = Vec::new();
        let console = self.list.iter().find(|console| console.link == link);
        if console.is_some_and(|console| registers.answers(console.address_state)) {
            // The list has room for one connection.
            let _ = links.push(link);
        }
        links
    }

    /// Drops what is being typed on a connection. Returns false if there is no such connection.
    fn drop_line(&mut self, link: Link) -> bool {
        let Some(console) = self.find(link) else { return false };
        *console = Console { programming: console.programming, ..Console::new(link, console.address_state) };
        true
    }

    /// Answers Esc or Ctrl-E.
    fn answer_abort(
        &self,
        at: Instant,
        link: Link,
        prompt: &[u8],
        registers: &Registers,
        out: &mut dyn Context,
    ) {
        if !registers.is_party() {
            self.end_echo(at, link, b"", registers, out);
            return self.answer(at, link, prompt, registers, out);
        }
        // On hardware all drives of a party answer a key that is for all of them (MDRIVE-38).
        let is_addressed = registers.word(Reg::ES) & 2 != 0;
        let answer: &[u8] = match registers.echo_mode() {
            echo::FULL => b"#\r\n",
            echo::NONE => b"",
            _ => CR_LF,
        };
        for text in [answer, prompt] {
            if is_addressed {
                self.answer(at, link, text, registers, out);
            } else {
                send(at, link, text, out);
            }
        }
    }
}

impl Registers {
    /// Echo mode (EM): one of [`echo`].
    fn echo_mode(&self) -> u16 {
        self.word(Reg::EM)
    }

    /// Key that stops everything: ES (MC 5-23). Only in party mode can it be addressed.
    fn escape(&self) -> u8 {
        if self.word(Reg::ES) & 1 != 0 { ESCAPE } else { CTRL_E }
    }
}

/// Prompt, which exists in EM 0 only: a question mark while there is an error (MC 9; MDRIVE-10).
pub(in crate::mdrive) fn prompt(registers: &Registers, errors: Errors) -> &'static [u8] {
    match (registers.echo_mode(), errors.is_set()) {
        (echo::FULL, false) => b">",
        (echo::FULL, true) => b"?",
        _ => b"",
    }
}

/// Answer to a line that was executed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Answer {
    Prompt,
    /// The checksum was wrong; the line had no effect.
    RxError,
    /// The sign-on and a prompt were the answer.
    Greeting,
}

/// Notes that the drive loses what was typed, if anything, because it is starting (MDRIVE-7).
pub(in crate::mdrive) fn note_lost_input(at: Instant, out: &mut dyn Context) {
    out.put(at, Output::Log(LogEvent::Dropped { port: MCODE, why: DropReason::Starting }));
}

/// Notes a key that needs no end of a line.
fn note_key(at: Instant, key: u8, out: &mut dyn Context) {
    out.put(at, Output::Log(LogEvent::Request { port: MCODE, unit: 0, function: key }));
}

/// Sends bytes on a connection.
pub(super) fn send(at: Instant, link: Link, bytes: &[u8], out: &mut dyn Context) {
    if !bytes.is_empty() {
        out.put(at, Output::Message { port: MCODE, link, bytes });
    }
}
