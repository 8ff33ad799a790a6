//! Connections for MCode, four at most: echo, end of lines, keys (MC 3.4.4, 7.1.1).
//!
//! Each connection has its own line and its own program mode; both end with the connection. Echo mode belongs
//! to the drive. A connection receives nothing before it has sent something, except text for all connections.
//! The drive executes one line at a time, from any connection, and takes no other input from its connections
//! meanwhile (MDRIVE-35).

use core::mem;

use heapless::{Deque, Vec};

use super::program::LINE_BYTES;
use super::serial::{Party, PartyAddress};
use crate::device::{Context, DropReason, Duration, Instant, Link, LogEvent, Output};
use crate::mdrive::MCODE;
use crate::mdrive::error::Errors;
use crate::mdrive::reasons::{Why, report};
use crate::mdrive::registers::Reg;
use crate::mdrive::startup::SIGN_ON;
use crate::mdrive::variables::Registers;

/// End of a printed line.
pub(in crate::mdrive) const CR_LF: &[u8] = b"\r\n";

const CTRL_C: u8 = 0x03;
const CTRL_E: u8 = 0x05;
const BACKSPACE: u8 = 0x08;
const ESCAPE: u8 = 0x1B;
const DELETE: u8 = 0x7F;

/// Echo of a typed line, by EM (MC 7.1.1).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) enum Echo {
    /// Each character, and a prompt.
    Full,
    /// CR LF when the line is accepted.
    Half,
    /// Nothing; only printed text is sent.
    None,
    /// The whole line, after its end.
    Afterwards,
}

/// Maximum number of connections.
pub(in crate::mdrive) const MAX_CONNECTIONS: usize = 4;

/// Number of characters that can wait during the execution of a line, if a client sends more than the drive
/// [takes](crate::device::Device::takes). Further characters are lost.
const WAITING: usize = 256;

/// A connection and the line that is being typed.
#[derive(Clone, Debug)]
struct Console {
    link: Link,
    line: Vec<u8, LINE_BYTES>,
    /// True if the line was too long and is refused. The rest of it is dropped.
    refused: bool,
    /// True if the last character was CR. An LF after it belongs to the same end of line.
    returned: bool,
    address_state: PartyAddress,
    /// Address of the next line, while in program mode.
    programming: Option<u16>,
}

impl Console {
    const fn new(link: Link, address_state: PartyAddress) -> Self {
        Self { link, line: Vec::new(), refused: false, returned: false, address_state, programming: None }
    }
}

/// A line that is complete.
pub(in crate::mdrive) struct Typed {
    pub(in crate::mdrive) line: Vec<u8, LINE_BYTES>,
    /// Name by which the line called this drive; 0 if it called none.
    pub(in crate::mdrive) name: u8,
    /// Address at which the line is stored, in program mode.
    pub(in crate::mdrive) programming: Option<u16>,
}

/// Result of a character.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) enum Key {
    None,
    /// The line ends. The program continues at full speed if it `continues`.
    End {
        continues: bool,
    },
    /// The program executes one line.
    Step,
    /// The line is too long and is refused.
    TooLong,
    /// Ctrl-C: the drive restarts.
    Restart,
    /// Esc or Ctrl-E: motion and program stop.
    Abort,
}

/// All connections.
#[derive(Clone, Debug)]
pub(in crate::mdrive) struct Consoles {
    list: Vec<Console, MAX_CONNECTIONS>,
    party: Party,
    /// Connection whose line is being executed, and the end of the execution. There is only one at a time.
    executing: Option<(Link, Instant)>,
    /// Characters received during the execution, in their order.
    waiting: Deque<(Link, u8), WAITING>,
}

impl Consoles {
    pub(in crate::mdrive) const fn new() -> Self {
        Self { list: Vec::new(), party: Party::Off, executing: None, waiting: Deque::new() }
    }

    /// Opens a connection.
    ///
    /// # Errors
    /// There is no room.
    fn open(&mut self, link: Link) -> Result<(), Console> {
        self.list.push(Console::new(link, self.first_called()))
    }

    /// Closes a connection. Forgets the text that is being typed there, the command of this connection that is
    /// in execution, and the characters that wait for its end.
    pub(in crate::mdrive) fn close(&mut self, link: Link) {
        self.list.retain(|console| console.link != link);
        self.executing.take_if(|(executing, _)| *executing == link);
        for _ in 0..self.waiting.len() {
            if let Some(typed) = self.waiting.pop_front().filter(|typed| typed.0 != link) {
                // The queue has room again.
                let _ = self.waiting.push_back(typed);
            }
        }
    }

    /// Returns true if a connection is in program mode.
    pub(in crate::mdrive) fn is_programming(&self) -> bool {
        self.list.iter().any(|console| console.programming.is_some())
    }

    /// Resets all connections for a restart of the drive. They stay open.
    pub(in crate::mdrive) fn restart(&mut self) {
        self.party = Party::Off;
        self.executing = None;
        self.waiting.clear();
        for console in &mut self.list {
            *console = Console::new(console.link, PartyAddress::Plain);
        }
    }

