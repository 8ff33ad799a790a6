//! Typed lines: their execution, answers and prompts (MC 3.4.4, 7.1.1).

use heapless::Vec;

use super::Interpreter;
use crate::device::{DropReason, Link, LogEvent, Output};
use crate::mdrive::MCODE;
use crate::mdrive::drive::Drive;
use crate::mdrive::error::Error;
use crate::mdrive::mcode::console::{Consoles, Echo, Key, MAX_CONNECTIONS, Typed, note_lost_input, prompt};
use crate::mdrive::mcode::operand::Place;
use crate::mdrive::mcode::parse::begins_number;
use crate::mdrive::mcode::serial::{ACK, NAK, is_checked};
use crate::mdrive::mcode::statement::Statement;
use crate::mdrive::reasons::{Why, report};

impl Interpreter<'_> {
    /// Handles the end of a connection. The characters of others may have waited for its line.
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

    /// Handles characters that were received during the execution of a line, up to the next line.
    fn process_waiting(&mut self) {
        while let Some((link, character)) = self.consoles().waited() {
            self.on_character(link, character);
        }
    }

    /// Handles a character, which is lost while the drive starts.
    fn on_character(&mut self, link: Link, character: u8) {
        // An earlier Ctrl-C may have restarted the drive.
        if self.drive.startup.is_started() {
            self.type_character(link, character);
            // A key takes effect at once.
            if character.is_ascii_control() {
                self.drive.dispatch_events(self.at, self.out);
            }
        } else {
            note_lost_input(self.at, self.out);
        }
    }

    /// Acts on what follows from a character.
    fn type_character(&mut self, link: Link, character: u8) {
        let steps = self.drive.mcode.vm.is_stepping();
        let Drive { mcode, bank, .. } = &mut *self.drive;
        match mcode.consoles.character(self.at, link, character, bank, steps, self.out) {
            Key::None => {}
            Key::End { continues } => {
                if continues {
                    mcode.vm.step(self.at, false);
                }
                self.end_line(link);
            }
            Key::Step => mcode.vm.step(self.at, true),
            Key::TooLong => self.refuse_line(link),
            Key::Restart => self.drive.restart(self.at, self.out),
            Key::Abort => self.abort(link),
        }
    }

    /// Handles the end of a line: its execution begins, unless the line was refused before.
    fn end_line(&mut self, link: Link) {
        if self.consoles().end_line(link) {
            let (line, programming) = self.drive.mcode.consoles.line(link);
            let takes = self.drive.reader(self.at).execution_time(line, programming);
            self.drive.mcode.consoles.execute(self.at, link, takes);
        }
    }

    /// Executes a line, between the end of its echo and a prompt.
    fn execute_line(&mut self, link: Link) {
        let Some(Typed { mut line, name, programming }) = self.consoles().take_line(link) else { return };
        let stores = programming.is_some();
        // Hardware sends no CR LF before printed text while a program runs; table 7.1 makes no such
        // difference (MDRIVE-39).
        let is_half = self.drive.bank.echo() == Echo::Half;
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
        let outcome =
            if spoiled { Ok(Answer::RxError) } else { self.run_statement(link, &line, programming) };
        if prints_alone && outcome.is_err() {
            self.end_echo(link, &line);
        }
        self.conclude(link, &line, sums, outcome);
        self.consoles().next_line(link);
    }

    /// Refuses a line that is too long (MC 5-57). The reply is sent before the line has ended.
    fn refuse_line(&mut self, link: Link) {
        if let Some(Typed { line, .. }) = self.consoles().take_line(link) {
            self.end_echo(link, &line);
            self.conclude(link, &line, self.drive.bank.check_sums(), Err(Error::Unknown));
        }
    }

    /// Handles Esc or Ctrl-E: motion stops without a ramp, and the program ends (MC 3.4.4).
    fn abort(&mut self, link: Link) {
        self.drive.mcode.end(&mut self.drive.motion);
        self.drive.motion.halt(self.at, self.out);
        let prompt = self.prompt();
        self.drive.mcode.consoles.answer_abort(self.at, link, prompt, &self.drive.bank, self.out);
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
            self.drive.fail(self.at, error);
        }
        // "The response will be the sign on message" (MC 5-26).
        let is_greeting = outcome == Ok(Answer::Greeting);
        if sums != 0 && self.drive.bank.echo() != Echo::None && !is_greeting {
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
    fn run_statement(&mut self, link: Link, line: &[u8], programming: Option<u16>) -> Result<Answer, Error> {
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
    // Not inlined: many places answer.
    #[inline(never)]
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
        prompt(&self.drive.bank, self.drive.mcode.errors)
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
