//! Serial lines: whose turn it is, and when each character is where.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use drivetwin_firmware::device::{Duration, Instant, Line, Port};
use drivetwin_protocol::line::Parity;
use drivetwin_protocol::modbus::{self, Burst, Voices};

use crate::bench::Seat;
use crate::collisions::Air;
use crate::faults::{Disturbance, Refusal, Text};

/// How long characters take.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum LineMode {
    /// Their time at the line's rate.
    #[default]
    Timed,
    /// None, for load tests: a frame and its end come at one instant, replies leave at once.
    Fast,
}

/// What is known of the settings of a sender's port; what is `None` fits every line.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Sender {
    /// Bits per second.
    pub baud: Option<u32>,
    /// Stop bits.
    pub stop: Option<u8>,
    /// Whether it asks for odd parity; a pty does not tell more of it.
    pub odd: Option<bool>,
}

impl Sender {
    /// Whether a drive on `line` can read it.
    #[must_use]
    pub fn fits(self, line: Line) -> bool {
        self.baud.is_none_or(|baud| baud == line.baud)
            && self.stop.is_none_or(|stop| stop == line.stop)
            && self.odd.is_none_or(|odd| odd == (line.parity == Parity::Odd))
    }
}

/// A line and the ports on it.
pub(crate) struct Wire {
    /// Its name on any bench: as given to it, or those of its drive and port.
    pub(crate) name: String,
    /// The name of its port, where a drive has it for itself.
    pub(crate) port: Option<&'static str>,
    /// By the names of their seats.
    pub(crate) ports: Vec<(Seat, Port)>,
    /// Who listens.
    pub(crate) clients: Vec<u32>,
    pub(crate) turn: Turn,
    /// The client that was served last.
    pub(crate) served: u32,
    /// The place of what it said in the order of arrival.
    pub(crate) said: u64,
    /// When `turn`, or the patience with half a message, ends.
    pub(crate) until: Instant,
    /// From when a client's character may begin.
    pub(crate) free: Instant,
    /// The end of the time for which the client served last keeps a line on which each character has its time.
    pub(crate) kept_until: Instant,
    /// When the last character of a drive has left.
    pub(crate) sends_until: Instant,
    pub(crate) disturbance: Disturbance,
    /// What comes, as it is, before the line is free again.
    pub(crate) behind: VecDeque<Request>,
    /// The request that is refused now.
    pub(crate) refusal: Option<Refusal>,
    /// Until when replies are on the line that were held up, or came twice: no other one overtakes them.
    pub(crate) held_up: Instant,
    /// Where characters may collide, what is on the line.
    pub(crate) air: Option<Air>,
}

/// A client's message, or noise, on a line.
#[derive(Clone, Default)]
pub(crate) struct Request {
    pub(crate) client: u32,
    /// Place in the order of arrival.
    pub(crate) order: u64,
    pub(crate) sender: Sender,
    /// How many characters it takes.
    pub(crate) count: usize,
    /// What of it is on the line.
    pub(crate) text: Text,
    /// How it is refused, and what the drives hear instead of it.
    pub(crate) refused: Option<(Refusal, Vec<u8>)>,
    /// Whether nobody has said it.
    pub(crate) noise: bool,
}

/// Whose turn it is on a line.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Turn {
    /// Nobody's, or it is given to half a message.
    Free,
    /// A message, or a character, is on its way to the drives, or they are judging it, or the client is
    /// held back.
    Asked,
    /// A drive answers.
    Answering,
    /// All is answered and nobody waits, but the client served last keeps the line and may go on.
    Kept,
}

impl Turn {
    /// Something is still under way to its end.
    pub(crate) fn is_busy(self) -> bool {
        matches!(self, Self::Asked | Self::Answering)
    }
}

