//! Ports of a device, and how they send.

use drivetwin_firmware::device::{Duration, Framing, Instant, Line, PortSpec};

use super::tcp_port::Tcp;

/// Statistics of a port since its device was added.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Statistics {
    /// Requests carried out.
    pub requests: u64,
    /// Requests refused with an exception.
    pub refused: u64,
    /// Frames whose check sum did not hold.
    pub crc: u64,
    /// Frames with a silence inside.
    pub gap: u64,
    /// Frames of a wrong length.
    pub length: u64,
    /// Frames with a parity or framing error.
    pub spoiled: u64,
    /// Frames for another address.
    pub foreign: u64,
    /// Frames that came while the device was starting.
    pub starting: u64,
    /// Connections so far, on a TCP port.
    pub connections: u64,
    /// Messages to the device, on a TCP port; of MCode pieces of them.
    pub messages: u64,
    /// Connections that were closed because the bytes were no Modbus/TCP, on a TCP port.
    pub broken: u64,
}

impl Statistics {
    /// Frames ignored, for whatever reason.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.crc + self.gap + self.length + self.spoiled + self.foreign + self.starting
    }
}

/// State of a port.
pub(crate) struct PortState {
    pub(crate) serial: Option<Serial>,
    /// State of a TCP port.
    pub(crate) tcp: Option<Tcp>,
    pub(crate) statistics: Statistics,
}

impl PortState {
    pub(super) fn new(spec: &PortSpec) -> Self {
        let serial = spec.line.map(|line| Serial::new(line, spec.framing == Framing::Silence));
        let tcp = spec.is_tcp().then(|| Tcp::new(spec));
        Self { serial, tcp, statistics: Statistics::default() }
    }
}

/// A serial port.
pub(crate) struct Serial {
    /// The line it is on.
    pub(super) bus: u32,
    factory: Line,
    line: Line,
    /// Settings that hold later.
    later: Vec<(Instant, Line)>,
    /// Silence ends its messages, or in ASCII a line feed: one pair of wires for both directions.
    /// Otherwise each character has its time, and both directions run at once.
    pub(crate) silence: bool,
    /// Time at which its last message began to leave.
    pub(super) began: Option<Instant>,
    /// Time at which its last character has left.
    pub(crate) sends_until: Instant,
}

impl Serial {
    fn new(line: Line, silence: bool) -> Self {
        Self {
            bus: 0,
            factory: line,
            line,
            later: Vec::new(),
            silence,
            began: None,
            sends_until: Instant::ZERO,
        }
    }

    /// The settings are those of the factory again.
    pub(super) fn power_on(&mut self) {
        self.line = self.factory;
        self.later.clear();
    }

    /// The settings of a character that begins at `at`.
    pub(crate) fn line_at(&self, at: Instant) -> Line {
        self.later.iter().rev().find(|(from, _)| *from <= at).map_or(self.line, |&(_, line)| line)
    }

    /// Other settings, when all has left.
    pub(super) fn change(&mut self, at: Instant, line: Line) {
        self.line = self.line_at(at);
        self.later.retain(|(from, _)| *from > at);
        self.later.push((at.max(self.sends_until), line));
    }

    /// So many characters leave behind all others; `fast`: they take no time. Returns when the first
    /// one begins, and its settings.
    pub(super) fn send(&mut self, at: Instant, count: usize, fast: bool) -> (Instant, Line) {
        let start = at.max(self.sends_until);
        let line = self.line_at(start);
        let character = if fast { Duration::ZERO } else { line.character() };
        self.began = Some(start);
        self.sends_until = start + character * count as u64;
        (start, line)
    }
}
