//! Frames of the lines and TCP ports as a pcapng file for Wireshark and its tools.
//!
//! Each line is an interface with the line's name, and each connection of a TCP port is one (`modbus 0`).
//! Each frame is a packet with the bench time of the start of its first character (from the epoch, in whole
//! nanoseconds). A packet names its dissector (`WIRESHARK_UPPER_PDU`), so Wireshark needs no settings
//! (BENCH-17):
//!
//! | on the line | shown as |
//! |---|---|
//! | Modbus RTU, Modbus/TCP | Modbus, as a query or a response |
//! | Modbus ASCII, commands of a QSB, MCode | lines of text |
//! | frames with a wrong checksum or a collision, noise | data, with the flag of a wrong checksum |
//!
//! The comment of a packet is the request with its outcome, or the reply, in the names of the manual:
//! `write Speed = 9000 -> done`.
//!
//! The flags contain the direction of a packet: *inbound* to drives, *outbound* from a drive. A request of
//! function 5 or 6 of Modbus RTU and its reply have the same bytes. Only the direction distinguishes them,
//! unless Wireshark has RTU on port 502 (`-o mbrtu.tcp.port:502`).

mod blocks;

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, Write};

use drivetwin_firmware::device::{Duration, Framing, Instant, Line, Spec};
use drivetwin_protocol::modbus::ascii;

pub use self::blocks::{Blocks, Packet, Protocol, Way};
use crate::bench::{Bench, Outlet};
use crate::decode::{self, Message};
use crate::record::capture::{Capture, Frame, Medium, Source};
use crate::record::journal::Entry as Received;

/// Maximum length of a text line in bytes; a longer one is split.
const LONGEST_TEXT: usize = 1 << 10;

/// Writes all frames that a bench retains.
///
/// # Errors
/// Errors of the writer.
pub fn write(bench: &Bench, out: impl Write) -> io::Result<()> {
    let mut file = Pcapng::new(bench, out)?;
    file.follow(bench)?;
    file.finish(bench)
}

/// Time after the end of a frame at which its outcome is known at the latest, so that its packet is written: longer
/// than the silence that ends a frame, and the time in which a line of MCode is executed.
const KNOWN_AFTER: Duration = Duration::millis(200);

/// Copy of the frames that a bench retained at an instant, so that another thread can write them.
pub struct Snapshot {
    capture: Capture,
    /// Number of frames recorded by that instant.
    seen: u64,
    /// Time until which the frames are complete.
    now: Instant,
    outlets: Vec<(Outlet, About)>,
}

impl Snapshot {
    /// A copy of the present state, without frames.
    #[must_use]
    pub fn begin(bench: &Bench) -> Self {
        let outlets = bench.outlets().into_iter().map(|outlet| (outlet, About::of(bench, outlet)));
        let capture = bench.capture();
        Self {
            capture: capture.outline(),
            seen: capture.seen(),
            now: bench.recorded_until(),
            outlets: outlets.collect(),
        }
    }

    /// Copies at most `most` more frames. Returns true if frames are left to copy. Frames that the bench has dropped
    /// in the meantime are lost.
    pub fn go_on(&mut self, bench: &Bench, most: usize) -> bool {
        self.capture.copy_on(bench.capture(), self.seen, most)
    }

    /// Writes the frames.
    ///
    /// # Errors
    /// Errors of the writer.
    pub fn write(&self, out: impl Write) -> io::Result<()> {
        let mut file = Pcapng::with(self.outlets.iter().cloned(), out)?;
        file.take_ended(&self.capture, self.now, &|outlet| {
            let known = self.outlets.iter().find(|(known, _)| *known == outlet);
            known.map_or_else(About::default, |(_, about)| about.clone())
        })?;
        file.end()
    }
}