impl Wire {
    /// A line that drives share.
    pub(crate) fn shared(seed: u64, name: &str, ports: Vec<(Seat, Port)>) -> Self {
        Self {
            name: name.to_owned(),
            port: None,
            ports,
            clients: Vec::new(),
            turn: Turn::Free,
            served: 0,
            said: 0,
            until: Instant::NEVER,
            free: Instant::ZERO,
            kept_until: Instant::ZERO,
            sends_until: Instant::ZERO,
            disturbance: Disturbance::new(seed, name),
            behind: VecDeque::new(),
            refusal: None,
            held_up: Instant::ZERO,
            air: None,
        }
    }

    /// When patience with half a message ends, if one waits for its rest.
    pub(crate) fn half_until(&self) -> Option<Instant> {
        (self.turn == Turn::Free && self.until != Instant::NEVER).then_some(self.until)
    }

    /// The line that a drive has for itself at a port called `name`.
    pub(crate) fn own(seed: u64, drive: &str, name: &'static str, at: (Seat, Port)) -> Self {
        Self { port: Some(name), ..Self::shared(seed, &format!("{drive}.{name}"), vec![at]) }
    }
}

/// Somebody outside.
#[derive(Default)]
pub(crate) struct Outside {
    pub(crate) bus: u32,
    /// The place of what arrived last before it came.
    since: u64,
    /// Whether it has left, and only its whole messages are still sent.
    pub(crate) left: bool,
    /// Whether its port gives characters their time itself, so that it gets what a drive says whole.
    pub(crate) paces_itself: bool,
    pub(crate) sender: Sender,
    /// Bytes that are not on the line yet.
    bytes: VecDeque<u8>,
    /// How they came.
    arrivals: VecDeque<Arrival>,
    /// Characters for it, as they end.
    inbox: VecDeque<Heard>,
}

/// A character for somebody outside.
#[derive(Clone, Copy)]
struct Heard {
    /// When it ends.
    end: Instant,
    byte: u8,
    /// The drive that says it, if one does.
    from: Option<Seat>,
    /// Whether it has collided: once spoiled it stays as it is, whatever else it meets.
    spoiled: bool,
}

/// Characters for clients that follow each other from `start` on.
#[derive(Clone, Copy)]
pub(crate) struct Told<'a> {
    pub(crate) start: Instant,
    pub(crate) character: Duration,
    pub(crate) bytes: &'a [u8],
    /// The drive that says them, if one does.
    pub(crate) from: Option<Seat>,
}

/// Bytes that came together.
#[derive(Clone, Copy)]
struct Arrival {
    /// Their place in the order of arrival.
    order: u64,
    at: Instant,
    count: usize,
    mark: Mark,
}

/// What a character is that a client has for a line on which each one has its time.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct Mark {
    /// Nobody has said it.
    pub(crate) noise: bool,
    /// A drive finds that it is wrong.
    pub(crate) unreadable: bool,
}

/// Bytes of a client that came without a silence beyond patience.
struct Spoken<'a> {
    bytes: &'a [u8],
    /// When the last of them came.
    last: Instant,
    /// Whether more came after such a silence.
    over: bool,
}

/// What a client has for the line.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Offer {
    /// So many bytes are to be sent, as from then on.
    Message(usize, Instant),
    /// Half a message, whose rest is waited for until then.
    Half(Instant),
    /// So many bytes, if no more follow until then.
    Unsure(usize, Instant),
}

impl Outside {
    /// A client on `bus` that comes when so much has arrived.
    pub(crate) fn new(bus: u32, since: u64) -> Self {
        Self { bus, since, ..Self::default() }
    }

    /// Bytes arrive.
    pub(crate) fn arrive(&mut self, at: Instant, order: u64, bytes: &[u8], mark: Mark) {
        self.bytes.extend(bytes);
        self.arrivals.push_back(Arrival { order, at, count: bytes.len(), mark });
    }

    /// What its first waiting byte is.
    pub(crate) fn mark(&self) -> Mark {
        self.arrivals.front().map(|arrival| arrival.mark).unwrap_or_default()
    }

