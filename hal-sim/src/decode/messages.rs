//! Messages on the ports of drives, from the events of a trace: when they are on the line, and their words.
//!
//! A message has the time that the drive can know. A message to the drive begins at the end of its first
//! character. A command or line of text begins when it is complete.

use std::collections::VecDeque;
use std::mem;

use drivetwin_firmware::device::{Duration, Framing, Instant, Line, Link, Port, Spec};
use drivetwin_protocol::modbus::ascii;

use super::{Exchange, Mark, Message, Request, bytes, exchange, reply, text};
use crate::record::journal::{self, Outcome};
use crate::record::trace::{Entry, Event, InputRecord, OutputRecord, Power, Trace};

/// Time after the end of a message within which an event may belong to it.
const NEAR: Duration = Duration::millis(1);

/// Maximum number of characters that are kept of a line of text. If the line is longer, its first characters are
/// left out.
const LONGEST: usize = 1 << 10;

/// A message on a port of a drive.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct PortMessage {
    /// Index of the drive in [`Trace::drives`].
    pub drive: usize,
    /// Port.
    pub port: Port,
    /// True if the drive sends the message, false if it receives it.
    pub sent: bool,
    /// Begin of the message.
    pub begin: Instant,
    /// End of the message; its begin if it takes no time.
    pub end: Instant,
    /// The message in words. If a message arrives in parts, each part gives the words of all parts so far,
    /// with the same begin. The outcome of a message to the drive comes as a message of its own, which takes no
    /// time: `write Speed = 9000 -> done`.
    pub text: String,
    /// The outcome of a message to the drive, when it is known.
    pub outcome: Option<KnownOutcome>,
}

/// Outcome of a message to a drive.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct KnownOutcome {
    /// Begin of the message.
    pub begin: Instant,
    /// The message alone in words.
    pub request: String,
    /// The outcome in words.
    pub text: String,
    /// Mark of the message in a picture.
    pub mark: Mark,
}

/// Finds the messages in the events of a trace.
///
/// ```
/// use drivetwin_firmware::md3::Md3;
/// use drivetwin_protocol::{modbus::rtu, time::Span};
/// use drivetwin_sim::bench::Bench;
/// use drivetwin_sim::decode::messages::Messages;
///
/// let mut bench = Bench::new();
/// let md3 = bench.add::<Md3>("x");
/// bench.run_until(2_500.millis());
/// bench.ask(md3, &rtu::write(1, 0x15, 9_000));
/// let mut messages = Messages::new(bench.trace());
/// let found = bench.trace().events().filter_map(|entry| messages.take(entry));
/// let words: Vec<String> = found.map(|message| message.text).collect();
/// assert_eq!(words, ["write SpeedLow = 9000", "done"]);
/// ```
#[derive(Clone, Debug)]
pub struct Messages {
    drives: Vec<Drive>,
}

#[derive(Clone, Debug)]
struct Drive {
    spec: &'static Spec,
    fast_line: bool,
    ports: Vec<PortState>,
}

#[derive(Clone, Debug)]
struct PortState {
    framing: Framing,
    /// Serial settings, and those that apply from a later time on.
    line: Option<Line>,
    later: VecDeque<(Instant, Line)>,
    /// The last Modbus message to the drive.
    request: Vec<u8>,
    begin: Instant,
    end: Instant,
    /// The last Modbus message of the drive, and the begin of its first character.
    reply: Vec<u8>,
    sent: Instant,
    first_ends: Instant,
    sends_until: Instant,
    /// Incomplete lines of text in both directions, each with its connection.
    received_text: Vec<(Link, Vec<u8>)>,
    sent_text: Vec<(Link, Vec<u8>)>,
    /// The last command of a QSB.
    command: Vec<u8>,
    /// The last line of text of each connection whose echo has not been sent yet.
    echoes: Vec<(Link, Vec<u8>)>,
}

impl PortState {
    /// The serial settings at `at`.
    fn line_at(&mut self, at: Instant) -> Option<Line> {
        while let Some(&(from, line)) = self.later.front()
            && from <= at
        {
            (self.line, _) = (Some(line), self.later.pop_front());
        }
        self.line
    }

    fn power_on(&mut self, factory: Option<Line>) {
        *self = Self { line: factory, ..Self::new(self.framing) };
    }

