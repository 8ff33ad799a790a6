//! Frames of the lines: pcapng, as Wireshark and its tools read it.
//!
//! Each line is an interface of its name, each frame a packet, stamped with the bench's time (from the epoch
//! on, in whole nanoseconds) at which its first character begins. A packet says what dissects it
//! (`WIRESHARK_UPPER_PDU`), so nothing has to be set:
//!
//! | on the line | shown as |
//! |---|---|
//! | Modbus RTU, Modbus/TCP | that, a query or a response |
//! | Modbus ASCII, commands of a QSB | lines of text |
//! | frames with a wrong check sum, noise | data; wrong check sums are in the packet's flags |
//!
//! The flags also tell which way a packet went: *inbound* to drives, *outbound* from one. That is the only way to
//! tell a request of function 5 or 6 of Modbus RTU from its reply, which is the same, unless one tells Wireshark
//! that RTU is on port 502 (`-o mbrtu.tcp.port:502`).

mod file;

use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, Write};

use standin_firmware::device::{Duration, Ends, Instant};
use standin_protocol::modbus::ascii;

pub use self::file::{File, Packet, Protocol, Way};
use crate::bench::{Bench, Bus};
use crate::capture::{Frame, From};

/// A line of text that is longer is cut there.
const LONGEST_TEXT: usize = 1 << 10;

/// Writes what a bench still knows of its lines.
///
/// # Errors
/// Those of the writer.
pub fn write(bench: &Bench, out: impl Write) -> io::Result<()> {
    let mut file = Pcapng::new(bench, out)?;
    file.follow(bench)?;
    file.finish()
}

/// A file that follows a bench. Between two calls it holds no more than the text of a line for each line.
///
/// What is in it, and in which order, does not depend on how often it follows: packets are written in the
/// order in which they end.
pub struct Pcapng<W> {
    file: File<W>,
    /// What the file calls each line.
    lines: BTreeMap<Bus, u32>,
    /// Text that is not written yet.
    texts: BTreeMap<(Bus, Way), Text>,
    /// The first frame that is not taken, and those behind it that are.
    first: u64,
    ahead: BTreeSet<u64>,
    /// Frames that the bench forgot before they were taken.
    lost: u64,
}

/// Characters that belong together.
struct Text {
    /// When the first one begins.
    at: Instant,
    /// When the last one ends.
    end: Instant,
    /// Until then a line feed may follow a carriage return.
    open: Instant,
    bytes: Vec<u8>,
}

impl<W: Write> Pcapng<W> {
    /// Begins the file, with the lines that the bench has by now.
    ///
    /// # Errors
    /// Those of the writer.
    pub fn new(bench: &Bench, out: W) -> io::Result<Self> {
        let mut pcapng = Self {
            file: File::new(out)?,
            lines: BTreeMap::new(),
            texts: BTreeMap::new(),
            first: 0,
            ahead: BTreeSet::new(),
            lost: 0,
        };
        for bus in bench.buses() {
            pcapng.line(bench, bus)?;
        }
        Ok(pcapng)
    }

    /// Writes the frames that have ended since the last time.
    ///
    /// # Errors
    /// Those of the writer.
    pub fn follow(&mut self, bench: &Bench) -> io::Result<()> {
        let (capture, now) = (bench.capture(), bench.now());
        self.skip(capture.lost());
        let new = (self.first..).zip(capture.since(self.first));
        let ended = new.filter(|(number, frame)| frame.end() <= now && !self.ahead.contains(number));
        let mut ended: Vec<_> = ended.map(|(number, frame)| (frame.end(), number, frame)).collect();
        ended.sort_unstable_by_key(|&(end, number, _)| (end, number));
        for (end, number, frame) in ended {
            self.write_texts(end)?;
            self.take(bench, frame)?;
            self.ahead.insert(number);
        }
        while self.ahead.remove(&self.first) {
            self.first += 1;
        }
        self.write_texts(now)
    }

    /// Ends the file. Text is written as far as it came, a frame that has not ended is not.
    ///
    /// # Errors
    /// Those of the writer.
    pub fn finish(mut self) -> io::Result<()> {
        self.write_texts(Instant::NEVER)?;
        self.file.flush()
    }