    /// The place of its first waiting byte in the order of arrival.
    pub(crate) fn order(&self) -> Option<u64> {
        self.arrivals.front().map(|arrival| arrival.order)
    }

    /// How many bytes wait.
    pub(crate) fn backlog(&self) -> usize {
        self.bytes.len()
    }

    /// What it has for a line at `now`. On one of Modbus, `framed`, it is a message, cut where its check sum
    /// holds or in ASCII behind its line feed; a burst that cannot become one goes as it is. Elsewhere it is
    /// a character.
    pub(crate) fn offer(&mut self, now: Instant, framed: Option<Line>, patience: Duration) -> Offer {
        let Some(line) = framed else {
            return Offer::Message(1, self.arrivals.front().map_or(now, |arrival| arrival.at));
        };
        // Behind a port that paces itself is a real line, on which other drives may answer.
        let voices = if self.paces_itself { Voices::All } else { Voices::Master };
        let left = self.left;
        let Spoken { bytes, last, over } = self.first_burst(patience);
        let ended = || modbus::ended(line, bytes, voices);
        let until = last + patience;
        match modbus::front(line, bytes, voices) {
            Burst::Frame(length) => Offer::Message(length, last),
            Burst::Unsure if left => Offer::Message(ended(), last),
            Burst::Broken(_) | Burst::Partial if left && !over => Offer::Half(Instant::NEVER),
            Burst::Broken(length) => Offer::Message(length, last),
            _ if over || until <= now => Offer::Message(ended(), until.min(now)),
            Burst::Unsure => Offer::Unsure(ended(), until),
            Burst::Partial => Offer::Half(until),
        }
    }

    /// What came first, up to a silence beyond `patience`.
    fn first_burst(&mut self, patience: Duration) -> Spoken<'_> {
        let bytes = &*self.bytes.make_contiguous();
        let mut count = 0;
        let mut last = self.arrivals.front().map_or(Instant::ZERO, |arrival| arrival.at);
        for arrival in &self.arrivals {
            if arrival.at.since(last) >= patience {
                return Spoken { bytes: &bytes[..count], last, over: true };
            }
            count += arrival.count;
            last = arrival.at;
        }
        Spoken { bytes, last, over: false }
    }

    /// Takes the first bytes that wait.
    pub(crate) fn take(&mut self, length: usize) -> Vec<u8> {
        let mut left = length;
        while let Some(arrival) = self.arrivals.front_mut()
            && left > 0
        {
            let part = left.min(arrival.count);
            (left, arrival.count) = (left - part, arrival.count - part);
            if arrival.count == 0 {
                self.arrivals.pop_front();
            }
        }
        self.bytes.drain(..length).collect()
    }

    /// A character for it. Two drives that send at once are mixed.
    fn hear(&mut self, heard: Heard) {
        let place = self.inbox.partition_point(|other| other.end <= heard.end);
        self.inbox.insert(place, heard);
    }

    /// Characters of that length that are on their way to it, and on the line in that time, become others.
    pub(crate) fn garble(
        &mut self,
        from: Instant,
        until: Instant,
        character: Duration,
        garbage: impl Fn(Instant, u8) -> u8,
    ) {
        let met = |heard: &&mut Heard| from < heard.end && heard.end - character < until;
        for heard in self.inbox.iter_mut().filter(met).filter(|heard| !heard.spoiled) {
            heard.byte = garbage(heard.end, heard.byte);
            heard.spoiled = true;
        }
    }

    /// Characters of a drive that end after `at` never came.
    fn hush(&mut self, seat: Seat, at: Instant) {
        self.inbox.retain(|heard| heard.end <= at || heard.from != Some(seat));
    }

    /// When the next character for it ends.
    fn due(&self) -> Instant {
        self.inbox.front().map_or(Instant::NEVER, |heard| heard.end)
    }

    /// Appends the characters that have ended by `now`.
    fn receive(&mut self, now: Instant, into: &mut Vec<u8>) -> usize {
        let count = self.inbox.partition_point(|heard| heard.end <= now);
        into.extend(self.inbox.drain(..count).map(|heard| heard.byte));
        count
    }
}