    fn new(framing: Framing) -> Self {
        Self {
            framing,
            line: None,
            later: VecDeque::new(),
            request: Vec::new(),
            begin: Instant::ZERO,
            end: Instant::ZERO,
            reply: Vec::new(),
            sent: Instant::ZERO,
            first_ends: Instant::ZERO,
            sends_until: Instant::ZERO,
            received_text: Vec::new(),
            sent_text: Vec::new(),
            command: Vec::new(),
            echoes: Vec::new(),
        }
    }
}

impl Messages {
    /// Begins with the drives of a trace.
    #[must_use]
    pub fn new(trace: &Trace) -> Self {
        let port = |port: &drivetwin_firmware::device::PortSpec| PortState {
            line: port.line,
            ..PortState::new(port.framing)
        };
        let drives = trace.drives.iter().map(|drive| Drive {
            spec: drive.spec,
            fast_line: drive.fast_line,
            ports: drive.spec.ports.iter().map(port).collect(),
        });
        Self { drives: drives.collect() }
    }

    /// Takes the next event of the trace, and returns the message that it belongs to.
    pub fn take(&mut self, entry: &Entry) -> Option<PortMessage> {
        let (at, index) = (entry.at, entry.drive);
        match &entry.event {
            Event::Input(InputRecord::Power(Power::On)) => {
                let drive = self.drives.get_mut(index)?;
                for (port, spec) in drive.ports.iter_mut().zip(drive.spec.ports) {
                    port.power_on(spec.line);
                }
                None
            }
            Event::Input(InputRecord::Bytes { port, bytes }) => self.received(at, index, *port, bytes),
            Event::Input(InputRecord::Message { port, link, bytes }) => {
                self.message(at, index, *port, *link, bytes, false)
            }
            Event::Output(OutputRecord::Line { port, line }) => {
                let port = self.port(index, *port)?;
                let from = at.max(port.sends_until);
                port.later.push_back((from, *line));
                None
            }
            Event::Output(OutputRecord::Bytes { port, bytes }) => self.sent(at, index, *port, bytes),
            Event::Output(OutputRecord::Message { port, link, bytes }) => {
                self.message(at, index, *port, *link, bytes, true)
            }
            Event::Received(received) => self.outcome(at, index, received),
            _ => None,
        }
    }

    /// The outcome of a message, which is known at `at`.
    fn outcome(&mut self, at: Instant, drive: usize, entry: &journal::Entry) -> Option<PortMessage> {
        let spec = self.drives.get(drive)?.spec;
        let state = self.port(drive, entry.port)?;
        let is_present = (state.begin..=state.end + NEAR).contains(&entry.at) && !state.request.is_empty();
        let begin = match (state.framing, entry.outcome) {
            (Framing::Silence, _) if is_present => state.begin,
            // The drive has not received these.
            (
                Framing::Silence,
                Outcome::Lost
                | Outcome::RefusedByFault(_)
                | Outcome::TooEarly(_)
                | Outcome::Collided(_)
                | Outcome::NoPower
                | Outcome::PowerLost
                | Outcome::Sending,
            ) => entry.at,
            // What another drive of the line sends is no message to this one.
            (Framing::Silence, _) => return None,
            _ => entry.at,
        };
        let exchange = exchange(spec, entry);
        let mark = Mark::of(entry, exchange.verdict);
        let words = exchange.to_string();
        let Exchange { request, outcome, .. } = exchange;
        let outcome = KnownOutcome { begin, request: request.text, text: outcome, mark };
        Some(PortMessage { outcome: Some(outcome), ..message(drive, entry.port, false, at, at, words) })
    }

    fn port(&mut self, drive: usize, port: Port) -> Option<&mut PortState> {
        self.drives.get_mut(drive)?.ports.get_mut(usize::from(port.0))
    }