    /// Begins or ends party mode. Unfinished lines are dropped.
    pub(in crate::mdrive) fn set_party(&mut self, on: bool) {
        if on == (self.party != Party::Off) {
            return;
        }
        self.party = if on { Party::Waiting } else { Party::Off };
        let address_state = self.first_called();
        for console in &mut self.list {
            *console =
                Console { programming: console.programming, ..Console::new(console.link, address_state) };
        }
    }

    /// Addressee at the beginning of a line.
    fn first_called(&self) -> PartyAddress {
        if self.party == Party::Off { PartyAddress::Plain } else { PartyAddress::Next }
    }

    /// All connections.
    pub(in crate::mdrive) fn links(&self) -> Vec<Link, MAX_CONNECTIONS> {
        let mut links = Vec::new();
        for console in &self.list {
            // The list has room for all connections.
            let _ = links.push(console.link);
        }
        links
    }

    /// Sends text to every connection, such as PR of a program. Without a connection the text is lost.
    pub(in crate::mdrive) fn send_to_all(&self, at: Instant, text: &[u8], out: &mut dyn Context) {
        for console in &self.list {
            send(at, console.link, text, out);
        }
    }

    /// Sends the drive's name to every connection, because a move that announces its end has ended (MC 5-45).
    pub(in crate::mdrive) fn send_name(&self, at: Instant, name: u16, out: &mut dyn Context) {
        self.send_to_all(at, &[(name & 0x7F) as u8, b'\r', b'\n'], out);
    }

    /// Sends the sign-on and a prompt to every connection.
    pub(in crate::mdrive) fn greet(&self, at: Instant, prompt: &[u8], out: &mut dyn Context) {
        self.send_to_all(at, SIGN_ON, out);
        self.send_to_all(at, prompt, out);
    }

    fn find(&mut self, link: Link) -> Option<&mut Console> {
        self.list.iter_mut().find(|console| console.link == link)
    }

    /// Returns true if no line is being executed.
    pub(in crate::mdrive) fn takes(&self) -> bool {
        self.executing.is_none()
    }

    /// Time at which the line in execution takes effect.
    pub(in crate::mdrive) fn deadline(&self) -> Instant {
        self.executing.map_or(Instant::NEVER, |(_, due)| due)
    }

    /// Begins to execute the line on a connection.
    pub(in crate::mdrive) fn execute(&mut self, at: Instant, link: Link, takes: Duration) {
        self.executing = Some((link, at + takes));
    }

    /// Takes the connection whose line has been executed.
    pub(in crate::mdrive) fn executed(&mut self, at: Instant) -> Option<Link> {
        self.executing.take_if(|(_, due)| *due <= at).map(|(link, _)| link)
    }

    /// Stores characters that arrive while a line is being executed.
    pub(in crate::mdrive) fn wait(&mut self, link: Link, character: u8) {
        // A client that respects `takes` never sends more characters than the queue holds.
        let _ = self.waiting.push_back((link, character));
    }

    /// Takes the oldest waiting character, unless a line is being executed.
    pub(in crate::mdrive) fn waited(&mut self) -> Option<(Link, u8)> {
        if self.takes() { self.waiting.pop_front() } else { None }
    }

    /// Handles a character, which is echoed if that is on. `steps` is true if the program waits for a key. Returns what
    /// follows.
    pub(in crate::mdrive) fn character(
        &mut self,
        at: Instant,
        link: Link,
        character: u8,
        registers: &Registers,
        steps: bool,
        out: &mut dyn Context,
    ) -> Key {
        let party = registers.is_party();
        if party && !self.is_for_me(at, link, character, registers, out) {
            return Key::None;
        }
        let echoes = registers.echo() == Echo::Full;
        let Some(console) = self.find(link) else { return Key::None };
        let returned = mem::replace(&mut console.returned, character == b'\r');
        let is_blank = console.line.trim_ascii().is_empty() && !console.refused;
        match character {
            b'\n' if returned && !party => Key::None,
            b'\r' if party => Key::None,
            b'\r' | b'\n' => Key::End { continues: steps && is_blank },
            CTRL_C if registers.word(Reg::CE) != 0 => {
                note_key(at, character, out);
                // The sign-on begins on a new line.
                let is_open = echoes && !console.line.is_empty();
                self.answer(at, link, if is_open { CR_LF } else { b"" }, registers, out);
                Key::Restart
            }
            _ if character == registers.escape() => {
                note_key(at, character, out);
                let programming = console.programming;
                *console = Console { programming, ..Console::new(link, console.address_state) };
                Key::Abort
            }
            CTRL_C | CTRL_E | ESCAPE => {
                report(Err(Why::KeyIsOff), at, out);
                note_key(at, character, out);
                Key::None
            }
            b' ' if steps && is_blank => Key::Step,
            BACKSPACE | DELETE => {
                let taken = console.line.pop().is_some();
                let erasure: &[u8] = if taken && echoes { b"\x08 \x08" } else { b"" };
                self.answer(at, link, erasure, registers, out);
                Key::None
            }
            b'\t' | b' '.. if !console.refused => {
                if console.line.push(character).is_err() {
                    console.refused = true;
                    return Key::TooLong;
                }
                if echoes {
                    self.answer(at, link, &[character], registers, out);
                }
                Key::None
            }
            // Ignored: the rest of a line that was too long, or a key that the drive does not have.
            _ => Key::None,
        }
    }

