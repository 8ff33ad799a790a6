//! Characters that overlap on a line.

use standin_firmware::device::{Duration, Instant};

use crate::dice::Dice;

/// No character takes longer: 12 bits at 50 baud.
const LONGEST_CHARACTER: Duration = Duration::millis(240);

/// What is on a line on which characters may overlap.
pub(crate) struct Air {
    spans: Vec<Span>,
    /// How many there have been.
    count: u32,
    /// Clients that have spoken since the line was free.
    pub(crate) spoke: Vec<u32>,
    /// When it was free last.
    pub(crate) free: Instant,
    dice: Dice,
}

/// Characters that somebody sends back to back.
struct Span {
    number: u32,
    from: Instant,
    until: Instant,
    character: Duration,
}

impl Air {
    /// Silence, on the line of that name.
    pub(crate) fn new(seed: u64, line: &str) -> Self {
        let dice = Dice::new(seed, &format!("collisions on {line}"));
        Self { spans: Vec::new(), count: 0, spoke: Vec::new(), free: Instant::ZERO, dice }
    }

    /// Somebody sends `count` characters from `from` on; returns a number for them.
    pub(crate) fn carry(&mut self, now: Instant, from: Instant, character: Duration, count: usize) -> u32 {
        self.spans.retain(|span| span.until + LONGEST_CHARACTER > now);
        self.count = self.count.wrapping_add(1);
        let until = from + character * count as u64;
        self.spans.push(Span { number: self.count, from, until, character });
        self.count
    }

    /// Whether a character of that number that ends at `end` overlaps another one.
    pub(crate) fn spoils(&self, number: u32, end: Instant) -> bool {
        let own = self.spans.iter().find(|span| span.number == number);
        let began = own.map_or(end, |span| end - span.character);
        self.spans.iter().any(|span| span.number != number && span.from < end && span.until > began)
    }

    /// What a client hears of a character that ends at `end` and overlaps another one: the same for all clients.
    pub(crate) fn garbage(&self, end: Instant, byte: u8) -> u8 {
        let mut dice = self.dice.clone();
        dice.skip(end.ticks());
        byte ^ (dice.next() % 255 + 1) as u8
    }
}