    /// Characters on a serial port to a drive. The first one ends at `at`.
    fn received(&mut self, at: Instant, drive: usize, port: Port, bytes: &[u8]) -> Option<PortMessage> {
        if self.is_overheard(at, drive, bytes) {
            return None;
        }
        let shared = self.drives.len() > 1;
        let Drive { spec, fast_line, .. } = *self.drives.get(drive)?;
        let state = self.port(drive, port)?;
        let line = state.line_at(at)?;
        let character = if fast_line { Duration::ZERO } else { line.character() };
        if state.framing == Framing::Character {
            let line = state.received_line(Link(0), bytes)?;
            return Some(message(drive, port, false, at, at, words(spec, Framing::Character, &line)));
        }
        let ascii = ascii::is_on(line);
        // The rest of a frame follows its beginning without a silence of 3.5 characters.
        let is_rest = match ascii {
            true => bytes.first() != Some(&b':'),
            false => at <= state.end + character * 4,
        };
        if is_rest && !state.request.is_empty() && !state.frame(ascii).is_whole() {
            state.request.extend_from_slice(bytes);
        } else {
            (state.request, state.begin) = (bytes.to_vec(), at);
        }
        state.end = at + character * (bytes.len() as u64).saturating_sub(1);
        let frame = state.frame(ascii);
        let text = match (frame.is_whole(), frame.address()) {
            (false, _) => self::bytes(frame.bytes),
            (true, Some(address @ 1..)) if shared => format!("to {address}: {}", frame.request(spec).text),
            (true, _) => frame.request(spec).text,
        };
        Some(message(drive, port, false, state.begin, state.end, text))
    }

    /// Returns true if characters to a drive are those that another drive of its line sends.
    fn is_overheard(&self, at: Instant, drive: usize, bytes: &[u8]) -> bool {
        let others = self.drives.iter().enumerate().filter(|(index, _)| *index != drive);
        let mut ports = others.flat_map(|(_, other)| &other.ports);
        ports.any(|port| port.framing == Framing::Silence && port.has_sent(at, bytes))
    }

    /// Characters that a drive puts at `at` to be sent on a serial port.
    fn sent(&mut self, at: Instant, drive: usize, port: Port, bytes: &[u8]) -> Option<PortMessage> {
        let Drive { spec, fast_line, .. } = *self.drives.get(drive)?;
        let state = self.port(drive, port)?;
        let begin = at.max(state.sends_until);
        let line = state.line_at(begin)?;
        let character = if fast_line { Duration::ZERO } else { line.character() };
        let end = begin + character * bytes.len() as u64;
        (state.sent, state.first_ends, state.sends_until) = (begin, begin + character, end);
        if state.framing == Framing::Character {
            let answer = bytes.trim_ascii();
            let text = match (answer.first(), text::response(spec, answer, &mut Request::default())) {
                (_, Some(words)) => words,
                // The echo of a write, and the codes of a refusal.
                (Some(b'w'), _) => "done".to_owned(),
                (Some(&code @ (b'e' | b'x')), _) => {
                    format!("refused: {}", text::refused_command(spec, &state.command, code))
                }
                _ => text::printable(answer),
            };
            return (!text.is_empty()).then(|| message(drive, port, true, begin, end, text));
        }
        state.reply.clear();
        state.reply.extend_from_slice(bytes);
        let text = state.reply_text(spec, ascii::is_on(line), bytes);
        Some(message(drive, port, true, begin, end, text))
    }

    /// A message on a TCP connection.
    fn message(
        &mut self,
        at: Instant,
        drive: usize,
        port: Port,
        link: Link,
        bytes: &[u8],
        sent: bool,
    ) -> Option<PortMessage> {
        let spec = self.drives.get(drive)?.spec;
        let state = self.port(drive, port)?;
        let text = match (state.framing, sent) {
            (Framing::Mbap, true) => state.reply_text(spec, false, bytes),
            (Framing::Mbap, false) => {
                state.request.clear();
                state.request.extend_from_slice(bytes);
                state.frame(false).request(spec).text
            }
            (framing, false) => {
                let line = state.received_line(link, bytes)?;
                words(spec, framing, &line)
            }
            (_, true) => state.sent_line(link, bytes)?,
        };
        Some(message(drive, port, sent, at, at, text))
    }
}

impl PortState {
    /// Returns true if characters of which the first ends at `at` are the last message of the drive, or a part of it
    /// in its place with a few characters that a fault has changed.
    fn has_sent(&self, at: Instant, bytes: &[u8]) -> bool {
        // A fault changes at most the address and the checksum.
        const MOST_CHANGED: usize = 3;
        if !(self.sent..=self.sends_until + NEAR).contains(&at) {
            return false;
        }
        let character = self.first_ends.since(self.sent);
        let place = at.since(self.first_ends).ticks().checked_div(character.ticks());
        let place = place.filter(|&place| self.first_ends + character * place == at);
        let place = place.and_then(|place| usize::try_from(place).ok());
        let part = place.and_then(|place| self.reply.get(place..place + bytes.len()));
        let is_part = part.is_some_and(|part| {
            part.iter().zip(bytes).filter(|(sent, heard)| sent != heard).count() <= MOST_CHANGED
        });
        self.reply == bytes || is_part
    }

