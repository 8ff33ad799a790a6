//! Collisions: characters that overlap on a line.

use drivetwin_firmware::device::{Duration, Instant, Line, Port};

use crate::ids::DriveId;
use crate::line::faults::data_bits;
use crate::record::effects::FrameEffects;
use crate::record::journal::Collision;
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
    /// Requests of clients that are not in a journal yet if they collide.
    requests: Vec<SentRequest>,
    rng: Rng,
}

/// Sender of characters.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Transmitter {
    Client,
    Drive(DriveId, Port),
    Noise,
}

impl Transmitter {
    /// The collision of another transmission with one of this sender.
    fn collision(self) -> Collision {
        match self {
            Self::Client => Collision::Request,
            Self::Drive(..) => Collision::Reply,
            Self::Noise => Collision::Noise,
        }
    }
}

/// A request of a client.
pub(crate) struct SentRequest {
    pub(crate) number: u32,
    /// End of the last character.
    pub(crate) end: Instant,
    pub(crate) bytes: Vec<u8>,
    /// Effects of faults on the request.
    pub(crate) effects: FrameEffects,
    /// The collision of the request, if there is one.
    pub(crate) with: Option<Collision>,
}

/// Characters of one sender, back to back.
struct Span {
    number: u32,
    by: Transmitter,
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
        Self {
            spans: Vec::new(),
            count: 0,
            transmitted: Vec::new(),
            free: Instant::ZERO,
            requests: Vec::new(),
            rng,
        }
    }

    /// Adds `count` characters of a sender from `from` on, which are frame number `frame` of the capture. Returns the
    /// number of the transmission.
    pub(crate) fn add(
        &mut self,
        now: Instant,
        by: Transmitter,
        from: Instant,
        character: Duration,
        count: usize,
        frame: u64,
    ) -> u32 {
        self.spans.retain(|span| span.until + LONGEST_CHARACTER > now);
        self.count = self.count.wrapping_add(1);
        let until = from + character * count as u64;
        self.spans.push(Span { number: self.count, by, frame, from, until, character });
        for request in &mut self.requests {
            let meets = request.with.is_none()
                && self
                    .spans
                    .iter()
                    .any(|span| span.number == request.number && span.from < until && from < span.until);
            request.with = request.with.or(meets.then(|| by.collision()));
        }
        self.count
    }

    /// Adds the transmission with that number as a request of a client.
    pub(crate) fn add_request(&mut self, number: u32, bytes: &[u8], effects: FrameEffects) {
        let Some(end) = self.spans.iter().find(|span| span.number == number).map(|span| span.until) else {
            return;
        };
        let with = self.met(number).next().map(|span| span.by.collision());
        self.requests.push(SentRequest { number, end, bytes: bytes.to_vec(), effects, with });
    }

    /// Returns true if one of the present requests has collided.
    pub(crate) fn has_collided(&self) -> bool {
        self.requests.iter().any(|request| request.with.is_some())
    }

    /// Takes the requests that have ended by `now`.
    pub(crate) fn take_ended(&mut self, now: Instant) -> Vec<SentRequest> {
        self.requests.extract_if(.., |request| request.end <= now).collect()
    }

    /// The ports whose replies have collided because of a transmission: its own, and those that it overlaps.
    pub(crate) fn collided_replies(&self, number: u32) -> Vec<(DriveId, Port)> {
        let own = self.spans.iter().filter(|span| span.number == number);
        let own = own.filter(|_| self.met(number).next().is_some());
        let senders = own.chain(self.met(number)).filter_map(|span| match span.by {
            Transmitter::Drive(drive, port) => Some((drive, port)),
            Transmitter::Client | Transmitter::Noise => None,
        });
        senders.collect()
    }

    /// Frames in the capture that a transmission overlaps.
    pub(crate) fn overlapped(&self, number: u32) -> impl Iterator<Item = u64> {
        self.met(number).map(|span| span.frame)
    }

    /// The transmissions that a transmission overlaps.
    fn met(&self, number: u32) -> impl Iterator<Item = &Span> {
        let own = self.spans.iter().find(|span| span.number == number);
        let meets = move |span: &&Span| {
            own.is_some_and(|own| span.number != number && span.from < own.until && own.from < span.until)
        };
        self.spans.iter().filter(meets)
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
