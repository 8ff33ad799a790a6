//! Ports of a drive: statistics, serial settings and transmission.

use drivetwin_firmware::device::{Duration, Framing, Instant, Line, PortSpec};

use super::tcp_port::Tcp;
use crate::record::effects::FrameEffects;

/// Statistics of a port since its device was added.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Statistics {
    /// Number of requests that were executed.
    pub requests: u64,
    /// Number of requests that were refused with an exception.
    pub refused: u64,
    /// Number of frames with a wrong checksum.
    pub crc: u64,
    /// Number of frames with a gap inside.
    pub gap: u64,
    /// Number of frames of a wrong length.
    pub length: u64,
    /// Number of frames with a parity or framing error.
    pub spoiled: u64,
    /// Number of frames for another address.
    pub foreign: u64,
    /// Number of frames that arrived while the drive was starting.
    pub starting: u64,
    /// Number of connections so far; only on a TCP port.
    pub connections: u64,
    /// Number of messages to the drive; only on a TCP port. On an MCode port a message is a text line or a
    /// part of one.
    pub messages: u64,
    /// Number of connections closed because the client sent bytes that are not Modbus/TCP.
    pub broken: u64,
}

impl Statistics {
    /// Number of frames that were ignored, for any reason.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.crc + self.gap + self.length + self.spoiled + self.foreign + self.starting
    }
}

/// State of a port.
pub(crate) struct PortState {
    pub(crate) serial: Option<Serial>,
    /// State of a TCP port.
    pub(crate) tcp: Option<Box<Tcp>>,
    pub(crate) statistics: Statistics,
    /// Effects of faults on the message that the drive receives, unless it is on a half-duplex line.
    pub(crate) on_request: FrameEffects,
    /// On a port with text lines: effects of faults on the characters that the drive has sent before the end
    /// of the line.
    pub(crate) on_echo: FrameEffects,
}

impl PortState {
    pub(super) fn new(spec: &PortSpec) -> Self {
        let serial = spec.line.map(|line| Serial::new(line, spec.framing == Framing::Silence));
        let tcp = spec.is_tcp().then(|| Box::new(Tcp::new(spec)));
        Self {
            serial,
            tcp,
            statistics: Statistics::default(),
            on_request: FrameEffects::NONE,
            on_echo: FrameEffects::NONE,
        }
    }
}

/// A serial port.
pub(crate) struct Serial {
    /// The serial line that the port is on.
    pub(super) bus: u32,
    factory: Line,
    line: Line,
    /// Settings that take effect later, and their times.
    later: Vec<(Instant, Line)>,
    /// True for half-duplex Modbus, where a gap or, in ASCII, a line feed ends a frame. False for full-duplex
    /// lines with timed characters.
    pub(crate) framed: bool,
    /// Time at which the first character of the last message began to leave.
    pub(super) began: Option<Instant>,
    /// Time at which the last character has left.
    pub(crate) sends_until: Instant,
}

impl Serial {
    fn new(line: Line, framed: bool) -> Self {
        Self {
            bus: 0,
            factory: line,
            line,
            later: Vec::new(),
            framed,
            began: None,
            sends_until: Instant::ZERO,
        }
    }

    /// Restores the factory settings.
    pub(super) fn power_on(&mut self) {
        self.line = self.factory;
        self.later.clear();
    }

    /// Settings that apply to a character that begins at `at`.
    pub(crate) fn line_at(&self, at: Instant) -> Line {
        self.later.iter().rev().find(|(from, _)| *from <= at).map_or(self.line, |&(_, line)| line)
    }

    /// Changes the settings after all queued characters have left.
    pub(super) fn change(&mut self, at: Instant, line: Line) {
        self.line = self.line_at(at);
        self.later.retain(|(from, _)| *from > at);
        self.later.push((at.max(self.sends_until), line));
    }

    /// Sends `count` characters after all queued ones. With `fast`, characters take no time. Returns the
    /// start of the first character, and its settings.
    pub(crate) fn send(&mut self, at: Instant, count: usize, fast: bool) -> (Instant, Line) {
        let start = at.max(self.sends_until);
        let line = self.line_at(start);
        let character = if fast { Duration::ZERO } else { line.character() };
        self.began = Some(start);
        self.sends_until = start + character * count as u64;
        (start, line)
    }
}
