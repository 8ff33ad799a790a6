//! Collisions: characters that overlap on a line.

use drivetwin_firmware::device::{Duration, Instant, Line};

use crate::line::faults::data_bits;
use crate::rng::Rng;

/// Longest character: 12 bits at 50 baud.
const LONGEST_CHARACTER: Duration = Duration::millis(240);

/// Characters on a line where characters may overlap.
pub(crate) struct CollisionTracker {
    spans: Vec<Span>,
    /// Number of transmissions so far.
    count: u32,
    /// Clients that have sent since the line was free (BENCH-15).
    pub(crate) transmitted: Vec<u32>,
    /// Last time at which the line was free.
    pub(crate) free: Instant,
    rng: Rng,
}

/// Characters of one sender, back to back.
struct Span {
    number: u32,
    /// Number of their frame in the capture.
    frame: u64,
    from: Instant,
    until: Instant,
    character: Duration,
}

impl CollisionTracker {
    /// A tracker without characters, for the line with that name.
    pub(crate) fn new(seed: u64, line: &str) -> Self {
        let rng = Rng::new(seed, &format!("collisions on {line}"));
        Self { spans: Vec::new(), count: 0, transmitted: Vec::new(), free: Instant::ZERO, rng }
    }

    /// Adds `count` characters from `from` on, which are frame number `frame` of the capture. Returns the
    /// number of the transmission.
    pub(crate) fn add(
        &mut self,
        now: Instant,
        from: Instant,
        character: Duration,
        count: usize,
        frame: u64,
    ) -> u32 {
        self.spans.retain(|span| span.until + LONGEST_CHARACTER > now);
        self.count = self.count.wrapping_add(1);
        let until = from + character * count as u64;
        self.spans.push(Span { number: self.count, frame, from, until, character });
        self.count
    }

    /// Frames in the capture that a transmission overlaps.
    pub(crate) fn overlapped(&self, number: u32) -> impl Iterator<Item = u64> {
        let own = self.spans.iter().find(|span| span.number == number);
        let meets = move |span: &&Span| {
            own.is_some_and(|own| span.number != number && span.from < own.until && own.from < span.until)
        };
        self.spans.iter().filter(meets).map(|span| span.frame)
    }

    /// Returns true if the character of a transmission that ends at `end` overlaps characters of another
    /// transmission.
    pub(crate) fn collides(&self, number: u32, end: Instant) -> bool {
        let own = self.spans.iter().find(|span| span.number == number);
        let began = own.map_or(end, |span| end - span.character);
        self.spans.iter().any(|span| span.number != number && span.from < end && span.until > began)
    }

    /// Byte that clients receive for a character that ends at `end` and overlaps another one. The byte is the
    /// same for all clients, and differs from `byte`.
    pub(crate) fn garbage(&self, line: Line, end: Instant, byte: u8) -> u8 {
        let mut rng = self.rng.clone();
        rng.skip(end.ticks());
        byte ^ (rng.next() % u64::from(data_bits(line)) + 1) as u8
    }
}