/// Properties of a line or TCP port that a file needs.
#[derive(Clone, Default)]
struct About {
    name: String,
    /// Kind of end that a message has there.
    ends: Option<Framing>,
    /// Descriptions of the drives, with their addresses.
    specs: Vec<(Option<u8>, &'static Spec)>,
}

impl About {
    fn of(bench: &Bench, outlet: Outlet) -> Self {
        let ports = match outlet {
            Outlet::Line(bus) => bench.ports(bus).to_vec(),
            Outlet::Tcp(drive, port) => vec![(drive, port)],
        };
        let first = ports.first();
        let port = first.and_then(|&(drive, port)| bench.spec(drive).ports.get(usize::from(port.0)));
        let specs = ports.iter().map(|&(drive, _)| (bench.address(drive), bench.spec(drive)));
        Self { name: bench.outlet_name(outlet), ends: port.map(|port| port.framing), specs: specs.collect() }
    }
}

/// Outlet of a medium.
fn outlet(on: Medium) -> Outlet {
    match on {
        Medium::Line(bus) => Outlet::Line(bus),
        Medium::Tcp(drive, port, _) => Outlet::Tcp(drive, port),
    }
}

/// Writer of a pcapng file while a bench runs. Between two calls it buffers at most one text line for each
/// line and connection.
///
/// The number of calls does not change content and order: packets are written in the order in which they end.
pub struct Pcapng<W> {
    blocks: Blocks<W>,
    /// Lines and connections.
    lines: BTreeMap<Medium, FileLine>,
    /// Text that is not written yet.
    texts: BTreeMap<(Medium, Way), Text>,
    /// Number of the first frame that is not taken yet; `ahead` contains later frames that are taken.
    first: u64,
    ahead: BTreeSet<u64>,
    /// Number of frames that the bench dropped before they were taken.
    lost: u64,
}

/// A line or connection in a file.
struct FileLine {
    /// Its number.
    number: u32,
    /// Kind of end that a message has on it.
    ends: Option<Framing>,
    /// Descriptions of the drives, with their addresses.
    specs: Vec<(Option<u8>, &'static Spec)>,
    /// The last request.
    request: Vec<u8>,
    /// Its answers, each with its outcome, if the drive says more of it than the answer does.
    limited: Vec<(Vec<u8>, String)>,
}

/// Characters that form one text line.
struct Text {
    /// Start of the first character.
    at: Instant,
    /// End of the last character.
    end: Instant,
    /// Time until which a line feed may follow a carriage return.
    open: Instant,
    bytes: Vec<u8>,
    /// Entries of the journal for the text.
    received: Vec<Received>,
    /// True if a key of MCode ends the text, too.
    has_keys: bool,
}

impl<W: Write> Pcapng<W> {
    /// Begins the file with the lines that the bench has now.
    ///
    /// # Errors
    /// Errors of the writer.
    pub fn new(bench: &Bench, out: W) -> io::Result<Self> {
        Self::with(bench.outlets().into_iter().map(|outlet| (outlet, About::of(bench, outlet))), out)
    }

    fn with(outlets: impl IntoIterator<Item = (Outlet, About)>, out: W) -> io::Result<Self> {
        let mut pcapng = Self {
            blocks: Blocks::new(out)?,
            lines: BTreeMap::new(),
            texts: BTreeMap::new(),
            first: 0,
            ahead: BTreeSet::new(),
            lost: 0,
        };
        for (outlet, about) in outlets {
            if let Outlet::Line(bus) = outlet {
                pcapng.line(Medium::Line(bus), &|_| about.clone())?;
            }
        }
        Ok(pcapng)
    }

    /// Writes the frames that ended more than 200 ms before the present time of the bench, so that their outcomes
    /// are known, and that are not written yet.
    ///
    /// # Errors
    /// Errors of the writer.
    pub fn follow(&mut self, bench: &Bench) -> io::Result<()> {
        let until = Instant::ZERO + bench.now().since(Instant::ZERO + KNOWN_AFTER);
        let until = until.min(bench.recorded_until());
        self.take_ended(bench.capture(), until, &|outlet| About::of(bench, outlet))
    }

    /// Writes the frames of a capture that have ended by `now`.
    fn take_ended(
        &mut self,
        capture: &Capture,
        now: Instant,
        about: &dyn Fn(Outlet) -> About,
    ) -> io::Result<()> {
        self.skip(capture.lost());
        let new = (self.first..).zip(capture.since(self.first));
        let ended = new.filter(|(number, frame)| frame.end() <= now && !self.ahead.contains(number));
        let mut ended: Vec<_> = ended.map(|(number, frame)| (frame.end(), number, frame)).collect();
        ended.sort_unstable_by_key(|&(end, number, _)| (end, number));
        for (end, number, frame) in ended {
            self.write_texts(end)?;
            self.take(frame, about)?;
            self.ahead.insert(number);
        }
        while self.ahead.remove(&self.first) {
            self.first += 1;
        }
        self.write_texts(now)
    }

    /// Ends the file at the present time of the bench. Incomplete text is written; a frame that has not ended is
    /// not.
    ///
    /// # Errors
    /// Errors of the writer.
    pub fn finish(mut self, bench: &Bench) -> io::Result<()> {
        self.take_ended(bench.capture(), bench.now(), &|outlet| About::of(bench, outlet))?;
        self.end()
    }

    fn end(mut self) -> io::Result<()> {
        self.write_texts(Instant::NEVER)?;
        self.blocks.flush()
    }