    /// Ends a line. Returns false if the line was refused before, so that it is not executed.
    pub(in crate::mdrive) fn end_line(&mut self, link: Link) -> bool {
        let next = self.first_called();
        let Some(console) = self.find(link) else { return false };
        let refused = mem::take(&mut console.refused);
        if refused {
            console.line.clear();
            console.address_state = next;
        }
        !refused
    }

    /// Line on a connection, and true if it is in program mode.
    pub(in crate::mdrive) fn line(&self, link: Link) -> (&[u8], bool) {
        let console = self.list.iter().find(|console| console.link == link);
        console.map_or((&[], false), |console| (&console.line, console.programming.is_some()))
    }

    /// Takes the line on a connection.
    pub(in crate::mdrive) fn take_line(&mut self, link: Link) -> Option<Typed> {
        let console = self.find(link)?;
        let line = mem::take(&mut console.line);
        Some(Typed { line, name: console.address_state.name(), programming: console.programming })
    }

    /// Begins the next line, after one that has been executed.
    pub(in crate::mdrive) fn next_line(&mut self, link: Link) {
        self.begin_line(link, self.first_called());
    }

    fn begin_line(&mut self, link: Link, address_state: PartyAddress) {
        if let Some(console) = self.find(link) {
            console.address_state = address_state;
        }
    }

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
                self.begin_line(link, PartyAddress::Next);
                false
            }
            (PartyAddress::Next, name) if active => {
                self.begin_line(link, registers.addressee(name));
                // Table 7.2 shows no echo of the name, but hardware sends it (MDRIVE-40).
                if registers.echo() == Echo::Full {
                    self.answer(at, link, &[name], registers, out);
                }
                false
            }
            (PartyAddress::Plain | PartyAddress::Next | PartyAddress::Others, _) => false,
        }
    }

    /// Sends the end of a line's echo. With checksums an acknowledgement is sent instead of CR LF.
    pub(in crate::mdrive) fn end_echo(
        &self,
        at: Instant,
        link: Link,
        line: &[u8],
        registers: &Registers,
        out: &mut dyn Context,
    ) {
        let mode = registers.echo();
        if mode == Echo::Afterwards {
            self.answer(at, link, line, registers, out);
        }
        if mode != Echo::None && registers.check_sums() == 0 {
            self.answer(at, link, CR_LF, registers, out);
        }
    }

    /// Sets the address from which typed lines are stored; `None` ends program mode.
    pub(in crate::mdrive) fn program_from(&mut self, link: Link, address: Option<u16>) {
        if let Some(console) = self.find(link) {
            console.programming = address;
        }
    }

    /// Sends an answer on a connection, if this drive is to answer.
    pub(in crate::mdrive) fn answer(
        &self,
        at: Instant,
        link: Link,
        bytes: &[u8],
        registers: &Registers,
        out: &mut dyn Context,
    ) {
        for link in &self.recipients(link, registers) {
            send(at, *link, bytes, out);
        }
    }

    /// Connections that get the answer to a line: its own, or none if this drive is not to answer.
    pub(in crate::mdrive) fn recipients(
        &self,
        link: Link,
        registers: &Registers,
    ) -> Vec<Link, MAX_CONNECTIONS> {
        let mut links = Vec::new();
        let console = self.list.iter().find(|console| console.link == link);
        if console.is_some_and(|console| registers.answers(console.address_state)) {
            // The list has room for one connection.
            let _ = links.push(link);
        }
        links
    }

    /// Answers Esc or Ctrl-E.
    pub(in crate::mdrive) fn answer_abort(
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
        let answer: &[u8] = match registers.echo() {
            Echo::Full => b"#\r\n",
            Echo::None => b"",
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
    pub(in crate::mdrive) fn echo(&self) -> Echo {
        match self.word(Reg::EM) {
            0 => Echo::Full,
            1 => Echo::Half,
            2 => Echo::None,
            _ => Echo::Afterwards,
        }
    }

    /// Key that stops everything: ES (MC 5-23). Only in party mode can it be addressed.
    fn escape(&self) -> u8 {
        if self.word(Reg::ES) & 1 != 0 { ESCAPE } else { CTRL_E }
    }
}

/// Prompt, which exists in EM 0 only: a question mark while there is an error (MC 9; MDRIVE-10).
pub(in crate::mdrive) fn prompt(registers: &Registers, errors: Errors) -> &'static [u8] {
    match (registers.echo(), errors.is_set()) {
        (Echo::Full, false) => b">",
        (Echo::Full, true) => b"?",
        _ => b"",
    }
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
pub(in crate::mdrive) fn send(at: Instant, link: Link, bytes: &[u8], out: &mut dyn Context) {
    if !bytes.is_empty() {
        out.put(at, Output::Message { port: MCODE, link, bytes });
    }
}