    /// The last Modbus message to the drive.
    fn frame(&self, ascii: bool) -> Message<'_> {
        Message { framing: self.framing, ascii, bytes: &self.request }
    }

    /// A Modbus reply in words.
    fn reply_text(&self, spec: &Spec, ascii: bool, bytes: &[u8]) -> String {
        let message = Message { framing: self.framing, ascii, bytes };
        let words = reply(spec, Some(&self.frame(ascii)), &message);
        if words.is_empty() { self::bytes(bytes) } else { words }
    }

    /// Appends characters to the incomplete line of a connection. Returns the line if it ends with them.
    fn received_line(&mut self, link: Link, bytes: &[u8]) -> Option<Vec<u8>> {
        let line = line(&mut self.received_text, link, bytes)?;
        self.command.clone_from(&line);
        self.echoes.retain(|(of, _)| *of != link);
        self.echoes.push((link, text::typed(&line)));
        Some(line)
    }

    /// Appends characters of a drive to the incomplete line of a connection. Returns what a line prints: what
    /// follows the echo of the command, without prompts.
    fn sent_line(&mut self, link: Link, bytes: &[u8]) -> Option<String> {
        let line = line(&mut self.sent_text, link, bytes)?;
        let echo = self.echoes.iter().position(|(of, _)| *of == link);
        let mut echo = echo.map(|index| self.echoes.swap_remove(index).1);
        let printed = text::printed_lines(&line, &mut echo);
        self.echoes.extend(echo.map(|echo| (link, echo)));
        (!printed.is_empty()).then(|| printed.join(" / "))
    }
}

/// Appends characters to the incomplete line of a connection. Returns the lines up to the last end of a line,
/// without it, if there is one.
fn line(texts: &mut Vec<(Link, Vec<u8>)>, link: Link, bytes: &[u8]) -> Option<Vec<u8>> {
    let index = texts.iter().position(|(of, _)| *of == link).unwrap_or_else(|| {
        texts.push((link, Vec::new()));
        texts.len() - 1
    });
    let (_, text) = &mut texts[index];
    text.extend_from_slice(bytes);
    text.drain(..text.len().saturating_sub(LONGEST));
    let end = text.iter().rposition(|byte| matches!(byte, b'\r' | b'\n'))?;
    let rest = text.split_off(end + 1);
    let line = mem::replace(text, rest);
    let line = line.trim_ascii();
    (!line.is_empty()).then(|| line.to_vec())
}

/// A command or line of text in words.
fn words(spec: &Spec, framing: Framing, line: &[u8]) -> String {
    Message { framing, ascii: false, bytes: line }.request(spec).text
}

fn message(drive: usize, port: Port, sent: bool, begin: Instant, end: Instant, text: String) -> PortMessage {
    PortMessage { drive, port, sent, begin, end, text, outcome: None }
}

#[cfg(test)]
mod tests {
    use drivetwin_firmware::device::Device as _;
    use drivetwin_firmware::md3::Md3;
    use drivetwin_protocol::modbus::rtu;
    use drivetwin_protocol::time::Span as _;

    use super::*;
    use crate::bench::{Bench, Setup};

    /// The words of all messages, each with the name of the drive.
    fn words(bench: &Bench) -> Vec<String> {
        let mut messages = Messages::new(bench.trace());
        let found = bench.trace().events().filter_map(|entry| messages.take(entry));
        let arrow = |sent| if sent { "<" } else { ">" };
        found.map(|found| format!("{} {} {}", found.drive, arrow(found.sent), found.text)).collect()
    }

    #[test]
    fn answers_of_others_on_a_shared_line_are_no_requests() {
        let mut bench = Bench::new();
        let row = Md3::new().spec().find("DeviceAddress").unwrap().row;
        let address = |address| Setup { boot_fast: true, presets: vec![(row, address)], ..Setup::default() };
        let x = bench.add_with("x", Box::new(Md3::new()), address(1)).unwrap();
        let y = bench.add_with("y", Box::new(Md3::new()), address(2)).unwrap();
        bench.share("line", &[(x, Port(0)), (y, Port(0))]);
        bench.run_until(100.millis());
        bench.ask(x, &rtu::read(2, 0x15, 1));
        assert_eq!(
            words(&bench),
            ["0 > to 2: read SpeedLow", "1 > to 2: read SpeedLow", "1 < SpeedLow = 5000"]
        );
    }