    /// The first so many frames are forgotten.
    fn skip(&mut self, forgotten: u64) {
        if forgotten > self.first {
            let taken = self.ahead.range(..forgotten).count() as u64;
            self.lost += forgotten - self.first - taken;
            self.first = forgotten;
            self.ahead = self.ahead.split_off(&forgotten);
        }
    }

    fn take(&mut self, bench: &Bench, frame: &Frame) -> io::Result<()> {
        let way = match frame.from {
            From::Client => Way::In,
            From::Drive(_) => Way::Out,
            From::Noise => Way::Nowhere,
        };
        let line = self.line(bench, frame.bus)?;
        match protocol(bench, frame) {
            _ if frame.bytes.is_empty() => Ok(()),
            Protocol::Text => self.take_text((frame.bus, way), frame),
            protocol => self.packet(line, frame.at, way, protocol, &frame.bytes),
        }
    }

    /// Puts characters to those before them. A text ends with its line, or is cut.
    fn take_text(&mut self, key: (Bus, Way), frame: &Frame) -> io::Result<()> {
        let timed = frame.lasts > Duration::ZERO;
        let character = if timed { frame.line.character() } else { Duration::ZERO };
        for (n, &byte) in (0..).zip(&frame.bytes) {
            let at = frame.at + character * n;
            if let Some(text) = self.texts.get(&key)
                && !text.goes_on(at, byte, frame.line.character())
            {
                self.write_text(key)?;
            }
            let text = self.texts.entry(key).or_insert(Text { at, end: at, open: at, bytes: Vec::new() });
            text.bytes.push(byte);
            text.end = at + character;
            text.open = text.end + frame.line.character() * 2;
        }
        Ok(())
    }

    /// Writes the texts of which it was clear before `at` that they are over.
    fn write_texts(&mut self, at: Instant) -> io::Result<()> {
        let over = |text: &Text| at == Instant::NEVER || (text.is_line() && text.open < at);
        let texts = self.texts.iter().filter(|(_, text)| over(text));
        let mut texts: Vec<_> = texts.map(|(&key, text)| (text.open, key)).collect();
        texts.sort_unstable();
        texts.into_iter().try_for_each(|(_, key)| self.write_text(key))
    }

    fn write_text(&mut self, key: (Bus, Way)) -> io::Result<()> {
        match (self.texts.remove(&key), self.lines.get(&key.0)) {
            (Some(text), Some(&line)) => self.packet(line, text.at, key.1, Protocol::Text, &text.bytes),
            _ => Ok(()),
        }
    }

    fn packet(
        &mut self,
        line: u32,
        at: Instant,
        way: Way,
        protocol: Protocol,
        bytes: &[u8],
    ) -> io::Result<()> {
        let lost = std::mem::take(&mut self.lost);
        self.file.packet(&Packet { line, at, way, protocol, bytes, lost })
    }

    /// What the file calls a line.
    fn line(&mut self, bench: &Bench, bus: Bus) -> io::Result<u32> {
        if let Some(&line) = self.lines.get(&bus) {
            return Ok(line);
        }
        let line = self.file.line(bench.bus_name(bus))?;
        self.lines.insert(bus, line);
        Ok(line)
    }
}

impl Text {
    /// Whether it is a whole line.
    fn is_line(&self) -> bool {
        self.bytes.last().is_some_and(|&byte| ends_line(byte))
    }

    /// Whether a character that begins at `at` belongs to it; behind the end of a line only another such that
    /// comes within a `character`.
    fn goes_on(&self, at: Instant, byte: u8, character: Duration) -> bool {
        let follows = ends_line(byte) && at <= self.end + character;
        self.bytes.len() < LONGEST_TEXT && (follows || !self.is_line())
    }
}

fn ends_line(byte: u8) -> bool {
    matches!(byte, b'\r' | b'\n')
}

/// What is spoken on a line.
fn protocol(bench: &Bench, frame: &Frame) -> Protocol {
    let first = bench.ports(frame.bus).first();
    let port = first.and_then(|&(seat, port)| bench.spec(seat).ports.get(usize::from(port.0)));
    match port.map(|port| port.ends) {
        _ if frame.from == From::Noise => Protocol::Noise,
        Some(Ends::Silence) if ascii::is_on(frame.line) => Protocol::Ascii,
        Some(Ends::Silence) => Protocol::Rtu,
        Some(Ends::Mbap) => Protocol::Tcp,
        Some(Ends::Character | Ends::Return) | None => Protocol::Text,
    }
}
