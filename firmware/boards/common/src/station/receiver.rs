//! Characters from the cable, with the times at which they arrive on the drive's line.

use drivetwin_firmware::device::{Duration, Instant, Line};
use heapless::Deque;

use crate::cable::{Cable, CablePort};

/// Number of characters that wait for their time. The computer waits with the others.
const ROOM: usize = 32;

/// Receives the characters that the computer sends to the port of the bus.
#[derive(Debug)]
pub(crate) struct Receiver {
    /// Characters, each with the end of its stop bit; `None` if the drive cannot read it.
    characters: Deque<(Instant, Option<u8>), ROOM>,
    /// End of the last character.
    free: Instant,
}

impl Receiver {
    pub(crate) const fn new() -> Self {
        Self { characters: Deque::new(), free: Instant::ZERO }
    }

    /// Takes characters from the cable at `now`, as many as there is room for. A character begins now, or at the end of
    /// the one before it. `line` has the settings of the drive. Characters with other settings are those with an error
    /// (BOARD-14); without settings there are none.
    pub(crate) fn listen(&mut self, now: Instant, cable: &mut impl Cable, line: Line) {
        let sent = cable.line();
        let character = sent.map_or(Duration::ZERO, Line::character);
        let mut bytes = [0; ROOM];
        let room = ROOM - self.characters.len();
        let Some(bytes) = bytes.get_mut(..room).filter(|bytes| !bytes.is_empty()) else { return };
        let count = cable.read(CablePort::Bus, bytes);
        for byte in bytes.iter().take(count).filter(|_| sent.is_some()) {
            self.free = self.free.max(now) + character;
            let _ = self.characters.push_back((self.free, (sent == Some(line)).then_some(*byte)));
        }
    }

    /// Time at which the next character arrives.
    pub(crate) fn due(&self) -> Instant {
        self.characters.front().map_or(Instant::NEVER, |(at, _)| *at)
    }

    /// Takes the next character.
    pub(crate) fn take(&mut self) -> Option<(Instant, Option<u8>)> {
        self.characters.pop_front()
    }
}