    /// Skips frames with numbers below `forgotten`, which the capture has dropped.
    fn skip(&mut self, forgotten: u64) {
        if forgotten > self.first {
            let taken = self.ahead.range(..forgotten).count() as u64;
            self.lost += forgotten - self.first - taken;
            self.first = forgotten;
            self.ahead = self.ahead.split_off(&forgotten);
        }
    }

    fn take(&mut self, frame: &Frame, about: &dyn Fn(Outlet) -> About) -> io::Result<()> {
        let way = match frame.from {
            Source::Client => Way::In,
            Source::Drive(_) => Way::Out,
            Source::Noise => Way::Noise,
        };
        let over = frame.bytes.is_empty() && matches!(frame.on, Medium::Tcp(..));
        if over {
            // At the end of a connection its incomplete texts are written.
            return [Way::In, Way::Out].into_iter().try_for_each(|way| self.write_text((frame.on, way)));
        }
        let line = self.line(frame.on, about)?;
        match protocol(line.ends, frame) {
            _ if frame.bytes.is_empty() => Ok(()),
            Protocol::Text => self.take_text((frame.on, way), frame),
            protocol => {
                let Frame { at, ref bytes, collided, .. } = *frame;
                let words = if collided { String::new() } else { line.words(way, protocol, bytes) };
                if way == Way::In {
                    line.limited = line.limited(&frame.received);
                }
                let comment = line.outcomes(&frame.received).unwrap_or(words);
                let line = line.number;
                self.packet(Packet { line, at, way, protocol, bytes, collided, comment: &comment, lost: 0 })
            }
        }
    }

    /// Appends characters to the pending text. A text is written when its line ends, or when it is too long.
    fn take_text(&mut self, key: (Medium, Way), frame: &Frame) -> io::Result<()> {
        let of_line = frame.line.map_or(Duration::ZERO, Line::character);
        let ends = self.lines.get(&key.0).and_then(|line| line.ends);
        let has_keys = key.1 == Way::In && ends == Some(Framing::Return);
        let character = if frame.lasts > Duration::ZERO { of_line } else { Duration::ZERO };
        let mut received = frame.received.iter().peekable();
        for (n, &byte) in (0..).zip(&frame.bytes) {
            let at = frame.at + character * n;
            if let Some(text) = self.texts.get(&key)
                && !text.goes_on(at, byte, of_line)
            {
                self.write_text(key)?;
            }
            let text = self.texts.entry(key).or_insert(Text {
                at,
                end: at,
                open: at,
                bytes: Vec::new(),
                received: Vec::new(),
                has_keys,
            });
            text.bytes.push(byte);
            text.end = at + character;
            text.open = text.end + of_line * 2;
            // A key has an entry of its own, and more characters may follow it.
            if text.is_key(byte) {
                text.received
                    .extend(received.next_if(|entry| entry.message().last() == Some(&byte)).cloned());
            }
        }
        if let Some(text) = self.texts.get_mut(&key) {
            text.received.extend(received.cloned());
        }
        Ok(())
    }

    /// Writes the texts whose lines were complete before `at`.
    fn write_texts(&mut self, at: Instant) -> io::Result<()> {
        let over = |text: &Text| at == Instant::NEVER || (text.is_line() && text.open < at);
        let texts = self.texts.iter().filter(|(_, text)| over(text));
        let mut texts: Vec<_> = texts.map(|(&key, text)| (text.open, key)).collect();
        texts.sort_unstable();
        texts.into_iter().try_for_each(|(_, key)| self.write_text(key))
    }

    fn write_text(&mut self, key: (Medium, Way)) -> io::Result<()> {
        match (self.texts.remove(&key), self.lines.get(&key.0)) {
            (Some(Text { at, bytes, received, .. }), Some(line)) => {
                let comment = line.outcomes(&received).unwrap_or_else(|| line.words_of_text(key.1, &bytes));
                let line = line.number;
                self.packet(Packet {
                    line,
                    at,
                    way: key.1,
                    protocol: Protocol::Text,
                    bytes: &bytes,
                    collided: false,
                    comment: &comment,
                    lost: 0,
                })
            }
            _ => Ok(()),
        }
    }

    fn packet(&mut self, packet: Packet<'_>) -> io::Result<()> {
        let lost = std::mem::take(&mut self.lost);
        self.blocks.packet(&Packet { lost, ..packet })
    }

