//! Serial lines: arbitration, faults, and the times of characters.

mod client_buffers;
pub(crate) mod collisions;
pub(crate) mod fault_rules;
pub mod faults;
mod misread;
mod request_boundaries;

use std::collections::VecDeque;
use std::sync::Arc;

use drivetwin_firmware::device::{Duration, Instant, Line, Port};
use drivetwin_protocol::line::Parity;

use crate::ids::DriveId;
use crate::record::early::{EarlyRequest, EarlyRequests};
use crate::record::effects::FrameEffects;
use crate::record::journal::{Entry, Journal};
use crate::record::requests::RequestLog;
pub(crate) use client_buffers::{CharFlags, ClientState, Clients, RxBurst};
pub(crate) use collisions::CollisionTracker;
use fault_rules::Content;
use faults::{Disturbance, Text};
pub(crate) use request_boundaries::PendingFrame;

/// Timing of characters on serial lines.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum LineMode {
    /// Each character takes its time at the line's baud rate.
    #[default]
    Timed,
    /// Characters take no time, for load tests: a frame and its end arrive at the same instant, and replies
    /// leave at once (HOST-5).
    Fast,
}

/// Serial settings of a client's port, as far as they are known; a field that is `None` fits every line.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Sender {
    /// Baud rate in bits per second; `None` if unknown.
    pub baud: Option<u32>,
    /// Number of data bits, 5 to 8; `None` if unknown.
    pub data: Option<u8>,
    /// Parity bit.
    pub parity: PortParity,
    /// Number of stop bits, 1 or 2; `None` if unknown.
    pub stop: Option<u8>,
}

/// Parity of a client's port, as far as it is known.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum PortParity {
    /// Any parity.
    #[default]
    Unknown,
    /// Even or no parity, which a pty does not distinguish.
    NotOdd,
    /// This parity.
    Known(Parity),
}

impl Sender {
    /// Returns whether a drive with the settings `line` can read characters of this sender.
    #[must_use]
    pub fn fits(self, line: Line) -> bool {
        self.baud.is_none_or(|baud| baud == line.baud)
            && self.data.is_none_or(|data| data == line.data)
            && self.stop.is_none_or(|stop| stop == line.stop)
            && match self.parity {
                PortParity::Unknown => true,
                PortParity::NotOdd => line.parity != Parity::Odd,
                PortParity::Known(parity) => parity == line.parity,
            }
    }

    /// The settings of the port. A setting that is not known is taken from `line`.
    #[must_use]
    pub fn or(self, line: Line) -> Line {
        let parity = match self.parity {
            PortParity::Known(parity) => parity,
            PortParity::Unknown | PortParity::NotOdd => line.parity,
        };
        Line {
            baud: self.baud.unwrap_or(line.baud),
            data: self.data.unwrap_or(line.data),
            parity,
            stop: self.stop.unwrap_or(line.stop),
        }
    }
}

/// A line and the ports on it.
pub(crate) struct SerialLine {
    /// Name of the line: the given name, or `drive.port` for the line of a single port.
    pub(crate) name: String,
    /// Name of the port, for the line of a single port.
    pub(crate) port: Option<&'static str>,
    /// Ports, sorted by the names of their drives.
    pub(crate) ports: Arc<[(DriveId, Port)]>,
    /// Connected clients.
    pub(crate) clients: Vec<u32>,
    pub(crate) turn: LineState,
    /// Client that was served last.
    pub(crate) served: u32,
    /// Arrival order of the last request of `served`.
    pub(crate) served_order: u64,
    /// End of `turn`; if the line is free, end of the wait for the rest of a partial frame.
    pub(crate) until: Instant,
    /// Earliest start of a client's next character.
    pub(crate) free: Instant,
    /// Time until which the client that was served last keeps a line with timed characters.
    pub(crate) kept_until: Instant,
    /// End of the last character that a drive sends.
    pub(crate) sends_until: Instant,
    /// The last request; `None` if the next one may come at any time.
    pub(crate) last_request: Option<LastRequest>,
    /// True if requests that are too early are dropped.
    pub(crate) strict: bool,
    /// Requests so far that were too early.
    pub(crate) early: EarlyRequests,
    /// Client whose next request was sent in one write with its last one.
    pub(crate) continues: Option<u32>,
    /// Requests so far.
    pub(crate) requests: RequestLog,
    pub(crate) disturbance: Disturbance,
    /// Content of the last request, if a fault needs it.
    pub(crate) asked: Option<Box<Content>>,
    /// Repetitions and noise that are sent unchanged before the line is free again.
    pub(crate) behind: VecDeque<Request>,
    /// End of delayed and repeated replies; the next reply does not start earlier.
    pub(crate) held_up: Instant,
    /// Delay of the last reply on the line, including its wait for earlier replies. The drive has transmitted the reply
    /// that much earlier, so the line carries it even if the drive's power fails during the delay.
    pub(crate) late_by: Duration,
    /// Characters on the line; `None` if they cannot collide.
    pub(crate) collisions: Option<Box<CollisionTracker>>,
    /// Frames of a shared line that were corrupt or for no drive.
    pub(crate) journal: Journal,
    /// The present frame if a drive ignored it; true if that drive has another address.
    pub(crate) unclaimed: Option<Box<(Entry, bool)>>,
    /// The same of a drive that did not listen. It counts if no drive of the line listened.
    pub(crate) unheard: Option<Box<(Entry, bool)>>,
    /// True if characters of the present frame reach drives one by one.
    pub(crate) in_characters: bool,
    /// True if the present frame has characters that are no message, which are in the journal.
    pub(crate) strayed: bool,
    /// True if a drive executed or refused the present frame.
    pub(crate) claimed: bool,
    /// Begin and end of the last noise that followed a reply.
    pub(crate) noise_of_reply: (Instant, Instant),
    /// End of the last noise that followed a reply and is in the journal.
    pub(crate) noise_entered: Instant,
    /// Effects of faults on the present frame, or on the present line of text.
    pub(crate) on_request: FrameEffects,
    /// The missing silence before the present frame, if it was too early.
    pub(crate) on_early: Option<EarlyRequest>,
    /// True if the last character of a client ended a line of text.
    pub(crate) has_ended: bool,
}

