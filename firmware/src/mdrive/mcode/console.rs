//! Connections for MCode, four at most: echo, end of lines, keys (MC 3.4.4, 7.1.1).
//!
//! Each connection has its own line and its own program mode; both end with the connection. Echo mode belongs
//! to the drive. A connection receives nothing before it has sent something, except text for all connections.
//! The drive executes one line at a time, from any connection, and takes no other input from its connections
//! meanwhile (MDRIVE-35).

mod line;

use core::mem;

use heapless::Vec;

use self::line::Console;
pub(in crate::mdrive) use self::line::{Consoles, MAX_CONNECTIONS};
use super::Interpreter;
use super::parse::begins_number;
use super::serial::{ACK, NAK, Party, PartyAddress, is_checked};
use super::statement::{Place, Statement};
use crate::device::{Context, DropReason, Instant, Link, LogEvent, Output};
use crate::mdrive::MCODE;
use crate::mdrive::error::{Error, Errors};
use crate::mdrive::reader::CR_LF;
use crate::mdrive::reasons::{Why, report};
use crate::mdrive::registers::Reg;
use crate::mdrive::variables::Registers;

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

impl Interpreter<'_> {
    pub(in crate::mdrive) fn closed(&mut self, link: Link) {
        self.consoles().close(link);
        self.process_waiting();
    }

    /// Handles characters, which may contain several lines. A line may change the state for the next one, so
    /// the next one waits for it.
    pub(in crate::mdrive) fn received(&mut self, link: Link, bytes: &[u8]) {
        for character in bytes {
            if self.consoles().takes() {
                self.on_character(link, *character);
            } else {
                self.consoles().wait(link, *character);
            }
        }
    }

    /// Handles the deadlines of MCode: of a typed line, and of the program.
    pub(in crate::mdrive) fn timeout(&mut self) {
        self.console_timeout();
        if self.drive.mcode.vm.deadline() <= self.at {
            // A line has been executed, or the time of H has passed.
            if self.drive.mcode.vm.timeout(self.at) {
                self.execute_program_line();
            }
            self.drive.dispatch_events(self.at, self.out);
        }
    }

    /// Executes the line whose execution time has ended, then handles the characters received meanwhile.
    fn console_timeout(&mut self) {
        if let Some(link) = self.drive.mcode.consoles.executed(self.at) {
            self.execute_line(link);
            self.drive.dispatch_events(self.at, self.out);
            self.process_waiting();
        }
    }

    fn process_waiting(&mut self) {
        while let Some((link, character)) = self.consoles().waited() {
            self.on_character(link, character);
        }
    }

    fn on_character(&mut self, link: Link, character: u8) {
        // An earlier Ctrl-C may have restarted the drive.
        if self.drive.startup.is_started() {
            self.console_character(link, character);
            // A key takes effect at once.
            if character.is_ascii_control() {
                self.drive.dispatch_events(self.at, self.out);
            }
        } else {
            note_lost_input(self.at, self.out);
        }
    }

    fn console_character(&mut self, link: Link, character: u8) {
        let party = self.drive.bank.is_party();
        if party && !self.drive.mcode.consoles.is_for_me(self.at, link, character, &self.drive.bank, self.out)
        {
            return;
        }
        let echoes = self.drive.bank.echo_mode() == echo::FULL;
        let (steps, escape) = (self.drive.mcode.vm.is_stepping(), self.drive.bank.escape());
        let Some(console) = self.drive.mcode.consoles.find(link) else { return };
        let returned = mem::replace(&mut console.returned, character == b'\r');
        let is_blank = console.line.trim_ascii().is_empty() && !console.refused;
        match character {
            b'\n' if returned && !party => {}
            b'\r' if party => {}
            b'\r' | b'\n' => {
                if steps && is_blank {
                    self.drive.mcode.vm.step(self.at, false);
                }
                self.end_line(link);
            }
            CTRL_C if self.drive.bank.word(Reg::CE) != 0 => {
                note_key(self.at, character, self.out);
                // The sign-on begins on a new line.
                let is_open = echoes && !console.line.is_empty();
                self.answer(link, if is_open { CR_LF } else { b"" });
                self.drive.restart(self.at, self.out);
            }
            _ if character == escape => {
                note_key(self.at, character, self.out);
                self.abort(link);
            }
            CTRL_C | CTRL_E | ESCAPE => {
                report(Err(Why::KeyIsOff), self.at, self.out);
                note_key(self.at, character, self.out);
            }
            b' ' if steps && is_blank => self.drive.mcode.vm.step(self.at, true),
            BACKSPACE | DELETE => {
                let taken = console.line.pop().is_some();
                let erasure: &[u8] = if taken && echoes { b"\x08 \x08" } else { b"" };
                self.answer(link, erasure);
            }
            b'\t' | b' '.. if !console.refused => {
                if console.line.push(character).is_err() {
                    self.refuse_line(link);
                } else if echoes {
                    self.answer(link, &[character]);
                }
            }
            // Ignored: the rest of a line that was too long, or a key that the drive does not have.
            _ => {}
        }
    }

    /// Handles the end of a line: its execution begins, unless the line was refused before.
    fn end_line(&mut self, link: Link) {
        let next = self.consoles().first_called();
        let Some(console) = self.drive.mcode.consoles.find(link) else { return };
        if mem::take(&mut console.refused) {
            console.line.clear();
            console.address_state = next;
            return;
        }
        let (line, programming) = (console.line.clone(), console.programming.is_some());
        let takes = self.drive.reader(self.at).execution_time(&line, programming);
        self.drive.mcode.consoles.execute(self.at, link, takes);
    }

    /// Executes a line, between the end of its echo and a prompt.
    fn execute_line(&mut self, link: Link) {
        let Some(console) = self.drive.mcode.consoles.find(link) else { return };
        let (mut line, name) = (mem::take(&mut console.line), console.address_state.name());
        let stores = console.programming.is_some();
        // Hardware sends no CR LF before printed text while a program runs; table 7.1 makes no such
        // difference (MDRIVE-39).
        let is_half = self.drive.bank.echo_mode() == echo::HALF;
        let prints_alone = is_half
            && self.drive.mcode.vm.is_running()
            && !stores
            && self.drive.reader(self.at).prints(&line);
        if !prints_alone {
            self.end_echo(link, &line);
        }
        let sums = self.drive.bank.check_sums();
        let spoiled = sums != 0 && !is_checked(name, &line);
        if sums != 0 {
            line.pop();
        }
        let outcome = if spoiled { Ok(Answer::RxError) } else { self.run_statement(link, &line) };
        if prints_alone && outcome.is_err() {
            self.end_echo(link, &line);
        }
        self.conclude(link, &line, sums, outcome);
        let next = self.consoles().first_called();
        self.consoles().call(link, next);
    }

    /// Refuses a line that is too long (MC 5-57). The reply is sent before the line has ended.
    fn refuse_line(&mut self, link: Link) {
        let Some(console) = self.drive.mcode.consoles.find(link) else { return };
        let line = mem::take(&mut console.line);
        console.refused = true;
        self.end_echo(link, &line);
        self.conclude(link, &line, self.drive.bank.check_sums(), Err(Error::Unknown));
    }

    /// Handles Esc or Ctrl-E: motion stops without a ramp, and the program ends (MC 3.4.4).
    fn abort(&mut self, link: Link) {
        if self.consoles().drop_line(link) {
            self.drive.end_program();
            self.drive.motion.halt(self.at, self.out);
            let prompt = self.prompt();
            self.drive.mcode.consoles.answer_abort(self.at, link, prompt, &self.drive.bank, self.out);
        }
    }

    /// Ends a line: reports its error, and sends an acknowledgement and a prompt. `sums` is CK when the line
    /// was executed.
    fn conclude(&mut self, link: Link, line: &[u8], sums: u16, outcome: Result<Answer, Error>) {
        let function = line.first().copied().unwrap_or(b'\r');
        self.out.put(
            self.at,
            Output::Log(match outcome {
                Ok(Answer::RxError) => LogEvent::Dropped { port: MCODE, why: DropReason::Crc },
                Ok(_) => LogEvent::Request { port: MCODE, unit: 0, function },
                Err(error) => LogEvent::Refused { port: MCODE, function, code: error as u8 },
            }),
        );
        if let Err(error) = outcome {
            self.drive.fail(self.at, error, self.out);
        }
        // "The response will be the sign on message" (MC 5-26).
        let is_greeting = outcome == Ok(Answer::Greeting);
        if sums != 0 && self.drive.bank.echo_mode() != echo::NONE && !is_greeting {
            let good = outcome == Ok(Answer::Prompt);
            // "ACK is not echoed if a program is running" (MC 5-12).
            let acknowledged: &[u8] = match good {
                true if sums == 2 && self.drive.mcode.vm.is_running() => &[],
                true => &[ACK],
                false => &[NAK],
            };
            self.answer(link, acknowledged);
        }
        if !is_greeting {
            self.answer(link, self.prompt());
        }
    }

    /// Executes the statement of a line.
    ///
    /// # Errors
    /// The line is wrong, or the drive's state forbids it.
    fn run_statement(&mut self, link: Link, line: &[u8]) -> Result<Answer, Error> {
        let programming = self.consoles().find(link).and_then(|console| console.programming);
        let statement = self.drive.reader(self.at).parse(line);
        if statement.is_err() && programming.is_none() && begins_number(line) {
            // "IF will be cleared to zero with a carriage return" (MC 5-36). This includes an invalid number.
            self.drive.mcode.vm.set_input_pending(false);
        }
        let statement = statement?;
        if let Some(address) = programming {
            match statement {
                Statement::Empty => {}
                Statement::Program(place) => self.enter_program_mode(link, place)?,
                _ => {
                    self.drive.mcode.store_line(self.at, address, line, &statement, self.out)?;
                    self.consoles().program_from(link, Some(address + 1));
                    // These statements are usually typed, not stored in a program.
                    let is_unusual = matches!(
                        statement,
                        Statement::Execute(..)
                            | Statement::ListProgram(_)
                            | Statement::Clear(_)
                            | Statement::Defaults
                    );
                    report(Err(if is_unusual { Why::StoresLine } else { Why::Stored }), self.at, self.out);
                }
            }
            return Ok(Answer::Prompt);
        }
        match statement {
            Statement::Print(items) => {
                let links = self.recipients(link);
                self.print_on(links, items)?;
            }
            Statement::ListProgram(place) => {
                let links = self.recipients(link);
                self.list_program(links, place)?;
            }
            Statement::Program(place) => self.enter_program_mode(link, place)?,
            Statement::Defaults => {
                self.restore()?;
                return Ok(Answer::Greeting);
            }
            _ => self.execute(&statement, false)?,
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
                self.drive.bank.needs_unlocked()?;
                Some(self.drive.mcode.address(place)?)
            }
            None => None,
        };
        self.consoles().program_from(link, address);
        Ok(())
    }

    fn consoles(&mut self) -> &mut Consoles {
        &mut self.drive.mcode.consoles
    }

    /// Sends an answer on a connection, if this drive is to answer.
    fn answer(&mut self, link: Link, bytes: &[u8]) {
        self.drive.mcode.consoles.answer(self.at, link, bytes, &self.drive.bank, self.out);
    }

    fn end_echo(&mut self, link: Link, line: &[u8]) {
        self.drive.mcode.consoles.end_echo(self.at, link, line, &self.drive.bank, self.out);
    }

    fn recipients(&self, link: Link) -> Vec<Link, MAX_CONNECTIONS> {
        self.drive.mcode.consoles.recipients(link, &self.drive.bank)
    }

    fn prompt(&self) -> &'static [u8] {
        prompt(&self.drive.bank, self.drive.errors)
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
    fn recipients(&self, link: Link, registers: &Registers) -> Vec<Link, MAX_CONNECTIONS> {
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