    /// A line or connection. A new one is added to the file.
    fn line(&mut self, on: Medium, about: &dyn Fn(Outlet) -> About) -> io::Result<&mut FileLine> {
        match self.lines.entry(on) {
            Entry::Occupied(known) => Ok(known.into_mut()),
            Entry::Vacant(new) => {
                let About { mut name, ends, specs } = about(outlet(on));
                if let Medium::Tcp(_, _, link) = on {
                    name += &format!(" {}", link.0);
                }
                let number = self.blocks.line(&name)?;
                Ok(new.insert(FileLine { number, ends, specs, request: Vec::new(), limited: Vec::new() }))
            }
        }
    }
}

impl FileLine {
    /// Description of the drive with that address, or of the first drive.
    fn spec(&self, address: Option<u8>) -> Option<&'static Spec> {
        let of_address = self.specs.iter().find(|(own, _)| address.is_some() && *own == address);
        of_address.or(self.specs.first()).map(|&(_, spec)| spec)
    }

    /// The messages that a frame or text ended, with their outcomes; `None` if there is none.
    fn outcomes(&self, received: &[Received]) -> Option<String> {
        let mut texts: Vec<String> = Vec::new();
        for entry in received {
            let message = Message { framing: self.ends?, ascii: entry.ascii, bytes: entry.message() };
            let text = decode::exchange(self.spec(message.address())?, entry).to_string();
            // Several drives may have received a broadcast.
            if !texts.contains(&text) {
                texts.push(text);
            }
        }
        (!texts.is_empty()).then(|| texts.join("; "))
    }

    /// The answers of messages that have another effect than they say, each with the outcome.
    fn limited(&self, received: &[Received]) -> Vec<(Vec<u8>, String)> {
        let limited = received.iter().filter(|entry| entry.reasons().next().is_some());
        let outcome = |entry: &Received| {
            let message = Message { framing: self.ends?, ascii: entry.ascii, bytes: entry.message() };
            let exchange = decode::exchange(self.spec(message.address())?, entry);
            Some((entry.answer().to_vec(), exchange.outcome))
        };
        limited.filter_map(outcome).collect()
    }

    /// A Modbus frame as text; empty for a frame that is not valid, and for a reply to an unknown request.
    fn words(&mut self, way: Way, protocol: Protocol, bytes: &[u8]) -> String {
        let Some(framing) = self.ends else { return String::new() };
        let message = |bytes| Message { framing, ascii: protocol == Protocol::Ascii, bytes };
        let frame = message(bytes);
        if way != Way::Noise && !frame.is_whole() {
            return decode::flaw(&frame);
        }
        let Some(spec) = self.spec(frame.address()) else { return String::new() };
        match way {
            Way::In => {
                self.request.clear();
                self.request.extend_from_slice(bytes);
                frame.request(spec).text
            }
            Way::Out => {
                let request = message(&self.request);
                let answers = match framing {
                    // A reply has the transaction of its request.
                    Framing::Mbap => self.request.get(..2) == bytes.get(..2),
                    _ => request.address() == frame.address(),
                };
                let limited = self.limited.iter().find(|(answer, _)| answer == bytes);
                match limited {
                    _ if !answers => String::new(),
                    Some((_, outcome)) => outcome.clone(),
                    None => decode::reply(spec, Some(&request), &frame),
                }
            }
            Way::Noise => String::new(),
        }
    }

    /// A command or a line of MCode as text; empty for an answer, and if the text is the line itself.
    fn words_of_text(&self, way: Way, bytes: &[u8]) -> String {
        match (way, self.ends, self.spec(None)) {
            (Way::In, Some(framing @ (Framing::Character | Framing::Return)), Some(spec)) => {
                let words = Message { framing, ascii: false, bytes }.request(spec).text;
                if words.as_bytes() == bytes.trim_ascii_end() { String::new() } else { words }
            }
            _ => String::new(),
        }
    }
}

impl Text {
    /// Returns true if the text is a complete line.
    fn is_line(&self) -> bool {
        self.bytes.last().is_some_and(|&byte| ends_line(byte) || self.is_key(byte))
    }

    /// Returns true if a character is a key that acts without the end of a line.
    fn is_key(&self, byte: u8) -> bool {
        self.has_keys && decode::text::is_key(byte)
    }