/// Everybody outside, and who can read something when. There may be thousands of them, of whom few hear
/// something at a time.
#[derive(Default)]
pub(crate) struct Clients {
    all: BTreeMap<u32, Outside>,
    /// When each one can read its next character, if there is one.
    audible: BTreeSet<(Instant, u32)>,
}

impl Clients {
    pub(crate) fn get(&self, id: &u32) -> Option<&Outside> {
        self.all.get(id)
    }

    pub(crate) fn get_mut(&mut self, id: &u32) -> Option<&mut Outside> {
        self.all.get_mut(id)
    }

    pub(crate) fn insert(&mut self, id: u32, outside: Outside) {
        self.all.insert(id, outside);
    }

    pub(crate) fn remove(&mut self, id: &u32) -> Option<Outside> {
        let outside = self.all.remove(id)?;
        self.audible.remove(&(outside.due(), *id));
        Some(outside)
    }

    /// Returns whether a client came behind that place in the order of arrival.
    pub(crate) fn came_after(&self, id: u32, order: u64) -> bool {
        self.all.get(&id).is_some_and(|outside| outside.since >= order)
    }

    /// A client hears nothing more, and is here only until its whole messages are sent.
    pub(crate) fn leave(&mut self, id: u32) -> Option<&Outside> {
        self.listening(id, |outside| outside.inbox.clear());
        let outside = self.all.get_mut(&id)?;
        outside.left = true;
        Some(outside)
    }

    /// Characters for a client, all of them as the first one begins if its port paces itself. `garbage`: what
    /// is heard of one that ends then and collides with what is on the line already.
    pub(crate) fn hear(&mut self, id: u32, told: Told<'_>, garbage: impl Fn(Instant, u8) -> Option<u8>) {
        let Told { start, character, bytes, from } = told;
        self.listening(id, |outside| {
            for (n, &byte) in (1..).zip(bytes) {
                let end = start + character * n;
                let garbage = garbage(end, byte);
                outside.hear(Heard {
                    end: if outside.paces_itself { start } else { end },
                    byte: garbage.unwrap_or(byte),
                    from,
                    spoiled: garbage.is_some(),
                });
            }
        });
    }

    /// Characters of a drive for a client that end after `at` never came.
    pub(crate) fn hush(&mut self, id: u32, seat: Seat, at: Instant) {
        self.listening(id, |outside| outside.hush(seat, at));
    }

    /// Appends the characters that a client can read by `now`; returns how many.
    pub(crate) fn receive(&mut self, id: u32, now: Instant, into: &mut Vec<u8>) -> usize {
        self.listening(id, |outside| outside.receive(now, into)).unwrap_or(0)
    }

    /// When somebody can read the next character.
    pub(crate) fn due(&self) -> Instant {
        self.audible.first().map_or(Instant::NEVER, |&(at, _)| at)
    }

    /// Who can read something by `now`.
    pub(crate) fn audible(&self, now: Instant) -> impl Iterator<Item = u32> {
        self.audible.iter().take_while(move |&&(at, _)| at <= now).map(|&(_, id)| id)
    }

    /// Does something with what a client that has not left hears.
    fn listening<T>(&mut self, id: u32, act: impl FnOnce(&mut Outside) -> T) -> Option<T> {
        let outside = self.all.get_mut(&id).filter(|outside| !outside.left)?;
        let before = outside.due();
        let result = act(outside);
        let after = outside.due();
        if before != after {
            self.audible.remove(&(before, id));
            if after < Instant::NEVER {
                self.audible.insert((after, id));
            }
        }
        Some(result)
    }
}