/// The last request on a line, for a judgement of the silence before the next one.
#[derive(Clone, Copy)]
pub(crate) struct LastRequest {
    pub(crate) client: u32,
    /// Time at which the client had sent all bytes.
    pub(crate) written: Instant,
    /// Time that the characters take on the line.
    pub(crate) takes: Duration,
}

/// A client's message, or noise, on a line.
#[derive(Clone, Default)]
pub(crate) struct Request {
    pub(crate) client: u32,
    /// Arrival order of its bytes.
    pub(crate) order: u64,
    pub(crate) sender: Sender,
    /// Number of characters.
    pub(crate) count: usize,
    /// Characters as transmitted on the line.
    pub(crate) text: Text,
    /// The exception that answers the request, if a fault refuses it.
    pub(crate) refusal: Option<Refusal>,
    /// True for noise, which no client has sent.
    pub(crate) noise: bool,
    /// Effects of faults on the request.
    pub(crate) effects: FrameEffects,
    /// The missing silence, if the request is too early.
    pub(crate) early: Option<EarlyRequest>,
}

/// Answer of a fault to a request, in place of the drive that the request is for (BENCH-12).
#[derive(Clone, Debug)]
pub(crate) struct Refusal {
    pub(crate) drive: DriveId,
    pub(crate) port: Port,
    /// Code of the exception.
    pub(crate) code: u8,
    /// The exception as a frame.
    pub(crate) answer: Vec<u8>,
}

/// State of a line.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum LineState {
    /// Free, or reserved for a partial frame.
    Free,
    /// A frame or character is being transmitted to the drives, or the drives wait for the inter-frame gap,
    /// or the client is deferred.
    Asked,
    /// A drive answers.
    Answering,
    /// All requests are answered and no client waits. The client that was served last keeps the line and may
    /// send more.
    Kept,
}

impl LineState {
    /// Returns true while a request is not completely handled.
    pub(crate) fn is_busy(self) -> bool {
        matches!(self, Self::Asked | Self::Answering)
    }
}

impl SerialLine {
    /// A line that several drives share.
    pub(crate) fn shared(seed: u64, name: &str, ports: Vec<(DriveId, Port)>) -> Self {
        Self {
            name: name.to_owned(),
            port: None,
            ports: ports.into(),
            clients: Vec::new(),
            turn: LineState::Free,
            served: 0,
            served_order: 0,
            until: Instant::NEVER,
            free: Instant::ZERO,
            kept_until: Instant::ZERO,
            sends_until: Instant::ZERO,
            last_request: None,
            strict: false,
            early: EarlyRequests::default(),
            continues: None,
            requests: RequestLog::default(),
            disturbance: Disturbance::new(seed, name),
            asked: None,
            behind: VecDeque::new(),
            held_up: Instant::ZERO,
            late_by: Duration::ZERO,
            collisions: None,
            journal: Journal::default(),
            unclaimed: None,
            unheard: None,
            in_characters: false,
            strayed: false,
            claimed: false,
            noise_of_reply: (Instant::ZERO, Instant::ZERO),
            noise_entered: Instant::ZERO,
            on_request: FrameEffects::NONE,
            on_early: None,
            has_ended: true,
        }
    }

    /// End of the wait for the rest of a partial frame, if there is one.
    pub(crate) fn partial_until(&self) -> Option<Instant> {
        (self.turn == LineState::Free && self.until != Instant::NEVER).then_some(self.until)
    }

    /// The line of a single port that is called `name`.
    pub(crate) fn own(seed: u64, drive: &str, name: &'static str, at: (DriveId, Port)) -> Self {
        Self { port: Some(name), ..Self::shared(seed, &format!("{drive}.{name}"), vec![at]) }
    }
}