    /// Returns true if a character that begins at `at` belongs to the text. After the end of a line, only a
    /// further line end within the time of one `character` does.
    fn goes_on(&self, at: Instant, byte: u8, character: Duration) -> bool {
        let ends_with_key = self.bytes.last().is_some_and(|&last| self.is_key(last));
        let follows = ends_line(byte) && !ends_with_key && at <= self.end + character;
        self.bytes.len() < LONGEST_TEXT && (follows || !self.is_line())
    }
}

fn ends_line(byte: u8) -> bool {
    matches!(byte, b'\r' | b'\n')
}

/// Protocol of a frame.
fn protocol(ends: Option<Framing>, frame: &Frame) -> Protocol {
    match ends {
        _ if frame.from == Source::Noise => Protocol::Noise,
        Some(Framing::Silence) if frame.line.is_some_and(ascii::is_on) => Protocol::Ascii,
        Some(Framing::Silence) => Protocol::Rtu,
        Some(Framing::Mbap) => Protocol::Tcp,
        Some(Framing::Character | Framing::Return) | None => Protocol::Text,
    }
}

#[cfg(test)]
mod tests {
    use drivetwin_firmware::md3::Md3;
    use drivetwin_protocol::modbus::rtu;

    use super::*;
    use crate::bench::{DriveId, Settings};
    use crate::record::trace::Retention;
    use crate::testing::echo_device::{EchoDevice, MCODE, MODBUS};

    /// A bench that retains that many frames, with an MD3 that was asked `times` times.
    fn asked(keep: Retention, times: usize) -> (Bench, DriveId) {
        let mut bench = Bench::with(Settings { capture: keep, ..Settings::default() });
        let md3 = bench.add::<Md3>("md3");
        bench.run_until(Instant::ZERO + Duration::secs(3));
        for _ in 0..times {
            bench.ask(md3, &rtu::read(1, 0, 1));
        }
        (bench, md3)
    }

    fn copied(copy: &Snapshot) -> Vec<u8> {
        let mut file = Vec::new();
        copy.write(&mut file).unwrap();
        file
    }

    #[test]
    fn each_connection_has_an_interface_and_its_text_lines_of_its_own() {
        let mut bench = Bench::with(Settings { capture: Retention::All, ..Settings::default() });
        let echo = bench.add::<EchoDevice>("echo");
        let [a, b, c] = [MCODE, MCODE, MODBUS].map(|port| bench.connect_to(echo, port).unwrap());
        for (client, text) in [(a, "PR"), (b, "MR 10\r\n"), (a, " P\r\n"), (b, "SL")] {
            bench.send(client, text.as_bytes());
            bench.run_until_idle();
        }
        bench.send(c, &[0, 1, 0, 0, 0, 2, 1, 0x11]);
        bench.disconnect(b);
        bench.run_until_idle();
        let mut file = Vec::new();
        write(&bench, &mut file).unwrap();
        let mut copy = Snapshot::begin(&bench);
        while copy.go_on(&bench, 2) {}
        assert_eq!(copied(&copy), file);
        let times = |bytes: &[u8]| file.windows(bytes.len()).filter(|window| *window == bytes).count();
        for name in ["mcode 0", "mcode 1", "modbus 0"] {
            assert_eq!(times(name.as_bytes()), 1, "{name}");
        }
        // Each line is in the file twice: as sent, and as echoed after the greeting. An incomplete line is
        // written at the end of its connection, with a comment that says so.
        assert_eq!((times(b"PR P\r\n"), times(b">PR P\r\n")), (2, 1));
        assert_eq!((times(b"MR 10\r\n"), times(b">MR 10\r\n"), times(b"SL")), (2, 1, 3));
        assert_eq!((times(b"mbtcp"), times(b"data-text-lines")), (2, 6));
    }

    #[test]
    fn a_copy_in_pieces_is_what_was_there_when_it_was_begun() {
        let (mut bench, md3) = asked(Retention::All, 10);
        let mut whole = Vec::new();
        write(&bench, &mut whole).unwrap();
        let mut copy = Snapshot::begin(&bench);
        let mut pieces = 1;
        while copy.go_on(&bench, 3) {
            bench.ask(md3, &rtu::read(1, 0, 1));
            pieces += 1;
        }
        // These are ten requests and ten replies.
        assert_eq!(pieces, 7);
        assert_eq!(copied(&copy), whole);
    }

    #[test]
    fn what_the_ring_drops_meanwhile_is_lost() {
        let (mut bench, md3) = asked(Retention::Ring(2_000), 30);
        let mut copy = Snapshot::begin(&bench);
        assert!(copy.go_on(&bench, 1));
        bench.ask(md3, &rtu::read(1, 0, 1));
        while copy.go_on(&bench, 1) {}
        assert_eq!(copy.capture.lost(), bench.capture().lost());
        assert_eq!(copy.capture.seen(), 60);
        for _ in 0..30 {
            bench.ask(md3, &rtu::read(1, 0, 1));
        }
        let mut copy = Snapshot { capture: copy.capture.outline(), ..copy };
        while copy.go_on(&bench, 1) {}
        assert_eq!((copy.capture.lost(), copy.capture.since(0).count()), (60, 0));
        copied(&copy);
    }
}