    #[test]
    fn a_disturbed_answer_of_another_drive_is_no_request() {
        use crate::line::faults::{FaultRule, LineFaults};
        let mut bench = Bench::new();
        let row = Md3::new().spec().find("DeviceAddress").unwrap().row;
        let address = |address| Setup { boot_fast: true, presets: vec![(row, address)], ..Setup::default() };
        let x = bench.add_with("x", Box::new(Md3::new()), address(1)).unwrap();
        let y = bench.add_with("y", Box::new(Md3::new()), address(2)).unwrap();
        let bus = bench.share("line", &[(x, Port(0)), (y, Port(0))]);
        bench.run_until(100.millis());
        let reply =
            FaultRule { direction: Some(crate::line::faults::Direction::Reply), ..FaultRule::next(1) };
        for _ in 0..20 {
            bench.set_line_faults(bus, LineFaults { corrupt: reply, ..LineFaults::NONE });
            bench.ask(x, &rtu::read(2, 0x14, 2));
        }
        let to_x = words(&bench).into_iter().filter(|words| words.starts_with("0 > "));
        assert_eq!(to_x.collect::<Vec<_>>(), vec!["0 > to 2: read Speed"; 20]);
    }

    #[test]
    fn the_answer_of_mcode_follows_its_echo() {
        let mut bench = Bench::new();
        bench.add_with("m", crate::catalog::make("mdrive").unwrap(), Setup::default()).unwrap();
        bench.run_until(3.secs());
        let [a, b] = [(); 2].map(|()| bench.connect_to(bench.find_drive("m").unwrap(), Port(1)).unwrap());
        // The lines of two connections, and one that is corrected.
        for (client, text) in [(a, "PR "), (b, "PR PV\x08 \x08M"), (a, "P\r"), (b, "\x08\x08VM\r")] {
            bench.send(client, text.as_bytes());
            bench.run_until_idle();
        }
        assert_eq!(words(&bench), ["0 > PR P", "0 < 0", "0 > PR VM", "0 < 768000"]);
    }

    #[test]
    fn commands_of_a_qsb_have_their_answers() {
        let mut bench = Bench::new();
        let qsb = bench.add_with("q", crate::catalog::make("qsb-d").unwrap(), Setup::default()).unwrap();
        bench.run_until(100.millis());
        for command in [&b"R0E\r"[..], b"W0C5\r", b"R99\r"] {
            bench.ask(qsb, command);
        }
        let words = words(&bench);
        assert_eq!(
            words[words.len() - 6..words.len() - 1],
            [
                "0 > read ReadEncoder",
                "0 < ReadEncoder = 0",
                "0 > write IntervalRate = 5",
                "0 < done",
                "0 > R99",
            ]
        );
        assert_eq!(words.last().unwrap(), "0 < refused: there is no register 99 (x)");
    }

    #[test]
    fn a_frame_in_two_parts_is_one_message() {
        let request = rtu::write(1, 0x15, 9_000);
        let (first, rest) = request.split_at(3);
        let hex = |bytes: &[u8]| bytes.iter().map(|byte| format!(" {byte:02X}")).collect::<String>();
        // A character takes 11 bits at 9600 baud.
        let text = format!(
            "drivetwin trace 1\ndrive x md3\n3000 > rx{}\n3003.4375 > rx{}\n3100 end\n",
            hex(first),
            hex(rest)
        );
        let trace = Trace::parse(&text, &|kind| crate::catalog::make(kind).ok()).unwrap();
        let mut messages = Messages::new(&trace);
        let found: Vec<_> = trace.events().filter_map(|entry| messages.take(entry)).collect();
        let [part, whole] = &found[..] else { panic!("{found:?}") };
        assert_eq!((part.text.as_str(), part.begin), ("3 bytes 01 06 00", whole.begin));
        assert_eq!(whole.text, "write SpeedLow = 9000");
        assert_eq!(
            (whole.begin, whole.end.since(whole.begin)),
            (Instant::ZERO + 3.secs(), Duration::from_ticks(55_000 + 4 * 18_333))
        );
    }
}
