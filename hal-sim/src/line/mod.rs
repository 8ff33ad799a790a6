//! Serial lines: arbitration, faults, and the time of each character.

mod client_buffers;
pub(crate) mod collisions;
pub mod faults;
mod request_boundaries;

use std::collections::VecDeque;

use drivetwin_firmware::device::{Instant, Line, Port};
use drivetwin_protocol::line::Parity;

use crate::ids::DriveId;
pub(crate) use client_buffers::{CharFlags, ClientState, Clients, RxBurst};
pub(crate) use collisions::Air;
use faults::{Disturbance, Refusal, Text};
pub(crate) use request_boundaries::PendingFrame;

/// Time that characters take.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum LineMode {
    /// Their time at the line's rate.
    #[default]
    Timed,
    /// None, for load tests (HOST-5): a frame and its end come at one instant, replies leave at once.
    Fast,
}

/// Serial settings of a sender as far as they are known; `None` fits every line.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Sender {
    /// Bits per second.
    pub baud: Option<u32>,
    /// Stop bits.
    pub stop: Option<u8>,
    /// True for odd parity; a pty shows no more of the parity.
    pub odd: Option<bool>,
}

impl Sender {
    /// Returns whether a drive on `line` can read it.
    #[must_use]
    pub fn fits(self, line: Line) -> bool {
        self.baud.is_none_or(|baud| baud == line.baud)
            && self.stop.is_none_or(|stop| stop == line.stop)
            && self.odd.is_none_or(|odd| odd == (line.parity == Parity::Odd))
    }
}

/// A line and the ports on it.
pub(crate) struct SerialLine {
    /// Name of the line: as given to it, or the names of its drive and port.
    pub(crate) name: String,
    /// The name of its port, where a drive has it for itself.
    pub(crate) port: Option<&'static str>,
    /// By the names of their seats.
    pub(crate) ports: Vec<(DriveId, Port)>,
    /// Clients that are connected.
    pub(crate) clients: Vec<u32>,
    pub(crate) turn: LineState,
    /// The client that was served last.
    pub(crate) served: u32,
    /// The place of what it said in the order of arrival.
    pub(crate) said: u64,
    /// End of `turn`, or of the wait for the rest of half a message.
    pub(crate) until: Instant,
    /// From when a client's character may begin.
    pub(crate) free: Instant,
    /// The end of the time for which the client served last keeps a line on which each character has its time.
    pub(crate) kept_until: Instant,
    /// Time at which the last character of a drive has left.
    pub(crate) sends_until: Instant,
    pub(crate) disturbance: Disturbance,
    /// Requests that come, as they are, before the line is free again.
    pub(crate) behind: VecDeque<Request>,
    /// The request that is refused now.
    pub(crate) refusal: Option<Refusal>,
    /// Until when replies are on the line that were held up, or came twice: no other one overtakes them.
    pub(crate) held_up: Instant,
    /// Characters on the line, where they may collide.
    pub(crate) air: Option<Air>,
}

/// A client's message, or noise, on a line.
#[derive(Clone, Default)]
pub(crate) struct Request {
    pub(crate) client: u32,
    /// Place in the order of arrival.
    pub(crate) order: u64,
    pub(crate) sender: Sender,
    /// Number of characters.
    pub(crate) count: usize,
    /// Characters as they are on the line.
    pub(crate) text: Text,
    /// Refusal of the request, and what the drives get instead of it.
    pub(crate) refused: Option<(Refusal, Vec<u8>)>,
    /// True for noise, which no client has sent.
    pub(crate) noise: bool,
}

/// State of a line.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum LineState {
    /// Free, or given to half a message.
    Free,
    /// A message, or a character, is on its way to the drives, or they are judging it, or the client is
    /// held back.
    Asked,
    /// A drive answers.
    Answering,
    /// All is answered and nobody waits, but the client served last keeps the line and may go on.
    Kept,
}

impl LineState {
    /// Returns whether a request is not complete yet.
    pub(crate) fn is_busy(self) -> bool {
        matches!(self, Self::Asked | Self::Answering)
    }
}

impl SerialLine {
    /// A line that drives share.
    pub(crate) fn shared(seed: u64, name: &str, ports: Vec<(DriveId, Port)>) -> Self {
        Self {
            name: name.to_owned(),
            port: None,
            ports,
            clients: Vec::new(),
            turn: LineState::Free,
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

    /// End of the wait for the rest of half a message, if one waits.
    pub(crate) fn half_until(&self) -> Option<Instant> {
        (self.turn == LineState::Free && self.until != Instant::NEVER).then_some(self.until)
    }

    /// The line that a drive has for itself at a port called `name`.
    pub(crate) fn own(seed: u64, drive: &str, name: &'static str, at: (DriveId, Port)) -> Self {
        Self { port: Some(name), ..Self::shared(seed, &format!("{drive}.{name}"), vec![at]) }
    }
}
