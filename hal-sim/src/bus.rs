//! Serial lines: whose turn it is, and when each character is where.

use std::collections::VecDeque;

use standin_firmware::device::{Duration, Instant, Line, Port};
use standin_protocol::line::Parity;
use standin_protocol::modbus::rtu;

use crate::bench::Seat;

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
    pub(crate) name: String,
    /// By the names of their seats.
    pub(crate) ports: Vec<(Seat, Port)>,
    /// Who listens.
    pub(crate) clients: Vec<u32>,
    pub(crate) turn: Turn,
    /// The client that was served last.
    pub(crate) served: u32,
    /// When `turn`, or the patience with half a message, ends.
    pub(crate) until: Instant,
    /// From when a client's character may begin.
    pub(crate) free: Instant,
    /// When the last character of a drive has left.
    pub(crate) sends_until: Instant,
}

/// Whose turn it is on a line.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Turn {
    /// Nobody's, or it is given to half a message.
    Free,
    /// A message is on its way to the drives, or they are judging it.
    Asked,
    /// A drive answers.
    Answering,
}

impl Wire {
    pub(crate) fn new(name: &str, ports: Vec<(Seat, Port)>) -> Self {
        Self {
            name: name.to_owned(),
            ports,
            clients: Vec::new(),
            turn: Turn::Free,
            served: 0,
            until: Instant::NEVER,
            free: Instant::ZERO,
            sends_until: Instant::ZERO,
        }
    }
}

/// Somebody outside.
#[derive(Default)]
pub(crate) struct Outside {
    pub(crate) bus: u32,
    /// Whether it has left, and only its whole messages are still sent.
    pub(crate) left: bool,
    pub(crate) sender: Sender,
    /// Bytes that are not on the line yet.
    bytes: Vec<u8>,
    /// How many of them came together, and their place in the order of arrival.
    arrivals: VecDeque<(u64, usize)>,
    /// When the last of them came.
    last: Instant,
    /// Characters for it, and when they end.
    inbox: VecDeque<(Instant, u8)>,
}

/// What a client has for the line.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Offer {
    /// So many bytes are to be sent, as from then on.
    Message(usize, Instant),
    /// Half a message, whose rest is waited for until then.
    Half(Instant),
}

impl Outside {
    pub(crate) fn new(bus: u32) -> Self {
        Self { bus, ..Self::default() }
    }

    /// Bytes arrive.
    pub(crate) fn arrive(&mut self, at: Instant, order: u64, bytes: &[u8], sender: Sender) {
        self.bytes.extend_from_slice(bytes);
        self.arrivals.push_back((order, bytes.len()));
        (self.last, self.sender) = (at, sender);
    }

    /// The place of its first waiting byte in the order of arrival.
    pub(crate) fn order(&self) -> Option<u64> {
        self.arrivals.front().map(|&(order, _)| order)
    }

    /// How many bytes wait.
    pub(crate) fn backlog(&self) -> usize {
        self.bytes.len()
    }

    /// What it has for a line at `now`. Where silence ends a message it is cut where its check sum
    /// holds; a burst that cannot become one goes as it is.
    pub(crate) fn offer(&self, now: Instant, silence: bool, patience: Duration) -> Offer {
        if !silence {
            return Offer::Message(self.bytes.len(), self.last);
        }
        match rtu::front(&self.bytes) {
            rtu::Burst::Frame(length) => Offer::Message(length, self.last),
            rtu::Burst::Broken => Offer::Message(self.bytes.len(), self.last),
            rtu::Burst::Partial if self.left => Offer::Half(Instant::NEVER),
            rtu::Burst::Partial => match self.last + patience {
                until if until <= now => Offer::Message(self.bytes.len(), now),
                until => Offer::Half(until),
            },
        }
    }

    /// Takes the first bytes that wait.
    pub(crate) fn take(&mut self, length: usize) -> Vec<u8> {
        let mut left = length;
        while let Some((_, waiting)) = self.arrivals.front_mut()
            && left > 0
        {
            let part = left.min(*waiting);
            (left, *waiting) = (left - part, *waiting - part);
            if *waiting == 0 {
                self.arrivals.pop_front();
            }
        }
        self.bytes.drain(..length).collect()
    }

    /// A character for it ends at `at`. Two drives that send at once are mixed.
    pub(crate) fn hear(&mut self, at: Instant, byte: u8) {
        let place = self.inbox.partition_point(|&(end, _)| end <= at);
        self.inbox.insert(place, (at, byte));
    }

    /// Characters that end after `at` never came.
    pub(crate) fn hush(&mut self, at: Instant) {
        self.inbox.truncate(self.inbox.partition_point(|&(end, _)| end <= at));
    }

    /// When the next character for it ends.
    pub(crate) fn due(&self) -> Instant {
        self.inbox.front().map_or(Instant::NEVER, |&(end, _)| end)
    }

    /// Appends the characters that have ended by `now`.
    pub(crate) fn receive(&mut self, now: Instant, into: &mut Vec<u8>) -> usize {
        let count = self.inbox.partition_point(|&(end, _)| end <= now);
        into.extend(self.inbox.drain(..count).map(|(_, byte)| byte));
        count
    }
}
