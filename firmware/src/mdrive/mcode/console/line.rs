//! Lines that are being typed, one on each connection, and the line in execution.

use heapless::{Deque, Vec};

use super::send;
use crate::device::{Context, Duration, Instant, Link};
use crate::mdrive::mcode::program::LINE_BYTES;
use crate::mdrive::mcode::serial::{Party, PartyAddress};
use crate::mdrive::startup::SIGN_ON;

/// Maximum number of connections.
pub(in crate::mdrive) const MAX_CONNECTIONS: usize = 4;

/// Number of characters that can wait during the execution of a line, if a client sends more than the drive
/// [takes](crate::device::Device::takes). Further characters are lost.
pub(in crate::mdrive) const WAITING: usize = 256;

/// A connection and the line that is being typed.
#[derive(Clone, Debug)]
pub(super) struct Console {
    pub(super) link: Link,
    pub(super) line: Vec<u8, LINE_BYTES>,
    /// True if the line was too long and is refused. The rest of it is dropped.
    pub(super) refused: bool,
    /// True if the last character was CR. An LF after it belongs to the same end of line.
    pub(super) returned: bool,
    pub(super) address_state: PartyAddress,
    /// Address of the next line, while in program mode.
    pub(super) programming: Option<u16>,
}

impl Console {
    pub(super) const fn new(link: Link, address_state: PartyAddress) -> Self {
        Self { link, line: Vec::new(), refused: false, returned: false, address_state, programming: None }
    }
}

/// All connections.
#[derive(Clone, Debug)]
pub(in crate::mdrive) struct Consoles {
    pub(super) list: Vec<Console, MAX_CONNECTIONS>,
    pub(super) party: Party,
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
    pub(super) fn open(&mut self, link: Link) -> Result<(), Console> {
        self.list.push(Console::new(link, self.first_called()))
    }

    /// Closes a connection. Forgets the text that is being typed there, the command of this connection that is
    /// in execution, and the characters that wait for its end.
    pub(super) fn close(&mut self, link: Link) {
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
    pub(super) fn first_called(&self) -> PartyAddress {
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

    pub(super) fn find(&mut self, link: Link) -> Option<&mut Console> {
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
    pub(super) fn execute(&mut self, at: Instant, link: Link, takes: Duration) {
        self.executing = Some((link, at + takes));
    }

    /// Takes the connection whose line has been executed.
    pub(super) fn executed(&mut self, at: Instant) -> Option<Link> {
        self.executing.take_if(|(_, due)| *due <= at).map(|(link, _)| link)
    }

    /// Stores characters that arrive while a line is being executed.
    pub(super) fn wait(&mut self, link: Link, character: u8) {
        // A client that respects `takes` never sends more characters than the queue holds.
        let _ = self.waiting.push_back((link, character));
    }

    /// Takes the oldest waiting character, unless a line is being executed.
    pub(super) fn waited(&mut self) -> Option<(Link, u8)> {
        if self.takes() { self.waiting.pop_front() } else { None }
    }
}
